//! Sets of views.

/// Views of a map, one bit for each.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ViewSet {
    words: Vec<u64>,
    /// Views there are.
    views: usize,
}

impl ViewSet {
    /// None of `views` views.
    pub fn none(views: usize) -> Self {
        Self {
            words: vec![0; views.div_ceil(64)],
            views,
        }
    }

    /// As bytes: view n is bit n modulo 8 of byte n / 8, the lowest bit first.
    pub fn to_bytes(&self) -> Vec<u8> {
        let bytes = self.words.iter().flat_map(|word| word.to_le_bytes());
        bytes.take(self.views.div_ceil(8)).collect()
    }

    /// Of `views` views, from what [`ViewSet::to_bytes`] gave; `None` for as many bytes as so many views do not have, and
    /// where a view is among them that there is not.
    pub fn from_bytes(bytes: &[u8], views: usize) -> Option<Self> {
        let words = bytes.chunks(8).map(|chunk| {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            u64::from_le_bytes(word)
        });
        let words: Vec<u64> = words.collect();
        let beyond = words.last().is_some_and(|last| match views % 64 {
            0 => false,
            used => last >> used != 0,
        });
        (bytes.len() == views.div_ceil(8) && !beyond).then_some(Self { words, views })
    }

    /// Adds a view; one that there is not is passed over.
    pub fn insert(&mut self, view: u32) {
        if (view as usize) < self.views {
            self.words[view as usize / 64] |= 1 << (view % 64);
        }
    }

    /// Whether a view is among these.
    pub fn contains(&self, view: u32) -> bool {
        let word = self.words.get(view as usize / 64);
        word.is_some_and(|word| word >> (view % 64) & 1 == 1)
    }

    /// How many they are.
    pub fn count(&self) -> usize {
        self.words
            .iter()
            .map(|word| word.count_ones() as usize)
            .sum()
    }

    /// The views, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        (0_u32..).zip(&self.words).flat_map(|(at, word)| {
            let mut rest = *word;
            std::iter::from_fn(move || {
                let bit = (rest != 0).then(|| rest.trailing_zeros())?;
                rest &= rest - 1;
                Some(at * 64 + bit)
            })
        })
    }

    /// The views, ascending.
    pub fn to_vec(&self) -> Vec<u32> {
        let mut views = Vec::with_capacity(self.count());
        views.extend(self.iter());
        views
    }
}
