//! Test of the form of a board's dots: they must be round and without holes. Applied to windows in which the board was found.
//!
//! Single dots of a few pixels show little of their form, but all dots of a board have the same one. The lattice determines the
//! map from the board to the image near each dot, so that the events of all dots can be overlaid on the print, without
//! perspective and lens. With (ρ, θ) the position of an event relative to its dot's centre in radii:
//!
//! - The rim of a disc is ρ = 1 in all directions. A rim with four corners is ρ = 1 + a cos 4θ + b sin 4θ, and smaller
//!   terms of higher order. Squares, tags and window panes have √(a² + b²) = 0.11, keys with rounded corners half of
//!   that. Centre, radius and deviations from the map (one and two periods in θ) are estimated in the same least
//!   squares, window by window.
//! - A disc has no events inside and around it. The other rim of a ring or a nut, either the hole's or the outer one, has events
//!   of the opposite polarity on the same side of the dot. Noise has as many events of one polarity as of the other.
//!
//! The evidence of windows is added up.

use evcal_core::event::Polarity;
use evcal_core::pattern::{Layout, Pattern};
use nalgebra::{DMatrix, Matrix2, Matrix2x5, Matrix5, SVector, Vector2, Vector5};

use crate::circles::event_pixel::EventPixel;
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame};

/// Evidence on the form of the dots from one or more windows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DotShape {
    /// Normal equations of the corners' amplitudes (of cos 4θ and sin 4θ), everything else eliminated.
    information: Matrix2<f64>,
    moment: Vector2<f64>,
    /// Sum of the squared residuals in ρ, without corners.
    residual: f64,
    /// Number of events on rims.
    rim: f64,
    /// Number of events on the rims' flanks, where the edge does not nearly slide along itself.
    flank: f64,
    /// Number of events of the opposite polarity minus number of events of the same polarity, inside a dot or around it
    /// next to the flanks.
    opposite: f64,
}

/// A dot of the board in a window.
#[derive(Clone, Copy, Debug)]
pub struct Dot {
    /// Index on the board.
    pub index: usize,
    /// Centre (px).
    pub center: Vector2<f64>,
    /// Radius (px).
    pub radius: f64,
}

/// Largest distance of the events from the centre in radii: the outer rim of a ring whose hole was found is within it.
const FAR: f64 = 2.3;
/// Distances within which events belong to the rim, whatever the dot's form (radii).
const RIM_BAND: std::ops::Range<f64> = 0.55..1.45;
/// Cosine of the angle to the dot's motion below which the edge nearly slides along itself, for events on the rim.
const SLIDING: f64 = 0.25;
/// The same limit for events next to the rim.
const SLIDING_NEXT_TO_RIM: f64 = 0.5;
/// Distance from the rim within which events belong to it, in radii.
const RIM: f64 = 0.2;
/// The same distance in pixels.
const RIM_PIXELS: f64 = 1.3;
/// Fewest events per dot.
const FEWEST: usize = 8;
/// Approximate number of dots of a window that are evaluated; if there are more, every other or third one is.
const MOST_DOTS: usize = 18;
/// Fewest dots for a map with quadratic terms.
const CURVED: usize = 9;
/// Largest amplitude of four corners in the rims of discs (radii). Squares have 0.11.
const LARGEST_CORNERS: f64 = 0.02;
/// Largest number of events of the opposite polarity inside and around discs, beyond noise, as a share of those on their rims.
/// Rings have more.
const MOST_HOLLOW: f64 = 0.12;
/// Factor on these limits for a single window.
const OF_ONE_WINDOW: f64 = 2.0;
/// Number of standard deviations from which corners are significant.
const CERTAIN: f64 = 3.0;

impl DotShape {
    /// Returns the evidence of a frame on the dots of `pattern`; `None` if it contains no events.
    pub fn of_frame(frame: &ReferenceFrame, pattern: &Pattern) -> Option<Self> {
        let circles = frame.circles.iter();
        let dot =
            |circle: &ObservedCircle| Some(Dot { index: circle.index, center: circle.center, radius: circle.radius? });
        let dots: Vec<Dot> = circles.filter_map(dot).collect();
        Some(Self::of_dots(&dots, frame.events()?, pattern))
    }

