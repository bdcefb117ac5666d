//! Corrects the time after bytes were lost.
//!
//! Times in the stream consist of 15 bits and of wrap words that count their overflows, every 32.8 ms. If wrap words
//! are lost, all later times are too small by a multiple of 2^15 µs. The host clock determines the multiple, because
//! the time from the last word of a transfer to its arrival is about the same before and after the gap.
//!
//! A delayed transfer looks like one more wrap. The following transfers then seem to arrive before they were sent,
//! which disproves the wrap. It is taken back at the next gap that is long enough for the time not to run back.

use crate::dump::{Transfer, TransferStatus};
use crate::protocol::word::{Special, Word};
use crate::protocol::{Decoder, Message};

/// Time between wraps, in µs.
const WRAP: i64 = 1 << 15;
/// Arrivals up to this much earlier than expected still count to the same wrap; arrivals may be late by up to the rest
/// of a wrap (µs).
const EARLY: i64 = 8192;
/// Period over which arrivals are compared, and within which arrivals after a gap may disprove its correction. A longer
/// period would include the drift of the clocks (µs).
const MEMORY: i64 = 1_000_000;

/// Number of gaps and amount of the corrections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RepairCounts {
    /// Number of gaps.
    pub gaps: u64,
    /// Number of gaps in which wrap words were lost.
    pub repaired: u64,
    /// Total time of the lost wrap words, in µs.
    pub restored_us: u64,
    /// Excess time that was taken back at a later gap, in µs.
    pub taken_back_us: u64,
}

/// A gap in which wrap words were lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repair {
    /// First time after the gap, corrected, in µs since the camera's latest timestamp reset.
    pub time: u64,
    /// Amount added to this and all later times, in µs.
    pub restored_us: u64,
    /// Part of the amount that later transfers proved excessive, in µs. Times are too large by it until the gap at
    /// which it is taken back.
    pub excess_us: u64,
}

/// The smallest recent difference between host clock and camera clock. Transfers that were delayed by the host have a
/// larger difference.
#[derive(Clone, Copy, Debug, Default)]
struct Offset {
    /// Start of the current period, in µs of the host clock.
    since: i64,
    /// Smallest difference in the current period.
    recent: Option<i64>,
    /// Smallest difference in the period before.
    before: Option<i64>,
}

impl Offset {
    fn add(&mut self, host: i64, camera: i64) {
        if host - self.since > MEMORY {
            (self.before, self.recent, self.since) = (self.recent, None, host);
        }
        let offset = host - camera;
        self.recent = Some(self.recent.map_or(offset, |recent| recent.min(offset)));
    }

    fn get(&self) -> Option<i64> {
        self.recent.into_iter().chain(self.before).min()
    }
}

/// Correction of the latest gap, while later transfers may disprove it.
#[derive(Clone, Copy, Debug)]
struct Doubt {
    /// Difference of the clocks before the gap.
    before: i64,
    /// Smallest difference of the clocks since the gap.
    since: i64,
    /// End of the period in which transfers count, in µs of the host clock.
    until: i64,
    /// Number of wraps that were restored.
    wraps: i64,
}

/// Decodes transfers, and corrects the time after each gap.
///
/// The number of lost wrap words follows from the host times of the transfers. A transfer that arrives more than 24 ms
/// late right after a gap counts as one more wrap. If transfers in the second after it disprove that, the wrap is taken
/// back at the next gap that is long enough. Without host times, or before the first good transfer, the time still
/// never runs back over a gap: it advances at least to the first time in the following stream.
#[derive(Clone, Debug, Default)]
pub struct GapRepair {
    /// Difference between the host clock and the camera clock without excess wraps.
    offset: Offset,
    /// Number of wraps by which the time is known to be ahead.
    ahead: i64,
    doubt: Option<Doubt>,
    /// `true` after a gap until a word carries time.
    open: bool,
    counts: RepairCounts,
    repairs: Vec<Repair>,
}

impl GapRepair {
    /// Returns the number of gaps and the amount of the corrections so far.
    pub fn counts(&self) -> RepairCounts {
        self.counts
    }

    /// Returns the gaps after which the time was corrected, in order.
    pub fn repairs(&self) -> &[Repair] {
        &self.repairs
    }

