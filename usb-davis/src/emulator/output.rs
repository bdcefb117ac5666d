//! The camera's data endpoint: turns pieces of a stream into transfers, with pace, FIFO and faults.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::faults::Faults;
use super::multiplexer::{Drops, Gate, Multiplexer, needs_more};
use super::piece::Piece;
use crate::configuration::Streams;

/// Playback speed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Pace {
    /// As fast as the client reads; nothing is dropped.
    #[default]
    Full,
    /// According to the times of the pieces. Like the camera, drops events and signals that do not fit into the FIFO
    /// because no transfer is queued, and counts them in registers 0.83 and 0.81.
    Real,
}

/// Interval at which a running camera checks for data to send.
const TURN: Duration = Duration::from_millis(1);
/// The same interval while the camera does not run.
const TURN_AT_REST: Duration = Duration::from_millis(20);
/// Largest interval between two turns that counts as camera time.
const TURN_MOST: Duration = Duration::from_millis(5);
/// Programs switch the modules on one by one. After each switching, data of modules that are still off wait this long
/// for their module.
const SWITCHING: Duration = Duration::from_millis(100);
/// Size of the camera's output FIFO.
const FIFO_BYTES: usize = 64 * 1024;

type Pieces = Box<dyn Iterator<Item = Piece> + Send>;

/// Result of a transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// No data yet.
    Nothing,
    /// Data.
    Bytes(Vec<u8>),
    /// No data: the endpoint halts.
    Halt,
    /// No data: the bus fails.
    Failure,
}

/// The camera's data endpoint.
pub(super) struct Output {
    source: Box<dyn FnMut() -> Pieces + Send>,
    pieces: Pieces,
    /// A piece whose time has not come yet.
    next: Option<Piece>,
    multiplexer: Multiplexer,
    fifo: VecDeque<u8>,
    /// Number of stale bytes sent.
    stale: usize,
    /// `true` if a run has ended since the stale bytes were sent.
    ended: bool,
    pub(super) pace: Pace,
    pub(super) delay: Duration,
    pub(super) faults: Faults,
    /// Running modules, while the path from them to the bus is open.
    streams: Option<Streams>,
    switched: Option<Instant>,
    started: Option<Instant>,
    /// Time of the last turn.
    turned: Option<Instant>,
    /// Total time without turns.
    asleep: Duration,
    sent_last: Option<Instant>,
    sent: u64,
    cut: usize,
}

