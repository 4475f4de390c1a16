#![doc = include_str!("occlusion_counts.md")]

use std::collections::BTreeMap;

use evermap_contract::{Emit, Fault, Fold, NothingToChoose, Operator, Port, Sides, Work};
use evermap_schemas::layers::{OcclusionCount, WarpedLabels};
use serde::{Deserialize, Serialize};

/// See the module's page.
pub struct OcclusionCounts;

impl Operator for OcclusionCounts {
    const NAME: &'static str = "occlusion_counts";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("occlusion_counts.md");
    type Params = NothingToChoose;
    type Output = OcclusionCount;

    fn work() -> Work<Self::Params> {
        Work::fold::<Counts>(Port::session::<WarpedLabels>("warped_labels"), vec![])
    }
}

struct Counts;

/// Sums over views.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Sums {
    pixels: u64,
    views: u64,
    squares: u64,
    products: u64,
}

impl Sums {
    /// Sums beyond 64 bits, which only a damaged artifact has, stay at the largest number.
    fn plus(self, other: Self) -> Self {
        Self {
            pixels: self.pixels.saturating_add(other.pixels),
            views: self.views.saturating_add(other.views),
            squares: self.squares.saturating_add(other.squares),
            products: self.products.saturating_add(other.products),
        }
    }
}

impl Fold for Counts {
    type Params = NothingToChoose;
    type Row = WarpedLabels;
    /// Dynamic class, then the class behind it.
    type Key = (String, String);
    type State = Sums;
    type Output = OcclusionCount;

    fn prepare(_: &NothingToChoose, _: &Sides) -> Result<Self, Fault> {
        Ok(Self)
    }

    fn lift(
        &self,
        rows: Vec<WarpedLabels>,
        states: &mut BTreeMap<Self::Key, Sums>,
        _: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        for row in rows {
            let mut all: BTreeMap<String, u64> = BTreeMap::new();
            for seen in &row.occlusions {
                let of_dynamic = all.entry(seen.dynamic.clone()).or_default();
                *of_dynamic = of_dynamic.saturating_add(seen.pixels);
            }
            for seen in row.occlusions {
                let of_dynamic = all.get(&seen.dynamic).copied().unwrap_or(0);
                let sums = states.entry((seen.dynamic, seen.class)).or_default();
                *sums = sums.plus(Sums {
                    pixels: seen.pixels,
                    views: 1,
                    squares: seen.pixels.saturating_mul(seen.pixels),
                    products: seen.pixels.saturating_mul(of_dynamic),
                });
            }
        }
        Ok(())
    }

    fn merge(&self, states: Vec<Sums>) -> Result<Sums, Fault> {
        Ok(states.into_iter().fold(Sums::default(), Sums::plus))
    }

    fn finish(
        &self,
        site: &str,
        (dynamic, class): &Self::Key,
        sums: Sums,
    ) -> Result<Option<OcclusionCount>, Fault> {
        Ok(Some(OcclusionCount {
            site: site.to_owned(),
            dynamic: dynamic.clone(),
            class: class.clone(),
            pixels: sums.pixels,
            views: sums.views,
            squares: sums.squares,
            products: sums.products,
        }))
    }

    fn state_bytes(&self, state: &Sums) -> usize {
        size_of_val(state)
    }
}
