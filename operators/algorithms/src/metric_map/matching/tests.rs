#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::metric_map::features::{DESCRIPTOR_BYTES, Descriptor, Feature, ImageFeatures};
use proptest::prelude::*;

/// Descriptors of few distinct values, so that ties and equals occur.
fn descriptors() -> impl Strategy<Value = Vec<Descriptor>> {
    let one = prop::collection::vec(0_u8..4, 8).prop_map(|few| {
        let mut bytes = [0; DESCRIPTOR_BYTES];
        for (index, byte) in bytes.iter_mut().enumerate() {
            *byte = few[index % 8];
        }
        Descriptor(bytes)
    });
    prop::collection::vec(one, 0..150)
}

fn images() -> impl Strategy<Value = ImageFeatures> {
    let place = (-5.0..405.0_f64, -5.0..305.0_f64, 1.0..60.0_f64);
    (descriptors(), prop::collection::vec(place, 150)).prop_map(|(descriptors, places)| {
        let features = descriptors.into_iter().zip(places);
        ImageFeatures {
            features: features
                .map(|(descriptor, (u, v, size_px))| Feature {
                    pixel: [u, v],
                    size_px,
                    descriptor,
                })
                .collect(),
        }
    })
}

fn naive_best(query: &Descriptor, set: &[Descriptor]) -> Option<(usize, u32, Option<u32>)> {
    let distances: Vec<u32> = set.iter().map(|other| query.distance(other)).collect();
    let best = (0..set.len()).min_by_key(|index| distances[*index])?;
    let second = (0..set.len()).filter(|index| *index != best);
    Some((
        best,
        distances[best],
        second.map(|index| distances[index]).min(),
    ))
}

proptest! {
    #[test]
    fn mutual_matches_are_those_of_the_naive_search(
        a in descriptors(), b in descriptors(), ratio in 0.5..1.1_f64
    ) {
        let limits = MatchLimits { match_bits: 60, match_ratio: ratio };
        let (set_a, set_b): (Descriptors, Descriptors) = (a.iter().collect(), b.iter().collect());
        let good = |(_, distance, second): (usize, u32, Option<u32>)| limits.accept(distance, second);
        let mut expected = Vec::new();
        for (query, descriptor) in a.iter().enumerate() {
            let Some(best) = naive_best(descriptor, &b).filter(|best| good(*best)) else { continue };
            let back = naive_best(&b[best.0], &a).filter(|back| good(*back));
            if back.is_some_and(|back| back.0 == query) {
                expected.push(Match { query: query as u32, found: best.0 as u32, distance: best.1 });
            }
        }
        prop_assert_eq!(set_a.mutual(&set_b, &limits), expected);
        let nearest = set_a.nearest(&set_b, &limits);
        for (descriptor, found) in a.iter().zip(nearest) {
            let expected = naive_best(descriptor, &b).filter(|best| good(*best));
            prop_assert_eq!(found.map(|found| found.found as usize), expected.map(|best| best.0));
        }
    }

    #[test]
    fn near_a_pixel_is_what_a_look_at_all_finds(
        image in images(), u in -50.0..450.0_f64, v in -50.0..350.0_f64, radius in 0.0..500.0_f64
    ) {
        let index = ImageIndex::new(&image);
        let grid = FeatureGrid::new(image.features.iter().map(|feature| feature.pixel));
        let mut found: Vec<u32> = grid.near([u, v], radius).collect();
        found.sort_unstable();
        let near = |feature: &Feature| {
            (feature.pixel[0] - u).powi(2) + (feature.pixel[1] - v).powi(2) <= radius * radius
        };
        let all = (0_u32..).zip(&image.features);
        let expected: Vec<u32> = all.filter(|(_, f)| near(f)).map(|(index, _)| index).collect();
        prop_assert_eq!(&found, &expected);

        let wanted = Descriptor([1; DESCRIPTOR_BYTES]);
        let even = |feature: u32| feature.is_multiple_of(2);
        let nearest = index.nearest([u, v], radius, &wanted, even);
        let candidates: Vec<u32> = expected.into_iter().filter(|f| even(*f)).collect();
        let distance = |f: u32| image.features[f as usize].descriptor.distance(&wanted);
        let best = candidates.iter().copied().min_by_key(|f| (distance(*f), *f));
        prop_assert_eq!(nearest.map(|nearest| nearest.feature), best);
        if let (Some(nearest), Some(best)) = (nearest, best) {
            let of = |f: u32| &image.features[f as usize];
            let elsewhere = |f: &u32| {
                let (a, b) = (of(best), of(*f));
                let apart = (a.pixel[0] - b.pixel[0]).hypot(a.pixel[1] - b.pixel[1]);
                apart > 0.25 * a.size_px.max(b.size_px)
            };
            let second = candidates.iter().copied().filter(elsewhere).map(distance).min();
            prop_assert_eq!(nearest.runner_up, second);
            prop_assert_eq!(nearest.distance, distance(best));
        }
    }
}

#[test]
fn nothing_and_nonsense_find_nothing() {
    let empty = FeatureGrid::new([]);
    assert!(empty.near([0.0, 0.0], 1e9).next().is_none());
    let far = FeatureGrid::new([[f64::NAN, 0.0], [1e300, 0.0], [-9e5, 5.0]]);
    assert_eq!(far.near([-9e5, 5.0], 1e9).collect::<Vec<_>>(), [2]);
    for (pixel, radius) in [
        ([f64::NAN, 0.0], 1.0),
        ([0.0, 0.0], f64::NAN),
        ([0.0, 0.0], -1.0),
    ] {
        assert!(far.near(pixel, radius).next().is_none());
    }
    let none: Descriptors = [].iter().collect();
    assert!(none.mutual(&none, &MatchLimits::default()).is_empty() && none.is_empty());
}

#[test]
fn another_scale_of_one_corner_is_no_rival() {
    let feature = |u, byte| Feature {
        pixel: [u, 0.0],
        size_px: 12.0,
        descriptor: Descriptor([byte; DESCRIPTOR_BYTES]),
    };
    let image = ImageFeatures {
        features: vec![feature(100.0, 0), feature(101.0, 1), feature(110.0, 3)],
    };
    let wanted = Descriptor([0; DESCRIPTOR_BYTES]);
    let found = ImageIndex::new(&image).nearest([100.0, 0.0], 30.0, &wanted, |_| true);
    let found = found.unwrap();
    assert_eq!(
        (found.feature, found.distance, found.runner_up),
        (0, 0, Some(128))
    );
    assert!(MatchLimits::default().accept(found.distance, found.runner_up));
}
