//! Queries of steps, planned.

use datafusion::error::DataFusionError;
use datafusion::prelude::{DataFrame, SessionContext};
use evermap_language::{Part, Place, PlanFaults};

use crate::error::{fault_of, place_in_query};
use crate::program::volatile::volatile_functions;
use crate::sql;

/// The query of a step and where it begins.
#[derive(Debug, Clone, Copy)]
pub struct Query<'q> {
    /// Name of the step.
    pub step: &'q str,
    /// Its text.
    pub text: &'q str,
    /// Its place.
    pub place: Place,
}

impl Query<'_> {
    /// The query planned; what is wrong with it is recorded.
    pub async fn planned(
        self,
        context: &SessionContext,
        faults: &mut PlanFaults,
    ) -> Option<DataFrame> {
        let frame = match sql::planned(context, self.text).await {
            Ok(frame) => frame,
            Err(error) => {
                self.does_not_plan(context, &error, faults);
                return None;
            }
        };
        let plan = frame.logical_plan();
        let repeated = sql::repeated_columns(plan);
        let volatile = volatile_functions(plan);
        if let Some(first) = repeated.first() {
            let names = repeated.join(", ");
            let what = format!("gives two columns the name {names}; name one with AS");
            self.fault(Part::Word(first), &what, faults);
        } else if let Some(first) = volatile.first() {
            let names = volatile.join(", ");
            let what = format!(
                "calls {names}, whose answer changes from run to run; order by columns, and take instants from the rows"
            );
            self.fault(Part::Word(first), &what, faults);
        } else {
            return Some(frame);
        }
        None
    }

    fn does_not_plan(
        self,
        context: &SessionContext,
        error: &DataFusionError,
        faults: &mut PlanFaults,
    ) {
        let fault = sql::explained(context, fault_of(error));
        let next = match fault.next.as_str() {
            "" => String::new(),
            next => format!("; {next}"),
        };
        let (line, column) = place_in_query(error).unwrap_or((1, 1));
        let what = format!("does not plan: {}{next}", fault.message);
        self.fault(Part::At(line, column), &what, faults);
    }

    fn fault(self, part: Part<'_>, what: &str, faults: &mut PlanFaults) {
        let place = faults.inside(self.place, self.text, part);
        faults.error(place, format!("the query of `{}` {what}", self.step));
    }
}
