//! A member of a null struct is null, and one that is not there is told with those that are, however it is named.
//!
//! Arrow keeps the members of a struct as columns of their own, which may hold anything where the struct is null; a
//! member that may not be null holds 0. DataFusion's `get_field` hands out that column as it is, until its release 56
//! (apache/datafusion#25122). Here it is masked, where the struct may be null.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef};
use arrow::compute::{is_null, nullif};
use arrow::datatypes::{DataType, Field, FieldRef};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::{Transformed, TreeNode, TreeNodeRecursion};
use datafusion::common::{DFSchema, Result, TableReference, exec_err};
use datafusion::execution::FunctionRegistry;
use datafusion::functions::core::get_field;
use datafusion::functions::core::getfield::GetFieldFunc;
use datafusion::logical_expr::expr::{Expr, GetFieldAccess, ScalarFunction};
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::planner::{ExprPlanner, PlannerResult, RawFieldAccessExpr};
use datafusion::logical_expr::{
    ColumnarValue, ExprSchemable, LogicalPlan, ReturnFieldArgs, ScalarFunctionArgs, ScalarUDF,
    ScalarUDFImpl, Signature, Volatility,
};
use datafusion::prelude::SessionContext;
use evermap_language::listed;
use evermap_schemas::Fault;

use crate::error::external;

/// That a plan names members which are there. Where a column is given, planning has found out; what stands in a condition
/// it passes over.
///
/// # Errors
/// That a struct has no member of a name, with those that it has.
pub fn check_members(plan: &LogicalPlan) -> Result<()> {
    let check = |expr: &Expr| match expr {
        Expr::ScalarFunction(call) => match call.func.inner().downcast_ref::<NoMember>() {
            Some(missing) => Err(external(missing.fault())),
            None => Ok(TreeNodeRecursion::Continue),
        },
        _ => Ok(TreeNodeRecursion::Continue),
    };
    plan.apply_with_subqueries(|node| node.apply_expressions(|expr| expr.apply(check)))?;
    Ok(())
}

/// Looks at `pose['x']` and `pose.x` before they are planned, and refuses a member that the struct does not have.
#[derive(Debug)]
pub struct Members;

impl ExprPlanner for Members {
    fn plan_field_access(
        &self,
        access: RawFieldAccessExpr,
        schema: &DFSchema,
    ) -> Result<PlannerResult<RawFieldAccessExpr>> {
        if let GetFieldAccess::NamedStructField { name } = &access.field_access
            && let Some(Some(name)) = name.try_as_str()
            && let Ok(found) = access.expr.get_type(schema)
            && let Some(missing) =
                NoMember::of(&found, name, || access.expr.schema_name().to_string())
        {
            return Err(external(missing.fault()));
        }
        Ok(PlannerResult::Original(access))
    }

    /// An error would be passed over here: what takes the member's place tells it.
    fn plan_compound_identifier(
        &self,
        field: &Field,
        _: Option<&TableReference>,
        names: &[String],
    ) -> Result<PlannerResult<Vec<Expr>>> {
        let mut found = field.data_type();
        for (index, name) in names.iter().enumerate() {
            let whole = || {
                let path = [field.name()].into_iter().chain(&names[..index]);
                path.map(String::as_str).collect::<Vec<_>>().join(".")
            };
            if let Some(missing) = NoMember::of(found, name, whole) {
                let function = ScalarUDF::new_from_impl(missing);
                return Ok(PlannerResult::Planned(function.call(Vec::new())));
            }
            let DataType::Struct(members) = found else {
                break;
            };
            let Some((_, member)) = members.find(name) else {
                break;
            };
            found = member.data_type();
        }
        Ok(PlannerResult::Original(Vec::new()))
    }
}

/// Stands where a member is named that a struct does not have, and tells so when it is asked for its type.
#[derive(Debug, PartialEq, Eq, Hash)]
struct NoMember {
    /// The struct, as it was named.
    whole: String,
    name: String,
    /// The members that there are; `None` where it is no struct but a list of them.
    known: Option<String>,
    signature: Signature,
}

impl NoMember {
    /// That values of a type have no member of this name; `None` where they have, or are neither structs nor lists.
    fn of(found: &DataType, name: &str, whole: impl FnOnce() -> String) -> Option<Self> {
        let known = match found {
            DataType::Struct(members) if members.find(name).is_some() => return None,
            DataType::Struct(members) => {
                Some(listed(members.iter().map(|member| member.name().as_str())))
            }
            DataType::List(_) | DataType::LargeList(_) | DataType::FixedSizeList(..) => None,
            _ => return None,
        };
        Some(Self {
            whole: whole(),
            name: name.to_owned(),
            known,
            signature: Signature::nullary(Volatility::Immutable),
        })
    }

