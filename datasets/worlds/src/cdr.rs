//! CDR, the byte format of ROS 2 messages (OMG DDS-XTypes 7.4.1, plain CDR, little-endian).

/// Writes one message. Primitives are aligned to their own size, counted from the end of the
/// four-byte encapsulation header.
#[derive(Debug, Clone)]
pub struct CdrWriter {
    bytes: Vec<u8>,
}

const HEADER: [u8; 4] = [0, 1, 0, 0];

impl Default for CdrWriter {
    fn default() -> Self {
        Self {
            bytes: HEADER.to_vec(),
        }
    }
}

impl CdrWriter {
    fn align(&mut self, size: usize) {
        while !(self.bytes.len() - HEADER.len()).is_multiple_of(size) {
            self.bytes.push(0);
        }
    }

    /// A `bool` or `uint8`.
    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    /// A `uint32`.
    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// An `int32`.
    pub fn i32(&mut self, value: i32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// A `float64`.
    pub fn f64(&mut self, value: f64) {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// A fixed array of `float64`.
    pub fn f64_array(&mut self, values: &[f64]) {
        for value in values {
            self.f64(*value);
        }
    }

    /// A `float64[]`.
    pub fn f64_sequence(&mut self, values: &[f64]) {
        self.u32(values.len() as u32);
        self.f64_array(values);
    }

    /// A `string`: length with the closing zero, bytes, zero.
    pub fn string(&mut self, value: &str) {
        self.u32(value.len() as u32 + 1);
        self.bytes.extend_from_slice(value.as_bytes());
        self.bytes.push(0);
    }

    /// A `uint8[]`.
    pub fn u8_sequence(&mut self, values: &[u8]) {
        self.u32(values.len() as u32);
        self.bytes.extend_from_slice(values);
    }

    /// The finished message, with its encapsulation header.
    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alignment_counts_from_after_the_header() {
        let mut cdr = CdrWriter::default();
        cdr.u8(7);
        cdr.f64(1.0);
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
