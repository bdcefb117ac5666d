//! Estimate of the sensor size of a recording that does not contain it.

use evcal_core::sensor::Sensor;

use crate::recording::Recording;

/// Sizes of common event cameras, smallest first.
const SENSORS: [Sensor; 7] = [
    Sensor::new(128, 128),
    Sensor::new(240, 180),
    Sensor::new(304, 240),
    Sensor::new(320, 320),
    Sensor::new(346, 260),
    Sensor::new(640, 480),
    Sensor::new(1280, 720),
];

/// Returns the smallest common sensor that contains all pixels of a recording; `None` if none is large enough, or if the
/// recording has no events.
pub fn likely_sensor_of(recording: &Recording) -> Option<Sensor> {
    let mut reader = recording.open().ok()?;
    let (mut largest, mut events) = (None, Vec::new());
    while reader.next_batch(&mut events).ok()? {
        for event in &events {
            let (x, y) = largest.unwrap_or_default();
            largest = Some((event.x.max(x), event.y.max(y)));
        }
    }
    let (column, row) = largest?;
    likely_sensor(column, row)
}

/// Returns the likely sensor as text that can be appended to a sentence about an unknown size.
pub fn likely_words(likely: Option<Sensor>) -> String {
    likely.map_or_else(String::new, |sensor| format!("; all events fit in {sensor}"))
}

/// Returns the smallest common sensor that has this column and row.
pub fn likely_sensor(column: u16, row: u16) -> Option<Sensor> {
    SENSORS.into_iter().find(|sensor| sensor.contains(column, row))
}
