//! Writer of RAW in EVT 3.0 and 4.0. In EVT 3.0, each event has a word with its column and polarity. Words for time and row precede it if
//! they differ from the previous event's. Vectors of events are not used. There is a time high every 4096 µs, as from a
//! camera.

use std::fs::File;
use std::io::{BufWriter, Write};

use evcal_core::decode::Evt4Encoder;
use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

use crate::encode::{Description, Encode, OutputFormat, PAUSE, Pauses, WriteError};

/// RAW in EVT 3.0.
pub const OUTPUT: OutputFormat = OutputFormat {
    title: Some("EVT 3.0"),
    ..OutputFormat::of_events("raw", &["raw"], |file, it| Ok(Box::new(Encoder::new(file, it)?)))
};

/// RAW in EVT 4.0.
pub const EVT4_OUTPUT: OutputFormat = OutputFormat {
    name: "evt4",
    title: Some("EVT 4.0"),
    extensions: &["evt4"],
    create: |file, description| {
        let output = header(file, description, "EVT 4.0", "4.0")?;
        Ok(Box::new(Evt4 {
            output,
            zero: description.zero,
            words: Evt4Encoder::new(),
            latest: 0,
            pauses: Pauses::default(),
        }))
    },
    ..OUTPUT
};

/// Longest time in µs without a time high of EVT 4.0.
const LONGEST_PAUSE: i64 = 500_000;

/// Largest number of characters of the camera name, because readers limit the length of header lines.
const LONGEST_NAME: usize = 200;

/// Columns and rows have 11 bits.
const SIDE: u16 = 1 << 11;
/// Time high has 12 bits, in units of 4096 µs.
const HIGH_SHIFT: u32 = 12;
const MASK: i64 = 0xfff;
/// In a pause, there is a time high for this number of steps (0.52 s).
const STEPS_IN_PAUSE: i64 = 128;
const ROW: u16 = 0;
const COLUMN: u16 = 0x2000;
const TIME_LOW: u16 = 0x6000;
const TIME_HIGH: u16 = 0x8000;

struct Encoder {
    output: BufWriter<File>,
    /// Time in µs that is zero in the words.
    zero: i64,
    /// Values of the latest words; `None` if the next event needs a new one.
    high: Option<i64>,
    low: Option<i64>,
    row: Option<u16>,
    pauses: Pauses,
}

/// Creates a file with the header of an encoding, such as `3.0`.
fn header(
    file: &mut dyn FnMut() -> std::io::Result<File>,
    Description { sensor, camera_name, .. }: &Description,
    format: &'static str,
    version: &str,
) -> Result<BufWriter<File>, WriteError> {
    let Sensor { width, height } = *sensor;
    if width > SIDE || height > SIDE {
        return Err(WriteError::Size { format, most: SIDE, sensor: *sensor });
    }
    let mut output = BufWriter::with_capacity(1 << 18, file()?);
    let number = version.trim_end_matches(".0");
    write!(
        output,
        "% evt {version}\n% format EVT{number};height={height};width={width}\n% geometry {width}x{height}\n"
    )?;
    let name = camera_name.chars().filter(|character| !character.is_control()).take(LONGEST_NAME);
    let name: String = name.collect();
    if !name.is_empty() {
        writeln!(output, "% serial_number {name}")?;
    }
    writeln!(output, "% end")?;
    Ok(output)
}

/// Says that times do not count from the zero of the recording.
fn lost(zero: i64) -> Vec<String> {
    (zero != 0).then(|| format!("times count from {zero} us")).into_iter().collect()
}

impl Encoder {
    fn new(file: &mut dyn FnMut() -> std::io::Result<File>, description: &Description) -> Result<Self, WriteError> {
        let output = header(file, description, "EVT 3.0", "3.0")?;
        Ok(Self { output, zero: description.zero, high: None, low: None, row: None, pauses: Pauses::default() })
    }

    fn word(&mut self, word: u16) -> Result<(), WriteError> {
        Ok(self.output.write_all(&word.to_le_bytes())?)
    }

