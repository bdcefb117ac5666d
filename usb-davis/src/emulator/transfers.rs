//! Queued transfers of clients, used by every transport.

use std::collections::VecDeque;

use super::model::Model;
use super::stall::TransferFault;
use crate::capture::DATA_ENDPOINT;

struct Queued<T> {
    tag: T,
    endpoint: u8,
    length: usize,
}

/// Queued transfers of any endpoint in their order. The transport identifies a transfer by its tag.
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

    /// Returns the first transfer for which the camera has data, and the data. Only the data endpoint has any.
    pub(super) fn next(&mut self, model: &mut Model) -> Option<(T, Result<Vec<u8>, TransferFault>)> {
        let Some(index) = self.0.iter().position(|transfer| transfer.endpoint == DATA_ENDPOINT) else {
            model.idle();
            return None;
        };
        let data = model.bulk(self.0.get(index)?.length)?;
        self.0.remove(index).map(|transfer| (transfer.tag, data))
    }

    /// Removes a transfer.
    pub(super) fn remove(&mut self, matches: impl Fn(&T) -> bool) -> Option<T> {
        let index = self.0.iter().position(|transfer| matches(&transfer.tag))?;
        self.0.remove(index).map(|transfer| transfer.tag)
    }

    /// Removes all transfers.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = T> + '_ {
        self.0.drain(..).map(|transfer| transfer.tag)
    }
}
