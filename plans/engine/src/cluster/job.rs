//! A wave of units as one Ballista job: the query `SELECT unit, run_unit(text)` over a manifest of units.

use std::collections::BTreeMap;
use std::fmt;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Schema};
use ballista_core::extension::SessionConfigExt;
use datafusion::datasource::MemTable;
use datafusion::error::Result as DataFusionResult;
use datafusion::execution::{FunctionRegistry, SessionState, SessionStateBuilder};
use datafusion::logical_expr::async_udf::{AsyncScalarUDF, AsyncScalarUDFImpl};
use datafusion::logical_expr::{
    ColumnarValue, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature, Volatility,
};
use datafusion::physical_plan::ExecutionPlan;
use datafusion::prelude::{SessionConfig, SessionContext, col};
use evermap_contract::Registry;
use evermap_schemas::{Fault, Kind};
use futures::FutureExt;
use futures::future::BoxFuture;

use crate::cluster::note;
use crate::error::{OrFault, external};
use crate::unit::Unit;

/// The texts of units by their numbers.
pub type UnitTexts = BTreeMap<usize, String>;

/// The text of a unit, as [`RunUnit`] reads it.
///
/// # Errors
/// A fault of ours.
pub fn unit_text(unit: &Unit) -> Result<String, Fault> {
    serde_json::to_string(unit).map_err(|error| Fault::bug(error.to_string()))
}

/// The plan of a job that runs units.
///
/// # Errors
/// A fault of ours.
pub async fn units_plan(
    units: UnitTexts,
    registry: &Registry,
) -> Result<Arc<dyn ExecutionPlan>, Fault> {
    let query = manifest(units)?;
    // One partition a unit is what the manifest has: nothing is dealt out anew.
    let config = session_config().with_target_partitions(1);
    let context = SessionContext::new_with_state(session_state(config, registry));
    let query = context.read_table(Arc::new(query)).or_fault()?;
    let done = run_unit(registry).call(vec![col("text")]);
    let query = query.select(vec![col("unit"), done]).or_fault()?;
    query.create_physical_plan().await.or_fault()
}

/// The units, each with its number in a partition of its own.
fn manifest(units: UnitTexts) -> Result<MemTable, Fault> {
    let schema = Arc::new(Schema::new(vec![
        Field::new("unit", DataType::Utf8, false),
        Field::new("text", DataType::Utf8, false),
    ]));
    let partition = |(index, text): (usize, String)| {
        let column = |text: String| -> ArrayRef { Arc::new(StringArray::from(vec![text])) };
        let columns = vec![column(index.to_string()), column(text)];
        Ok(vec![RecordBatch::try_new(Arc::clone(&schema), columns)?])
    };
    let partitions = units
        .into_iter()
        .map(partition)
        .collect::<Result<_, Fault>>()?;
    MemTable::try_new(Arc::clone(&schema), partitions).or_fault()
}

/// The SQL function that does a unit with the operators of this process: its fault as JSON, or an empty text.
struct RunUnit {
    registry: Registry,
    signature: Signature,
}

fn run_unit(registry: &Registry) -> ScalarUDF {
    let function = RunUnit {
        registry: registry.clone(),
        signature: Signature::exact(vec![DataType::Utf8], Volatility::Volatile),
    };
    AsyncScalarUDF::new(Arc::new(function)).into_scalar_udf()
}

impl RunUnit {
    fn outcomes(&self, args: ScalarFunctionArgs) -> BoxFuture<'_, DataFusionResult<ColumnarValue>> {
        let outcomes = async move {
            let texts = ColumnarValue::values_to_arrays(&args.args)?;
            let mut outcomes = Vec::new();
            for text in texts.iter().flat_map(|texts| texts.as_string::<i32>()) {
                let outcome = self.outcome(text.unwrap_or_default()).await;
                outcomes.push(outcome.map_err(external)?);
            }
            Ok(ColumnarValue::Array(Arc::new(StringArray::from(outcomes))))
        };
        outcomes.boxed()
    }

    async fn outcome(&self, text: &str) -> Result<String, Fault> {
        let unit: Unit = serde_json::from_str(text).map_err(|error| {
            Fault::bug(format!("a unit does not read: {error}"))
                .next("run the same evermap everywhere")
        })?;
        if !unit.is_wanted().await.map_err(|fault| coded(&fault))? {
            let fault = Fault::resource(format!("the run that {} is for has ended", unit.label()));
            return Err(coded(&fault));
        }
        // Whoever was at it when it was given up may have ended since.
        if unit.is_done().await.map_err(|fault| coded(&fault))? {
            return Ok(String::new());
        }
        match note::run(&unit, &self.registry).await {
            Ok(_) => Ok(String::new()),
            // What the machine was short of may be there on another one: let the task fail and be tried again.
            Err(fault) if fault.kind == Kind::Resource => Err(coded(&fault)),
            Err(fault) => {
                serde_json::to_string(&fault).map_err(|error| Fault::bug(error.to_string()))
            }
        }
    }
}

