//! What lies on the ground: images projected onto it, tiles of it, roads on it, boxes painted on it.
//!
//! | module | what it knows |
//! |---|---|
//! | [`boxes`] | boxes that look alike: parking spaces, crossings, arrows |
//! | [`cells`] | square cells by column and row, which are neighbours, which lie in an outline or along a line |
//! | [`channels`] | what images show of a cell: how bright it is, or its colour |
//! | [`danger`] | where people are, how often anybody looked, how fast to drive there |
//! | [`floor`] | the height of a floor that bends, by where vehicles stood |
//! | [`patch`] | what one image shows of the ground |
//! | [`people`] | people in images, upright, and where they stand |
//! | [`projection`] | images projected to cells of the ground plane |
//! | [`road_network`] | lanes and intersections from driven positions |
//! | [`segment`] | pieces of lines |
//! | [`tiles`] | tile addressing and exact integer sums |

pub mod boxes;
pub mod cells;
pub mod channels;
pub mod danger;
pub mod floor;
pub mod patch;
pub mod people;
pub mod projection;
pub mod road_network;
pub mod segment;
pub mod tiles;
