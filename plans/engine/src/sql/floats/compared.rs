//! Floating point numbers that are compared by their bits: in lists, by `CASE`, where each is counted once, and where rows are
//! sorted. There -0.0 would be less than 0.0, and NaN with a sign, as `0.0 / 0.0` has it, less than all numbers. Groups, joins
//! and operators of DataFusion know of zeros.

use std::sync::Arc;

use arrow::array::{
    Array, ArrayRef, AsArray, FixedSizeListArray, GenericListArray, OffsetSizeTrait,
};
use arrow::datatypes::{
    ArrowPrimitiveType, DataType, FieldRef, Float16Type, Float32Type, Float64Type,
};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::common::{Column, DFSchema, Result, ScalarValue, exec_err};
use datafusion::logical_expr::expr::{Case, Cast, InList, ScalarFunction, Sort};
use datafusion::logical_expr::expr_rewriter::NamePreserver;
use datafusion::logical_expr::utils::merge_schema;
use datafusion::logical_expr::{
    ColumnarValue, Distinct, Expr, ExprSchemable, LogicalPlan, Projection, ReturnFieldArgs,
    ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature, Volatility, Window,
};
use datafusion::optimizer::AnalyzerRule;

/// Functions that compare their arguments, or items of them, by bits.
const COMPARING: [&str; 9] = [
    "nullif",
    "array_has",
    "array_has_all",
    "array_has_any",
    "array_position",
    "array_positions",
    "array_remove",
    "array_remove_n",
    "array_remove_all",
];

/// What [`Compared`] is called.
const COMPARED: &str = "compared";

/// The rule that puts [`Compared`] around numbers that are compared by bits, behind type coercion.
#[derive(Debug)]
pub struct ComparedFloats;

impl AnalyzerRule for ComparedFloats {
    fn name(&self) -> &str {
        "compared_floats"
    }

    fn analyze(&self, plan: LogicalPlan, _: &ConfigOptions) -> Result<LogicalPlan> {
        Ok(plan.transform_up_with_subqueries(of_node)?.data)
    }
}

fn of_node(plan: LogicalPlan) -> Result<Transformed<LogicalPlan>> {
    let schema = merge_schema(&plan.inputs());
    let names = NamePreserver::new(&plan);
    let plan = plan.map_expressions(|expr| {
        let name = names.save(&expr);
        let found = expr.transform_up(|part| Ok(within(part, &schema)))?;
        Ok(found.update_data(|expr| name.restore(expr)))
    })?;
    Ok(match plan.data {
        LogicalPlan::Sort(mut sort) => {
            sorted(&mut sort.expr, &schema);
            Transformed::yes(LogicalPlan::Sort(sort))
        }
        // What rows are told apart by leads the order, as it stands.
        LogicalPlan::Distinct(Distinct::On(mut distinct)) => {
            all_compared(&mut distinct.on_expr, &schema);
            sorted(
                distinct.sort_expr.as_deref_mut().unwrap_or_default(),
                &schema,
            );
            Transformed::yes(LogicalPlan::Distinct(Distinct::On(distinct)))
        }
        LogicalPlan::Window(window) => of_window(window)?,
        data => Transformed::new(data, plan.transformed, plan.tnr),
    })
}

/// Numbers that windows go by become columns below them: windows of one node have the same keys, and each is rewritten by
/// itself.
fn of_window(mut window: Window) -> Result<Transformed<LogicalPlan>> {
    let schema = Arc::clone(window.input.schema());
    let mut keys: Vec<Expr> = Vec::new();
    let names = NamePreserver::new_for_projection();
    let terms = std::mem::take(&mut window.window_expr).into_iter();
    let terms = terms.map(|term| {
        let name = names.save(&term);
        let term = term.transform_up(|part| Ok(by_columns(part, &schema, &mut keys)))?;
        Ok(name.restore(term.data))
    });
    window.window_expr = terms.collect::<Result<_>>()?;
    let input = match keys.is_empty() {
        true => window.input,
        false => {
            let columns = schema.iter().map(|field| Expr::Column(Column::from(field)));
            let keys = keys.into_iter().enumerate();
            let keys = keys.map(|(at, key)| key.alias(key_name(&schema, at)));
            let columns = columns.chain(keys).collect();
            Arc::new(LogicalPlan::Projection(Projection::try_new(
                columns,
                window.input,
            )?))
        }
    };
    // The columns of a window below are among those of this one.
    let window = Window::try_new(window.window_expr, input)?;
    Ok(Transformed::yes(LogicalPlan::Window(window)))
}

