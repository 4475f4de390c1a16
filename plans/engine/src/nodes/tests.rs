//! An operator with a side over several partitions: what the plan says, what is shared, what is counted.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use arrow::array::RecordBatch;
use datafusion::datasource::memory::MemorySourceConfig;
use datafusion::datasource::source::DataSourceExec;
use datafusion::physical_optimizer::PhysicalOptimizerRule;
use datafusion::physical_optimizer::ensure_requirements::EnsureRequirements;
use datafusion::physical_plan::display::DisplayableExecutionPlan;
use datafusion::physical_plan::{ExecutionPlan, collect};
use datafusion::prelude::SessionContext;
use evermap_contract::laws::table;
use evermap_contract::{Entry, LayerRow, Operator as Declared, Phase, Port, Work};
use evermap_datasets::{Dataset, ImageReader};
use evermap_schemas::layers::{Features, Keyframe, VehiclePose};
use evermap_schemas::{Bytes, Fault, Kind, Layer, Stamp, batch, record, rows};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::nodes::node::{Deal, Duty, Need, ordering};
use crate::nodes::operator::{Operator, OperatorExec};
use crate::nodes::pixels::{Fetching, PixelsExec};
use crate::sql::{Limits, context};
use crate::temporary::counted;

record! {
    /// How many keyframes there are beside a pose.
    #[layer("company", key(site, session, stamp))]
    pub struct Company {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Instant.
        stamp: evermap_schemas::Stamp ["ns"],
        /// Keyframes of the site.
        keyframes: u64,
    }
}

/// How often sides were prepared for site `s`.
static PREPARED: AtomicUsize = AtomicUsize::new(0);

#[derive(Default, Clone, Serialize, Deserialize, JsonSchema)]
struct Params {}

struct Counted;
impl Declared for Counted {
    const NAME: &'static str = "company";
    const VERSION: u32 = 1;
    const PAGE: &'static str = "";
    type Params = Params;
    type Output = Company;
    fn work() -> Work<Params> {
        Work::each_row(
            Port::session::<VehiclePose>("poses"),
            vec![Port::site::<Keyframe>("keyframes")],
            |_, sides| {
                let keyframes = sides.rows::<Keyframe>("keyframes")?;
                PREPARED.fetch_add(usize::from(!keyframes.is_empty()), Ordering::Relaxed);
                Ok(keyframes.len() as u64)
            },
            |&keyframes, pose: VehiclePose| {
                Ok([Company {
                    site: pose.site,
                    session: pose.session,
                    stamp: pose.stamp,
                    keyframes,
                }])
            },
        )
    }
}

/// Counts the bytes of the descriptors of the image at each pose, one image at a time.
struct Fetched;
impl Declared for Fetched {
    const NAME: &'static str = "fetched";
    const VERSION: u32 = 1;
    const PAGE: &'static str = "";
    type Params = Params;
    type Output = Company;
    fn work() -> Work<Params> {
        Work::each_row(
            Port::session::<VehiclePose>("poses"),
            vec![Port::site::<Features>("images").fetched()],
            |_, sides| sides.fetched::<Features>("images"),
            |images, pose: VehiclePose| {
                let image = images.row(pose.stamp.0 as usize);
                let image = image.map_err(|fault| fault.to_string())?;
                Ok([Company {
                    site: pose.site,
                    session: pose.session,
                    stamp: image.stamp,
                    keyframes: image.descriptors.0.len() as u64,
                }])
            },
        )
    }
}

fn made(layer: &Layer, rows: std::ops::Range<i64>) -> RecordBatch {
    let row = |at: i64| json!({ "site": "s", "session": "a", "stamp": at, "keyframe": at });
    let known = |mut row: serde_json::Value| {
        let row = row.as_object_mut().unwrap();
        row.retain(|name, _| layer.columns.iter().any(|column| column.name == name));
        row.clone()
    };
    let rows: Vec<_> = rows.map(|at| known(row(at))).collect();
    table(&layer.schema(), &rows).unwrap()
}

fn scan(partitions: &[Vec<RecordBatch>]) -> Arc<dyn ExecutionPlan> {
    let schema = partitions[0][0].schema();
    MemorySourceConfig::try_new_exec(partitions, schema, None).unwrap()
}

/// Poses in three partitions, keyframes in two.
fn plan(context: &SessionContext) -> Arc<dyn ExecutionPlan> {
    let (poses, keyframes) = (VehiclePose::layer(), Keyframe::layer());
    let poses = [0..10, 10..20, 20..30].map(|part| vec![made(&poses, part)]);
    let keyframes = [0..3, 3..5].map(|part| vec![made(&keyframes, part)]);
    let entry = Entry::of::<Counted>();
    let sides = entry.sides(Phase::Run).to_vec();
    let operator = Operator::new(&entry, &entry.defaults, Phase::Run, sides, Arc::default());
    let children = vec![scan(&poses), scan(&keyframes)];
    let exec = OperatorExec::try_new(Arc::new(operator), children).unwrap();
    ensured(context, Arc::new(exec))
}

