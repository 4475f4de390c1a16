//! From tracks and rough poses to an accurate map.

#[cfg(test)]
mod simulated;
#[cfg(test)]
mod tests;
