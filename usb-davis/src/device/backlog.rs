//! Received transfers that have not been read yet, within a memory limit.
//!
//! Memory is counted in bytes: a transfer that fills less than half of its buffer is copied into memory of its own
//! length, and the buffer is reused at once. A camera sends its data every millisecond, so most transfers are short.

use std::collections::VecDeque;

use super::error::StreamError;
use crate::dump::TransferStatus;

/// Transfers and memory of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Queue {
    /// Number of transfers queued at the same time, clamped to 8 to 32.
    pub transfers: usize,
    /// Bytes per transfer, rounded up to packets of 1024, at least one.
    pub transfer_bytes: usize,
    /// Memory limit in bytes for transfers that wait for the reader, in addition to the queued transfers. Memory is
    /// allocated only when needed.
    pub waiting_bytes: usize,
}

impl Default for Queue {
    /// 32 transfers of 128 KiB use 4 MiB of the 16 MiB that Linux grants by default: at 50 MB/s the process may sleep
    /// for 80 ms before the camera must drop data. With up to 128 MiB waiting, a disk may pause for 5 s at 24 MB/s.
    fn default() -> Self {
        Self { transfers: 32, transfer_bytes: 128 * 1024, waiting_bytes: 128 << 20 }
    }
}

/// Statistics of a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamStatistics {
    /// Transfers with data.
    pub transfers: u64,
    /// Bytes received.
    pub bytes: u64,
    /// Transfers that failed. Their data are lost; the next good transfer reports it
    /// ([`crate::dump::Transfer::gap_before`]).
    pub failed: u64,
    /// Transfers that could not be queued again at once because the memory for waiting transfers was used up, that is,
    /// the reader is too slow. The camera may have dropped events in the meantime; its own counters report this
    /// ([`super::Stream::read_dropped`]).
    pub starved: u64,
    /// Largest memory in bytes of transfers that waited for the reader.
    pub waiting_most: usize,
}

/// Memory that a waiting transfer takes in addition to its bytes.
const OVERHEAD: usize = 64;

/// A transfer with data.
pub(super) struct Received {
    /// At least as long as the data.
    pub(super) buffer: Vec<u8>,
    pub(super) length: usize,
    pub(super) status: TransferStatus,
    pub(super) host_ns: u64,
    pub(super) gap_before: bool,
}

/// Transfers that wait for the reader, in order, and free buffers.
pub(super) struct Backlog {
    waiting: VecDeque<Received>,
    empty: Vec<Vec<u8>>,
    /// Memory of the waiting transfers and of the transfer that the reader uses.
    buffered: usize,
    queue: Queue,
    /// `true` if a transfer failed since the last good one.
    gap: bool,
    /// Number of consecutive failures.
    failures: usize,
    pub(super) statistics: StreamStatistics,
}

impl Backlog {
    /// Creates an empty backlog. The limits of `queue` are applied.
    pub(super) fn new(queue: Queue) -> Self {
        let queue = Queue {
            transfers: queue.transfers.clamp(8, 32),
            transfer_bytes: queue.transfer_bytes.clamp(1024, 1 << 24).next_multiple_of(1024),
            waiting_bytes: queue.waiting_bytes,
        };
        let statistics = StreamStatistics::default();
        let (waiting, empty) = (VecDeque::new(), Vec::new());
        Self { waiting, empty, buffered: 0, queue, gap: false, failures: 0, statistics }
    }

    /// Returns the number of transfers to keep queued.
    pub(super) fn transfers(&self) -> usize {
        self.queue.transfers
    }

    /// Returns a buffer for a transfer.
    pub(super) fn buffer(&mut self) -> Vec<u8> {
        self.empty.pop().unwrap_or_else(|| vec![0; self.queue.transfer_bytes])
    }

    /// Returns `true` if a transfer may be queued again.
    pub(super) fn has_room(&self) -> bool {
        // One transfer may wait even if the limit is zero.
        self.buffered < self.queue.waiting_bytes.max(1)
    }

    /// Accepts the `length` bytes that a transfer received into `buffer`. After a failure the bytes are undefined and
    /// are dropped. Returns an error after too many consecutive failures.
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
            // A disturbance on the bus fails all queued transfers at once.
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
        self.buffered += buffer.capacity() + OVERHEAD;
        let gap_before = std::mem::take(&mut self.gap);
        self.waiting.push_back(Received { buffer, length, status, host_ns, gap_before });
        self.statistics.transfers += 1;
        self.statistics.bytes += length as u64;
        self.statistics.waiting_most = self.statistics.waiting_most.max(self.buffered);
        Ok(())
    }

    /// Returns the oldest transfer. Return its buffer by [`Backlog::give_back`].
    pub(super) fn pop(&mut self) -> Option<Received> {
        self.waiting.pop_front()
    }

    /// Takes back a buffer that the reader no longer needs.
    pub(super) fn give_back(&mut self, buffer: Vec<u8>) {
        self.buffered = self.buffered.saturating_sub(buffer.capacity() + OVERHEAD);
        self.reuse(buffer);
    }

    /// Keeps a buffer for later transfers, if they can use it.
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

    /// Adds transfers of `length` bytes until there is no room; returns their number.
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
    fn memory_is_counted_in_bytes_and_released() {
        let mut backlog = Backlog::new(QUEUE);
        for (length, count) in [(100, 100_000usize.div_ceil(164)), (4096, 100_000usize.div_ceil(4160)), (1, 1539)] {
            assert_eq!(fill(&mut backlog, length), count, "{length}");
            while let Some(received) = backlog.pop() {
                assert!(received.length == length && received.buffer.len() >= length);
                backlog.give_back(received.buffer);
            }
            assert_eq!(backlog.buffered, 0);
            assert!(backlog.empty.len() <= QUEUE.transfers);
        }
        assert!(backlog.statistics.waiting_most < 100_000 + 4160);
    }

    #[test]
    fn a_failure_is_a_gap_and_many_in_a_row_end_the_stream() {
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
