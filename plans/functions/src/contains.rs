//! `contains(graph, class [, count])`.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, BooleanArray};
use arrow::datatypes::{DataType, Int64Type};
use datafusion::common::{Result, plan_err};
use datafusion::functions::string;
use datafusion::logical_expr::{
    ColumnarValue, DocSection, Documentation, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl,
    Signature, Volatility,
};

use crate::graphs::{Graphs, is_graph, no_graph};

/// The function's name.
pub(crate) const NAME: &str = "contains";

/// Whether a view shows areas of a class; on text, whether one text has another in it.
#[derive(Debug, PartialEq, Eq, Hash)]
pub(crate) struct Contains {
    signature: Signature,
    text: Arc<ScalarUDF>,
    documentation: Documentation,
}

impl Default for Contains {
    fn default() -> Self {
        Self {
            signature: Signature::user_defined(Volatility::Immutable),
            text: string::contains(),
            documentation: documentation(),
        }
    }
}

impl ScalarUDFImpl for Contains {
    fn name(&self) -> &str {
        NAME
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn coerce_types(&self, given: &[DataType]) -> Result<Vec<DataType>> {
        match given {
            [graph, _] if is_graph(graph) => Ok(vec![graph.clone(), DataType::Utf8]),
            [graph, _, count] if is_graph(graph) && (count.is_integer() || count.is_null()) => {
                Ok(vec![graph.clone(), DataType::Utf8, DataType::Int64])
            }
            [graph, ..] if is_graph(graph) => {
                plan_err!(
                    "contains expects (graph, class) or (graph, class, count), a whole number"
                )
            }
            [text, part] if !text.is_nested() && !part.is_nested() => {
                Ok(vec![DataType::Utf8, DataType::Utf8])
            }
            [found, ..] => no_graph(NAME, found),
            [] => plan_err!("contains expects (graph, class [, count])"),
        }
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(DataType::Boolean)
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        if !args
            .args
            .first()
            .is_some_and(|first| is_graph(&first.data_type()))
        {
            return self.text.inner().invoke_with_args(args);
        }
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let [graphs, classes, counts @ ..] = columns.as_slice() else {
            return plan_err!("contains expects (graph, class [, count])");
        };
        let found = contains(graphs, classes, counts.first())?;
        Ok(ColumnarValue::Array(Arc::new(found)))
    }

    fn documentation(&self) -> Option<&Documentation> {
        Some(&self.documentation)
    }
}

fn documentation() -> Documentation {
    let about = "Whether a view shows areas of a class, so many at least → bool";
    Documentation::builder(DocSection::default(), about, "contains(graph, class)")
        .with_alternative_syntax("contains(graph, class, count)")
        .with_alternative_syntax("contains(text, part)")
        .with_argument("graph", "the graph of a view")
        .with_argument("class", "a class of the graph's areas")
        .with_argument("count", "areas at least; 1 where it is not given")
        .with_argument("text", "a text")
        .with_argument("part", "a text that may be in it")
        .with_sql_example("SELECT contains('a red car', 'car') -- true")
        .build()
}

fn contains(
    graphs: &ArrayRef,
    classes: &ArrayRef,
    counts: Option<&ArrayRef>,
) -> Result<BooleanArray> {
    let graphs = Graphs::of(graphs)?;
    let classes = classes.as_string::<i32>();
    let counts = counts.map(|counts| counts.as_primitive::<Int64Type>());
    let row = |row: usize| {
        let unknown = graphs.is_null(row)
            || classes.is_null(row)
            || counts.is_some_and(|counts| counts.is_null(row));
        (!unknown).then(|| {
            let (class, least) = (
                classes.value(row),
                counts.map_or(1, |counts| counts.value(row)),
            );
            let shown = graphs
                .areas(row)
                .filter(|area| graphs.class(*area) == class);
            shown.count() as i64 >= least
        })
    };
    Ok((0..graphs.len()).map(row).collect())
}
