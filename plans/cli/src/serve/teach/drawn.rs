//! People on whole images: who was said to be in one, and who is drawn there because the detector missed them.

use std::collections::BTreeMap;

use evermap_catalog::PERSON;
use evermap_schemas::Fault;
use evermap_schemas::layers::{PersonQuestion, PlacedLabel};

use super::painting::Canvas;
use super::people::{answers, shown_by};
use super::taught_site::TaughtSite;
use crate::annotate::features::DrawnFeature;
use crate::annotate::known::KnownLabels;
use crate::annotate::mapped_image::{MappedImage, PixelBox, same};
use crate::annotate::person_images::CORNER;
use crate::annotate::state::image_of;

/// Boxes that are said at once, at most.
const MOST_BOXES: usize = 100;
/// Who stands farther than this from where they stood when the map learnt of them is said anew, m.
const MOVED_M: f64 = 1e-3;

/// What was said of people in an image.
pub struct PeopleOnImage {
    /// The version that is looked at.
    pub version: u64,
    /// Counts what was said.
    pub revision: u64,
    /// How many answers about people, of all images, the version has not learnt from.
    pub waiting: usize,
    /// The labels that are tied to the image, by name, each with the box around who is meant; `None` where the image does not
    /// show them.
    pub said: Vec<(PlacedLabel, Option<PixelBox>)>,
}

impl TaughtSite {
    pub(super) fn on_image(&self, canvas: &Canvas<'_>) -> PeopleOnImage {
        let seen = MappedImage::new(canvas.image, canvas.size, (&self.state, self.plane_m)).ok();
        let labels = self.state.labels.rows().iter();
        let here = labels
            .filter(|label| is_answer(label) && image_of(label).as_ref() == Some(canvas.image));
        let around = |label: &PlacedLabel| {
            let asked = self.people.iter().find(|one| answers(label, one));
            let stands = || {
                let at = &label.anchor.as_ref()?.vehicle_from_label;
                seen.as_ref()?.around([at.x, at.y])
            };
            asked.and_then(bounds).or_else(stands)
        };
        PeopleOnImage {
            version: self.state.version,
            revision: self.revision,
            waiting: self.waiting(),
            said: here.map(|label| (label.clone(), around(label))).collect(),
        }
    }

    /// The features that say what boxes on an image mean, all of them, or none. A box around who is asked about says that
    /// they are a person; any other that somebody was missed.
    pub(super) fn boxed(
        &self,
        canvas: &Canvas<'_>,
        boxes: &[PixelBox],
    ) -> Result<Vec<DrawnFeature>, Fault> {
        if boxes.is_empty() || boxes.len() > MOST_BOXES {
            let found = boxes.len();
            return Err(refused(format!(
                "expected 1 to {MOST_BOXES} boxes, found {found}"
            )));
        }
        let seen = MappedImage::new(canvas.image, canvas.size, (&self.state, self.plane_m));
        let seen = seen.map_err(|reason| refused(reason.to_owned()))?;
        let asked = self.people.iter();
        let asked: Vec<&PersonQuestion> =
            asked.filter(|one| shown_by(one) == *canvas.image).collect();
        let feature = |(number, drawn): (usize, &PixelBox)| -> Result<DrawnFeature, Fault> {
            let place = format!("box {number}");
            let refused = |text: &str| refused(format!("{place}: {text}"));
            within(drawn, canvas.size).map_err(|text| refused(&text))?;
            let (standing, at) = match meant(&asked, drawn) {
                Some(one) => ("accepted", [one.x, one.y]),
                None => ("drawn", seen.standing(drawn).map_err(refused)?),
            };
            Ok(seen.feature(place.clone(), standing, at))
        };
        boxes.iter().enumerate().map(feature).collect()
    }

    /// How many answers about people the version has not learnt from.
    pub(super) fn waiting(&self) -> usize {
        waiting(&self.state.labels, &self.learnt)
    }
}

fn refused(text: String) -> Fault {
    Fault::user(text).next("nothing was saved")
}

/// Whether a label says who is a person in an image, or who is none.
pub(super) fn is_answer(label: &PlacedLabel) -> bool {
    label.kind == PERSON && image_of(label).is_some()
}

/// How many answers are not what was learnt from, by name: new ones, others, and those that are gone.
fn waiting(now: &KnownLabels, learnt: &BTreeMap<String, PlacedLabel>) -> usize {
    let is_learnt = |label: &PlacedLabel| {
        let known = learnt.get(&label.label);
        known.is_some_and(|known| says_the_same(label, known))
    };
    let anew = now.rows().iter().filter(|label| is_answer(label));
    let anew = anew.filter(|label| !is_learnt(label)).count();
    let is_gone = |name: &&String| !now.get(name).is_some_and(is_answer);
    anew + learnt.keys().filter(is_gone).count()
}

fn says_the_same(label: &PlacedLabel, other: &PlacedLabel) -> bool {
    let place = |of: &PlacedLabel| {
        let at = of.anchor.as_ref().map(|anchor| &anchor.vehicle_from_label);
        at.map(|at| [at.x, at.y])
    };
    let apart_m = place(label)
        .zip(place(other))
        .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
    label.standing == other.standing
        && image_of(label) == image_of(other)
        && apart_m.is_some_and(|apart_m| apart_m <= MOVED_M)
}

