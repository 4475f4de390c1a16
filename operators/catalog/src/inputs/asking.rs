//! Questions to people, as all layers of questions have them.

/// Why something of this probability is asked.
pub(crate) fn reason(probability: f64) -> &'static str {
    match probability {
        0.25..=0.75 => "uncertain",
        _ => "unlike every label so far",
    }
}
