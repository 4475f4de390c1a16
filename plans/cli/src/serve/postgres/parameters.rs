//! What clients bind to the parameters of a query, `$1`, `$2` …, in the place of these.
//!
//! A type that a client says is written into the query, so that the query is planned as it would be with a value of that
//! type. One that nobody says follows from what stands beside the parameter; where nothing does, it is a text, as in Postgres.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::datatypes::{DataType, Field, FieldRef};
use datafusion::common::tree_node::{Transformed, TreeNode, TreeNodeRecursion};
use datafusion::common::{DFSchema, ParamValues, Result, ScalarValue};
use datafusion::logical_expr::expr::Placeholder;
use datafusion::logical_expr::{Expr, ExprSchemable, LogicalPlan};
use datafusion::sql::sqlparser::keywords::Keyword;
use datafusion::sql::sqlparser::tokenizer::{Token, TokenWithSpan};
use datafusion_postgres::arrow_pg::datatypes::df::deserialize_parameters_with_server_types;
use evermap_engine::error::fault_of;
use evermap_functions::caught;
use pgwire::api::Type;
use pgwire::api::portal::Portal;
use pgwire::api::stmt::{QueryParser, StoredStatement};
use pgwire::error::PgWireResult;

use crate::serve::postgres::expression::each_expression;
use crate::serve::postgres::tokens::{changed, tokens};
use crate::serve::postgres::values::{Bound, Value, none_of_its_type};
use crate::serve::postgres::{Prepared, TYPES, error, said};

/// Parameters of a query at most, as the protocol counts them.
const MOST: usize = u16::MAX as usize;

/// The function that `x = ANY(list)` is.
const HAS: &str = "array_has";

/// A query with the types that a client says of its parameters: `$1` is `CAST($1 AS SMALLINT)`.
///
/// Texts and exact numbers that are cast as they are stay: they are read as what they are cast to.
pub fn as_declared<'q>(query: &'q str, types: &[Option<Type>]) -> Cow<'q, str> {
    let tokens = tokens(query);
    let casts = tokens.iter().enumerate().filter_map(|(place, found)| {
        let Token::Placeholder(name) = &found.token else {
            return None;
        };
        let number = name.get(1..)?.parse::<usize>().ok()?.checked_sub(1)?;
        let declared = types.get(number)?.as_ref()?;
        let stays = is_read_as_cast(declared) && is_cast(&tokens, place);
        let cast = format!("CAST({name} AS {})", written(declared)?);
        (!stays).then_some((found.span, cast))
    });
    changed(query, casts.collect())
}

/// Types as SQL has them; `None` for those that are left to whoever reads the parameter. Exact numbers are what literals with
/// a point are.
fn written(declared: &Type) -> Option<&'static str> {
    Some(match *declared {
        Type::BOOL => "BOOLEAN",
        Type::INT2 => "SMALLINT",
        Type::INT4 => "INTEGER",
        Type::INT8 => "BIGINT",
        Type::FLOAT4 => "REAL",
        Type::FLOAT8 | Type::NUMERIC => "DOUBLE PRECISION",
        // A map has none but as texts.
        Type::TEXT | Type::VARCHAR | Type::UUID => "TEXT",
        Type::BYTEA => "BYTEA",
        Type::DATE => "DATE",
        Type::TIME => "TIME",
        Type::TIMESTAMP => "TIMESTAMP",
        Type::TIMESTAMPTZ => "TIMESTAMPTZ",
        Type::INTERVAL => "INTERVAL",
        Type::BOOL_ARRAY => "BOOLEAN[]",
        Type::INT2_ARRAY => "SMALLINT[]",
        Type::INT4_ARRAY => "INTEGER[]",
        Type::INT8_ARRAY => "BIGINT[]",
        Type::FLOAT4_ARRAY => "REAL[]",
        Type::FLOAT8_ARRAY | Type::NUMERIC_ARRAY => "DOUBLE PRECISION[]",
        Type::TEXT_ARRAY | Type::VARCHAR_ARRAY | Type::UUID_ARRAY => "TEXT[]",
        Type::DATE_ARRAY => "DATE[]",
        Type::TIMESTAMP_ARRAY => "TIMESTAMP[]",
        Type::TIMESTAMPTZ_ARRAY => "TIMESTAMPTZ[]",
        _ => return None,
    })
}

