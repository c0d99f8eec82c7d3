//! The container before PyTorch 1.6: three small pickles (magic number, protocol version, system
//! information), the object's pickle, the list of storage keys, and the raw storages in that
//! order, each after its number of values as int64.

use std::{collections::HashMap, ops::Range};

use super::{
    error::Problem,
    pickle::{self, ElementType, Object, Pickled},
};

/// The magic number 0x1950a86a20f9469cfc6c, pickled with protocol 2.
pub(super) const MAGIC: &[u8] = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.";
/// The only layout ever written behind that number.
const PROTOCOL_VERSION: i64 = 1001;

/// An opened legacy container.
#[derive(Debug)]
pub(super) struct LegacyFile {
    bytes: Vec<u8>,
    storages: HashMap<String, Range<usize>>,
}

impl LegacyFile {
    pub(super) fn open(bytes: Vec<u8>) -> Result<(Self, Pickled), Problem> {
        let mut offset = MAGIC.len();
        let version = next_pickle(&bytes, &mut offset)?;
        if version.arena.int(version.root) != Some(PROTOCOL_VERSION) {
            return Err(Problem::UnknownContainer);
        }
        let system = next_pickle(&bytes, &mut offset)?;
        let little = system.arena.lookup(system.root, "little_endian");
        if little.and_then(|id| system.arena.get(id)) != Some(&Object::Bool(true)) {
            return Err(Problem::ByteOrder);
        }
        let object = next_pickle(&bytes, &mut offset)?;
        let keys = next_pickle(&bytes, &mut offset)?;
        let storages = locate_storages(&bytes, offset, &object, &keys)?;
        Ok((Self { bytes, storages }, object))
    }

    pub(super) fn storage(&self, key: &str) -> Result<&[u8], Problem> {
        let range = self.storages.get(key).cloned();
        let found = range.and_then(|range| self.bytes.get(range));
        found.ok_or_else(|| Problem::MissingEntry(key.to_owned()))
    }
}

fn next_pickle(bytes: &[u8], offset: &mut usize) -> Result<Pickled, Problem> {
    let rest = bytes.get(*offset..).unwrap_or_default();
    let pickled = pickle::interpret(rest)?;
    *offset += pickled.consumed;
    Ok(pickled)
}

/// Where each storage's bytes are. Element types come from the object: the list has keys alone.
fn locate_storages(
    bytes: &[u8],
    mut offset: usize,
    object: &Pickled,
    keys: &Pickled,
) -> Result<HashMap<String, Range<usize>>, Problem> {
    let elements: HashMap<&str, ElementType> =
        object.arena.storages().map(|storage| (&*storage.key, storage.element)).collect();
    let damaged = Problem::StorageList;
    let list = keys.arena.items(keys.root).ok_or(damaged(offset))?;
    let mut storages = HashMap::new();
    for &key in list {
        let key = keys.arena.text(key).ok_or(damaged(offset))?;
        let element = elements.get(&**key).ok_or(damaged(offset))?;
        let (size, start) = storage_size(bytes, offset, *element).ok_or(damaged(offset))?;
        let available = bytes.len().saturating_sub(start);
        if size > available {
            return Err(Problem::StorageSize {
                key: key.to_string(),
                expected: size as u64,
                found: available as u64,
            });
        }
        offset = start + size;
        if storages.insert(key.to_string(), start..offset).is_some() {
            return Err(damaged(offset));
        }
    }
    Ok(storages)
}

/// Bytes of the storage whose header is at `offset`, and where they start.
fn storage_size(bytes: &[u8], offset: usize, element: ElementType) -> Option<(usize, usize)> {
    let start = offset.checked_add(8)?;
    let header: [u8; 8] = bytes.get(offset..start)?.try_into().ok()?;
    let values = usize::try_from(i64::from_le_bytes(header)).ok()?;
    Some((values.checked_mul(element.bytes())?, start))
}
