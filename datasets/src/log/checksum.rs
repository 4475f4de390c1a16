//! The checksum of a file's bytes, from the first on.

/// What was hashed so far.
#[derive(Default)]
pub(crate) struct Checksum {
    crc: crc32fast::Hasher,
    hashed: u64,
}

impl Checksum {
    /// How many bytes were hashed.
    pub fn hashed(&self) -> u64 {
        self.hashed
    }

    /// Takes the next bytes.
    pub fn add(&mut self, bytes: &[u8]) {
        self.crc.update(bytes);
        self.hashed += bytes.len() as u64;
    }

    /// Of all bytes that were taken.
    pub fn finish(self) -> u32 {
        self.crc.finalize()
    }
}