fn is_read_as_cast(declared: &Type) -> bool {
    matches!(
        *declared,
        Type::TEXT
            | Type::VARCHAR
            | Type::NUMERIC
            | Type::TEXT_ARRAY
            | Type::VARCHAR_ARRAY
            | Type::NUMERIC_ARRAY
    )
}

/// Whether a token is cast: `$1::T`, `CAST($1 AS T)`.
fn is_cast(tokens: &[TokenWithSpan], place: usize) -> bool {
    let token = |place: usize| tokens.get(place).map(|token| &token.token);
    match (place.checked_sub(1).and_then(token), token(place + 1)) {
        (_, Some(Token::DoubleColon)) => true,
        (Some(Token::LParen), Some(Token::Word(word))) => word.keyword == Keyword::AS,
        _ => false,
    }
}

/// The plan with a type for each parameter that has none yet.
///
/// # Errors
/// What planning says.
pub fn with_types(plan: LogicalPlan) -> Result<LogicalPlan> {
    if plan.get_parameter_names()?.is_empty() {
        return Ok(plan);
    }
    let plan = each_expression(plan, of_list)?;
    let known = known(&plan)?;
    let typed = each_expression(plan.clone(), |found, _| Ok(typed(found, &known)));
    // Where no text goes, a value may.
    Ok(typed.unwrap_or(plan))
}

fn is_open(parameter: &Placeholder) -> bool {
    let field = parameter.field.as_ref();
    field.is_none_or(|field| field.data_type().is_null())
}

fn nullable(kind: DataType) -> FieldRef {
    Arc::new(Field::new("", kind, true))
}

/// `x = ANY($1)` with a list of what `x` is.
fn of_list(found: Expr, schema: &DFSchema) -> Result<Transformed<Expr>> {
    let Expr::ScalarFunction(mut call) = found else {
        return Ok(Transformed::no(found));
    };
    let is_has = call.func.name() == HAS;
    let is_made = match call.args.as_mut_slice() {
        [Expr::Placeholder(list), element] if is_has && is_open(list) => {
            let item = match element.get_type(schema) {
                Ok(DataType::Null) | Err(_) => DataType::Utf8,
                Ok(DataType::Dictionary(_, value)) => *value,
                Ok(other) => other,
            };
            let item = Arc::new(Field::new_list_field(item, true));
            list.field = Some(nullable(DataType::List(item)));
            true
        }
        _ => false,
    };
    let call = Expr::ScalarFunction(call);
    Ok(match is_made {
        true => Transformed::yes(call),
        false => Transformed::no(call),
    })
}

/// The types of parameters that what stands beside them says, or what they are cast to, or that they are numbers of rows.
fn known(plan: &LogicalPlan) -> Result<BTreeMap<String, FieldRef>> {
    let (mut beside, mut otherwise) = (BTreeMap::new(), BTreeMap::new());
    plan.apply_with_subqueries(|node| {
        if let LogicalPlan::Limit(limit) = node {
            for rows in limit.skip.iter().chain(&limit.fetch) {
                if let Expr::Placeholder(parameter) = rows.as_ref() {
                    otherwise.insert(parameter.id.clone(), nullable(DataType::Int64));
                }
            }
        }
        node.apply_expressions(|expression| {
            expression.apply(|found| {
                match found {
                    Expr::Placeholder(parameter) if !is_open(parameter) => {
                        if let Some(field) = &parameter.field {
                            beside.insert(parameter.id.clone(), Arc::clone(field));
                        }
                    }
                    Expr::Cast(cast) => {
                        if let Expr::Placeholder(parameter) = cast.expr.as_ref() {
                            let kind = cast.field.data_type().clone();
                            let to = otherwise.entry(parameter.id.clone());
                            to.or_insert_with(|| nullable(kind));
                        }
                    }
                    _ => {}
                }
                Ok(TreeNodeRecursion::Continue)
            })
        })
    })?;
    otherwise.extend(beside);
    Ok(otherwise)
}

