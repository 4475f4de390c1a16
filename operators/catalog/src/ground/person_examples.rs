#![doc = include_str!("person_examples.md")]

use std::collections::BTreeMap;

use evermap_algorithms::ground::people::PeopleParams;
use evermap_algorithms::ground::people::search::{Person, people, person_at};
use evermap_contract::{Emit, Fault, Operator, Pixels, Port, Reach, Reason, Sides, Work};
use evermap_schemas::layers::PersonExample;
use evermap_schemas::roles::Anchor;
use evermap_schemas::{ImageRef, Stamp, record};

use crate::inputs::painting::ImageKey;
use crate::inputs::people::{self as looking, Looking, PERSON, REJECTED, Room, Sight};
use crate::inputs::rig::{self, OfVehicle};

/// See the module's page.
pub struct PersonExamples;

/// A label is about the hypothesis that is nearest to it, no farther away than this (m): a person 8 m away is placed to half
/// a metre along the line of sight.
const WITHIN_M: f64 = 1.0;
/// Why labels of an image that is not there are left out.
const MISSING: &str = "label of an image that the map does not have";

record! {
    /// A label, as far as it may say something of a person in an image.
    #[layer("placed_labels", key(site, label))]
    pub struct PersonLabel {
        /// Site of the map.
        site: String,
        /// The label.
        label: String,
        /// What it marks.
        kind: String,
        /// `drawn`, `accepted`, or `rejected`: there is no such thing here.
        standing: String,
        /// When the latest of it was said.
        said: Stamp ["ns"],
        /// The vehicle pose that it is tied to; null where there is none.
        anchor: Option<Anchor>,
    }
}

record! {
    /// An image of which something was said, as labels name it.
    #[layer("answered_images", key(site, session, stamp, camera))]
    pub struct AnsweredImage {
        /// Site that was driven.
        site: String,
        /// Session that was driven.
        session: String,
        /// Instant of the keyframe.
        stamp: Stamp ["ns"],
        /// Camera that took it.
        camera: String,
        /// Where the pixels are; null where the map has no such image.
        image: Option<ImageRef>,
    }
}

impl Operator for PersonExamples {
    const NAME: &'static str = "person_examples";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("person_examples.md");
    type Params = OfVehicle<PeopleParams>;
    type Output = PersonExample;

    fn work() -> Work<Self::Params> {
        let images = Port::session::<AnsweredImage>("images").pixels("image");
        let mut sides = vec![Port::site::<PersonLabel>("labels").needed()];
        sides.extend(rig::ports(Reach::Session));
        Work::batches(images, sides, Answers::new, Answers::of_images)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        looking::check(&params.options)
    }
}

/// Answers about people, by the image that they are about.
struct Answers {
    looking: Looking,
    said: BTreeMap<ImageKey, Vec<Answer>>,
}

/// What was said of somebody at a point of the vehicle frame (m).
struct Answer {
    label: String,
    standing: String,
    at: [f64; 2],
}

impl Answers {
    fn new(params: &OfVehicle<PeopleParams>, sides: &Sides) -> Result<Self, Fault> {
        let mut labels: Vec<PersonLabel> = sides.rows("labels")?;
        labels.retain(|label| label.kind == PERSON);
        labels.sort_by(|a, b| (a.said, &a.label).cmp(&(b.said, &b.label)));
        let mut said = BTreeMap::<ImageKey, Vec<Answer>>::new();
        for label in labels {
            let Some(Anchor {
                session,
                stamp,
                camera: Some(camera),
                vehicle_from_label,
            }) = label.anchor
            else {
                continue;
            };
            let of_image = said.entry((session, stamp, camera)).or_default();
            of_image.push(Answer {
                label: label.label,
                standing: label.standing,
                at: [vehicle_from_label.x, vehicle_from_label.y],
            });
        }
        Ok(Self {
            looking: Looking::new(params, sides)?,
            said,
        })
    }

    fn of_images(
        &self,
        images: Vec<AnsweredImage>,
        pixels: &Pixels,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        let mut room = Room::default();
        for (row, image) in images.into_iter().enumerate() {
            let key = (image.session.clone(), image.stamp, image.camera.clone());
            let Some(said) = self.said.get(&key) else {
                continue;
            };
            let Some(reference) = &image.image else {
                emit.skip(MISSING, said.len() as u64);
                continue;
            };
            let Some(bytes) = pixels.get(row) else {
                continue;
            };
            let named = (&*image.session, &*image.camera, image.stamp);
            let find = |sight: Sight<'_>| meant(said, sight);
            let meant = self
                .looking
                .at(named, &reference.format, bytes, &mut room, find);
            let meant = match meant {
                Ok(meant) => meant,
                Err(reason) => {
                    emit.skip(reason, said.len() as u64);
                    continue;
                }
            };
            let mut rows = Vec::with_capacity(said.len());
            for (at, answer) in said.iter().enumerate() {
                match example(&image, answer, &meant[at..]) {
                    Ok(row) => rows.push(row),
                    Err(reason) => emit.skip(reason, 1),
                }
            }
            rows.sort_by(|a, b| a.label.cmp(&b.label));
            emit.rows(rows)?;
        }
        Ok(())
    }
}

