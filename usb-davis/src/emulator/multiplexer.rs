//! Selection of the words of a stream that are sent: words of running modules, for which there is room.
//!
//! As long as all words are sent, bytes pass unchanged, faults included. From the first word that is held back or
//! inserted, timestamps are written again: wrap, timestamp and row are sent when the host does not know them yet, as in
//! the camera's multiplexer.

use crate::configuration::Streams;
use crate::protocol::word::{Special, Word};

/// Largest multiplier of a wrap word.
const WRAP_MOST: u64 = 0x0FFF;
/// Room for a word with everything that may have to precede it.
const WORDS: usize = 16;

/// Conditions for sending words.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gate {
    /// Running modules.
    pub(super) streams: Streams,
    /// Bytes for which there is room.
    pub(super) room: usize,
    /// `true` to drop events for which there is no room (register 0.5). Everything else waits for room.
    pub(super) drop_events: bool,
    /// `true` to drop signals for which there is no room (register 0.4).
    pub(super) drop_signals: bool,
}

impl Gate {
    /// Sends everything from these modules.
    pub(super) fn without_limit(streams: Streams) -> Self {
        Self { streams, room: usize::MAX, drop_events: false, drop_signals: false }
    }
}

/// Number of events and signals for which there was no room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Drops {
    pub(super) events: u64,
    pub(super) signals: u64,
}

/// Origin of a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Module {
    Multiplexer,
    Events,
    Frames,
    Imu,
    Signals,
}

fn module(word: Word) -> Module {
    match word {
        Word::Row(_) | Word::Column(..) => Module::Events,
        Word::Sample(_) | Word::RegionHigh(_) | Word::RegionLow(_) | Word::Exposure(_) => Module::Frames,
        Word::ImuByte(_) | Word::ImuScale(_) | Word::Special(Special::ImuStart | Special::ImuEnd) => Module::Imu,
        Word::Timestamp(_) | Word::Wrap(_) | Word::Unknown(_) | Word::Special(Special::TimestampReset) => {
            Module::Multiplexer
        }
        Word::Special(
            Special::ExternalInputFalling
            | Special::ExternalInputRising
            | Special::ExternalInputPulse
            | Special::GeneratorFalling
            | Special::GeneratorRising,
        ) => Module::Signals,
        Word::Special(_) => Module::Frames,
    }
}

/// Returns `true` if `bytes` contain words of modules that do not run in `streams`.
pub(super) fn needs_more(bytes: &[u8], streams: Streams) -> bool {
    let (words, _) = bytes.as_chunks::<2>();
    words.iter().any(|word| match module(Word::parse(u16::from_le_bytes(*word))) {
        Module::Multiplexer => false,
        Module::Events => !streams.events,
        Module::Frames => !streams.frames,
        Module::Imu => !streams.imu,
        Module::Signals => !streams.signals,
    })
}

/// Time and row at a position of a stream.
#[derive(Clone, Copy, Debug, Default)]
struct Position {
    /// Time at the latest wrap or restart in µs.
    wrap: u64,
    /// Low 15 bits of the time.
    low: u16,
    row: Option<u16>,
}

impl Position {
    fn time(&self) -> u64 {
        self.wrap + u64::from(self.low)
    }
}

/// The multiplexer, from the start of a stream.
#[derive(Clone, Debug)]
pub(super) struct Multiplexer {
    /// First byte of a word whose second byte has not come yet.
    half: Option<u8>,
    /// `true` while every word was sent.
    exact: bool,
    source: Position,
    sent: Position,
    /// Time of the source at which the host's time is zero (µs).
    zero: u64,
    /// `true` if the current frame is sent.
    frame: bool,
    /// `true` if the current IMU sample is sent.
    sample: bool,
}

impl Default for Multiplexer {
    fn default() -> Self {
        let (source, sent) = (Position::default(), Position::default());
        Self { half: None, exact: true, source, sent, zero: 0, frame: true, sample: true }
    }
}

