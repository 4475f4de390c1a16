//! What features look like, which is kept apart from where they are: it is most of them, and looked at seldom.

use std::borrow::Cow;

use rayon::prelude::*;

use super::scene::FeatureRef;
use crate::metric_map::features::{DESCRIPTOR_BYTES, Descriptor};

/// The descriptors of a scene's features: all in memory, or fetched when they are looked at. That may be several times. `E`
/// is why they may be out of reach.
pub trait DescriptorSource<E>: Sync {
    /// Of the image of this index, by feature.
    ///
    /// # Errors
    /// When they cannot be fetched.
    fn descriptors(&self, image: u32) -> Result<Cow<'_, [Descriptor]>, E>;
}

/// Images that are looked at one after the other; fewer are not worth a thread's start.
const IN_A_ROW: usize = 16;

/// The descriptors of these features, in their order. Each image is looked at once.
///
/// # Errors
/// As [`DescriptorSource::descriptors`].
pub fn descriptors_of<E: Send>(
    described: &dyn DescriptorSource<E>,
    features: &[FeatureRef],
) -> Result<Vec<Descriptor>, E> {
    let mut order: Vec<usize> = (0..features.len()).collect();
    order.par_sort_unstable_by_key(|at| features[*at]);
    let by_image: Vec<&[usize]> = order
        .chunk_by(|a, b| features[*a].image == features[*b].image)
        .collect();
    let of_image = |places: &&[usize]| -> Result<Vec<Descriptor>, E> {
        let seen = described.descriptors(features[places[0]].image)?;
        let looks = places.iter().map(|at| seen[features[*at].feature as usize]);
        Ok(looks.collect())
    };
    let images = by_image.par_iter().with_min_len(IN_A_ROW);
    let found: Vec<Vec<Descriptor>> = images.map(of_image).collect::<Result<_, E>>()?;
    let mut descriptors = vec![Descriptor([0; DESCRIPTOR_BYTES]); features.len()];
    for (at, found) in order.iter().zip(found.into_iter().flatten()) {
        descriptors[*at] = found;
    }
    Ok(descriptors)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Mutex;

    use super::*;

    /// Images of four features, which look like their numbers; the image 9 is out of reach.
    #[derive(Default)]
    struct Numbered {
        looked_at: Mutex<Vec<u32>>,
    }

    fn look(image: u32, feature: u32) -> Descriptor {
        Descriptor([(10 * image + feature) as u8; DESCRIPTOR_BYTES])
    }

    impl DescriptorSource<u32> for Numbered {
        fn descriptors(&self, image: u32) -> Result<Cow<'_, [Descriptor]>, u32> {
            self.looked_at.lock().unwrap().push(image);
            let all = (0..4).map(|feature| look(image, feature));
            if image == 9 {
                Err(image)
            } else {
                Ok(Cow::Owned(all.collect()))
            }
        }
    }

    fn features(names: &[(u32, u32)]) -> Vec<FeatureRef> {
        let name = |(image, feature): &(u32, u32)| FeatureRef {
            image: *image,
            feature: *feature,
        };
        names.iter().map(name).collect()
    }

    #[test]
    fn descriptors_come_in_the_order_of_the_features_and_each_image_is_looked_at_once() {
        let names = [(3, 1), (0, 2), (3, 0), (1, 3), (0, 2), (3, 3)];
        let seen = Numbered::default();
        let found = descriptors_of(&seen, &features(&names)).unwrap();
        assert_eq!(found, names.map(|(image, feature)| look(image, feature)));
        let mut looked_at = seen.looked_at.into_inner().unwrap();
        looked_at.sort_unstable();
        assert_eq!(looked_at, [0, 1, 3]);
    }

    #[test]
    fn what_is_out_of_reach_is_told() {
        let seen = Numbered::default();
        let found = descriptors_of(&seen, &features(&[(3, 1), (9, 0)]));
        assert_eq!(found, Err(9));
        assert_eq!(descriptors_of(&seen, &[]), Ok(Vec::new()));
    }
}