    /// Returns the evidence of the sorted `pixels` of a window on its `dots`.
    pub fn of_dots(dots: &[Dot], pixels: &[EventPixel], pattern: &Pattern) -> Self {
        let Some(map) = LatticeMap::through(dots, pattern) else { return Self::default() };
        let mut sums = RimSums::default();
        let mut shape = Self::default();
        let mut around: Vec<(Vector2<f64>, Polarity)> = Vec::new();
        for dot in dots.iter().step_by(dots.len().div_ceil(MOST_DOTS).max(1)) {
            let Some(to_board) = map.jacobian_at(lattice_place(pattern, dot.index)).try_inverse() else { continue };
            let unit = map.radius;
            let cell = cell_of(pattern.layout, unit);
            gather(dot, pixels, &(to_board / unit), &mut around);
            let heading = heading(&around);
            if around.len() < FEWEST || heading == Vector2::zeros() {
                continue;
            }
            let margin = RIM.max(RIM_PIXELS / dot.radius);
            for (place, polarity) in &around {
                let radius = place.norm();
                // OFF on the side towards which the dark dot moves.
                let toward = place.dot(&heading) / radius.max(1e-9);
                let expected = (toward > 0.0) == (*polarity == Polarity::Off);
                if !cell(place) {
                    continue;
                }
                if toward.abs() > SLIDING_NEXT_TO_RIM {
                    let is_next_to_rim = (radius - 1.0).abs() > margin;
                    if is_next_to_rim {
                        shape.opposite += if expected { -1.0 } else { 1.0 };
                    } else if expected {
                        shape.flank += 1.0;
                    }
                }
                if expected && RIM_BAND.contains(&radius) && toward.abs() > SLIDING {
                    sums.add(place, radius);
                }
            }
        }
        sums.eliminate(&mut shape);
        shape
    }

    /// Adds the evidence of another window.
    pub fn add(&mut self, other: &Self) {
        self.information += other.information;
        self.moment += other.moment;
        self.residual += other.residual;
        self.rim += other.rim;
        self.flank += other.flank;
        self.opposite += other.opposite;
    }

    /// Returns the amplitude of four corners, in radii, and its standard deviation; `None` if it is not determined.
    pub fn corners(&self) -> Option<(f64, f64)> {
        let covariance = self.information.try_inverse()?;
        let amplitude = covariance * self.moment;
        let variance = self.residual / self.rim.max(1.0) * 0.5 * covariance.trace();
        let sigma = variance.sqrt();
        (sigma.is_finite() && self.rim > 0.0).then(|| (amplitude.norm(), sigma))
    }

    /// Returns the number of events of the opposite polarity inside and around the dots, beyond noise, as a share of those on
    /// their flanks.
    pub fn hollowness(&self) -> f64 {
        self.opposite / self.flank.max(1.0)
    }

    /// Returns `true` if the dots may be discs, by the evidence of all windows.
    pub(super) fn may_be_discs(&self) -> bool {
        self.is_below(1.0)
    }

    /// Returns `true` if the dots may be discs, by the evidence of one window.
    pub(super) fn may_be_discs_in_window(&self) -> bool {
        self.is_below(OF_ONE_WINDOW)
    }

    fn is_below(&self, factor: f64) -> bool {
        let certain = self.corners().map_or(0.0, |(amplitude, sigma)| amplitude - CERTAIN * sigma);
        certain <= factor * LARGEST_CORNERS && self.hollowness() <= factor * MOST_HOLLOW
    }
}

/// Collects the positions of events around a `dot`, mapped by `to_board`, with their polarities, in `around`.
fn gather(dot: &Dot, pixels: &[EventPixel], to_board: &Matrix2<f64>, around: &mut Vec<(Vector2<f64>, Polarity)>) {
    around.clear();
    let center = dot.center;
    let Some(to_image) = to_board.try_inverse() else { return };
    // Width and height of the ellipse that is the image of the circle of radius FAR.
    let (wide, high) = (FAR * to_image.row(0).norm(), FAR * to_image.row(1).norm());
    let first = (center.y - high).ceil().max(0.0) as u16;
    let mut rest = pixels.get(pixels.partition_point(|pixel| pixel.y() < first)..).unwrap_or_default();
    while let Some(row) = rest.first().map(|pixel| pixel.y()).filter(|row| f64::from(*row) <= center.y + high) {
        let end = rest.partition_point(|pixel| pixel.y() <= row);
        let (this, later) = rest.split_at(end);
        rest = later;
        let start = this.partition_point(|pixel| f64::from(pixel.x()) < center.x - wide);
        let near = this.get(start..).unwrap_or_default();
        around.extend(near.iter().take_while(|pixel| f64::from(pixel.x()) <= center.x + wide).filter_map(|pixel| {
            let place = to_board * (Vector2::new(f64::from(pixel.x()), f64::from(pixel.y())) - center);
            (place.norm_squared() < FAR * FAR).then(|| (place, pixel.polarity()))
        }));
    }
}

/// Returns the direction of a dot's motion, from the positions of its events of both polarities; 0 if one is missing.
fn heading(around: &[(Vector2<f64>, Polarity)]) -> Vector2<f64> {
    let mean = |wanted: Polarity| {
        let of_rim =
            |(place, polarity): &&(Vector2<f64>, Polarity)| *polarity == wanted && RIM_BAND.contains(&place.norm());
        let places = around.iter().filter(of_rim).map(|(place, _)| place);
        let (sum, count) = places.fold((Vector2::zeros(), 0.0), |(sum, count), place| (sum + place, count + 1.0));
        (count > 0.0).then(|| sum / count)
    };
    let (Some(off), Some(on)) = (mean(Polarity::Off), mean(Polarity::On)) else { return Vector2::zeros() };
    (off - on).try_normalize(1e-9).unwrap_or_default()
}