fn typed(found: Expr, known: &BTreeMap<String, FieldRef>) -> Transformed<Expr> {
    match found {
        Expr::Placeholder(mut parameter) if is_open(&parameter) => {
            let field = known.get(&parameter.id).cloned();
            parameter.field = Some(field.unwrap_or_else(|| nullable(DataType::Utf8)));
            Transformed::yes(Expr::Placeholder(parameter))
        }
        other => Transformed::no(other),
    }
}

/// The types of the parameters of a plan by their numbers, from 1 on; null where nobody knows.
fn types(plan: &LogicalPlan) -> PgWireResult<BTreeMap<usize, DataType>> {
    let fields = plan.get_parameter_fields();
    let fields = fields.map_err(|error| said(&fault_of(&error)))?;
    let numbered = |(id, field): (&String, &Option<FieldRef>)| -> PgWireResult<_> {
        let number = id.get(1..).and_then(|digits| digits.parse::<usize>().ok());
        let number = number.filter(|number| (1..=MOST).contains(number));
        let message = format!("expected parameters from $1 to ${MOST}, found {id}");
        let number = number.ok_or_else(|| error("ERROR", "42P02", &message))?;
        let kind = field.as_ref().map(|field| field.data_type().clone());
        Ok((number, kind.unwrap_or(DataType::Null)))
    };
    fields.iter().map(numbered).collect()
}

/// The types that clients are told of parameters, by their numbers.
fn told_by_number(prepared: &Prepared) -> PgWireResult<BTreeMap<usize, Type>> {
    let (_, Some((_, plan))) = prepared else {
        return Ok(BTreeMap::new());
    };
    let numbers = types(plan)?.into_keys();
    // The library has them in the order of these.
    Ok(numbers.zip(TYPES.get_parameter_types(prepared)?).collect())
}

/// The types that clients are told of parameters, from the first to the last.
///
/// # Errors
/// For more parameters than there may be, and for types that Postgres has not.
pub fn told(prepared: &Prepared) -> PgWireResult<Vec<Type>> {
    let mut told = told_by_number(prepared)?;
    let last = told.last_key_value().map_or(0, |(number, _)| *number);
    let kind = |number| told.remove(&number).unwrap_or(Type::UNKNOWN);
    Ok((1..=last).map(kind).collect())
}

/// A portal with what its client bound in the place of parameters: a portal without any.
///
/// # Errors
/// For values that are none of their types, and for too few of them; what planning says.
pub fn bound(portal: Portal<Prepared>) -> PgWireResult<Portal<Prepared>> {
    let old = &portal.statement;
    let (query, Some((statement, plan))) = &old.statement else {
        return Ok(portal);
    };
    let types = types(plan)?;
    let last = types.last_key_value().map_or(0, |(number, _)| *number);
    let count = portal.parameters.len();
    if count < last {
        let message = format!("expected {last} parameters, found {count}");
        return Err(error("ERROR", "08P01", &message));
    }
    let plan = match last {
        0 => plan.clone(),
        _ => filled(plan.clone(), values(&portal, &types)?)
            .map_err(|error| said(&fault_of(&error)))?,
    };
    let prepared = (query.clone(), Some((statement.clone(), plan)));
    let statement = StoredStatement::new(old.id.clone(), prepared, Vec::new());
    let mut again = Portal::new_cursor(portal.name.clone(), Arc::new(statement));
    again.result_column_format = portal.result_column_format.clone();
    again.state = portal.state();
    Ok(again)
}

/// The values of all parameters.
fn values(
    portal: &Portal<Prepared>,
    types: &BTreeMap<usize, DataType>,
) -> PgWireResult<Vec<Value>> {
    let told = told_by_number(&portal.statement.statement)?;
    let declared = |place: usize| {
        let declared = portal.statement.parameter_types.get(place)?.as_ref();
        declared.filter(|kind| **kind != Type::UNKNOWN)
    };
    let mut read = Vec::with_capacity(portal.parameters.len());
    for (place, bytes) in portal.parameters.iter().enumerate() {
        read.push(match (bytes, types.get(&(place + 1))) {
            // What the query does not speak of may be anything.
            (_, None) => Some(ScalarValue::Null.into()),
            (None, Some(target)) => {
                let null = ScalarValue::try_from(target);
                Some(null.unwrap_or(ScalarValue::Null).into())
            }
            (Some(bytes), Some(target)) => {
                let kind = declared(place).or_else(|| told.get(&(place + 1)));
                let bound = Bound {
                    bytes,
                    is_text: portal.parameter_format.is_text(place),
                    is_declared: declared(place).is_some(),
                    kind: kind.unwrap_or(&Type::UNKNOWN),
                    target,
                };
                bound.read()?
            }
        });
    }
    if read.iter().any(Option::is_none) {
        let theirs = by_library(portal, &read, types, &told)?;
        for (value, theirs) in read.iter_mut().zip(theirs) {
            // It makes null of what is too far or too large.
            if value.is_none() && theirs.is_null() {
                let message =
                    "expected a parameter that its type has room for, found one beyond it";
                return Err(error("ERROR", "22003", message));
            }
            value.get_or_insert_with(|| theirs.into());
        }
    }
    Ok(read.into_iter().flatten().collect())
}