impl Output {
    pub(super) fn new<I>(mut source: impl FnMut() -> I + Send + 'static) -> Self
    where
        I: Iterator<Item = Piece> + Send + 'static,
    {
        Self {
            source: Box::new(move || Box::new(source())),
            pieces: Box::new(std::iter::empty()),
            next: None,
            multiplexer: Multiplexer::default(),
            fifo: VecDeque::new(),
            stale: 0,
            ended: false,
            pace: Pace::default(),
            delay: Duration::ZERO,
            faults: Faults::default(),
            streams: None,
            switched: None,
            started: None,
            turned: None,
            asleep: Duration::ZERO,
            sent_last: None,
            sent: 0,
            cut: 0,
        }
    }

    /// Returns the number of bytes sent since the latest start.
    pub(super) fn sent(&self) -> u64 {
        self.sent
    }

    /// Switches modules on or off; with `None` nothing is sent. The stream starts from the beginning if nothing was
    /// sent before; data in the FIFO at the end stay there.
    pub(super) fn switch(&mut self, streams: Option<Streams>) {
        if streams == self.streams {
            return;
        }
        match streams {
            Some(_) if self.streams.is_none() => self.start(),
            Some(_) => {}
            None => self.ended = true,
        }
        (self.streams, self.switched) = (streams, Some(Instant::now()));
    }

    fn start(&mut self) {
        self.pieces = (self.source)();
        (self.next, self.started, self.sent, self.cut) = (None, Some(Instant::now()), 0, 0);
        self.asleep = Duration::ZERO;
        self.multiplexer = Multiplexer::default();
        self.fifo.clear();
    }

    /// Restarts the time of a running stream at zero.
    pub(super) fn restart_time(&mut self) {
        if self.streams.is_some() {
            let mut words = Vec::new();
            self.multiplexer.restart_time(&mut words);
            self.fifo.extend(words);
        }
    }

    /// Discards all data, as a power loss does.
    pub(super) fn clear(&mut self) {
        (self.streams, self.stale, self.sent) = (None, 0, 0);
        self.fifo.clear();
    }

    /// Returns `true` once, when it is time to unplug the camera.
    pub(super) fn take_unplug(&mut self) -> bool {
        self.faults.unplug_at.take_if(|at| self.sent >= *at).is_some()
    }

    /// Returns the result of a transfer of at most `room` bytes. A transfer that is not full waits for
    /// `early_packet_delay` (register 9.1) after the previous one.
    pub(super) fn take(&mut self, room: usize, early_packet_delay: Duration) -> Taken {
        if self.faults.stall_at.take_if(|at| self.sent >= *at).is_some() {
            return Taken::Halt;
        }
        if self.streams.is_none() && self.faults.take_failure(self.sent) {
            return Taken::Failure;
        }
        if let Some(stale) = self.faults.stale.get(self.stale..).filter(|stale| !stale.is_empty()) {
            let stale: Vec<u8> = stale.iter().copied().take(room).collect();
            self.stale += stale.len();
            return Taken::Bytes(stale);
        }
        let room = self.faults.limit(room, self.sent, self.cut);
        self.fill(room);
        let take = self.fifo.len().min(room);
        let early = || self.sent_last.is_some_and(|last| last.elapsed() < early_packet_delay);
        if take == 0 || (take < room && self.pace == Pace::Real && early()) {
            return Taken::Nothing;
        }
        let mut bytes: Vec<u8> = self.fifo.drain(..take).collect();
        self.faults.spoil(&mut bytes, self.sent);
        self.sent_last = Some(Instant::now());
        self.cut = self.cut.wrapping_add(1);
        let fails = self.faults.take_failure(self.sent);
        self.sent += take as u64;
        if fails { Taken::Failure } else { Taken::Bytes(bytes) }
    }

    /// Returns the time until the next turn; it is short only while there is something to play.
    pub(super) fn turn_interval(&self) -> Duration {
        if self.streams.is_some() { TURN } else { TURN_AT_REST }
    }

    /// Advances the camera; call it every few milliseconds. If the computer was too busy for that, the camera's time is
    /// stopped in between, because a real camera would not send everything at once afterwards.
    pub(super) fn turn(&mut self) {
        let now = Instant::now();
        let gap = self.turned.replace(now).map_or(Duration::ZERO, |turned| now - turned);
        self.asleep += gap.saturating_sub(TURN_MOST);
    }

    /// Returns the next piece, if its time has come.
    fn due(&mut self, streams: Streams) -> Option<Piece> {
        let elapsed = self.started.map_or(Duration::ZERO, |started| started.elapsed()).saturating_sub(self.asleep);
        let elapsed = elapsed.checked_sub(self.delay)?;
        let Some(piece) = self.next.take().or_else(|| self.pieces.next()) else {
            self.fifo.extend(self.multiplexer.finish());
            return None;
        };
        let early = self.pace == Pace::Real && Duration::from_micros(piece.time) > elapsed;
        let switching = self.switched.is_some_and(|switched| switched.elapsed() < SWITCHING);
        if early || switching && needs_more(&piece.bytes, streams) {
            self.next = Some(piece);
            return None;
        }
        Some(piece)
    }

    fn fill(&mut self, room: usize) {
        let mut words = Vec::new();
        while self.fifo.len() < room
            && let Some(streams) = self.streams
            && let Some(piece) = self.due(streams)
        {
            words.clear();
            self.multiplexer.take(&piece.bytes, Gate::without_limit(streams), &mut words);
            self.fifo.extend(&words);
        }
    }

    /// Advances the time without a queued transfer, and returns the data that did not fit into the FIFO. With
    /// `drop_events` and `drop_signals`, events and signals do not wait for room.
    pub(super) fn idle(&mut self, drop_events: bool, drop_signals: bool) -> Drops {
        // The end of the previous run will not be read any more.
        if self.streams.is_none() && std::mem::take(&mut self.ended) {
            self.stale = 0;
        }
        let mut drops = Drops::default();
        let mut words = Vec::new();
        while self.pace == Pace::Real
            && let Some(streams) = self.streams
            && let Some(piece) = self.due(streams)
        {
            let room = FIFO_BYTES.saturating_sub(self.fifo.len());
            words.clear();
            let new =
                self.multiplexer.take(&piece.bytes, Gate { streams, room, drop_events, drop_signals }, &mut words);
            (drops.events, drops.signals) = (drops.events + new.events, drops.signals + new.signals);
            self.fifo.extend(&words);
        }
        drops
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::Failures;

    fn running(pieces: Vec<Piece>, faults: Faults) -> Output {
        let mut output = Output::new(move || pieces.clone().into_iter());
        output.faults = faults;
        output.switch(Some(Streams::ALL));
        output
    }

    #[test]
    fn failed_transfers_lose_their_data() {
        let pieces = vec![Piece { time: 0, bytes: (0..100).collect() }];
        let failures = Some(Failures { at: 10, transfers: 2 });
        let mut output = running(pieces, Faults { failures, ..Faults::default() });
        let mut take = || output.take(20, Duration::ZERO);
        assert_eq!(take(), Taken::Bytes((0..10).collect()));
        assert_eq!([take(), take()], [Taken::Failure, Taken::Failure]);
        assert_eq!(take(), Taken::Bytes((50..70).collect()));
    }

    #[test]
    fn stale_bytes_come_first_and_again_after_each_run() {
        let pieces = vec![Piece { time: 0, bytes: vec![1; 10] }];
        let mut output = running(pieces, Faults { stale: vec![9; 5], ..Faults::default() });
        assert_eq!(output.take(3, Duration::ZERO), Taken::Bytes(vec![9; 3]));
        assert_eq!(output.take(30, Duration::ZERO), Taken::Bytes(vec![9; 2]));
        assert_eq!(output.take(30, Duration::ZERO), Taken::Bytes(vec![1; 10]));
        output.switch(None);
        assert_eq!(output.take(30, Duration::ZERO), Taken::Nothing);
        output.idle(true, true);
        assert_eq!(output.take(30, Duration::ZERO), Taken::Bytes(vec![9; 5]));
        assert_eq!(output.take(30, Duration::ZERO), Taken::Nothing);
    }

    #[test]
    fn faults_occur_at_their_byte() {
        let pieces = vec![Piece { time: 0, bytes: (0..100).collect() }];
        let faults = Faults { cuts: vec![7, 3], stall_at: Some(12), unplug_at: Some(20), ..Faults::default() };
        let mut output = running(pieces, faults);
        let mut take = || output.take(64, Duration::ZERO);
        let expected = [(0..7).collect(), (7..10).collect(), (10..12).collect()];
        assert_eq!([take(), take(), take()], expected.map(Taken::Bytes));
        assert_eq!(take(), Taken::Halt);
        assert_eq!(take(), Taken::Bytes(vec![12, 13, 14]));
        assert!(!output.take_unplug());
        while !output.take_unplug() {
            assert!(matches!(output.take(64, Duration::ZERO), Taken::Bytes(_)));
        }
        assert_eq!(output.sent(), 20);
        assert!(!output.take_unplug());
    }

    #[test]
    fn events_without_a_queued_transfer_are_dropped_at_real_pace() {
        // Row 0, then 499 columns.
        let bytes: Vec<u8> = [0x00, 0x10].into_iter().chain([0x00, 0x20].repeat(499)).collect();
        let pieces = vec![Piece { time: 0, bytes }; 100];
        for drop_events in [true, false] {
            let mut output = running(pieces.clone(), Faults::default());
            output.pace = Pace::Real;
            let dropped = output.idle(drop_events, true).events;
            let Taken::Bytes(bytes) = output.take(1 << 20, Duration::ZERO) else { panic!("nothing") };
            let columns = bytes.as_chunks::<2>().0.iter().filter(|word| word[1] == 0x20).count() as u64;
            assert_eq!(columns + dropped, 100 * 499);
            assert_eq!((dropped > 0, bytes.len() <= FIFO_BYTES), (drop_events, drop_events));
            assert!(bytes.len() > FIFO_BYTES - 100);
        }
    }
}
