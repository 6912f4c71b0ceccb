//! Where a camera is: an address of the network, or a name that the library knows it by.

use std::net::Ipv4Addr;
use std::time::Duration;

use super::error::LiveError;
use super::ffi::list_near_devices;
use super::options::LiveOptions;
use super::probe;

/// How long a camera may take to answer a ping.
const PING: Duration = Duration::from_millis(100);
const DISCOVERY: Duration = Duration::from_millis(500);

/// Where a camera is now.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// A GigE Vision camera, by its address.
    Gige(Ipv4Addr),
    /// A camera that is not on the network (USB3 Vision), by the library's name for it. It is not pinged, and no packet
    /// filter stands before it: its cable ends here.
    Device(String),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Gige(address) => write!(f, "{address}"),
            Self::Device(id) => f.write_str(id),
        }
    }
}

impl Place {
    /// Whether the camera answers and is held (by us): `None` when it is silent, or not of the kind that is asked.
    pub fn is_held(&self) -> Option<bool> {
        match self {
            Self::Gige(address) => (0..3).find_map(|_| probe::is_held(*address, PING)),
            Self::Device(_) => None,
        }
    }
}

/// Finds the camera.
///
/// # Errors
/// Absent, another camera, or several.
pub fn locate(options: &LiveOptions) -> Result<Place, LiveError> {
    let which = &options.which;
    let fits = |found: &probe::Found| {
        which.serial.as_ref().is_none_or(|s| *s == found.serial)
            && which.user_name.as_ref().is_none_or(|n| *n == found.user_name)
    };
    if let Some(address) = which.address {
        if let Some(found) = (0..3).find_map(|_| probe::ping(address, PING)) {
            if fits(&found) {
                return Ok(Place::Gige(address));
            }
            // The right camera may have moved to another address: look there, else say who is here.
            return search(options, fits).map_err(|error| match (error, &which.serial) {
                (LiveError::Absent { camera, .. }, Some(serial)) => LiveError::AnotherCamera {
                    camera,
                    address,
                    found: found.serial,
                    expected: serial.clone(),
                },
                (LiveError::Absent { camera, sought, .. }, None) => LiveError::Absent {
                    camera,
                    sought,
                    others: others(std::slice::from_ref(&found)),
                },
                (other, _) => other,
            });
        }
        if which.serial.is_none() && which.user_name.is_none() {
            return Err(LiveError::Absent {
                camera: options.camera.clone(),
                sought: which.to_string(),
                others: String::new(),
            });
        }
    }
    search(options, fits)
}

/// On the network first; then on the USB bus, whose cameras have a serial number and no user-defined name.
fn search(options: &LiveOptions, fits: impl Fn(&probe::Found) -> bool) -> Result<Place, LiveError> {
    let all = probe::discover(DISCOVERY);
    let mut places: Vec<_> = all
        .iter()
        .filter(|camera| fits(camera))
        .map(|camera| Place::Gige(camera.address))
        .collect();
    let which = &options.which;
    if let (true, Some(serial), None, None) =
        (places.is_empty(), &which.serial, which.address, &which.user_name)
    {
        let near = list_near_devices().into_iter();
        places.extend(near.filter(|d| d.serial == *serial).map(|d| Place::Device(d.id)));
    }
    match places.as_slice() {
        [] => Err(LiveError::Absent {
            camera: options.camera.clone(),
            sought: options.which.to_string(),
            others: others(&all),
        }),
        [one] => Ok(one.clone()),
        _ => Err(LiveError::Ambiguous {
            camera: options.camera.clone(),
            sought: options.which.to_string(),
            places,
        }),
    }
}

/// The cameras that are there instead, as far as a line holds them.
fn others(found: &[probe::Found]) -> String {
    const MOST: usize = 4;
    if found.is_empty() {
        return String::new();
    }
    let told = found.iter().take(MOST).map(|camera| {
        let name = match camera.user_name.as_str() {
            "" => String::new(),
            name => format!(" named {name}"),
        };
        format!("serial {}{name} at {}", camera.serial, camera.address)
    });
    let more = if found.len() > MOST { ", …" } else { "" };
    format!(" (there is {}{more})", told.collect::<Vec<_>>().join(", "))
}

/// Refuses a camera that another program holds.
///
/// # Errors
/// [`LiveError::Held`], or no answer.
pub fn check_free(options: &LiveOptions, address: Ipv4Addr) -> Result<(), LiveError> {
    let camera = options.camera.clone();
    match Place::Gige(address).is_held() {
        Some(false) => Ok(()),
        Some(true) => Err(LiveError::Held {
            camera,
            address,
            by: probe::holder(address, PING),
        }),
        None => Err(LiveError::Absent {
            camera,
            sought: address.to_string(),
            others: String::new(),
        }),
    }
}
