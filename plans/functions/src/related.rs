//! `related(graph, class, relation, class)`.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, BooleanArray, StringArray};
use arrow::datatypes::DataType;
use datafusion::common::{DataFusionError, Result, plan_err};
use datafusion::logical_expr::{
    ColumnarValue, DocSection, Documentation, ScalarFunctionArgs, ScalarUDFImpl, Signature,
    Volatility,
};
use evermap_algorithms::semantic_map::semantic_graph::{Relation, offset};

use crate::graphs::{Geometry, Graphs, is_graph, no_graph};

/// The function's name.
pub(crate) const NAME: &str = "related";

/// Whether an area of one class is so related to an area of another.
#[derive(Debug, PartialEq, Eq, Hash)]
pub(crate) struct Related {
    signature: Signature,
    documentation: Documentation,
}

impl Default for Related {
    fn default() -> Self {
        Self {
            signature: Signature::user_defined(Volatility::Immutable),
            documentation: documentation(),
        }
    }
}

impl ScalarUDFImpl for Related {
    fn name(&self) -> &str {
        NAME
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn coerce_types(&self, given: &[DataType]) -> Result<Vec<DataType>> {
        match given {
            [graph, _, _, _] if is_graph(graph) => Ok(vec![
                graph.clone(),
                DataType::Utf8,
                DataType::Utf8,
                DataType::Utf8,
            ]),
            [found, _, _, _] => no_graph(NAME, found),
            _ => plan_err!("related expects (graph, class, relation, class)"),
        }
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(DataType::Boolean)
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let [graphs, first, relation, second] = columns.as_slice() else {
            return plan_err!("related expects (graph, class, relation, class)");
        };
        let asked = RelationColumns {
            first: first.as_string(),
            relation: relation.as_string(),
            second: second.as_string(),
        };
        Ok(ColumnarValue::Array(Arc::new(asked.related(graphs)?)))
    }

    fn documentation(&self) -> Option<&Documentation> {
        Some(&self.documentation)
    }
}

fn documentation() -> Documentation {
    let about = "Whether an area of one class is so related to an area of another → bool";
    let call = "related(graph, class, relation, other)";
    let relations = "where the first is from the second: `left of`, `right of`, `above` … (eight directions), `on`, `touches`";
    Documentation::builder(DocSection::default(), about, call)
        .with_argument("graph", "the graph of a view")
        .with_argument("class", "the first class")
        .with_argument("relation", relations)
        .with_argument("other", "the second class")
        .with_sql_example("SELECT view FROM views WHERE related(graph, 'car', 'on', 'road') -- car")
        .build()
}

/// What is asked of each row.
struct RelationColumns<'a> {
    first: &'a StringArray,
    relation: &'a StringArray,
    second: &'a StringArray,
}

impl RelationColumns<'_> {
    fn related(&self, column: &ArrayRef) -> Result<BooleanArray> {
        let graphs = Graphs::of(column)?;
        let geometry = graphs.geometry()?;
        let mut parsed: Option<(&str, Relation)> = None;
        let row = |row: usize| -> Result<Option<bool>> {
            let words = [self.first, self.relation, self.second];
            if graphs.is_null(row) || words.iter().any(|word| word.is_null(row)) {
                return Ok(None);
            }
            let word = self.relation.value(row);
            let relation = match parsed {
                Some((known, relation)) if known == word => relation,
                _ => Relation::parse(word)
                    .map_err(|error| DataFusionError::Plan(error.to_string()))?,
            };
            parsed = Some((word, relation));
            let classes = [self.first.value(row), self.second.value(row)];
            Ok(Some(holds(&graphs, &geometry, row, relation, classes)))
        };
        (0..graphs.len()).map(row).collect()
    }
}

fn holds(
    graphs: &Graphs<'_>,
    geometry: &Geometry<'_>,
    row: usize,
    relation: Relation,
    classes: [&str; 2],
) -> bool {
    let areas = graphs.areas(row);
    let circle = geometry.circle_px(row);
    let is_so = |one: usize, other: usize| {
        other != one
            && graphs.class(one) == classes[0]
            && graphs.class(other) == classes[1]
            && relation.fits(offset(geometry.centre(other), geometry.centre(one), circle))
    };
    if relation.needs_contact() {
        // Edges to areas that do not exist are passed over.
        return geometry
            .contacts(row)
            .filter(|ends| ends.iter().all(|end| *end < areas.len()))
            .map(|ends| ends.map(|end| areas.start + end))
            .any(|[a, b]| is_so(a, b) || is_so(b, a));
    }
    let ones = areas.clone();
    ones.filter(|one| graphs.class(*one) == classes[0])
        .any(|one| areas.clone().any(|other| is_so(one, other)))
}
