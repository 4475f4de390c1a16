//! People: where they were seen, what was learnt of them, how often anybody looked, and what that means for how fast to drive.

use crate::{Stamp, Wkb, record};

record! {
    /// Somebody whom an image may show, as a detector has it that nobody here taught.
    #[layer("person_hypotheses", key(site, session, stamp, camera, person))]
    pub struct PersonHypothesis {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant of the image.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// Counted from 0 within the image, the likeliest first.
        person: u32,
        /// Where the feet are on the plane that the vehicle stands on.
        x: f64 ["m", "vehicle"],
        /// Where the feet are.
        y: f64 ["m", "vehicle"],
        /// Height of that plane.
        z: f64 ["m", "vehicle"],
        /// Variance of `x`.
        var_x_m2: f64 ["m²", "vehicle"],
        /// Covariance of `x` and `y`.
        cov_xy_m2: f64 ["m²", "vehicle"],
        /// Variance of `y`.
        var_y_m2: f64 ["m²", "vehicle"],
        /// Distance from the camera along the ground.
        range_m: f64 ["m"],
        /// Rectangle of the image around the person: least column and row, largest column and row; (0, 0) is the centre of
        /// the first pixel.
        rectangle: Vec<f64> ["px", "image"],
        /// Score of the detector's window.
        score: f64,
        /// How probably it is a person, before anybody taught.
        probability: f64,
        /// What the window shows, in numbers that mean the same for all windows.
        description: Vec<f32>,
    }
}

record! {
    /// What somebody said of a window of an image: that it shows a person, or that it does not.
    #[layer("person_examples", key(site, session, stamp, camera, label))]
    pub struct PersonExample {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant of the image.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// The label that says so.
        label: String,
        /// Its standing: `drawn` or `accepted` for a person, `rejected` for what is none.
        standing: String,
        /// Where the feet of who is meant are on the plane that the vehicle stands on.
        x: f64 ["m", "vehicle"],
        /// Where the feet are.
        y: f64 ["m", "vehicle"],
        /// Distance from the camera along the ground.
        range_m: f64 ["m"],
        /// How probably it is a person, before anybody taught.
        probability: f64,
        /// What the window shows, as `person_hypotheses` has it.
        description: Vec<f32>,
    }
}

record! {
    /// How answers differ from what an untaught detector of people foretells, by what windows show.
    #[layer("person_models", key(site))]
    pub struct PersonModel {
        /// Site whose answers it was learnt from.
        site: String,
        /// Windows of which somebody said that they show a person.
        accepted: u32,
        /// Windows of which somebody said that they show none.
        rejected: u32,
        /// Mean of the linear function's weights, one for each number of a description.
        weights: Vec<f64>,
        /// Variance of each weight before any answer.
        scale: f64,
        /// Variance of the noise of an answer.
        noise: f64,
        /// A root of the weights' covariance, row by row.
        spread: Vec<f32>,
    }
}

record! {
    /// A person that an image shows.
    #[layer("people", key(site, session, stamp, camera, person))]
    pub struct Person {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant of the image.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// Its number among those of the image in `person_hypotheses`.
        person: u32,
        /// Where the feet are on the plane that the vehicle stands on.
        x: f64 ["m", "vehicle"],
        /// Where the feet are.
        y: f64 ["m", "vehicle"],
        /// Height of that plane.
        z: f64 ["m", "vehicle"],
        /// Variance of `x`.
        var_x_m2: f64 ["m²", "vehicle"],
        /// Covariance of `x` and `y`.
        cov_xy_m2: f64 ["m²", "vehicle"],
        /// Variance of `y`.
        var_y_m2: f64 ["m²", "vehicle"],
        /// Distance from the camera along the ground.
        range_m: f64 ["m"],
        /// Rectangle of the image around the person: least column and row, largest column and row; (0, 0) is the centre of
        /// the first pixel.
        rectangle: Vec<f64> ["px", "image"],
        /// Score of the detector's window.
        score: f64,
        /// Mean of the answer to whether it is one: 1 for a person, -1 for none; where much speaks for it, beyond.
        mean: f64,
        /// Variance of the mean; null where nobody has taught yet.
        variance: Option<f64>,
        /// How probably it is a person.
        probability: f64,
    }
}

