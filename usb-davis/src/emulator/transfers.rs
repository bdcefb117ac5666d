//! Transfers that clients have queued: what every transport needs.

use std::collections::VecDeque;

use super::model::{Model, Stall};
use crate::capture::DATA_ENDPOINT;

struct Queued<T> {
    tag: T,
    endpoint: u8,
    length: usize,
}

/// Queued transfers of any endpoint in their order. The tag says to the transport which is which.
pub(super) struct QueuedTransfers<T>(VecDeque<Queued<T>>);

impl<T> Default for QueuedTransfers<T> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<T> QueuedTransfers<T> {
    /// Queues a transfer of at most `length` bytes.
    pub(super) fn push(&mut self, tag: T, endpoint: u8, length: usize) {
        self.0.push_back(Queued { tag, endpoint, length });
    }

    /// Finishes what the camera has data for, in order. Only the data endpoint ever has.
    pub(super) fn pump(&mut self, model: &mut Model, mut finish: impl FnMut(T, Result<Vec<u8>, Stall>)) {
        model.turn();
        let mut waiting = VecDeque::new();
        while let Some(transfer) = self.0.pop_front() {
            let data = if transfer.endpoint == DATA_ENDPOINT { model.bulk(transfer.length) } else { None };
            match data {
                Some(data) => finish(transfer.tag, data),
                None => {
                    let ends = transfer.endpoint == DATA_ENDPOINT;
                    waiting.push_back(transfer);
                    if ends {
                        break;
                    }
                }
            }
        }
        waiting.append(&mut self.0);
        self.0 = waiting;
        if !self.0.iter().any(|transfer| transfer.endpoint == DATA_ENDPOINT) {
            model.idle();
        }
    }

    /// Takes one back.
    pub(super) fn remove(&mut self, matches: impl Fn(&T) -> bool) -> Option<T> {
        let index = self.0.iter().position(|transfer| matches(&transfer.tag))?;
        self.0.remove(index).map(|transfer| transfer.tag)
    }

    /// Takes all back.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = T> + '_ {
        self.0.drain(..).map(|transfer| transfer.tag)
    }
}
