//! An even sample of the events of all recordings, held in memory.
//!
//! The rank of an event in its burst requires all earlier events of the pixel and some later ones. So a recording is read once
//! from beginning to end, and events wait until their bursts are over. The rounds of association use only a part of the events:
//! as many as fit into memory are kept with their ranks during detection, so that the recording is not read again.

use std::collections::VecDeque;
use std::hint::black_box;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use crate::solve::rows::burst::{BurstBeginning, BurstLength, BurstPosition, BurstTracker};
use evcal_detection::diagnosis::double_edges::FirstIntervals;
use evcal_detection::diagnosis::lost_events::BurstPairs;

/// An event with its rank and burst length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RankedEvent {
    /// Time in microseconds since the start of the recording.
    pub t: i64,
    /// Column in pixels.
    pub x: u16,
    /// Row in pixels.
    pub y: u16,
    /// Direction of the change.
    pub polarity: Polarity,
    /// Rank and length of its burst.
    pub place: BurstPosition,
}

/// Returns the position of an event in a fixed order of thinning: to keep a share of the events, the ones whose position is below
/// a bound are kept ([`places`]).
///
/// Multiples of the golden ratio spread any share evenly over neighbouring ordinals.
fn thinning_place(ordinal: u64) -> u32 {
    (ordinal.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as u32
}

/// Returns the bound of [`thinning_place`] below which a share (0 to 1) of the events lies.
fn places(share: f64) -> u64 {
    (share * 2.0_f64.powi(32)).round().clamp(0.0, 2.0_f64.powi(32)) as u64
}

/// Longest pause within a burst (µs), which is also the time that events wait for the end of their burst.
const BURST_PAUSE: i64 = 100_000;

/// Number of events whose pixels are fetched from memory together: their states fit into the fastest cache.
const TOGETHER: usize = 128;

/// Ranks the events of one recording and passes on a share of them.
pub struct Thinning {
    bursts: BurstTracker,
    ordinal: u64,
    /// Time of the latest event that was taken (µs).
    latest: i64,
    waiting: VecDeque<Waiting>,
}

/// An event whose burst may continue, in 16 bytes: at 20 million events per second, two million wait at a time.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    /// The lowest bits of the time (µs). The rest follows from the latest event, which is at most [`BURST_PAUSE`] later.
    t: u32,
    /// Position in the order of thinning.
    order: u32,
    x: u16,
    y: u16,
    polarity: Polarity,
    beginning: BurstBeginning,
}

const _: () = assert!(size_of::<Waiting>() == 16);

/// Largest number of events that wait, four times as many as those of 20 million events per second. Of more, as in files with very many
/// events at one time, the first do not wait for the end of their bursts.
const MOST_WAITING: usize = 1 << 23;

impl Waiting {
    /// Returns the time (µs), given the time `latest` of the latest event.
    fn t(&self, latest: i64) -> i64 {
        let before = (latest as u32).wrapping_sub(self.t) as i32;
        latest - i64::from(before)
    }
}

impl Thinning {
    /// Creates the thinning of a recording of this sensor.
    pub fn new(sensor: Sensor) -> Self {
        Self { bursts: BurstTracker::new(sensor, BURST_PAUSE), ordinal: 0, latest: 0, waiting: VecDeque::new() }
    }

    /// Takes the next events of the recording; their times are microseconds since its start. Events whose position is below
    /// `places` wait, and `keep` gets those whose burst is over.
    fn push(&mut self, events: &[Event], places: u64, mut keep: impl FnMut(RankedEvent, u32)) {
        for events in events.chunks(TOGETHER) {
            self.bursts.count(events);
            let over = events.last().map_or(i64::MIN, |last| last.t.saturating_sub(BURST_PAUSE));
            let due = self.waiting.iter().take_while(|first| first.t(self.latest) < over);
            black_box(due.fold(0, |sum, event| sum ^ self.bursts.touch(event.x, event.y)));
            for event in events {
                let over = event.t.saturating_sub(BURST_PAUSE);
                while let Some(first) = self.waiting.front().copied() {
                    if first.t(self.latest) >= over && self.waiting.len() < MOST_WAITING {
                        break;
                    }
                    self.waiting.pop_front();
                    keep(self.ranked(&first), first.order);
                }
                self.latest = event.t;
                let order = thinning_place(self.ordinal);
                self.ordinal += 1;
                let Some(beginning) = self.bursts.push(event) else { continue };
                if u64::from(order) < places {
                    let Event { t, x, y, polarity } = *event;
                    self.waiting.push_back(Waiting { t: t as u32, order, x, y, polarity, beginning });
                }
            }
        }
        // At the beginning all events wait, later only the sampled ones.
        if self.waiting.len() < self.waiting.capacity() / 8 {
            self.waiting.shrink_to(2 * self.waiting.len());
        }
    }

