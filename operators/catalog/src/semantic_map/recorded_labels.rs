#![doc = include_str!("recorded_labels.md")]

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::semantic_map::semantic_graph::{MOST_CLASSES, VOID};
use evermap_contract::{Emit, Fault, Operator, Pixels, Port, Reason, Sides, Work};
use evermap_schemas::layers::LabelImage;
use evermap_schemas::roles::{Frame, LabelClass};
use evermap_vision::{ImageError, decode_values};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::pixels::{NO_LABELS, label_image};

/// See the module's page.
pub struct RecordedLabels;

/// What labels mean.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct RecordedLabelsParams {
    /// Names of the classes by pixel value, for sessions whose log does not say: by default those of paper 2.
    pub classes: Vec<String>,
    /// Classes that count as another one, by name: `{"bicyclist": "pedestrian"}`.
    pub merge: BTreeMap<String, String>,
}

impl Default for RecordedLabelsParams {
    fn default() -> Self {
        let classes = [
            "tree",
            "sky",
            "road",
            "sign",
            "sidewalk",
            "ground sign",
            "building",
            "car",
            "other",
        ];
        Self {
            classes: classes.map(str::to_owned).to_vec(),
            merge: BTreeMap::new(),
        }
    }
}

impl Operator for RecordedLabels {
    const NAME: &'static str = "recorded_labels";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("recorded_labels.md");
    type Params = RecordedLabelsParams;
    type Output = LabelImage;

    fn work() -> Work<Self::Params> {
        let labels = Port::session::<Frame>("labels").pixels("image");
        let classes = Port::site::<LabelClass>("classes").optional();
        Work::batches(labels, vec![classes], Site::new, Site::images)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let distinct: BTreeSet<_> = params.classes.iter().collect();
        if distinct.len() != params.classes.len() || !(1..=MOST_CLASSES).contains(&distinct.len()) {
            return Err(Fault::user(format!(
                "expected from 1 to {MOST_CLASSES} `classes`, each named once, found {:?}",
                params.classes
            )));
        }
        let names = params.classes.iter().chain(params.merge.values());
        if names.clone().any(String::is_empty) {
            return Err(Fault::user("expected names of classes, found an empty one"));
        }
        Ok(())
    }
}

/// What label values become: an index into the site's classes.
type Table = [u8; 256];

/// The classes of a site, in one order for all its sessions.
struct Site {
    classes: Vec<String>,
    /// By session, of those whose log says.
    sessions: BTreeMap<String, Table>,
    /// Of the others.
    unsaid: Table,
}

impl Site {
    fn new(params: &RecordedLabelsParams, sides: &Sides) -> Result<Self, Fault> {
        let said = sides.rows("classes")?;
        Ok(Self::of(said, &params.classes, &params.merge))
    }

    /// The classes that the logs name, by session and value; where none does, the given ones.
    fn of(mut said: Vec<LabelClass>, given: &[String], merge: &BTreeMap<String, String>) -> Self {
        let merged = |name: &str| merge.get(name).map_or(name, String::as_str).to_owned();
        said.sort_by(|a, b| (&a.session, a.value, &a.class).cmp(&(&b.session, b.value, &b.class)));
        said.dedup_by(|later, first| {
            (&later.session, later.value) == (&first.session, first.value)
        });
        let mut classes: Vec<String> = Vec::new();
        let names: Vec<&String> = match said.as_slice() {
            [] => given.iter().collect(),
            said => said.iter().map(|row| &row.class).collect(),
        };
        for name in names.into_iter().map(|name| merged(name)) {
            if !classes.contains(&name) && classes.len() < MOST_CLASSES {
                classes.push(name);
            }
        }
        let index = |name: &str| {
            let name = merged(name);
            let found = classes.iter().position(|class| *class == name);
            found.map_or(VOID, |index| index as u8)
        };
        let mut sessions: BTreeMap<String, Table> = BTreeMap::new();
        for row in &said {
            let table = sessions.entry(row.session.clone()).or_insert([VOID; 256]);
            table[usize::from(row.value)] = index(&row.class);
        }
        let mut unsaid = [VOID; 256];
        for (entry, name) in unsaid.iter_mut().zip(given) {
            *entry = index(name);
        }
        Self {
            classes,
            sessions,
            unsaid,
        }
    }
}

/// A row, and whether all its pixels have a class or say that they have none.
type DecodedImage = Result<(LabelImage, bool), Reason>;

