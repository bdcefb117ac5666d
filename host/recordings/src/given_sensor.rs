//! Checks that the requested sensor size fits the events of a recording.

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use evcal_files::remedies;

use super::likely_sensor::{likely_sensor_of, likely_words};
use crate::options::RecordingOptions;
use crate::read_report::ReadReport;
use crate::reader::MAX_SENSOR_SIZE;
use crate::recording::Recording;

/// Fraction of events that may lie outside the requested sensor.
const FEW_OUTSIDE: f64 = 0.01;

/// The requested sensor does not fit the recording.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OtherSensor {
    /// Many events lie outside it.
    #[error(
            "{file}: {outside} of {total} events lie outside the {sensor} pixels that were asked for{}",
            own.map_or_else(String::new, |own| format!("; the file states {own}"))
        )]
    TooSmall {
        /// Path of the file.
        file: String,
        /// Number of events outside the sensor.
        outside: u64,
        /// Number of all events.
        total: u64,
        /// Requested sensor.
        sensor: Sensor,
        /// Sensor stated in the file.
        own: Option<Sensor>,
    },
    /// Columns and rows are exchanged, in the requested size or in the recording.
    #[error(
        "{file}: {outside} of {total} events lie outside the {sensor} pixels, but none would with x and y exchanged"
    )]
    Exchanged {
        /// Path of the file.
        file: String,
        /// Number of events outside the sensor.
        outside: u64,
        /// Number of all events.
        total: u64,
        /// Requested sensor.
        sensor: Sensor,
        /// Part of the input in which x and y are exchanged.
        exchanged: Exchanged,
    },
    /// Pixels are counted from 1 instead of 0.
    #[error(
            "{file}: no event lies in column 0 or row 0 of the {sensor} pixels, and some lie in column {} and row {}. Pixels are counted from 1 instead of 0",
        .sensor.width, .sensor.height
    )]
    CountedFromOne {
        /// Path of the file.
        file: String,
        /// Sensor that fits once pixels are counted from 0.
        sensor: Sensor,
    },
    /// Many events have a column or row that no sensor has.
    #[error("{file}: {count} of {total} events have a column or row below 0 or beyond 32766")]
    NoPixels {
        /// Path of the file.
        file: String,
        /// Number of events with such a column or row.
        count: u64,
        /// Number of all events.
        total: u64,
    },
    /// Many events lie outside the sensor that the file states.
    #[error("{file} states a sensor of {own} pixels, but {outside} of its {total} events lie outside{}", likely_words(*likely))]
    StatedTooSmall {
        /// Path of the file.
        file: String,
        /// Number of events outside the sensor.
        outside: u64,
        /// Number of all events.
        total: u64,
        /// Sensor stated in the file.
        own: Sensor,
        /// Smallest common sensor that has all events.
        likely: Option<Sensor>,
    },
    /// The requested sensor is larger than the sensor stated in the file.
    #[error("{file} is of a sensor of {own} pixels, but {sensor} was asked for")]
    TooLarge {
        /// Path of the file.
        file: String,
        /// Requested sensor.
        sensor: Sensor,
        /// Sensor stated in the file.
        own: Sensor,
    },
}

remedies! { OtherSensor, say;
    Self::TooSmall { own: Some(_), .. } | Self::TooLarge { .. } => "leave out {}", say.sensor;
    Self::Exchanged { exchanged: Exchanged::RequestedSize, sensor, .. } => "write {}", say.size(sensor.height, sensor.width);
    Self::Exchanged { exchanged: Exchanged::FileSize, sensor, .. } =>
        "the size in the file has them swapped; write {}", say.size(sensor.height, sensor.width);
    Self::Exchanged { exchanged: Exchanged::Columns, .. } =>
        "give the order of the columns with {}, such as t,y,x,p", say.columns;
    Self::Exchanged { exchanged: Exchanged::File, .. } =>
        "the program that wrote the file swapped them; write the file again";
    Self::StatedTooSmall { likely: Some(likely), .. } => "give the true size: {}", say.size(likely.width, likely.height);
    Self::CountedFromOne { .. } => "subtract 1 from x and y";
    Self::NoPixels { .. } => "give the columns of x and y with {}", say.columns;
    _ => "give the true size with {}", say.sensor;
}

/// Part of the input in which x and y are exchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exchanged {
    /// The requested sensor size.
    RequestedSize,
    /// The sensor size that the file states.
    FileSize,
    /// The order of the columns of a table, detected or requested.
    Columns,
    /// The file: the program that wrote it exchanged x and y.
    File,
}

/// `true` if the sensor is higher than wide, which is not the case for real sensors.
fn is_portrait(sensor: Sensor) -> bool {
    sensor.height > sensor.width
}

fn turned(sensor: Sensor) -> Sensor {
    Sensor::new(sensor.height, sensor.width)
}

/// `true` if so many of `total` events do not fit the sensor that its size is wrong.
fn is_many(count: u64, total: u64) -> bool {
    count as f64 > FEW_OUTSIDE * total as f64
}

