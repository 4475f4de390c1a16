//! The order of a Cloud Optimized GeoTIFF: who reads a part of it by ranges, as by HTTP, finds everything that says where
//! things are at its beginning.
//!
//! ```text
//!   as encoded    blocks, directory of the picture; blocks, directory of an overview; …
//!   as laid out   all directories with their values; blocks of the smallest overview; …; blocks of the picture
//! ```
//! Format: OGC Cloud Optimized GeoTIFF 1.0 (21-026), TIFF 6.0.

/// Bytes before the first directory.
const HEADER: usize = 8;
/// Directories at most: each is half as wide as the one before.
const MOST: usize = 32;
/// Tags of what blocks are found by.
const OFFSETS: u16 = 324;
const SIZES: u16 = 325;

/// A directory, its entries in order.
struct Directory(Vec<Entry>);

struct Entry {
    tag: u16,
    kind: u16,
    count: u32,
    /// All of its values, as they are stored.
    values: Vec<u8>,
}

/// The same file in that order; `None` for what is no little-endian TIFF of blocks, or would be larger than 4 GiB.
pub fn cloud_optimized(file: &[u8]) -> Option<Vec<u8>> {
    let mut directories = directories(file)?;
    let mut at = HEADER + directories.iter().map(Directory::size).sum::<usize>();
    let mut blocks: Vec<&[u8]> = Vec::new();
    for directory in directories.iter_mut().rev() {
        let mut offsets = Vec::new();
        for (offset, size) in directory.numbers(OFFSETS)?.zip(directory.numbers(SIZES)?) {
            let block = file.get(offset..offset.checked_add(size)?)?;
            offsets.extend(u32::try_from(at).ok()?.to_le_bytes());
            at += block.len();
            blocks.push(block);
        }
        directory.entry(OFFSETS)?.values = offsets;
    }
    u32::try_from(at).ok()?;
    let mut out = Vec::with_capacity(at);
    out.extend(*b"II*\0");
    out.extend((HEADER as u32).to_le_bytes());
    let count = directories.len();
    for (number, directory) in directories.iter().enumerate() {
        directory.write(&mut out, number + 1 == count);
    }
    blocks.iter().for_each(|block| out.extend(*block));
    Some(out)
}

fn u16_at(file: &[u8], at: usize) -> Option<u16> {
    let (bytes, _) = file.get(at..)?.split_first_chunk()?;
    Some(u16::from_le_bytes(*bytes))
}

fn u32_at(file: &[u8], at: usize) -> Option<u32> {
    let (bytes, _) = file.get(at..)?.split_first_chunk()?;
    Some(u32::from_le_bytes(*bytes))
}

fn directories(file: &[u8]) -> Option<Vec<Directory>> {
    file.strip_prefix(b"II*\0")?;
    let mut all = Vec::new();
    let mut at = u32_at(file, 4)? as usize;
    while at != 0 {
        if all.len() == MOST {
            return None;
        }
        let count = usize::from(u16_at(file, at)?);
        let entries = (0..count).map(|number| entry(file, at + 2 + 12 * number));
        all.push(Directory(entries.collect::<Option<_>>()?));
        at = u32_at(file, at + 2 + 12 * count)? as usize;
    }
    Some(all)
}

fn entry(file: &[u8], at: usize) -> Option<Entry> {
    let (kind, count) = (u16_at(file, at + 2)?, u32_at(file, at + 4)?);
    let size = match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 => 8,
        _ => return None,
    } * count as usize;
    let values = match size {
        0..=4 => at + 8,
        _ => u32_at(file, at + 8)? as usize,
    };
    Some(Entry {
        tag: u16_at(file, at)?,
        kind,
        count,
        values: file.get(values..values.checked_add(size)?)?.to_vec(),
    })
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
    fn entry(&mut self, tag: u16) -> Option<&mut Entry> {
        self.0.iter_mut().find(|entry| entry.tag == tag)
    }

    /// The values of an entry of `LONG`s.
    fn numbers(&self, tag: u16) -> Option<impl Iterator<Item = usize> + use<>> {
        let found = self
            .0
            .iter()
            .find(|entry| entry.tag == tag && entry.kind == 4)?;
        let numbers = found.values.as_chunks::<4>().0.to_vec().into_iter();
        Some(numbers.map(|number| u32::from_le_bytes(number) as usize))
    }

    /// Bytes of its table.
    fn table(&self) -> usize {
        2 + 12 * self.0.len() + 4
    }

    /// Bytes with the values behind it.
    fn size(&self) -> usize {
        self.table() + self.0.iter().map(Entry::behind).sum::<usize>()
    }

    fn write(&self, out: &mut Vec<u8>, last: bool) {
        let begin = out.len();
        let mut at = begin + self.table();
        out.extend((self.0.len() as u16).to_le_bytes());
        for entry in &self.0 {
            out.extend(entry.tag.to_le_bytes());
            out.extend(entry.kind.to_le_bytes());
            out.extend(entry.count.to_le_bytes());
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
        for entry in self.0.iter().filter(|entry| entry.behind() > 0) {
            out.extend(&entry.values);
            out.resize(out.len().next_multiple_of(2), 0);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    /// A file of one picture of two blocks, laid out as an encoder does it, and with values behind its directory.
    fn file() -> Vec<u8> {
        let mut file = b"II*\0".to_vec();
        file.extend(18_u32.to_le_bytes());
        file.extend(b"firstsecon");
        file.extend(3_u16.to_le_bytes());
        for (tag, kind, count, value) in [
            (OFFSETS, 4_u16, 2, 60),
            (SIZES, 4, 2, 68),
            (999, 2, 3, 0x0061_6261),
        ] {
            file.extend(tag.to_le_bytes());
            file.extend(kind.to_le_bytes());
            file.extend(u32::to_le_bytes(count));
            file.extend(u32::to_le_bytes(value));
        }
        file.extend(0_u32.to_le_bytes());
        for number in [8_u32, 13, 5, 5] {
            file.extend(number.to_le_bytes());
        }
        file
    }

    #[test]
    fn directories_come_first_and_lead_to_the_same_blocks() {
        let laid_out = cloud_optimized(&file()).unwrap();
        assert_eq!(u32_at(&laid_out, 4), Some(8));
        let directory = &directories(&laid_out).unwrap()[0];
        let offsets: Vec<usize> = directory.numbers(OFFSETS).unwrap().collect();
        assert_eq!(offsets, [laid_out.len() - 10, laid_out.len() - 5]);
        assert_eq!(laid_out[offsets[0]..], *b"firstsecon");
        assert_eq!(directory.0[2].values, b"aba");
        assert_eq!(cloud_optimized(&laid_out).unwrap(), laid_out);
    }

    proptest! {
        #[test]
        fn no_bytes_cause_a_panic(place in 0_usize..80, byte: u8) {
            let mut file = file();
            if let Some(found) = file.get_mut(place) {
                *found = byte;
            }
            let _ = cloud_optimized(&file);
        }
    }
}
