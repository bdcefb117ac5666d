//! What has come and not been read yet, and the memory that it may take.
//!
//! Memory is counted in bytes: a transfer that is not even half full is copied into memory of its own
//! length, and its buffer is used again at once. A camera hands over what it has every millisecond, so
//! most transfers are short.

use std::collections::VecDeque;

use super::error::StreamError;
use crate::dump::TransferStatus;

/// Transfers and memory of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Queue {
    /// Transfers queued at a time, 8 to 32 (cut to that).
    pub transfers: usize,
    /// Bytes of each, rounded up to packets of 1024, at least one.
    pub transfer_bytes: usize,
    /// Memory in bytes of what may wait for the reader, beside the transfers queued. It is taken only
    /// when it is needed.
    pub waiting_bytes: usize,
}

impl Default for Queue {
    /// 32 transfers of 128 KiB, 4 MiB of the 16 that Linux grants by default: at 50 MB/s the process
    /// may sleep for 80 ms before the camera must drop. Up to 128 MiB waiting: a disk may stand still
    /// for 5 s at 24 MB/s.
    fn default() -> Self {
        Self { transfers: 32, transfer_bytes: 128 * 1024, waiting_bytes: 128 << 20 }
    }
}

/// What a stream has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamStatistics {
    /// Transfers that brought something.
    pub transfers: u64,
    /// Bytes they brought.
    pub bytes: u64,
    /// Transfers that failed. What each would have brought is lost; the next good one says so
    /// ([`crate::dump::Transfer::gap_before`]).
    pub failed: u64,
    /// Transfers that could not be queued again at once, because the memory for waiting ones was used
    /// up: the reader is too slow. The camera may have dropped events then; its own counters know
    /// ([`super::Stream::read_dropped`]).
    pub starved: u64,
    /// Largest memory in bytes of what waited to be read.
    pub waiting_most: usize,
}

/// What a waiting transfer takes beside its bytes.
const OVERHEAD: usize = 64;

/// A transfer that brought something.
pub(super) struct Received {
    /// At least as long as what was brought.
    pub(super) buffer: Vec<u8>,
    pub(super) length: usize,
    pub(super) status: TransferStatus,
    pub(super) host_ns: u64,
    pub(super) gap_before: bool,
}

/// Transfers that wait to be read, in order, and the buffers.
pub(super) struct Backlog {
    waiting: VecDeque<Received>,
    empty: Vec<Vec<u8>>,
    /// Memory of what waits and of what the reader has.
    held: usize,
    queue: Queue,
    /// A transfer failed since the last good one, and how many did in a row.
    gap: bool,
    failures: usize,
    pub(super) statistics: StreamStatistics,
}

impl Backlog {
    /// An empty one. The limits of `queue` are applied.
    pub(super) fn new(queue: Queue) -> Self {
        let queue = Queue {
            transfers: queue.transfers.clamp(8, 32),
            transfer_bytes: queue.transfer_bytes.clamp(1024, 1 << 24).next_multiple_of(1024),
            waiting_bytes: queue.waiting_bytes,
        };
        let statistics = StreamStatistics::default();
        let (waiting, empty) = (VecDeque::new(), Vec::new());
        Self { waiting, empty, held: 0, queue, gap: false, failures: 0, statistics }
    }

    /// Transfers to be queued at a time.
    pub(super) fn transfers(&self) -> usize {
        self.queue.transfers
    }

    /// A buffer for a transfer.
    pub(super) fn buffer(&mut self) -> Vec<u8> {
        self.empty.pop().unwrap_or_else(|| vec![0; self.queue.transfer_bytes])
    }

    /// Whether a transfer may be queued again.
    pub(super) fn has_room(&self) -> bool {
        // Something may wait even if nothing is granted.
        self.held < self.queue.waiting_bytes.max(1)
    }