/// A remote error arrives as a string: the code at its front lets the other side read it back.
fn coded(fault: &Fault) -> Fault {
    Fault::new(fault.kind, fault.coded())
}

impl AsyncScalarUDFImpl for RunUnit {
    // Its future is boxed once: `crate::erased`.
    fn invoke_async_with_args<'a, 'all>(
        &'a self,
        args: ScalarFunctionArgs,
    ) -> BoxFuture<'all, DataFusionResult<ColumnarValue>>
    where
        'a: 'all,
        Self: 'all,
    {
        self.outcomes(args)
    }
}

impl ScalarUDFImpl for RunUnit {
    fn name(&self) -> &str {
        "run_unit"
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> DataFusionResult<DataType> {
        Ok(DataType::Utf8)
    }

    fn invoke_with_args(&self, _: ScalarFunctionArgs) -> DataFusionResult<ColumnarValue> {
        Err(external(Fault::bug("a unit is run asynchronously")))
    }
}

// A process has one list of operators, and so one such function.
impl PartialEq for RunUnit {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for RunUnit {}

impl Hash for RunUnit {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}

impl fmt::Debug for RunUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RunUnit")
    }
}

/// The configuration of all sessions of a cluster.
pub fn session_config() -> SessionConfig {
    SessionConfig::new_with_ballista().with_ballista_adaptive_query_planner(false)
}

/// The state of a session with this configuration, which knows how to do units.
pub fn session_state(config: SessionConfig, registry: &Registry) -> SessionState {
    let mut state = SessionStateBuilder::new()
        .with_default_features()
        .with_config(config)
        .build();
    // It replaces nothing, and so cannot fail.
    let _ = state.register_udf(Arc::new(run_unit(registry)));
    state
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::digest::digest;
    use crate::map::lease::Lease;
    use crate::map::receipt::{Artifact, Extent, Receipt, Recipe};
    use crate::map::store::Store;
    use crate::sql::Limits;

    #[tokio::test]
    async fn what_is_done_when_its_turn_comes_is_not_done_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let lease = Lease::of_run(&store).await.unwrap();
        let unit = Unit {
            store: store.url().to_string(),
            recipe: Recipe::new(Arc::from([]), Extent::default()),
            logs: Vec::new(),
            limits: Limits::default(),
            lease: lease.name().to_owned(),
        };
        let function = RunUnit {
            registry: Registry::default(),
            signature: Signature::exact(vec![DataType::Utf8], Volatility::Volatile),
        };
        let text = unit_text(&unit).unwrap();
        // Were it done, it would be found to have nothing to do.
        let said = function.outcome(&text).await.unwrap();
        assert!(said.contains("a unit without stages"), "{said}");

        let artifact = Artifact {
            content: digest(b"rows"),
            rows: 1,
            bytes: 4,
            extent: Extent::default(),
        };
        let receipt = Receipt {
            digest: unit.recipe.digest().unwrap(),
            recipe: unit.recipe.clone(),
            artifact: artifact.clone(),
            skipped: BTreeMap::new(),
            log_losses: BTreeMap::new(),
            started: 0,
            seconds: 0.0,
            nodes: Vec::new(),
        };
        receipt.write(&store).await.unwrap();
        let without_rows = function.outcome(&text).await.unwrap();
        assert_eq!(without_rows, said);
        store
            .write(&artifact.name(), b"rows".to_vec())
            .await
            .unwrap();
        assert_eq!(function.outcome(&text).await.unwrap(), "");
    }
}
