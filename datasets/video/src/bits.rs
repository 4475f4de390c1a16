//! Units of a frame, and the bits that they begin with (Annex B, 7.3.1 and 9.1 to 9.2 of ITU-T H.264 and H.265).

/// Each unit of a frame, from what follows its start code, 00 00 01, to the end of the frame; it has one byte or more.
pub(crate) fn units(frame: &[u8]) -> impl Iterator<Item = &[u8]> {
    let quads = frame.windows(4).enumerate();
    let starts = quads.filter(|(_, quad)| quad[..3] == [0, 0, 1]);
    starts.map(|(at, _)| &frame[at + 3..])
}

/// Reads bits one after the other, up to the next start code. All that is read is `None` where there are none left.
#[derive(Debug)]
pub(crate) struct Bits<'a> {
    rest: &'a [u8],
    /// Zero bytes before the rest.
    zeros: u32,
    byte: u8,
    /// How many bits of the byte are still to come.
    left: u32,
}

impl<'a> Bits<'a> {
    pub(crate) fn of(unit: &'a [u8]) -> Self {
        Self {
            rest: unit,
            zeros: 0,
            byte: 0,
            left: 0,
        }
    }

    /// The next byte that is meant: 3 stands behind two zeros so that no start code comes about.
    fn next_byte(&mut self) -> Option<u8> {
        let (mut byte, mut rest) = self.rest.split_first()?;
        let mut zeros = self.zeros;
        if zeros >= 2 {
            match *byte {
                0..=2 => return None,
                3 => {
                    zeros = 0;
                    (byte, rest) = rest.split_first()?;
                }
                _ => {}
            }
        }
        self.rest = rest;
        self.zeros = if *byte == 0 { zeros + 1 } else { 0 };
        Some(*byte)
    }

    /// A bit: `u(1)`.
    pub(crate) fn flag(&mut self) -> Option<bool> {
        if self.left == 0 {
            self.byte = self.next_byte()?;
            self.left = 8;
        }
        self.left -= 1;
        Some((self.byte >> self.left) & 1 == 1)
    }

    /// So many bits, 32 at most, the highest first: `u(n)`.
    pub(crate) fn number(&mut self, bits: u32) -> Option<u32> {
        let mut number = 0;
        for _ in 0..bits {
            number = (number << 1) | u32::from(self.flag()?);
        }
        Some(number)
    }

    pub(crate) fn skip(&mut self, bits: u32) -> Option<()> {
        for _ in 0..bits {
            self.flag()?;
        }
        Some(())
    }

    /// A number that says itself how long it is: `ue(v)`, less than 2^32 - 1.
    pub(crate) fn unsigned(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while !self.flag()? {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        let base = (1u32 << zeros) - 1;
        base.checked_add(self.number(zeros)?)
    }

    /// The same up to a largest one; `None` beyond.
    pub(crate) fn up_to(&mut self, largest: u32) -> Option<u32> {
        self.unsigned().filter(|number| *number <= largest)
    }

    /// Leaves out so many numbers of `ue(v)`, or `se(v)`, which are as long.
    pub(crate) fn pass(&mut self, numbers: u32) -> Option<()> {
        for _ in 0..numbers {
            self.unsigned()?;
        }
        Some(())
    }
}

/// How many bits an index below `count` has: Ceil(Log2(count)).
pub(crate) fn index_bits(count: u32) -> u32 {
    u32::BITS - count.saturating_sub(1).leading_zeros()
}

#[cfg(test)]
pub(crate) mod written {
    //! Units for tests, bit by bit.

    /// A unit behind a start code: its head, then bits, and those that end it.
    #[derive(Default)]
    pub(crate) struct Written {
        head: Vec<u8>,
        bits: Vec<bool>,
    }

    impl Written {
        pub(crate) fn unit(head: &[u8]) -> Self {
            Self {
                head: head.to_vec(),
                bits: Vec::new(),
            }
        }