    /// Passes a transfer to a decoder: first a gap if bytes were lost, then the payload, or a gap instead of the
    /// payload if the transfer failed. The removal of the camera ends the stream but is not a gap.
    pub fn decode<S: AsRef<[u16]> + AsMut<[u16]>>(
        &mut self,
        transfer: &Transfer<'_>,
        decoder: &mut Decoder<S>,
        mut sink: impl FnMut(Message<'_>),
    ) {
        let lost = !transfer.status.is_good() && transfer.status != TransferStatus::NoDevice;
        if transfer.gap_before || lost {
            decoder.gap(&mut sink);
            self.counts.gaps += 1;
            self.open = true;
        }
        if !transfer.status.is_good() {
            return;
        }
        let host = transfer.host_ns.and_then(|host| i64::try_from(host / 1000).ok());
        if self.open
            && let Some(times) = StreamTimes::new(transfer.payload)
        {
            self.open = false;
            self.restore(&times, host, decoder);
        }
        let resets = decoder.counts().timestamp_resets;
        decoder.decode(transfer.payload, sink);
        if decoder.counts().timestamp_resets != resets {
            (self.offset, self.ahead, self.doubt) = (Offset::default(), 0, None);
        }
        if let (false, Some(host), Ok(camera)) = (self.open, host, i64::try_from(decoder.time())) {
            self.compare(host, camera);
        }
    }

    /// Records the arrival of a transfer whose last time is `camera`.
    fn compare(&mut self, host: i64, camera: i64) {
        let Some(doubt) = self.doubt.as_mut() else { return self.offset.add(host, camera - self.ahead * WRAP) };
        doubt.since = doubt.since.min(host - (camera - self.ahead * WRAP));
        let early = doubt.before - doubt.since;
        let excess = (early + EARLY).div_euclid(WRAP).min(doubt.wraps);
        if excess > 0 {
            self.ahead += excess;
            if let Some(repair) = self.repairs.last_mut() {
                repair.excess_us = repair.excess_us.saturating_add(excess.unsigned_abs() << 15);
            }
            self.doubt = None;
        } else if host > doubt.until {
            self.offset.add(host, host - doubt.since);
            self.doubt = None;
        }
    }

    fn restore<S: AsRef<[u16]> + AsMut<[u16]>>(
        &mut self,
        times: &StreamTimes,
        host: Option<i64>,
        decoder: &mut Decoder<S>,
    ) {
        let signed = |time: u64| i64::try_from(time).unwrap_or(i64::MAX);
        let (wrap, time) = (signed(decoder.wrap_time()), signed(decoder.time()));
        // The time must not run back.
        let fewest = (time.saturating_sub(wrap).saturating_sub(times.first) + WRAP - 1).div_euclid(WRAP);
        let known = self.offset.get().zip(host);
        let expected = known.map(|(offset, host)| {
            let end = host.saturating_sub(offset);
            end.saturating_sub(wrap).saturating_sub(times.last).saturating_add(EARLY).div_euclid(WRAP)
        });
        let wraps = fewest.max(expected.unwrap_or(0)).max(0);
        self.doubt = None;
        if let Some(expected) = expected {
            // The excess cannot be larger than the amount restored.
            let restored = i64::try_from(self.counts.restored_us >> 15).unwrap_or(i64::MAX);
            let ahead = (wraps - expected).clamp(0, restored);
            self.counts.taken_back_us += u64::try_from(self.ahead - ahead).unwrap_or(0) << 15;
            self.ahead = ahead;
        }
        let Ok(count @ 1..) = u64::try_from(wraps) else { return };
        decoder.restore_wraps(count);
        let restored_us = count.saturating_mul(1 << 15);
        self.counts.repaired += 1;
        self.counts.restored_us = self.counts.restored_us.saturating_add(restored_us);
        let first = u64::try_from(times.first).unwrap_or(0);
        self.repairs.push(Repair { time: decoder.wrap_time().saturating_add(first), restored_us, excess_us: 0 });
        self.doubt = known.map(|(before, host)| {
            let until = host.saturating_add(MEMORY);
            Doubt { before, since: i64::MAX, until, wraps }
        });
    }
}

/// First and last time in a piece of stream, in µs since a wrap before it, up to a timestamp reset.
struct StreamTimes {
    first: i64,
    last: i64,
}

impl StreamTimes {
    /// Returns `None` if no word carries time.
    fn new(payload: &[u8]) -> Option<Self> {
        let (mut first, mut last, mut wrap) = (None, 0, 0);
        let (words, _) = payload.as_chunks::<2>();
        for word in words {
            last = match Word::parse(u16::from_le_bytes(*word)) {
                Word::Timestamp(low) => wrap + i64::from(low),
                Word::Wrap(times) => {
                    wrap += i64::from(times) * WRAP;
                    wrap
                }
                // A lost wrap word before a reset does not affect the times after it.
                Word::Special(Special::TimestampReset) => break,
                _ => continue,
            };
            first = first.or(Some(last));
        }
        first.map(|first| Self { first, last })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::{Encoder, Layout, Polarity, PolarityEvent};

    /// A transfer: time in µs, and bytes.
    type Timed = (u64, Vec<u8>);

    /// Returns transfers of one event per ms, or at `times`.
    fn transfers(times: impl IntoIterator<Item = u64>) -> Vec<Timed> {
        let mut encoder = Encoder::new(Layout::DAVIS346);
        let transfer = |time| {
            let mut bytes = Vec::new();
            let event = PolarityEvent { time, x: 3, y: 4, polarity: Polarity::On };
            encoder.event(&event, &mut bytes).expect("in order");
            (time, bytes)
        };
        times.into_iter().map(transfer).collect()
    }

    /// Plays transfers without the numbers in `lost`; `delay` returns the delay of the host. Returns the decoded times
    /// and the repairs.
    fn play(
        all: &[Timed],
        lost: impl Fn(usize) -> bool,
        delay: impl Fn(usize) -> u64,
        clock: bool,
    ) -> (Vec<u64>, RepairCounts) {
        let mut decoder = Decoder::new(Layout::DAVIS346);
        let mut repair = GapRepair::default();
        let mut times = Vec::new();
        let mut gap_before = false;
        for (index, (time, payload)) in all.iter().enumerate() {
            if lost(index) {
                gap_before = true;
                continue;
            }
            let host_ns = clock.then_some((time + 500_000 + delay(index)) * 1000);
            let status = TransferStatus::Completed;
            let transfer = Transfer { host_ns, gap_before, status, payload };
            gap_before = false;
            repair.decode(&transfer, &mut decoder, |message| {
                if let Message::Events(events) = message {
                    times.extend(events.iter().map(|event| event.time));
                }
            });
        }
        (times, repair.counts())
    }

    #[test]
    fn times_after_gaps_of_any_length_are_those_without_them() {
        let all = transfers((1..3000).map(|index| index * 1003));
        let jitter = |index: usize| (index as u64).wrapping_mul(0x9E37_79B9) % 7000;
        for length in [1, 10, 31, 32, 33, 64, 65, 100, 327, 1000, 2000] {
            let lost = |index: usize| (500..500 + length).contains(&index);
            let (times, counts) = play(&all, lost, jitter, true);
            let kept = all.iter().enumerate().filter(|(index, _)| !lost(*index)).map(|(_, transfer)| transfer.0);
            // A transfer after a gap that carries no time of its own contributes no event.
            let missing = kept.clone().filter(|time| !times.contains(time)).count();
            assert!(missing <= 1, "{length}: {missing}");
            assert!(times.iter().all(|time| kept.clone().any(|kept| kept == *time)), "{length}");
            let wraps = all[500 + length].0 / 32_768 - all[499].0 / 32_768;
            let carried = u64::from(all[500 + length].0 / 32_768 != all[499 + length].0 / 32_768);
            assert_eq!(counts.restored_us, (wraps - carried) * 32_768, "{length}");
            assert_eq!((counts.gaps, counts.repaired), (1, u64::from(counts.restored_us > 0)), "{length}");
        }
    }

    #[test]
    fn a_failed_transfer_is_a_gap_and_a_timestamp_reset_is_not() {
        let all = transfers((1..300).map(|index| index * 1000));
        let mut decoder = Decoder::new(Layout::DAVIS346);
        let mut repair = GapRepair::default();
        let mut latest = 0;
        for (time, payload) in &all {
            let failed = (100_000..=200_000).contains(time);
            let status = if failed { TransferStatus::Error } else { TransferStatus::Completed };
            let transfer = Transfer { host_ns: Some(time * 1000), gap_before: false, status, payload };
            repair.decode(&transfer, &mut decoder, |message| {
                if let Message::Events(events) = message {
                    latest = events[0].time;
                    assert_eq!(latest, *time);
                }
            });
        }
        assert_eq!(latest, 299_000);
        assert_eq!(repair.counts(), RepairCounts { gaps: 101, repaired: 1, restored_us: 3 * 32_768, taken_back_us: 0 });

        let mut bytes = Vec::new();
        Encoder::new(Layout::DAVIS346).timestamp_reset(&mut bytes);
        let transfer = |host_ns, gap_before, payload| Transfer {
            host_ns: Some(host_ns),
            gap_before,
            status: TransferStatus::Completed,
            payload,
        };
        repair.decode(&transfer(900_000_000, true, &bytes), &mut decoder, |_| {});
        assert_eq!((decoder.time(), repair.counts().repaired), (0, 1));
        // The difference of the clocks has changed.
        repair.decode(&transfer(901_000_000, false, &all[0].1), &mut decoder, |_| {});
        repair.decode(&transfer(921_000_000, true, &all[20].1), &mut decoder, |_| {});
        assert_eq!((decoder.time(), repair.counts().repaired), (21_000, 1));
    }

    /// Returns the result of `play` for transfers 1 ms apart without those in `gaps`, where the host delays the
    /// transfers from number `late` on by 30 ms.
    fn play_late(gaps: &[std::ops::Range<usize>], late: usize) -> (Vec<Timed>, Vec<u64>, RepairCounts) {
        let all = transfers((1..3000).map(|index| index * 1003));
        let lost = |index: usize| gaps.iter().any(|gap| gap.contains(&index));
        let delay = |index: usize| match index.checked_sub(late) {
            Some(after) => 30_000u64.saturating_sub(1003 * after as u64),
            None => 0,
        };
        let (times, counts) = play(&all, lost, delay, true);
        (all, times, counts)
    }

    #[test]
    fn an_excess_wrap_is_taken_back_at_the_next_gap() {
        // Number 510 is late and looks like one more wrap; the later gap of a third of a second loses ten wraps.
        let (all, times, counts) = play_late(&[500..510, 1500..1830], 510);
        assert!(times.is_sorted());
        for (time, shift) in [(all[499].0, 0), (all[600].0, 32_768), (all[1499].0, 32_768), (all[1900].0, 0)] {
            assert!(times.contains(&(time + shift)), "{time}");
        }
        let (last, expected) = (times[times.len() - 1000..].to_vec(), all[all.len() - 1000..].iter());
        assert!(last.iter().eq(expected.map(|(time, _)| time)));
        assert_eq!((counts.gaps, counts.repaired, counts.taken_back_us), (2, 2, 32_768));
        // The gap at which the wrap is taken back may be the one after the next.
        let (all, times, counts) = play_late(&[500..510, 700..705, 1500..1830], 510);
        assert!(times.is_sorted() && times.ends_with(&[all[all.len() - 1].0]));
        assert_eq!(counts.taken_back_us, 32_768);
        // Without a late transfer nothing is taken back.
        let (_, times, counts) = play_late(&[500..510, 1500..1830], 5000);
        assert!(times.is_sorted() && counts.taken_back_us == 0 && counts.repaired == 1);
    }

    #[test]
    fn corrected_times_are_reported() {
        let all = transfers((1..3000).map(|index| index * 1003));
        let (mut decoder, mut repair) = (Decoder::new(Layout::DAVIS346), GapRepair::default());
        for (index, (time, payload)) in all.iter().enumerate().filter(|(index, _)| !(500..600).contains(index)) {
            // The host is busy when the stream resumes.
            let late = if index < 630 { 30_000u64.saturating_sub(1003 * index.saturating_sub(600) as u64) } else { 0 };
            let late = if index < 600 { 0 } else { late };
            let (host_ns, status) = (Some((time + late) * 1000), TransferStatus::Completed);
            let transfer = Transfer { host_ns, gap_before: index == 600, status, payload };
            repair.decode(&transfer, &mut decoder, |_| {});
        }
        let lost = all[600].0 / 32_768 - all[499].0 / 32_768;
        let [found] = repair.repairs() else { panic!("{:?}", repair.repairs()) };
        assert_eq!(*found, Repair { time: all[600].0 + 32_768, restored_us: (lost + 1) * 32_768, excess_us: 32_768 });
    }

    #[test]
    fn without_a_clock_time_does_not_run_back() {
        let all = transfers((1..300).map(|index| index * 1000));
        for length in [1, 20, 32, 60, 150] {
            let (times, counts) = play(&all, |index| (100..100 + length).contains(&index), |_| 0, false);
            assert!(times.is_sorted(), "{length}");
            assert!(counts.restored_us <= 32_768, "{length}");
        }
    }
}
