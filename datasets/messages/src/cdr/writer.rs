//! Writes CDR: plain, little-endian (OMG DDS-XTypes 7.4.1).

/// Encapsulation header of plain little-endian CDR.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Writes one message. Numbers are aligned to their own size, counted from the end of the header.
pub struct CdrWriter(Vec<u8>);

impl CdrWriter {
    pub(crate) fn new() -> Self {
        Self(HEADER.to_vec())
    }

    fn aligned(&mut self, number: &[u8]) {
        while !(self.0.len() - HEADER.len()).is_multiple_of(number.len()) {
            self.0.push(0);
        }
        self.0.extend_from_slice(number);
    }

    /// A `bool` or `uint8`.
    pub(crate) fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    /// A `uint16`.
    pub(crate) fn u16(&mut self, value: u16) {
        self.aligned(&value.to_le_bytes());
    }

    /// A `uint32`.
    pub(crate) fn u32(&mut self, value: u32) {
        self.aligned(&value.to_le_bytes());
    }

    /// A `float32`.
    pub(crate) fn f32(&mut self, value: f32) {
        self.aligned(&value.to_le_bytes());
    }

    /// `float64`s one after the other, as fixed arrays and structs of them are.
    pub(crate) fn f64s(&mut self, values: &[f64]) {
        for value in values {
            self.aligned(&value.to_le_bytes());
        }
    }

    /// A `string`: length with the closing zero, bytes, zero.
    pub(crate) fn string(&mut self, value: &str) {
        self.u32(value.len() as u32 + 1);
        self.0.extend_from_slice(value.as_bytes());
        self.0.push(0);
    }

    /// A `uint8[]`.
    pub(crate) fn octets(&mut self, values: &[u8]) {
        self.u32(values.len() as u32);
        self.0.extend_from_slice(values);
    }

    /// The message with its header.
    pub(crate) fn finish(self) -> Vec<u8> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alignment_counts_from_after_the_header() {
        let mut cdr = CdrWriter::new();
        cdr.u8(7);
        cdr.f64s(&[1.0]);
        cdr.string("ab");
        cdr.u32(5);
        let bytes = cdr.finish();
        let expected = [
            0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f, 3, 0, 0, 0, b'a',
            b'b', 0, 0, 5, 0, 0, 0,
        ];
        assert_eq!(bytes, expected);
    }
}
