//! Event Stream (`.es`), a format for events of DVS and ATIS cameras.
//!
//! The file begins with `Event Stream`, three bytes of version, a byte with the kind of events, and u16 width and
//! height of the sensor, little-endian. Rows count from below. Bytes follow; the first byte of an event contains the
//! time since the previous one:
//!
//! | kind | byte | meaning |
//! |---|---|---|
//! | 1, DVS | `dt << 1 \| on` | an event after dt ≤ 126 µs; u16 x, u16 y follow |
//! | | 0xFF | 127 µs pass |
//! | | 0xFE | no meaning |
//! | 2, ATIS | `dt << 2 \| on << 1 \| exposure` | an event after dt ≤ 62 µs, or a measurement of light; u16 x, u16 y follow |
//! | | 0xFD to 0xFF | 63, 126 or 189 µs pass |
//! | | 0xFC | no meaning |

use std::path::Path;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::bytes::ByteReader;
use crate::counted::counted;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, OpenResult, Uses};
use crate::options::RecordingOptions;
use crate::read_report::{ReadReport, Truncation};
use crate::reader::{Decode, Opened, RecordingInformation};
use crate::unsupported_format::UnsupportedFormat;

const MAGIC: &[u8] = b"Event Stream";
/// Number of bytes before the size of the sensor: the magic, the version, and the kind.
const HEAD: usize = MAGIC.len() + 4;
/// Number of bytes that are decoded at a time.
const BLOCK: u64 = 1 << 17;

/// Event Stream.
pub const FORMAT: FileFormat = FileFormat {
    uses: Uses { growth: true, ..Uses::NONE },
    ..FileFormat::of_events("Event Stream", |head| head.bytes.starts_with(MAGIC), open)
};

/// Kind of the events.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Dvs,
    Atis,
}

/// Meaning of a byte.
enum Step {
    /// This time passes, in microseconds.
    Later(i64),
    /// An event after this time in microseconds. Without polarity it is a measurement of light.
    Event(i64, Option<Polarity>),
}

impl Kind {
    fn step(self, byte: u8) -> Step {
        let on = |set: bool| if set { Polarity::On } else { Polarity::Off };
        match (self, byte) {
            (Self::Dvs, 0xff) => Step::Later(127),
            (Self::Dvs, 0xfe) => Step::Later(0),
            (Self::Dvs, byte) => Step::Event((byte >> 1).into(), Some(on(byte & 1 != 0))),
            (Self::Atis, 0xfc..) => Step::Later(i64::from(byte & 3) * 63),
            (Self::Atis, byte) => Step::Event((byte >> 2).into(), (byte & 1 == 0).then_some(on(byte & 2 != 0))),
        }
    }
}

struct Decoder {
    file: ByteReader,
    kind: Kind,
    height: u16,
    t: i64,
    /// Bytes that were read but not decoded.
    rest: Vec<u8>,
    block: Vec<u8>,
    measurements: u64,
}

fn open(path: &Path, options: &RecordingOptions) -> OpenResult {
    let mut file = ByteReader::following(path, options.growth.as_ref())?;
    let head = file.array::<HEAD>()?;
    let Some([.., major, _, _, kind]) = head else {
        return Err(file.damaged(0, "the header is incomplete"));
    };
    let unsupported = |format| RecordingError::new(path, RecordingErrorKind::Unsupported(format));
    if major != 2 {
        return Err(unsupported(UnsupportedFormat::EventStreamVersion));
    }
    let kind = match kind {
        1 => Kind::Dvs,
        2 => Kind::Atis,
        _ => return Err(unsupported(UnsupportedFormat::EventStreamKind)),
    };
    let Some([a, b, c, d]) = file.array()? else {
        return Err(file.damaged(HEAD as u64, "the header is incomplete"));
    };
    let sensor = Sensor::new(u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]));
    let information =
        RecordingInformation { format: FORMAT.name, sensor: Some(sensor), ..RecordingInformation::default() };
    let (rest, block) = (Vec::new(), Vec::new());
    // Rows count from below, and the header may state too few.
    let height = options.sensor.map_or(sensor.height, |requested| requested.height.max(sensor.height));
    Ok(Opened::new(information, Decoder { file, kind, height, t: 0, rest, block, measurements: 0 }))
}

