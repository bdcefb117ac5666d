//! From pieces of a stream to transfers: pace, FIFO and faults of the camera's data endpoint.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::faults::Faults;
use super::piece::Piece;

/// How fast the stream is played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pace {
    /// As fast as the client reads; nothing is ever dropped.
    #[default]
    Full,
    /// By the pieces' times. What does not fit into the FIFO, because no transfer is queued, is
    /// dropped and counted by register 0.83, as the camera does.
    Real,
}

/// How often the camera looks whether it has something to send, running and at rest.
const TURN: Duration = Duration::from_millis(1);
const TURN_AT_REST: Duration = Duration::from_millis(20);
/// Longest time between two turns that passes for the camera too.
const TURN_MOST: Duration = Duration::from_millis(5);
/// Room of the camera's output.
const FIFO_BYTES: usize = 64 * 1024;

type Pieces = Box<dyn Iterator<Item = Piece> + Send>;

/// What a transfer brings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// Nothing yet.
    Nothing,
    /// These bytes.
    Bytes(Vec<u8>),
    /// Nothing: the endpoint halts.
    Halt,
}

/// The camera's data endpoint.
pub(super) struct Output {
    source: Box<dyn FnMut() -> Pieces + Send>,
    pieces: Pieces,
    /// A piece whose time has not come.
    next: Option<Piece>,
    fifo: VecDeque<u8>,
    pub(super) pace: Pace,
    pub(super) delay: Duration,
    pub(super) faults: Faults,
    running: bool,
    started: Option<Instant>,
    /// When it was last given the processor, and for how long it was kept from it.
    turned: Option<Instant>,
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
            fifo: VecDeque::new(),
            pace: Pace::default(),
            delay: Duration::ZERO,
            faults: Faults::default(),
            running: false,
            started: None,
            turned: None,
            asleep: Duration::ZERO,
            sent_last: None,
            sent: 0,
            cut: 0,
        }
    }

    /// Bytes sent since the latest start.
    pub(super) fn sent(&self) -> u64 {
        self.sent
    }

    /// Begins the stream anew.
    pub(super) fn start(&mut self) {
        self.pieces = (self.source)();
        (self.next, self.started, self.sent, self.cut) = (None, Some(Instant::now()), 0, 0);
        self.asleep = Duration::ZERO;
        self.fifo.clear();
        self.running = true;
    }

    /// Ends the stream; what is in the FIFO stays there.
    pub(super) fn stop(&mut self) {
        self.running = false;
    }

    /// Loses what it holds, as without power.
    pub(super) fn clear(&mut self) {
        self.running = false;
        self.fifo.clear();
        self.sent = 0;
    }

    /// Whether it is time to unplug the camera; true once.
    pub(super) fn take_unplug(&mut self) -> bool {
        self.faults.unplug_at.take_if(|at| self.sent >= *at).is_some()
    }

    /// What a transfer of at most `room` bytes brings now. A transfer that is not full waits for
    /// `early_packet_delay` (register 9.1) after the one before.
    pub(super) fn take(&mut self, room: usize, early_packet_delay: Duration) -> Taken {
        if self.faults.stall_at.take_if(|at| self.sent >= *at).is_some() {
            return Taken::Halt;
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
        self.sent += take as u64;
        Taken::Bytes(bytes)
    }

    /// After what time it wants its next turn: soon only while there is something to play.
    pub(super) fn turn_interval(&self) -> Duration {
        if self.running { TURN } else { TURN_AT_REST }
    }

    /// To be called every few milliseconds. Where the computer was too busy for that, the camera's
    /// time stood still: a real camera would not have sent everything at once afterwards.
    pub(super) fn turn(&mut self) {
        let now = Instant::now();
        let gap = self.turned.replace(now).map_or(Duration::ZERO, |turned| now - turned);
        self.asleep += gap.saturating_sub(TURN_MOST);
    }

    /// The next piece, if its time has come.
    fn due(&mut self) -> Option<Piece> {
        if !self.running {
            return None;
        }
        let elapsed = self.started.map_or(Duration::ZERO, |started| started.elapsed()).saturating_sub(self.asleep);
        let elapsed = elapsed.checked_sub(self.delay)?;
        let piece = self.next.take().or_else(|| self.pieces.next())?;
        if self.pace == Pace::Real && Duration::from_micros(piece.time) > elapsed {
            self.next = Some(piece);
            return None;
        }
        Some(piece)
    }

    fn fill(&mut self, room: usize) {
        while self.fifo.len() < room {
            let Some(piece) = self.due() else { return };
            self.fifo.extend(piece.bytes);
        }
    }

    /// Lets time pass without a queued transfer: how many pieces found no room in the FIFO.
    pub(super) fn idle(&mut self) -> u64 {
        let mut dropped = 0;
        while self.pace == Pace::Real {
            let Some(piece) = self.due() else { break };
            if self.fifo.len() + piece.bytes.len() > FIFO_BYTES {
                dropped += 1;
            } else {
                self.fifo.extend(piece.bytes);
            }
        }
        dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn running(pieces: Vec<Piece>, faults: Faults) -> Output {
        let mut output = Output::new(move || pieces.clone().into_iter());
        output.faults = faults;
        output.start();
        output
    }

    #[test]
    fn faults_come_at_their_byte() {
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
    fn what_no_transfer_takes_is_dropped_at_real_pace() {
        let pieces = (0..100).map(|_| Piece { time: 0, bytes: vec![0; 1000] }).collect();
        let mut output = running(pieces, Faults::default());
        output.pace = Pace::Real;
        assert_eq!(output.idle(), 35);
        assert_eq!(output.take(1 << 20, Duration::ZERO), Taken::Bytes(vec![0; 65_000]));
    }
}
