//! The pictures that a file has annotations of, and which of them the mosaic is.

use evermap_schemas::Fault;

use crate::annotate::Losses;
use crate::annotate::mosaic::Picture;

/// Why an annotation is left out.
pub(super) const OF_ANOTHER: &str = "annotation of another picture";

/// A picture as a file describes it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Described {
    /// Its file, as the program knows it: a name, a path or an address. `None` where nothing is said.
    pub(super) name: Option<String>,
    /// Width and height, px; `None` where nothing is said.
    pub(super) size: Option<[f64; 2]>,
}

/// For each picture of a file whether it is the mosaic: by its name, or since the file has no other one. Another name is told.
///
/// # Errors
/// A user fault where no picture is the mosaic, or what is to be it has another size.
pub(super) fn which_are(
    mosaic: &Picture,
    described: &[Described],
    losses: &mut Losses,
) -> Result<Vec<bool>, Fault> {
    let is_called = |one: &Described| {
        let name = one.name.as_deref();
        name.is_some_and(|name| is_file(name, &mosaic.name))
    };
    let called: Vec<bool> = described.iter().map(is_called).collect();
    let is_found = called.contains(&true);
    if !is_found && described.windows(2).any(|two| two[0].name != two[1].name) {
        return Err(none_of(mosaic, described));
    }
    let chosen: Vec<bool> = called.iter().map(|called| *called || !is_found).collect();
    for (one, _) in described.iter().zip(&chosen).filter(|(_, is)| **is) {
        one.fits(mosaic)?;
    }
    if let Some(Some(name)) = described.first().map(|one| one.name.as_deref())
        && !is_found
    {
        losses.remark(&format!(
            "note: annotations of {name} are taken for those of {}",
            mosaic.name
        ));
    }
    Ok(chosen)
}

impl Described {
    /// Holds its size to that of the mosaic.
    ///
    /// # Errors
    /// A user fault for another one.
    fn fits(&self, mosaic: &Picture) -> Result<(), Fault> {
        let expected = mosaic.size;
        let Some([width, height]) = self.size.filter(|size| *size != expected.map(f64::from))
        else {
            return Ok(());
        };
        let [expected_width, expected_height] = expected;
        let fault = Fault::user(format!(
            "expected annotations of a picture of {expected_width} × {expected_height} px, found those of one of {width} × {height} px"
        ));
        let fault = fault.next(AS_DRAWN);
        Err(match &self.name {
            Some(name) => fault.at(name),
            None => fault,
        })
    }
}

/// What to do about another picture.
const AS_DRAWN: &str = "name with --mosaic the very picture that was drawn on";

fn none_of(mosaic: &Picture, described: &[Described]) -> Fault {
    let names = described.iter().filter_map(|one| one.name.as_deref());
    Fault::user(format!(
        "expected annotations of {}, found those of {}",
        mosaic.name,
        evermap_language::listed(names)
    ))
    .next(AS_DRAWN)
}

/// Whether a path or an address is that of a file of this name. Label Studio puts eight hexadecimal digits and a dash before
/// the names of files that people upload, and files of its own disk behind `?d=`.
pub(super) fn is_file(path: &str, name: &str) -> bool {
    let path = match path.split_once('?') {
        Some((address, query)) if !query.starts_with("d=") => address,
        _ => path,
    };
    let ends = |text: &str| text.is_empty() || text.ends_with(['/', '\\', '=']);
    let Some(before) = path.strip_suffix(name) else {
        return false;
    };
    let Some(uploaded) = before.strip_suffix('-') else {
        return ends(before);
    };
    let folder = uploaded.trim_end_matches(|digit: char| digit.is_ascii_hexdigit());
    uploaded.len() - folder.len() == 8 && ends(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_have_names_of_files_in_their_ways() {
        for path in [
            "lot.png",
            "north/lot.png",
            "north\\lot.png",
            "/data/upload/1/3f2a1b4c-lot.png",
            "3f2a1b4c-lot.png",
            "/data/local-files/?d=lot.png",
            "https://maps.example/lot.png?signature=3f",
        ] {
            assert!(is_file(path, "lot.png"), "{path}");
        }
        for path in [
            "parking_lot.png",
            "parking-lot.png",
            "/data/3f2a1b4-lot.png",
            "lot.png.jpg",
            "",
        ] {
            assert!(!is_file(path, "lot.png"), "{path}");
        }
    }
}