/// Checks the requested sensor against the size stated in the file. Reads the events only if the requested one is larger.
///
/// # Errors
/// [`OtherSensor::TooLarge`], unless many events lie outside the sensor that the file states.
pub fn check_stated(recording: &Recording) -> Result<(), OtherSensor> {
    let Some(sensor) = recording.options().sensor else { return Ok(()) };
    match recording.own_sensor() {
        Some(own) if is_portrait(own) && sensor == turned(own) => Ok(()),
        Some(own) if (sensor.width > own.width || sensor.height > own.height) && has_most(recording, own) => {
            Err(OtherSensor::TooLarge { file: recording.path().display().to_string(), sensor, own })
        }
        _ => Ok(()),
    }
}

/// `true` if `sensor` has most events of `recording`, or if they cannot be read.
fn has_most(recording: &Recording, sensor: Sensor) -> bool {
    let options = RecordingOptions { sensor: Some(sensor), ..recording.options().clone() };
    let Ok(mut reader) = recording.with_options(options).open() else { return true };
    let mut events = Vec::new();
    while reader.next_batch(&mut events).is_ok_and(|more| more) {}
    let report = reader.report();
    !is_many(report.out_of_range, report.events + report.out_of_range)
}

/// Returns the smallest common sensor that has all events of `recording`, whatever sensor is stated.
fn likely_for_all(recording: &Recording) -> Option<Sensor> {
    let sensor = Some(Sensor::new(MAX_SENSOR_SIZE, MAX_SENSOR_SIZE));
    likely_sensor_of(&recording.with_options(RecordingOptions { sensor, ..recording.options().clone() }))
}

/// Checks that the events, which were read with this `report`, fit the sensor.
///
/// # Errors
/// [`OtherSensor`] if many lie outside it, or if pixels are counted from 1.
pub fn check_outside(recording: &Recording, report: &ReadReport) -> Result<(), OtherSensor> {
    let outside = report.out_of_range;
    if outside > 0
        && let Some(sensor) = counted_from_one(recording)
    {
        return Err(OtherSensor::CountedFromOne { file: recording.path().display().to_string(), sensor });
    }
    let total = report.events + outside;
    if !is_many(outside, total) {
        return Ok(());
    }
    let file = recording.path().display().to_string();
    let (asked, own) = (recording.options().sensor, recording.own_sensor());
    let has_columns = recording.format().uses.columns;
    match asked.or(own) {
        Some(sensor) if report.are_coordinates_exchanged() => {
            let exchanged = match asked {
                Some(asked) if is_portrait(asked) => Exchanged::RequestedSize,
                None if is_portrait(sensor) => Exchanged::FileSize,
                _ if has_columns => Exchanged::Columns,
                _ => Exchanged::File,
            };
            Err(OtherSensor::Exchanged { file, outside, total, sensor, exchanged })
        }
        _ if has_columns && is_many(report.no_pixel, total) => {
            Err(OtherSensor::NoPixels { file, count: report.no_pixel, total })
        }
        Some(sensor) if asked.is_some() => Err(OtherSensor::TooSmall { file, outside, total, sensor, own }),
        Some(own) => Err(OtherSensor::StatedTooSmall { file, outside, total, own, likely: likely_for_all(recording) }),
        None => Ok(()),
    }
}

/// Returns the sensor of a recording whose pixels are counted from 1, as in MATLAB: there are no events in column 0 and
/// row 0, and the last events lie one column and one row outside the sensor (the requested one, the file's own, or a
/// usual one). `None` otherwise; reading then stops at the first event that contradicts it.
pub fn counted_from_one(recording: &Recording) -> Option<Sensor> {
    let known = recording.options().sensor.or_else(|| recording.own_sensor());
    let larger = |sensor: Sensor| Sensor::new(sensor.width.saturating_add(1), sensor.height.saturating_add(1));
    // The reader would drop the events in question with the known sensor, so it gets a larger one.
    let options = RecordingOptions { sensor: known.map(larger), ..recording.options().clone() };
    let mut reader = recording.with_options(options).open().ok()?;
    let (mut column, mut row, mut events) = (0, 0, Vec::new());
    while reader.next_batch(&mut events).ok()? {
        for event in &events {
            if event.x == 0 || event.y == 0 {
                return None;
            }
            (column, row) = (event.x.max(column), event.y.max(row));
        }
        if reader.report().out_of_range > 0 {
            return None;
        }
    }
    let sensor = Sensor::new(column, row);
    known.map_or_else(|| is_usual(sensor), |known| known == sensor).then_some(sensor)
}

