//! Names in messages: the nearest known one, and quoting that is safe to print.

/// Longer names are not compared: a mistyped name is short, a pasted page is not.
const LONGEST_COMPARED: usize = 64;
const LONGEST_SHOWN: usize = 60;

/// The candidate nearest to `name` by edit distance, if it is near enough to be meant:
/// at most a third of the letters wrong. Upper case and `-` for `_` cost nothing.
/// The first of equally near candidates wins.
#[must_use]
pub fn nearest<'k>(name: &str, candidates: impl IntoIterator<Item = &'k str>) -> Option<&'k str> {
    let length = name.chars().count();
    if length == 0 || length > LONGEST_COMPARED {
        return None;
    }
    let folded = fold(name);
    let allowed = (length / 3).max(1);
    let candidates = candidates.into_iter();
    let others = candidates.filter(|other| other.len() <= 4 * LONGEST_COMPARED && *other != name);
    let near = others.filter_map(|other| {
        let distance = strsim::damerau_levenshtein(&folded, &fold(other));
        let is_near = distance <= allowed && distance < other.chars().count().max(1);
        is_near.then_some((distance, other))
    });
    let nearest = near.min_by_key(|(distance, _)| *distance);
    nearest.map(|(_, candidate)| candidate)
}

fn fold(name: &str) -> String {
    name.to_lowercase().replace('-', "_")
}

/// `name` in backticks, control characters escaped, cut if very long.
pub(crate) fn quoted(name: &str) -> String {
    format!("`{}`", printable(name))
}

/// `name` with control characters escaped, cut if very long.
pub(crate) fn printable(name: &str) -> String {
    let mut out = String::new();
    for (index, c) in name.chars().enumerate() {
        if index == LONGEST_SHOWN {
            out.push('…');
            break;
        }
        if c.is_control() {
            out.extend(c.escape_debug());
        } else {
            out.push(c);
        }
    }
    out
}

/// A message of another program, its line breaks and runs of spaces as single spaces.
pub(crate) fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The names quoted and listed with commas: "`a`, `b`"; "none" when there are none.
#[must_use]
pub fn listed<'n>(names: impl IntoIterator<Item = &'n str>) -> String {
    const MOST_LISTED: usize = 12;
    let mut names = names.into_iter();
    let mut shown: Vec<String> = names.by_ref().take(MOST_LISTED).map(quoted).collect();
    if names.next().is_some() {
        shown.push("…".to_owned());
    }
    match shown.is_empty() {
        true => "none".to_owned(),
        false => shown.join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_found_and_far_ones_are_not() {
        let known = ["keyframes", "road_network", "overhead_tiles"];
        assert_eq!(nearest("road_netwrok", known), Some("road_network"));
        assert_eq!(nearest("Road-Network", known), Some("road_network"));
        assert_eq!(nearest("lanes", known), None);
        assert_eq!(nearest("", known), None);
        assert_eq!(nearest("x", ["y"]), None);
        assert_eq!(nearest(&"x".repeat(1000), known), None);
    }

    #[test]
    fn quoting_is_safe_to_print() {
        assert_eq!(quoted("a\u{1b}[31m"), "`a\\u{1b}[31m`");
        assert_eq!(quoted(&"x".repeat(70)).chars().count(), 63);
        assert_eq!(listed([]), "none");
    }
}
