//! Functions that a query names and that are not there.

use datafusion::prelude::SessionContext;
use evermap_language::nearest;
use evermap_schemas::Fault;

/// A fault of planning, in our words where it is that a function is not there, with the one that may be meant.
pub fn explained(context: &SessionContext, fault: Fault) -> Fault {
    let Some(function) = missing_function(&fault.message) else {
        return fault;
    };
    let state = context.state();
    let known = state.scalar_functions().keys();
    let mut known: Vec<&String> = known.chain(state.aggregate_functions().keys()).collect();
    known.sort();
    let meant = nearest(function, known.into_iter().map(String::as_str));
    Fault {
        message: format!("there is no function `{function}`"),
        next: match meant {
            Some(near) => format!("did you mean `{near}`?"),
            None => "`evermap functions` lists those of maps".to_owned(),
        },
        ..fault
    }
}

/// The function that DataFusion did not find.
fn missing_function(message: &str) -> Option<&str> {
    let (_, behind) = message.split_once("Invalid function '")?;
    behind.split_once('\'').map(|(name, _)| name)
}