    /// Returns the number of events of each pixel, row by row.
    pub fn counts(&self) -> Vec<u32> {
        self.bursts.counts()
    }

    /// Returns the number of events that have the same time and polarity as the previous event of their pixel.
    pub fn repeated(&self) -> u64 {
        self.bursts.repeated()
    }

    /// Returns the intervals after the first event of each burst.
    pub fn intervals(&self) -> &FirstIntervals {
        self.bursts.intervals()
    }

    /// Returns the lengths of successive bursts.
    pub fn pairs(&self) -> &BurstPairs {
        self.bursts.pairs()
    }

    fn ranked(&self, event: &Waiting) -> RankedEvent {
        let Waiting { x, y, polarity, beginning, .. } = *event;
        let t = event.t(self.latest);
        RankedEvent { t, x, y, polarity, place: self.bursts.place(x, y, beginning) }
    }

    /// Ends the recording: `keep` gets the events that still wait.
    fn end(&mut self, mut keep: impl FnMut(RankedEvent, u32)) {
        for event in std::mem::take(&mut self.waiting) {
            keep(self.ranked(&event), event.order);
        }
    }

    /// Takes the next events, and appends a share of 0 to 1 of them to `kept` as soon as their bursts are over.
    pub fn take(&mut self, events: &[Event], share: f64, kept: &mut Vec<RankedEvent>) {
        self.push(events, places(share), |event, _| kept.push(event));
    }

    /// Appends the events that still wait at the end of the recording to `kept`.
    pub fn take_rest(&mut self, kept: &mut Vec<RankedEvent>) {
        self.end(|event, _| kept.push(event));
    }
}

/// Share of the sample that is kept when it has become too large.
const STAYS: f64 = 0.75;
/// Number of events in one batch.
const BATCH: usize = 32_768;

/// Largest number of events in a run.
const RUN: usize = 32_768;

/// Consecutive events, in 13 bytes each.
#[derive(Clone, Debug)]
pub struct Run {
    /// Time of the first event (µs).
    start: i64,
    events: Vec<CompactEvent>,
    kinds: Vec<CompactKind>,
}

#[derive(Clone, Copy, Debug)]
struct CompactEvent {
    /// Time after the start of the run (µs).
    t: u32,
    x: u16,
    y: u16,
    /// Position in the order of thinning.
    place: u32,
}

/// Polarity, rank and length of the burst in one byte.
#[derive(Clone, Copy, Debug)]
struct CompactKind(u8);

impl CompactKind {
    fn new(polarity: Polarity, place: BurstPosition) -> Self {
        Self(polarity.index() as u8 | (place.length.index() as u8) << 1 | place.rank << 3)
    }

    fn polarity(self) -> Polarity {
        if self.0 & 1 == 0 { Polarity::Off } else { Polarity::On }
    }

    fn place(self) -> BurstPosition {
        let length = BurstLength::ALL.get(usize::from(self.0 >> 1 & 3)).copied().unwrap_or_default();
        BurstPosition { rank: self.0 >> 3, length }
    }
}

impl Run {
    fn starting_at(start: i64) -> Self {
        Self { start, events: Vec::new(), kinds: Vec::new() }
    }

    /// Returns the time after the start of the run, if an event of time `t` fits into the run.
    fn room_for(&self, t: i64) -> Option<u32> {
        let after = t.checked_sub(self.start).and_then(|after| u32::try_from(after).ok())?;
        (self.events.len() < RUN).then_some(after)
    }

    /// Keeps the events whose position in the order of thinning is below `places`.
    fn thin_to(&mut self, places: u64) {
        let mut stays = self.events.iter().map(|event| u64::from(event.place) < places);
        self.kinds.retain(|_| stays.next().unwrap_or(false));
        self.events.retain(|event| u64::from(event.place) < places);
        self.events.shrink_to_fit();
        self.kinds.shrink_to_fit();
    }

    /// Returns by how much (µs) the later run `other` starts after this one, if all its events fit into this one.
    fn room_for_all_of(&self, other: &Self) -> Option<u32> {
        let later = u32::try_from(other.start.checked_sub(self.start)?).ok()?;
        let last = other.events.last().map_or(0, |event| event.t);
        (later.checked_add(last).is_some() && self.events.len() + other.events.len() <= RUN).then_some(later)
    }

    /// Adds the events of `other`, which starts `later` µs after this run.
    fn append(&mut self, other: &Self, later: u32) {
        self.events.extend(other.events.iter().map(|event| CompactEvent { t: event.t + later, ..*event }));
        self.kinds.extend_from_slice(&other.kinds);
    }

