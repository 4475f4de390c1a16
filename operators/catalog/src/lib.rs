//! The operators: one file each, with its page beside it, and the list of them.
//!
//! A kernel here is a translation from typed rows to `evermap_algorithms` and back; mathematics lives there, OpenCV
//! behind `evermap_vision`. There are no files, clocks or threads of a runtime, and no operator knows another.
//!
//! To add one: `name.rs`, `name.md`, and a line in the list below. The laws of the contract then run on it unasked.

use evermap_contract::{Entry, Registry};

mod inputs;

pub use inputs::drive::rigs;

macro_rules! operators {
    ($($file:ident::$operator:ident),+ $(,)?) => {
        $(pub mod $file;)+

        /// Every operator there is.
        pub fn registry() -> Registry {
            Registry::new([$(Entry::of::<$file::$operator>()),+])
        }
    };
}

// Sorted by file name; a test compares the list with the folder.
operators! {
    bundle_adjustment::BundleAdjustment,
    class_index::ClassIndex,
    class_scores::ClassScoring,
    crf_settings::CrfSettings,
    features::Features,
    frame_poses::FramePoses,
    ground_patches::GroundPatches,
    intersections::Intersections,
    keyframes::Keyframes,
    label_images::LabelImages,
    label_scores::LabelScores,
    landmarks::Landmarks,
    localisation::Localisation,
    loop_closures::LoopClosures,
    map_frames::MapFrames,
    overhead_tiles::OverheadTiles,
    pixel_forest::PixelForest,
    pixel_samples::PixelSampling,
    pose_graph::PoseGraph,
    recorded_labels::RecordedLabels,
    relocations::Relocations,
    road_network::RoadNetwork,
    temporal_scores::TemporalScores,
    tracks::Tracks,
    views::Views,
    word_relocations::WordRelocations,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use std::path::{Path, PathBuf};

    fn files(extension: &str) -> Vec<String> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        let paths = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path());
        let named = |path: &PathBuf| path.extension().is_some_and(|found| found == extension);
        let stem = |path: PathBuf| path.file_stem().unwrap().to_string_lossy().into_owned();
        let mut names: Vec<_> = paths
            .filter(named)
            .map(stem)
            .filter(|name| name != "lib")
            .collect();
        names.sort();
        names
    }

    #[test]
    fn the_list_the_files_and_the_pages_agree() {
        let listed: Vec<_> = registry()
            .entries()
            .map(|entry| entry.name.to_owned())
            .collect();
        assert_eq!(listed, files("rs"));
        assert_eq!(listed, files("md"));
        let source = include_str!("lib.rs");
        let places: Vec<_> = listed
            .iter()
            .map(|name| source.find(&format!("    {name}::")))
            .collect();
        assert!(places.is_sorted(), "the list is not sorted");
    }

    #[test]
    fn every_operator_keeps_the_laws() {
        for entry in registry().entries() {
            evermap_contract::laws::check(entry).unwrap_or_else(|fault| panic!("{fault}"));
        }
    }

    #[test]
    fn every_page_names_its_ports_and_parameters() {
        for entry in registry().entries() {
            let page = entry.page.0;
            assert!(
                page.starts_with(&format!("# {}\n", entry.name)),
                "{}: title",
                entry.name
            );
            assert!(page.contains("\n## Source\n"), "{}: source", entry.name);
            let parameters = entry
                .defaults
                .as_object()
                .unwrap()
                .keys()
                .map(String::as_str);
            for word in entry.ports.iter().map(|port| port.name).chain(parameters) {
                assert!(
                    page.contains(&format!("| `{word}` |")),
                    "{}: no line for {word}",
                    entry.name
                );
            }
        }
    }
}