/// `true` if `sensor` has a common size: an event in its last pixel suggests exactly this sensor.
fn is_usual(sensor: Sensor) -> bool {
    let (Some(x), Some(y)) = (sensor.width.checked_sub(1), sensor.height.checked_sub(1)) else { return false };
    let last = Event { t: 0, x, y, polarity: Polarity::On };
    likely_sensor_of(&Recording::from_events("", vec![last], RecordingOptions::default())) == Some(sensor)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the fault of the sensor for these lines of text.
    fn wrong(lines: &str, sensor: Option<Sensor>) -> Option<OtherSensor> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        std::fs::write(&path, lines).unwrap();
        let recording = Recording::new(&path, RecordingOptions { sensor, ..RecordingOptions::default() }).unwrap();
        let (mut reader, mut batch) = (recording.open().unwrap(), Vec::new());
        while reader.next_batch(&mut batch).unwrap() {}
        check_outside(&recording, reader.report()).err()
    }

    #[test]
    fn exchanged_and_negative_coordinates_are_distinguished_from_a_wrong_size() {
        let davis = Some(Sensor::new(346, 260));
        let turned = "t_us,x,y,p\n1,259,345,1\n2,3,300,0\n";
        let upright = "t_us,x,y,p\n1,345,259,1\n2,300,3,0\n";
        for (lines, sensor, expected) in [
            (turned, davis, Some(Exchanged::Columns)),
            (&format!("346 260\n{turned}"), None, Some(Exchanged::Columns)),
            (&format!("260 346\n{upright}"), None, Some(Exchanged::FileSize)),
            (&format!("260 346\n{upright}"), davis, None),
            (upright, Some(Sensor::new(260, 346)), Some(Exchanged::RequestedSize)),
            (upright, davis, None),
        ] {
            match (wrong(lines, sensor), expected) {
                (Some(OtherSensor::Exchanged { outside: 2, total: 2, exchanged, .. }), Some(expected)) => {
                    assert_eq!(exchanged, expected, "{lines}");
                }
                (found, expected) => assert!(found.is_none() && expected.is_none(), "{lines}: {found:?}"),
            }
        }
        let small = wrong(upright, Some(Sensor::new(240, 180)));
        assert!(matches!(small, Some(OtherSensor::TooSmall { outside: 2, total: 2, own: None, .. })), "{small:?}");
        let negative = wrong("t_us,x,y,p\n1,-3,5,1\n2,3,3,0\n", davis);
        assert!(matches!(negative, Some(OtherSensor::NoPixels { count: 1, total: 2, .. })), "{negative:?}");
    }

    /// The size that the advice names must be accepted, although the file states a smaller one.
    #[test]
    fn a_size_in_the_file_that_its_events_exceed_is_named() {
        let lines = "240 180\n1 345 259 1\n2 3 4 0\n";
        let likely = Some(Sensor::new(346, 260));
        let found = wrong(lines, None);
        let Some(OtherSensor::StatedTooSmall { outside: 1, total: 2, likely: named, .. }) = found else {
            panic!("{found:?}")
        };
        assert_eq!(named, likely);
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        std::fs::write(&path, lines).unwrap();
        let recording = Recording::new(&path, RecordingOptions { sensor: likely, ..Default::default() }).unwrap();
        assert_eq!((check_stated(&recording), wrong(lines, likely)), (Ok(()), None));
    }

    /// The size that the advice names must be accepted.
    #[test]
    fn a_portrait_size_in_the_file_may_be_turned() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        let fits = |lines: &str, sensor: Sensor| {
            std::fs::write(&path, lines).unwrap();
            let options = RecordingOptions { sensor: Some(sensor), ..RecordingOptions::default() };
            check_stated(&Recording::new(&path, options).unwrap()).is_ok()
        };
        let portrait = "260 346\n1 2 3 1\n";
        assert!(fits(portrait, Sensor::new(346, 260)) && fits(portrait, Sensor::new(260, 346)));
        assert!(!fits(portrait, Sensor::new(640, 480)));
        assert!(!fits("346 260\n1 2 3 1\n", Sensor::new(260, 346)));
    }

    /// MATLAB counts from 1. Without this check cx and cy would be off by 1 px and nothing would show it, because the
    /// last column and row have less than a hundredth of the events.
    #[test]
    fn pixels_counted_from_one_are_detected() {
        let davis = Sensor::new(346, 260);
        let all = |range: std::ops::RangeInclusive<u16>| -> String {
            let lines = range.map(|at| format!("{at},{at},{},1\n", if at == 346 { 260 } else { at.min(259) }));
            format!("t_us,x,y,p\n{}", lines.collect::<String>())
        };
        let message = wrong(&all(1..=346), Some(davis)).unwrap().to_string();
        assert!(message.contains("in column 346 and row 260. Pixels are counted from 1"), "{message}");
        // One event in column 0, or beyond column 346, refutes it.
        for lines in [all(0..=346), all(1..=347)] {
            assert_eq!(wrong(&lines, Some(davis)), None);
        }
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        let found = |lines: &str, sensor: Option<Sensor>| {
            std::fs::write(&path, lines).unwrap();
            let options = RecordingOptions { sensor, ..RecordingOptions::default() };
            counted_from_one(&Recording::new(&path, options).unwrap())
        };
        assert_eq!(found(&all(1..=346), None), Some(davis));
        assert_eq!(found(&all(1..=345), None), None, "no camera has 345 columns");
        assert_eq!(found(&all(0..=346), None), None);
        assert_eq!(found(&all(1..=346), Some(Sensor::new(640, 480))), None, "nothing lies outside");
    }
}
