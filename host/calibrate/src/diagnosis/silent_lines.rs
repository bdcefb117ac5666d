//! Columns and rows without events: of a sensor of another size, of scaled coordinates, or broken ones.

use evcal_core::sensor::Sensor;
use event_recordings::likely_sensor::likely_sensor;

/// A column without events is silent if the median active column has at least this number of events.
const FEWEST_OF_COLUMN: u64 = 1000;
/// If this share of both the columns and the rows between active ones is silent, the coordinates were scaled.
const MANY_SILENT: f64 = 0.15;
/// Largest number of adjacent silent columns or rows if coordinates were scaled.
const LARGEST_STEP: usize = 8;

/// Meaning of columns and rows without events.
#[derive(Clone, Debug, PartialEq)]
pub enum SilentLines {
    /// All events lie on the pixels of a smaller common sensor.
    SmallerSensor {
        /// The smaller sensor.
        smaller: Sensor,
        /// Stated size of the sensor.
        stated: Sensor,
    },
    /// Columns and rows between active ones are silent everywhere: the coordinates were scaled.
    Scaled {
        /// Number of silent columns.
        columns: usize,
        /// Number of silent rows.
        rows: usize,
    },
    /// These columns are silent: a region of interest is set, or they are broken.
    Columns(Vec<u16>),
}

impl SilentLines {
    /// Returns the meaning of silent columns and rows, from the number of events of each pixel, row by row of `width` pixels;
    /// `None` without silent columns, or if there are too few events.
    pub fn found(events: &[u32], width: usize) -> Option<Self> {
        let mut columns = vec![0_u64; width];
        let mut rows = Vec::new();
        for row in events.chunks_exact(width.max(1)) {
            columns.iter_mut().zip(row).for_each(|(column, count)| *column += u64::from(*count));
            rows.push(row.iter().map(|count| u64::from(*count)).sum::<u64>());
        }
        let mut active: Vec<u64> = columns.iter().copied().filter(|count| *count > 0).collect();
        active.sort_unstable();
        if *active.get(active.len() / 2)? < FEWEST_OF_COLUMN || active.len() == width {
            return None;
        }
        let stated = Sensor::new(u16::try_from(width).ok()?, u16::try_from(rows.len()).ok()?);
        let last = |lines: &[u64]| u16::try_from(lines.iter().rposition(|count| *count > 0)?).ok();
        let smaller = likely_sensor(last(&columns)?, last(&rows)?);
        let fills =
            |sensor: &Sensor| last(&columns) == Some(sensor.width - 1) && last(&rows) == Some(sensor.height - 1);
        if let Some(smaller) = smaller.filter(|smaller| *smaller != stated && fills(smaller)) {
            return Some(Self::SmallerSensor { smaller, stated });
        }
        if let (Some(columns), Some(rows)) = (scaled(&columns), scaled(&rows)) {
            return Some(Self::Scaled { columns, rows });
        }
        Some(Self::Columns(without_events(&columns)))
    }
}

/// Returns the lines of pixels without events if most lines have many.
pub(super) fn dead_lines(events: &[u64]) -> Vec<u16> {
    let mut sorted = events.to_vec();
    sorted.sort_unstable();
    if sorted.get(sorted.len() / 2).is_none_or(|median| *median < FEWEST_OF_COLUMN) {
        return Vec::new();
    }
    without_events(events)
}

fn without_events(lines: &[u64]) -> Vec<u16> {
    (0..).zip(lines).filter(|(_, events)| **events == 0).map(|(line, _)| line).collect()
}

/// Returns the number of silent lines between active ones if many are silent, but nowhere more than [`LARGEST_STEP`]
/// adjacent ones.
fn scaled(lines: &[u64]) -> Option<usize> {
    let is_active = |count: &u64| *count > 0;
    let (first, last) = (lines.iter().position(is_active)?, lines.iter().rposition(is_active)?);
    let inner = lines.get(first..=last)?;
    let silent = inner.iter().filter(|count| **count == 0).count();
    let largest = inner.split(is_active).map(<[u64]>::len).max()?;
    (silent as f64 > MANY_SILENT * inner.len() as f64 && largest <= LARGEST_STEP).then_some(silent)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Events of a sensor whose pixel (x, y) has events if `is_active`.
    fn found(sensor: Sensor, is_active: impl Fn(u16, u16) -> bool) -> Option<SilentLines> {
        let pixels = (0..sensor.height).flat_map(|y| (0..sensor.width).map(move |x| (x, y)));
        let events: Vec<u32> = pixels.map(|(x, y)| if is_active(x, y) { 20 } else { 0 }).collect();
        SilentLines::found(&events, usize::from(sensor.width))
    }

    #[test]
    fn silent_columns_and_rows_are_explained() {
        let davis = Sensor::new(346, 260);
        let large = Sensor::new(640, 480);
        assert_eq!(found(davis, |_, _| true), None);
        assert_eq!(found(davis, |x, _| x != 7 && x != 90), Some(SilentLines::Columns(vec![7, 90])));
        let smaller = found(large, |x, y| davis.contains(x, y));
        assert_eq!(smaller, Some(SilentLines::SmallerSensor { smaller: davis, stated: large }));
        // Coordinates times 1.5, or 2.
        let scaled = |columns, rows| Some(SilentLines::Scaled { columns, rows });
        assert_eq!(found(Sensor::new(519, 390), |x, y| x % 3 < 2 && y % 3 < 2), scaled(172, 129));
        assert_eq!(found(davis, |x, y| x % 2 == 0 && y % 2 == 0), scaled(172, 129));
        // A region of interest.
        let region = found(davis, |x, y| (40..300).contains(&x) && (20..200).contains(&y));
        assert!(matches!(region, Some(SilentLines::Columns(columns)) if columns.len() == 86));
    }

    #[test]
    fn few_events_do_not_make_a_column_dead() {
        assert_eq!(dead_lines(&[0, 999, 999]), [0_u16; 0]);
        assert_eq!(dead_lines(&[0, 1000, 1000]), [0]);
        assert_eq!(dead_lines(&[]), [0_u16; 0]);
    }
}