    /// Returns the events in order of time.
    pub fn events(&self) -> impl Iterator<Item = RankedEvent> + '_ {
        self.placed().map(|(event, _)| event)
    }

    /// Returns the events in order of time, each with its position in the order of thinning.
    fn placed(&self) -> impl Iterator<Item = (RankedEvent, u32)> + '_ {
        self.events.iter().zip(&self.kinds).map(|(&CompactEvent { t, x, y, place }, kind)| {
            let t = self.start + i64::from(t);
            (RankedEvent { t, x, y, polarity: kind.polarity(), place: kind.place() }, place)
        })
    }
}

/// The kept events of one recording, in runs, so that they take no more memory than they need.
#[derive(Clone, Debug, Default)]
struct Kept {
    runs: Vec<Run>,
}

impl Kept {
    fn len(&self) -> usize {
        self.runs.iter().map(|run| run.events.len()).sum()
    }

    fn push(&mut self, event: RankedEvent, place: u32) {
        let RankedEvent { t, x, y, polarity, place: in_burst } = event;
        let after = match self.runs.last().and_then(|run| run.room_for(t)) {
            Some(after) => after,
            None => {
                self.runs.push(Run::starting_at(t));
                0
            }
        };
        if let Some(run) = self.runs.last_mut() {
            run.events.push(CompactEvent { t: after, x, y, place });
            run.kinds.push(CompactKind::new(polarity, in_burst));
        }
    }

    fn thin_to(&mut self, places: u64) {
        for mut run in std::mem::take(&mut self.runs) {
            run.thin_to(places);
            match self.runs.last_mut().and_then(|last| Some((last.room_for_all_of(&run)?, last))) {
                Some((later, last)) => last.append(&run, later),
                None => self.runs.push(run),
            }
        }
    }
}

/// An even sample of the events of all recordings.
#[derive(Clone, Debug)]
pub struct EventSample {
    recordings: Vec<Kept>,
    most: usize,
    share: f64,
}

impl EventSample {
    /// Creates a sample of at most `most` events of all recordings together (at least one); each takes 13 bytes.
    pub fn new(most: usize) -> Self {
        Self { recordings: Vec::new(), most: most.max(1), share: 1.0 }
    }

    /// Begins recording number `recording`; the next events belong to it.
    pub fn begin(&mut self, recording: usize) {
        self.recordings.resize_with(self.recordings.len().max(recording + 1), Kept::default);
    }

    /// Adds the next events of the current recording; `thinning` is the recording's.
    pub fn push(&mut self, events: &[Event], thinning: &mut Thinning) {
        self.follow(thinning, |thinning, places, keep| thinning.push(events, places, keep));
    }

    /// Passes the next events of the current recording to `thinning` without keeping any of them.
    pub fn pass(&mut self, events: &[Event], thinning: &mut Thinning) {
        self.follow(thinning, |thinning, _, keep| thinning.push(events, 0, keep));
    }

    /// Ends the current recording.
    pub fn end(&mut self, thinning: &mut Thinning) {
        self.follow(thinning, |thinning, _, keep| thinning.end(keep));
    }

    /// Runs `step`, which gets the bound of the positions in the sample, and keeps the events that `thinning` passes on.
    fn follow(
        &mut self,
        thinning: &mut Thinning,
        step: impl FnOnce(&mut Thinning, u64, &mut dyn FnMut(RankedEvent, u32)),
    ) {
        let places = places(self.share);
        let Some(kept) = self.recordings.last_mut() else { return };
        // The share may have decreased while events waited.
        step(thinning, places, &mut |event, place| {
            if u64::from(place) < places {
                kept.push(event, place);
            }
        });
        self.thin();
    }

    fn thin(&mut self) {
        while self.recordings.iter().map(Kept::len).sum::<usize>() > self.most {
            self.share *= STAYS;
            let places = self::places(self.share);
            self.recordings.iter_mut().for_each(|kept| kept.thin_to(places));
        }
    }

    /// Returns a smaller sample, of at most `most` events.
    pub fn thinned(mut self, most: usize) -> Self {
        self.most = most.max(1);
        self.thin();
        self
    }

    /// Returns all sampled events of a recording, in the order of time.
    pub fn runs(&self, recording: usize) -> &[Run] {
        self.recordings.get(recording).map_or(&[], |kept| &kept.runs)
    }

