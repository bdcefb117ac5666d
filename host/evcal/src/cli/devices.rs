//! `evcal devices`.

use serde_json::json;
use usb_davis::device::{Availability, DeviceError, Listing, UDEV_RULE, UDEV_RULE_FILE, list};

use super::{Failure, print};

/// No camera was found; the message contains advice.
#[derive(Debug, thiserror::Error)]
#[error(
    "{}\n  evcal supports the DAVIS346; lsusb should list it as 152a:841a\n  \
     if it does, write this line to {UDEV_RULE_FILE}, then reconnect the camera:\n  {UDEV_RULE}\n  \
     for other cameras, calibrate from a recording: evcal calibrate --help",
    DeviceError::NotFound { wanted: String::new() }
)]
struct NoCamera;

/// Arguments of `evcal devices`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Print the cameras as a JSON array
    #[arg(long)]
    json: bool,
}

/// Runs `evcal devices`. It fails if no camera is available.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let cameras = list().map_err(Failure::plain)?;
    if arguments.json {
        print::json(&cameras.iter().map(as_json).collect::<Vec<_>>())?;
    } else {
        cameras.iter().try_for_each(|camera| print::line(as_text(camera)))?;
    }
    let is_ready = |camera: &&Listing| matches!(camera.availability, Availability::Ready { .. });
    if cameras.iter().any(|camera| is_ready(&camera)) {
        return Ok(());
    }
    let unavailable = cameras.into_iter().find_map(|camera| match camera.availability {
        Availability::Unavailable(error) => Some(error),
        Availability::Ready { .. } => None,
    });
    Err(unavailable.map_or_else(|| Failure::plain(NoCamera), Failure::plain))
}

fn as_text(camera: &Listing) -> String {
    let serial = if camera.identity.serial.is_empty() { "unknown" } else { &camera.identity.serial };
    let (bus, address, firmware) = (camera.bus, camera.address, camera.identity.firmware());
    let state = match &camera.availability {
        Availability::Ready { logic, patch } => format!("logic {logic}.{patch}, ready"),
        Availability::Unavailable(error) => first_line(error),
    };
    format!("DAVIS346, serial number {serial}, bus {bus}, address {address}, firmware {firmware}, {state}")
}

/// Returns the error without advice.
fn first_line(error: &DeviceError) -> String {
    match error {
        DeviceError::Forbidden { .. } => "forbidden".to_owned(),
        DeviceError::Busy { .. } => "busy: used by another program".to_owned(),
        error => error.to_string(),
    }
}

fn as_json(camera: &Listing) -> serde_json::Value {
    let (state, logic, reason) = match &camera.availability {
        Availability::Ready { logic, patch } => ("ready", Some(format!("{logic}.{patch}")), None),
        Availability::Unavailable(error) => {
            let state = match error {
                DeviceError::Forbidden { .. } => "forbidden",
                DeviceError::Busy { .. } => "busy",
                DeviceError::Unsupported(_) => "unsupported",
                _ => "failed",
            };
            (state, None, Some(error.to_string()))
        }
    };
    json!({
        "serial": camera.identity.serial, "bus": camera.bus, "address": camera.address,
        "firmware": camera.identity.firmware(), "logic": logic, "state": state, "reason": reason,
    })
}
