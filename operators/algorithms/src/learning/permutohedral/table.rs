//! Distinct keys, numbered in the order in which they first appear.

/// Integer coordinates.
pub(super) type Key<const V: usize> = [i32; V];

/// A hash table without removal: open addressing, never more than half full.
pub(super) struct Keys<const V: usize> {
    keys: Vec<Key<V>>,
    /// Index of a key and one; 0 where there is none. A power of two of them.
    slots: Vec<u32>,
}

impl<const V: usize> Keys<V> {
    /// An empty table with room for about this many keys.
    pub(super) fn with_room(keys: usize) -> Self {
        Self {
            keys: Vec::with_capacity(keys),
            slots: vec![0; (2 * keys).next_power_of_two().max(64)],
        }
    }

    /// Number of keys.
    pub(super) fn len(&self) -> usize {
        self.keys.len()
    }

    /// A key by its number.
    #[inline(always)]
    pub(super) fn key(&self, number: usize) -> &Key<V> {
        &self.keys[number]
    }

    /// The number of a key, if it is there.
    #[inline(always)]
    pub(super) fn find(&self, key: &Key<V>) -> Option<u32> {
        self.slots[self.slot(key, hash(key))].checked_sub(1)
    }

    /// The number of a key, which is added if it is new.
    #[inline(always)]
    pub(super) fn insert(&mut self, key: &Key<V>) -> u32 {
        self.insert_hashed(key, hash(key))
    }

    /// The same, of a key whose [`hash`] is known.
    #[inline(always)]
    pub(super) fn insert_hashed(&mut self, key: &Key<V>, hash: u32) -> u32 {
        let slot = self.slot(key, hash);
        if let Some(number) = self.slots[slot].checked_sub(1) {
            return number;
        }
        self.keys.push(*key);
        let number = self.keys.len() as u32;
        self.slots[slot] = number;
        if 2 * self.keys.len() > self.slots.len() {
            self.grow();
        }
        number - 1
    }

    /// Where the key is, or would be.
    #[inline(always)]
    fn slot(&self, key: &Key<V>, hash: u32) -> usize {
        let most = self.slots.len() - 1;
        let mut slot = hash as usize & most;
        loop {
            match self.slots[slot].checked_sub(1) {
                Some(number) if self.keys[number as usize] != *key => slot = (slot + 1) & most,
                _ => return slot,
            }
        }
    }

    #[cold]
    fn grow(&mut self) {
        self.slots = vec![0; 2 * self.slots.len()];
        for number in 0..self.keys.len() {
            let key = &self.keys[number];
            let slot = self.slot(key, hash(key));
            self.slots[slot] = number as u32 + 1;
        }
    }
}

/// Mixed so that the lower bits depend on all coordinates.
#[inline(always)]
fn hash<const V: usize>(key: &Key<V>) -> u32 {
    hashes(&key.map(|coordinate| [coordinate]))[0]
}

/// The hashes of several keys, which are given coordinate by coordinate.
#[inline(always)]
pub(super) fn hashes<const V: usize, const KEYS: usize>(keys: &[[i32; KEYS]; V]) -> [u32; KEYS] {
    let mut mixed = [0u32; KEYS];
    for coordinates in keys {
        for (mixed, coordinate) in mixed.iter_mut().zip(coordinates) {
            *mixed = (mixed.rotate_left(11) ^ *coordinate as u32).wrapping_mul(0x9e37_79b1);
        }
    }
    mixed.map(|mixed| mixed ^ (mixed >> 15))
}
