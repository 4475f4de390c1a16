//! The pictures that a file has annotations of, and which of them are those that are looked for.

use evermap_schemas::Fault;

use crate::annotate::Losses;

/// Why an annotation is left out.
pub(super) const OF_ANOTHER: &str = "annotation of another picture";

/// A picture that annotations may be of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Canvas {
    /// The name of its file.
    pub name: String,
    /// Width and height, px.
    pub size: [u32; 2],
}

/// A picture as a file describes it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct DescribedPicture {
    /// What tells it in its file from another one of the same name; `None` where nothing does, and it is the same.
    pub(super) id: Option<String>,
    /// Its file, as the program knows it: a name, a path or an address. `None` where nothing is said.
    pub(super) name: Option<String>,
    /// Width and height, px, as the file has them; `None` where nothing is said.
    pub(super) size: [Option<String>; 2],
}

/// For each picture of a file which of these it is, by its name; where there is one alone, and the file has no other picture,
/// that one, and another name is told. `None` for others.
///
/// # Errors
/// A user fault where no picture is one of these, several may be the same one, or what is to be one has another size.
pub(super) fn which_are(
    canvases: &[Canvas],
    described: &[DescribedPicture],
    losses: &mut Losses,
) -> Result<Vec<Option<usize>>, Fault> {
    let called = |one: &DescribedPicture| {
        let name = one.name.as_deref()?;
        canvases
            .iter()
            .position(|canvas| is_file(name, &canvas.name))
    };
    let mut chosen: Vec<Option<usize>> = described.iter().map(called).collect();
    if described.is_empty() {
        losses.remark("note: the file has annotations of no picture");
    }
    if chosen.iter().all(Option::is_none) {
        let is_only = described.windows(2).all(|two| two[0].name == two[1].name);
        let [canvas] = canvases else {
            return Err(none_of(canvases, described));
        };
        if !is_only {
            return Err(none_of(canvases, described));
        }
        chosen.fill(Some(0));
        if let Some(Some(name)) = described.first().map(|one| one.name.as_deref()) {
            losses.remark(&format!(
                "note: annotations of {name} are taken for those of {}",
                canvas.name
            ));
        }
    }
    for (number, canvas) in canvases.iter().enumerate() {
        tell_apart((number, canvas), described, &mut chosen)?;
    }
    for (one, at) in described.iter().zip(&chosen) {
        if let Some(canvas) = at.and_then(|at| canvases.get(at)) {
            one.fits(canvas)?;
        }
    }
    Ok(chosen)
}

/// Of pictures in several folders whose files have one name, leaves the one that is called just so.
///
/// # Errors
/// A user fault with two of them, where nothing tells which is meant.
fn tell_apart(
    (number, canvas): (usize, &Canvas),
    described: &[DescribedPicture],
    chosen: &mut [Option<usize>],
) -> Result<(), Fault> {
    let is_it = |one: &DescribedPicture| one.name.as_ref() == Some(&canvas.name);
    let alike = described.iter().zip(&*chosen);
    let alike = alike.filter(|(_, at)| **at == Some(number));
    let mut alike: Vec<&DescribedPicture> = alike.map(|(one, _)| one).collect();
    if alike.iter().any(|one| is_it(one)) {
        alike.retain(|one| is_it(one));
        for (one, at) in described.iter().zip(chosen) {
            at.take_if(|at| *at == number && !is_it(one));
        }
    }
    let other = alike.iter().find(|one| !one.is_same(alike[0]));
    match other {
        None => Ok(()),
        Some(other) => {
            let (of, one, other) = (&canvas.name, alike[0].in_words(), other.in_words());
            let fault = format!("expected one picture that may be {of}, found {one} and {other}");
            Err(Fault::user(fault).next("give each a name of its own, or leave one out"))
        }
    }
}

impl DescribedPicture {
    /// Whether it is the same picture as another one.
    fn is_same(&self, other: &Self) -> bool {
        (&self.name, &self.id) == (&other.name, &other.id)
    }

    fn in_words(&self) -> String {
        let name = self.name.as_deref().unwrap_or("one without a name");
        match &self.id {
            Some(id) => format!("{name} (id {id})"),
            None => name.to_owned(),
        }
    }

    /// Holds its size to that of a picture.
    ///
    /// # Errors
    /// A user fault for another one, or one that is no number.
    fn fits(&self, canvas: &Canvas) -> Result<(), Fault> {
        let is = |said: &Option<String>, side: u32| {
            let said = said.as_ref().map(|said| said.trim().parse::<f64>());
            said.is_none_or(|said| said == Ok(f64::from(side)))
        };
        let [width, height] = &self.size;
        let [expected_width, expected_height] = canvas.size;
        if is(width, expected_width) && is(height, expected_height) {
            return Ok(());
        }
        let [width, height] = [width, height].map(|said| said.as_deref().unwrap_or("?"));
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
const AS_DRAWN: &str = "name with --mosaic, or --images, what was drawn on";

fn none_of(canvases: &[Canvas], described: &[DescribedPicture]) -> Fault {
    let names = described.iter().filter_map(|one| one.name.as_deref());
    let found = evermap_language::listed(names);
    let text = match canvases {
        [one] => format!(
            "expected annotations of {}, found those of {found}",
            one.name
        ),
        _ => format!("expected annotations of the images of the folder, found those of {found}"),
    };
    Fault::user(text).next(AS_DRAWN)
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
