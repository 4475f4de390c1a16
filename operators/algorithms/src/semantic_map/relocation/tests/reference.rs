//! Relocation as it is defined, area by area: nothing is sorted, left out, or computed for several headings at once.
#![allow(clippy::unwrap_used)]

use std::cmp::Reverse;
use std::f64::consts::TAU;

use proptest::prelude::*;

use super::graphs::graph;
use crate::semantic_map::relocation::description::{AreaCode, Description, Measure, order};
use crate::semantic_map::relocation::{Hit, Options, ViewMap, similarity};
use crate::semantic_map::semantic_graph::Graph;

/// How much two areas speak for being the same thing.
fn evidence(measure: &Measure, a: &AreaCode, b: &AreaCode) -> u32 {
    let circle = |a: u16, b: u16| u32::from(a.wrapping_sub(b).min(b.wrapping_sub(a)));
    let share = |value: u32, of: u16| (value * u32::from(of)) >> 16;
    let turn = circle(a.bearing, b.bearing);
    let tilt = share(circle(a.orientation, b.orientation), measure.orientation);
    let difference = share(turn, measure.bearing)
        + u32::from(a.elevation.abs_diff(b.elevation))
        + u32::from(a.size.abs_diff(b.size))
        + u32::from(a.elongation.abs_diff(b.elongation))
        + share(tilt, a.stretch.min(b.stretch));
    if a.class == b.class && turn <= u32::from(measure.max_bearing) {
        u32::from(measure.limit).saturating_sub(difference)
    } else {
        0
    }
}

/// Areas of a query or a view, the largest first, with what touches what.
struct Seen(Description);

impl Seen {
    fn new(graph: &Graph, options: &Options) -> Self {
        Self(Description::new(graph, &order(graph, options), options))
    }

    fn turned(&self, turn: u16) -> Vec<AreaCode> {
        let codes = (0..self.0.areas.len()).map(|area| {
            let code = self.0.areas.at(area);
            AreaCode {
                bearing: code.bearing.wrapping_add(turn),
                ..code
            }
        });
        codes.collect()
    }

    fn bound(&self, view: &Self, turn: u16, measure: &Measure) -> u32 {
        let floor = u32::from(measure.limit / 4);
        let best = |mine: &AreaCode| {
            let others = view.turned(0);
            let evidence = others.iter().map(|other| evidence(measure, mine, other));
            evidence.max().unwrap_or(0).max(floor)
        };
        let weighted = self.turned(turn);
        let weighted = weighted.iter().zip(&self.0.weights);
        weighted.map(|(area, weight)| best(area) * weight).sum()
    }

    /// Pairs, the largest area of the query first, and their evidence.
    fn tree(&self, view: &Self, turn: u16, options: &Options) -> (Vec<[usize; 2]>, u32) {
        let measure = Measure::new(options);
        let most = options.boundary_factor.max(1.0).ln() as f32;
        let others = view.turned(0);
        let (mut pairs, mut sum): (Vec<[usize; 2]>, u32) = (Vec::new(), 0);
        for (mine, code) in self.turned(turn).iter().enumerate() {
            let fits = |other: usize| {
                self.0.neighbours(mine).iter().all(|(neighbour, length)| {
                    let pair = pairs.iter().find(|[a, _]| *a == usize::from(*neighbour));
                    let partner = pair.map(|[_, b]| *b as u16);
                    let mut touching = view.0.neighbours(other).iter();
                    touching
                        .find(|(at, _)| Some(*at) == partner)
                        .is_none_or(|(_, other)| (length - other).abs() <= most)
                })
            };
            let free = (0..others.len()).filter(|other| !pairs.iter().any(|[_, b]| b == other));
            let speaks =
                free.map(|other| (evidence(&measure, code, &others[other]), Reverse(other)));
            let best = speaks
                .filter(|(evidence, Reverse(other))| *evidence > 0 && fits(*other))
                .max();
            if let Some((evidence, Reverse(other))) = best {
                pairs.push([mine, other]);
                sum += evidence * self.0.weights[mine];
            }
        }
        (pairs, sum)
    }

    /// The turn at which half of what matched areas weigh lies on either side.
    fn fitted(&self, view: &Self, turn: u16, options: &Options) -> u16 {
        let (mine, others) = (self.turned(turn), view.turned(0));
        let (pairs, _) = self.tree(view, turn, options);
        let mut apart: Vec<i16> = Vec::new();
        for [a, b] in pairs {
            let by = others[b].bearing.wrapping_sub(mine[a].bearing) as i16;
            apart.extend(std::iter::repeat_n(by, self.0.weights[a] as usize));
        }
        apart.sort_unstable();
        let middle = apart.get(apart.len().div_ceil(2).saturating_sub(1));
        turn.wrapping_add(middle.map_or(0, |by| *by as u16))
    }
}

fn turns(options: &Options) -> Vec<u16> {
    let code = |turn: f64| ((turn / TAU * 65536.0).round() as i64).rem_euclid(65536) as u16;
    options.turns_rad().map(code).collect()
}

