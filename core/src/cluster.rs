//! DBSCAN (Ester, Kriegel, Sander, Xu, KDD 1996) of the events of a window, per polarity, on a bitmap.
//!
//! Events lie on a pixel grid, so the neighbours of a pixel are looked up as a few bits per row, and clusters grow by
//! joining runs of pixels (union-find), row by row.
//!
//! - A pixel counts once per window and polarity, however many events it triggered.
//! - A pixel with events of both polarities is dropped. In a window of a few milliseconds such pixels lie where the
//!   edge moves along itself, or are hot or flickering. Their polarity does not depend on the side of the dot, and they
//!   would connect the ends of the two arcs.
//! - A pixel is a *core* pixel if at least [`ClusterSettings::min_points`] pixels of its polarity,
//!   itself included, lie within the Euclidean distance [`ClusterSettings::epsilon`] (as in the
//!   original paper; both bounds are inclusive).
//! - Core pixels within ε of each other share a cluster. A pixel that is not core but lies within ε of a core pixel is
//!   a *border* pixel; it joins the cluster of the first such core pixel in reading order (top to bottom, left to
//!   right). In the original paper this depends on the order of the data.
//! - Clusters are numbered by their first core pixel in reading order.
//!
//! Storage is borrowed or const generic, with a fixed capacity; what does not fit is counted in [`ClusterCounts`].
//! Nothing here panics.

mod bitmap;
mod dbscan;
mod moments;
mod neighbourhood;
mod runs;

pub use bitmap::{row_bytes, row_count};
pub use dbscan::{ClusterCounts, Clusterer, SensorTooLarge};
pub use moments::{CentralMoments, PixelSums};
pub use runs::PixelRuns;

use nalgebra::{RealField, Vector2};

use crate::settings::{at_least, from_to};

crate::settings! {
    /// DBSCAN over the pixels of one polarity.
    #[derive(Clone, Copy, Debug, PartialEq)]
    #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields, default))]
    pub struct ClusterSettings {
        /// Neighbourhood radius ε. It must stay below the gap between the arcs of neighbouring dots.
        pub epsilon: f32 = 2.5, "px", from_to(1.0, Self::LARGEST_EPSILON);
        /// Number of pixels within ε, the pixel itself included, that makes it a core pixel (MinPts).
        pub min_points: u16 = 3, "pixels", at_least(1.0);
        /// Smallest number of pixels in a cluster; smaller clusters are noise.
        pub min_pixels: u16 = 5, "pixels", at_least(1.0);
    }
}

impl ClusterSettings {
    /// Largest supported [`epsilon`](Self::epsilon), in pixels.
    pub const LARGEST_EPSILON: f32 = bitmap::MARGIN as f32 + 0.99;
}

/// A run of adjacent pixels in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelRun {
    /// Leftmost column.
    pub x: u16,
    /// Rightmost column, at least `x`.
    pub last: u16,
    /// Row.
    pub y: u16,
}

impl PixelRun {
    /// Returns the number of pixels, at least 1.
    #[inline]
    pub const fn length(&self) -> u16 {
        self.last.wrapping_sub(self.x).wrapping_add(1)
    }

    /// Returns the pixels (column, row) of the run.
    pub fn pixels(&self) -> impl Iterator<Item = (u16, u16)> {
        let y = self.y;
        (self.x..=self.last).map(move |x| (x, y))
    }
}

/// A cluster of pixels of one polarity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster<T> {
    /// Moments of its pixels.
    pub moments: CentralMoments<T>,
    /// Centre in pixels: the mean of the pixels. A median would guard against distant outliers, but a density-based
    /// cluster has none. The mean does not depend on the direction of an arc, and follows from exact sums.
    pub center: Vector2<T>,
    /// Leftmost and topmost column and row.
    pub min: [u16; 2],
    /// Rightmost and bottommost column and row.
    pub max: [u16; 2],
    /// Number of pixels.
    pub pixels: u32,
    first_run: u16,
}

impl<T: RealField + Copy> Cluster<T> {
    /// Returns the width and height of the bounding box in pixels, each at least 1.
    pub const fn extent(&self) -> [u16; 2] {
        let width = self.max[0].saturating_sub(self.min[0]).saturating_add(1);
        let height = self.max[1].saturating_sub(self.min[1]).saturating_add(1);
        [width, height]
    }
}

#[cfg(test)]
mod tests;
