//! Unfinished control requests of a capture, of the kinds that describe a camera.
//!
//! A capture may contain any number of requests that never end, so only the latest are kept.

use std::collections::{BTreeMap, HashMap};

use super::usb::DeviceAddress;
use crate::registers::{REQUEST_REGISTER, REQUEST_REGISTERS};

pub(super) const GET_DESCRIPTOR: u8 = 6;

/// Largest number of requests kept, far more than are under way at the same time.
const MOST: usize = 4096;
/// Largest number of bytes kept per request; neither Linux nor Windows lets a program send more in one.
const BYTES_MOST: usize = 4096;

/// Device and number of a request.
type Key = (DeviceAddress, u64);

/// The beginning of a request.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Request {
    pub(super) setup: [u8; 8],
    pub(super) sent: Vec<u8>,
}

/// Requests under way.
#[derive(Debug, Default)]
pub(super) struct Requests {
    /// Each request with its position in `order`.
    requests: HashMap<Key, (u64, Request)>,
    order: BTreeMap<u64, Key>,
    begun: u64,
}

impl Requests {
    /// Records the beginning of a request; an earlier request with the same key never ended.
    pub(super) fn begin(&mut self, key: Key, setup: [u8; 8], data: &[u8]) {
        self.end(key);
        if !matters(setup) {
            return;
        }
        if self.requests.len() >= MOST
            && let Some((_, oldest)) = self.order.pop_first()
        {
            self.requests.remove(&oldest);
        }
        let sent = data.iter().take(BYTES_MOST).copied().collect();
        self.requests.insert(key, (self.begun, Request { setup, sent }));
        self.order.insert(self.begun, key);
        self.begun += 1;
    }

    /// Returns the request that ends; `None` if it is irrelevant or its beginning is unknown.
    pub(super) fn end(&mut self, key: Key) -> Option<Request> {
        let (place, request) = self.requests.remove(&key)?;
        self.order.remove(&place);
        Some(request)
    }
}

/// Returns `true` if the request or its answer may describe a camera.
fn matters([request_type, request, ..]: [u8; 8]) -> bool {
    matches!(
        (request_type, request),
        (0x40 | 0xC0, REQUEST_REGISTER) | (0x40, REQUEST_REGISTERS) | (0x80, GET_DESCRIPTOR)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const WRITE: [u8; 8] = [0x40, REQUEST_REGISTER, 0, 0, 0, 0, 4, 0];

    fn key(id: u64) -> Key {
        (DeviceAddress { bus: 1, device: 2 }, id)
    }

    #[test]
    fn only_the_latest_requests_are_kept_and_their_data_are_limited() {
        let mut requests = Requests::default();
        for id in 0..3 * MOST as u64 {
            requests.begin(key(id), WRITE, &[7; 100_000]);
        }
        assert_eq!((requests.requests.len(), requests.order.len()), (MOST, MOST));
        assert_eq!(requests.end(key(2 * MOST as u64 - 1)), None);
        for id in 2 * MOST as u64..3 * MOST as u64 {
            assert_eq!(requests.end(key(id)), Some(Request { setup: WRITE, sent: vec![7; BYTES_MOST] }));
        }
        assert!(requests.requests.is_empty() && requests.order.is_empty());
    }

    #[test]
    fn a_reused_number_means_the_latest_request() {
        let mut requests = Requests::default();
        requests.begin(key(1), WRITE, &[1]);
        requests.begin(key(1), WRITE, &[2]);
        assert_eq!(requests.end(key(1)), Some(Request { setup: WRITE, sent: vec![2] }));
        // Setting an address does not describe a camera, but ends the earlier request with the same number.
        requests.begin(key(1), WRITE, &[1]);
        requests.begin(key(1), [0, 5, 3, 0, 0, 0, 0, 0], &[]);
        assert_eq!(requests.end(key(1)), None);
    }
}