impl Multiplexer {
    /// Processes the next bytes of the stream; appends the bytes to send to `out`.
    pub(super) fn take(&mut self, bytes: &[u8], gate: Gate, out: &mut Vec<u8>) -> Drops {
        let mut drops = Drops::default();
        let bytes = match (self.half, bytes) {
            (Some(low), [high, rest @ ..]) => {
                self.half = None;
                self.word(u16::from_le_bytes([low, *high]), gate, &mut drops, out);
                rest
            }
            _ => bytes,
        };
        let (words, odd) = bytes.as_chunks::<2>();
        for word in words {
            self.word(u16::from_le_bytes(*word), gate, &mut drops, out);
        }
        if let [byte] = odd {
            self.half = Some(*byte);
        }
        drops
    }

    /// Ends the stream, which sends an incomplete word too.
    pub(super) fn finish(&mut self) -> Option<u8> {
        self.half.take()
    }

    /// Restarts the time at zero.
    pub(super) fn restart_time(&mut self, out: &mut Vec<u8>) {
        put(Word::Special(Special::TimestampReset), out);
        (self.exact, self.zero, self.sent) = (false, self.source.time(), Position::default());
    }

    fn word(&mut self, bits: u16, gate: Gate, drops: &mut Drops, out: &mut Vec<u8>) {
        let word = Word::parse(bits);
        let new_row = self.source.row.is_none() || matches!(word, Word::Row(_));
        match word {
            Word::Timestamp(low) => self.source.low = low,
            Word::Wrap(times) => (self.source.wrap, self.source.low) = (self.source.wrap + (u64::from(times) << 15), 0),
            Word::Row(row) => self.source.row = Some(row),
            Word::Special(Special::TimestampReset) => self.source = Position::default(),
            _ => {}
        }
        let goes = self.goes(word, gate, drops, out.len());
        self.exact &= goes;
        if self.exact {
            put(word, out);
            self.sent = self.source;
            return;
        }
        match word {
            Word::Special(Special::TimestampReset) => {
                put(word, out);
                (self.sent, self.zero) = (Position::default(), 0);
            }
            // A row is sent with its first column, unless that column is held back.
            Word::Row(_) if new_row => self.sent.row = None,
            Word::Wrap(_) if out.len() < gate.room => self.wraps(out),
            Word::Timestamp(_) | Word::Row(_) | Word::Wrap(_) => {}
            _ if !goes => {}
            Word::Column(..) => {
                self.stamp(out);
                if let Some(row) = self.source.row.filter(|row| self.sent.row != Some(*row)) {
                    put(Word::Row(row), out);
                    self.sent.row = Some(row);
                }
                put(word, out);
            }
            Word::Special(_) => {
                self.stamp(out);
                put(word, out);
            }
            _ => put(word, out),
        }
    }

    /// Returns `true` if a word is sent; counts it if it is dropped.
    fn goes(&mut self, word: Word, gate: Gate, drops: &mut Drops, length: usize) -> bool {
        let full = length + WORDS > gate.room;
        match (module(word), word) {
            (Module::Multiplexer, _) => true,
            (Module::Events, _) if !gate.streams.events => false,
            (Module::Events, _) => {
                let drop = full && gate.drop_events;
                drops.events += u64::from(drop && matches!(word, Word::Column(..)));
                !drop
            }
            (Module::Signals, _) if !gate.streams.signals => false,
            (Module::Signals, _) => {
                let drop = full && gate.drop_signals;
                drops.signals += u64::from(drop);
                !drop
            }
            (Module::Frames, _) => {
                let starts =
                    matches!(word, Word::Special(Special::FrameStartGlobalShutter | Special::FrameStartRollingShutter));
                self.frame = gate.streams.frames && (self.frame || starts);
                self.frame
            }
            (Module::Imu, _) => {
                self.sample = gate.streams.imu && (self.sample || word == Word::Special(Special::ImuStart));
                self.sample
            }
        }
    }

