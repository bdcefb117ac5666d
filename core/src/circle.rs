//! Circle candidates: pairs of an ON and an OFF cluster at opposite sides of a dot
//! (Huang, Wang, Kneip, IROS 2021, III-B).
//!
//! A moving dark dot triggers OFF events at its leading edge and ON events at its trailing edge.
//!
//! - [`Extraction::Hard`] fits a circle (Kåsa) to all pixels of a pair and tests the fit against the pair.
//! - [`Extraction::Soft`] takes the line between the centres of a pair as the diameter. It suits noisy input and
//!   inclined views, in which a dot is an ellipse.
//!
//! Beyond the paper, both methods require the two arcs to curve around a common centre. The ON arc of one dot and the
//! OFF arc of the next are also close to each other, but curve away from each other. The third moments of a cluster
//! determine the direction in which it is curved.
//!
//! In both methods a pair counts only if each cluster is the other's best partner. The centre of a cluster is the mean
//! of its pixels. The mean of an arc lies inside the circle, by an amount that follows from the arc's variance. Both
//! means are moved outwards by that amount before the line between them is taken as a diameter or compared with a
//! fitted circle. (The paper's median lies between the mean and the arc, depending on the direction of the arc.) Every
//! rejected pair is counted by its reason in [`CircleCounts`]. Nothing here panics.

mod extraction;
mod fit;

pub use extraction::{CircleCounts, extract};
pub use fit::{Circle, fit_circle};

use nalgebra::Vector2;

use crate::settings::{above, at_least, from_to};

/// Method of deriving a circle from a pair of clusters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum Extraction {
    /// A circle fitted to the pixels of both clusters.
    #[default]
    Hard,
    /// The line between the centres of the clusters as diameter.
    Soft,
}

/// Largest number of neighbours that can be tried for a cluster.
pub const MAX_NEIGHBOURS: usize = 8;

// The defaults are for dots of 3 to 25 px radius, inclined by up to 60°, and windows in which a dot moves by less than
// its radius.
crate::settings! {
    /// Circles from pairs of an ON and an OFF cluster. "(hard)" and "(soft)" mark values that only one extraction
    /// method uses.
    #[derive(Clone, Copy, Debug, PartialEq)]
    #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields, default))]
    pub struct CircleSettings {
        /// Nearest facing clusters of the other polarity tried for each ON cluster (hard).
        pub neighbours: u8 = 4, "clusters", from_to(1.0, MAX_NEIGHBOURS as f32);
        /// Smallest cosine of the angle between the direction in which an arc is curved and the direction to its
        /// partner.
        #[cfg_attr(feature = "serde", serde(skip))]
        pub min_facing: f32 = 0.5, "", from_to(-1.0, 1.0);
        /// Smallest radius.
        pub min_radius: f32 = 2.0, "px", at_least(0.0).up_to("max_radius");
        /// Largest radius; clusters wider or higher than twice this are not arcs of a dot.
        pub max_radius: f32 = 32.0, "px", above(0.0);
        /// Smallest ratio of the number of pixels of each cluster to the radius in pixels; it is about 1 for an arc of
        /// one radian.
        #[cfg_attr(feature = "serde", serde(skip))]
        pub min_arc: f32 = 0.75, "radii", at_least(0.0);
        /// Largest ratio of the fitted radius to half the line between the outermost points of both arcs (hard).
        pub max_radius_ratio: f32 = 2.0, "", above(0.0);
        /// Smallest ratio of the fitted radius to half the line between the outermost points of both arcs (hard).
        #[cfg_attr(feature = "serde", serde(skip))]
        pub min_radius_ratio: f32 = 0.75, "", at_least(0.0).up_to("max_radius_ratio");
        /// Largest distance of the fitted centre from the midpoint of the line between the outermost points of both arcs
        /// (hard).
        pub max_center_offset: f32 = 0.5, "radii", above(0.0);
        /// Largest mean distance of the pixels from the circle; 0.2 times the radius is added to it, because tilted
        /// dots are ellipses (hard).
        pub max_error: f32 = 1.0, "px", at_least(0.0);
        /// Factor of the radius in the term that is added to `max_error`, because tilted dots are ellipses (hard).
        #[cfg_attr(feature = "serde", serde(skip))]
        pub max_relative_error: f32 = 0.2, "radii", at_least(0.0);
        /// Largest mean distance of the pixels from the circle (soft).
        pub max_soft_error: f32 = 0.35, "radii", above(0.0);
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
