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
    for label in &labels {
        fits(label, size)?;
    }
    Ok(stamps.into_iter().zip(labels).collect())
}

/// That a file holds labels of images of this size.
fn fits(label: &Path, size: (u32, u32)) -> Result<(), Fault> {
    let (format, found) = log::image_size(label)?;
    // JPEG would change values.
    if format != "png" {
        return Err(Fault::user("expected labels as PNG").at(label.display()));
    }
    if found != size {
        return Err(Fault::user(format!(
            "expected labels of the images' size, {} x {}, found {} x {}",
            size.0, size.1, found.0, found.1
        ))
        .at(label.display()));
    }
    Ok(())
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

    /// A PNG image as far as its size says.
    fn png_head(width: u32, height: u32) -> Vec<u8> {
        let mut head = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
        head.extend(width.to_be_bytes());
        head.extend(height.to_be_bytes());
        head
    }

    #[test]
    fn every_label_image_is_a_png_of_the_images_size() {
        let folder = tempfile::tempdir().unwrap();
        let images = paths(&["a.png", "b.png"]);
        let labels = paths(&["a.png", "b.png"]).into_iter();
        let labels: Vec<_> = labels.map(|name| folder.path().join(name)).collect();
        let of = |second: &[u8]| {
            std::fs::write(&labels[0], png_head(4, 3)).unwrap();
            std::fs::write(&labels[1], second).unwrap();
            of_images(&images, &[10, 20], labels.clone(), (4, 3))
        };
        let stamps: Vec<u64> = of(&png_head(4, 3)).unwrap().iter().map(|l| l.0).collect();
        assert_eq!(stamps, [10, 20]);
        let jpeg = b"\xff\xd8\xff\xc0\0\x11\x08\0\x03\0\x04\x03";
        for (second, said) in [
            (&png_head(3, 4)[..], "4 x 3, found 3 x 4"),
            (&jpeg[..], "expected labels as PNG"),
            (&b"no image at all"[..], "expected a PNG or JPEG image"),
        ] {
            let fault = of(second).unwrap_err().to_string();
            assert!(fault.contains(said) && fault.contains("b.png"), "{fault}");
        }
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
