//! Lists the DAVIS346 cameras on the bus, and the reason for each camera that cannot be used.
//!
//! ```text
//! cargo run -p usb-davis --example list
//! ```

use usb_davis::device::{Availability, DeviceError, list};

fn main() -> Result<(), DeviceError> {
    for camera in list()? {
        let state = match camera.availability {
            Availability::Ready { logic, patch } => format!("ready, logic {logic}.{patch}"),
            Availability::Unavailable(error) => error.to_string(),
        };
        println!("bus {}, address {}, serial number {}: {state}", camera.bus, camera.address, camera.identity.serial);
    }
    Ok(())
}
