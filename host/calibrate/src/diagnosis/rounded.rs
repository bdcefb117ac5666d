//! Detection of events that were undistorted and rounded to pixels. Where undistortion stretches the image, lines of pixels
//! between busy ones have no events at all, which never happens on a sensor.

use std::fmt;

use serde::Serialize;

/// A pixel is among busy ones if the median number of events of its neighbours is at least this. By chance, fewer than
/// one in 2000 of such pixels has no event.
const BUSY: u32 = 8;
/// Fewest pixels among busy ones for a decision.
const FEWEST: u64 = 1000;
/// Share of them without an event above which the events were rounded: on a sensor, fewer are empty.
const MANY_EMPTY: f64 = 0.01;

/// Pixels without events among busy ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rounded {
    /// Share of the pixels among busy ones.
    pub empty: f64,
}

impl Rounded {
    /// Remedy.
    pub const ADVICE: &str = "calibrate the events as the camera sent them";

    /// Returns the empty pixels from the number of events of each pixel, row by row.
    pub fn found(events: &[u32], width: usize) -> Option<Self> {
        let rows: Vec<&[u32]> = events.chunks_exact(width.max(1)).collect();
        // Lines without any event are broken, or not read.
        let silent_column: Vec<bool> =
            (0..width).map(|x| rows.iter().all(|row| row.get(x).is_none_or(|count| *count == 0))).collect();
        let rows: Vec<&[u32]> = rows.into_iter().filter(|row| row.iter().any(|count| *count > 0)).collect();
        let columns: Vec<usize> = (0..width).filter(|x| silent_column.get(*x) == Some(&false)).collect();
        let (mut busy, mut empty) = (0_u64, 0_u64);
        for around in rows.windows(3) {
            for places in columns.windows(3) {
                let mut counts = [0; 9];
                let values = around.iter().flat_map(|row| places.iter().map(|x| row.get(*x).copied().unwrap_or(0)));
                counts.iter_mut().zip(values).for_each(|(count, value)| *count = value);
                let [a, b, c, d, own, e, f, g, h] = counts;
                let mut neighbours = [a, b, c, d, e, f, g, h];
                neighbours.sort_unstable();
                if neighbours[3] >= BUSY {
                    busy += 1;
                    empty += u64::from(own == 0);
                }
            }
        }
        let share = empty as f64 / busy.max(1) as f64;
        (busy >= FEWEST && share > MANY_EMPTY).then_some(Self { empty: share })
    }
}

impl fmt::Display for Rounded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:.0} % of the pixels among busy ones have no event: the events were undistorted already, and rounded to pixels",
            100.0 * self.empty
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 120;
    const HEIGHT: usize = 90;

    /// Events of all pixels of a sensor, about 20 each, moved by `to`.
    fn found(to: impl Fn(f64, f64) -> (f64, f64), is_silent: impl Fn(usize, usize) -> bool) -> Option<Rounded> {
        let mut events = vec![0; WIDTH * HEIGHT];
        for (y, x) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (y, x))) {
            let (column, row) = to(x as f64 - 59.5, y as f64 - 44.5);
            let (column, row) = ((column + 59.5).round(), (row + 44.5).round());
            let is_inside = (0.0..WIDTH as f64).contains(&column) && (0.0..HEIGHT as f64).contains(&row);
            if is_inside && !is_silent(x, y) {
                events[row as usize * WIDTH + column as usize] += 15 + ((x * 7 + y * 13) % 11) as u32;
            }
        }
        Rounded::found(&events, WIDTH)
    }

    #[test]
    fn stretched_events_leave_empty_pixels_but_a_sensor_does_not() {
        let stretched = |x: f64, y: f64| {
            let factor = 1.0 + 0.1 * (x * x + y * y) / 3600.0;
            (x * factor, y * factor)
        };
        let rounded = found(stretched, |_, _| false).unwrap();
        assert!((0.03..0.4).contains(&rounded.empty), "{rounded:?}");
        let as_sent = |x: f64, y: f64| (x, y);
        assert_eq!(found(as_sent, |_, _| false), None);
        // Broken columns, a sensor that reads every other row, one with a window, and one with broken pixels.
        assert_eq!(found(as_sent, |x, _| [7, 8, 50].contains(&x)), None);
        assert_eq!(found(as_sent, |_, y| y % 2 == 0), None);
        assert_eq!(found(as_sent, |x, y| x < 30 || y > 60), None);
        assert_eq!(found(as_sent, |x, y| (x * 31 + y * 17) % 211 == 0), None);
    }
}
