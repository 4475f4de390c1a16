//! What views show, as graphs of areas; how alike two views are, and places found again by it.
//!
//! | module | what it knows |
//! |---|---|
//! | [`class_scores`] | probabilities of classes over an image |
//! | [`relation_index`] | views by pairs of classes and how they lie |
//! | [`relocation`] | where in a map a view was taken, by the graph of what it shows |
//! | [`semantic_graph`] | label images as areas that touch, and where they lie of one another |
//! | [`stable`] | what a place looks like without what moves, from several visits |
//! | [`temporal_votes`] | what neighbouring views say about a view's pixels |

pub mod class_scores;
pub mod relation_index;
pub mod relocation;
pub mod semantic_graph;
pub mod stable;
pub mod temporal_votes;