    /// Writes the words that set the time to `t` µs after the zero.
    fn time(&mut self, t: i64) -> Result<(), WriteError> {
        let (high, low) = (t >> HIGH_SHIFT, t & MASK);
        if self.high != Some(high) {
            let before = self.high.unwrap_or(0) << HIGH_SHIFT;
            self.pauses.check(before.saturating_add(self.zero), t.saturating_add(self.zero))?;
            // Writes all time highs in between, as a camera does: some readers detect a wrap of the clock only from the
            // last one before it. In a pause, one per half second and that last one are enough.
            let is_pause = t.saturating_sub(before).unsigned_abs() > PAUSE;
            for step in self.high.map_or(0, |latest| latest + 1)..=high {
                if !is_pause || step % STEPS_IN_PAUSE == 0 || step & MASK == MASK || step == high {
                    self.word(TIME_HIGH | (step & MASK) as u16)?;
                }
            }
            (self.high, self.low) = (Some(high), None);
        }
        if self.low != Some(low) {
            self.word(TIME_LOW | low as u16)?;
            self.low = Some(low);
        }
        Ok(())
    }
}

impl Encode for Encoder {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        for event in events {
            self.time(event.t.saturating_sub(self.zero).max(0))?;
            if self.row != Some(event.y) {
                self.word(ROW | event.y)?;
                self.row = Some(event.y);
            }
            self.word(COLUMN | (event.polarity.index() as u16) << 11 | event.x)?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        Ok(self.output.flush()?)
    }

    fn lost(&self) -> Vec<String> {
        lost(self.zero)
    }
}

/// Encoder of EVT 4.0: a word per event, and a time high every 64 µs with events and at least every half second.
struct Evt4 {
    output: BufWriter<File>,
    zero: i64,
    words: Evt4Encoder,
    /// Latest time in µs after the zero.
    latest: i64,
    pauses: Pauses,
}

impl Encode for Evt4 {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        for event in events {
            let t = event.t.saturating_sub(self.zero).max(0);
            self.pauses.check(self.latest.saturating_add(self.zero), event.t)?;
            while t - self.latest > LONGEST_PAUSE {
                self.latest += LONGEST_PAUSE;
                if let Some(word) = self.words.time(self.latest) {
                    self.output.write_all(&word.to_le_bytes())?;
                }
            }
            self.latest = self.latest.max(t);
            // The size of the sensor was checked, and events outside it are left out.
            for word in self.words.encode(Event { t, ..*event }).unwrap_or_default() {
                self.output.write_all(&word.to_le_bytes())?;
            }
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        Ok(self.output.flush()?)
    }

    fn lost(&self) -> Vec<String> {
        lost(self.zero)
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;
    use crate::extras::OtherStreams;
    use crate::testing;

    fn written(events: &[Event], sensor: Sensor, zero: i64) -> Result<Vec<u8>, WriteError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        let description = Description { sensor, camera_name: "EVK4 7", others: OtherStreams::default(), zero };
        let mut encoder = (OUTPUT.create)(&mut || file.reopen(), &description)?;
        events.chunks(3).try_for_each(|part| encoder.write(part))?;
        encoder.finish()?;
        Ok(std::fs::read(file.path()).unwrap())
    }

    fn event(t: i64, x: u16, y: u16, polarity: Polarity) -> Event {
        Event { t, x, y, polarity }
    }

    /// With a pause of 20 s.
    #[test]
    fn evt4_is_read_back() {
        let events: Vec<Event> = (0..5000)
            .map(|index| {
                let polarity = if index % 3 == 0 { Polarity::On } else { Polarity::Off };
                event(40 * index + index / 2500 * 20_000_000, index as u16 % 346, index as u16 % 260, polarity)
            })
            .collect();
        let file = tempfile::NamedTempFile::new().unwrap();
        let (sensor, others) = (Sensor::new(346, 260), OtherStreams::default());
        let description = Description { sensor, camera_name: "", others, zero: 0 };
        let mut encoder = (EVT4_OUTPUT.create)(&mut || file.reopen(), &description).unwrap();
        encoder.write(&events).unwrap();
        encoder.finish().unwrap();
        let outcome = testing::read(&std::fs::read(file.path()).unwrap());
        assert!(outcome.events == events && outcome.report.stream.faults.is_empty());
        assert_eq!(outcome.information.unwrap().sensor, Some(sensor));
    }

