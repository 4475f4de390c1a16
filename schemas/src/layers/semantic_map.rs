//! Layers of the semantic map: labels of pixels, what labels them, graphs of views, and where views were found.

use crate::layers::Source;
use crate::{Bytes, ImageRef, Pose, Stamp, record};

record! {
    /// The classes of one image's pixels.
    #[layer("label_images", key(site, session, stamp, camera))]
    pub struct LabelImage {
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
    }
}

record! {
    /// An image with the classes of its pixels: what classifiers learn from.
    #[layer("labelled_frames", key(site, session, stamp, camera))]
    pub struct LabelledFrame {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took the image.
        camera: String,
        /// Where the pixels are.
        image: ImageRef,
        /// Names of the classes; a pixel's value is an index into this list.
        classes: Vec<String>,
        /// The labels as an 8-bit grey PNG; 255 where a pixel has no class.
        png: Bytes,
    }
}

record! {
    /// Pixels of one image that a classifier learns from.
    #[layer("pixel_samples", key(site, session, stamp, camera))]
    pub struct PixelSamples {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took the image.
        camera: String,
        /// Names of the classes.
        classes: Vec<String>,
        /// What the features are, as JSON: predictions must compute the same ones.
        features: String,
        /// Labelled pixels of each class in the image, whether sampled or not.
        class_pixels: Vec<u64>,
        /// Number of features of each sample.
        dimensions: u32,
        /// Class of each sample, an index into `classes`.
        labels: Vec<u8>,
        /// Features of the samples, one sample after the other, each value quantised to a byte.
        values: Bytes,
    }
}

record! {
    /// One node of a decision tree.
    pub struct TreeNode {
        /// Feature that is compared.
        feature: u16,
        /// A sample goes left where its feature is at most this.
        threshold: u8,
        /// Index of the left child; the right one follows it. 0 for a leaf.
        left: u32,
        /// Index of a leaf's distribution; 0 for inner nodes.
        leaf: u32,
    }
}

record! {
    /// One tree of a random forest that classifies pixels.
    #[layer("pixel_forest", key(site, tree))]
    pub struct DecisionTree {
        /// Site that it was learnt on.
        site: String,
        /// Counted from 0 within the forest.
        tree: u32,
        /// Names of the classes.
        classes: Vec<String>,
        /// What the features are, as JSON.
        features: String,
        /// The nodes, the root first.
        nodes: Vec<TreeNode>,
        /// Probability of each class at each leaf, one leaf after the other.
        distributions: Vec<f32>,
        /// Share of each class among the labelled pixels.
        priors: Vec<f32>,
        /// What it has not seen, though the forest was learnt from it: its scores there are as of new images.
        held_out: Vec<Source>,
    }
}

record! {
    /// One perceptron of a network that classifies pixels: of one hidden layer, with rectified units.
    #[layer("pixel_network", key(site, member))]
    pub struct PixelPerceptron {
        /// Site that it was learnt on.
        site: String,
        /// Counted from 0 within the network.
        member: u32,
        /// Names of the classes.
        classes: Vec<String>,
        /// What the features are, as JSON.
        features: String,
        /// Weights of the features, of one hidden unit after the other.
        hidden_weights: Vec<f32>,
        /// One a hidden unit.
        hidden_biases: Vec<f32>,
        /// Weights of the hidden units, of one class after the other.
        output_weights: Vec<f32>,
        /// One a class, all taken for equally frequent.
        output_biases: Vec<f32>,
        /// Share of each class among the labelled pixels.
        priors: Vec<f32>,
        /// What it has not seen, though the network was learnt from it: its scores there are as of new images.
        held_out: Vec<Source>,
    }
}

record! {
    /// Probabilities of the classes over one image.
    #[layer("class_scores", key(site, session, stamp, camera))]
    pub struct ClassScores {
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
        /// Side of a cell: cell (i, j) is of the pixels `[i, i + 1) * stride` by `[j, j + 1) * stride`.
        stride_px: u32 ["px"],
        /// Names of the classes.
        classes: Vec<String>,
        /// Probability of each class in each cell, `1/255` per unit: cell after cell, row by row, classes innermost.
        probabilities: Bytes,
    }
}

