//! What the values of images mean, as the names of their topics speak of it.

use crate::roles::cameras::is_kind;

/// What the values of an image mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    Picture,
    Depth,
    Labels,
}

/// Words in the names of topics, and what images they are sent on.
const WORDS: [(&str, Content); 12] = [
    ("label", Content::Labels),
    ("labels", Content::Labels),
    ("segmentation", Content::Labels),
    ("semantic", Content::Labels),
    ("semantics", Content::Labels),
    ("depth", Content::Depth),
    ("depthmap", Content::Depth),
    ("rgb", Content::Picture),
    ("bgr", Content::Picture),
    ("color", Content::Picture),
    ("colour", Content::Picture),
    ("mono", Content::Picture),
];

/// So many of the last parts that say more than that images are sent tell what these are: those before name who sends.
const TELLING: usize = 2;

/// What the name of an image topic speaks of: the first word that does, in the last part that has one. Words of cameras
/// (`depth_camera/image`) are who sends, unless the topic ends with them.
pub(super) fn content_of(topic: &str) -> Content {
    let parts = topic.split('/').filter(|part| !part.is_empty());
    let told = parts.rev().enumerate().map(|(place, part)| {
        let told = content_of_part(part, place == 0);
        (part, told)
    });
    let mut telling = told
        .filter(|(part, told)| told.is_some() || !is_kind(part))
        .take(TELLING);
    let found = telling.find_map(|(_, told)| told);
    found.unwrap_or(Content::Picture)
}

/// Whether a part of a topic's name speaks of labels.
pub(super) fn is_of_labels(part: &str) -> bool {
    content_of_part(part, true) == Some(Content::Labels)
}

fn content_of_part(part: &str, is_last: bool) -> Option<Content> {
    let words = words(part);
    let mut places = 0..words.len();
    places.find_map(|place| {
        let (_, content) = WORDS.iter().find(|(word, _)| *word == words[place])?;
        let next = words.get(place + 1);
        let is_of_camera = next.is_some_and(|next| next.starts_with("cam"));
        (is_last || !is_of_camera).then_some(*content)
    })
}

/// The words of a part, in small letters: `aligned_depth_to_color`, `compressedDepth`, `labels2`.
fn words(part: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut was_small = false;
    for letter in part.chars() {
        let begins = was_small && letter.is_uppercase();
        if begins || !letter.is_alphabetic() {
            words.push(String::new());
        }
        if let Some(word) = words.last_mut()
            && letter.is_alphabetic()
        {
            word.extend(letter.to_lowercase());
        }
        was_small = letter.is_lowercase();
    }
    words.retain(|word| !word.is_empty());
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_the_last_parts_tell_what_images_are() {
        for (topic, content) in [
            ("/depthcam_front/color/image/compressed", Content::Picture),
            ("/depth_camera_front/image/compressed", Content::Picture),
            ("/labelled/camera_front/image/compressed", Content::Picture),
            ("/semantic_slam/cameras/front/image_raw", Content::Picture),
            ("/depth_cam/rgb/image_rect_color", Content::Picture),
            ("/rgb_to_depth/image_raw", Content::Picture),
            ("/labeler/front/image", Content::Picture),
            ("/depth_camera", Content::Depth),
            ("/depth/front/image_raw", Content::Depth),
            ("/camera/depth/image_rect_raw", Content::Depth),
            ("/camera/aligned_depth_to_color/image_raw", Content::Depth),
            ("/front_camera_depth/image", Content::Depth),
            ("/kinect2/hd/image_depth_rect", Content::Depth),
            ("/front/image/compressedDepth", Content::Depth),
            ("/front/depthImage", Content::Depth),
            ("/front/semantic_segmentation/image", Content::Labels),
            ("/pano/Labels2/compressed", Content::Labels),
            ("/labels/cam0", Content::Labels),
        ] {
            assert_eq!(content_of(topic), content, "{topic}");
        }
    }
}
