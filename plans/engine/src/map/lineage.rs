//! What rows were made from, back to the messages of logs, as the table function `lineage`.
//!
//! Nothing is kept for it: each unit's recipe names the rows and logs that it read.

use std::collections::BTreeMap;
use std::sync::Arc;

use datafusion::catalog::{TableFunctionArgs, TableFunctionImpl, TableProvider};
use datafusion::common::{Result, plan_err};
use datafusion::datasource::MemTable;
use datafusion::logical_expr::{DocSection, Documentation};
use evermap_language::{Input, nearest};
use evermap_schemas::{Fault, batch, record};

use crate::map::Map;
use crate::map::receipt::{Artifact, Extent, LogContent, Receipt};
use crate::map::store::each;
use crate::map::table_function::{text, waited};
use crate::map::version::MappedSession;
use crate::program::{Stage, Task};
use crate::quoted;

record! {
    /// What one unit made, or one table of a session's log.
    #[derive(Default)]
    #[layer("lineage", key(entry))]
    pub struct Origin {
        /// Its number; those of the layer that is asked for come first.
        entry: u32,
        /// Numbers of what it was made from. What the version before had, and logs, are not traced further.
        made_from: Vec<u32>,
        /// The step that made it, `previous.` and a layer of the version before, or the role or topic of a log.
        name: String,
        /// What was computed for it, in order: a step, with its operator and that one's version, or a query.
        computed: Vec<String>,
        /// Site that it is of; null where it is the map.
        site: Option<String>,
        /// Session that it is of; null where it is more than one.
        session: Option<String>,
        /// Rows; null for a log.
        rows: Option<u64>,
        /// Digest of the rows, or of the log.
        content: String,
        /// Topics that were read; of a log alone.
        topics: Vec<String>,
        /// Files of the log; of a log alone.
        files: Vec<String>,
        /// A query of the messages; null where it is no log.
        messages: Option<String>,
    }
}

/// The table function.
#[derive(Debug)]
pub struct LineageFunction(pub Map);

impl TableFunctionImpl for LineageFunction {
    fn call_with_args(&self, args: TableFunctionArgs) -> Result<Arc<dyn TableProvider>> {
        let (layer, session) = match args.exprs() {
            [layer] => (layer, None),
            [layer, session] => (layer, Some(session)),
            _ => {
                return plan_err!(
                    "lineage expects (layer) or (layer, session), such as lineage('lanes')"
                );
            }
        };
        let layer = text(LINEAGE, "the name of a layer, such as 'lanes'", layer)?;
        let session = session
            .map(|session| text(LINEAGE, "the name of a session, such as 'monday'", session));
        let session = session.transpose()?;
        let found = async { batch(lineage(&self.0, &layer, session.as_deref()).await?) };
        let rows = waited(LINEAGE, found)?;
        Ok(Arc::new(MemTable::try_new(
            rows.schema(),
            vec![vec![rows]],
        )?))
    }
}

const LINEAGE: &str = "lineage";

/// What the function is.
pub fn documentation() -> Documentation {
    let about = "What the rows of a layer were made from, back to the messages of logs → a table: entry, made_from \
                 (numbers of other entries), name (the step, or the role of a log), computed (steps with operators and \
                 versions), site, session, rows, content, topics, files, messages (a query)";
    Documentation::builder(DocSection::default(), about, "lineage(layer)")
        .with_alternative_syntax("lineage(layer, session)")
        .with_argument("layer", "name of the layer")
        .with_argument(
            "session",
            "the session whose rows and log are meant; all, where there is none",
        )
        .with_sql_example("SELECT DISTINCT session, unnest(topics) FROM lineage('lanes')")
        .build()
}

/// What the rows of a layer were made from: those of a session, or all.
///
/// # Errors
/// A user fault for a layer or a session that there is not; a resource fault when the store does not answer.
pub async fn lineage(map: &Map, layer: &str, session: Option<&str>) -> Result<Vec<Origin>, Fault> {
    let stored = map.version.layers.get(layer).ok_or_else(|| {
        let known = map.version.layers.keys().map(String::as_str);
        missing("layer", layer, known)
    })?;
    let of = Of::new(map, session)?;
    let mut found = Origins::default();
    let mut level = Vec::new();
    for (artifact, recipe) in stored.artifacts.iter().zip(&stored.recipes) {
        if of.has(&artifact.extent) {
            let (entry, _) = found.rows(layer, artifact);
            level.push((entry, recipe.as_str()));
        }
    }
    while !level.is_empty() {
        let asked = level
            .iter()
            .map(|(_, recipe)| Receipt::read(&map.store, recipe));
        let receipts = each(asked).await?;
        let mut next = Vec::new();
        for ((entry, _), receipt) in level.into_iter().zip(receipts) {
            // A receipt that a crash has torn tells nothing.
            if let Some(receipt) = receipt {
                next.extend(found.made(entry, &receipt, &of));
            }
        }
        level = next;
    }
    Ok(found.entries)
}

fn missing<'k>(what: &str, name: &str, known: impl Iterator<Item = &'k str>) -> Fault {
    let meant = nearest(name, known);
    let fault = Fault::user(format!(
        "there is no {what} `{name}` in this version of the map"
    ));
    match meant {
        Some(near) => fault.next(format!("did you mean `{near}`?")),
        None => fault,
    }
}

/// What is asked for, of a version.
struct Of<'m> {
    sessions: &'m [MappedSession],
    /// The log of the session that is meant; all are, where there is none.
    log: Option<&'m LogContent>,
    /// The recipe of what a step made, by the step, what the rows are of, and their digest: rows of two sites are equal where
    /// there are none.
    recipes: BTreeMap<(&'m str, &'m Extent, &'m str), &'m str>,
}

