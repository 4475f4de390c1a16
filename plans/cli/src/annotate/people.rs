//! What people said of somebody in camera images by drawing boxes: who was left is a person, who was removed is none, and who
//! was added was missed.

use std::path::Path;

use evermap_catalog::PERSON;
use evermap_schemas::Fault;

use super::features::DrawnFeature;
use super::mapped_image::{MappedImage, PixelBox, same};
use super::person_images::{AskedBox, PersonImage, PersonImages};
use super::pixels::{Boxes, PictureBox, Pixel, Program};
use super::state::State;
use super::{Losses, read_text};

/// What a file of COCO, CVAT or Label Studio says of the images of a folder that `evermap export --format coco` wrote. What
/// makes no sense is noted and left out; `plane_m` is the height of the ground in the vehicle frame.
///
/// # Errors
/// A user fault for another folder, images of another site, or a file of another form or of other images.
pub fn read(
    file: &Path,
    folder: &Path,
    (state, plane_m): (&State, f64),
    losses: &mut Losses,
) -> Result<Vec<DrawnFeature>, Fault> {
    let images = PersonImages::read(folder)?;
    if let Some(other) = images.images.iter().find(|image| image.site != state.site) {
        let (site, found) = (&state.site, &other.site);
        return Err(Fault::user(format!(
            "expected images of the site {site}, found some of {found}"
        ))
        .at(folder.display()));
    }
    let at = |fault: Fault| fault.at(file.display());
    let text = read_text(file).map_err(at)?;
    let program = Program::of(file, &text).ok_or_else(|| {
        at(Fault::user(
            "expected boxes of COCO, CVAT (XML) or Label Studio (JSON), found none of them",
        ))
    })?;
    let canvases: Vec<_> = images.images.iter().map(PersonImage::canvas).collect();
    let found = program.boxes(file, &text, &canvases, losses).map_err(at)?;
    let drawn = by_image(found, canvases.len(), losses);
    let mut features = Vec::new();
    for (image, drawn) in images.images.iter().zip(drawn) {
        let asked: Vec<&AskedBox> = images.asked(image).collect();
        let said = said(&asked, &drawn);
        features.extend(features_of(image, &said, (state, plane_m), losses));
    }
    Ok(features)
}

/// What is drawn on an image.
#[derive(Debug, Default)]
struct OnImage {
    /// Whether somebody looked at it.
    is_seen: bool,
    /// Whether a shape could not be read: who seems to be gone may be that.
    has_unread: bool,
    people: Vec<PictureBox>,
    /// Boxes of something else. Whether who was asked about there is a person, they do not say.
    others: Vec<PictureBox>,
}

/// What is drawn, by image; boxes of something else than a person are noted.
fn by_image(found: Boxes, images: usize, losses: &mut Losses) -> Vec<OnImage> {
    let on_image = |number: usize| OnImage {
        is_seen: found.seen.contains(&number),
        has_unread: found.unread.contains(&number),
        ..OnImage::default()
    };
    let mut drawn: Vec<OnImage> = (0..images).map(on_image).collect();
    for one in found.boxes {
        let is_person = is_person(one.kind.as_deref());
        if !is_person {
            losses.note("box of something else than a person", &one.place);
        }
        match drawn.get_mut(one.picture) {
            Some(image) if is_person => {
                image.is_seen = true;
                image.people.push(one);
            }
            Some(image) => image.others.push(one),
            None => {}
        }
    }
    drawn
}

/// Whether a box marks a person: where it says nothing else, in capitals or not.
fn is_person(kind: Option<&str>) -> bool {
    kind.is_none_or(|kind| kind.trim().eq_ignore_ascii_case(PERSON))
}

