//! Estimate of the sensor size of a recording that does not contain it.

use evcal_core::sensor::Sensor;
use evcal_files::remedy::Words;

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
    likely.map_or_else(String::new, |sensor| format!("; its events suggest {sensor}"))
}

/// Returns the remedy for an unknown size, with the likely one.
pub fn add_sensor(likely: Option<Sensor>, say: &Words) -> String {
    let size = likely.map_or_else(|| say.size("WIDTH", "HEIGHT"), |sensor| say.size(sensor.width, sensor.height));
    format!("add {size}")
}

/// Returns the common sensor whose last row is `column` and whose last column is `row`, because x and y are then
/// probably exchanged. Otherwise returns the smallest common sensor that contains both.
pub fn likely_sensor(column: u16, row: u16) -> Option<Sensor> {
    let largest = |sensor: &Sensor| (sensor.width - 1, sensor.height - 1);
    let exchanged = SENSORS.into_iter().find(|sensor| largest(sensor) == (row, column));
    exchanged.or_else(|| SENSORS.into_iter().find(|sensor| sensor.contains(column, row)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_sensor_is_likely_unless_x_and_y_are_exchanged() {
        for (column, row, likely) in [
            (345, 259, Some(Sensor::new(346, 260))),
            (259, 345, Some(Sensor::new(346, 260))),
            (258, 345, Some(Sensor::new(640, 480))),
            (319, 319, Some(Sensor::new(320, 320))),
            (2000, 10, None),
        ] {
            assert_eq!(likely_sensor(column, row), likely, "{column}, {row}");
        }
    }
}