record! {
    /// Somebody whom an image may show and who is worth asking about.
    #[layer("person_questions", key(site, question))]
    pub struct PersonQuestion {
        /// Site of the map.
        site: String,
        /// Counted from 1: which to ask about first.
        question: u32,
        /// Session that was driven.
        session: String,
        /// Exposure instant of the image.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// Its number among those of the image in `person_hypotheses`.
        person: u32,
        /// Where the feet are on the plane that the vehicle stands on.
        x: f64 ["m", "vehicle"],
        /// Where the feet are.
        y: f64 ["m", "vehicle"],
        /// Distance from the camera along the ground.
        range_m: f64 ["m"],
        /// Rectangle of the image around the person, as `person_hypotheses` has it.
        rectangle: Vec<f64> ["px", "image"],
        /// Mean of the answer: 1 for a person, -1 for none.
        mean: f64,
        /// Variance of the mean.
        variance: f64,
        /// How probably it is a person.
        probability: f64,
        /// What the answer would teach when those before are given: change of the probabilities of all, squares added up.
        gain: f64,
        /// Why it is asked: `uncertain`, or `unlike every label so far`, whatever it is held for.
        reason: String,
    }
}

record! {
    /// Where on the ground a person stood when an image was taken.
    #[layer("people_on_ground", key(site, session, stamp, camera, person))]
    pub struct PersonOnGround {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant of the image.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// Counted from 0 within the image.
        person: u32,
        /// Where the feet are.
        x: f64 ["m", "map"],
        /// Where the feet are.
        y: f64 ["m", "map"],
        /// Where the feet are.
        z: f64 ["m", "map"],
        /// Variance of `x`.
        var_x_m2: f64 ["m²", "map"],
        /// Covariance of `x` and `y`.
        cov_xy_m2: f64 ["m²", "map"],
        /// Variance of `y`.
        var_y_m2: f64 ["m²", "map"],
        /// Distance from the camera along the ground.
        range_m: f64 ["m"],
        /// How probably there is a person at all: 1 for what is known, less for what a detector thinks.
        probability: f64,
    }
}

record! {
    /// How often the cameras of a session looked at a cell of the ground.
    #[layer("exposure", key(site, session, column, row))]
    pub struct Exposure {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Column of the cell: cell i covers `[i, i + 1) * cell_m` along the map's x axis.
        column: i32 ["", "map"],
        /// Row of the cell: cell j covers `[j, j + 1) * cell_m` along the map's y axis.
        row: i32 ["", "map"],
        /// Side of a cell.
        cell_m: f64 ["m"],
        /// Length of a look: time is cut into such pieces, counted from the stamp 0.
        look_s: f64 ["s"],
        /// Looks in which at least one image would have shown a person in the cell.
        looks: u32,
        /// Stamp of the first image that did.
        first_stamp: Stamp ["ns"],
    }
}

record! {
    /// How probably a person is on ground of a kind.
    pub struct GroundPrior {
        /// A kind of label, `lane`, or `other`.
        kind: String,
        /// Probability that somebody is in one cell of such ground in one look, as expected before any visit.
        expected: f64,
        /// The same, as the visits so far have it.
        probability: f64,
    }
}

