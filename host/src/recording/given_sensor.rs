//! Whether a sensor that was asked for is that of the recording.

use evcal_core::sensor::Sensor;

use super::Recording;

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

/// Whether a sensor that was asked for has the pixels of the events, of which `kept` lie in it and `outside` do not.
///
/// # Errors
/// [`OtherSensor::TooSmall`].
pub fn check_outside(recording: &Recording, kept: u64, outside: u64) -> Result<(), OtherSensor> {
    let total = kept + outside;
    match recording.options().sensor {
        Some(sensor) if outside as f64 > FEW_OUTSIDE * total as f64 => {
            let file = recording.path().display().to_string();
            Err(OtherSensor::TooSmall { file, outside, total, sensor, own: recording.own_sensor() })
        }
        _ => Ok(()),
    }
}