impl Decoder {
    /// Appends the events at the front of `bytes`. Returns the number of bytes decoded.
    fn events(&mut self, bytes: &[u8], batch: &mut Vec<Event>) -> usize {
        let mut rest = bytes;
        while let Some((&byte, after)) = rest.split_first() {
            match self.kind.step(byte) {
                Step::Later(step) => {
                    self.t = self.t.saturating_add(step);
                    rest = after;
                }
                Step::Event(step, polarity) => {
                    let Some((&[a, b, c, d], after)) = after.split_first_chunk() else { break };
                    self.t = self.t.saturating_add(step);
                    rest = after;
                    let (x, y) = (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]));
                    // A row outside the sensor stays outside.
                    let y = self.height.checked_sub(1).and_then(|last| last.checked_sub(y)).unwrap_or(y);
                    match polarity {
                        Some(polarity) => batch.push(Event { t: self.t, x, y, polarity }),
                        None => self.measurements += 1,
                    }
                }
            }
        }
        bytes.len() - rest.len()
    }
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let mut block = std::mem::take(&mut self.block);
        let wanted = self.file.block(BLOCK);
        self.file.read(&mut block, wanted)?;
        let more = block.len() as u64 == wanted;
        let mut bytes = std::mem::take(&mut self.rest);
        bytes.extend_from_slice(&block);
        self.block = block;
        let used = self.events(&bytes, batch);
        bytes.drain(..used);
        self.rest = bytes;
        if self.measurements > 0 {
            report.other_packets.insert("measurements of light".to_owned(), self.measurements);
        }
        if !more && !self.rest.is_empty() {
            let byte = self.file.position() - self.rest.len() as u64;
            let lost = counted(self.rest.len() as u64, "byte of an event is left", "bytes of an event are left");
            report.truncated = Some(Truncation { byte, lost });
        }
        Ok(more)
    }

    fn done(&self) -> Option<f64> {
        Some(self.file.done())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn file(kind: u8, content: &[u8]) -> Vec<u8> {
        [MAGIC, &[2, 0, 0, kind], &[64, 1], &[240, 0], content].concat()
    }

    fn event(t: i64, x: u16, y: u16, polarity: Polarity) -> Event {
        Event { t, x, y, polarity }
    }

    #[test]
    fn events_of_a_dvs_are_decoded() {
        // ON at (319, 239 from below) after 3 µs; OFF at (0, 0 from below) after 127 + 127 + 126 µs; a row outside the
        // sensor.
        let content = [7, 63, 1, 239, 0, 0xff, 0xfe, 0xff, 252, 0, 0, 0, 0, 0, 5, 0, 240, 0];
        let outcome = testing::read(&file(1, &content));
        let expected = [event(3, 319, 0, Polarity::On), event(383, 0, 239, Polarity::Off)];
        assert_eq!((outcome.events.as_slice(), outcome.error), (expected.as_slice(), None));
        assert_eq!((outcome.report.out_of_range, outcome.report.truncated), (1, None));
        let information = outcome.information.unwrap();
        assert_eq!((information.format, information.sensor), ("Event Stream", Some(Sensor::new(320, 240))));
    }

    #[test]
    fn events_of_an_atis_are_decoded() {
        // 189 + 63 µs and a byte without meaning; ON after 62 µs; OFF after 1 µs; a measurement.
        let content = [0xff, 0xfd, 0xfc, 250, 1, 0, 0, 0, 4, 2, 0, 1, 0, 3, 2, 0, 1, 0];
        let outcome = testing::read(&file(2, &content));
        let expected = [event(314, 1, 239, Polarity::On), event(315, 2, 238, Polarity::Off)];
        assert_eq!((outcome.events.as_slice(), outcome.error), (expected.as_slice(), None));
        assert_eq!(outcome.report.other_packets["measurements of light"], 1);
    }

    #[test]
    fn events_across_read_blocks_are_complete() {
        let count = BLOCK as usize / 5 * 2 + 7;
        let content: Vec<u8> = (0..count).flat_map(|index| [3, (index % 251) as u8, 0, 0, 0]).collect();
        let outcome = testing::read(&file(1, &content));
        assert_eq!(outcome.events.len(), count);
        assert_eq!(outcome.events[count - 1], event(count as i64, (count - 1) as u16 % 251, 239, Polarity::On));
    }

    /// Rows of a file whose header states one pixel were "below 0 or beyond 32766", and could not be read with the true size either.
    #[test]
    fn a_sensor_that_is_stated_too_small_can_be_corrected() {
        let content = [MAGIC, &[2, 0, 0, 1, 1, 0, 1, 0, 7, 63, 1, 239, 0]].concat();
        let outcome = testing::read(&content);
        assert_eq!((outcome.events.len(), outcome.report.out_of_range, outcome.report.no_pixel), (0, 1, 0));
        let options = RecordingOptions { sensor: Some(Sensor::new(320, 240)), ..RecordingOptions::default() };
        assert_eq!(testing::read_with(&content, options).events, [event(3, 319, 0, Polarity::On)]);
    }

    #[test]
    fn other_kinds_and_versions_are_rejected() {
        for (content, part) in [
            (file(4, &[]), "DVS nor an ATIS"),
            ([MAGIC, &[1, 0, 0, 1, 64, 1, 240, 0]].concat(), "a version other than 2"),
            (file(1, &[])[..14].to_vec(), "header"),
        ] {
            let error = testing::read(&content).error.unwrap();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn damage_loses_as_little_as_possible() {
        let content: Vec<u8> = (0..30).flat_map(|index| [0xff, index * 2, index, 0, index, 0]).collect();
        testing::check_damage(&file(1, &content));
        testing::check_damage(&file(2, &content));
    }
}
