//! `pitchd cameras`: what cameras there are.

use std::net::Ipv4Addr;
use std::time::Duration;

use super::seen::{self, Seen};
use crate::capture::aravis;

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
    #[serde(flatten)]
    seen: Seen,
    /// Held by a program; unknown for USB.
    in_use: Option<bool>,
    /// Host of that program, where the camera tells it.
    in_use_by: Option<Ipv4Addr>,
}

impl From<Seen> for Row {
    fn from(seen: Seen) -> Self {
        let patience = Duration::from_millis(200);
        let in_use = seen.gige.and_then(|address| aravis::is_held(address, patience));
        let held = seen.gige.filter(|_| in_use == Some(true));
        Self {
            in_use,
            in_use_by: held.and_then(|address| aravis::holder(address, patience)),
            seen,
        }
    }
}

/// Prints the list.
///
/// # Errors
/// None of the addresses asked has a camera.
pub fn run(args: &CamerasArgs) -> anyhow::Result<()> {
    let seen = seen::cameras(&args.address, Duration::from_millis(500));
    let rows: Vec<Row> = seen.into_iter().map(Row::from).collect();
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
                row.seen.address,
                row.seen.serial,
                row.seen.model,
                row.seen.user_name,
                row.seen.protocol,
                in_use,
                row.seen.id
            );
        }
    }
    if rows.is_empty() && !args.address.is_empty() {
        anyhow::bail!("no camera at {:?}", args.address);
    }
    Ok(())
}
