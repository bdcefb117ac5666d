//! Sorting of events within a bounded window of time.
//!
//! Writers that collect events by packet, by message or by pixel store some of them after later ones. The window is
//! 0.1 s long and has at most [`MOST_EVENTS`] events. Batches that are in order pass through without a copy.

use std::collections::VecDeque;

use evcal_core::event::Event;

use crate::read_report::ReadReport;

/// Length of the window in microseconds.
pub const WINDOW: i64 = 100_000;
/// Size limit of the window: 16 MiB, 0.1 s at 10 million events per second.
const MOST_EVENTS: usize = 1 << 20;
/// Number of events in a piece of the window.
const PIECE: usize = 1 << 14;
/// Number of buffers that are kept for reuse, and the number of events up to which they are.
const SPARE: usize = 4;
const LARGEST_SPARE: usize = 1 << 18;

/// The events of the last [`WINDOW`], sorted by time.
pub struct Order {
    window: i64,
    /// Pieces in order of time.
    held: VecDeque<Vec<Event>>,
    count: usize,
    /// Events that still have to be merged into the pieces.
    unsorted: Vec<Event>,
    /// Latest time of all events so far, and of the events that were returned.
    latest: i64,
    returned: i64,
    spare: Vec<Vec<Event>>,
}

impl Order {
    /// Creates an empty window of this length in microseconds. If the length is 0, events are not sorted.
    pub fn new(window: i64) -> Self {
        let (held, unsorted, spare) = (VecDeque::new(), Vec::new(), Vec::new());
        Self { window, held, count: 0, unsorted, latest: i64::MIN, returned: i64::MIN, spare }
    }

    /// Returns an empty buffer for the next events.
    pub fn buffer(&mut self) -> Vec<Event> {
        self.spare.pop().unwrap_or_default()
    }

    /// Adds `events`, in the order of the file. `latest` is the latest time up to here; `in_order` is true if no event
    /// is earlier than one before it. Events that are earlier than one already returned get its time.
    pub fn push(&mut self, mut events: Vec<Event>, latest: i64, in_order: bool, report: &mut ReadReport) {
        self.count += events.len();
        if in_order && self.unsorted.is_empty() {
            self.latest = latest;
            self.append(events);
            return;
        }
        for event in &mut events {
            let late = self.latest.saturating_sub(event.t);
            if late <= 0 {
                self.latest = event.t;
            } else if event.t < self.returned {
                report.steps_back += 1;
                report.largest_step_back = report.largest_step_back.max(self.returned - event.t);
                event.t = self.returned;
            } else {
                report.sorted += 1;
                report.largest_delay = report.largest_delay.max(late);
            }
        }
        self.unsorted.append(&mut events);
        self.recycle(events);
        if self.unsorted.len() >= PIECE || self.window == 0 {
            self.merge();
        }
    }

    /// Replaces the content of `events` with the next events that no later one can precede, or with any next events at
    /// the end of the recording. Returns `false` if there are none.
    pub fn pop(&mut self, is_end: bool, events: &mut Vec<Event>) -> bool {
        if is_end {
            self.merge();
        } else if !self.unsorted.is_empty() {
            return false;
        }
        let settled = self.latest.saturating_sub(self.window);
        let is_full = self.count > MOST_EVENTS;
        let is_next = |piece: &Vec<Event>| is_end || is_full || piece.last().is_none_or(|last| last.t <= settled);
        if !self.held.front().is_some_and(is_next) {
            return false;
        }
        let mut piece = self.held.pop_front().unwrap_or_default();
        self.count -= piece.len();
        self.returned = piece.last().map_or(self.returned, |last| last.t);
        std::mem::swap(events, &mut piece);
        self.recycle(piece);
        true
    }

    /// Number of events in the window.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Drops all events.
    pub fn clear(&mut self) {
        self.held.clear();
        self.unsorted.clear();
        self.count = 0;
    }

    fn recycle(&mut self, mut buffer: Vec<Event>) {
        if self.spare.len() < SPARE && buffer.capacity() <= LARGEST_SPARE {
            buffer.clear();
            self.spare.push(buffer);
        }
    }

    /// Adds events that are in order and not earlier than the others.
    fn append(&mut self, events: Vec<Event>) {
        match self.held.back_mut() {
            Some(last) if last.len() + events.len() <= PIECE => {
                last.extend_from_slice(&events);
                self.recycle(events);
            }
            _ if events.is_empty() => self.recycle(events),
            _ => self.held.push_back(events),
        }
    }

