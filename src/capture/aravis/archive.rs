//! The archive (zip) in which cameras keep their descriptions: every length in it is looked at before it is believed.

use std::io::Read;

const END: &[u8] = b"PK\x05\x06";
const ENTRY: &[u8] = b"PK\x01\x02";
const FILE: &[u8] = b"PK\x03\x04";
const END_BYTES: usize = 22;
const ENTRY_BYTES: usize = 46;
const FILE_BYTES: usize = 30;
/// An archive of a description has one file, some have a schema beside it.
const FILES_MOST: usize = 64;

fn word16(bytes: &[u8], at: usize) -> Option<usize> {
    let word: [u8; 2] = bytes.get(at..at.checked_add(2)?)?.try_into().ok()?;
    Some(usize::from(u16::from_le_bytes(word)))
}

fn word32(bytes: &[u8], at: usize) -> Option<usize> {
    let word: [u8; 4] = bytes.get(at..at.checked_add(4)?)?.try_into().ok()?;
    usize::try_from(u32::from_le_bytes(word)).ok()
}

/// One file, as the directory at the archive's end has it.
struct Entry {
    method: usize,
    packed_bytes: usize,
    bytes: usize,
    header: usize,
}

/// The first file of an archive, unpacked; at most `most` bytes.
///
/// # Errors
/// What is wrong, in words that follow "its archive".
pub fn first_file(archive: &[u8], most: usize) -> Result<Vec<u8>, &'static str> {
    let ends: Vec<usize> = archive
        .windows(END.len())
        .enumerate()
        .filter_map(|(at, bytes)| (bytes == END).then_some(at))
        .collect();
    let [end] = ends.as_slice() else {
        return Err(match ends.is_empty() {
            true => "has no end: it is cut short",
            false => "has several ends",
        });
    };
    let entries = directory(archive, *end).ok_or("has a directory that leads out of it")?;
    let first = entries.first().ok_or("is empty")?;
    let mut unpacked = Vec::new();
    for (k, entry) in entries.iter().enumerate() {
        let packed = packed_bytes(archive, entry).ok_or("has a file that leads out of it")?;
        if entry.bytes > most {
            return Err("states an absurd size");
        }
        if k == 0 {
            unpacked = unpack(packed, first, most)?;
        }
    }
    Ok(unpacked)
}

fn directory(archive: &[u8], end: usize) -> Option<Vec<Entry>> {
    archive.get(end..end + END_BYTES)?;
    let count = word16(archive, end + 10).filter(|n| *n <= FILES_MOST)?;
    let mut at = word32(archive, end + 16)?;
    let mut entries = Vec::with_capacity(count);
    for _ in 0..count {
        let head = archive.get(at..at.checked_add(ENTRY_BYTES)?)?;
        if !head.starts_with(ENTRY) {
            return None;
        }
        entries.push(Entry {
            method: word16(head, 10)?,
            packed_bytes: word32(head, 20)?,
            bytes: word32(head, 24)?,
            header: word32(head, 42)?,
        });
        let names = word16(head, 28)? + word16(head, 30)? + word16(head, 32)?;
        at = at.checked_add(ENTRY_BYTES + names).filter(|at| *at <= end)?;
    }
    Some(entries)
}

fn packed_bytes<'a>(archive: &'a [u8], entry: &Entry) -> Option<&'a [u8]> {
    let head = archive.get(entry.header..entry.header.checked_add(FILE_BYTES)?)?;
    if !head.starts_with(FILE) {
        return None;
    }
    let begin = entry.header + FILE_BYTES + word16(head, 26)? + word16(head, 28)?;
    archive.get(begin..begin.checked_add(entry.packed_bytes)?)
}

fn unpack(packed: &[u8], entry: &Entry, most: usize) -> Result<Vec<u8>, &'static str> {
    let mut unpacked = Vec::new();
    match entry.method {
        0 => unpacked.extend_from_slice(packed),
        8 => {
            let inflated = flate2::read::DeflateDecoder::new(packed);
            let mut limited = inflated.take(most as u64 + 1);
            limited
                .read_to_end(&mut unpacked)
                .map_err(|_| "has a damaged file")?;
        }
        _ => return Err("is packed in an unknown way"),
    }
    if unpacked.len() != entry.bytes {
        return Err("does not hold what it states");
    }
    Ok(unpacked)
}

#[cfg(test)]
pub(crate) mod tests {
    use std::io::Write;

    use proptest::prelude::*;

    use super::*;

    /// An archive of one deflated file.
    pub fn packed(name: &str, text: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(text).unwrap();
        let data = encoder.finish().unwrap();
        let sizes = [0, data.len() as u32, text.len() as u32];
        let words = |list: &[u16]| list.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
        let longs = |list: &[u32]| list.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
        let name_bytes = name.len() as u16;
        let mut file = FILE.to_vec();
        file.extend(words(&[20, 0, 8, 0, 0]));
        file.extend(longs(&sizes));
        file.extend(words(&[name_bytes, 0]));
        file.extend(name.as_bytes());
        file.extend(&data);
        let directory = file.len() as u32;
        file.extend(ENTRY);
        file.extend(words(&[20, 20, 0, 8, 0, 0]));
        file.extend(longs(&sizes));
        file.extend(words(&[name_bytes, 0, 0, 0, 0]));
        file.extend(longs(&[0, 0]));
        file.extend(name.as_bytes());
        let bytes = file.len() as u32 - directory;
        file.extend(END);
        file.extend(words(&[0, 0, 1, 1]));
        file.extend(longs(&[bytes, directory]));
        file.extend(words(&[0]));
        file
    }

    #[test]
    fn a_whole_archive_is_unpacked_and_a_cut_one_refused() {
        let text = "<RegisterDescription/>".repeat(50);
        let whole = packed("camera.xml", text.as_bytes());
        assert_eq!(first_file(&whole, 1 << 20).unwrap(), text.as_bytes());
        assert_eq!(first_file(&whole, 100), Err("states an absurd size"));
        let mut refused = 0;
        for cut in 0..whole.len() {
            refused += usize::from(first_file(&whole[..cut], 1 << 20).is_err());
        }
        assert_eq!(refused, whole.len());
        let mut bomb = packed("camera.xml", &vec![0; 4 << 20]);
        let at = bomb.len() - END_BYTES - "camera.xml".len() - ENTRY_BYTES + 24;
        bomb[at..at + 4].copy_from_slice(&100_u32.to_le_bytes());
        assert_eq!(first_file(&bomb, 1 << 20), Err("does not hold what it states"));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn no_damage_makes_it_panic(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12)) {
            let mut archive = packed("camera.xml", &b"<a><b/></a>".repeat(20));
            for (at, byte) in changes {
                let at = at.index(archive.len());
                archive[at] = byte;
            }
            if let Ok(text) = first_file(&archive, 1 << 16) {
                prop_assert!(text.len() <= 1 << 16);
            }
        }
    }
}
