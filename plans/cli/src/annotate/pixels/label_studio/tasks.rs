//! Tasks as they are read one after the other: of each its picture, and what people said of it.

use evermap_schemas::Fault;

use super::written::{TaskData, WrittenAnnotations, WrittenResult, WrittenTask};
use crate::annotate::no_json;
use crate::annotate::pixels::described::{Canvas, DescribedPicture, is_file};
use crate::annotate::reading::{MOST_FEATURES, Member, each, not_more};

/// What people said of a task's picture.
#[derive(Debug)]
pub(super) struct TaskAnnotations {
    pub(super) is_seen: bool,
    pub(super) is_unread: bool,
    pub(super) results: Vec<WrittenResult>,
}

/// The pictures of tasks, and what was said of each.
///
/// # Errors
/// A user fault for JSON of another form, annotations that are no list, or too many tasks or results.
pub(super) fn tasks(
    text: &str,
    canvases: &[Canvas],
) -> Result<(Vec<DescribedPicture>, Vec<TaskAnnotations>), Fault> {
    let mut reading = Reading::default();
    each(text, |task| reading.take(task, canvases)).map_err(|error| no_json(&error))?;
    if reading.has_others {
        return Err(Fault::user(
            "expected tasks of Label Studio with their annotations, found JSON of another form",
        )
        .next("export from Label Studio as `JSON`, not as `JSON-MIN`"));
    }
    reading.fault.map_or(Ok(()), Err)?;
    not_more(reading.tasks, "tasks")?;
    not_more(reading.results, "results")?;
    Ok((reading.pictures, reading.said))
}

#[derive(Default)]
struct Reading {
    tasks: usize,
    results: usize,
    /// Whether there is what is no task.
    has_others: bool,
    /// Of the first task whose annotations are no list.
    fault: Option<Fault>,
    pictures: Vec<DescribedPicture>,
    said: Vec<TaskAnnotations>,
}

impl Reading {
    fn take(&mut self, task: WrittenTask, canvases: &[Canvas]) {
        self.has_others |= !task.is_task;
        self.tasks += 1;
        let mut said = TaskAnnotations {
            is_seen: false,
            is_unread: false,
            results: Vec::new(),
        };
        for (name, found) in [
            ("annotations", task.annotations),
            ("completions", task.completions),
        ] {
            if let Err(fault) = found.is.is_list(name) {
                self.fault.get_or_insert(fault);
            }
            let WrittenAnnotations {
                is_seen,
                is_unread,
                results,
                count,
                ..
            } = found;
            said.is_seen |= is_seen;
            said.is_unread |= is_unread;
            self.results += count;
            said.results.extend(results);
        }
        // What is refused in the end is not held.
        if self.tasks <= MOST_FEATURES && self.results <= MOST_FEATURES {
            self.pictures
                .push(described(&task.data, &said.results, canvases));
            said.results.shrink_to_fit();
            self.said.push(said);
        }
    }
}

/// The picture of a task, under whatever word the project has it, with the size that a result says.
fn described(data: &TaskData, results: &[WrittenResult], canvases: &[Canvas]) -> DescribedPicture {
    let texts = || data.texts.iter().map(String::as_str);
    let is_one = |text: &&str| canvases.iter().any(|canvas| is_file(text, &canvas.name));
    let name = texts().find(is_one).or(data.image.text());
    let size = |result: &WrittenResult| {
        [&result.original_width, &result.original_height].map(Member::written)
    };
    let mut sizes = results.iter().map(size);
    DescribedPicture {
        // Several tasks may be of one picture.
        id: None,
        name: name.or(texts().next()).map(str::to_owned),
        size: sizes
            .find(|size| size.iter().any(Option::is_some))
            .unwrap_or_default(),
    }
}
