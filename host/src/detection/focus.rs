//! How sharp the circles of a window are: the width of the band of events about their rims.

use nalgebra::Vector2;

use crate::circles::event_pixel::EventPixel;
use crate::circles::reference_frame::ReferenceFrame;
use crate::numerics::statistics;

/// Pixels farther from a rim, as a share of its radius, belong to something else.
const REACH: f64 = 0.6;
/// Fewest pixels that make a width.
const FEWEST_PIXELS: usize = 100;
/// Windows of a recording that are measured.
const WINDOWS: usize = 100;
/// The sharpest of so many tells how sharp a recording is: motion widens the band of the others.
const SHARPEST: usize = 10;

/// How sharp the circles of a recording are: the width of the band (px) that a tenth of its windows is below; `None` where too
/// few have events.
pub fn sharpness(frames: &[ReferenceFrame]) -> Option<f64> {
    let step = frames.len().div_ceil(WINDOWS).max(1);
    let widths = frames.iter().step_by(step).filter_map(|frame| band_width(frame, frame.events()?));
    let mut widths: Vec<f64> = widths.collect();
    widths.sort_by(f64::total_cmp);
    widths.get(widths.len() / SHARPEST).copied()
}

/// Width of the band of `pixels` about the rims of a frame's circles (px): twice the median distance of pixels from the rim of their circle, after the rim was moved to the middle of them.
pub fn band_width(frame: &ReferenceFrame, pixels: &[EventPixel]) -> Option<f64> {
    let circles: Vec<(Vector2<f64>, f64)> =
        frame.circles.iter().filter_map(|circle| Some((circle.center, circle.radius?))).collect();
    let mut offsets: Vec<f64> = pixels
        .iter()
        .filter_map(|pixel| {
            let at = Vector2::new(f64::from(pixel.x()), f64::from(pixel.y()));
            let of = |&(center, radius): &(Vector2<f64>, f64)| ((at - center).norm() - radius, radius);
            let (offset, radius) = circles.iter().map(of).min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
            (offset.abs() < REACH * radius).then_some(offset)
        })
        .collect();
    if offsets.len() < FEWEST_PIXELS {
        return None;
    }
    let middle = median(&mut offsets);
    offsets.iter_mut().for_each(|offset| *offset = (*offset - middle).abs());
    Some(2.0 * median(&mut offsets))
}

fn median(values: &mut [f64]) -> f64 {
    statistics::median(values, f64::total_cmp).unwrap_or(0.0)
}