/// What was said of somebody.
#[derive(Debug)]
enum PersonEdit<'a> {
    /// Who was asked about is a person.
    Left(&'a AskedBox),
    /// Who was asked about is none.
    Removed(&'a AskedBox),
    /// Somebody was missed.
    Added(&'a PictureBox),
}

/// What boxes that were drawn on an image say of those whom was asked about, the most alike first. Nothing is said of an image
/// that nobody looked at, and of who has a box of something else that is more alike than any of a person; where a shape was not
/// read, nobody is taken for removed.
fn said<'a>(asked: &[&'a AskedBox], image: &'a OnImage) -> Vec<PersonEdit<'a>> {
    if !image.is_seen {
        return Vec::new();
    }
    let alike = |one: &AskedBox, other: &PictureBox| same(&flat(one.bounds()), &flat(other.bounds));
    // How much a box of something else is like each, where one is.
    let others = asked.iter().map(|one| {
        let others = image.others.iter().filter_map(|other| alike(one, other));
        others.max_by(f64::total_cmp)
    });
    let others: Vec<Option<f64>> = others.collect();
    let drawn = &image.people;
    let mut pairs = Vec::new();
    for (a, one) in asked.iter().enumerate() {
        for (d, other) in drawn.iter().enumerate() {
            let alike = alike(one, other);
            let alike = alike.filter(|alike| others[a].is_none_or(|other| other <= *alike));
            pairs.extend(alike.map(|alike| (alike, a, d)));
        }
    }
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut left, mut meant) = (vec![false; asked.len()], vec![false; drawn.len()]);
    for (_, a, d) in pairs {
        if !left[a] && !meant[d] {
            (left[a], meant[d]) = (true, true);
        }
    }
    let of_asked = asked
        .iter()
        .copied()
        .enumerate()
        .filter_map(|(a, one)| match left[a] {
            true => Some(PersonEdit::Left(one)),
            false if image.has_unread || others[a].is_some() => None,
            false => Some(PersonEdit::Removed(one)),
        });
    let added = drawn.iter().zip(&meant).filter(|(_, meant)| !**meant);
    of_asked
        .chain(added.map(|(one, _)| PersonEdit::Added(one)))
        .collect()
}

fn flat([[left, top], [right, bottom]]: [Pixel; 2]) -> PixelBox {
    [left, top, right, bottom]
}

