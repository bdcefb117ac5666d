//! Whether a sensor that was asked for is that of the recording.

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::likely_sensor::likely_sensor_of;
use crate::options::RecordingOptions;
use crate::read_report::ReadReport;
use crate::recording::Recording;

/// Share of events that may lie outside of a sensor that was asked for.
const FEW_OUTSIDE: f64 = 0.01;

/// A sensor that was asked for is not that of the recording.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OtherSensor {
    /// Many events are beyond it.
    #[error(
        "{file}: {outside} of {total} events lie outside the {sensor} pixels that were asked for{}",
        own.map_or_else(String::new, |own| format!("; the file says {own}"))
    )]
    TooSmall {
        /// The file.
        file: String,
        /// Events outside.
        outside: u64,
        /// All events.
        total: u64,
        /// The sensor asked for.
        sensor: Sensor,
        /// What the file says.
        own: Option<Sensor>,
    },
    /// Its rows are the columns of the recording, or the recording has them the wrong way round.
    #[error(
        "{file}: {outside} of {total} events lie outside the {sensor} pixels, but none would with x and y exchanged"
    )]
    Exchanged {
        /// The file.
        file: String,
        /// Events outside.
        outside: u64,
        /// All events.
        total: u64,
        /// The sensor.
        sensor: Sensor,
        /// Where they are exchanged.
        exchanged: Exchanged,
    },
    /// Its pixels are counted from 1.
    #[error(
        "{file}: no event lies in column 0 or row 0 of the {sensor} pixels, and some lie in column {} and row {}. Pixels are counted from 1, where they should be counted from 0",
        .sensor.width, .sensor.height
    )]
    CountedFromOne {
        /// The file.
        file: String,
        /// The sensor.
        sensor: Sensor,
    },
    /// Columns and rows that are no pixels.
    #[error("{file}: {count} of {total} events have a column or row below 0 or beyond 32766")]
    NoPixels {
        /// The file.
        file: String,
        /// Events with such ones.
        count: u64,
        /// All events.
        total: u64,
    },
    /// It has pixels that the sensor of the file does not have.
    #[error("{file} is of a sensor of {own} pixels, but {sensor} was asked for")]
    TooLarge {
        /// The file.
        file: String,
        /// The sensor asked for.
        sensor: Sensor,
        /// What the file says.
        own: Sensor,
    },
}

/// Where x and y are exchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exchanged {
    /// In the size of the sensor that was asked for.
    InTheSizeAskedFor,
    /// In the size of the sensor that the file states.
    InTheSizeOfTheFile,
    /// In the order of the columns of a table, as far as it was recognised or asked for.
    InTheColumns,
    /// In the file: the program that wrote it exchanged them.
    InTheFile,
}

/// Whether a sensor is higher than wide, which none is.
fn stands(sensor: Sensor) -> bool {
    sensor.height > sensor.width
}

fn turned(sensor: Sensor) -> Sensor {
    Sensor::new(sensor.height, sensor.width)
}

/// Whether the file says nothing against the sensor that was asked for. No event is read.
///
/// # Errors
/// [`OtherSensor::TooLarge`].
pub fn check_stated(recording: &Recording) -> Result<(), OtherSensor> {
    let Some(sensor) = recording.options().sensor else { return Ok(()) };
    match recording.own_sensor() {
        Some(own) if stands(own) && sensor == turned(own) => Ok(()),
        Some(own) if sensor.width > own.width || sensor.height > own.height => {
            Err(OtherSensor::TooLarge { file: recording.path().display().to_string(), sensor, own })
        }
        _ => Ok(()),
    }
}