impl Site {
    fn images(
        &self,
        frames: Vec<Frame>,
        pixels: &Pixels,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        let frames = frames.into_par_iter().enumerate();
        let found: Vec<DecodedImage> = frames
            .filter_map(|(row, frame)| Some(self.image(frame, pixels.get(row)?)))
            .collect();
        let incomplete = found.iter().flatten().filter(|(_, complete)| !complete);
        let incomplete = incomplete.count() as u64;
        emit.skip("label image has values without a class", incomplete);
        let rows = found.into_iter().map(|found| Ok([found?.0]));
        emit.made(rows.collect())
    }

    fn image(&self, frame: Frame, bytes: &[u8]) -> DecodedImage {
        let values = decode_values(bytes).map_err(|error| match error {
            ImageError::Values { .. } => "label image holds colours instead of values",
            _ => NO_LABELS,
        })?;
        let table = self.sessions.get(&frame.session).unwrap_or(&self.unsaid);
        let (data, complete) = classified(&values.data, table);
        let (width, height) = (values.width, values.height);
        let png = label_image([width, height], data)?;
        let row = LabelImage {
            site: frame.site,
            session: frame.session,
            stamp: frame.stamp,
            camera: frame.camera,
            width,
            height,
            classes: self.classes.clone(),
            png,
        };
        Ok((row, complete))
    }
}

/// The class of every pixel; false where one that has a value has no class, as no value above 255 has.
fn classified(values: &[u16], table: &Table) -> (Vec<u8>, bool) {
    let (mut met, mut beyond) = ([false; 256], false);
    let look_up = |value: &u16| {
        let Ok(value) = u8::try_from(*value) else {
            beyond = true;
            return VOID;
        };
        met[usize::from(value)] = true;
        table[usize::from(value)]
    };
    let classes = values.iter().map(look_up).collect();
    let unknown =
        |(value, met): (usize, &bool)| *met && value != usize::from(VOID) && table[value] == VOID;
    (classes, !beyond && !met.iter().enumerate().any(unknown))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(session: &str, value: u8, class: &str) -> LabelClass {
        LabelClass {
            site: "town".into(),
            session: session.into(),
            value,
            class: class.into(),
        }
    }

    #[test]
    fn sessions_that_number_classes_differently_share_one_list() {
        let given = RecordedLabelsParams::default().classes;
        let merge = BTreeMap::from([("bicyclist".to_owned(), "pedestrian".to_owned())]);
        let rows = vec![
            said("b", 0, "road"),
            said("b", 9, "bicyclist"),
            said("a", 4, "road"),
            said("a", 2, "sky"),
            said("a", 2, "zebra"),
        ];
        let site = Site::of(rows, &given, &merge);
        assert_eq!(site.classes, ["sky", "road", "pedestrian"]);
        assert_eq!((site.sessions["a"][2], site.sessions["a"][4]), (0, 1));
        assert_eq!((site.sessions["b"][0], site.sessions["b"][9]), (1, 2));
        assert_eq!(site.sessions["a"][0], VOID);
        // A session that says nothing: what the parameter names, as far as the site knows it.
        assert_eq!(
            (site.unsaid[1], site.unsaid[2], site.unsaid[0]),
            (0, 1, VOID)
        );
    }

    #[test]
    fn where_no_log_says_the_given_classes_hold() {
        let given = ["a".to_owned(), "b".to_owned(), "c".to_owned()];
        let merge = BTreeMap::from([("a".to_owned(), "c".to_owned())]);
        let site = Site::of(Vec::new(), &given, &merge);
        assert_eq!(site.classes, ["c", "b"]);
        assert_eq!(site.unsaid[..4], [0, 1, 0, VOID]);
    }

    #[test]
    fn only_values_that_mean_nothing_are_missed() {
        let mut table = [VOID; 256];
        table[7] = 3;
        assert_eq!(classified(&[7, 255, 7], &table), (vec![3, 255, 3], true));
        assert_eq!(classified(&[7, 11], &table), (vec![3, 255], false));
    }

    #[test]
    fn values_above_255_are_missed_and_are_not_of_a_class_named_255() {
        let mut table = [VOID; 256];
        table[7] = 3;
        assert_eq!(classified(&[7, 26_000], &table), (vec![3, 255], false));
        table[255] = 1;
        assert_eq!(classified(&[255, 7], &table), (vec![1, 3], true));
        let beyond = classified(&[255, 256, 65_535], &table);
        assert_eq!(beyond, (vec![1, 255, 255], false));
    }
}
