//! `pitchd cameras`: what cameras there are.

use std::net::Ipv4Addr;
use std::time::Duration;

use crate::capture::aravis::{self, Found, ListedDevice};

/// List GigE Vision and USB3 Vision cameras.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  pitchd cameras
  pitchd cameras --json | jq -r '.[].serial'
  pitchd cameras --address 127.0.0.5        # asks this address alone")]
pub struct CamerasArgs {
    /// Ask these addresses instead of all interfaces.
    #[arg(long, value_name = "IP")]
    pub address: Vec<Ipv4Addr>,
    /// JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(serde::Serialize)]
struct Row {
    id: String,
    vendor: String,
    model: String,
    serial: String,
    address: String,
    user_name: String,
    protocol: String,
    /// Held by a program; unknown for USB.
    in_use: Option<bool>,
    /// Host of that program, where the camera tells it.
    in_use_by: Option<Ipv4Addr>,
}

impl From<Found> for Row {
    fn from(found: Found) -> Self {
        let patience = Duration::from_millis(200);
        let in_use = aravis::is_held(found.address, patience);
        Self {
            id: format!("{}-{}-{}", found.vendor, found.model, found.serial),
            in_use,
            in_use_by: aravis::holder(found.address, patience).filter(|_| in_use == Some(true)),
            vendor: found.vendor,
            model: found.model,
            serial: found.serial,
            address: found.address.to_string(),
            user_name: found.user_name,
            protocol: "GigEVision".to_owned(),
        }
    }
}

impl From<ListedDevice> for Row {
    fn from(device: ListedDevice) -> Self {
        Self {
            id: device.id,
            vendor: device.vendor,
            model: device.model,
            serial: device.serial,
            address: device.address,
            user_name: String::new(),
            protocol: device.protocol,
            in_use: None,
            in_use_by: None,
        }
    }
}

/// Prints the list.
///
/// # Errors
/// None of the addresses asked has a camera.
pub fn run(args: &CamerasArgs) -> anyhow::Result<()> {
    let mut rows: Vec<Row> = Vec::new();
    if args.address.is_empty() {
        rows.extend(
            aravis::discover(Duration::from_millis(500))
                .into_iter()
                .map(Row::from),
        );
        rows.extend(aravis::list_near_devices().into_iter().map(Row::from));
    } else {
        let patience = Duration::from_millis(300);
        rows.extend(
            args.address
                .iter()
                .filter_map(|a| aravis::ping(*a, patience))
                .map(Row::from),
        );
    }
    if args.json {
        say_line!("{}", serde_json::to_string_pretty(&rows)?);
    } else if rows.is_empty() {
        say_line!("no camera found (pitchd check looks at the host)");
    } else {
        say_line!(
            "{:<16} {:<16} {:<20} {:<16} {:<12} {:<20} id",
            "address",
            "serial",
            "model",
            "name",
            "protocol",
            "in use"
        );
        for row in &rows {
            let in_use = match (row.in_use, row.in_use_by) {
                (Some(true), Some(host)) => format!("by {host}"),
                (Some(true), None) => "yes".to_owned(),
                (Some(false), _) => "no".to_owned(),
                (None, _) => "?".to_owned(),
            };
            say_line!(
                "{:<16} {:<16} {:<20} {:<16} {:<12} {:<20} {}",
                row.address,
                row.serial,
                row.model,
                row.user_name,
                row.protocol,
                in_use,
                row.id
            );
        }
    }
    if rows.is_empty() && !args.address.is_empty() {
        anyhow::bail!("no camera at {:?}", args.address);
    }
    Ok(())
}
