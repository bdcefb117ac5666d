//! How sharp the circles of a window are: the width of the band of events about their rims.

use nalgebra::Vector2;
use serde::Serialize;

use crate::circles::event_pixel::EventPixel;
use crate::circles::reference_frame::ReferenceFrame;
use evcal_geometry::numerics::statistics;

/// Edges wider than this, in pixels and in radii of the circle, are blurred. Those of a lens in focus are 0.8 px wide; motion
/// across many pixels widens them on sensors that have many.
const BLURRED: [f64; 2] = [1.6, 0.18];
/// Pixels farther from a rim, as a share of its radius, belong to something else.
const REACH: f64 = 0.6;
/// Fewest pixels that make a width.
const FEWEST_PIXELS: usize = 100;
/// Windows of a recording that are measured.
pub const WINDOWS: usize = 100;
/// The sharpest of so many tells how sharp a recording is: motion widens the band of the others.
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
    /// Whether the circles are blurred.
    pub fn is_blurred(&self) -> bool {
        let [pixels, radii] = BLURRED;
        self.pixels > pixels && self.radii > radii
    }
}

/// How sharp the circles of a recording are: the width of the band that a tenth of its windows is below; `None` where too few have
/// events.
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