record! {
    /// An image with the probabilities of the classes over it.
    #[layer("scored_frames", key(site, session, stamp, camera))]
    pub struct ScoredFrame {
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
        /// Side of a cell.
        stride_px: u32 ["px"],
        /// Names of the classes.
        classes: Vec<String>,
        /// As in `class_scores`.
        probabilities: Bytes,
        /// Where the pixels are: colour for the random field, range for the neighbours' votes.
        image: ImageRef,
    }
}

record! {
    /// An image with the probabilities of the classes over it, and with the classes that are true.
    #[layer("labelled_scores", key(site, session, stamp, camera))]
    pub struct LabelledScores {
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
        /// Side of a cell.
        stride_px: u32 ["px"],
        /// Names of the classes.
        classes: Vec<String>,
        /// As in `class_scores`, by a classifier that has not learnt from this image.
        probabilities: Bytes,
        /// Where the pixels are, in colour.
        image: ImageRef,
        /// Names of the true labels' classes, which may be others in another order.
        label_classes: Vec<String>,
        /// The true labels as an 8-bit grey PNG, indices into `label_classes`; 255 where a pixel has no class.
        png: Bytes,
    }
}

record! {
    /// Parameters of the dense random field and how well they did on held-out images.
    #[layer("crf_settings", key(site, rank))]
    pub struct CrfSetting {
        /// Site that they were learnt on.
        site: String,
        /// Counted from 0, the best first.
        rank: u32,
        /// Standard deviation of the appearance kernel in the image.
        appearance_px: f64 ["px"],
        /// Standard deviation of the appearance kernel in colour (8-bit values).
        appearance_colour: f64,
        /// Weight of the appearance kernel.
        appearance_weight: f64,
        /// Standard deviation of the smoothness kernel.
        smoothness_px: f64 ["px"],
        /// Weight of the smoothness kernel.
        smoothness_weight: f64,
        /// Pixels right, of those with a class.
        pixel_accuracy: f64,
        /// Mean over the classes of the share of their pixels that are right.
        class_accuracy: f64,
        /// Images that were labelled with them: fewer than others where they were clearly worse.
        images: u32,
    }
}

record! {
    /// One connected area of equal class in a view.
    pub struct SemanticArea {
        /// The class.
        class: String,
        /// Number of pixels.
        pixels: u32 ["px"],
        /// Column of the centre; in a full panorama from 0 to the width, as it may lie across the seam.
        u: f32 ["px"],
        /// Row of the centre.
        v: f32 ["px"],
        /// Half the longer axis of the ellipse with the area's second moments.
        major_px: f32 ["px"],
        /// Half the shorter axis.
        minor_px: f32 ["px"],
        /// Direction of the longer axis, from the image's x axis toward y, `(-π/2, π/2]`.
        orientation_rad: f32 ["rad"],
        /// `sqrt(1 - minor²/major²)`: 0 for a circle, near 1 for a line.
        eccentricity: f32,
    }
}

record! {
    /// Two areas that touch.
    pub struct SemanticEdge {
        /// Index of one area; the smaller one.
        a: u16,
        /// Index of the other area.
        b: u16,
        /// Pairs of neighbouring pixels (four neighbours) across their common boundary.
        boundary_px: u32 ["px"],
    }
}

record! {
    /// Areas and which of them touch.
    pub struct SemanticGraph {
        /// Width of the view.
        width: u32 ["px"],
        /// Height of the view.
        height: u32 ["px"],
        /// True where the last column is next to the first, as the calibration says.
        wraps: bool,
        /// The angle from the left edge of the image to the right one along its middle row; null without a calibration, or
        /// where the lens sees nothing at an edge.
        field_of_view_rad: Option<f32> ["rad"],
        /// The areas, by class in the order of the class list, the largest first.
        areas: Vec<SemanticArea>,
        /// The edges, ordered by a and b.
        edges: Vec<SemanticEdge>,
    }
}

