//! Second pass over windows whose circles fit several positions on the board, which uses neighbouring reference frames.
//!
//! If the border of the image cuts the board, several placements explain the circles equally well. The frames just before or just
//! after predict the position of each circle, assuming constant motion. The pass goes through the windows once forward and once
//! backward, on one thread, so that each placed window helps to place the next.

use evcal_core::grid::GridCandidate;
use evcal_core::window::Window;
use nalgebra::Vector2;

use crate::circles::reference_frame::ReferenceFrame;

/// A window with a lattice whose position on the board is uncertain.
pub(super) struct Uncertain {
    /// Index of the chunk among those searched together.
    pub chunk: usize,
    pub window: Window,
    pub candidates: Vec<GridCandidate<f32>>,
}

impl Uncertain {
    fn start(&self) -> f64 {
        self.window.start_us as f64 * 1e-6
    }

    fn end(&self) -> f64 {
        self.window.end_us as f64 * 1e-6
    }
}

/// Limits on the time between frames and windows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spacing {
    /// Smallest time between two frames (s).
    pub gap: f64,
    /// Longest time over which circles can be predicted (s).
    pub longest: f64,
}

/// Predicts the positions of the circles of the board (by index, `circles` of them) in the middle of a window, from the
/// frame nearest in time (`near`) and the one beyond it (`far`); `None` if `near` is too far away in time.
fn expected(
    circles: usize,
    window: &Uncertain,
    near: &ReferenceFrame,
    far: Option<&ReferenceFrame>,
    longest: f64,
) -> Option<Vec<Option<Vector2<f32>>>> {
    let elapsed = 0.5 * (window.start() + window.end()) - near.t();
    if elapsed.abs() > longest {
        return None;
    }
    let far = far.filter(|far| (near.t() - far.t()).abs() <= longest);
    let velocity = |index: usize, center: Vector2<f64>| {
        let far = far?;
        let before = far.circles.iter().find(|circle| circle.index == index)?;
        Some((center - before.center) / (near.t() - far.t()))
    };
    let velocities: Vec<Option<Vector2<f64>>> =
        near.circles.iter().map(|circle| velocity(circle.index, circle.center)).collect();
    let known = velocities.iter().flatten().count().max(1) as f64;
    let mean = velocities.iter().flatten().sum::<Vector2<f64>>() / known;
    let mut pixels = vec![None; circles];
    for (circle, velocity) in near.circles.iter().zip(&velocities) {
        if let Some(slot) = pixels.get_mut(circle.index) {
            *slot = Some((circle.center + velocity.unwrap_or(mean) * elapsed).cast());
        }
    }
    Some(pixels)
}

