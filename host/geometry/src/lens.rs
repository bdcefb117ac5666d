//! Properties of a lens independent of a recording: camera files, priors, differences between two cameras, nearest
//! equivalents.

pub mod axial_focal;
pub mod camera_file;
pub mod covered_region;
pub mod distortion_prior;
pub mod fixed;
pub mod folds;
pub mod nearest;
pub mod projection_difference;
pub mod projection_sensitivity;
