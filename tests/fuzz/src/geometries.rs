//! Functions on geometries, given any.

use std::sync::{Arc, OnceLock};

use arrow::datatypes::{DataType, Field};
use datafusion::config::ConfigOptions;
use datafusion::logical_expr::{ColumnarValue, ScalarFunctionArgs, ScalarUDF};
use datafusion::prelude::SessionContext;
use datafusion::scalar::ScalarValue;

use crate::counted;

/// A function, and the types of arguments that it takes.
struct Call {
    function: Arc<ScalarUDF>,
    types: Vec<DataType>,
}

/// One byte for the function, then its arguments: numbers of eight bytes; geometries and texts behind their length (two).
pub fn geometries(bytes: &[u8]) {
    static CALLS: OnceLock<Vec<Call>> = OnceLock::new();
    let calls = CALLS.get_or_init(calls);
    let Some((first, mut rest)) = bytes.split_first() else {
        return;
    };
    let Call { function, types } = &calls[usize::from(*first) % calls.len()];
    let given: Option<Vec<ScalarValue>> =
        types.iter().map(|kind| argument(kind, &mut rest)).collect();
    let (Some(given), Ok(result)) = (given, function.return_type(types)) else {
        return;
    };
    let field = |kind: &DataType| Arc::new(Field::new("argument", kind.clone(), true));
    let _ = function.invoke_with_args(ScalarFunctionArgs {
        args: given.into_iter().map(ColumnarValue::Scalar).collect(),
        arg_fields: types.iter().map(field).collect(),
        number_rows: 1,
        return_field: field(&result),
        config_options: Arc::new(ConfigOptions::default()),
    });
}

/// All functions whose names are PostGIS's, in each way that they take geometries, numbers and texts.
fn calls() -> Vec<Call> {
    let context = SessionContext::new();
    evermap_functions::register(&context);
    let state = context.state();
    let mut functions: Vec<&Arc<ScalarUDF>> = state.scalar_functions().values().collect();
    functions.retain(|function| function.name().starts_with("st_"));
    functions.sort_by_key(|function| function.name());
    let of = |function: &Arc<ScalarUDF>| {
        let takes = |types: &Vec<DataType>| {
            let taken = function.coerce_types(types);
            taken.is_ok_and(|taken| taken == *types)
        };
        let call = |types| Call {
            function: Arc::clone(function),
            types,
        };
        lists()
            .into_iter()
            .filter(takes)
            .map(call)
            .collect::<Vec<_>>()
    };
    functions.into_iter().flat_map(of).collect()
}

/// All lists of at most four types.
fn lists() -> Vec<Vec<DataType>> {
    let mut lists = vec![Vec::new()];
    let mut longest = lists.clone();
    for _ in 0..4 {
        let longer = longest.iter().flat_map(|list| {
            let types = [DataType::Binary, DataType::Float64, DataType::Utf8].into_iter();
            types.map(move |kind| [list.as_slice(), &[kind]].concat())
        });
        longest = longer.collect();
        lists.extend_from_slice(&longest);
    }
    lists
}

fn argument(kind: &DataType, rest: &mut &[u8]) -> Option<ScalarValue> {
    if *kind == DataType::Float64 {
        let (number, behind) = rest.split_first_chunk()?;
        *rest = behind;
        return Some(ScalarValue::Float64(Some(f64::from_le_bytes(*number))));
    }
    let (value, behind) = counted(rest)?;
    *rest = behind;
    Some(match kind {
        DataType::Binary => ScalarValue::Binary(Some(value.to_vec())),
        _ => ScalarValue::Utf8(Some(String::from_utf8_lossy(value).into_owned())),
    })
}
