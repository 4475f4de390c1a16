//! What hangs together.

/// The parts that what is `wanted` of so many is joined to, each from its first on; `neighbours` says what joins them.
pub(crate) fn parts<I: Iterator<Item = usize>>(
    count: usize,
    wanted: impl Fn(usize) -> bool,
    neighbours: impl Fn(usize) -> I,
) -> Vec<Vec<usize>> {
    let mut seen = vec![false; count];
    let mut parts = Vec::new();
    for start in 0..count {
        if seen[start] || !wanted(start) {
            continue;
        }
        seen[start] = true;
        let mut part = vec![start];
        let mut next = 0;
        while let Some(at) = part.get(next).copied() {
            next += 1;
            for other in neighbours(at) {
                if !seen[other] && wanted(other) {
                    seen[other] = true;
                    part.push(other);
                }
            }
        }
        parts.push(part);
    }
    parts
}

/// Makes one part of those that two are in. By member `parents` are another one of its part, before it; the first of a
/// part is its own (union-find).
#[inline]
pub(crate) fn join(parents: &mut [u32], both: [u32; 2]) {
    let [a, b] = both.map(|at| first(parents, at));
    parents[a.max(b) as usize] = a.min(b);
}

/// The first of the part that a member is in; the way to it becomes shorter.
#[inline]
pub(crate) fn first(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        let above = parents[parents[at as usize] as usize];
        parents[at as usize] = above;
        at = above;
    }
    at
}