/// What the library reads of those values that are not read yet, and anything in the place of others.
fn by_library(
    portal: &Portal<Prepared>,
    read: &[Option<Value>],
    types: &BTreeMap<usize, DataType>,
    told: &BTreeMap<usize, Type>,
) -> PgWireResult<Vec<ScalarValue>> {
    let mut declared = portal.statement.parameter_types.clone();
    declared.resize(read.len(), None);
    let mut parameters = portal.parameters.clone();
    for (place, read) in read.iter().enumerate() {
        if read.is_some() {
            (declared[place], parameters[place]) = (Some(Type::TEXT), None);
        }
    }
    let statement = StoredStatement::new(String::new(), (), declared);
    let mut left = Portal::new_cursor(String::new(), Arc::new(statement));
    left.parameter_format = portal.parameter_format.clone();
    left.parameters = parameters;
    let numbers = 1..=read.len();
    let types = numbers.clone().map(|number| types.get(&number));
    let types: Vec<_> = types
        .map(|kind| kind.filter(|kind| !kind.is_null()))
        .collect();
    let told: Vec<_> = numbers.map(|number| told.get(&number)).collect();
    // It panics at an interval that is cut short.
    let values = caught(|| deserialize_parameters_with_server_types(&left, &types, &told));
    match values.ok_or_else(none_of_its_type)?? {
        ParamValues::List(values) => Ok(values.into_iter().map(|value| value.value).collect()),
        ParamValues::Map(_) => Err(none_of_its_type()),
    }
}

/// The plan with values in the place of parameters.
fn filled(plan: LogicalPlan, values: Vec<Value>) -> Result<LogicalPlan> {
    let mut whole = BTreeMap::new();
    let mut given = Vec::with_capacity(values.len());
    for (place, value) in values.into_iter().enumerate() {
        whole.extend(value.whole.map(|whole| (format!("${}", place + 1), whole)));
        given.push(value.value);
    }
    let plan = match whole.is_empty() {
        true => plan,
        false => each_expression(plan, |found, _| compared(found, &whole))?,
    };
    plan.replace_params_with_values(&ParamValues::from(given))
}

/// A comparison with an exact number that is whole, as one with an integer: both sides would be rounded.
fn compared(found: Expr, whole: &BTreeMap<String, ScalarValue>) -> Result<Transformed<Expr>> {
    let compares = match &found {
        Expr::BinaryExpr(binary) => binary.op.supports_propagation(),
        Expr::Between(_) | Expr::InList(_) => true,
        Expr::ScalarFunction(call) => call.func.name() == HAS,
        _ => false,
    };
    if !compares {
        return Ok(Transformed::no(found));
    }
    found.map_children(|side| {
        let whole = exact(&side).and_then(|id| whole.get(id)).cloned();
        Ok(match whole {
            Some(whole) => Transformed::yes(Expr::Literal(whole, None)),
            None => Transformed::no(side),
        })
    })
}

/// The parameter that a side of a comparison is, where it is written as an exact number.
fn exact(side: &Expr) -> Option<&str> {
    let Expr::Cast(cast) = side else {
        return None;
    };
    let is_double = match cast.field.data_type() {
        DataType::List(item) => item.data_type() == &DataType::Float64,
        other => other == &DataType::Float64,
    };
    match cast.expr.as_ref() {
        Expr::Placeholder(parameter) if is_double => Some(&parameter.id),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