record! {
    /// One view of a place, described by the graph of what is seen.
    #[layer("views", key(site, session, stamp, camera))]
    pub struct View {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// The view's name: `session/camera/stamp`, the stamp in ns.
        view: String,
        /// What is seen.
        graph: SemanticGraph,
        /// The camera in the frame of the poses that the plan gives: the map's, or the odometry's of each session; null
        /// where there are none around the instant, or nothing says where the camera is mounted.
        map_from_view: Option<Pose>,
        /// How far away things are: the range image of the same camera and instant, in the log; null where there is none.
        depth: Option<ImageRef>,
    }
}

record! {
    /// How many areas of a class a view has.
    pub struct ClassCount {
        /// The class.
        class: String,
        /// Areas; at least 1.
        areas: u16,
    }
}

record! {
    /// One leaf of the class index: views with equal content.
    #[layer("class_index", key(site, leaf))]
    pub struct ClassLeaf {
        /// Site of the views.
        site: String,
        /// Leaves are in the order of the index: by which classes are present, then by how many areas of each.
        leaf: u32,
        /// The classes present, by name; those that are not listed are absent.
        counts: Vec<ClassCount>,
        /// The views, by name.
        views: Vec<String>,
    }
}

record! {
    /// Views in which an area of one class is in a relation to an area of another.
    #[layer("relation_index", key(site, class, relation, other))]
    pub struct RelatedViews {
        /// Site of the views.
        site: String,
        /// The first class.
        class: String,
        /// Where the first is from the second, or that they touch: the words of `related`.
        relation: String,
        /// The second class.
        other: String,
        /// One bit for each of the site's views in the order of their names (by bytes): view n is bit n modulo 8 of byte
        /// n / 8, the lowest first; 1 where it is so.
        views: Bytes,
        /// Digest of those names, as an index of other views, however many they are, says nothing of these.
        names: String,
    }
}

record! {
    /// A view of the map that a query view may show, the best first.
    #[layer("relocations", key(site, session, stamp, camera, rank))]
    pub struct Relocation {
        /// Site of the map.
        site: String,
        /// Session of the query.
        session: String,
        /// Exposure instant of the query.
        stamp: Stamp ["ns"],
        /// Camera of the query.
        camera: String,
        /// The query's view.
        view: String,
        /// Counted from 0, the best first.
        rank: u32,
        /// Session of the map's view.
        map_session: String,
        /// Exposure instant of the map's view.
        map_stamp: Stamp ["ns"],
        /// Camera of the map's view.
        map_camera: String,
        /// The map's view.
        map_view: String,
        /// From 0 (nothing in common) to 1 (the same): of graphs, how much the query's areas are matched, by their sizes
        /// and by how small the differences are; of words, the L1 score.
        score: f64,
        /// Of graphs, σ = exp(1 - N/Nm) with N areas in the query and Nm matched, 1 at best and 0 without a match
        /// (paper 3); of words, the score again.
        similarity: f64,
        /// By how much the query looks farther to the left than the map's view, counter-clockwise seen from above, in
        /// [-π, π); null of words, which do not know it.
        yaw_rad: Option<f64> ["rad"],
        /// Probability that this view shows the query's place, which is as likely mapped as not: what
        /// `relocation_calibrations` says of the map's drive; null but for the first, where that says nothing or where the
        /// view was taken is not known, and of words.
        certainty: Option<f64>,
    }
}

record! {
    /// What it is worth that a view of a drive is found.
    #[layer("relocation_calibrations", key(site, session, camera))]
    pub struct RelocationCalibration {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Camera that took the views.
        camera: String,
        /// Views no farther apart show one place, and those farther than twice as much two.
        within_m: f64 ["m"],
        /// Views of which it is known where they were taken.
        views: u32,
        /// Those that were looked for in their own drive: 0 where none has a view of its place and one of another to be
        /// compared with.
        queries: u32,
        /// Share of them that were found where they were taken; null without any.
        recall: Option<f64>,
        /// The distinctness of a hit (1 less the score of the best view of another place, as a share of the hit's) that is
        /// as likely right as wrong; null where distinctness tells nothing.
        middle: Option<f64>,
        /// Change of the logarithm of the odds with the distinctness; null with `middle`.
        slope: Option<f64>,
    }
}
