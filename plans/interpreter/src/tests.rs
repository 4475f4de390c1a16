#![allow(clippy::unwrap_used)]
//! Functions as people write them, run by the interpreter of the tests' own environment.

use std::sync::Arc;

use arrow::array::{AsArray, Float64Array, Int64Array};
use arrow::datatypes::{DataType, Field, Float64Type, Int64Type, Schema};
use evermap_schemas::Kind;
use serde_json::json;

use super::*;

/// Whether there is an interpreter with pyarrow: `make test` names one.
fn is_there() -> bool {
    let named = std::env::var_os(INTERPRETER).is_some();
    if !named {
        evermap_test_data::skipped("EVERMAP_PYTHON is not set; run `make test`");
    }
    named
}

fn function(code: &str, params: Value) -> Function {
    Function {
        file: "steps.py".into(),
        function: "made".into(),
        code: code.into(),
        ports: vec!["speeds".into()],
        params: params.as_object().cloned().unwrap_or_default(),
    }
}

fn speeds() -> Table {
    let columns = [
        Field::new("stamp", DataType::Int64, false),
        Field::new("speed_mps", DataType::Float64, true),
    ];
    let schema = Arc::new(Schema::new(columns.to_vec()));
    let stamps = Int64Array::from(vec![1, 2, 3]);
    let speeds = Float64Array::from(vec![Some(0.5), None, Some(2.0)]);
    let batch = RecordBatch::try_new(
        Arc::clone(&schema),
        vec![Arc::new(stamps), Arc::new(speeds)],
    );
    let batches = vec![batch.unwrap()];
    Table { schema, batches }
}

fn refused(code: &str, params: Value) -> String {
    let function = function(code, params);
    let checked = function.check();
    let made = checked.and_then(|environment| function.call(&environment, &[speeds()]));
    let fault = made.unwrap_err();
    assert_eq!(fault.kind, Kind::User);
    format!("{} ({})", fault.message, fault.place)
}

#[test]
fn rows_come_back_as_they_were_made() {
    if !is_there() {
        return;
    }
    let code = "import pyarrow.compute as pc
def made(speeds, factor, offset=0.0):
    print('a person looks at this')
    kept = speeds.filter(pc.is_valid(speeds['speed_mps']))
    scaled = pc.add(pc.multiply(kept['speed_mps'], factor), offset)
    return {'stamp': kept['stamp'], 'speed': scaled}, {'no speed': 1}
";
    let function = function(code, json!({"factor": 2.0}));
    let environment = function.check().unwrap();
    for _ in 0..2 {
        let made = function.call(&environment, &[speeds()]).unwrap();
        let rows = &made.rows.batches[0];
        let stamps = rows.column(0).as_primitive::<Int64Type>().values().to_vec();
        let speeds = rows
            .column(1)
            .as_primitive::<Float64Type>()
            .values()
            .to_vec();
        assert_eq!((stamps, speeds), (vec![1, 3], vec![1.0, 4.0]));
        assert_eq!(made.skipped, BTreeMap::from([("no speed".to_owned(), 1)]));
    }
}