record! {
    /// What danger maps of a site are made with, as the visits so far teach it, and how well they foretold each next visit.
    #[layer("danger_settings", key(site))]
    pub struct DangerSetting {
        /// Site of the map.
        site: String,
        /// Visits that looked at the ground.
        visits: u32,
        /// Visits in which people were found.
        visits_with_people: u32,
        /// What is known of ground by its kind, ordered by kind.
        priors: Vec<GroundPrior>,
        /// Weight of what is known of a cell by its kind, in looks.
        prior_looks: f64,
        /// Weight of the tie between two neighbouring cells, in looks.
        tie_looks: f64,
        /// Looks at cells in the visits that were foretold: all after the first in which people were found.
        foretold_looks: f64,
        /// Logarithm of the likelihood of these visits, each foretold from those before it; null where there is none.
        log_likelihood: Option<f64> ["nat"],
        /// The same, foretold by what was expected of each kind of ground before any visit; null where that is.
        log_likelihood_of_expected: Option<f64> ["nat"],
        /// The same, foretold by the rate of each kind of ground in the visits before; null where that is.
        log_likelihood_of_kinds: Option<f64> ["nat"],
        /// The same, foretold by counting people in each cell alone; null where that is.
        log_likelihood_of_counts: Option<f64> ["nat"],
    }
}

record! {
    /// How probably a person is in a cell of the ground.
    #[layer("danger_map", key(site, column, row))]
    pub struct Danger {
        /// Site of the map.
        site: String,
        /// Column of the cell: cell i covers `[i, i + 1) * cell_m` along the map's x axis.
        column: i32 ["", "map"],
        /// Row of the cell: cell j covers `[j, j + 1) * cell_m` along the map's y axis.
        row: i32 ["", "map"],
        /// Side of a cell.
        cell_m: f64 ["m"],
        /// Middle of the cell.
        x: f64 ["m", "map"],
        /// Middle of the cell.
        y: f64 ["m", "map"],
        /// Kind of ground: of the labels and lanes that the middle is in, the one where people are expected most; else `other`.
        ground: String,
        /// Looks at the cell, in all visits.
        looks: f64,
        /// Looks in which somebody was there, in all visits; a sum of probabilities.
        people: f64,
        /// Probability that somebody is in the cell in one look, as the kind of ground alone has it.
        prior: f64,
        /// Probability that somebody is in the cell in one look.
        danger: f64,
    }
}

record! {
    /// How fast to drive over a cell of the ground.
    #[layer("speed_map", key(site, column, row))]
    pub struct SpeedCell {
        /// Site of the map.
        site: String,
        /// Column of the cell: cell i covers `[i, i + 1) * cell_m` along the map's x axis.
        column: i32 ["", "map"],
        /// Row of the cell: cell j covers `[j, j + 1) * cell_m` along the map's y axis.
        row: i32 ["", "map"],
        /// Side of a cell.
        cell_m: f64 ["m"],
        /// Middle of the cell.
        x: f64 ["m", "map"],
        /// Middle of the cell.
        y: f64 ["m", "map"],
        /// Probability that somebody is in the cell in one look.
        danger: f64,
        /// Recommended speed.
        speed_mps: f64 ["m/s"],
        /// The highest speed that is recommended anywhere.
        max_mps: f64 ["m/s"],
    }
}

record! {
    /// How fast to drive along a lane.
    #[layer("lane_speeds", key(site, lane), geometry(geometry))]
    pub struct LaneSpeed {
        /// Site of the map.
        site: String,
        /// The lane's number within the site.
        lane: u32,
        /// How it was driven: `forward`, `backward`, `both` or `unknown`.
        direction: String,
        /// Length along the centre line.
        length_m: f64 ["m"],
        /// Width.
        width_m: f64 ["m"],
        /// Cells of the speed map that are on the lane.
        cells: u32,
        /// Probability that somebody is in a cell of the lane in one look: the mean over its cells; null where it has none.
        danger: Option<f64>,
        /// The lowest recommended speed on the lane; null where it has no cell.
        speed_mps: Option<f64> ["m/s"],
        /// The mean recommended speed over its cells; null where it has none.
        mean_mps: Option<f64> ["m/s"],
        /// The centre line as a line string.
        geometry: Wkb ["m", "map"],
    }
}
