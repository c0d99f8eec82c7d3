//! Records of a binary FBX file, version 7.4: a name, properties, and records inside.

use crate::error::FormatError;

pub(super) const VERSION: u32 = 7400;
const MAGIC: &[u8] = b"Kaydara FBX Binary  \x00\x1a\x00";
/// A record of zeros, which ends a list of records.
const END: [u8; 13] = [0; 13];
/// Bytes before the name of a record: end, properties, their bytes, length of the name.
const HEAD: usize = 13;
/// End of the file. It depends on the time of creation, which is always the same here.
const FOOT: [u8; 16] = [
    0xfa, 0xbc, 0xab, 0x09, 0xd0, 0xc8, 0xd4, 0x66, 0xb1, 0x76, 0xfb, 0x83, 0x1c, 0xf7, 0x26, 0x7e,
];
const LAST: [u8; 16] = [
    0xf8, 0x5a, 0x8c, 0x6a, 0xde, 0xf5, 0xd9, 0x7e, 0xec, 0xe9, 0x0c, 0xe3, 0x75, 0x8f, 0x29, 0x0b,
];

/// A property of a record.
#[derive(Clone, Copy, Debug)]
pub(super) enum Value<'a> {
    Short(i16),
    Int(i32),
    Long(i64),
    Double(f64),
    Text(&'a str),
    Raw(&'a [u8]),
    Ints(&'a [i32]),
    Longs(&'a [i64]),
    Floats(&'a [f32]),
}

/// A file in the making.
pub(super) struct Records {
    bytes: Vec<u8>,
}

impl Records {
    pub(super) fn new(capacity: usize) -> Self {
        let mut bytes = Vec::with_capacity(capacity);
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        Self { bytes }
    }

    /// Adds a record without others inside.
    pub(super) fn leaf(&mut self, name: &str, values: &[Value<'_>]) {
        let start = self.begin(name, values);
        self.end_at(start);
    }

    /// Adds a record with those inside that `inside` adds.
    pub(super) fn node(
        &mut self,
        name: &str,
        values: &[Value<'_>],
        inside: impl FnOnce(&mut Self),
    ) {
        let start = self.begin(name, values);
        inside(self);
        self.bytes.extend(END);
        self.end_at(start);
    }

    fn begin(&mut self, name: &str, values: &[Value<'_>]) -> usize {
        let start = self.bytes.len();
        self.bytes.extend([0; HEAD]);
        self.bytes.extend(name.as_bytes());
        let first = self.bytes.len();
        values.iter().for_each(|value| self.value(value));
        let length = (self.bytes.len() - first) as u32;
        self.put(start + 4, values.len() as u32);
        self.put(start + 8, length);
        self.bytes[start + 12] = name.len() as u8;
        start
    }

    /// Places in the file have four bytes; [`Records::finish`] refuses a file with more.
    fn end_at(&mut self, start: usize) {
        self.put(start, self.bytes.len() as u32);
    }

    fn put(&mut self, at: usize, number: u32) {
        self.bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
    }

    fn value(&mut self, value: &Value<'_>) {
        match *value {
            Value::Short(number) => self.scalar(b'Y', &number.to_le_bytes()),
            Value::Int(number) => self.scalar(b'I', &number.to_le_bytes()),
            Value::Long(number) => self.scalar(b'L', &number.to_le_bytes()),
            Value::Double(number) => self.scalar(b'D', &number.to_le_bytes()),
            Value::Text(text) => self.blob(b'S', text.as_bytes()),
            Value::Raw(bytes) => self.blob(b'R', bytes),
            Value::Ints(numbers) => self.array(b'i', numbers, |n| n.to_le_bytes()),
            Value::Longs(numbers) => self.array(b'l', numbers, |n| n.to_le_bytes()),
            Value::Floats(numbers) => self.array(b'f', numbers, |n| n.to_le_bytes()),
        }
    }

    fn scalar(&mut self, kind: u8, bytes: &[u8]) {
        self.bytes.push(kind);
        self.bytes.extend(bytes);
    }

    fn blob(&mut self, kind: u8, bytes: &[u8]) {
        self.scalar(kind, &(bytes.len() as u32).to_le_bytes());
        self.bytes.extend(bytes);
    }

    /// Without compression, whose bytes would depend on the version of a library.
    fn array<T: Copy, const N: usize>(
        &mut self,
        kind: u8,
        numbers: &[T],
        bytes: impl Fn(T) -> [u8; N],
    ) {
        self.scalar(kind, &(numbers.len() as u32).to_le_bytes());
        self.bytes.extend(0_u32.to_le_bytes());
        self.bytes.extend(((N * numbers.len()) as u32).to_le_bytes());
        self.bytes.extend(numbers.iter().flat_map(|&number| bytes(number)));
    }

    /// Returns the file.
    ///
    /// # Errors
    /// [`FormatError::TooLong`] beyond the 4 GiB that places in the file can name.
    pub(super) fn finish(mut self) -> Result<Vec<u8>, FormatError> {
        self.bytes.extend(END);
        self.bytes.extend(FOOT);
        // At least one byte of padding.
        self.bytes.resize((self.bytes.len() + 1).next_multiple_of(16), 0);
        self.bytes.extend([0; 4]);
        self.bytes.extend(VERSION.to_le_bytes());
        self.bytes.extend([0; 120]);
        self.bytes.extend(LAST);
        let bytes = self.bytes.len() as u64;
        match u32::try_from(bytes) {
            Ok(_) => Ok(self.bytes),
            Err(_) => Err(FormatError::TooLong { format: "fbx", bytes }),
        }
    }
}
