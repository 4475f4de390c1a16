//! Layers of the stable map: panoramas with range, where they were taken seen from each other, and what is behind moving
//! things.

use crate::{Bytes, Pose, Stamp, record};

record! {
    /// A panorama with range: what a view looks like in every direction, and how far away it is.
    #[layer("spheres", key(site, session, stamp, camera))]
    pub struct SphereView {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// Width of both images.
        width: u32 ["px"],
        /// Height of both images.
        height: u32 ["px"],
        /// `[fx, fy]` in pixels per radian: columns are longitude, rows are latitude.
        focal: Vec<f64> ["px/rad"],
        /// `[cx, cy]`: the pixel that looks straight ahead.
        centre: Vec<f64> ["px"],
        /// The picture, encoded as it was in the log.
        image: Bytes,
        /// Distance along the ray, encoded as it was in the log: 16 or fewer bits, 0 where nothing was measured.
        range: Bytes,
        /// Metres per unit of the range.
        unit_m: f64 ["m"],
    }
}

record! {
    /// Where a view was taken, seen from a view of the map: a relocation that ends in a pose.
    #[layer("registrations", key(site, session, stamp, camera, rank))]
    pub struct ViewRegistration {
        /// Site of the map.
        site: String,
        /// Session of the view.
        session: String,
        /// Exposure instant of the view.
        stamp: Stamp ["ns"],
        /// Camera of the view.
        camera: String,
        /// Counted from 0, the best first: converged ones before all others, then by the share of points that fit.
        rank: u32,
        /// Rank of the relocation that this began with.
        relocation_rank: u32,
        /// Session of the map's view.
        map_session: String,
        /// Exposure instant of the map's view.
        map_stamp: Stamp ["ns"],
        /// Camera of the map's view.
        map_camera: String,
        /// `converged`, or why it failed: `few seen`, `few inliers`, `unlike` (other brightness), `ambiguous`
        /// (another place fits nearly as well), `uncertain`, `restless`, `no range`.
        state: String,
        /// The view's camera in the camera of the map's view; null without range.
        map_view_from_view: Option<Pose> ["", "camera of the map's view"],
        /// Covariance of that pose, 6×6 row by row, along the axes of the view's camera: translation (m²), then rotation
        /// (rad²); empty without range.
        covariance: Vec<f64>,
        /// Standard deviation of the position along the axis that is known least, at the right place: it does not know of
        /// wrong ones; null without range.
        sigma_m: Option<f64> ["m"],
        /// Of the points of the map's view that have range, the share that the view sees as well.
        overlap: f64,
        /// Of what those tell of the place, the share that is as it should be.
        inliers: f64,
        /// Correlation of brightness over the points that are seen, within tiles of the image; null without range, or where an
        /// image has no structure.
        correlation: Option<f64>,
        /// Brightness of the view per brightness of the map's view; null without range.
        gain: Option<f64>,
    }
}

record! {
    /// A view that is linked with another one: where it was taken, seen from there.
    #[layer("view_links", key(site, session, stamp, camera, kind, other_session, other_stamp, other_camera))]
    pub struct ViewLink {
        /// Site of both views.
        site: String,
        /// Session of the view.
        session: String,
        /// Exposure instant of the view.
        stamp: Stamp ["ns"],
        /// Camera of the view.
        camera: String,
        /// `driven`: the other one came before it in its drive; `registered`: relocation found the other one in the map.
        kind: String,
        /// Session of the other view.
        other_session: String,
        /// Exposure instant of the other view.
        other_stamp: Stamp ["ns"],
        /// Camera of the other view.
        other_camera: String,
        /// The view's camera in the camera of the other view.
        other_view_from_view: Pose ["", "camera of the other view"],
        /// Covariance of that pose, 6×6 row by row, along the axes of the view's camera: translation (m²), then rotation
        /// (rad²).
        covariance: Vec<f64>,
        /// Standard deviation of the position along the axis that is known least, at the right place: it does not know of
        /// wrong ones.
        sigma_m: f64 ["m"],
    }
}

