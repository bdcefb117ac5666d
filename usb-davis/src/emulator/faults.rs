//! Faults of an emulated camera.

/// Faults of the camera. Byte positions count from the start of the stream.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// The camera is unplugged once this many bytes were sent; once only.
    pub unplug_at: Option<u64>,
    /// The data endpoint halts once this many bytes were sent; once only.
    pub stall_at: Option<u64>,
    /// Lengths of the transfers, used repeatedly, odd lengths included; if empty, transfers have the requested length.
    pub cuts: Vec<usize>,
    /// Replaces every n-th word of the stream by a word that no camera sends; `None` or 0 disables it.
    pub bad_word_every: Option<u64>,
    /// The bus fails; once only.
    pub failures: Option<Failures>,
    /// Bytes of an earlier run that are still in the camera. They are sent before everything else, at first and again
    /// after each run once no transfer is queued any more.
    pub stale: Vec<u8>,
}

/// Consecutive transfers that fail. Their data are lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Failures {
    /// Bytes sent before the first failure.
    pub at: u64,
    /// Number of transfers.
    pub transfers: u64,
}

/// Words that no camera sends, used in turn: an unknown special, a row and a column outside the sensor, unknown
/// sub-codes of the two miscellaneous words.
const BAD_WORDS: [u16; 5] = [0x0FFF, 0x1FFF, 0x2FFF, 0x5F00, 0x6C00];

impl Faults {
    /// Returns the length of a transfer of at most `room` bytes after `sent` bytes, limited to the next fault. `cut`
    /// counts the transfers.
    pub(super) fn limit(&self, room: usize, sent: u64, cut: usize) -> usize {
        let cut = self.cuts.get(cut % self.cuts.len().max(1)).copied().unwrap_or(room).max(1);
        let failures = self.failures.map(|failures| failures.at).filter(|&at| at > sent);
        let next = [self.stall_at, self.unplug_at, failures].into_iter().flatten().min();
        let left = next.map_or(u64::MAX, |at| at.saturating_sub(sent));
        room.min(cut).min(usize::try_from(left).unwrap_or(usize::MAX))
    }

    /// Returns `true` if a transfer after `sent` bytes fails, and counts the failure.
    pub(super) fn take_failure(&mut self, sent: u64) -> bool {
        let Some(failures) = self.failures.as_mut().filter(|failures| failures.at <= sent) else { return false };
        let fails = failures.transfers > 0;
        failures.transfers = failures.transfers.saturating_sub(1);
        fails
    }

    /// Inserts bad words into `bytes`, which come after `sent` bytes of the stream.
    pub(super) fn spoil(&self, bytes: &mut [u8], sent: u64) {
        let Some(every) = self.bad_word_every.filter(|&every| every > 0) else { return };
        for (byte, position) in bytes.iter_mut().zip(sent..) {
            let word = position / 2 + 1;
            if word.is_multiple_of(every) {
                let turn = (word / every - 1) % BAD_WORDS.len() as u64;
                let bad = BAD_WORDS.get(turn as usize).copied().unwrap_or_default();
                let [low, high] = bad.to_le_bytes();
                *byte = if position % 2 == 0 { low } else { high };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::{Decoder, Layout};

    #[test]
    fn bad_words_do_not_depend_on_the_splitting_of_the_stream() {
        let faults = Faults { bad_word_every: Some(7), ..Faults::default() };
        let mut whole = [0x01, 0x80].repeat(70);
        let mut parts = whole.clone();
        faults.spoil(&mut whole, 0);
        let mut sent = 0;
        for part in parts.chunks_mut(3) {
            faults.spoil(part, sent);
            sent += part.len() as u64;
        }
        assert_eq!(whole, parts);
        let mut decoder = Decoder::new(Layout::DAVIS346);
        let mut offsets = Vec::new();
        decoder.decode(&whole, |message| {
            if let crate::protocol::Message::Anomaly(anomaly) = message {
                offsets.push(anomaly.offset);
            }
        });
        assert_eq!(offsets, (1..=10).map(|fault| fault * 14 - 2).collect::<Vec<u64>>());
    }
}