    /// Sends the wraps that the host does not know yet.
    fn wraps(&mut self, out: &mut Vec<u8>) {
        let mut wraps = self.source.time().saturating_sub(self.zero).saturating_sub(self.sent.wrap) >> 15;
        while wraps > 0 {
            let times = wraps.min(WRAP_MOST);
            put(Word::Wrap(times as u16), out);
            (self.sent.wrap, self.sent.low) = (self.sent.wrap + (times << 15), 0);
            wraps -= times;
        }
    }

    /// Sends the time, if the host does not know it yet.
    fn stamp(&mut self, out: &mut Vec<u8>) {
        self.wraps(out);
        let low = (self.source.time().saturating_sub(self.zero) & 0x7FFF) as u16;
        if low != self.sent.low {
            put(Word::Timestamp(low), out);
            self.sent.low = low;
        }
    }
}

fn put(word: Word, out: &mut Vec<u8>) {
    out.extend(word.emit().to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::{Decoder, Encoder, Frame, ImuModel, ImuSample, ImuScale, Layout, Message};
    use crate::protocol::{Polarity, PolarityEvent, Region, Shutter, Signal, SignalEvent};

    fn event(index: u64) -> PolarityEvent {
        let (x, y) = ((index / 5 * 7 % 346) as u16, (index * 11 % 260) as u16);
        PolarityEvent {
            time: index * 37,
            x,
            y,
            polarity: if index.is_multiple_of(3) { Polarity::Off } else { Polarity::On },
        }
    }

    /// Returns 10,000 events over 0.37 s, with a small frame, an IMU sample and a signal at every thousandth.
    fn stream() -> Vec<u8> {
        let mut encoder = Encoder::new(Layout::DAVIS346);
        let mut bytes = Vec::new();
        for index in 0..10_000 {
            encoder.event(&event(index), &mut bytes).expect("in order");
            if index % 1000 == 500 {
                let time = event(index).time;
                let frame = Frame {
                    shutter: Shutter::Global,
                    start: time,
                    end: time + 20,
                    exposure_start: Some(time + 5),
                    exposure_end: Some(time + 10),
                    exposure_cycles: 5,
                    region: Region { x: 1, y: 2, width: 2, height: 2 },
                    damaged_columns: 0,
                    pixels: &[1, 2, 3, 4],
                };
                encoder.frame(&frame, &mut bytes).expect("in order");
                let sample = ImuSample {
                    time: time + 21,
                    acceleration: Some([1, 2, 3]),
                    angular_velocity: None,
                    temperature: None,
                    scale: ImuScale { accelerometer: 0, gyroscope: 0 },
                    model: ImuModel::Mpu9250,
                };
                encoder.imu(&sample, &mut bytes).expect("in order");
                let signal = SignalEvent { time: time + 22, signal: Signal::ExternalInputPulse };
                encoder.signal(&signal, &mut bytes).expect("in order");
            }
        }
        bytes
    }

    /// Returns the events and the numbers of frames, samples and signals, and asserts that there is no fault.
    fn decode(bytes: &[u8]) -> (Vec<PolarityEvent>, [u64; 3]) {
        let mut decoder = Decoder::with_frames(Layout::DAVIS346, vec![0; 346 * 260]);
        let mut events = Vec::new();
        decoder.decode(bytes, |message| {
            if let Message::Events(new) = message {
                events.extend_from_slice(new);
            }
        });
        let counts = decoder.counts();
        assert_eq!(counts.anomalies.total(), 0, "{counts:?}");
        (events, [counts.frames, counts.imu_samples, counts.signals])
    }

    fn pass(bytes: &[u8], piece: usize, gate: impl Fn(usize, usize) -> Gate) -> (Vec<u8>, Drops) {
        let (mut multiplexer, mut out, mut drops) = (Multiplexer::default(), Vec::new(), Drops::default());
        for (index, piece) in bytes.chunks(piece).enumerate() {
            let gate = gate(index, out.len());
            let new = multiplexer.take(piece, gate, &mut out);
            (drops.events, drops.signals) = (drops.events + new.events, drops.signals + new.signals);
        }
        out.extend(multiplexer.finish());
        (out, drops)
    }

    #[test]
    fn bytes_that_pass_are_unchanged() {
        let noise: Vec<u8> = (0..9999u64).map(|at| (at.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8).collect();
        for bytes in [stream(), noise] {
            for piece in [1, 7, 512] {
                assert_eq!(pass(&bytes, piece, |_, _| Gate::without_limit(Streams::ALL)).0, bytes);
            }
        }
    }

    #[test]
    fn modules_that_do_not_run_send_nothing() {
        let all: Vec<PolarityEvent> = (0..10_000).map(event).collect();
        let none = Streams { events: false, frames: false, imu: false, signals: false };
        for (streams, others) in [
            (Streams { events: true, ..none }, [0, 0, 0]),
            (Streams { events: true, imu: true, ..none }, [0, 10, 0]),
            (Streams { frames: true, signals: true, ..none }, [10, 0, 10]),
        ] {
            let (bytes, drops) = pass(&stream(), 7, |_, _| Gate::without_limit(streams));
            let (events, found) = decode(&bytes);
            assert_eq!((found, drops), (others, Drops::default()));
            assert_eq!(events, if streams.events { all.clone() } else { Vec::new() });
        }
        // If frames are switched on during a frame, that frame is not sent, the next one is.
        let frames = |on| Gate::without_limit(Streams { frames: on, ..Streams::ALL });
        let start = stream().windows(2).position(|word| word == [11, 0]).expect("a column");
        let (bytes, _) = pass(&stream(), start + 1, |index, _| frames(index > 0));
        assert_eq!(decode(&bytes), (all, [9, 10, 10]));
    }

    #[test]
    fn events_without_buffer_space_are_counted_and_the_rest_is_correct() {
        let limited = |_, length: usize| Gate {
            streams: Streams::ALL,
            // Room for a part of each piece.
            room: length + 60,
            drop_events: true,
            drop_signals: true,
        };
        let (bytes, drops) = pass(&stream(), 200, limited);
        let (events, [frames, samples, signals]) = decode(&bytes);
        assert!(drops.events > 1000 && events.len() > 1000);
        assert_eq!(events.len() as u64 + drops.events, 10_000);
        assert_eq!((frames, samples, signals + drops.signals), (10, 10, 10));
        let all: Vec<PolarityEvent> = (0..10_000).map(event).collect();
        assert!(events.iter().all(|event| all.contains(event)) && events.is_sorted_by_key(|event| event.time));
        let waiting = |index, length| Gate { drop_events: false, drop_signals: false, ..limited(index, length) };
        assert_eq!(pass(&stream(), 200, waiting).0, stream());
    }

    #[test]
    fn time_restarts_at_zero() {
        let (bytes, mut multiplexer, mut out) = (stream(), Multiplexer::default(), Vec::new());
        let (before, after) = bytes.split_at(30_000);
        multiplexer.take(before, Gate::without_limit(Streams::ALL), &mut out);
        let first = decode(&out).0.len();
        let mut decoder = Decoder::new(Layout::DAVIS346);
        decoder.decode(&out, |_| {});
        let zero = decoder.time();
        multiplexer.restart_time(&mut out);
        multiplexer.take(after, Gate::without_limit(Streams::ALL), &mut out);
        let (events, _) = decode(&out);
        for (index, received) in (0..).zip(events) {
            let expected = event(index);
            let time = if index < first as u64 { expected.time } else { expected.time - zero };
            assert_eq!(received, PolarityEvent { time, ..expected }, "{index}");
        }
    }
}
