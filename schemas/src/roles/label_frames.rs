//! Label images: each value, from 0 to 255, a class; `label_classes` says which.

use std::collections::BTreeMap;

use crate::roles::content::{Content, is_of_labels};
use crate::roles::frames::{Frame, IMAGES, of_content};
use crate::roles::{Choice, Messages, Role, Topic};

/// Image topics whose names speak of labels, segmentation or semantics.
pub const ROLE: Role = Role::of::<Frame>(Messages {
    choose,
    pictures: false,
    ..IMAGES
})
.named("label_frames", "One image of class labels, by reference.");

/// Of topics that differ only from the part that speaks of labels on, the first by name.
fn choose(topics: &[Topic]) -> Vec<Choice> {
    let labels = of_content(topics, Content::Labels);
    let mut owners = BTreeMap::<Vec<&str>, Vec<&Topic>>::new();
    for topic in &labels {
        let parts = topic.name.split('/');
        let owner = parts.take_while(|part| !is_of_labels(part)).collect();
        owners.entry(owner).or_default().push(topic);
    }
    owners.into_values().filter_map(Choice::first_of).collect()
}