    /// Passes the events of a share of 0 to 1 of a recording to `visit`, batch by batch in the order of time. Returns `false`
    /// without a call if the sample does not contain all of them.
    pub fn read(&self, recording: usize, share: f64, visit: &mut dyn FnMut(&[RankedEvent])) -> bool {
        let (Some(kept), true) = (self.recordings.get(recording), share <= self.share) else { return false };
        let places = places(share);
        let mut batch = Vec::new();
        for (event, place) in kept.runs.iter().flat_map(Run::placed) {
            if u64::from(place) < places {
                batch.push(event);
            }
            // Batches are full however small the share, because their processing is shared among threads.
            if batch.len() == BATCH {
                visit(&batch);
                batch.clear();
            }
        }
        if !batch.is_empty() {
            visit(&batch);
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor::new(64, 48);

    fn events(count: u64) -> Vec<Event> {
        let of = |index: u64| {
            let random = index.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 40;
            let polarity = if random & 1 == 0 { Polarity::On } else { Polarity::Off };
            Event { t: index as i64 * 7, x: (random >> 1) as u16 % 64, y: (random >> 8) as u16 % 48, polarity }
        };
        (0..count).map(of).collect()
    }

    fn streamed(events: &[Event], share: f64) -> Vec<RankedEvent> {
        let (mut thinning, mut kept) = (Thinning::new(SENSOR), Vec::new());
        events.chunks(777).for_each(|batch| thinning.take(batch, share, &mut kept));
        thinning.take_rest(&mut kept);
        kept
    }

    fn sampled(recordings: &[Vec<Event>], most: usize) -> EventSample {
        let mut sample = EventSample::new(most);
        for (index, events) in recordings.iter().enumerate() {
            sample.begin(index);
            let mut thinning = Thinning::new(SENSOR);
            events.chunks(999).for_each(|batch| sample.push(batch, &mut thinning));
            sample.end(&mut thinning);
        }
        sample
    }

    /// Events of one time wait for the end of their burst, but not all events of a file may.
    #[test]
    fn events_far_apart_and_of_one_time_need_little_memory() {
        let event = |t: i64| Event { t, x: 1, y: 1, polarity: Polarity::On };
        let hours: Vec<Event> = (0..1000).map(|index| event(index << 33)).collect();
        let sample = sampled(&[hours], 2000);
        let room: usize = sample.runs(0).iter().map(|run| run.events.capacity() + run.kinds.capacity()).sum();
        assert!(sample.runs(0).len() == 1000 && room < 20_000, "{room}");
        let (mut thinning, mut kept) = (Thinning::new(SENSOR), Vec::new());
        let together = vec![event(5); 1 << 20];
        for _ in 0..9 {
            thinning.take(&together, 1.0, &mut kept);
            kept.clear();
        }
        assert_eq!(thinning.waiting.len(), MOST_WAITING);
        assert!(kept.is_empty());
    }

    #[test]
    fn thinning_keeps_the_requested_share() {
        let events = events(100_000);
        for share in [0.0, 0.1, 0.5, 0.9, 1.0] {
            let kept = streamed(&events, share).len();
            assert!((kept as f64 / 100_000.0 - share).abs() < 1e-3, "{share}: {kept}");
        }
    }

    #[test]
    fn times_are_restored_after_long_pauses() {
        let hours = 3_600_000_000;
        // Within a burst, after the longest silence, and where the lowest bits of the time wrap.
        let times = [0, 1, 50_000, hours, 30 * hours, (1 << 37) - 10, (1 << 37) + 10, (1 << 37) + 99_000, i64::MAX / 2];
        let event = |t: i64| Event { t, x: (t % 64) as u16, y: 3, polarity: Polarity::On };
        let kept = streamed(&times.map(event), 1.0);
        assert_eq!(kept.iter().map(|event| event.t).collect::<Vec<_>>(), times);
    }

    #[test]
    fn the_sample_returns_the_same_events_as_the_recording() {
        let recordings = [events(20_000), events(30_000)];
        let sample = sampled(&recordings, 10_000);
        let kept: usize = sample.recordings.iter().map(Kept::len).sum();
        assert!((7_000..=10_000).contains(&kept), "{kept}");
        for (index, events) in recordings.iter().enumerate() {
            for share in [0.0, 0.01, 0.1, sample.share] {
                let mut read = Vec::new();
                assert!(sample.read(index, share, &mut |batch| read.extend_from_slice(batch)));
                assert_eq!(read, streamed(events, share), "{share}");
            }
        }
    }

    #[test]
    fn a_share_larger_than_the_sample_is_not_available() {
        let sample = sampled(&[events(20_000)], 10_000);
        let none = &mut |_: &[RankedEvent]| panic!("events");
        assert!(!sample.read(0, 1.0, none));
        assert!(!sample.read(1, 0.1, none));
        let all = sampled(&[events(500)], 500);
        let mut count = 0;
        assert!(all.read(0, 1.0, &mut |batch| count += batch.len()));
        assert_eq!(count, 500);
    }
}
