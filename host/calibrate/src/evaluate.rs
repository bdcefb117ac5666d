//! Is a result right? Trajectories and calibrations against the truth or against each other.
//!
//! | module | question |
//! |---|---|
//! | [`trajectory_error`] | how far are the estimated camera positions from the true ones (ATE)? |
//! | [`projection_difference`](evcal_geometry::lens::projection_difference) | where would two calibrations put the same point in the image? |
//! | [`comparison`] | all of it, of the files of a calibration and those of the truth |
//! | [`intrinsics`] | which parameters differ, and by how much? |
//! | [`captured`] | what does motion capture say of a trajectory? |
//! | [`printed_board`] | is the board bent and printed as it was simulated? |
//!
//! Parameters of a lens model trade against each other and against the camera's orientation, so
//! the projection difference is the figure to trust; the parameters are for the eye.

pub mod captured;
pub mod comparison;
pub mod intrinsics;
pub mod pose_by_intrinsics;
pub mod printed_board;
pub mod trajectory_error;