record! {
    /// Pixels of one class that turned out to hide another.
    pub struct Occluded {
        /// What is in front.
        dynamic: String,
        /// What is behind.
        class: String,
        /// Pixels.
        pixels: u64 ["px"],
    }
}

record! {
    /// A label image in which what moves is replaced by what other views saw behind it.
    #[layer("warped_labels", key(site, session, stamp, camera))]
    pub struct WarpedLabels {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took the image.
        camera: String,
        /// Width of the image.
        width: u32 ["px"],
        /// Height of the image.
        height: u32 ["px"],
        /// Names of the classes; a pixel's value is an index into this list.
        classes: Vec<String>,
        /// The labels as an 8-bit grey PNG; 255 where a pixel has no class.
        png: Bytes,
        /// Other views that were looked through.
        views: u32,
        /// What was replaced by what; ordered by class.
        occlusions: Vec<Occluded>,
        /// Pixels that still show what moves, as nobody saw what is behind them.
        unseen_px: u64 ["px"],
        /// Pixels that have no class as what others saw behind what moves is not clear: where areas meet.
        unclear_px: u64 ["px"],
    }
}

record! {
    /// How often a moving thing of one class hid a static one, over all views.
    #[layer("occlusion_counts", key(site, dynamic, class))]
    pub struct OcclusionCount {
        /// Site of the views.
        site: String,
        /// What is in front.
        dynamic: String,
        /// What is behind.
        class: String,
        /// Pixels O: what was taken for the one and is the other.
        pixels: u64 ["px"],
        /// Views that show this.
        views: u64,
        /// Sum over the views of the squares of these pixels.
        squares: u64 ["px²"],
        /// Sum over the views of these pixels times all pixels where something is behind this dynamic class.
        products: u64 ["px²"],
    }
}

record! {
    /// How probably a static class is behind a dynamic one.
    #[layer("occlusion_model", key(site, dynamic, class))]
    pub struct OcclusionProbability {
        /// Site of the views.
        site: String,
        /// What is in front.
        dynamic: String,
        /// What is behind.
        class: String,
        /// Pixels O that were taken for the one and are the other.
        pixels: u64 ["px"],
        /// `P(class | dynamic)` = O / N, of N pixels in which anything was behind this dynamic class.
        probability: f64,
        /// Standard deviation of that, as views differ.
        deviation: f64,
    }
}

record! {
    /// Pixels of one area whose class was inferred.
    pub struct InferredArea {
        /// What is in front.
        dynamic: String,
        /// What is taken to be behind.
        class: String,
        /// Pixels.
        pixels: u64 ["px"],
        /// Mean column of the pixels, from the first one around the seam.
        u: f32 ["px"],
        /// Mean row of the pixels.
        v: f32 ["px"],
        /// Mean of the pixels' probabilities of being of that class.
        probability: f64,
    }
}

record! {
    /// A label image without anything that moves: what was seen behind it, or what is probably there.
    #[layer("inferred_labels", key(site, session, stamp, camera))]
    pub struct InferredLabels {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took the image.
        camera: String,
        /// Width of the image.
        width: u32 ["px"],
        /// Height of the image.
        height: u32 ["px"],
        /// Names of the classes; a pixel's value is an index into this list.
        classes: Vec<String>,
        /// The labels as an 8-bit grey PNG; 255 where a pixel has no class.
        png: Bytes,
        /// How probable each label is, as an 8-bit grey PNG: 255 where it was seen, less where it was inferred, 0 where
        /// there is none.
        certainty: Bytes,
        /// What was inferred: by moving thing and class, the first pixel's first.
        inferred: Vec<InferredArea>,
        /// Pixels of which nothing is known: all that have no class in `png`, those too that had none before.
        unknown_px: u64 ["px"],
    }
}