/// Returns a function that returns `true` if a position, in radii of `unit` spacings, is nearer to its dot than to the
/// next.
fn cell_of(layout: Layout, unit: f64) -> impl Fn(&Vector2<f64>) -> bool {
    // Slightly less than half, to exclude the neighbour's own rim.
    let half = 0.48 / unit;
    move |place| match layout {
        Layout::Symmetric => place.x.abs().max(place.y.abs()) < half,
        Layout::Asymmetric => place.x.abs() + place.y.abs() < 2.0 * half,
    }
}

/// Returns the position of a circle on the lattice.
fn lattice_place(pattern: &Pattern, index: usize) -> Vector2<f64> {
    let (x, y) = pattern.lattice_position(index);
    Vector2::new(f64::from(x), f64::from(y))
}

/// A smooth map from the lattice to the image, and the dots' radius in spacings.
struct LatticeMap {
    middle: Vector2<f64>,
    /// Coefficients of x, y, x², x y, y² in both coordinates of the image.
    terms: [Vector2<f64>; 5],
    radius: f64,
}

impl LatticeMap {
    /// Fits the map to the dots by least squares; `None` if there are too few.
    fn through(dots: &[Dot], pattern: &Pattern) -> Option<Self> {
        let place = |dot: &Dot| lattice_place(pattern, dot.index);
        let count = dots.len();
        let middle = dots.iter().map(place).sum::<Vector2<f64>>() / count.max(1) as f64;
        let columns = if count < CURVED { 3 } else { 6 };
        let design = DMatrix::from_fn(count, columns, |row, column| {
            let offset = dots.get(row).map_or_else(Vector2::zeros, |dot| place(dot) - middle);
            let (x, y) = (offset.x, offset.y);
            [1.0, x, y, x * x, x * y, y * y].get(column).copied().unwrap_or(0.0)
        });
        let centers = DMatrix::from_fn(count, 2, |row, column| {
            dots.get(row).and_then(|dot| dot.center.get(column).copied()).unwrap_or(0.0)
        });
        let solution = design.tr_mul(&design).cholesky()?.solve(&design.tr_mul(&centers));
        let term = |row: usize| {
            let value = |column: usize| solution.get((row, column)).copied().unwrap_or(0.0);
            Vector2::new(value(0), value(1))
        };
        let mut map = Self { middle, terms: [term(1), term(2), term(3), term(4), term(5)], radius: 1.0 };
        let radii = dots.iter().filter_map(|dot| {
            let area = map.jacobian_at(place(dot)).determinant().abs();
            (area > 0.0).then(|| dot.radius / area.sqrt())
        });
        let mut radii: Vec<f64> = radii.collect();
        radii.sort_by(f64::total_cmp);
        map.radius = radii.get(radii.len() / 2).copied().filter(|radius| *radius > 0.0)?;
        Some(map)
    }

    fn jacobian_at(&self, place: Vector2<f64>) -> Matrix2<f64> {
        let [by_x, by_y, xx, xy, yy] = self.terms;
        let offset = place - self.middle;
        Matrix2::from_columns(&[
            by_x + xx * (2.0 * offset.x) + xy * offset.y,
            by_y + xy * offset.x + yy * (2.0 * offset.y),
        ])
    }
}

/// Sums of the least squares for ρ − 1 over 1, cos θ, sin θ, cos 2θ, sin 2θ and cos 4θ, sin 4θ.
#[derive(Default)]
struct RimSums {
    plain: Matrix5<f64>,
    mixed: Matrix2x5<f64>,
    corners: Matrix2<f64>,
    plain_moment: Vector5<f64>,
    corner_moment: Vector2<f64>,
    square: f64,
    count: f64,
}

impl RimSums {
    #[inline]
    fn add(&mut self, place: &Vector2<f64>, radius: f64) {
        let (c, s) = (place.x / radius, place.y / radius);
        let (c2, s2) = (c * c - s * s, 2.0 * c * s);
        let plain = SVector::from([1.0, c, s, c2, s2]);
        let corner = Vector2::new(c2 * c2 - s2 * s2, 2.0 * c2 * s2);
        let deviation = radius - 1.0;
        self.plain += plain * plain.transpose();
        self.mixed += corner * plain.transpose();
        self.corners += corner * corner.transpose();
        self.plain_moment += plain * deviation;
        self.corner_moment += corner * deviation;
        self.square += deviation * deviation;
        self.count += 1.0;
    }

    /// Eliminates everything but the corners.
    fn eliminate(&self, shape: &mut DotShape) {
        let Some(inverse) = self.plain.cholesky().map(|factor| factor.inverse()) else { return };
        let gain = self.mixed * inverse;
        shape.information += self.corners - gain * self.mixed.transpose();
        shape.moment += self.corner_moment - gain * self.plain_moment;
        shape.residual += (self.square - self.plain_moment.dot(&(inverse * self.plain_moment))).max(0.0);
        shape.rim += self.count;
    }
}

#[cfg(test)]
mod tests;
