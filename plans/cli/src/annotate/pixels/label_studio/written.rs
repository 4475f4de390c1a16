//! What is read of Label Studio's tasks, whatever else they have.

use serde::de::{MapAccess, SeqAccess};

use crate::annotate::pixels::outline::{Numbers, PixelOutline};
use crate::annotate::reading::{
    AnyJson, JsonToken, Lenient, Listed, MOST_FEATURES, Member, skipped, value,
};

/// Texts of a task's data that are looked through for the name of its picture.
const MOST_TEXTS: usize = 1000;
/// Names in a result's value that are looked through for its labels.
const MOST_NAMES: usize = 64;

/// A task.
#[derive(Debug, Default)]
pub(super) struct WrittenTask {
    /// Whether it has members of a task as `JSON` has it: `JSON-MIN` has its members, and none of these.
    pub(super) is_task: bool,
    pub(super) data: TaskData,
    pub(super) annotations: WrittenAnnotations,
    pub(super) completions: WrittenAnnotations,
}

impl Lenient for WrittenTask {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        self.is_task |= matches!(name, "data" | "annotations" | "completions" | "predictions");
        match name {
            "data" => self.data = value(object)?,
            "annotations" => self.annotations = value(object)?,
            "completions" => self.completions = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

/// What a task is about.
#[derive(Debug, Default)]
pub(super) struct TaskData {
    pub(super) image: Member,
    pub(super) texts: Vec<String>,
}

impl Lenient for TaskData {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        let found: Member = value(object)?;
        if let (Some(text), true) = (found.text(), self.texts.len() < MOST_TEXTS) {
            self.texts.push(text.to_owned());
        }
        if name == "image" {
            self.image = found;
        }
        Ok(())
    }
}

/// What people said of a task's picture, each time that somebody looked at it and did not give up.
#[derive(Debug, Default)]
pub(super) struct WrittenAnnotations {
    /// What is there.
    pub(super) is: Member,
    /// Whether somebody said something, if only that there is nothing.
    pub(super) is_seen: bool,
    /// Whether it could not be read what somebody said.
    pub(super) is_unread: bool,
    /// The first results, so many as there may be.
    pub(super) results: Vec<WrittenResult>,
    /// How many there are.
    pub(super) count: usize,
}

impl Lenient for WrittenAnnotations {
    fn found(&mut self, token: JsonToken<'_>) {
        self.is.found(token);
    }

    fn element<'de, A: SeqAccess<'de>>(&mut self, list: &mut A) -> Result<Option<()>, A::Error> {
        let found = list.next_element::<AnyJson<WrittenAnnotation>>()?;
        Ok(found.map(|AnyJson(annotation)| self.take(annotation)))
    }
}

impl WrittenAnnotations {
    fn take(&mut self, annotation: WrittenAnnotation) {
        let result = annotation.result;
        match () {
            () if annotation.was_cancelled == Member::Truth(true) => {}
            () if result.is == Member::List => {
                self.is_seen = true;
                self.count += result.count;
                if self.count <= MOST_FEATURES {
                    self.results.extend(result.first);
                }
            }
            () => self.is_unread = true,
        }
    }
}

#[derive(Debug, Default)]
struct WrittenAnnotation {
    was_cancelled: Member,
    result: Listed<WrittenResult>,
}

impl Lenient for WrittenAnnotation {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "was_cancelled" => self.was_cancelled = value(object)?,
            "result" => self.result = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

/// One thing that is said.
#[derive(Debug, Default)]
pub(super) struct WrittenResult {
    pub(super) id: Member,
    form: Member,
    pub(super) original_width: Member,
    pub(super) original_height: Member,
    pub(super) value: WrittenValue,
}

impl Lenient for WrittenResult {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "id" => self.id = value(object)?,
            "type" => self.form = value(object)?,
            "original_width" => self.original_width = value(object)?,
            "original_height" => self.original_height = value(object)?,
            "value" => self.value = value(object)?,
            _ => skipped(object)?,
        }
        Ok(())
    }
}

impl WrittenResult {
    /// What kind of result it is, where it says so.
    pub(super) fn form(&self) -> Option<&str> {
        self.form.text()
    }

    /// Its labels, which are in its value under the name of its form.
    pub(super) fn labels(&self) -> Option<&WrittenLabels> {
        let form = self.form().unwrap_or_default();
        let mut named = self.value.named.iter();
        let found = named.find(|(name, _)| name == form);
        found.map(|(_, labels)| labels)
    }
}

/// Where a result lies, in percent of the picture, and what it is.
#[derive(Debug, Default)]
pub(super) struct WrittenValue {
    pub(super) x: Option<f64>,
    pub(super) y: Option<f64>,
    pub(super) width: Option<f64>,
    pub(super) height: Option<f64>,
    pub(super) rotation: Member,
    pub(super) points: WrittenPoints,
    /// What may be its labels, by name.
    named: Vec<(String, WrittenLabels)>,
}

impl Lenient for WrittenValue {
    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        match name {
            "x" => self.x = value::<Member, A>(object)?.number(),
            "y" => self.y = value::<Member, A>(object)?.number(),
            "width" => self.width = value::<Member, A>(object)?.number(),
            "height" => self.height = value::<Member, A>(object)?.number(),
            "rotation" => self.rotation = value(object)?,
            "points" => self.points = value(object)?,
            _ if self.named.len() < MOST_NAMES => {
                let labels = value(object)?;
                self.named.retain(|(known, _)| known != name);
                self.named.push((name.to_owned(), labels));
            }
            _ => skipped(object)?,
        }
        Ok(())
    }
}

/// What a result is said to be: the first of several.
pub(super) type WrittenLabels = Listed<Member, 1>;

/// Corners of an outline, each a list of a column and a row.
#[derive(Debug, Default)]
pub(super) struct WrittenPoints {
    pub(super) is_list: bool,
    pub(super) outline: PixelOutline,
}

impl Lenient for WrittenPoints {
    fn found(&mut self, token: JsonToken<'_>) {
        self.is_list = matches!(token, JsonToken::List);
    }

    fn element<'de, A: SeqAccess<'de>>(&mut self, list: &mut A) -> Result<Option<()>, A::Error> {
        let Some(AnyJson(point)) = list.next_element::<AnyJson<Numbers<2>>>()? else {
            return Ok(None);
        };
        match point.all() {
            Some(point) => self.outline.add(point),
            None => self.outline.end(),
        }
        Ok(Some(()))
    }
}