/// Who is asked about around whom a box is drawn.
fn meant<'q>(asked: &[&'q PersonQuestion], drawn: &PixelBox) -> Option<&'q PersonQuestion> {
    let alike = asked
        .iter()
        .filter_map(|one| Some((same(&bounds(one)?, drawn)?, *one)));
    let best = alike.max_by(|a, b| a.0.total_cmp(&b.0));
    best.map(|(_, one)| one)
}

/// The box around who is asked about; `None` where the layer has no rectangle.
fn bounds(question: &PersonQuestion) -> Option<PixelBox> {
    let rectangle = PixelBox::try_from(question.rectangle.as_slice()).ok()?;
    Some(rectangle.map(|at| at + CORNER))
}

/// # Errors
/// In words, for a box without a size, or beyond the image.
fn within(drawn: &PixelBox, [width, height]: [u32; 2]) -> Result<(), String> {
    let [left, top, right, bottom] = *drawn;
    let has_size = left < right && top < bottom;
    if !has_size {
        return Err(format!(
            "expected a box whose right is beyond its left, and its bottom below its top, found {drawn:?}"
        ));
    }
    let is_inside =
        left.min(top) >= 0.0 && right <= f64::from(width) && bottom <= f64::from(height);
    match is_inside {
        true => Ok(()),
        false => Err(format!(
            "expected a box within the image, {width} x {height} px, found {drawn:?}"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::serve::teach::people::tests::{label, question};

    #[test]
    fn a_box_has_a_size_and_is_within_its_image() {
        let told = |drawn: PixelBox| within(&drawn, [256, 83]).err().unwrap_or_default();
        assert_eq!(told([0.0, 0.0, 256.0, 83.0]), "");
        assert_eq!(told([9.5, 1.0, 10.0, 2.0]), "");
        for none in [
            [9.0, 1.0, 9.0, 5.0],
            [9.0, 5.0, 12.0, 5.0],
            [12.0, 1.0, 9.0, 5.0],
            [f64::NAN, 1.0, 9.0, 5.0],
        ] {
            let told = told(none);
            assert!(
                told.starts_with("expected a box whose right is beyond"),
                "{told}"
            );
        }
        for beyond in [
            [-0.1, 1.0, 9.0, 5.0],
            [1.0, -3.0, 9.0, 5.0],
            [1.0, 1.0, 257.0, 5.0],
            [1.0, 1.0, 9.0, f64::INFINITY],
        ] {
            let told = told(beyond);
            assert!(
                told.starts_with("expected a box within the image, 256 x 83 px"),
                "{told}"
            );
        }
    }

    #[test]
    fn a_box_means_who_is_asked_about_where_it_is_most_alike() {
        let of = |x: f64, rectangle: [f64; 4]| PersonQuestion {
            rectangle: rectangle.to_vec(),
            ..question(5, x)
        };
        let near = of(2.0, [9.5, 19.5, 29.5, 79.5]);
        let far = of(6.0, [11.5, 19.5, 31.5, 79.5]);
        let torn = PersonQuestion {
            rectangle: vec![1.0],
            ..question(5, 8.0)
        };
        let asked = [&near, &torn, &far];
        let meant_at = |drawn: PixelBox| meant(&asked, &drawn).map(|one| one.x);
        assert_eq!(meant_at([13.0, 22.0, 31.0, 78.0]), Some(6.0));
        assert_eq!(meant_at([10.0, 20.0, 30.0, 80.0]), Some(2.0));
        assert_eq!(meant_at([40.0, 20.0, 60.0, 80.0]), None);
    }

    #[test]
    fn answers_wait_until_a_version_has_learnt_them_as_they_are() {
        let by_name = |labels: &[PlacedLabel]| -> BTreeMap<String, PlacedLabel> {
            let named = labels.iter().map(|one| (one.label.clone(), one.clone()));
            named.collect()
        };
        let one = label("one", Some((5, 2.0)));
        let two = label("two", Some((6, 3.0)));
        // What lies on the ground is no answer about an image, and another kind is none about people.
        let ground = label("ground", None);
        let other = PlacedLabel {
            kind: "crossing".into(),
            ..label("other", Some((5, 2.0)))
        };
        let now: KnownLabels = [one.clone(), two.clone(), ground, other]
            .into_iter()
            .collect();
        assert_eq!(waiting(&now, &BTreeMap::new()), 2);
        assert_eq!(waiting(&now, &by_name(&[one.clone(), two.clone()])), 0);
        let turned = PlacedLabel {
            standing: "accepted".into(),
            ..one.clone()
        };
        assert_eq!(waiting(&now, &by_name(&[turned, two.clone()])), 1);
        let moved = label("two", Some((6, 3.1)));
        assert_eq!(waiting(&now, &by_name(&[one.clone(), moved])), 1);
        let elsewhere = label("two", Some((7, 3.0)));
        assert_eq!(waiting(&now, &by_name(&[one.clone(), elsewhere])), 1);
        // Who was learnt and taken back.
        let gone = label("gone", Some((5, 4.0)));
        assert_eq!(waiting(&now, &by_name(&[one, two, gone])), 1);
    }
}