/// Poses in three partitions, and as many images of 64 kB and more, in their order.
fn fetching(context: &SessionContext) -> Arc<dyn ExecutionPlan> {
    let poses = [0..10, 10..20, 20..30].map(|part| vec![made(&VehiclePose::layer(), part)]);
    let image = |at: i64| Features {
        site: "s".to_owned(),
        session: "a".to_owned(),
        stamp: Stamp(at),
        keyframe: at as u32,
        camera: "front".to_owned(),
        width: 400,
        height: 300,
        u: vec![],
        v: vec![],
        size_px: vec![],
        descriptors: Bytes(vec![0; 65_536 + at as usize]),
    };
    let images = (0..30).map(|at| batch(vec![image(at)]).unwrap());
    let images: Vec<RecordBatch> = images.collect();
    let schema = Features::layer().schema();
    let order = ordering(["site", "session", "stamp", "camera"], &schema).unwrap();
    let images = MemorySourceConfig::try_new(&[images], schema, None).unwrap();
    let images = images.try_with_sort_information(vec![order]).unwrap();
    let entry = Entry::of::<Fetched>();
    let sides = entry.sides(Phase::Run).to_vec();
    let operator = Operator::new(&entry, &entry.defaults, Phase::Run, sides, Arc::default());
    let images: Arc<dyn ExecutionPlan> = DataSourceExec::from_data_source(images);
    let children = vec![scan(&poses), images];
    let exec = OperatorExec::try_new(Arc::new(operator), children).unwrap();
    ensured(context, Arc::new(exec))
}

#[tokio::test]
async fn rows_of_a_store_are_fetched_wherever_there_is_room_for_them() {
    for (memory_bytes, in_file) in [(1 << 30, false), (1 << 20, true)] {
        let context = limited(memory_bytes);
        let runtime = counted(&context.runtime_env());
        let context = SessionContext::new_with_config_rt(context.copied_config(), runtime);
        let plan = fetching(&context);
        let batches = collect(Arc::clone(&plan), context.task_ctx())
            .await
            .unwrap();
        let company: Vec<Company> = batches.iter().flat_map(|b| rows(b).unwrap()).collect();
        let mut found: Vec<(i64, u64)> = company
            .iter()
            .map(|row| (row.stamp.0, row.keyframes))
            .collect();
        found.sort_unstable();
        let expected: Vec<(i64, u64)> = (0..30).map(|at| (at, 65_536 + at as u64)).collect();
        assert_eq!(found, expected);
        let metrics = plan.metrics().unwrap();
        let in_files = metrics.sum_by_name("side_file_bytes").unwrap().as_usize();
        assert_eq!(in_files > 30 * 65_536, in_file, "{in_files} B");
        drop(plan);
        let left = context.runtime_env().disk_manager.used_disk_space();
        assert_eq!(left, 0);
    }
}

fn ensured(context: &SessionContext, plan: Arc<dyn ExecutionPlan>) -> Arc<dyn ExecutionPlan> {
    let state = context.state();
    let ensure = EnsureRequirements::new();
    ensure.optimize(plan, state.config_options()).unwrap()
}

fn limited(memory_bytes: usize) -> SessionContext {
    context(Limits {
        memory_bytes,
        partitions: 3,
    })
    .unwrap()
}

#[tokio::test]
async fn sides_are_children_collected_once_for_all_partitions() {
    let context = limited(1 << 30);
    let plan = plan(&context);
    let batches = collect(Arc::clone(&plan), context.task_ctx())
        .await
        .unwrap();
    let company: Vec<Company> = batches.iter().flat_map(|b| rows(b).unwrap()).collect();
    assert_eq!(company.len(), 30);
    assert!(company.iter().all(|row| row.keyframes == 5));
    assert_eq!(PREPARED.load(Ordering::Relaxed), 1);

    let explained = DisplayableExecutionPlan::with_metrics(plan.as_ref());
    let text = explained.indent(false).to_string();
    for needle in [
        "OperatorExec: operator=company, phase=Run, driving=poses, sides=[keyframes]",
        "side_rows=5",
        "output_rows=30",
        "SortExec: expr=[site@0 ASC, session@1 ASC, stamp@2 ASC]",
    ] {
        assert!(text.contains(needle), "{needle} is not in\n{text}");
    }
}

#[tokio::test]
async fn sides_that_do_not_fit_memory_are_a_fault_of_resources() {
    let context = limited(1);
    let failed = collect(plan(&context), context.task_ctx())
        .await
        .unwrap_err();
    let fault: Fault = crate::error::fault_of(&failed);
    assert_eq!(fault.kind, Kind::Resource, "{fault}");
}

#[tokio::test]
async fn images_are_fetched_after_rows_are_sorted_and_dealt_out() {
    let context = limited(1 << 30);
    let dataset = Dataset::open(&context.runtime_env(), &[], None)
        .await
        .unwrap();
    let need = Need {
        deal: Deal::ByKey(&["site", "session"]),
        sorting: vec!["site", "session", "stamp"],
        parallel: true,
    };
    let fetching = |need| {
        Arc::new(Fetching {
            column: "image".to_owned(),
            need,
            reader: Arc::new(ImageReader::new(&dataset, 1)),
            losses: Arc::default(),
        })
    };
    let layer = VehiclePose::layer();
    let poses = [0..10, 10..20].map(|part| vec![made(&layer, part)]);
    let inner = PixelsExec::try_new(fetching(need.clone()), vec![scan(&poses)]).unwrap();
    // A second node stands for the operator: it has the same need, and finds it met.
    let met = Need {
        parallel: false,
        ..need
    };
    let outer = PixelsExec::try_new(fetching(met), vec![Arc::new(inner)]).unwrap();
    assert!(outer.duty.keeps_order());
    let plan = ensured(&context, Arc::new(outer));
    let text = DisplayableExecutionPlan::new(plan.as_ref())
        .indent(false)
        .to_string();
    let nodes: Vec<_> = text
        .lines()
        .map(|line| line.trim().split(':').next().unwrap())
        .collect();
    assert_eq!(nodes[..2], ["PixelsExec", "PixelsExec"], "{text}");
    assert!(
        text.contains("SortExec") && text.contains("RepartitionExec"),
        "{text}"
    );
}
