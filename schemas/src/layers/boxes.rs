//! Boxes on the ground that look alike: what was learnt of them, where others may be, parking spaces.

use crate::{Bytes, Pose, Wkb, record};

record! {
    /// What one tile of the overhead image shows as gradients, of equal strength wherever there is structure: all that boxes
    /// are described by.
    #[layer("overhead_gradients", key(site, tile_x, tile_y))]
    pub struct OverheadGradients {
        /// Site of the map.
        site: String,
        /// Column of the tile, as in `overhead_tiles` at zoom 0.
        tile_x: i32 ["", "map"],
        /// Row of the tile, likewise.
        tile_y: i32 ["", "map"],
        /// Side of a cell.
        cell_m: f64 ["m"],
        /// Digest of all that the gradients follow from: the tile's pixels, those of its neighbours as far as contrast is
        /// levelled with them, and how gradients are made.
        content: String,
        /// A PNG of two channels, the first row the northernmost. The first channel is strength in steps of 8/254 of the mean
        /// around (255 where nothing was seen), the second direction from east in 256ths of half a turn, anticlockwise.
        png: Bytes,
    }
}

record! {
    /// What was learnt of one kind of box on the ground from the boxes that people drew, accepted and rejected.
    #[layer("box_models", key(site, kind))]
    pub struct BoxModel {
        /// Site that it was learnt on.
        site: String,
        /// What the boxes mark.
        kind: String,
        /// Boxes that were drawn or accepted, where the overhead image shows anything.
        accepted: u32,
        /// Boxes that were rejected, likewise.
        rejected: u32,
        /// Length and width of such boxes, for each size that was drawn.
        sizes_m: Vec<[f64; 2]> ["m"],
        /// Mean height of the boxes in the map.
        height_m: f64 ["m", "map"],
        /// Mean of the linear function's weights, one for each number of a description.
        weights: Vec<f64>,
        /// Variance of each weight before any answer.
        scale: f64,
        /// Variance of the noise of an answer.
        noise: f64,
        /// A root of the weights' covariance, row by row.
        spread: Vec<f32>,
        /// Mean that is as likely one of the kind as not.
        middle: f64,
        /// Change of the logarithm of the odds with the mean.
        slope: f64,
        /// What such boxes show in detail: gradients with their direction doubled, along the length and then across.
        template: Vec<[f32; 2]>,
    }
}

record! {
    /// A box on the ground that may be one of a kind, as nobody has said yet.
    #[layer("box_hypotheses", key(site, kind, hypothesis), geometry(geometry))]
    pub struct BoxHypothesis {
        /// Site of the map.
        site: String,
        /// What it may mark.
        kind: String,
        /// Counted from 0, the likeliest first.
        hypothesis: u32,
        /// Its frame in the map: the middle of the box; x lies along its length, in the direction that it looks.
        map_from_label: Pose ["", "map"],
        /// Length of the box.
        length_m: f64 ["m"],
        /// Width of the box.
        width_m: f64 ["m"],
        /// Mean of the answer: 1 for one of the kind, -1 for none.
        mean: f64,
        /// Variance of the mean.
        variance: f64,
        /// Probability that it is one.
        probability: f64,
        /// Counted from 1: which to ask about first; null where others are more worth asking about.
        question: Option<u32>,
        /// What the answer would teach when those before are given: change of the probabilities of all, squares added up; null
        /// where `question` is.
        gain: Option<f64>,
        /// Why it is asked: `uncertain`, or `unlike every label so far`, whatever it is held for; null where `question` is.
        reason: Option<String>,
        /// The box from above.
        geometry: Wkb ["m", "map"],
    }
}

record! {
    /// A parking space: drawn or accepted by a person, or found.
    #[layer("parking_spaces", key(site, space), geometry(geometry))]
    pub struct ParkingSpace {
        /// Site of the map.
        site: String,
        /// Its number, counted from 1, row by row.
        space: u32,
        /// Its row, counted from 1: spaces side by side, or one behind the other.
        row: u32,
        /// Its place in the row, counted from 1.
        place: u32,
        /// `drawn` or `accepted` by a person, or `found`.
        standing: String,
        /// The label, where a person said so; null where it was found.
        label: Option<String>,
        /// Probability that it is one; 1 where a person said so.
        probability: f64,
        /// Its frame in the map: the middle of the space; x lies along its length, away from the lane that it is entered from.
        map_from_space: Pose ["", "map"],
        /// Length of the space.
        length_m: f64 ["m"],
        /// Width of the space.
        width_m: f64 ["m"],
        /// The lane that it is entered from: the nearest one; null where none is near.
        lane: Option<u32>,
        /// From the middle of the space to that lane; null where there is none.
        lane_distance_m: Option<f64> ["m"],
        /// The space from above.
        geometry: Wkb ["m", "map"],
    }
}

record! {
    /// Whether a parking space was free during a session.
    #[layer("space_occupancy", key(site, session, space))]
    pub struct SpaceOccupancy {
        /// Site of the map.
        site: String,
        /// Session that drove past.
        session: String,
        /// The space's number, as `parking_spaces` of this version has it.
        space: u32,
        /// `free`, `taken`, or `unseen` where not enough was seen of it to say.
        state: String,
        /// Probability that it was taken; null where unseen.
        taken: Option<f64>,
        /// Points that were seen to stand on it.
        standing: u32,
        /// Part of it that was looked at, 0 to 1.
        looked: f64,
    }
}