    /// Merges the unsorted events into the pieces that they overlap. Events of one time stay in the order of the file.
    fn merge(&mut self) {
        let unsorted = std::mem::take(&mut self.unsorted);
        let Some(first) = unsorted.iter().map(|event| event.t).min() else { return };
        let kept = self.held.partition_point(|piece| piece.last().is_none_or(|last| last.t <= first));
        let mut all: Vec<Event> = self.held.drain(kept..).flatten().collect();
        all.extend_from_slice(&unsorted);
        // This sort is stable, and takes linear time for a few sorted runs.
        all.sort_by_key(|event| event.t);
        self.held.extend(all.chunks(PIECE).map(<[Event]>::to_vec));
        self.unsorted = unsorted;
        self.unsorted.clear();
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;

    fn at(t: i64, x: usize) -> Event {
        Event { t, x: x as u16, y: 0, polarity: Polarity::On }
    }

    /// Passes batches of `size` events through the window. Returns the events and the report.
    fn sorted(events: &[Event], size: usize) -> (Vec<Event>, ReadReport) {
        let (mut order, mut report, mut latest) = (Order::new(WINDOW), ReadReport::default(), i64::MIN);
        let (mut all, mut batch) = (Vec::new(), Vec::new());
        for part in events.chunks(size) {
            let mut in_order = true;
            for event in part {
                in_order &= event.t >= latest;
                latest = latest.max(event.t);
            }
            order.push(part.to_vec(), latest, in_order, &mut report);
            while order.pop(false, &mut batch) {
                assert!(
                    batch.iter().all(|event| event.t <= latest - WINDOW) || order.count > MOST_EVENTS - size.max(PIECE)
                );
                all.append(&mut batch);
            }
        }
        while order.pop(true, &mut batch) {
            all.append(&mut batch);
        }
        (all, report)
    }

    /// Orders of 100,000 events, 3 µs apart, in blocks of at most 0.1 s: none, blocks reversed, two interleaved
    /// streams of which one is late, and one late event in a thousand.
    #[test]
    fn events_within_the_window_are_sorted_and_keep_their_order_at_equal_times() {
        let truth: Vec<Event> = (0..100_000).map(|index| at(index as i64 / 2 * 3, index % 30_000)).collect();
        let place: [fn(i64, i64) -> i64; 4] = [
            |_, index| index,
            |t, index| t / 90_000 * 90_000 * 100 + 90_000 * 100 - t % 90_000 * 100 + index % 2,
            |t, index| t * 10 + if index % 4 < 2 { 0 } else { 999_000 },
            |t, index| t * 10 + if index % 1000 == 0 { 600_000 } else { index % 2 },
        ];
        for place in place {
            let mut given: Vec<(i64, Event)> =
                truth.iter().enumerate().map(|(index, event)| (place(event.t, index as i64), *event)).collect();
            given.sort_by_key(|(place, _)| *place);
            let given: Vec<Event> = given.into_iter().map(|(_, event)| event).collect();
            let mut expected = given.clone();
            expected.sort_by_key(|event| event.t);
            let mut latest = 0;
            let late = given.iter().filter(|event| {
                latest = latest.max(event.t);
                event.t < latest
            });
            let late = late.count() as u64;
            for size in [1, 1000, 16_384, 100_000] {
                let (events, report) = sorted(&given, size);
                assert!(events == expected, "{size}");
                assert_eq!((report.sorted, report.steps_back), (late, 0));
            }
        }
    }

    /// Two million events of one time fill the window. One that is 50 ms earlier follows.
    #[test]
    fn what_exceeds_the_window_is_counted() {
        let mut events: Vec<Event> = (0..2 * MOST_EVENTS).map(|index| at(60_000, index % 100)).collect();
        events.extend([at(10_000, 1), at(70_000, 2)]);
        let (sorted, report) = sorted(&events, 30_000);
        assert_eq!((sorted.len(), report.sorted), (events.len(), 0));
        assert_eq!((report.steps_back, report.largest_step_back), (1, 50_000));
        assert!(sorted.is_sorted_by_key(|event| event.t) && sorted[0].t == 60_000);
    }
}