    fn fault(&self) -> Fault {
        let Self {
            whole, name, known, ..
        } = self;
        match known {
            Some(known) => Fault::user(format!("`{whole}` has no member `{name}`"))
                .next(format!("there are {known}")),
            None => Fault::user(format!("`{whole}` is a list, which has no member `{name}`")).next(
                format!("take it of one item, {whole}[1]['{name}'], or of each: unnest({whole})"),
            ),
        }
    }
}

impl ScalarUDFImpl for NoMember {
    fn name(&self) -> &str {
        "member"
    }

    fn schema_name(&self, _: &[Expr]) -> Result<String> {
        Ok(format!("{}[{}]", self.whole, self.name))
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Err(external(self.fault()))
    }

    fn invoke_with_args(&self, _: ScalarFunctionArgs) -> Result<ColumnarValue> {
        Err(external(self.fault()))
    }
}

/// Has members of null structs be null in the queries of a context.
///
/// # Errors
/// When the rule cannot be registered.
pub fn mask_members(context: &SessionContext) -> Result<()> {
    let state = context.state_ref();
    let rule = Arc::new(MaskMembers);
    state.write().register_function_rewrite(rule)
}

/// Puts [`MaskedMember`] in the place of `get_field`.
#[derive(Debug)]
struct MaskMembers;

impl FunctionRewrite for MaskMembers {
    fn name(&self) -> &str {
        "mask_members"
    }

    fn rewrite(
        &self,
        expr: Expr,
        schema: &DFSchema,
        _: &ConfigOptions,
    ) -> Result<Transformed<Expr>> {
        match expr {
            Expr::ScalarFunction(call) if call.func.inner().is::<GetFieldFunc>() => {
                let mut args = call.args.into_iter();
                let Some(whole) = args.next() else {
                    return exec_err!("get_field: expected a struct and the name of a member");
                };
                let masked = args.fold(whole, |whole, name| member(whole, name, schema));
                Ok(Transformed::yes(masked))
            }
            expr => Ok(Transformed::no(expr)),
        }
    }
}

/// A member of a struct, masked where that may be null; of what is no struct, what `get_field` makes of it.
fn member(whole: Expr, name: Expr, schema: &DFSchema) -> Expr {
    let is_struct = matches!(whole.get_type(schema), Ok(DataType::Struct(_)));
    let func = match is_struct && whole.nullable(schema).unwrap_or(true) {
        true => ScalarUDF::new_from_impl(MaskedMember::default()).into(),
        false => get_field(),
    };
    Expr::ScalarFunction(ScalarFunction::new_udf(func, vec![whole, name]))
}

/// As `get_field` with one name, and null where the struct is.
#[derive(Debug, Default, PartialEq, Eq, Hash)]
struct MaskedMember {
    inner: GetFieldFunc,
}

impl ScalarUDFImpl for MaskedMember {
    fn name(&self) -> &str {
        "member"
    }

    fn schema_name(&self, args: &[Expr]) -> Result<String> {
        self.inner.schema_name(args)
    }

    fn signature(&self) -> &Signature {
        self.inner.signature()
    }

    fn coerce_types(&self, types: &[DataType]) -> Result<Vec<DataType>> {
        self.inner.coerce_types(types)
    }

    fn return_type(&self, types: &[DataType]) -> Result<DataType> {
        self.inner.return_type(types)
    }

    fn return_field_from_args(&self, args: ReturnFieldArgs) -> Result<FieldRef> {
        self.inner.return_field_from_args(args)
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let whole = args.args.first().cloned();
        match (self.inner.invoke_with_args(args)?, whole) {
            (ColumnarValue::Array(member), Some(ColumnarValue::Array(whole))) => {
                Ok(ColumnarValue::Array(masked(member, &whole)?))
            }
            (member, _) => Ok(member),
        }
    }
}

