//! Sharpness of the circles of a window: the width of the band of events about their rims.

use std::fmt;

use nalgebra::Vector2;
use serde::Serialize;

use crate::circles::event_pixel::EventPixel;
use crate::circles::reference_frame::ReferenceFrame;
use evcal_geometry::numerics::statistics;

/// Width above which edges are blurred, in pixels and in radii of the circle. With a lens in focus it is 0.8 px; motion across
/// many pixels increases it on sensors with many pixels.
const BLURRED: [f64; 2] = [1.6, 0.18];
/// Distance from a rim, as a share of its radius, beyond which pixels do not belong to it.
const REACH: f64 = 0.6;
/// Fewest pixels for a width.
const FEWEST_PIXELS: usize = 100;
/// Number of windows of a recording that are measured.
pub const WINDOWS: usize = 100;
/// The sharpest of this number of windows determines the sharpness of a recording: motion widens the band of the others.
const SHARPEST: usize = 10;

/// Width of circles' edges.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EdgeWidth {
    /// In pixels.
    pub pixels: f64,
    /// In radii of the circles.
    pub radii: f64,
}

impl EdgeWidth {
    /// Remedy for blurred circles.
    pub const ADVICE: &str = "focus the lens on the distance of the board, and clean it";

    /// Returns `true` if the circles are blurred.
    pub fn is_blurred(&self) -> bool {
        let [pixels, radii] = BLURRED;
        self.pixels > pixels && self.radii > radii
    }
}

impl fmt::Display for EdgeWidth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the circles' edges are blurred over {:.1} px", self.pixels)
    }
}

/// Returns the edge width of a recording: a low quantile over its windows (the sharpest one in ten), because motion
/// widens the others; `None` if too few windows have events.
pub fn edge_width(frames: &[ReferenceFrame]) -> Option<EdgeWidth> {
    let step = frames.len().div_ceil(WINDOWS).max(1);
    let widths = frames.iter().step_by(step).filter_map(|frame| {
        let pixels = band_width(frame, frame.events()?)?;
        let mut radii: Vec<f64> = frame.circles.iter().filter_map(|circle| circle.radius).collect();
        Some(EdgeWidth { pixels, radii: pixels / median(&mut radii).max(1.0) })
    });
    let mut widths: Vec<EdgeWidth> = widths.collect();
    widths.sort_by(|a, b| a.pixels.total_cmp(&b.pixels));
    widths.get(widths.len() / SHARPEST).copied()
}

/// Returns the width of the band of `pixels` about the rims of a frame's circles (px): twice the median distance of pixels from
/// the rim of their circle, after the rim was moved to their middle.
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
