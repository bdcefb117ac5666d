//! What is known of a lens apart from any recording: files of it, priors, differences between two, nearest equivalents.

pub mod axial_focal;
pub mod camera_file;
pub mod covered_region;
pub mod distortion_prior;
pub mod folds;
pub mod held;
pub mod nearest;
pub mod projection_difference;
pub mod projection_sensitivity;
