//! Whether a sensor that was asked for is that of the recording.

use evcal_core::sensor::Sensor;

use super::{ReadReport, Recording};

/// Share of events that may lie outside of a sensor that was asked for.
const FEW_OUTSIDE: f64 = 0.01;

/// A sensor that was asked for is not that of the recording.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OtherSensor {
    /// Many events are beyond it.
    #[error(
        "{file}: {outside} of {total} events lie outside of {sensor} pixels, which --sensor asks for: {}",
        match .own { Some(own) => format!("leave it out, the file says {own}"), None => "give the true size".to_owned() }
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
        "{file}: {outside} of {total} events lie outside of {sensor} pixels, but none would with x and y exchanged: {advice}"
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
        /// What to do.
        advice: String,
    },
    /// Columns and rows that are no pixels.
    #[error(
        "{file}: {count} of {total} events have a column or row below 0 or beyond 32766: say which columns x and y are with --columns"
    )]
    NoPixels {
        /// The file.
        file: String,
        /// Events with such ones.
        count: u64,
        /// All events.
        total: u64,
    },
    /// It has pixels that the sensor of the file does not have.
    #[error("{file} is of a sensor of {own} pixels, and --sensor asks for {sensor}: leave it out")]
    TooLarge {
        /// The file.
        file: String,
        /// The sensor asked for.
        sensor: Sensor,
        /// What the file says.
        own: Sensor,
    },
}

/// Whether the file says nothing against the sensor that was asked for. No event is read.
///
/// # Errors
/// [`OtherSensor::TooLarge`].
pub fn check_stated(recording: &Recording) -> Result<(), OtherSensor> {
    let Some(sensor) = recording.options().sensor else { return Ok(()) };
    match recording.own_sensor() {
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
            let advice = match asked {
                Some(Sensor { width, height }) if height > width => format!("write --sensor {height}x{width}"),
                _ if has_columns => "say where x and y are with --columns, such as t,y,x,p".to_owned(),
                _ => "the program that wrote the file exchanged them; write it anew".to_owned(),
            };
            Err(OtherSensor::Exchanged { file, outside, total, sensor, advice })
        }
        _ if has_columns && is_many(report.no_pixel) => {
            Err(OtherSensor::NoPixels { file, count: report.no_pixel, total })
        }
        Some(sensor) if asked.is_some() => Err(OtherSensor::TooSmall { file, outside, total, sensor, own }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::RecordingOptions;

    /// What is wrong with the sensor of these lines of text.
    fn wrong(lines: &str, sensor: Option<Sensor>) -> Option<String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        std::fs::write(&path, lines).unwrap();
        let recording = Recording::new(&path, RecordingOptions { sensor, ..RecordingOptions::default() }).unwrap();
        let (mut reader, mut batch) = (recording.open().unwrap(), Vec::new());
        while reader.next_batch(&mut batch).unwrap() {}
        check_outside(&recording, reader.report()).err().map(|error| error.to_string())
    }

    #[test]
    fn exchanged_and_negative_coordinates_are_told_from_a_wrong_size() {
        let davis = Some(Sensor::new(346, 260));
        let turned = "t_us,x,y,p\n1,259,345,1\n2,3,300,0\n";
        let upright = "t_us,x,y,p\n1,345,259,1\n2,300,3,0\n";
        for (lines, sensor, part) in [
            (
                turned,
                davis,
                Some(
                    "2 of 2 events lie outside of 346 x 260 pixels, but none would with x and y exchanged: say where x and y are with --columns",
                ),
            ),
            (&format!("346 260\n{turned}"), None, Some("with x and y exchanged")),
            (upright, Some(Sensor::new(260, 346)), Some("write --sensor 346x260")),
            (upright, Some(Sensor::new(240, 180)), Some("give the true size")),
            ("t_us,x,y,p\n1,-3,5,1\n2,3,3,0\n", davis, Some("1 of 2 events have a column or row below 0")),
            (upright, davis, None),
        ] {
            let told = wrong(lines, sensor);
            match part {
                Some(part) => assert!(told.as_ref().is_some_and(|told| told.contains(part)), "{told:?}"),
                None => assert_eq!(told, None),
            }
        }
    }
}
