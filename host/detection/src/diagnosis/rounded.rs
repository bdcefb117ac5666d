//! Detection of events that were undistorted and rounded to pixels. Where undistortion stretches the image, pixels between busy ones
//! have no events at all, and these pixels form lines through the image. Dead pixels of a sensor, and pixels that a short scene missed,
//! form no lines.

use std::fmt;

use serde::Serialize;

/// A pixel is among busy ones if the median number of events of its neighbours is at least this. By chance, fewer than
/// one in 2000 of such pixels has no event.
const BUSY: u32 = 8;
/// Fewest pixels among busy ones for a decision.
const FEWEST: u64 = 1000;
/// Share of them without an event above which the events may have been rounded.
const MANY_EMPTY: f64 = 0.01;
/// Share of the empty pixels that are part of a line if the events were rounded: 0.75 to 1 with lenses of k1 from −0.35 to 0.2 and
/// scales of 0.8 to 3. With pixels that are empty by chance, it is below 0.4 unless a quarter of all are empty.
const IN_LINES: f64 = 0.5;
/// The same as a multiple of the share among pixels with events. It is 1 if empty pixels are independent, however many they are.
const MORE_THAN_CHANCE: f64 = 2.0;

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
        // Pixels without events and pixels with events: all of them, and those in a line of empty pixels.
        let (mut without, mut with) = ([0_u64; 2], [0_u64; 2]);
        for around in rows.windows(3) {
            for places in columns.windows(3) {
                let mut counts = [0; 9];
                let values = around.iter().flat_map(|row| places.iter().map(|x| row.get(*x).copied().unwrap_or(0)));
                counts.iter_mut().zip(values).for_each(|(count, value)| *count = value);
                let [a, b, c, d, own, e, f, g, h] = counts;
                let mut neighbours = [a, b, c, d, e, f, g, h];
                neighbours.sort_unstable();
                if neighbours[3] >= BUSY {
                    let [all, in_lines] = if own == 0 { &mut without } else { &mut with };
                    *all += 1;
                    *in_lines += u64::from(is_in_line([a, b, c, d, e, f, g, h].map(|count| count == 0)));
                }
            }
        }
        let share = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
        let busy = without[0] + with[0];
        let empty = share(without[0], busy);
        let [found, by_chance] = [without, with].map(|[all, in_lines]| share(in_lines, all));
        let are_lines = found > IN_LINES && found > MORE_THAN_CHANCE * by_chance;
        (busy >= FEWEST && empty > MANY_EMPTY && are_lines).then_some(Self { empty })
    }
}

/// Returns `true` if a line of empty pixels, straight or bent by at most 45°, passes through a pixel. Its neighbours are given row by
/// row, with `true` for those without events.
fn is_in_line([a, b, c, d, e, f, g, h]: [bool; 8]) -> bool {
    let across = (d && (c || e || h)) || (e && (a || f));
    let down = (b && (f || g || h)) || (g && (a || c));
    across || down || (a && h) || (c && f)
}

impl fmt::Display for Rounded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:.0} % of the pixels among busy ones have no event, and they form lines: the events were undistorted already, and rounded to pixels",
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

    /// Returns `true` for one pixel in `of`, chosen as if at random.
    fn is_dead(x: usize, y: usize, of: u64) -> bool {
        let number = (y * WIDTH + x) as u64;
        (number.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32).wrapping_mul(0xd6e8_feb8_6659_fd93) >> 33 & 0xffff
            < 0x10000 / of
    }

    /// With 1.2 % of dead pixels, a calibration with an error of 0.010 px was said to be of undistorted events; so was one of 194
    /// repetitions of a short scene, in which pixels have no events or at least 194.
    #[test]
    fn pixels_that_are_empty_by_chance_form_no_lines() {
        let as_sent = |x: f64, y: f64| (x, y);
        for of in [83, 30, 10, 4, 3] {
            assert_eq!(found(as_sent, |x, y| is_dead(x, y, of)), None, "one in {of}");
        }
        // Defects of 2 × 2 and 4 × 3 pixels.
        assert_eq!(found(as_sent, |x, y| is_dead(x / 2, y / 2, 20)), None);
        assert_eq!(found(as_sent, |x, y| is_dead(x / 4, y / 3, 40)), None);
        // A scene that covers the middle more often than the border.
        let mut events = vec![0; WIDTH * HEIGHT];
        for (place, count) in events.iter_mut().enumerate() {
            let (x, y) = ((place % WIDTH) as f64 - 59.5, (place / WIDTH) as f64 - 44.5);
            let expected = 8.0 * (-(x * x + y * y) / 1800.0).exp();
            let draws =
                (0..40).filter(|draw| is_dead(place % WIDTH + draw * 131, place / WIDTH, (40.0 / expected) as u64));
            *count = 194 * draws.count() as u32;
        }
        let empty = events.iter().filter(|count| **count == 0).count();
        assert!(empty * 20 > events.len(), "{empty}");
        assert_eq!(Rounded::found(&events, WIDTH), None);
    }

    #[test]
    fn stretched_events_leave_empty_pixels_but_a_sensor_does_not() {
        for (scale, strength) in [(1.0, 0.1), (1.0, 0.03), (0.9, 0.2), (1.15, 0.1), (1.4, 0.05)] {
            let stretched = |x: f64, y: f64| {
                let factor = scale * (1.0 + strength * (x * x + y * y) / 3600.0);
                (x * factor, y * factor)
            };
            let rounded = found(stretched, |_, _| false).unwrap_or_else(|| panic!("{scale} {strength}"));
            assert!((0.01..0.6).contains(&rounded.empty), "{rounded:?}");
            // Dead pixels of the camera do not hide the lines.
            assert!(found(stretched, |x, y| is_dead(x, y, 30)).is_some(), "{scale} {strength}");
        }
        let as_sent = |x: f64, y: f64| (x, y);
        assert_eq!(found(as_sent, |_, _| false), None);
        // Broken columns, a sensor that reads every other row, one with a window, and one with broken pixels.
        assert_eq!(found(as_sent, |x, _| [7, 8, 50].contains(&x)), None);
        assert_eq!(found(as_sent, |_, y| y % 2 == 0), None);
        assert_eq!(found(as_sent, |x, y| x < 30 || y > 60), None);
        assert_eq!(found(as_sent, |x, y| (x * 31 + y * 17) % 211 == 0), None);
    }
}
