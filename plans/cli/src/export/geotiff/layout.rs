//! The order of a Cloud Optimized GeoTIFF: who reads a part of it by ranges, as by HTTP, finds everything that says where
//! things are at its beginning.
//!
//! ```text
//!   all directories with their values; blocks of the smallest overview; …; blocks of the picture
//! ```
//! Format: OGC Cloud Optimized GeoTIFF 1.0 (21-026), TIFF 6.0.

use std::collections::BTreeMap;

use tiff::tags::Tag;

/// Bytes before the first directory.
const HEADER: usize = 8;

/// One resolution: what it takes to decode it, and its blocks.
pub struct Level {
    /// All but where the blocks are.
    pub directory: Directory,
    /// They, row by row.
    pub blocks: Vec<Vec<u8>>,
}

/// A directory: its entries by tag.
#[derive(Default)]
pub struct Directory(BTreeMap<u16, Entry>);

struct Entry {
    kind: u16,
    count: usize,
    /// All of its values, as they are stored.
    values: Vec<u8>,
}

/// The file of a picture and its overviews, each smaller than the one before, in this order; `None` where it would be
/// larger than 4 GiB.
pub fn file(mut levels: Vec<Level>) -> Option<Vec<u8>> {
    for Level { directory, blocks } in &mut levels {
        let sizes = blocks.iter().map(|block| u32::try_from(block.len()).ok());
        let sizes: Vec<u32> = sizes.collect::<Option<_>>()?;
        directory.longs(Tag::TileByteCounts, &sizes);
        // As many as there will be.
        directory.longs(Tag::TileOffsets, &sizes);
    }
    let directories = levels.iter().map(|level| level.directory.size());
    let mut at = HEADER + directories.sum::<usize>();
    for Level { directory, blocks } in levels.iter_mut().rev() {
        let mut offsets = Vec::with_capacity(blocks.len());
        for block in blocks {
            offsets.push(u32::try_from(at).ok()?);
            at += block.len();
        }
        directory.longs(Tag::TileOffsets, &offsets);
    }
    u32::try_from(at).ok()?;
    let mut out = Vec::with_capacity(at);
    out.extend(*b"II*\0");
    out.extend((HEADER as u32).to_le_bytes());
    for (number, level) in levels.iter().enumerate() {
        level.directory.write(&mut out, number + 1 == levels.len());
    }
    let blocks = levels.iter().rev().flat_map(|level| &level.blocks);
    blocks.for_each(|block| out.extend(block));
    Some(out)
}

impl Entry {
    /// Bytes that it takes behind the directory: values begin at even places.
    fn behind(&self) -> usize {
        match self.values.len() {
            0..=4 => 0,
            more => more.next_multiple_of(2),
        }
    }
}

impl Directory {
    /// Sets an entry of `SHORT`s.
    pub fn shorts(&mut self, tag: Tag, values: &[u16]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.set(tag, 3, values.len(), bytes.collect());
    }

    /// Sets an entry of `LONG`s.
    pub fn longs(&mut self, tag: Tag, values: &[u32]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.set(tag, 4, values.len(), bytes.collect());
    }

    /// Sets an entry of `DOUBLE`s.
    pub fn doubles(&mut self, tag: Tag, values: &[f64]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.set(tag, 12, values.len(), bytes.collect());
    }

    /// Sets an entry of `ASCII`, which ends with a zero.
    pub fn text(&mut self, tag: Tag, text: &str) {
        let bytes: Vec<u8> = text.bytes().chain([0]).collect();
        self.set(tag, 2, bytes.len(), bytes);
    }

    fn set(&mut self, tag: Tag, kind: u16, count: usize, values: Vec<u8>) {
        let entry = Entry {
            kind,
            count,
            values,
        };
        self.0.insert(tag.to_u16(), entry);
    }

    /// Bytes of its table.
    fn table(&self) -> usize {
        2 + 12 * self.0.len() + 4
    }

    /// Bytes with the values behind it.
    fn size(&self) -> usize {
        self.table() + self.0.values().map(Entry::behind).sum::<usize>()
    }

    fn write(&self, out: &mut Vec<u8>, last: bool) {
        let begin = out.len();
        let mut at = begin + self.table();
        out.extend((self.0.len() as u16).to_le_bytes());
        for (tag, entry) in &self.0 {
            out.extend(tag.to_le_bytes());
            out.extend(entry.kind.to_le_bytes());
            out.extend((entry.count as u32).to_le_bytes());
            match entry.behind() {
                0 => {
                    let mut values = [0; 4];
                    values[..entry.values.len()].copy_from_slice(&entry.values);
                    out.extend(values);
                }
                size => {
                    out.extend((at as u32).to_le_bytes());
                    at += size;
                }
            }
        }
        let next = if last { 0 } else { at as u32 };
        out.extend(next.to_le_bytes());
        for entry in self.0.values().filter(|entry| entry.behind() > 0) {
            out.extend(&entry.values);
            out.resize(out.len().next_multiple_of(2), 0);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn u32_at(file: &[u8], at: usize) -> usize {
        u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize
    }

    /// Where the value of an entry is, or what it is; and how many there are.
    fn found(file: &[u8], directory: usize, number: usize) -> (usize, usize) {
        let entry = directory + 2 + 12 * number;
        (u32_at(file, entry + 8), u32_at(file, entry + 4))
    }

    #[test]
    fn directories_come_first_and_lead_to_their_blocks() {
        let level = |name: &str, blocks: &[&str]| {
            let mut directory = Directory::default();
            directory.text(Tag::Artist, name);
            Level {
                directory,
                blocks: blocks
                    .iter()
                    .map(|block| block.as_bytes().to_vec())
                    .collect(),
            }
        };
        let file = file(vec![
            level("abcdef", &["first", "second"]),
            level("ab", &["small"]),
        ])
        .unwrap();
        assert_eq!(file[..8], *b"II*\0\x08\0\0\0");
        assert!(file.ends_with(b"smallfirstsecond"));
        // The name, then offsets, then sizes: tags ascend.
        let (name, letters) = found(&file, 8, 0);
        assert_eq!(file[name..name + letters], *b"abcdef\0");
        let (offsets, count) = found(&file, 8, 1);
        let blocks = [0, 4].map(|at| u32_at(&file, offsets + at));
        assert_eq!((blocks, count), ([file.len() - 11, file.len() - 6], 2));
        let (sizes, _) = found(&file, 8, 2);
        assert_eq!([0, 4].map(|at| u32_at(&file, sizes + at)), [5, 6]);
        // One value stands in the entry itself.
        let overview = u32_at(&file, 8 + 2 + 12 * 3);
        assert_eq!(found(&file, overview, 0), (0x6261, 3));
        assert_eq!(found(&file, overview, 1), (file.len() - 16, 1));
        assert_eq!(u32_at(&file, overview + 2 + 12 * 3), 0);
    }
}
