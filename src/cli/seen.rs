//! Cameras that are there, of whichever kind, for the commands that list them.

use std::net::Ipv4Addr;
use std::time::Duration;

use crate::capture::aravis::{self, Found, ListedDevice};

/// How long an address that is asked alone may take.
const PING: Duration = Duration::from_millis(300);

/// A camera that is there.
#[derive(Debug, serde::Serialize)]
pub struct Seen {
    /// Its address where it is on the network.
    #[serde(skip)]
    pub gige: Option<Ipv4Addr>,
    /// The library's name for it.
    pub id: String,
    /// Maker.
    pub vendor: String,
    /// Model.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// IP address or USB bus path.
    pub address: String,
    /// Empty where it has none.
    pub user_name: String,
    /// `GigEVision` or `USB3Vision`.
    pub protocol: String,
}

impl From<Found> for Seen {
    fn from(found: Found) -> Self {
        Self {
            gige: Some(found.address),
            id: format!("{}-{}-{}", found.vendor, found.model, found.serial),
            vendor: found.vendor,
            model: found.model,
            serial: found.serial,
            address: found.address.to_string(),
            user_name: found.user_name,
            protocol: "GigEVision".to_owned(),
        }
    }
}

impl From<ListedDevice> for Seen {
    fn from(device: ListedDevice) -> Self {
        Self {
            gige: None,
            id: device.id,
            vendor: device.vendor,
            model: device.model,
            serial: device.serial,
            address: device.address,
            user_name: String::new(),
            protocol: device.protocol,
        }
    }
}

/// The cameras at these addresses; without any, all that answer on the network within `patience`, and those of the USB bus.
pub fn cameras(addresses: &[Ipv4Addr], patience: Duration) -> Vec<Seen> {
    if addresses.is_empty() {
        let network = aravis::discover(patience).into_iter().map(Seen::from);
        let near = aravis::list_near_devices().into_iter();
        return network.chain(near.map(Seen::from)).collect();
    }
    let found = addresses.iter().filter_map(|a| aravis::ping(*a, PING));
    found.map(Seen::from).collect()
}
