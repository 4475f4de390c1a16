//! `a || b || c` of texts as one function, so that it is asked what it would make, too.

use std::sync::Arc;

use arrow::compute::kernels::concat_elements::concat_elements_dyn;
use arrow::datatypes::{DataType, Field, FieldRef};
use datafusion::common::{Result, ScalarValue, exec_err};
use datafusion::logical_expr::binary::BinaryTypeCoercer;
use datafusion::logical_expr::{
    ColumnarValue, Expr, Operator, ReturnFieldArgs, ScalarFunctionArgs, ScalarUDFImpl, Signature,
    Volatility,
};

/// What the operator does from the left to the right, by its name.
#[derive(Debug, PartialEq, Eq, Hash)]
pub struct TextsJoined {
    signature: Signature,
}

impl Default for TextsJoined {
    fn default() -> Self {
        Self {
            signature: Signature::user_defined(Volatility::Immutable),
        }
    }
}

impl ScalarUDFImpl for TextsJoined {
    fn name(&self) -> &str {
        "||"
    }

    /// As that of the operator: a column of a query is called by it.
    fn schema_name(&self, args: &[Expr]) -> Result<String> {
        let names = args.iter().map(|arg| arg.schema_name().to_string());
        Ok(names.collect::<Vec<_>>().join(" || "))
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    /// All are what the operator makes of them.
    fn coerce_types(&self, types: &[DataType]) -> Result<Vec<DataType>> {
        Ok(match self.return_type(types)? {
            // These keep their lengths, which add up.
            DataType::FixedSizeBinary(_) => types.to_vec(),
            joined => vec![joined; types.len()],
        })
    }

    fn return_type(&self, types: &[DataType]) -> Result<DataType> {
        let [first, others @ ..] = types else {
            return exec_err!("||: expected texts, found none");
        };
        let joined = |left: DataType, right: &DataType| {
            BinaryTypeCoercer::new(&left, &Operator::StringConcat, right).get_result_type()
        };
        others.iter().try_fold(first.clone(), joined)
    }

    fn return_field_from_args(&self, args: ReturnFieldArgs) -> Result<FieldRef> {
        let fields = args.arg_fields.iter();
        let types: Vec<DataType> = fields.map(|field| field.data_type().clone()).collect();
        let nullable = args.arg_fields.iter().any(|field| field.is_nullable());
        let joined = self.return_type(&types)?;
        Ok(Arc::new(Field::new(self.name(), joined, nullable)))
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let joined = args.args.into_iter().map(Ok).reduce(|left, right| {
            let both = [left?, right?];
            let columns = ColumnarValue::values_to_arrays(&both)?;
            let joined = concat_elements_dyn(&columns[0], &columns[1])?;
            let is_one = |value: &ColumnarValue| matches!(value, ColumnarValue::Scalar(_));
            match both.iter().all(is_one) {
                true => ScalarValue::try_from_array(&joined, 0).map(ColumnarValue::Scalar),
                false => Ok(ColumnarValue::Array(joined)),
            }
        });
        joined.unwrap_or_else(|| exec_err!("||: expected texts, found none"))
    }
}