/// A name that no column below has: each window has more of them than the one below it.
fn key_name(schema: &DFSchema, at: usize) -> String {
    format!("__{COMPARED}_{}", schema.fields().len() + at)
}

/// A window that goes by columns where it went by numbers, which are added to those that are there.
fn by_columns(mut term: Expr, schema: &DFSchema, keys: &mut Vec<Expr>) -> Transformed<Expr> {
    let Expr::WindowFunction(call) = &mut term else {
        return Transformed::no(term);
    };
    let params = &mut call.params;
    let by = params.partition_by.iter_mut();
    let by = by.chain(params.order_by.iter_mut().map(|sort| &mut sort.expr));
    let mut is_changed = false;
    for key in by {
        if compared(key, schema) {
            let at = keys.iter().position(|known| known == key);
            let at = at.unwrap_or_else(|| {
                keys.push(key.clone());
                keys.len() - 1
            });
            *key = Expr::Column(Column::new_unqualified(key_name(schema, at)));
            is_changed = true;
        }
    }
    match is_changed {
        true => Transformed::yes(term),
        false => Transformed::no(term),
    }
}

/// A term whose own parts are compared.
fn within(mut term: Expr, schema: &DFSchema) -> Transformed<Expr> {
    let is_changed = match &mut term {
        Expr::InList(InList { expr, list, .. }) if !list.iter().all(is_plain) => {
            let is_changed = all_compared(list, schema);
            compared(expr, schema) || is_changed
        }
        Expr::Case(Case {
            expr: Some(expr),
            when_then_expr,
            ..
        }) => {
            let whens = when_then_expr.iter_mut();
            let whens = whens.map(|(when, _)| compared(when, schema));
            let is_changed = whens.fold(false, |before, when| before | when);
            compared(expr, schema) || is_changed
        }
        Expr::ScalarFunction(call) if COMPARING.contains(&call.func.name()) => {
            all_compared(&mut call.args, schema)
        }
        Expr::AggregateFunction(call) => {
            let is_distinct = call.params.distinct;
            let args = is_distinct && all_compared(&mut call.params.args, schema);
            // A percentile's order is that of its argument.
            let is_sorted = is_distinct || !call.func.supports_within_group_clause();
            is_sorted && sorted(&mut call.params.order_by, schema) || args
        }
        Expr::WindowFunction(call) => {
            let params = &mut call.params;
            params.distinct && all_compared(&mut params.args, schema)
        }
        _ => false,
    };
    match is_changed {
        true => Transformed::yes(term),
        false => Transformed::no(term),
    }
}

fn sorted(keys: &mut [Sort], schema: &DFSchema) -> bool {
    let keys = keys.iter_mut().map(|key| compared(&mut key.expr, schema));
    keys.fold(false, |before, key| before | key)
}

fn all_compared(values: &mut [Expr], schema: &DFSchema) -> bool {
    let values = values.iter_mut().map(|value| compared(value, schema));
    values.fold(false, |before, value| before | value)
}

/// Puts [`Compared`] around a term, if it is one of floating point numbers; whether it is.
fn compared(value: &mut Expr, schema: &DFSchema) -> bool {
    let is_compared = matches!(&*value, Expr::ScalarFunction(call) if call.func.name() == COMPARED);
    if is_compared || !value.get_type(schema).is_ok_and(|kind| is_of_floats(&kind)) {
        return false;
    }
    let args = vec![std::mem::take(value)];
    let function = Arc::new(ScalarUDF::new_from_impl(Compared::default()));
    *value = Expr::ScalarFunction(ScalarFunction::new_udf(function, args));
    true
}