#[test]
fn every_mistake_is_named() {
    if !is_there() {
        return;
    }
    let cases = [
        (
            "def made(speeds)\n    pass\n",
            json!({}),
            "SyntaxError: expected ':' (steps.py, line 1) (steps.py:made)",
        ),
        (
            "def other(speeds):\n    pass\n",
            json!({}),
            "expected a function made, found other (steps.py:made)",
        ),
        (
            "def made(speeds, window_s):\n    pass\n",
            json!({}),
            "made(speeds, window_s) does not take what the step gives: missing a required argument: 'window_s' (steps.py:made)",
        ),
        (
            "def made(speeds):\n    pass\n",
            json!({"windw_s": 1}),
            "made(speeds) does not take what the step gives: got an unexpected keyword argument 'windw_s' (steps.py:made)",
        ),
        (
            "import nothing_of_this_name\n",
            json!({}),
            "ModuleNotFoundError: No module named 'nothing_of_this_name' (steps.py, line 1, in <module>) (steps.py:made)",
        ),
        (
            "def half(x):\n    return x / 0\n\ndef made(speeds):\n    return half(1)\n",
            json!({}),
            "ZeroDivisionError: division by zero (steps.py, line 2, in half) (steps.py:made)",
        ),
        (
            "def made(speeds):\n    raise ValueError('no speed\\n\\n  at 3 s')\n",
            json!({}),
            "ValueError: no speed at 3 s (steps.py, line 2, in made) (steps.py:made)",
        ),
        (
            "def made(speeds):\n    raise ValueError('x' * 2_000_000)\n",
            json!({}),
            "x… (steps.py, line 2, in made) (steps.py:made)",
        ),
        (
            "def made(speeds):\n    return speeds, {'no calibration': -3}\n",
            json!({}),
            "expected how often 'no calibration' was, a whole number from 0, found -3 (steps.py:made)",
        ),
        (
            "def made(speeds):\n    return speeds, {'no calibration': '3'}\n",
            json!({}),
            "a whole number from 0, found '3' (steps.py:made)",
        ),
        (
            "def made(speeds):\n    return speeds, {'no calibration': 2.5}\n",
            json!({}),
            "a whole number from 0, found 2.5 (steps.py:made)",
        ),
        (
            "def made(speeds):\n    return 3\n",
            json!({}),
            "expected rows (a pyarrow Table, a data frame, a dict of columns), found int",
        ),
        (
            "def made(speeds):\n    raise SystemExit(3)\n",
            json!({}),
            "SystemExit: 3 (steps.py, line 2, in made)",
        ),
        (
            "import os\ndef made(speeds):\n    os._exit(7)\n",
            json!({}),
            "the interpreter ended without an answer (exit status: 7) (steps.py:made)",
        ),
    ];
    for (code, params, expected) in cases {
        let found = refused(code, params);
        assert!(
            found.contains(expected),
            "expected {expected}\n   found {found}"
        );
    }
}

/// A child that comes back from the function answers nobody, and ends.
#[test]
fn a_function_that_forks_is_answered_by_itself_alone() {
    if !is_there() {
        return;
    }
    let code = "import multiprocessing, os, time
def made(speeds, raises):
    child = os.fork()
    if child == 0:
        if raises:
            raise ValueError('in the child')
        return {'whose': [0], 'status': [0]}
    for _ in range(200):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        time.sleep(0.05)
    status = os.waitstatus_to_exitcode(status) if ended else -1
    with multiprocessing.get_context('fork').Pool(2) as pool:
        [whose] = pool.map(abs, [-1])
    return {'whose': [whose], 'status': [status]}
";
    for raises in [false, true] {
        let function = function(code, json!({ "raises": raises }));
        let environment = function.check().unwrap();
        for _ in 0..3 {
            let made = function.call(&environment, &[speeds()]).unwrap();
            let rows = &made.rows.batches[0];
            let value = |column: usize| rows.column(column).as_primitive::<Int64Type>().value(0);
            assert_eq!((value(0), value(1)), (1, i64::from(raises)));
        }
    }
}

#[test]
fn an_answer_to_another_request_is_refused() {
    let code = "import json, struct, sys
def made(speeds):
    line = json.dumps({'number': 1, 'skipped': {}}).encode()
    answers = sys._getframe(2).f_locals['answers']
    answers.write(struct.pack('<I', len(line)) + line)
    return speeds
";
    if is_there() {
        let said = refused(code, json!({}));
        let expected = "expected the answer to request 2, found one to request 1";
        assert!(said.starts_with(expected), "{said}");
    }
}

#[test]
fn another_environment_is_refused() {
    if !is_there() {
        return;
    }
    let function = function("def made(speeds):\n    return speeds\n", json!({}));
    let other = Environment("0".repeat(64));
    let fault = function.call(&other, &[speeds()]).unwrap_err();
    assert!(
        fault
            .message
            .starts_with("expected the Python environment 000000000000 "),
        "{fault}"
    );
}

#[test]
fn large_tables_pass() {
    if !is_there() {
        return;
    }
    let schema = Arc::new(Schema::new(vec![Field::new("x", DataType::Int64, false)]));
    let column = Int64Array::from_iter_values(0..2_000_000);
    let batch = RecordBatch::try_new(Arc::clone(&schema), vec![Arc::new(column)]).unwrap();
    let batches = vec![batch.clone(), batch];
    let code = "def made(speeds):\n    return speeds.slice(1_999_999, 2)\n";
    let function = function(code, json!({}));
    let environment = function.check().unwrap();
    let made = function
        .call(&environment, &[Table { schema, batches }])
        .unwrap();
    let rows = arrow::compute::concat_batches(&made.rows.schema, &made.rows.batches).unwrap();
    assert_eq!(
        rows.column(0).as_primitive::<Int64Type>().values().to_vec(),
        [1_999_999, 0]
    );
}
