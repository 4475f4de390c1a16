//! Questions about people as a folder of camera images, with the boxes that are asked about.

use std::collections::BTreeMap;
use std::path::Path;

use bytes::Bytes;
use datafusion::prelude::SessionContext;
use evermap_catalog::image_size;
use evermap_catalog::painted::ImageKey;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::layers::PersonQuestion;
use evermap_schemas::{Fault, LayerRow};

use crate::annotate::Losses;
use crate::annotate::person_images::{INDEX, PersonImages, TASKS};
use crate::camera_images::file;
use crate::cutout;
use crate::ending::{Ending, Lost};
use crate::export::{Selection, selected};
use crate::output::Folder;
use crate::reader::{MapReader, one_site, typed};

/// Writes the images of the first questions into a folder, and what is asked of each. Images that cannot be read are noted
/// and left out.
///
/// # Errors
/// A user fault for another layer, several sites or no questions, a resource fault where it cannot be written.
pub async fn export(reader: &MapReader, layer: &str, selection: &Selection, out: &Path) -> Ending {
    let declared = reader.declaration(layer).map(|layer| layer.name);
    if declared != Some(PersonQuestion::NAME) {
        let fault = Fault::user("expected a layer of questions about people, found another one");
        return Err(fault
            .next("name person_questions, which the plan people makes")
            .into());
    }
    let batches = selected(reader.map.batches(layer).await?, selection)?;
    let questions: Vec<PersonQuestion> = typed(&batches)?;
    let sites = questions.iter().map(|row| row.site.as_str());
    one_site(sites, selection.site.as_deref())?;
    let context = reader.context(context(Limits::default())?)?;
    let mut folder = Folder::create(out)?;
    let (mut written, mut losses) = (PersonImages::default(), Losses::default());
    for (key, asked) in by_image(questions, selection.questions) {
        match shown(reader, &context, &key).await {
            Ok((size, ending, bytes)) => {
                written.add((size, ending), &asked);
                if let Some(image) = written.images.last() {
                    folder.add(&image.file_name, &bytes)?;
                }
            }
            Err(fault) => {
                let (session, stamp, camera) = &key;
                let place = format!("{camera} in {session} at {} ns", stamp.0);
                losses.remark(&format!("{place}: {fault}"));
                losses.count("image that cannot be read", 1);
            }
        }
    }
    let [index, tasks] = written.texts()?;
    folder.add(TASKS, tasks.as_bytes())?;
    folder.add(INDEX, index.as_bytes())?;
    folder.finish()?;
    losses.tell();
    Ok(Lost(losses.counts))
}

/// The first questions by their images, those of the first image first.
fn by_image(
    mut questions: Vec<PersonQuestion>,
    most: u32,
) -> impl Iterator<Item = (ImageKey, Vec<PersonQuestion>)> {
    questions.sort_by_key(|row| row.question);
    questions.truncate(most as usize);
    let mut places: BTreeMap<ImageKey, usize> = BTreeMap::new();
    let mut images: Vec<(ImageKey, Vec<PersonQuestion>)> = Vec::new();
    for row in questions {
        let key = (row.session.clone(), row.stamp, row.camera.clone());
        let place = *places.entry(key.clone()).or_insert(images.len());
        match images.get_mut(place) {
            Some((_, asked)) => asked.push(row),
            None => images.push((key, vec![row])),
        }
    }
    images.into_iter()
}

/// Size, ending and bytes of an image as programs read it: JPEG and PNG as they are, others as PNG.
async fn shown(
    reader: &MapReader,
    context: &SessionContext,
    key: &ImageKey,
) -> Result<([u32; 2], &'static str, Bytes), Fault> {
    let bytes = file(reader, context, key).await?;
    let size = image_size(&bytes).map_err(|error| Fault::data(error.to_string()))?;
    Ok(match cutout::kind_of(&bytes) {
        Some(cutout::PNG) => (size, "png", bytes),
        Some(_) => (size, "jpg", bytes),
        None => (size, "png", cutout::whole(&bytes)?.into()),
    })
}

#[cfg(test)]
mod tests {
    use evermap_schemas::Stamp;

    use super::*;

    #[test]
    fn questions_of_one_image_are_asked_together_and_the_first_ones_first() {
        let question = |number: u32, stamp: i64| PersonQuestion {
            site: "lot".into(),
            question: number,
            session: "a".into(),
            stamp: Stamp(stamp),
            camera: "front".into(),
            person: 0,
            x: 0.0,
            y: 0.0,
            range_m: 3.0,
            rectangle: vec![0.0, 0.0, 1.0, 1.0],
            mean: 0.0,
            variance: 1.0,
            probability: 0.5,
            gain: 0.1,
            reason: "uncertain".into(),
        };
        let rows = [(4, 9), (2, 5), (1, 7), (3, 7)].map(|(number, stamp)| question(number, stamp));
        let found = by_image(rows.to_vec(), 3).map(|((_, stamp, _), asked)| {
            let numbers: Vec<u32> = asked.iter().map(|row| row.question).collect();
            (stamp.0, numbers)
        });
        assert_eq!(found.collect::<Vec<_>>(), [(7, vec![1, 3]), (5, vec![2])]);
    }
}
