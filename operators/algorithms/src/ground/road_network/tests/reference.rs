//! Algorithm 1 transcribed line by line: a matrix, all pairs, cliques by trying every subset.

use super::super::cells::{distance, mean};

pub(super) struct Reference {
    pub(super) x: Vec<[f64; 3]>,
    /// A, rows and columns of all nodes; removed ones are empty.
    pub(super) a: Vec<Vec<bool>>,
    pub(super) exists: Vec<bool>,
}

impl Reference {
    pub(super) fn new(drives: &[Vec<[f64; 3]>], d: f64) -> Self {
        let x: Vec<[f64; 3]> = drives.concat();
        let m = x.len();
        let mut a = vec![vec![false; m]; m];
        for i in 0..m {
            for j in 0..m {
                a[i][j] = i != j && distance(&x[i], &x[j]) <= d;
            }
        }
        let mut first = 0;
        for drive in drives {
            let end = first + drive.len();
            for i in first..end {
                let mut n = 1;
                while i + n < end && distance(&x[i], &x[i + n]) <= d {
                    a[i][i + n] = false;
                    a[i + n][i] = false;
                    n += 1;
                }
            }
            for i in first + 1..end {
                a[i - 1][i] = true;
                a[i][i - 1] = true;
            }
            first = end;
        }
        Self {
            exists: vec![true; m],
            x,
            a,
        }
    }

    fn neighbours(&self, i: usize) -> Vec<usize> {
        (0..self.x.len()).filter(|&j| self.a[i][j]).collect()
    }

    /// Every subset of at least three that is a clique and has no clique one larger above it.
    fn cliques(&self) -> Vec<Vec<usize>> {
        let m = self.x.len();
        let mut found: Vec<Vec<usize>> = Vec::new();
        for subset in 0u32..1 << m {
            let members: Vec<usize> = (0..m).filter(|i| subset >> i & 1 == 1).collect();
            let joined = |i: usize| members.iter().all(|&j| i == j || self.a[i][j]);
            let clique = members.iter().all(|&i| joined(i));
            let maximal = (0..m).all(|i| members.contains(&i) || !joined(i));
            if members.len() > 2 && clique && maximal {
                found.push(members);
            }
        }
        found.sort_by(|p, q| q.len().cmp(&p.len()).then_with(|| p.cmp(q)));
        found
    }

    pub(super) fn prune(&mut self, loops: u32, d: f64) {
        for _ in 0..loops {
            let mut removed: Vec<usize> = Vec::new();
            let before = self.exists.clone();
            for c in self.cliques() {
                let centre = mean(c.iter().map(|&i| &self.x[i]));
                let by_distance = |i: usize| (distance(&centre, &self.x[i]), i);
                let b = (0..self.x.len())
                    .filter(|&i| before[i] && (c.contains(&i) || by_distance(i).0 <= d))
                    .map(by_distance)
                    .reduce(|p, q| if q < p { q } else { p })
                    .map_or(0, |(_, i)| i);
                let mut n: Vec<usize> = c.clone();
                n.extend(c.iter().flat_map(|&i| self.neighbours(i)));
                if n.iter().chain([&b]).any(|i| removed.contains(i)) {
                    continue;
                }
                for &i in n.iter().filter(|&&i| i != b) {
                    self.a[b][i] = true;
                    self.a[i][b] = true;
                }
                let dead = n.iter().copied().filter(|&i| self.neighbours(i).len() == 1);
                let gone: Vec<usize> = c.iter().copied().chain(dead).filter(|&i| i != b).collect();
                removed.extend(gone);
            }
            for &i in &removed {
                self.exists[i] = false;
                for j in 0..self.x.len() {
                    self.a[i][j] = false;
                    self.a[j][i] = false;
                }
            }
        }
    }
}
