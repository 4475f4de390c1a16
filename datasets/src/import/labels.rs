//! Label images beside the images that they label, and what their values mean.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use evermap_schemas::Fault;
use serde::Deserialize;

use crate::import::{log, read};

/// Names of classes by pixel value.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub enum ClassNames {
    /// The names.
    List(Vec<String>),
    /// A text file with one name per line.
    File(PathBuf),
}

impl ClassNames {
    /// The names; an empty one stands for no class.
    pub(super) fn read(&self, folder: &Path) -> Result<Vec<String>, Fault> {
        let (names, place) = match self {
            Self::List(names) => (names.clone(), "classes".to_owned()),
            Self::File(file) => {
                let path = folder.join(file);
                let names = read(&path)?
                    .lines()
                    .map(|line| line.trim().to_owned())
                    .collect();
                (names, path.display().to_string())
            }
        };
        let named = names.iter().filter(|name| !name.is_empty()).count();
        if named == 0 || names.len() > 255 {
            return Err(Fault::user(format!(
                "expected names of classes for values from 0 to at most 254, found {named} names for {} values",
                names.len()
            ))
            .at(place));
        }
        Ok(names)
    }
}

/// Stamp and file of each label image: that of the image with the same file stem, or, where stems differ and there are
/// as many, of the image at the same place.
pub(super) fn of_images(
    images: &[PathBuf],
    stamps: &[u64],
    labels: Vec<PathBuf>,
    size: (u32, u32),
) -> Result<Vec<(u64, PathBuf)>, Fault> {
    let stamps = pair(images, stamps, &labels)?;
    if let Some(first) = labels.first() {
        // JPEG would change values.
        let (format, found) = log::image_size(first)?;
        if format != "png" {
            return Err(Fault::user("expected labels as PNG").at(first.display()));
        }
        if found != size {
            return Err(Fault::user(format!(
                "expected labels of the images' size, {} x {}, found {} x {}",
                size.0, size.1, found.0, found.1
            ))
            .at(first.display()));
        }
    }
    Ok(stamps.into_iter().zip(labels).collect())
}

/// The stamp of each label image.
fn pair(images: &[PathBuf], stamps: &[u64], labels: &[PathBuf]) -> Result<Vec<u64>, Fault> {
    let by_stem: BTreeMap<_, u64> = images
        .iter()
        .map(|image| image.file_stem())
        .zip(stamps.iter().copied())
        .collect();
    let found: Option<Vec<u64>> = labels
        .iter()
        .map(|label| by_stem.get(&label.file_stem()).copied())
        .collect();
    match found {
        Some(found) if by_stem.len() == images.len() => Ok(found),
        _ if labels.len() == images.len() => Ok(stamps.to_vec()),
        _ => Err(Fault::user(format!(
            "expected label images named like the images, or one for each of {} images, found {}",
            images.len(),
            labels.len()
        ))
        .next("name label images like the images, or list as many of them, in the same order")),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn paths(names: &[&str]) -> Vec<PathBuf> {
        names.iter().map(PathBuf::from).collect()
    }

    #[test]
    fn labels_belong_to_images_by_name_or_else_by_place() {
        let images = paths(&["i/a.png", "i/b.png", "i/c.jpg"]);
        let stamps = [10, 20, 30];
        let of = |labels: &[&str]| pair(&images, &stamps, &paths(labels));
        assert_eq!(of(&["l/c.png", "l/a.png"]).unwrap(), [30, 10]);
        assert_eq!(
            of(&["l/a_L.png", "l/b_L.png", "l/c_L.png"]).unwrap(),
            [10, 20, 30]
        );
        let fault = of(&["l/a_L.png", "l/b_L.png"]).unwrap_err().to_string();
        assert!(fault.contains("3 images, found 2"), "{fault}");
    }

    #[test]
    fn classes_come_as_a_list_or_a_file() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("names.txt"), "road\n\n car \n").unwrap();
        let file: ClassNames = serde_yaml_ng::from_str("names.txt").unwrap();
        assert_eq!(file.read(folder.path()).unwrap(), ["road", "", "car"]);
        let list: ClassNames = serde_yaml_ng::from_str("[road, car]").unwrap();
        assert_eq!(list.read(folder.path()).unwrap(), ["road", "car"]);
        assert!(ClassNames::List(Vec::new()).read(folder.path()).is_err());
    }
}
