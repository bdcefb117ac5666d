//! Circle candidates: pairs of an ON and an OFF cluster at opposite sides of a dot
//! (Huang, Wang, Kneip, IROS 2021, III-B).
//!
//! A dark dot that moves leaves OFF events where it arrives and ON events where it leaves.
//!
//! - [`Method::Hard`] fits a circle (Kåsa) to all pixels of a pair and tests the fit against the pair.
//! - [`Method::Soft`] takes the line between the centres of a pair as the diameter: for noisy input
//!   and for inclined views, in which a dot is an ellipse.
//!
//! Beyond the paper, both methods want the arcs to be curved around each other: the ON arc of a dot
//! and the OFF arc of the next one are near too, but back to back. The third moments of a cluster
//! tell.
//!
//! Either way a pair counts only if each cluster is the other's best partner. The clusters' centres
//! are their means: the mean of an arc lies inside of the circle by an amount that its spread tells,
//! and is moved out by that much wherever a distance is compared (the paper's median lies somewhere
//! between, depending on the direction of the arc). Every pair that falls
//! away is counted by its reason in [`CircleCounts`]. Nothing here panics.

mod extraction;
mod fit;

pub use extraction::{CircleCounts, extract};
pub use fit::{Circle, fit_circle};

use nalgebra::{RealField, Vector2};

/// How a circle follows from a pair of clusters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// A circle fitted to the pixels of both clusters.
    Hard,
    /// The line between the centres of the clusters as diameter.
    Soft,
}

/// Largest number of neighbours that can be tried for a cluster.
pub const MAX_NEIGHBOURS: usize = 8;

/// Settings of the extraction.
///
/// The defaults are for dots of 3 to 25 px radius, seen at up to 60° from the front, and windows in
/// which a dot moves by less than its radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExtractionSettings<T> {
    /// How a circle follows from a pair.
    /// Default: [`Method::Hard`].
    pub method: Method,
    /// Number of nearest facing clusters of the other polarity tried for each ON cluster, at most
    /// [`MAX_NEIGHBOURS`].
    /// Default: 4.
    pub neighbours: u8,
    /// Smallest cosine of the angle between the direction in which an arc is curved and that to its
    /// partner.
    /// Default: 0.5.
    pub min_facing: T,
    /// Smallest radius in pixels.
    /// Default: 2 px.
    pub min_radius: T,
    /// Largest radius in pixels. Clusters wider or higher than twice this are no arcs of a dot.
    /// Default: 32 px.
    pub max_radius: T,
    /// Fewest pixels of each cluster, in radii: an arc of one radian has about one pixel per radius.
    /// Default: 0.75.
    pub min_arc: T,
    /// Largest ratio of the fitted radius to half the distance of the cluster centres (hard).
    /// Default: 2.
    pub max_radius_ratio: T,
    /// Smallest such ratio (hard).
    /// Default: 0.75.
    pub min_radius_ratio: T,
    /// Largest distance of the fitted centre from the midpoint of the cluster centres, in radii (hard).
    /// Default: 0.5.
    pub max_center_offset: T,
    /// Largest mean distance of the pixels from a fitted circle, in pixels, for a circle of radius 0 (hard).
    /// Default: 1 px.
    pub max_error: T,
    /// What a fitted circle may deviate beyond [`max_error`](Self::max_error), in radii (hard): dots
    /// are ellipses in inclined views.
    /// Default: 0.2.
    pub max_relative_error: T,
    /// Largest mean distance of the pixels from the circle, in radii (soft).
    /// Default: 0.35.
    pub max_soft_error: T,
}

impl<T: RealField + Copy> Default for ExtractionSettings<T> {
    fn default() -> Self {
        Self {
            method: Method::Hard,
            neighbours: 4,
            min_facing: nalgebra::convert(0.5),
            min_radius: nalgebra::convert(2.0),
            max_radius: nalgebra::convert(32.0),
            min_arc: nalgebra::convert(0.75),
            max_radius_ratio: nalgebra::convert(2.0),
            min_radius_ratio: nalgebra::convert(0.75),
            max_center_offset: nalgebra::convert(0.5),
            max_error: nalgebra::convert(1.0),
            max_relative_error: nalgebra::convert(0.2),
            max_soft_error: nalgebra::convert(0.35),
        }
    }
}

/// A circle in the image, found from a pair of clusters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleCandidate<T> {
    /// Centre in pixels.
    pub center: Vector2<T>,
    /// Radius in pixels.
    pub radius: T,
    /// Mean absolute distance of the pixels of both clusters from the circle, in pixels.
    pub error: T,
    /// Index of the ON cluster.
    pub on_cluster: u16,
    /// Index of the OFF cluster.
    pub off_cluster: u16,
    /// Pixels of the ON cluster.
    pub on_pixels: u16,
    /// Pixels of the OFF cluster.
    pub off_pixels: u16,
}

#[cfg(test)]
mod tests;