/// What was said of an image, as features of a map.
fn features_of(
    image: &PersonImage,
    said: &[PersonEdit<'_>],
    map: (&State, f64),
    losses: &mut Losses,
) -> Vec<DrawnFeature> {
    let key = image.key();
    let seen = match MappedImage::new(&key, image.canvas().size, map) {
        Ok(seen) => seen,
        Err(reason) => {
            losses.note(reason, &image.file_name);
            return Vec::new();
        }
    };
    let answer = |asked: &AskedBox, standing: &str| {
        let place = format!("{}, question {}", image.file_name, asked.question);
        seen.feature(place, standing, [asked.x, asked.y])
    };
    let mut features = Vec::new();
    for one in said {
        match one {
            PersonEdit::Left(asked) => features.push(answer(asked, "accepted")),
            PersonEdit::Removed(asked) => features.push(answer(asked, "rejected")),
            PersonEdit::Added(drawn) => {
                let place = format!("{}, {}", image.file_name, drawn.place);
                match seen.standing(&flat(drawn.bounds)) {
                    Ok(at) => features.push(seen.feature(place, "drawn", at)),
                    Err(reason) => losses.note(reason, &place),
                }
            }
        }
    }
    features
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::annotate::person_images::tests::question;
    use serde_json::{Value, json};

    fn drawn(bounds: [Pixel; 2]) -> PictureBox {
        PictureBox {
            place: String::new(),
            kind: None,
            picture: 0,
            bounds,
        }
    }

    #[test]
    fn who_was_left_is_a_person_who_was_removed_none_and_who_was_added_was_missed() {
        let mut images = PersonImages::default();
        let questions = [
            question(1, [9.5, 19.5, 29.5, 79.5]),
            question(2, [11.5, 19.5, 31.5, 79.5]),
            question(3, [59.5, 19.5, 79.5, 79.5]),
        ];
        images.add(([100, 80], "png"), &questions);
        let asked: Vec<&AskedBox> = images.annotations.iter().collect();
        let people = vec![
            // Tighter than the second one was, and nearer to it than to the first.
            drawn([[13.0, 22.0], [31.0, 78.0]]),
            // Beside the third one.
            drawn([[85.0, 20.0], [99.0, 79.0]]),
        ];
        let image = OnImage {
            is_seen: true,
            people,
            ..OnImage::default()
        };
        let told: Vec<String> = said(&asked, &image).iter().map(in_words).collect();
        assert_eq!(told, ["removed 1", "left 2", "removed 3", "added at 85"]);
        let unseen = OnImage {
            is_seen: false,
            ..image
        };
        assert!(said(&asked, &unseen).is_empty());
    }

    fn in_words(one: &PersonEdit<'_>) -> String {
        match one {
            PersonEdit::Left(one) => format!("left {}", one.question),
            PersonEdit::Removed(one) => format!("removed {}", one.question),
            PersonEdit::Added(one) => format!("added at {}", one.bounds[0][0]),
        }
    }

    /// What a file says of somebody at columns 10 to 30, and of somebody whose box is gone, and how much of it is told. The
    /// file is made of the name of the image.
    fn told(name: &str, write: impl Fn(&str) -> String) -> (Vec<String>, u64) {
        let mut images = PersonImages::default();
        let questions = [
            question(1, [9.5, 19.5, 29.5, 79.5]),
            question(2, [59.5, 19.5, 79.5, 79.5]),
        ];
        images.add(([100, 80], "png"), &questions);
        let canvases = [images.images[0].canvas()];
        let (path, text) = (Path::new(name), write(&canvases[0].name));
        let mut losses = Losses::default();
        let program = Program::of(path, &text).unwrap();
        let found = program.boxes(path, &text, &canvases, &mut losses).unwrap();
        let drawn = by_image(found, canvases.len(), &mut losses);
        let asked: Vec<&AskedBox> = images.annotations.iter().collect();
        let said = said(&asked, &drawn[0]).iter().map(in_words).collect();
        (said, losses.counts.values().sum())
    }

    /// A box of something else, or one that cannot be read, does not say that there is no person.
    #[test]
    fn only_a_box_that_is_gone_is_a_rejection() {
        let both: &[&str] = &["left 1", "removed 2"];
        let a_box = r#"<box label="person" xtl="10" ytl="20" xbr="30" ybr="80"/>"#;
        let other = a_box.replace("person", "pedestrian");
        let aside = other.replace("10", "40").replace("30", "56");
        let cvat: [(String, &[&str], u64); 9] = [
            (a_box.into(), both, 0),
            (other.clone(), &["removed 2"], 1),
            (format!("{other}{a_box}"), both, 1),
            (format!("{aside}{a_box}"), both, 1),
            (
                r#"<ellipse label="person" cx="20" cy="50" rx="10" ry="30"/>"#.into(),
                both,
                1,
            ),
            (
                r#"<mask label="person" rle="1200" left="10" top="20" width="20" height="60"/>"#
                    .into(),
                both,
                1,
            ),
            (a_box.replace("30", "NaN"), &[], 1),
            (r#"<points label="person" points="20,50"/>"#.into(), &[], 1),
            (
                r#"<tag label="night"/>"#.into(),
                &["removed 1", "removed 2"],
                1,
            ),
        ];
        for (shapes, expected, lost) in cvat {
            let write = |image: &str| {
                format!(r#"<annotations><image name="{image}">{shapes}</image></annotations>"#)
            };
            let (said, count) = told("a.xml", write);
            assert_eq!(said, expected, "{shapes}");
            assert_eq!(count, lost, "{shapes}");
        }
        let bbox = json!([10, 20, 20, 60]);
        let coco: [(&str, Value, &[&str], u64); 3] = [
            ("person", bbox.clone(), both, 0),
            ("pedestrian", bbox, &["removed 2"], 1),
            ("person", json!([10, 20, null, 60]), &[], 1),
        ];
        for (category, bbox, expected, lost) in coco {
            let write = |image: &str| {
                let images = json!([{ "id": 7, "file_name": image }]);
                let categories = json!([{ "id": 3, "name": category }]);
                let drawn = json!([{ "image_id": 7, "category_id": 3, "bbox": bbox }]);
                json!({ "images": images, "categories": categories, "annotations": drawn })
                    .to_string()
            };
            let (said, count) = told("a.json", write);
            assert_eq!(said, expected, "{category} {bbox}");
            assert_eq!(count, lost, "{category} {bbox}");
        }
        let value =
            json!({ "x": 10, "y": 25, "width": 20, "height": 75, "rectanglelabels": ["person"] });
        let mut lacking = value.clone();
        lacking.as_object_mut().unwrap().remove("x");
        let studio: [(&str, Value, &[&str], u64); 3] = [
            ("rectanglelabels", value, both, 0),
            ("rectanglelabels", lacking, &[], 1),
            (
                "choices",
                json!({ "choices": ["night"] }),
                &["removed 1", "removed 2"],
                1,
            ),
        ];
        for (form, value, expected, lost) in studio {
            let write = |image: &str| {
                let result = json!({ "type": form, "value": value });
                let said = json!([{ "result": [result] }]);
                json!([{ "data": { "image": image }, "annotations": said }]).to_string()
            };
            let (said, count) = told("a.json", write);
            assert_eq!(said, expected, "{form} {value}");
            assert_eq!(count, lost, "{form} {value}");
        }
    }

    #[test]
    fn a_box_marks_a_person_where_it_says_nothing_else() {
        assert!(is_person(None) && is_person(Some("person")) && is_person(Some(" Person")));
        assert!(!is_person(Some("car")) && !is_person(Some("persons")));
    }
}