        pub(crate) fn number(mut self, bits: u32, number: u32) -> Self {
            let all = (0..bits).rev().map(|bit| (number >> bit) & 1 == 1);
            self.bits.extend(all);
            self
        }

        pub(crate) fn flags(self, flags: &[u32]) -> Self {
            flags.iter().fold(self, |unit, flag| unit.number(1, *flag))
        }

        pub(crate) fn unsigned(self, numbers: &[u32]) -> Self {
            numbers.iter().fold(self, |unit, number| {
                let bits = (number + 1).ilog2();
                unit.number(bits, 0).number(bits + 1, number + 1)
            })
        }

        pub(crate) fn bytes(self) -> Vec<u8> {
            let mut bits = self.number(1, 1);
            while !bits.bits.len().is_multiple_of(8) {
                bits.bits.push(false);
            }
            let mut bytes = [&[0, 0, 1], bits.head.as_slice()].concat();
            let mut zeros = 0;
            for eight in bits.bits.chunks(8) {
                let byte = eight
                    .iter()
                    .fold(0, |byte, bit| (byte << 1) | u8::from(*bit));
                if zeros == 2 && byte <= 3 {
                    bytes.push(3);
                    zeros = 0;
                }
                zeros = if byte == 0 { zeros + 1 } else { 0 };
                bytes.push(byte);
            }
            bytes
        }
    }
}

#[cfg(test)]
mod tests {
    use super::written::Written;
    use super::*;

    #[test]
    fn bits_are_read_as_the_standards_write_them() {
        // Table 9-2: 1, 010, 011, 00100, 00101.
        let mut bits = Bits::of(&[0b1010_0110, 0b0100_0010, 0b1000_0000]);
        let read: Vec<_> = (0..5).map(|_| bits.unsigned()).collect();
        assert_eq!(read, [0, 1, 2, 3, 4].map(Some));
        let mut bits = Bits::of(&[0xa5, 0x0f]);
        assert_eq!((bits.number(4), bits.flag()), (Some(0xa), Some(false)));
        assert_eq!((bits.skip(3), bits.number(8)), (Some(()), Some(0x0f)));
        assert_eq!((bits.flag(), bits.number(0)), (None, Some(0)));
    }

    #[test]
    fn a_three_that_keeps_start_codes_out_is_not_read_and_a_start_code_ends() {
        let mut bits = Bits::of(&[0, 0, 3, 1, 0, 0, 3, 0, 7]);
        assert_eq!(bits.number(24), Some(1));
        assert_eq!(bits.number(32), Some(7));
        let mut bits = Bits::of(&[9, 0, 0, 1, 9]);
        assert_eq!((bits.number(24), bits.flag()), (Some(0x09_00_00), None));
        let mut bits = Bits::of(&[0, 0, 3]);
        assert_eq!((bits.number(16), bits.flag()), (Some(0), None));
        let units: Vec<_> = units(&[0, 0, 0, 1, 5, 0, 0, 1, 6, 0, 0, 1]).collect();
        assert_eq!(units.len(), 2);
        assert_eq!((units[0][0], units[1][0]), (5, 6));
    }

    #[test]
    fn numbers_end_at_32_bits() {
        let mut bits = Bits::of(&[0; 40]);
        assert_eq!(bits.unsigned(), None);
        let largest = Written::default().number(31, 0).number(32, u32::MAX);
        let largest = largest.bytes();
        let mut bits = Bits::of(&largest[3..]);
        assert_eq!(bits.unsigned(), Some(u32::MAX - 1));
        let mut bits = Bits::of(&[0b0010_0001, 0b0100_0000]);
        assert_eq!((bits.up_to(3), bits.up_to(3)), (Some(3), None));
    }

    #[test]
    fn an_index_has_as_many_bits_as_it_needs() {
        let counts = [0, 1, 2, 3, 4, 5, 32];
        assert_eq!(counts.map(index_bits), [0, 0, 1, 2, 2, 3, 5]);
    }
}
