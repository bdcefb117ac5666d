//! Decodes bytes to messages.

use super::anomaly::{Anomaly, AnomalyCounts, AnomalyKind};
use super::frame::{FrameAssembly, Level};
use super::imu::ImuAssembly;
use super::layout::Layout;
use super::message::{Message, Polarity, PolarityEvent, Shutter, Signal, SignalEvent};
use super::word::{Special, Word};

/// Value of `row` while no row is current.
const NO_ROW: u16 = u16::MAX;
/// Largest number of events decoded before they are handed over.
const BLOCK: usize = 64;
const NO_EVENT: PolarityEvent = PolarityEvent { time: 0, x: 0, y: 0, polarity: Polarity::Off };

/// Numbers of items and faults that a decoder has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderCounts {
    /// Bytes decoded.
    pub bytes: u64,
    /// Pixel events returned.
    pub events: u64,
    /// Signals returned.
    pub signals: u64,
    /// IMU samples returned.
    pub imu_samples: u64,
    /// Frames returned.
    pub frames: u64,
    /// Restarts of the camera's clock.
    pub timestamp_resets: u64,
    /// Words of a frame or IMU sample that had already begun when the stream (or its continuation after a gap) began,
    /// and addresses after a gap whose time is unknown. These are not faults.
    pub skipped: u64,
    /// Faults, by kind.
    pub anomalies: AnomalyCounts,
}

/// An incremental decoder for pieces of the stream of any size.
///
/// `S` is the memory in which frames are assembled, at least width × height numbers: an array, a slice or a vector.
/// Without memory (`[u16; 0]`, the default) frames are skipped.
///
/// The decoder allocates nothing and never panics, whatever the bytes.
///
/// ```
/// use usb_davis::protocol::{Decoder, Layout, Message};
///
/// let mut decoder = Decoder::new(Layout::DAVIS346);
/// // µs 5, row 17, column 200 turned on: cut in the middle of a word.
/// let mut events = Vec::new();
/// for piece in [&[0x05, 0x80, 0x11][..], &[0x10, 0xC8, 0x30]] {
///     decoder.decode(piece, |message| {
///         if let Message::Events(new) = message {
///             events.extend(new.iter().map(|event| (event.time, event.x, event.y)));
///         }
///     });
/// }
/// assert_eq!(events, [(5, 17, 200)]);
/// ```
#[derive(Clone, Debug)]
pub struct Decoder<S = [u16; 0]> {
    layout: Layout,
    /// Time at the latest wrap or reset, a multiple of 2^15, in µs.
    wrap: u64,
    /// Latest time in µs.
    time: u64,
    row: u16,
    /// `true` after a gap: the time of an event is unknown until the next word that carries time.
    resuming: bool,
    /// First byte of a word whose second byte has not come yet.
    half: Option<u8>,
    /// Offset of the next whole word.
    offset: u64,
    frame: FrameAssembly<S>,
    imu: ImuAssembly,
    counts: DecoderCounts,
}

impl Decoder<[u16; 0]> {
    /// Creates a decoder that skips frames.
    pub fn new(layout: Layout) -> Self {
        Self::with_frames(layout, [])
    }
}

impl<S: AsRef<[u16]> + AsMut<[u16]>> Decoder<S> {
    /// Creates a decoder that assembles frames in `memory`.
    pub fn with_frames(layout: Layout, memory: S) -> Self {
        Self {
            layout,
            wrap: 0,
            time: 0,
            row: NO_ROW,
            resuming: false,
            half: None,
            offset: 0,
            frame: FrameAssembly::new(layout.aps, memory),
            imu: ImuAssembly::default(),
            counts: DecoderCounts::default(),
        }
    }

    /// Returns the counts so far.
    pub fn counts(&self) -> DecoderCounts {
        DecoderCounts { bytes: self.offset + u64::from(self.half.is_some()), ..self.counts }
    }

    /// Returns the latest time in µs.
    pub fn time(&self) -> u64 {
        self.time
    }