/// Whom answers mean, in their order: the hypothesis that is nearest, or where none is near and somebody is said to be there,
/// who stands there. `None` where the image shows neither.
fn meant(said: &[Answer], sight: Sight<'_>) -> Vec<Option<Person>> {
    let Sight {
        upright,
        image,
        detector,
        params,
    } = sight;
    let found = people(upright, image, detector, params);
    let whom = |answer: &Answer| {
        let apart_m = |one: &Person| {
            let [x, y] = one.position;
            (x - answer.at[0]).hypot(y - answer.at[1])
        };
        let near = found.iter().filter(|one| apart_m(one) <= WITHIN_M);
        let nearest = near.min_by(|a, b| apart_m(a).total_cmp(&apart_m(b)));
        match nearest {
            Some(one) => Some(one.clone()),
            None if answer.standing == REJECTED => None,
            None => person_at(upright, image, detector, params, answer.at),
        }
    };
    said.iter().map(whom).collect()
}

/// What an answer teaches, given whom it means, and behind that whom later ones mean.
fn example(
    image: &AnsweredImage,
    answer: &Answer,
    meant: &[Option<Person>],
) -> Result<PersonExample, Reason> {
    let Some((Some(one), later)) = meant.split_first() else {
        return Err("label that matches no person found in its image".into());
    };
    let same = |other: &Person| other.position == one.position;
    if later.iter().flatten().any(same) {
        return Err("label replaced by a later one of the same person".into());
    }
    if !["drawn", "accepted", REJECTED].contains(&answer.standing.as_str()) {
        return Err("label was neither drawn nor accepted nor rejected".into());
    }
    Ok(PersonExample {
        site: image.site.clone(),
        session: image.session.clone(),
        stamp: image.stamp,
        camera: image.camera.clone(),
        label: answer.label.clone(),
        standing: answer.standing.clone(),
        x: one.position[0],
        y: one.position[1],
        range_m: one.range_m,
        probability: one.probability,
        description: one.description.clone(),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use evermap_contract::laws::{Split, inputs_of, run};
    use evermap_contract::{Entry, Losses};
    use evermap_schemas::Pose;
    use serde_json::json;

    use super::*;

    /// What somebody said of a person in an image of this camera.
    fn answer(label: &str, camera: &str) -> PersonLabel {
        PersonLabel {
            site: "lot".into(),
            label: label.into(),
            kind: PERSON.into(),
            standing: "accepted".into(),
            said: Stamp(10),
            anchor: Some(Anchor {
                session: "a".into(),
                stamp: Stamp(5),
                camera: Some(camera.into()),
                vehicle_from_label: Pose::IDENTITY,
            }),
        }
    }

    /// An image of this camera, or that there is none.
    fn image(camera: &str, image: Option<ImageRef>) -> AnsweredImage {
        AnsweredImage {
            site: "lot".into(),
            session: "a".into(),
            stamp: Stamp(5),
            camera: camera.into(),
            image,
        }
    }

    #[test]
    fn answers_about_an_image_that_is_not_there_are_counted() {
        let there = ImageRef {
            session: "a".into(),
            length: 1,
            format: "jpeg".into(),
            ..ImageRef::default()
        };
        let images = vec![image("front", Some(there)), image("right", None)];
        let labels = [("one", "right"), ("two", "right"), ("three", "front")];
        let labels = labels.map(|(label, camera)| answer(label, camera)).to_vec();
        let inputs = [inputs_of("images", images), inputs_of("labels", labels)];
        let inputs = inputs.map(Result::unwrap).into_iter().collect();
        let entry = Entry::of::<PersonExamples>();
        let found = run(&entry, &json!({}), &inputs, Split::default()).unwrap();
        assert_eq!(found.rows.num_rows(), 0);
        let mut expected = Losses::default();
        expected.add(MISSING, 2);
        // Who could not fetch an image has counted it.
        assert_eq!(found.losses, expected);
    }
}
