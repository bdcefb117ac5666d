//! From bytes to messages.

use super::anomaly::{Anomaly, AnomalyCounts, AnomalyKind};
use super::frame::{FrameAssembly, Level};
use super::imu::ImuAssembly;
use super::layout::Layout;
use super::message::{Message, Polarity, PolarityEvent, Shutter, Signal, SignalEvent};
use super::word::{Special, Word};

/// No row is current.
const NO_ROW: u16 = u16::MAX;

/// What a decoder has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderCounts {
    /// Bytes taken in.
    pub bytes: u64,
    /// Pixel events handed over.
    pub events: u64,
    /// Signals handed over.
    pub signals: u64,
    /// Inertial samples handed over.
    pub imu_samples: u64,
    /// Frames handed over.
    pub frames: u64,
    /// Restarts of the camera's clock.
    pub timestamp_resets: u64,
    /// Words of a frame or inertial sample that was under way when the stream (or its continuation
    /// after a gap) began: no fault.
    pub skipped: u64,
    /// Faults, by kind.
    pub anomalies: AnomalyCounts,
}

/// An incremental decoder: give it the stream's bytes in pieces of any size.
///
/// `S` is the memory in which frames are put together, at least width × height numbers: an array,
/// a slice or a vector. With none of it (`[u16; 0]`, the default) frames are passed over.
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
///         if let Message::Polarity(event) = message {
///             events.push((event.time, event.x, event.y));
///         }
///     });
/// }
/// assert_eq!(events, [(5, 17, 200)]);
/// ```
#[derive(Clone, Debug)]
pub struct Decoder<S = [u16; 0]> {
    layout: Layout,
    /// Time at the latest wrap or reset, and the latest time, in µs.
    wrap: u64,
    time: u64,
    row: u16,
    /// First byte of a word whose second byte has not come yet.
    half: Option<u8>,
    /// Offset of the next whole word.
    offset: u64,
    frame: FrameAssembly<S>,
    imu: ImuAssembly,
    counts: DecoderCounts,
}

impl Decoder<[u16; 0]> {
    /// A decoder that passes over frames.
    pub fn new(layout: Layout) -> Self {
        Self::with_frames(layout, [])
    }
}

impl<S: AsRef<[u16]> + AsMut<[u16]>> Decoder<S> {
    /// A decoder that puts frames together in `memory`.
    pub fn with_frames(layout: Layout, memory: S) -> Self {
        Self {
            layout,
            wrap: 0,
            time: 0,
            row: NO_ROW,
            half: None,
            offset: 0,
            frame: FrameAssembly::new(layout.aps, memory),
            imu: ImuAssembly::default(),
            counts: DecoderCounts::default(),
        }
    }

    /// What was seen so far.
    pub fn counts(&self) -> DecoderCounts {
        DecoderCounts { bytes: self.offset + u64::from(self.half.is_some()), ..self.counts }
    }

    /// The latest time in µs.
    pub fn time(&self) -> u64 {
        self.time
    }

    /// What the decoder assumes of the camera.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Takes the next bytes of the stream and hands over what they complete, in order.
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

    /// Bytes were lost here: drops what is in progress and counts the loss.
    ///
    /// The time goes on from the latest one. Should a wrap word be among what was lost, all later
    /// times are too small by a multiple of 2^15 µs, which the stream itself cannot tell.
    pub fn gap(&mut self, mut sink: impl FnMut(Message<'_>)) {
        self.offset += u64::from(self.half.take().is_some());
        self.row = NO_ROW;
        self.frame.interrupt();
        self.imu.interrupt();
        self.anomaly(AnomalyKind::Gap, self.offset, 0, &mut sink);
    }

    fn words(&mut self, words: &[[u8; 2]], sink: &mut impl FnMut(Message<'_>)) {
        let array = self.layout.dvs;
        let end = self.offset + 2 * words.len() as u64;
        let mut rest = words;
        while let [first, after @ ..] = rest {
            let offset = end - 2 * rest.len() as u64;
            let word = u16::from_le_bytes(*first);
            rest = after;
            if word & 0x8000 != 0 {
                let time = self.wrap.saturating_add(u64::from(word & 0x7FFF));
                if time < self.time {
                    self.anomaly(AnomalyKind::TimeBackwards, offset, word, sink);
                }
                self.time = time;
                continue;
            }
            let data = word & 0x0FFF;
            match word >> 12 {
                1 if data < array.rows => self.row = data,
                code @ (2 | 3) if data < array.columns && self.row != NO_ROW => {
                    let (x, y) = array.swap(data, self.row);
                    let polarity = if code == 3 { Polarity::On } else { Polarity::Off };
                    self.counts.events += 1;
                    sink(Message::Polarity(PolarityEvent { time: self.time, x, y, polarity }));
                }
                4 if data < 0x0400 => {
                    let more = after.iter().take_while(|word| word[1] & 0xFC == 0x40).count();
                    let run = words.len() - after.len() - 1;
                    rest = after.get(more..).unwrap_or(&[]);
                    let samples = words.get(run..=run + more).unwrap_or(&[]);
                    self.samples(samples, offset, sink);
                }
                _ => self.other(word, offset, sink),
            }
        }
        self.offset = end;
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

    /// All words that are neither timestamps, nor good addresses, nor samples.
    #[inline(never)]
    fn other(&mut self, word: u16, offset: u64, sink: &mut impl FnMut(Message<'_>)) {
        let time = self.time;
        let result = match Word::parse(word) {
            Word::Timestamp(_) | Word::Sample(_) => Ok(()),
            Word::Row(_) => {
                self.row = NO_ROW;
                Err(AnomalyKind::RowOutOfRange)
            }
            Word::Column(column, _) => Err(match column < self.layout.dvs.columns {
                true => AnomalyKind::ColumnWithoutRow,
                false => AnomalyKind::ColumnOutOfRange,
            }),
            Word::Wrap(times) => {
                self.wrap = self.wrap.saturating_add(u64::from(times) << 15);
                self.time = self.time.max(self.wrap);
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
                (self.wrap, self.time) = (0, 0);
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
