//! Oriented boxes of YOLO: a line each, the number of a class and four corners as shares of the picture.

use std::path::Path;

use evermap_schemas::Fault;

use super::{DrawnShape, Pixel, Shape, kinds};
use crate::annotate::Losses;
use crate::annotate::mosaic::Picture;
use crate::ending::Failure;
use crate::output::write_file;

/// The names of the classes, a line each, beside the boxes.
const CLASSES: &str = "classes.txt";

/// The names of the classes; none where nobody wrote them.
///
/// # Errors
/// A user fault for a file that cannot be read.
pub(super) fn classes(path: &Path) -> Result<Vec<String>, Fault> {
    let path = path.with_file_name(CLASSES);
    match evermap_datasets::read_text(&path) {
        Ok(text) => Ok(text.lines().map(|line| line.trim().to_owned()).collect()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => {
            Err(Fault::user(format!("expected names of classes, found {error}")).at(path.display()))
        }
    }
}

/// Whether a text begins with a box.
pub(super) fn begins(text: &str) -> bool {
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    lines
        .next()
        .is_some_and(|line| corners(line, [1, 1]).is_some())
}

/// The boxes of a picture of this size. Of a class without a name its number is what it marks.
pub(super) fn read(
    text: &str,
    classes: &[String],
    size: [u32; 2],
    losses: &mut Losses,
) -> Vec<DrawnShape> {
    let lines = text.lines().enumerate();
    let lines = lines.filter(|(_, line)| !line.trim().is_empty());
    let mut found = Vec::new();
    for (number, line) in lines {
        let place = format!("line {}", number + 1);
        match corners(line, size) {
            Some((class, corners)) => {
                let name = classes.get(class).cloned();
                let kind = name.or_else(|| Some(class.to_string()));
                found.push(DrawnShape::said(place, kind, Shape::Closed(corners)));
            }
            None => losses.note("line that is not a class and four corners", &place),
        }
    }
    found
}

fn corners(line: &str, [width, height]: [u32; 2]) -> Option<(usize, Vec<Pixel>)> {
    let mut words = line.split_whitespace();
    let class = words.next()?.parse().ok()?;
    let shares: Option<Vec<f64>> = words.map(|word| word.parse().ok()).collect();
    let shares: [f64; 8] = shares?.try_into().ok()?;
    let (corners, _) = shares.as_chunks::<2>();
    let pixel = |[x, y]: &[f64; 2]| [x * f64::from(width), y * f64::from(height)];
    Some((class, corners.iter().map(pixel).collect()))
}

/// The boxes; their classes are written beside, after those that are there: files of the same folder have their numbers.
///
/// # Errors
/// As [`classes`] and [`write_file`]; a user fault for boxes in the place of their classes.
pub(super) fn write(
    drawn: &[DrawnShape],
    picture: &Picture,
    path: &Path,
) -> Result<String, Failure> {
    let beside = path.with_file_name(CLASSES);
    let name = path.file_name().unwrap_or_default();
    if name.eq_ignore_ascii_case(CLASSES) {
        let fault =
            Fault::user("expected a file for boxes, found the name of that of their classes");
        return Err(fault.at(path.display()).next("call it otherwise").into());
    }
    let mut names = classes(path)?;
    let known = names.len();
    for kind in kinds(drawn).into_iter().map(str::trim) {
        if !names.iter().any(|name| name == kind) {
            names.push(kind.to_owned());
        }
    }
    if names.len() > known {
        write_file(&beside, (names.join("\n") + "\n").as_bytes())?;
    }
    let [width, height] = picture.size.map(f64::from);
    let line = |drawn: &DrawnShape| {
        let kind = drawn.kind.as_deref().unwrap_or_default().trim();
        let class = names.iter().position(|name| name == kind).unwrap_or(0);
        let corners = drawn.shape.points().into_iter();
        let shares = corners.map(|[x, y]| format!(" {} {}", x / width, y / height));
        format!("{class}{}\n", shares.collect::<String>())
    };
    Ok(drawn.iter().map(line).collect())
}
