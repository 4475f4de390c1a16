//! People whom images may show: whom to ask about, and where they stand.

use evermap_algorithms::geometry::pose::Pose;
use evermap_catalog::painted::ImageKey;
use evermap_catalog::{ANSWERED_M, PERSON};
use evermap_schemas::layers::{PersonQuestion, PlacedLabel};
use nalgebra::Vector3;

use super::taught_site::TaughtSite;
use crate::annotate::state::image_of;

/// Whom to ask about, as the version that is looked at has it, without those who were answered since.
pub struct People {
    /// Counts what was said.
    pub revision: u64,
    /// The first to ask about first.
    pub asked: Vec<PlacedQuestion>,
    /// How many others there are: of images that the map has no vehicle pose of, where no answer can be held.
    pub unplaced: usize,
    /// How many answers the version has not learnt from.
    pub waiting: usize,
}

/// Somebody to ask about.
pub struct PlacedQuestion {
    /// What is asked.
    pub question: PersonQuestion,
    /// Where they stand, with the vehicle's heading.
    pub map_from_person: evermap_schemas::Pose,
}

impl PlacedQuestion {
    /// The image that may show them.
    pub fn image(&self) -> ImageKey {
        shown_by(&self.question)
    }
}

impl TaughtSite {
    pub(super) fn people(&self) -> People {
        let mut found = People {
            revision: self.revision,
            asked: Vec::new(),
            unplaced: 0,
            waiting: self.waiting(),
        };
        let labels = self.state.labels.rows().iter();
        let said: Vec<&PlacedLabel> = labels.filter(|label| label.kind == PERSON).collect();
        for question in &self.people {
            if said.iter().any(|label| answers(label, question)) {
                continue;
            }
            match self.state.map_from_vehicle(&shown_by(question)) {
                Some(pose) => found.asked.push(PlacedQuestion {
                    question: question.clone(),
                    map_from_person: standing(&pose, question),
                }),
                None => found.unplaced += 1,
            }
        }
        found
    }
}

/// The image that may show who is asked about.
pub(super) fn shown_by(question: &PersonQuestion) -> ImageKey {
    (
        question.session.clone(),
        question.stamp,
        question.camera.clone(),
    )
}

/// Where somebody stands whose image was taken there.
fn standing(map_from_vehicle: &Pose, question: &PersonQuestion) -> evermap_schemas::Pose {
    let vehicle_from_person = Vector3::new(question.x, question.y, 0.0);
    let vehicle_from_person = Pose::new(vehicle_from_person, Pose::identity().rotation);
    let map_from_person = map_from_vehicle.compose(&vehicle_from_person);
    evermap_schemas::Pose::from_array(map_from_person.to_array())
}

/// Whether a label says who it is: of the same image, and of just that place.
pub(super) fn answers(label: &PlacedLabel, question: &PersonQuestion) -> bool {
    let place = label.anchor.as_ref().map(|it| &it.vehicle_from_label);
    let is_there =
        place.is_some_and(|at| (at.x - question.x).hypot(at.y - question.y) <= ANSWERED_M);
    is_there && image_of(label) == Some(shown_by(question))
}

#[cfg(test)]
pub(super) mod tests {
    use evermap_schemas::roles::Anchor;
    use evermap_schemas::{Stamp, Wkb};

    use super::*;

    /// Somebody to ask about, ahead in an image of this instant.
    pub(in crate::serve::teach) fn question(stamp: i64, x: f64) -> PersonQuestion {
        PersonQuestion {
            site: "lot".into(),
            question: 1,
            session: "a".into(),
            stamp: Stamp(stamp),
            camera: "front".into(),
            person: 0,
            x,
            y: 1.0,
            range_m: 3.0,
            rectangle: vec![1.0, 2.0, 3.0, 4.0],
            mean: 0.0,
            variance: 1.0,
            probability: 0.5,
            gain: 0.1,
            reason: "uncertain".into(),
        }
    }

    /// A label that says that somebody is none, tied to the image of this instant, and so far ahead (m) where one is given.
    pub(in crate::serve::teach) fn label(name: &str, image: Option<(i64, f64)>) -> PlacedLabel {
        let anchor = |(stamp, x): (i64, f64)| Anchor {
            session: "a".into(),
            stamp: Stamp(stamp),
            camera: Some("front".into()),
            vehicle_from_label: evermap_schemas::Pose {
                x,
                y: 1.0,
                ..evermap_schemas::Pose::IDENTITY
            },
        };
        PlacedLabel {
            site: "lot".into(),
            label: name.into(),
            kind: PERSON.into(),
            standing: "rejected".into(),
            author: "ada".into(),
            said: Stamp(1),
            placed_by: "pose".into(),
            anchor: image.map(anchor),
            shape: "box".into(),
            map_from_label: evermap_schemas::Pose::IDENTITY,
            length_m: Some(0.4),
            width_m: Some(0.4),
            points: Vec::new(),
            geometry: Wkb::point([0.0; 3]),
        }
    }

    #[test]
    fn an_answer_is_about_who_stands_there_in_that_image() {
        assert!(!answers(&label("one", None), &question(5, 2.0)));
        let mut label = label("one", Some((5, 2.2)));
        assert!(answers(&label, &question(5, 2.0)));
        assert!(!answers(&label, &question(5, 1.8)));
        assert!(!answers(&label, &question(6, 2.0)));
        if let Some(anchor) = &mut label.anchor {
            anchor.camera = None;
        }
        assert!(!answers(&label, &question(5, 2.0)));
    }

    #[test]
    fn somebody_ahead_stands_where_the_vehicle_looks() {
        let vehicle = Pose::from_yaw(10.0, 20.0, std::f64::consts::FRAC_PI_2);
        let found = standing(&vehicle, &question(5, 2.0));
        assert!((found.x - 9.0).abs() < 1e-9 && (found.y - 22.0).abs() < 1e-9);
    }
}