    /// Returns the layout of the camera that the decoder assumes.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Decodes the next bytes of the stream, and calls `sink` with the completed messages, in order.
    pub fn decode(&mut self, bytes: &[u8], mut sink: impl FnMut(Message<'_>)) {
        let bytes = match (self.half, bytes) {
            (Some(low), [high, rest @ ..]) => {
                self.half = None;
                self.words(&[[low, *high]], &mut sink);
                rest
            }
            _ => bytes,
        };
        let (words, odd) = bytes.as_chunks::<2>();
        self.words(words, &mut sink);
        if let [byte] = odd {
            self.half = Some(*byte);
        }
    }

    /// Marks that bytes were lost here: drops incomplete items, counts the loss, and resumes events at the next word
    /// that carries time.
    ///
    /// The time continues from the latest one. If a wrap word was lost, all later times are too small by a multiple of
    /// 2^15 µs, which the stream alone cannot determine; a caller who knows the number of lost wraps restores them by
    /// [`Decoder::restore_wraps`].
    pub fn gap(&mut self, mut sink: impl FnMut(Message<'_>)) {
        self.offset += u64::from(self.half.take().is_some());
        self.row = NO_ROW;
        self.resuming = true;
        self.frame.interrupt();
        self.imu.interrupt();
        self.anomaly(AnomalyKind::Gap, self.offset, 0, &mut sink);
    }

    /// Adds `count` × 2^15 µs for lost wrap words; call it right after [`Decoder::gap`]. [`crate::capture::GapRepair`]
    /// determines the count from the host clock.
    pub fn restore_wraps(&mut self, count: u64) {
        self.wrap = self.wrap.saturating_add(count.saturating_mul(1 << 15));
        self.time = self.time.max(self.wrap);
    }

    /// Returns the time at the latest wrap or reset in µs, to which the low 15 bits of a timestamp are added.
    pub fn wrap_time(&self) -> u64 {
        self.wrap
    }

    fn words(&mut self, words: &[[u8; 2]], sink: &mut impl FnMut(Message<'_>)) {
        let end = self.offset + 2 * words.len() as u64;
        let mut events = [NO_EVENT; BLOCK];
        let mut rest = words;
        loop {
            let (count, after) = self.events(rest, &mut events);
            rest = after;
            self.counts.events += count as u64;
            if let Some(events @ [_, ..]) = events.get(..count) {
                sink(Message::Events(events));
                continue;
            }
            let offset = end - 2 * rest.len() as u64;
            match rest {
                [] => break,
                [[_, 0x40..0x44], ..] => {
                    let run = rest.iter().take_while(|word| matches!(word[1], 0x40..0x44)).count();
                    let (samples, after) = rest.split_at_checked(run).unwrap_or((rest, &[]));
                    self.samples(samples, offset, sink);
                    rest = after;
                }
                [first, after @ ..] => {
                    self.other(u16::from_le_bytes(*first), offset, sink);
                    rest = after;
                }
            }
        }
        self.offset = end;
    }

    /// Decodes the words of pixel events at the beginning of `words`, at most a block of them, up to the first word
    /// that is something else or faulty. Returns the number of events and the remaining words; if there are no events,
    /// the first remaining word is such a word.
    ///
    /// The order of timestamp, row and column words cannot be predicted, so the code does not branch on it: every word
    /// writes an event, and only column words keep it.
    fn events<'w>(&mut self, words: &'w [[u8; 2]], events: &mut [PolarityEvent; BLOCK]) -> (usize, &'w [[u8; 2]]) {
        let array = self.layout.dvs;
        let columns = if self.row == NO_ROW { 0 } else { array.columns };
        // For each code, a limit of the data: a word at or above it is left to the caller. The limit is 0 for codes that
        // are not decoded here, and for every address and timestamp directly after a gap. Timestamps, whose bit 15 makes
        // them codes 8 to 15, otherwise have no limit.
        let (rows, any) = if self.resuming { (0, 0) } else { (array.rows, 0x1000) };
        let limits = [0, rows, columns, columns, 0, 0, 0, 0, any, any, any, any, any, any, any, any];
        let (wrap, mut time, mut row) = (self.wrap, self.time, self.row);
        let mut count = 0;
        let mut rest = words;
        while let [first, after @ ..] = rest {
            let word = u16::from_le_bytes(*first);
            let (code, data) = (word >> 12, word & 0x0FFF);
            let next = if word & 0x8000 != 0 { wrap | u64::from(word & 0x7FFF) } else { time };
            let limit = limits.get(usize::from(code)).copied().unwrap_or(0);
            if data >= limit || next < time {
                break;
            }
            time = next;
            row = if code == 1 { data } else { row };
            let (x, y) = array.swap(data, row);
            let polarity = if code & 1 == 1 { Polarity::On } else { Polarity::Off };
            let Some(place) = events.get_mut(count) else { break };
            *place = PolarityEvent { time, x, y, polarity };
            count += usize::from(code >> 1 == 1);
            rest = after;
        }
        (self.time, self.row) = (time, row);
        (count, rest)
    }

    #[cold]
    fn anomaly(&mut self, kind: AnomalyKind, offset: u64, word: u16, sink: &mut impl FnMut(Message<'_>)) {
        self.counts.anomalies.add(kind);
        sink(Message::Anomaly(Anomaly { kind, offset, word, time: self.time }));
    }

    fn samples(&mut self, words: &[[u8; 2]], offset: u64, sink: &mut impl FnMut(Message<'_>)) {
        if !self.frame.synchronised {
            self.counts.skipped += words.len() as u64;
        } else if let Err((kind, index)) = self.frame.samples(words) {
            let word = words.get(index).copied().map_or(0, u16::from_le_bytes);
            self.anomaly(kind, offset + 2 * index as u64, word, sink);
        }
    }

    /// Decodes all words that [`Decoder::events`] does not handle, except samples.
    #[inline(never)]
    fn other(&mut self, word: u16, offset: u64, sink: &mut impl FnMut(Message<'_>)) {
        let time = self.time;
        let result = match Word::parse(word) {
            Word::Row(_) | Word::Column(..) if self.resuming => {
                self.counts.skipped += 1;
                Ok(())
            }
            Word::Timestamp(low) => {
                self.resuming = false;
                self.time = self.wrap | u64::from(low);
                if self.time < time { Err(AnomalyKind::TimeBackwards) } else { Ok(()) }
            }
            Word::Row(row) => {
                let exists = row < self.layout.dvs.rows;
                self.row = if exists { row } else { NO_ROW };
                if exists { Ok(()) } else { Err(AnomalyKind::RowOutOfRange) }
            }
            Word::Column(column, polarity) => self.column(column, polarity, sink),
            Word::Sample(_) => Ok(()),
            Word::Wrap(times) => {
                self.wrap = self.wrap.wrapping_add(u64::from(times) << 15);
                self.time = self.time.max(self.wrap);
                self.resuming = false;
                Ok(())
            }
            Word::Unknown(_) => Err(AnomalyKind::UnknownWord),
            Word::ImuByte(_) | Word::ImuScale(_) | Word::Special(Special::ImuEnd) if !self.imu.synchronised => {
                self.counts.skipped += 1;
                Ok(())
            }
            Word::ImuByte(byte) => self.imu.byte(byte),
            Word::ImuScale(contents) => self.imu.scale(contents),
            Word::Special(Special::ImuStart) => self.imu.start(),
            Word::Special(Special::ImuEnd) => self.imu.end(time, &self.layout.imu).map(|sample| {
                self.counts.imu_samples += 1;
                sink(Message::Imu(sample));
            }),
            Word::Special(Special::TimestampReset) => {
                if self.frame.discard() {
                    self.anomaly(AnomalyKind::FrameAcrossReset, offset, word, sink);
                }
                (self.wrap, self.time, self.resuming) = (0, 0, false);
                self.counts.timestamp_resets += 1;
                sink(Message::TimestampReset { previous: time });
                Ok(())
            }
            Word::Special(Special::ExternalInputFalling) => self.signal(Signal::ExternalInputFalling, sink),
            Word::Special(Special::ExternalInputRising) => self.signal(Signal::ExternalInputRising, sink),
            Word::Special(Special::ExternalInputPulse) => self.signal(Signal::ExternalInputPulse, sink),
            Word::Special(Special::GeneratorFalling) => self.signal(Signal::GeneratorFalling, sink),
            Word::Special(Special::GeneratorRising) => self.signal(Signal::GeneratorRising, sink),
            frame_word => return self.frame_word(frame_word, word, offset, sink),
        };
        if let Err(kind) = result {
            self.anomaly(kind, offset, word, sink);
        }
    }

    /// Decodes the first column after a row without columns; other columns are handled by [`Decoder::events`].
    fn column(
        &mut self,
        column: u16,
        polarity: Polarity,
        sink: &mut impl FnMut(Message<'_>),
    ) -> Result<(), AnomalyKind> {
        if column >= self.layout.dvs.columns {
            return Err(AnomalyKind::ColumnOutOfRange);
        }
        if self.row == NO_ROW {
            return Err(AnomalyKind::ColumnWithoutRow);
        }
        let (x, y) = self.layout.dvs.swap(column, self.row);
        self.counts.events += 1;
        sink(Message::Events(&[PolarityEvent { time: self.time, x, y, polarity }]));
        Ok(())
    }

    fn signal(&mut self, signal: Signal, sink: &mut impl FnMut(Message<'_>)) -> Result<(), AnomalyKind> {
        self.counts.signals += 1;
        sink(Message::Signal(SignalEvent { time: self.time, signal }));
        Ok(())
    }

    fn frame_word(&mut self, meaning: Word, word: u16, offset: u64, sink: &mut impl FnMut(Message<'_>)) {
        let (counts, time) = (&mut self.counts, self.time);
        let starts =
            matches!(meaning, Word::Special(Special::FrameStartGlobalShutter | Special::FrameStartRollingShutter));
        if !starts && !self.frame.synchronised {
            counts.skipped += 1;
            return;
        }
        let mut report = |kind| {
            counts.anomalies.add(kind);
            sink(Message::Anomaly(Anomaly { kind, offset, word, time }));
        };
        let result = match meaning {
            Word::RegionHigh(byte) => self.frame.corner_byte(byte, false),
            Word::RegionLow(byte) => self.frame.corner_byte(byte, true),
            Word::Exposure(bits) => self.frame.exposure_bits(bits),
            Word::Special(Special::ExposureStart) => self.frame.exposure_start(time),
            Word::Special(Special::ExposureEnd) => self.frame.exposure_end(time),
            Word::Special(Special::FrameStartGlobalShutter) => {
                self.frame.start(Shutter::Global, time, &mut report);
                Ok(())
            }
            Word::Special(Special::FrameStartRollingShutter) => {
                self.frame.start(Shutter::Rolling, time, &mut report);
                Ok(())
            }
            Word::Special(Special::ResetColumnStart) => {
                self.frame.column_start(Level::Reset, &mut report);
                Ok(())
            }
            Word::Special(Special::SignalColumnStart) => {
                self.frame.column_start(Level::Signal, &mut report);
                Ok(())
            }
            Word::Special(Special::ColumnEnd) => {
                self.frame.column_end(&mut report);
                Ok(())
            }
            Word::Special(Special::FrameEnd) => {
                if let Some(frame) = self.frame.end(time, &mut report) {
                    self.counts.frames += 1;
                    sink(Message::Frame(frame));
                }
                return;
            }
            _ => Err(AnomalyKind::UnknownWord),
        };
        if let Err(kind) = result {
            report(kind);
        }
    }
}
