//! Standard requests of USB devices (USB 3.2, table 9-4).

use super::descriptors::descriptor;
use super::stall::Stall;
use crate::capture::DATA_ENDPOINT;
use crate::dump::Identity;

/// Bit of the request type for requests that the device answers with data; the other bits name the recipient.
const IN: u8 = 0x80;
const DEVICE: u8 = 0x00;
const INTERFACE: u8 = 0x01;
const ENDPOINT: u8 = 0x02;

const GET_STATUS: u8 = 0;
const CLEAR_FEATURE: u8 = 1;
const SET_FEATURE: u8 = 3;
const GET_DESCRIPTOR: u8 = 6;
const GET_CONFIGURATION: u8 = 8;
const SET_CONFIGURATION: u8 = 9;
const GET_INTERFACE: u8 = 10;
const SET_INTERFACE: u8 = 11;
const SET_EXIT_LATENCY: u8 = 48;
const SET_ISOCHRONOUS_DELAY: u8 = 49;

const ENDPOINT_HALT: u16 = 0;

/// Answers a request. `halted` is `true` while the data endpoint is halted.
pub(super) fn standard_request(identity: &Identity, halted: &mut bool, setup: [u8; 8]) -> Result<Vec<u8>, Stall> {
    let [kind, request, v0, v1, i0, i1, ..] = setup;
    let data_endpoint = [i0, i1] == [DATA_ENDPOINT, 0];
    match (kind & !IN, kind & IN, request) {
        (DEVICE | INTERFACE, IN, GET_STATUS) => Ok(vec![0, 0]),
        (ENDPOINT, IN, GET_STATUS) => Ok(vec![u8::from(data_endpoint && *halted), 0]),
        (ENDPOINT, 0, CLEAR_FEATURE | SET_FEATURE) if u16::from_le_bytes([v0, v1]) == ENDPOINT_HALT => {
            if data_endpoint {
                *halted = request == SET_FEATURE;
            }
            Ok(Vec::new())
        }
        // Power saving is accepted without effect.
        (DEVICE | INTERFACE, 0, CLEAR_FEATURE | SET_FEATURE) => Ok(Vec::new()),
        (DEVICE, IN, GET_DESCRIPTOR) => descriptor(identity, v1, v0).ok_or(Stall),
        // There is one configuration, and one setting of its interface.
        (DEVICE, IN, GET_CONFIGURATION) => Ok(vec![1]),
        (INTERFACE, IN, GET_INTERFACE) => Ok(vec![0]),
        (DEVICE, 0, SET_CONFIGURATION) | (INTERFACE, 0, SET_INTERFACE) => Ok(Vec::new()),
        (DEVICE, 0, SET_EXIT_LATENCY | SET_ISOCHRONOUS_DELAY) => Ok(Vec::new()),
        _ => Err(Stall),
    }
}
