//! Reads MCAP fields from a byte slice, never past its end.
//!
//! Why not `mcap::parse_record`: on a damaged attachment it computes `body.len() - 4` unchecked.

use std::collections::BTreeMap;

/// What is left of a record.
#[derive(Debug, Clone, Copy)]
pub struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }
    /// The next `count` bytes.
    pub fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(count)?;
        self.0 = tail;
        Some(head)
    }
    pub fn u16(&mut self) -> Option<u16> {
        self.bytes(2)?.try_into().ok().map(u16::from_le_bytes)
    }
    pub fn u32(&mut self) -> Option<u32> {
        self.bytes(4)?.try_into().ok().map(u32::from_le_bytes)
    }
    pub fn u64(&mut self) -> Option<u64> {
        self.bytes(8)?.try_into().ok().map(u64::from_le_bytes)
    }
    /// A length (4 bytes) and that many bytes of UTF-8.
    pub fn string(&mut self) -> Option<&'a str> {
        let count = self.u32()? as usize;
        std::str::from_utf8(self.bytes(count)?).ok()
    }
    /// A length in bytes and that many bytes of string pairs.
    pub fn string_map(&mut self) -> Option<BTreeMap<String, String>> {
        let count = self.u32()? as usize;
        let mut inner = Cursor(self.bytes(count)?);
        let mut map = BTreeMap::new();
        while !inner.0.is_empty() {
            let key = inner.string()?.to_owned();
            map.insert(key, inner.string()?.to_owned());
        }
        Some(map)
    }
    /// Everything left.
    pub fn rest(self) -> &'a [u8] {
        self.0
    }
}