    #[test]
    fn words_follow_the_format() {
        let events = [
            event(4097, 3, 2, Polarity::On),
            event(4097, 4, 2, Polarity::Off),
            event(4099, 4, 2, Polarity::Off),
            event(8192, 4, 719, Polarity::Off),
        ];
        let content = written(&events, Sensor::new(1280, 720), 0).unwrap();
        let header =
            b"% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% serial_number EVK4 7\n% end\n";
        let words =
            [0x8000_u16, 0x8001, 0x6001, 0x0002, 0x2803, 0x2004, 0x6003, 0x2004, 0x8002, 0x6000, 0x02cf, 0x2004];
        let words: Vec<u8> = words.into_iter().flat_map(u16::to_le_bytes).collect();
        assert_eq!(content, [header.as_slice(), &words].concat());
    }

    #[test]
    fn times_are_kept_over_pauses_longer_than_the_range_of_the_clock() {
        let times = [3_599_000_000_i64, 3_599_000_001, 3_599_999_999, 3_620_000_000, 3_700_123_456, 7_300_000_000];
        let events: Vec<Event> = times.into_iter().map(|t| event(t, 2047, 2047, Polarity::On)).collect();
        let outcome = testing::read(&written(&events, Sensor::new(2048, 2048), 0).unwrap());
        assert_eq!((outcome.events.as_slice(), outcome.error), (events.as_slice(), None));
        assert_eq!(outcome.report.stream.notes(), [""; 0]);
        let information = outcome.information.unwrap();
        assert_eq!(information.camera_name.as_deref(), Some("EVK4 7"));
        let shifted = testing::read(&written(&events, Sensor::new(2048, 2048), times[0]).unwrap());
        assert!(shifted.events.iter().zip(&events).all(|(found, event)| found.t == event.t - times[0]));
    }

    /// With a time high for every 4096 µs, each of these events would have 40 MB.
    #[test]
    fn long_pauses_take_few_words_and_have_a_limit() {
        let times: Vec<i64> = (0..20).map(|index| index * 82_800_000_000 + 7).collect();
        let events: Vec<Event> = times.iter().map(|&t| event(t, 5, 6, Polarity::On)).collect();
        let content = written(&events, Sensor::new(1280, 720), 0).unwrap();
        assert!(content.len() < 10_000_000, "{}", content.len());
        assert!(testing::read(&content).events == events);
        let times = (0..40).map(|index| index * 82_800_000_000);
        let events: Vec<Event> = times.map(|t| event(t, 5, 6, Polarity::On)).collect();
        let error = written(&events, Sensor::new(1280, 720), 0).unwrap_err();
        assert!(matches!(error, WriteError::Pauses { time: 2_649_600_000_000 }), "{error}");
    }

    /// With a word for every 4096 µs, such a file would have 830 GB.
    #[test]
    fn a_jump_of_years_is_rejected() {
        let at = |t| event(t, 3, 2, Polarity::On);
        let error = written(&[at(0), at(1_700_000_000_000_000)], Sensor::new(1280, 720), 0).unwrap_err().to_string();
        assert!(error.contains("1700000000000000 us") && error.contains("more than a day"), "{error}");
        let zero = 1_600_000_000_000_000;
        let error = written(&[at(zero + 8192), at(zero + 86_500_000_000)], Sensor::new(1280, 720), zero).unwrap_err();
        let WriteError::Jump { before, time } = error else { panic!("{error}") };
        assert_eq!((before, time), (zero + 8192, zero + 86_500_000_000));
    }

    #[test]
    fn a_sensor_too_large_for_the_words_is_rejected() {
        let error = written(&[], Sensor::new(2049, 10), 0).unwrap_err().to_string();
        assert!(error.contains("2048") && error.contains("2049"), "{error}");
    }
}