fn masked(member: ArrayRef, whole: &ArrayRef) -> Result<ArrayRef> {
    if whole.null_count() == 0 {
        return Ok(member);
    }
    Ok(nullif(&member, &is_null(whole)?)?)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::array::{Float64Array, RecordBatch, StructArray};
    use arrow::datatypes::{Fields, Schema};
    use arrow::util::display::array_value_to_string;

    use super::*;
    use crate::sql::{Limits, context, read_only};

    /// Two rows: a pose with a place, and none, whose x is 7 all the same.
    fn poses() -> RecordBatch {
        let x: ArrayRef = Arc::new(Float64Array::from(vec![1.0, 7.0]));
        let place = Fields::from(vec![Field::new("x", DataType::Float64, false)]);
        let places = StructArray::new(place.clone(), vec![x], None);
        let pose = Fields::from(vec![Field::new("place", DataType::Struct(place), false)]);
        let known = Some(vec![true, false].into());
        let poses = StructArray::new(pose.clone(), vec![Arc::new(places)], known);
        let schema = Schema::new(vec![Field::new("pose", DataType::Struct(pose), true)]);
        RecordBatch::try_new(Arc::new(schema), vec![Arc::new(poses)]).unwrap()
    }

    #[tokio::test]
    async fn a_member_of_a_list_is_told_with_how_its_items_are_taken() {
        let context = context(Limits::one_partition()).unwrap();
        context.register_batch("poses", poses()).unwrap();
        let rows = "(SELECT make_array(pose) AS listed FROM poses) AS many";
        for query in ["SELECT listed['place']", "SELECT 1 AS one, listed['place']"] {
            let query = format!("{query} FROM {rows}");
            let fault = read_only(&context, &query).await.err().unwrap();
            let said = "`many.listed` is a list, which has no member `place`";
            assert_eq!(fault.message, said);
            let next =
                "take it of one item, many.listed[1]['place'], or of each: unnest(many.listed)";
            assert_eq!(fault.next, next);
        }
        let taken = format!("SELECT listed[1]['place'] FROM {rows}");
        assert!(read_only(&context, &taken).await.is_ok());
    }

    #[tokio::test]
    async fn a_member_that_is_not_there_is_told_with_those_that_are() {
        let context = context(Limits::one_partition()).unwrap();
        context.register_batch("poses", poses()).unwrap();
        for (query, whole, name, known) in [
            (
                "SELECT pose['place']['xx'] FROM poses",
                "poses.pose[place]",
                "xx",
                "x",
            ),
            ("SELECT pose.place.xx FROM poses", "pose.place", "xx", "x"),
            ("SELECT pose.xx, pose.yy FROM poses", "pose", "xx", "place"),
            (
                "SELECT p.pose.plac FROM poses AS p",
                "pose",
                "plac",
                "place",
            ),
            (
                "SELECT pose.plac.x AS x FROM poses",
                "pose",
                "plac",
                "place",
            ),
            (
                "SELECT 1 FROM poses WHERE pose.place.xx > 1",
                "pose.place",
                "xx",
                "x",
            ),
            (
                "SELECT pose FROM poses ORDER BY pose.place.xx",
                "pose.place",
                "xx",
                "x",
            ),
            (
                "SELECT (SELECT pose.place.xx FROM poses LIMIT 1) AS first",
                "pose.place",
                "xx",
                "x",
            ),
            (
                "EXPLAIN SELECT pose.place.xx FROM poses",
                "pose.place",
                "xx",
                "x",
            ),
        ] {
            let fault = read_only(&context, query).await.err().unwrap();
            let expected = format!("`{whole}` has no member `{name}`");
            assert_eq!(fault.message, expected, "{query}");
            assert_eq!(fault.next, format!("there are `{known}`"), "{query}");
        }
    }

    #[tokio::test]
    async fn a_member_of_a_null_struct_is_null_however_it_is_named() {
        for member in [
            "pose['place']['x']",
            "poses.pose.place.x",
            "get_field(pose, 'place', 'x')",
            "get_field(get_field(pose, 'place'), 'x')",
            "x FROM (SELECT nullif(whole, whole)['x'] AS x FROM (SELECT named_struct('x', 1.0) AS whole)) AS t UNION ALL SELECT pose['place']['x']",
        ] {
            let context = context(Limits::one_partition()).unwrap();
            context.register_batch("poses", poses()).unwrap();
            let query = format!("SELECT {member} FROM poses");
            let rows = context.sql(&query).await.unwrap().collect().await.unwrap();
            let texts: Vec<String> = rows
                .iter()
                .flat_map(|rows| {
                    let column = rows.column(0);
                    let texts = (0..rows.num_rows()).map(|row| array_value_to_string(column, row));
                    texts.map(Result::unwrap).collect::<Vec<_>>()
                })
                .collect();
            let known: Vec<&String> = texts.iter().filter(|text| !text.is_empty()).collect();
            assert_eq!(known, ["1.0"], "{member}: {texts:?}");
        }
    }
}
