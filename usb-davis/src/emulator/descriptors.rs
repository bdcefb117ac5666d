//! The camera's USB descriptors.

use crate::dump::Identity;

const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
const STRING: u8 = 3;
const DEVICE_CAPABILITIES: u8 = 15;

/// One interface, bulk endpoint 0x82, interrupt endpoint 0x81, each with its companion (USB 3).
const CONFIGURATION_DESCRIPTOR: &[u8] = &[
    9, 2, 44, 0, 1, 1, 0, 0x80, 100, //
    9, 4, 0, 0, 2, 0xFF, 0, 0, 0, //
    7, 5, 0x82, 2, 0x00, 0x04, 0, 6, 0x30, 15, 0, 0, 0, //
    7, 5, 0x81, 3, 0x40, 0x00, 1, 6, 0x30, 0, 0, 0x40, 0,
];

/// USB 2 extension (link power management), SuperSpeed (full, high and super; no exit latency given).
const CAPABILITIES_DESCRIPTOR: &[u8] = &[
    5, 15, 22, 0, 2, //
    7, 16, 2, 0x02, 0, 0, 0, //
    10, 16, 3, 0, 0x0E, 0, 1, 0, 0, 0,
];

pub(super) fn device_descriptor(identity: &Identity) -> [u8; 18] {
    let [v0, v1] = identity.vendor_id.to_le_bytes();
    let [p0, p1] = identity.product_id.to_le_bytes();
    let [d0, d1] = identity.device_version.to_le_bytes();
    [18, DEVICE, 0x00, 0x03, 0, 0, 0, 9, v0, v1, p0, p1, d0, d1, 1, 2, 3, 1]
}

/// Returns device and configuration descriptor, as in sysfs.
pub(super) fn descriptors(identity: &Identity) -> Vec<u8> {
    [&device_descriptor(identity)[..], CONFIGURATION_DESCRIPTOR].concat()
}

/// Returns a descriptor; `None` if it does not exist.
pub(super) fn descriptor(identity: &Identity, kind: u8, index: u8) -> Option<Vec<u8>> {
    match (kind, index) {
        (DEVICE, 0) => Some(device_descriptor(identity).to_vec()),
        (CONFIGURATION, 0) => Some(CONFIGURATION_DESCRIPTOR.to_vec()),
        (DEVICE_CAPABILITIES, 0) => Some(CAPABILITIES_DESCRIPTOR.to_vec()),
        // American English.
        (STRING, 0) => Some(vec![4, STRING, 0x09, 0x04]),
        (STRING, 1) => Some(string_descriptor("INI")),
        (STRING, 2) => Some(string_descriptor("DAViS FX3")),
        (STRING, 3) => Some(string_descriptor(&identity.serial)),
        _ => None,
    }
}

fn string_descriptor(text: &str) -> Vec<u8> {
    let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).take(252).collect();
    let mut descriptor = vec![(units.len() + 2) as u8, STRING];
    descriptor.extend(units);
    descriptor
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the sum of the lengths of the descriptors in `bytes`.
    fn chain(bytes: &[u8]) -> usize {
        let mut at = 0;
        while let Some(&length) = bytes.get(at) {
            assert!(length > 0);
            at += usize::from(length);
        }
        at
    }

    #[test]
    fn lengths_match_the_contents() {
        for (bytes, total) in [(CONFIGURATION_DESCRIPTOR, 44), (CAPABILITIES_DESCRIPTOR, 22)] {
            assert_eq!((bytes.len(), usize::from(bytes[2]), chain(bytes)), (total, total, total));
        }
    }
}