/// Whether the sensor has the pixels of the events, which were read with this `report`.
///
/// # Errors
/// [`OtherSensor`], where many lie outside of it.
pub fn check_outside(recording: &Recording, report: &ReadReport) -> Result<(), OtherSensor> {
    let outside = report.out_of_range;
    if outside > 0
        && let Some(sensor) = counted_from_one(recording)
    {
        return Err(OtherSensor::CountedFromOne { file: recording.path().display().to_string(), sensor });
    }
    let total = report.events + outside;
    let is_many = |count: u64| count as f64 > FEW_OUTSIDE * total as f64;
    if !is_many(outside) {
        return Ok(());
    }
    let file = recording.path().display().to_string();
    let (asked, own) = (recording.options().sensor, recording.own_sensor());
    let has_columns = recording.format().uses.columns;
    match asked.or(own) {
        Some(sensor) if report.looks_exchanged() => {
            let exchanged = match asked {
                Some(asked) if stands(asked) => Exchanged::InTheSizeAskedFor,
                None if stands(sensor) => Exchanged::InTheSizeOfTheFile,
                _ if has_columns => Exchanged::InTheColumns,
                _ => Exchanged::InTheFile,
            };
            Err(OtherSensor::Exchanged { file, outside, total, sensor, exchanged })
        }
        _ if has_columns && is_many(report.no_pixel) => {
            Err(OtherSensor::NoPixels { file, count: report.no_pixel, total })
        }
        Some(sensor) if asked.is_some() => Err(OtherSensor::TooSmall { file, outside, total, sensor, own }),
        _ => Ok(()),
    }
}

/// The sensor of a recording whose pixels are counted from 1, as MATLAB counts: column 0 and row 0 send nothing, and the last
/// events lie one column and one row behind the sensor that was asked for, that of the file, or a usual one. Reads the
/// recording up to the first event that tells otherwise.
pub fn counted_from_one(recording: &Recording) -> Option<Sensor> {
    let known = recording.options().sensor.or_else(|| recording.own_sensor());
    let larger = |sensor: Sensor| Sensor::new(sensor.width.saturating_add(1), sensor.height.saturating_add(1));
    // With the sensor as it is known the events in question are left out.
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

/// Whether it is the smallest usual sensor that has its last pixel.
fn is_usual(sensor: Sensor) -> bool {
    let (Some(x), Some(y)) = (sensor.width.checked_sub(1), sensor.height.checked_sub(1)) else { return false };
    let last = Event { t: 0, x, y, polarity: Polarity::On };
    likely_sensor_of(&Recording::from_events("", vec![last], RecordingOptions::default())) == Some(sensor)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is wrong with the sensor of these lines of text.
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
    fn exchanged_and_negative_coordinates_are_told_from_a_wrong_size() {
        let davis = Some(Sensor::new(346, 260));
        let turned = "t_us,x,y,p\n1,259,345,1\n2,3,300,0\n";
        let upright = "t_us,x,y,p\n1,345,259,1\n2,300,3,0\n";
        for (lines, sensor, expected) in [
            (turned, davis, Some(Exchanged::InTheColumns)),
            (&format!("346 260\n{turned}"), None, Some(Exchanged::InTheColumns)),
            (&format!("260 346\n{upright}"), None, Some(Exchanged::InTheSizeOfTheFile)),
            (&format!("260 346\n{upright}"), davis, None),
            (upright, Some(Sensor::new(260, 346)), Some(Exchanged::InTheSizeAskedFor)),
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

    /// The size that the advice named was refused.
    #[test]
    fn a_size_of_the_file_that_stands_may_be_turned() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        let fits = |lines: &str, sensor: Sensor| {
            std::fs::write(&path, lines).unwrap();
            let options = RecordingOptions { sensor: Some(sensor), ..RecordingOptions::default() };
            check_stated(&Recording::new(&path, options).unwrap()).is_ok()
        };
        let standing = "260 346\n1 2 3 1\n";
        assert!(fits(standing, Sensor::new(346, 260)) && fits(standing, Sensor::new(260, 346)));
        assert!(!fits(standing, Sensor::new(640, 480)));
        assert!(!fits("346 260\n1 2 3 1\n", Sensor::new(260, 346)));
    }

    /// MATLAB counts from 1: such recordings were calibrated as good, with cx and cy off by 1 px, for the last column and row are
    /// less than a hundredth of the events.
    #[test]
    fn pixels_counted_from_one_are_told() {
        let davis = Sensor::new(346, 260);
        let all = |range: std::ops::RangeInclusive<u16>| -> String {
            let lines = range.map(|at| format!("{at},{at},{},1\n", if at == 346 { 260 } else { at.min(259) }));
            format!("t_us,x,y,p\n{}", lines.collect::<String>())
        };
        let told = wrong(&all(1..=346), Some(davis)).unwrap().to_string();
        assert!(told.contains("in column 346 and row 260. Pixels are counted from 1"), "{told}");
        // One event in column 0, or behind column 346, tells otherwise.
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
