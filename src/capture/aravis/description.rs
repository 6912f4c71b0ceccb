//! Reads a camera's GenICam description before the library does, and refuses what the library would not survive.
//!
//! Aravis 0.8.26 believes what a camera says: it allocates the size that the camera states (an absurd one ends the
//! process), fetches `File:` and `Http:` addresses, unpacks archives without looking at their lengths and follows a value
//! that refers to itself until the stack ends. All of that is seen here, with a few kilobytes over GVCP.

use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

use super::archive;
use super::error::LiveError;
use super::nodes;
use super::probe::Registers;
use crate::scene::CameraId;

/// Where the first address of the description stands, and its length.
const URL: (u32, usize) = (0x0200, 512);
/// The most that a description may be, packed or not: the largest known ones have 3 MB.
const BYTES_MOST: usize = 16 << 20;
/// A camera answers some thousand reads a second.
const PATIENCE: Duration = Duration::from_secs(10);

/// What is wrong with a description.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DescriptionError {
    /// The camera stopped answering.
    #[error("it stopped answering at address {address:#x}, byte {read} of {bytes}")]
    Silent {
        /// Where it begins.
        address: u32,
        /// Bytes read.
        read: usize,
        /// Bytes there should be.
        bytes: usize,
    },
    /// Its address cannot be used.
    #[error("its address {url:?} {why}")]
    Url {
        /// As the camera states it.
        url: String,
        /// What is wrong.
        why: &'static str,
    },
    /// Its archive is damaged.
    #[error("its archive {0}")]
    Archive(&'static str),
    /// It is no XML of nodes.
    #[error("{0}")]
    Xml(String),
}

/// Refuses a camera whose description would harm the library.
///
/// # Errors
/// [`LiveError::Description`].
pub fn check(camera: &CameraId, address: Ipv4Addr) -> Result<(), LiveError> {
    examine(address).map_err(|why| LiveError::Description {
        camera: camera.clone(),
        address,
        why,
    })
}

fn examine(address: Ipv4Addr) -> Result<(), DescriptionError> {
    let until = Instant::now() + PATIENCE;
    let text = read(address, (URL.0, URL.1), until)?;
    let place = Place::parse(&text)?;
    let raw = read(address, (place.address, place.bytes), until)?;
    let xml = if place.packed {
        archive::first_file(&raw, BYTES_MOST).map_err(DescriptionError::Archive)?
    } else {
        raw
    };
    nodes::check(&xml).map_err(DescriptionError::Xml)
}

fn read(
    camera: Ipv4Addr,
    (address, bytes): (u32, usize),
    until: Instant,
) -> Result<Vec<u8>, DescriptionError> {
    let silent = |read: usize| DescriptionError::Silent { address, read, bytes };
    let mut registers = Registers::of(camera).map_err(|_| silent(0))?;
    let mut read = Vec::with_capacity(bytes);
    while read.len() < bytes {
        let at = u32::try_from(read.len()).map_or(u32::MAX, |done| address.saturating_add(done));
        let part = registers.read(at, bytes - read.len(), until);
        read.extend(part.ok_or_else(|| silent(read.len()))?);
    }
    read.truncate(bytes);
    Ok(read)
}

/// Where in the camera's memory the description is.
#[derive(Debug, PartialEq, Eq)]
struct Place {
    address: u32,
    bytes: usize,
    packed: bool,
}

impl Place {
    /// `Local:name.zip;ADDRESS;SIZE`, both in hexadecimal, perhaps with `?SchemaVersion=…` behind.
    fn parse(text: &[u8]) -> Result<Self, DescriptionError> {
        let end = text.iter().position(|b| *b == 0).unwrap_or(text.len());
        let url = String::from_utf8_lossy(text.get(..end).unwrap_or_default()).into_owned();
        let wrong = |why| DescriptionError::Url {
            url: url.chars().filter(|c| !c.is_control()).take(80).collect(),
            why,
        };
        let (scheme, rest) = url.split_once(':').ok_or_else(|| wrong("is none"))?;
        if !scheme.trim().eq_ignore_ascii_case("local") {
            return Err(wrong("is not in the camera's own memory"));
        }
        let mut parts = rest.split('?').next().unwrap_or_default().split(';');
        let name = parts.next().unwrap_or_default();
        let mut number = || {
            let text = parts.next()?.trim();
            let text = text.strip_prefix("0x").unwrap_or(text);
            u64::from_str_radix(text, 16).ok()
        };
        let (Some(address), Some(bytes)) = (number(), number()) else {
            return Err(wrong("has no address and size"));
        };
        let bytes = usize::try_from(bytes).unwrap_or(usize::MAX);
        if bytes == 0 || bytes > BYTES_MOST {
            return Err(wrong("states an absurd size"));
        }
        let fits = u32::try_from(address)
            .ok()
            .filter(|a| u64::from(*a) + bytes as u64 <= 1 << 32);
        Ok(Self {
            address: fits.ok_or_else(|| wrong("leads out of the camera's memory"))?,
            bytes,
            packed: name.to_ascii_lowercase().ends_with(".zip"),
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_usual_addresses_are_understood_and_the_absurd_refused() {
        let place = Place::parse(b"Local:ACE_GIGE.zip;F0000000;3BF4\0\0").unwrap();
        assert_eq!(
            (place.address, place.bytes, place.packed),
            (0xf000_0000, 0x3bf4, true)
        );
        let place = Place::parse(b"local:///cam.xml;0x10000;ab?SchemaVersion=1.1.0").unwrap();
        assert_eq!(
            (place.address, place.bytes, place.packed),
            (0x1_0000, 0xab, false)
        );
        for (url, why) in [
            (&b"File:/dev/zero"[..], "own memory"),
            (b"http://10.0.0.1/a.xml", "own memory"),
            (b"Local:a.xml;10000;FFFFFFFFFFFF", "absurd size"),
            (b"Local:a.xml;10000;0", "absurd size"),
            (b"Local:a.xml;FFFFFFF0;100", "leads out"),
            (b"Local:a.xml", "no address"),
            (b"\0", "is none"),
        ] {
            let error = Place::parse(url).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(5000))]
        #[test]
        fn any_address_is_read_or_refused(text in "(Local:|local:///|[a-zA-Z]{0,6}:?)[ -~]{0,40}(;[0-9a-fA-Fx]{0,20}){0,3}") {
            if let Ok(place) = Place::parse(text.as_bytes()) {
                prop_assert!((1..=BYTES_MOST).contains(&place.bytes));
            }
        }
    }
}
