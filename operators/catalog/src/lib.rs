//! The operators: one file each, with its page beside it, and the list of them.
//!
//! A kernel here is a translation from typed rows to `evermap_algorithms` and back; mathematics lives there, OpenCV
//! behind `evermap_vision`. There are no files, clocks or threads of a runtime, and no operator knows another.
//!
//! To add one: `family/name.rs`, `family/name.md`, and a line in the list below. The laws of the contract then run on it
//! unasked.

use evermap_contract::{Entry, Registry};

mod inputs;

pub use evermap_vision::{Rgb, decode_colour, image_size};
pub use inputs::boxes::{mosaic, tile_gradients};
pub use inputs::drive::rigs;
pub use inputs::labels as annotated;
pub use inputs::masks::{ALL_CAMERAS, MASK};
pub use inputs::painting as painted;
pub use inputs::people::{ANSWERED_M, PERSON};
pub use inputs::rig::{Footing, OfVehicle, USUAL_VEHICLE, VehicleFrame, footing};

macro_rules! operators {
    ($($family:ident { $($file:ident::$operator:ident),+ $(,)? })+) => {
        $(
            #[allow(missing_docs)]
            pub mod $family {
                $(pub mod $file;)+
            }
        )+

        /// Every operator there is.
        pub fn registry() -> Registry {
            Registry::new([$($(Entry::of::<$family::$file::$operator>()),+),+])
        }
    };
}

// Sorted; a test compares the list with the folders.
operators! {
    ground {
        danger_map::DangerMap,
        danger_settings::DangerSettings,
        exposure::ExposureOfGround,
        ground_patches::GroundPatches,
        intersections::Intersections,
        lane_speeds::LaneSpeeds,
        overhead_gradients::GradientsOfTiles,
        overhead_tiles::OverheadTiles,
        people::People,
        people_on_ground::PeopleOnGround,
        person_examples::PersonExamples,
        person_hypotheses::PersonHypotheses,
        person_models::PersonModels,
        person_questions::PersonQuestions,
        road_network::RoadNetwork,
        speed_map::SpeedMap,
    }
    labels {
        box_hypotheses::BoxHypotheses,
        box_models::BoxModels,
        label_anchors::LabelAnchors,
        parking_spaces::ParkingSpaces,
        placed_labels::PlacedLabels,
        space_occupancy::SpacesOccupied,
        taught_labels::TaughtLabels,
    }
    learning {
        class_scores::ClassScoring,
        crf_settings::CrfSettings,
        label_images::LabelImages,
        label_scores::LabelScores,
        pixel_forest::PixelForest,
        pixel_network::PixelNetwork,
        pixel_samples::PixelSampling,
        temporal_scores::TemporalScores,
    }
    metric_map {
        antenna_positions::AntennaPositions,
        body_masks::BodyMasks,
        bundle_adjustment::BundleAdjustment,
        features::Features,
        frame_poses::FramePoses,
        georeference::Georeferences,
        inertial_odometry::InertialOdometry,
        keyframes::Keyframes,
        landmarks::Landmarks,
        localisation::Localisation,
        loop_closures::LoopClosures,
        map_frames::MapFrames,
        pose_graph::PoseGraph,
        speeds::Speeds,
        surface_points::SurfacePoints,
        tracks::Tracks,
    }
    semantic_map {
        class_index::ClassIndex,
        inferred_labels::InferredLabelImages,
        occlusion_counts::OcclusionCounts,
        occlusion_samples::OcclusionSamples,
        recorded_labels::RecordedLabels,
        registrations::Registrations,
        relation_index::RelationIndex,
        relocation_calibrations::RelocationCalibrations,
        relocations::Relocations,
        spheres::Spheres,
        view_links::ViewLinks,
        views::Views,
        warped_labels::WarpedLabelImages,
        word_relocations::WordRelocations,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use std::path::{Path, PathBuf};

    /// The files with this extension, `family/name`, without what only helps others.
    fn files(extension: &str) -> Vec<String> {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        let entries = |folder: &Path| {
            std::fs::read_dir(folder)
                .unwrap()
                .map(|entry| entry.unwrap().path())
        };
        let folders = entries(&source).filter(|path| path.is_dir() && !path.ends_with("inputs"));
        let named = |path: &PathBuf| path.extension().is_some_and(|found| found == extension);
        let name = |path: PathBuf| {
            let path = path.strip_prefix(&source).unwrap().with_extension("");
            path.to_string_lossy().into_owned()
        };
        let mut names: Vec<_> = folders
            .flat_map(|folder| entries(&folder).collect::<Vec<_>>())
            .filter(named)
            .map(name)
            .collect();
        names.sort();
        names
    }

    #[test]
    fn the_list_the_files_and_the_pages_agree() {
        assert_eq!(listed(), files("rs"));
        assert_eq!(listed(), files("md"));
    }

    /// The operators as the list above has them, `family/name`.
    fn listed() -> Vec<String> {
        let source = include_str!("lib.rs");
        let list = source.split("\noperators! {").nth(1).unwrap();
        let list = list.split("\n}").next().unwrap();
        let mut family = "";
        let mut names = Vec::new();
        for line in list.lines().map(str::trim) {
            match (line.strip_suffix(" {"), line.split_once("::")) {
                (Some(name), _) => family = name,
                (None, Some((name, _))) => names.push(format!("{family}/{name}")),
                _ => {}
            }
        }
        names
    }

    #[test]
    fn every_operator_keeps_the_laws() {
        for entry in registry().entries() {
            evermap_contract::laws::check(entry).unwrap_or_else(|fault| panic!("{fault}"));
        }
    }

    #[test]
    fn every_layer_is_declared_where_tables_are_looked_up_by_name() {
        let declared: Vec<&str> = evermap_schemas::layers::all()
            .iter()
            .map(|it| it.name)
            .collect();
        for entry in registry().entries() {
            assert!(declared.contains(&entry.output.name), "{}", entry.name);
        }
    }

    #[test]
    fn the_walk_through_shows_the_file_of_its_operator() {
        let walk = include_str!("../../../docs/adding-an-operator.md");
        assert!(walk.contains(include_str!("metric_map/speeds.rs")));
    }

    #[test]
    fn pages_leave_ports_and_parameters_to_their_declarations() {
        for entry in registry().entries() {
            let (name, page) = (entry.name, entry.page.0);
            assert!(page.starts_with(&format!("# {name}\n")), "{name}: title");
            assert!(page.contains("\n## Source\n"), "{name}: source");
            for told in ["\n## Ports", "\n## Parameters"] {
                assert!(
                    !page.contains(told),
                    "{name}: {told:?} is written from the declaration, see Entry::reference"
                );
            }
            for parameter in entry.parameters() {
                assert!(
                    !page.contains(&format!("| `{}` |", parameter.name)),
                    "{name}: {} is told twice",
                    parameter.name
                );
            }
        }
    }
}