    /// Takes the `length` bytes that a transfer brought into `buffer`. After a failure they may be
    /// anything, and are not handed over. An error: there were so many failures in a row that no
    /// better is to be expected.
    pub(super) fn take_in(
        &mut self,
        buffer: Vec<u8>,
        length: usize,
        status: TransferStatus,
        host_ns: u64,
    ) -> Result<(), StreamError> {
        if !status.is_good() {
            self.reuse(buffer);
            self.gap = true;
            self.failures += 1;
            self.statistics.failed += 1;
            // Whatever disturbs the bus fails all queued transfers at a time.
            let give_up = self.failures > 2 * self.queue.transfers;
            return if give_up { Err(StreamError::Failed(status)) } else { Ok(()) };
        }
        self.failures = 0;
        let Some(payload) = buffer.get(..length).filter(|payload| !payload.is_empty()) else {
            self.reuse(buffer);
            return Ok(());
        };
        let buffer = if length <= buffer.len() / 2 {
            let payload = payload.to_vec();
            self.reuse(buffer);
            payload
        } else {
            buffer
        };
        self.held += buffer.capacity() + OVERHEAD;
        let gap_before = std::mem::take(&mut self.gap);
        self.waiting.push_back(Received { buffer, length, status, host_ns, gap_before });
        self.statistics.transfers += 1;
        self.statistics.bytes += length as u64;
        self.statistics.waiting_most = self.statistics.waiting_most.max(self.held);
        Ok(())
    }

    /// The oldest transfer. Its buffer comes back by [`Backlog::give_back`].
    pub(super) fn pop(&mut self) -> Option<Received> {
        self.waiting.pop_front()
    }

    /// The reader has no more use for this buffer.
    pub(super) fn give_back(&mut self, buffer: Vec<u8>) {
        self.held = self.held.saturating_sub(buffer.capacity() + OVERHEAD);
        self.reuse(buffer);
    }

    /// Keeps a buffer for the transfers to come, if they can use it.
    fn reuse(&mut self, buffer: Vec<u8>) {
        if buffer.len() == self.queue.transfer_bytes && self.empty.len() < self.queue.transfers {
            self.empty.push(buffer);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUEUE: Queue = Queue { transfers: 8, transfer_bytes: 4096, waiting_bytes: 100_000 };

    /// Takes in transfers of `length` bytes until there is no room: how many.
    fn fill(backlog: &mut Backlog, length: usize) -> usize {
        let mut count = 0;
        while backlog.has_room() {
            let buffer = backlog.buffer();
            assert_eq!(buffer.len(), QUEUE.transfer_bytes);
            backlog.take_in(buffer, length, TransferStatus::Completed, 0).expect("no failure");
            count += 1;
        }
        count
    }

    #[test]
    fn memory_is_counted_in_bytes_and_comes_back() {
        let mut backlog = Backlog::new(QUEUE);
        for (length, count) in [(100, 100_000usize.div_ceil(164)), (4096, 100_000usize.div_ceil(4160)), (1, 1539)] {
            assert_eq!(fill(&mut backlog, length), count, "{length}");
            while let Some(received) = backlog.pop() {
                assert!(received.length == length && received.buffer.len() >= length);
                backlog.give_back(received.buffer);
            }
            assert_eq!(backlog.held, 0);
            assert!(backlog.empty.len() <= QUEUE.transfers);
        }
        assert!(backlog.statistics.waiting_most < 100_000 + 4160);
    }

    #[test]
    fn a_failure_is_a_gap_and_a_run_of_them_the_end() {
        let mut backlog = Backlog::new(QUEUE);
        let mut take = |length, status| {
            let buffer = backlog.buffer();
            backlog.take_in(buffer, length, status, 0)
        };
        for _ in 0..3 {
            for _ in 0..16 {
                assert_eq!(take(4000, TransferStatus::Error), Ok(()));
            }
            assert_eq!(take(5, TransferStatus::Completed), Ok(()));
            assert_eq!(take(6, TransferStatus::Completed), Ok(()));
        }
        for _ in 0..16 {
            assert_eq!(take(0, TransferStatus::Overflow), Ok(()));
        }
        assert_eq!(take(0, TransferStatus::Error), Err(StreamError::Failed(TransferStatus::Error)));
        let received: Vec<_> = std::iter::from_fn(|| backlog.pop()).map(|one| (one.length, one.gap_before)).collect();
        assert_eq!(received, [(5, true), (6, false)].repeat(3));
        assert_eq!((backlog.statistics.failed, backlog.statistics.bytes), (3 * 16 + 17, 33));
    }
}