impl<'m> Of<'m> {
    fn new(map: &'m Map, session: Option<&str>) -> Result<Self, Fault> {
        let sessions = &map.version.sessions;
        let log = session.map(|name| {
            let log = MappedSession::named(sessions, name).map(|session| &session.log);
            log.ok_or_else(|| {
                let known = sessions.iter().map(|session| session.log.session.as_str());
                missing("session", name, known)
            })
        });
        let stored = map.version.layers.iter();
        let recipes = stored.flat_map(|(name, layer)| {
            let made = layer.artifacts.iter().zip(&layer.recipes);
            made.map(move |(rows, recipe)| (key(name, rows), recipe.as_str()))
        });
        Ok(Self {
            sessions,
            log: log.transpose()?,
            recipes: recipes.collect(),
        })
    }

    fn has(&self, extent: &Extent) -> bool {
        self.log.is_none_or(|log| extent.covers(log))
    }
}

fn key<'a>(step: &'a str, rows: &'a Artifact) -> (&'a str, &'a Extent, &'a str) {
    (step, &rows.extent, &rows.content)
}

/// What was found so far.
#[derive(Default)]
struct Origins {
    entries: Vec<Origin>,
    /// Entries by name, what they are of, and content.
    numbers: BTreeMap<(String, Extent, String), u32>,
}

impl Origins {
    /// The number of an entry, and whether it is new.
    fn number(&mut self, origin: Origin) -> (u32, bool) {
        let extent = Extent {
            session: origin.session.clone(),
            site: origin.site.clone(),
        };
        let key = (origin.name.clone(), extent, origin.content.clone());
        let next = self.entries.len() as u32;
        let number = *self.numbers.entry(key).or_insert(next);
        if number == next {
            self.entries.push(Origin {
                entry: number,
                ..origin
            });
        }
        (number, number == next)
    }

    fn rows(&mut self, name: &str, artifact: &Artifact) -> (u32, bool) {
        self.number(Origin {
            name: name.to_owned(),
            site: artifact.extent.site.clone(),
            session: artifact.extent.session.clone(),
            rows: Some(artifact.rows),
            content: artifact.content.clone(),
            ..Origin::default()
        })
    }

    /// A table of a log; `None` for a role that no topic plays.
    fn log(&mut self, source: &str, log: &LogContent, of: &Of<'_>) -> Option<u32> {
        let mapped =
            MappedSession::named(of.sessions, &log.session).map(|session| &session.manifest);
        let topics = match source.starts_with('/') {
            true => vec![source.to_owned()],
            false => mapped?.roles.get(source)?.clone(),
        };
        let files = mapped.into_iter().flat_map(|manifest| &manifest.sessions);
        let files = files.flat_map(|session| &session.files);
        let (session, table) = (quoted::name(&log.session), quoted::name(source));
        let (number, _) = self.number(Origin {
            name: source.to_owned(),
            site: Some(log.site.clone()),
            session: Some(log.session.clone()),
            content: log.content.clone(),
            topics,
            files: files.map(|file| last_segment(file).to_owned()).collect(),
            messages: Some(format!("SELECT * FROM {session}.{table}")),
            ..Origin::default()
        });
        Some(number)
    }

    /// Adds what a unit read to what it made; what of it is new, with its recipe.
    fn made<'m>(&mut self, entry: u32, receipt: &Receipt, of: &Of<'m>) -> Vec<(u32, &'m str)> {
        let recipe = &receipt.recipe;
        let (mut from, mut next) = (Vec::new(), Vec::new());
        let tables = recipe.tables.iter();
        let tables = tables.map(|(name, artifacts)| (name, artifacts.as_slice()));
        let new = recipe.new.iter();
        let new = new.map(|(name, rows)| (name, rows.artifacts.as_slice()));
        for (name, artifacts) in tables.chain(new) {
            for artifact in artifacts.iter().filter(|artifact| of.has(&artifact.extent)) {
                let (number, is_new) = self.rows(name, artifact);
                from.push(number);
                if let (true, Some(recipe)) = (is_new, of.recipes.get(&key(name, artifact))) {
                    next.push((number, *recipe));
                }
            }
        }
        for (layer, rows) in &recipe.previous {
            let name = Input::Previous(layer.clone()).written();
            let artifacts = rows.artifacts.iter();
            let artifacts = artifacts.filter(|artifact| of.has(&artifact.extent));
            from.extend(artifacts.map(|artifact| self.rows(&name, artifact).0));
        }
        let reads = recipe.stages.iter().flat_map(|stage| &stage.reads);
        for read in reads {
            if let Input::Source(source) = &read.table {
                let logs = recipe.logs.iter();
                let logs =
                    logs.filter(|log| of.log.is_none_or(|meant| log.session == meant.session));
                from.extend(logs.filter_map(|log| self.log(source, log, of)));
            }
        }
        from.sort_unstable();
        from.dedup();
        if let Some(made) = self.entries.get_mut(entry as usize) {
            made.made_from = from;
            made.computed = recipe.stages.iter().map(computed).collect();
        }
        next
    }
}

/// A step, with what it is.
fn computed(stage: &Stage) -> String {
    let name = &stage.name;
    match &stage.task {
        Task::Op { op, version, .. } => format!("{name}: {op} {version}"),
        Task::Sql { .. } => format!("{name}: query"),
        Task::Python(python) => format!("{name}: {}", python.function.label()),
    }
}

/// The name of a file, without where it is.
fn last_segment(file: &str) -> &str {
    file.rsplit('/').next().unwrap_or(file)
}