/// Adds to `found` the frames of `uncertain` windows. `place` makes a frame of a window and the expected pixels of the
/// board's circles, or returns `None`. All are in the order of time; `before` are the last two frames of the previous
/// search, the later one first. Returns all frames in the order of time, and the number of added ones.
pub(super) fn second_pass(
    circles: usize,
    before: [Option<&ReferenceFrame>; 2],
    found: Vec<ReferenceFrame>,
    uncertain: Vec<Uncertain>,
    spacing: Spacing,
    mut place: impl FnMut(&Uncertain, &[Option<Vector2<f32>>]) -> Option<ReferenceFrame>,
) -> (Vec<ReferenceFrame>, u64) {
    let mut added = 0;
    let mut frames: Vec<ReferenceFrame> = Vec::with_capacity(found.len());
    let mut left: Vec<Uncertain> = Vec::new();
    let mut found = found.into_iter().peekable();
    for window in uncertain {
        while let Some(frame) = found.next_if(|frame| frame.start < window.end() + spacing.gap) {
            frames.push(frame);
        }
        let (near, far) = {
            let mut latest = frames.iter().rev().chain(before.into_iter().flatten());
            (latest.next(), latest.next())
        };
        if near.is_some_and(|near| window.start() < near.end + spacing.gap) {
            continue;
        }
        let pixels = near.and_then(|near| expected(circles, &window, near, far, spacing.longest));
        match pixels.and_then(|pixels| place(&window, &pixels)) {
            Some(frame) => {
                frames.push(frame);
                added += 1;
            }
            None => left.push(window),
        }
    }
    frames.extend(found);
    for window in left.iter().rev() {
        let next = frames.partition_point(|frame| frame.start < window.end() + spacing.gap);
        let mut following = frames.iter().skip(next);
        let (near, far) = (following.next(), following.next());
        let before = next.checked_sub(1).and_then(|index| frames.get(index));
        if before.is_some_and(|before| window.start() < before.end + spacing.gap) {
            continue;
        }
        let pixels = near.and_then(|near| expected(circles, window, near, far, spacing.longest));
        if let Some(frame) = pixels.and_then(|pixels| place(window, &pixels)) {
            frames.insert(next, frame);
            added += 1;
        }
    }
    (frames, added)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circles::reference_frame::{ObservedCircle, SeenIn};

    const SPACING: Spacing = Spacing { gap: 0.005, longest: 0.03 };
    const WINDOW: f64 = 0.002;

    /// Returns the position of circle `index` at `t`: 300 px/s to the right, 100 px/s up.
    fn truth(index: usize, t: f64) -> Vector2<f64> {
        Vector2::new(40.0 + 30.0 * index as f64 + 300.0 * t, 90.0 - 100.0 * t)
    }

    fn frame(start: f64, circles: std::ops::Range<usize>) -> ReferenceFrame {
        let (end, t) = (start + WINDOW, start + 0.5 * WINDOW);
        let circles =
            circles.map(|index| ObservedCircle { index, t, center: truth(index, t), radius: None, velocity: None });
        ReferenceFrame { recording: 0, start, end, circles: circles.collect(), seen_in: SeenIn::Circles }
    }

    fn window(start: f64) -> Uncertain {
        let (start_us, end_us) = ((start * 1e6).round() as i64, ((start + WINDOW) * 1e6).round() as i64);
        Uncertain { chunk: 0, window: Window { start_us, end_us, first: 0, last: 0 }, candidates: Vec::new() }
    }

    /// A pass that places every window with expected pixels, which must be the true ones. Returns the starts of the frames in µs,
    /// and the number of added ones.
    fn pass(before: [Option<&ReferenceFrame>; 2], found: Vec<ReferenceFrame>, starts: &[f64]) -> (Vec<i64>, u64) {
        let uncertain = starts.iter().map(|&start| window(start)).collect();
        let (frames, added) = second_pass(6, before, found, uncertain, SPACING, |window, expected| {
            let middle = 0.5 * (window.start() + window.end());
            for (index, pixel) in expected.iter().enumerate() {
                let error = pixel.map_or(0.0, |pixel| (pixel.cast() - truth(index, middle)).norm());
                assert!(error < 1e-3, "circle {index}: {error} px");
            }
            assert!(expected.iter().flatten().count() >= 3);
            Some(frame(window.start(), 0..4))
        });
        (frames.iter().map(|frame| (frame.start * 1e6).round() as i64).collect(), added)
    }

    #[test]
    fn windows_are_searched_after_frames_and_before_them() {
        let found = vec![frame(0.100, 0..5), frame(0.110, 1..6), frame(0.160, 0..5), frame(0.170, 0..5)];
        let (starts, added) = pass([None, None], found, &[0.090, 0.120, 0.130, 0.150]);
        assert_eq!(starts, [90_000, 100_000, 110_000, 120_000, 130_000, 150_000, 160_000, 170_000]);
        assert_eq!(added, 4);
    }

    #[test]
    fn frames_of_the_previous_search_predict_positions() {
        let (later, earlier) = (frame(0.090, 0..5), frame(0.080, 0..5));
        assert_eq!(pass([Some(&later), Some(&earlier)], Vec::new(), &[0.1]), (vec![100_000], 1));
    }

    #[test]
    fn windows_too_near_to_a_frame_are_not_searched() {
        let found = vec![frame(0.100, 0..5), frame(0.110, 0..5)];
        // Too near to a frame before, to one after, to both; and longer windows with the same start.
        let (starts, added) = pass([None, None], found, &[0.098, 0.1045, 0.106, 0.115, 0.118, 0.118, 0.121]);
        assert_eq!((starts, added), (vec![100_000, 110_000, 118_000], 1));
    }

    #[test]
    fn no_positions_are_predicted_long_before_or_after_a_frame() {
        let found = vec![frame(0.100, 0..5), frame(0.110, 0..5)];
        let (starts, added) = pass([None, None], found, &[0.050, 0.150]);
        assert_eq!((starts, added), (vec![100_000, 110_000], 0));
    }
}
