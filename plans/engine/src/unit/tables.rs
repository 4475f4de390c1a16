//! The tables that a unit reads from the map and from logs, no more of each than it needs.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::datatypes::Schema;
use datafusion::catalog::TableProvider;
use datafusion::common::ScalarValue;
use datafusion::logical_expr::{ident, lit};
use datafusion::prelude::{DataFrame, SessionContext};
use evermap_contract::{Reach, Registry};
use evermap_language::Input;
use evermap_schemas::Fault;

use crate::conform::misfits;
use crate::error::OrFault;
use crate::map::artifact::read_artifacts;
use crate::map::receipt::{Artifact, Extent, LayerRows};
use crate::map::store::Store;
use crate::program::{Read, Scope};
use crate::unit::Unit;

/// What a unit reads, in the context that it runs in.
pub struct Tables<'a> {
    /// The unit.
    pub unit: &'a Unit,
    /// The map.
    pub store: &'a Store,
    /// The operators, which know the columns of layers.
    pub registry: &'a Registry,
    /// Where plans are made and run.
    pub context: SessionContext,
    /// The tables of the unit's logs.
    pub logs: BTreeMap<String, Arc<dyn TableProvider>>,
}

impl Tables<'_> {
    /// The rows of a table that are read, with the columns that are.
    ///
    /// # Errors
    /// A bug fault for a table that the unit was not given, or what keeps it from being opened.
    pub async fn rows(&self, read: &Read) -> Result<DataFrame, Fault> {
        let recipe = &self.unit.recipe;
        let (frame, extents) = match &read.table {
            Input::Source(name) => {
                let missing = || Fault::user(format!("expected logs with {name}, found none"));
                let table = Arc::clone(self.logs.get(name).ok_or_else(missing)?);
                let frame = self.context.read_table(table).or_fault()?;
                let logs = recipe.logs.iter();
                let extents = logs.map(|log| Extent::of(Scope::Session, log));
                (frame, extents.collect())
            }
            Input::Step(name) => {
                let artifacts = recipe.tables.get(name).map_or(&[][..], Vec::as_slice);
                (self.artifacts(artifacts, None).await?, extents(artifacts))
            }
            Input::Previous(name) => {
                let missing = || Fault::bug(format!("no previous {name}"));
                let LayerRows { op, artifacts } = recipe.previous.get(name).ok_or_else(missing)?;
                let frame = self.artifacts(artifacts, op.as_deref()).await?;
                let frame = self.grown(frame, op.as_deref())?;
                self.check_stored(name, &frame, op.as_deref(), &read.columns)?;
                let frame = without_sessions(frame, &recipe.replaced)?;
                (frame, extents(artifacts))
            }
            Input::New(name) => {
                let missing = || Fault::bug(format!("no new {name}"));
                let LayerRows { op, artifacts } = recipe.new.get(name).ok_or_else(missing)?;
                let frame = self.artifacts(artifacts, op.as_deref()).await?;
                (frame, extents(artifacts))
            }
        };
        projected(self.narrowed(frame, &extents, read.reach)?, &read.columns)
    }

    /// Rows of more than is wanted are filtered.
    fn narrowed(
        &self,
        frame: DataFrame,
        extents: &[Extent],
        reach: Reach,
    ) -> Result<DataFrame, Fault> {
        let wanted = self.unit.recipe.extent.reached(reach);
        let no_more = |of: fn(&Extent) -> &Option<String>| {
            let mut extents = extents.iter();
            extents.all(|extent| of(extent) == of(&wanted))
        };
        let (column, value) = match (&wanted.session, &wanted.site) {
            (Some(session), _) if !no_more(|of| &of.session) => ("session", session),
            (None, Some(site)) if !no_more(|of| &of.site) => ("site", site),
            _ => return Ok(frame),
        };
        if !has(&frame, column) {
            return Ok(frame);
        }
        let filtered = frame.filter(ident(column).eq(lit(value)));
        filtered.or_fault()
    }

    /// The layer with the columns that its operator has got since, null where they may be so.
    fn grown(&self, frame: DataFrame, op: Option<&str>) -> Result<DataFrame, Fault> {
        let Some(op) = op else {
            return Ok(frame);
        };
        let columns = self.registry.get(op)?.output.columns.iter();
        let mut lacks: Vec<_> = columns.filter(|column| column.nullable).collect();
        lacks.retain(|column| !has(&frame, column.name));
        lacks.into_iter().try_fold(frame, |frame, column| {
            let null = ScalarValue::try_new_null(&column.data_type).or_fault()?;
            frame.with_column(column.name, lit(null)).or_fault()
        })
    }

    /// Refuses what another plan, or another version of evermap, wrote under a step's name where a port cannot read it.
    /// Queries name no columns here: planning them says which one is not there.
    fn check_stored(
        &self,
        name: &str,
        frame: &DataFrame,
        op: Option<&str>,
        columns: &[String],
    ) -> Result<(), Fault> {
        let Some(op) = op else {
            return Ok(());
        };
        let mut layer = self.registry.get(op)?.output.clone();
        let is_read = |name: &str| columns.iter().any(|read| read == name);
        layer.columns.retain(|column| is_read(column.name));
        let misfits = misfits(frame.schema().as_arrow(), &layer);
        let Some(misfit) = misfits.first() else {
            return Ok(());
        };
        Err(Fault::user(format!(
            "`previous.{name}` {misfit}: another plan, or another version of evermap, wrote the layer {name} of this map; map its sessions into a new folder"
        )))
    }

    async fn artifacts(
        &self,
        artifacts: &[Artifact],
        op: Option<&str>,
    ) -> Result<DataFrame, Fault> {
        if !artifacts.is_empty() {
            return read_artifacts(&self.context, self.store, artifacts).await;
        }
        let schema = match op {
            Some(op) => self.registry.get(op)?.output.schema(),
            None => Arc::new(Schema::empty()),
        };
        let empty = self.context.read_batch(RecordBatch::new_empty(schema));
        empty.or_fault()
    }
}

fn extents(artifacts: &[Artifact]) -> Vec<Extent> {
    let extents = artifacts.iter().map(|artifact| artifact.extent.clone());
    extents.collect()
}

fn has(frame: &DataFrame, column: &str) -> bool {
    frame.schema().field_with_unqualified_name(column).is_ok()
}

fn without_sessions(frame: DataFrame, without: &[String]) -> Result<DataFrame, Fault> {
    if without.is_empty() || !has(&frame, "session") {
        return Ok(frame);
    }
    let without = without.iter().map(|session| lit(session.clone())).collect();
    let filtered = frame.filter(ident("session").in_list(without, true));
    filtered.or_fault()
}

/// The table with just these columns, as far as it has them; all where none are named.
fn projected(frame: DataFrame, columns: &[String]) -> Result<DataFrame, Fault> {
    if columns.is_empty() {
        return Ok(frame);
    }
    let kept: Vec<_> = columns
        .iter()
        .filter(|column| has(&frame, column))
        .collect();
    let projected = frame.select(kept.into_iter().map(ident));
    projected.or_fault()
}