fn search(graphs: &[Graph], query: &Graph, options: &Options, top: usize) -> Vec<Hit> {
    let measure = Measure::new(options);
    let any = options.of_any_size();
    let (large, all) = (Seen::new(query, options), Seen::new(query, &any));
    let turns = turns(options);
    let views: Vec<[Seen; 2]> = graphs
        .iter()
        .map(|view| [options, &any].map(|options| Seen::new(view, &options.of_map())))
        .collect();
    let mut bounded: Vec<(Reverse<u32>, usize, usize)> = Vec::new();
    for (view, [of_view, _]) in views.iter().enumerate() {
        let bound = |turn: usize| {
            (
                Reverse(large.bound(of_view, turns[turn], &measure)),
                view,
                turn,
            )
        };
        bounded.extend((0..turns.len()).map(bound).min());
    }
    bounded.sort_unstable();
    bounded.truncate(top.max(options.candidates as usize));
    let mut found: Vec<Hit> = Vec::new();
    for (_, view, turn) in bounded {
        let turn = large.fitted(&views[view][0], turns[turn], options);
        let turn = all.fitted(&views[view][1], turn, &any);
        let (pairs, evidence) = all.tree(&views[view][1], turn, &any);
        let most = f64::from(all.0.weight()) * f64::from(measure.limit);
        found.push(Hit {
            view: view as u32,
            turn_rad: f64::from(turn as i16) / 65536.0 * TAU,
            matched: pairs.len() as u32,
            score: if most > 0.0 {
                f64::from(evidence) / most
            } else {
                0.0
            },
            similarity: similarity(all.0.areas.len() as u32, pairs.len() as u32),
        });
    }
    found.retain(|hit| hit.matched >= options.min_matched.max(1));
    found.sort_by(|a, b| {
        b.score
            .total_cmp(&a.score)
            .then(b.matched.cmp(&a.matched))
            .then(a.view.cmp(&b.view))
    });
    found.truncate(top);
    found
}

fn options() -> impl Strategy<Value = Options> {
    let headings = prop_oneof![Just(24_u32), Just(1), Just(2), Just(7), Just(9), Just(360)];
    let bearing = prop_oneof![Just(0.15_f64), Just(0.0), Just(1e-4), Just(3.0)];
    let reach = prop_oneof![Just(0.75_f64), Just(0.1), Just(TAU)];
    let limit = prop_oneof![Just(4.0_f64), 0.0_f64..1.0, Just(40.0)];
    let least = prop_oneof![Just(0.002_f64), Just(0.02)];
    let others = (1_u32..6, any::<bool>());
    (headings, bearing, reach, limit, least, others).prop_map(
        |(headings, bearing, max_bearing_rad, limit, min_area_share, (candidates, ignores))| {
            let mut options = Options {
                headings,
                max_bearing_rad,
                limit,
                min_area_share,
                candidates,
                boundary_factor: 1.5,
                ignored: if ignores { vec![1] } else { Vec::new() },
                ..Options::default()
            };
            options.scales.bearing_rad = bearing;
            options
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]
    #[test]
    fn what_is_found_is_what_the_definition_finds(
        graphs in prop::collection::vec(graph(), 0..24),
        query in graph(),
        options in options(),
        top in 0_usize..4,
    ) {
        let map = ViewMap::new(graphs.iter(), options.clone());
        let expected = search(&graphs, &query, &options, top);
        let asked = map.query(&query);
        prop_assert_eq!(&map.search(&asked, top, |_| true), &expected);
        let views: Vec<u32> = (0..graphs.len() as u32).collect();
        prop_assert_eq!(map.among(&asked, &views, top), expected);
    }

    #[test]
    fn bounds_are_as_defined_and_none_of_all_views_is_lower(
        graphs in prop::collection::vec(graph(), 0..24),
        query in graph(),
        options in options(),
    ) {
        let map = ViewMap::new(graphs.iter(), options.clone());
        let (asked, measure) = (map.query(&query), Measure::new(&options));
        let large = Seen::new(&query, &options);
        let mut of_all: Vec<Vec<u32>> = Vec::new();
        map.bounds.of_all(&asked.large, |of_turns| {
            of_all.push(of_turns.iter().map(|told| map.bounds.most(*told)).collect());
        });
        prop_assert_eq!(of_all.len(), graphs.len());
        for ((view, graph), of_all) in (0..).zip(&graphs).zip(of_all) {
            let pair = map.large.pair(&asked.large, view, 0).unwrap();
            let of_view = Seen::new(graph, &options.of_map());
            let turns = turns(&options).into_iter();
            let defined: Vec<u32> = turns.map(|turn| large.bound(&of_view, turn, &measure)).collect();
            prop_assert_eq!(&map.bounds.of_pair(&pair)[..defined.len()], &defined[..]);
            let higher = of_all.iter().zip(&defined).all(|(of_all, defined)| of_all >= defined);
            prop_assert!(of_all.len() == defined.len() && higher, "{:?} {:?}", of_all, defined);
        }
    }
}
