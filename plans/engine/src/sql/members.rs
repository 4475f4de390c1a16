//! A member of a null struct is null, and one that is not there is told with those that are.
//!
//! Arrow keeps the members of a struct as columns of their own, which may hold anything where the struct is null; a
//! member that may not be null holds 0. DataFusion's `get_field` hands out that column as it is, until its release 56
//! (apache/datafusion#25122). Here it is masked, where the struct may be null.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef};
use arrow::compute::{is_null, nullif};
use arrow::datatypes::{DataType, FieldRef};
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::Transformed;
use datafusion::common::{DFSchema, Result, exec_err};
use datafusion::execution::FunctionRegistry;
use datafusion::functions::core::get_field;
use datafusion::functions::core::getfield::GetFieldFunc;
use datafusion::logical_expr::expr::{Expr, GetFieldAccess, ScalarFunction};
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::planner::{ExprPlanner, PlannerResult, RawFieldAccessExpr};
use datafusion::logical_expr::{
    ColumnarValue, ExprSchemable, ReturnFieldArgs, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl,
    Signature,
};
use datafusion::prelude::SessionContext;
use evermap_language::listed;
use evermap_schemas::Fault;

use crate::error::external;

/// What looks at `pose['x']` before it is planned, and refuses a member that the struct does not have.
pub fn members() -> Arc<dyn ExprPlanner> {
    Arc::new(Members)
}

#[derive(Debug)]
struct Members;

impl ExprPlanner for Members {
    fn plan_field_access(
        &self,
        access: RawFieldAccessExpr,
        schema: &DFSchema,
    ) -> Result<PlannerResult<RawFieldAccessExpr>> {
        if let GetFieldAccess::NamedStructField { name } = &access.field_access
            && let Some(Some(name)) = name.try_as_str()
            && let Ok(DataType::Struct(members)) = access.expr.get_type(schema)
            && members.iter().all(|member| member.name() != name)
        {
            let whole = access.expr.schema_name();
            let known = members.iter().map(|member| member.name().as_str());
            let fault = Fault::user(format!("`{whole}` has no member `{name}`"));
            let known = listed(known);
            return Err(external(fault.next(format!("there are {known}"))));
        }
        Ok(PlannerResult::Original(access))
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
    use arrow::datatypes::{Field, Fields, Schema};
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
    async fn a_member_that_is_not_there_is_told_with_those_that_are() {
        let context = context(Limits::one_partition()).unwrap();
        context.register_batch("poses", poses()).unwrap();
        let query = "SELECT pose['place']['xx'] FROM poses";
        let fault = read_only(&context, query).await.err().unwrap();
        assert!(fault.message.ends_with("has no member `xx`"), "{fault}");
        assert_eq!(fault.next, "there are `x`");
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