/// Whether a value is written that is equal to nothing that has other bits.
fn is_plain(value: &Expr) -> bool {
    let value = match value {
        Expr::Cast(Cast { expr, .. }) => expr.as_ref(),
        value => value,
    };
    let number = value
        .as_literal()
        .map(|value| value.cast_to(&DataType::Float64));
    match number {
        Some(Ok(ScalarValue::Float64(number))) => {
            number.is_none_or(|number| number != 0.0 && !number.is_nan())
        }
        _ => false,
    }
}

fn is_of_floats(kind: &DataType) -> bool {
    match kind {
        DataType::List(item) | DataType::LargeList(item) | DataType::FixedSizeList(item, _) => {
            is_of_floats(item.data_type())
        }
        kind => kind.is_floating(),
    }
}

/// Floating point numbers, of which those that are equal have the same bits.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Compared {
    signature: Signature,
}

impl Default for Compared {
    fn default() -> Self {
        Self {
            signature: Signature::any(1, Volatility::Immutable),
        }
    }
}

impl ScalarUDFImpl for Compared {
    fn name(&self) -> &str {
        COMPARED
    }

    /// As that of what is compared: a column of a query is called by it.
    fn schema_name(&self, args: &[Expr]) -> Result<String> {
        let names = args.iter().map(|arg| arg.schema_name().to_string());
        Ok(names.collect())
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, types: &[DataType]) -> Result<DataType> {
        match types {
            [kind] => Ok(kind.clone()),
            others => exec_err!("expected one number, found {}", others.len()),
        }
    }

    fn return_field_from_args(&self, args: ReturnFieldArgs) -> Result<FieldRef> {
        match args.arg_fields {
            [field] => Ok(Arc::clone(field)),
            others => exec_err!("expected one number, found {}", others.len()),
        }
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        match args.args.as_slice() {
            [ColumnarValue::Array(values)] => Ok(ColumnarValue::Array(plain(values)?)),
            [ColumnarValue::Scalar(value)] => {
                let plain = plain(&value.to_array()?)?;
                Ok(ColumnarValue::Scalar(ScalarValue::try_from_array(
                    &plain, 0,
                )?))
            }
            others => exec_err!("expected one number, found {}", others.len()),
        }
    }
}

type Half = <Float16Type as ArrowPrimitiveType>::Native;

/// Values with one zero and one NaN.
fn plain(values: &ArrayRef) -> Result<ArrayRef> {
    Ok(match values.data_type() {
        DataType::Float16 => numbers::<Float16Type>(values, Half::ZERO, Half::NAN),
        DataType::Float32 => numbers::<Float32Type>(values, 0.0, f32::NAN),
        DataType::Float64 => numbers::<Float64Type>(values, 0.0, f64::NAN),
        DataType::List(item) => list::<i32>(values, item)?,
        DataType::LargeList(item) => list::<i64>(values, item)?,
        DataType::FixedSizeList(item, size) => {
            let lists = values.as_fixed_size_list();
            let (items, nulls) = (plain(lists.values())?, lists.nulls().cloned());
            let (item, count) = (Arc::clone(item), lists.len());
            let lists = FixedSizeListArray::try_new_with_length(item, *size, items, nulls, count)?;
            Arc::new(lists)
        }
        _ => Arc::clone(values),
    })
}

fn numbers<T: ArrowPrimitiveType>(values: &ArrayRef, zero: T::Native, nan: T::Native) -> ArrayRef {
    let plain = |value: T::Native| match value.partial_cmp(&value) {
        None => nan,
        Some(_) if value == zero => zero,
        Some(_) => value,
    };
    Arc::new(values.as_primitive::<T>().unary::<_, T>(plain))
}

fn list<O: OffsetSizeTrait>(values: &ArrayRef, item: &FieldRef) -> Result<ArrayRef> {
    let lists = values.as_list::<O>();
    let (offsets, nulls) = (lists.offsets().clone(), lists.nulls().cloned());
    let items = plain(lists.values())?;
    let lists = GenericListArray::<O>::try_new(Arc::clone(item), offsets, items, nulls)?;
    Ok(Arc::new(lists))
}
