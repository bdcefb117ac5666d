//! Evaluation of a result: trajectories and calibrations compared with the ground truth or with each other.
//!
//! | module | result |
//! |---|---|
//! | [`trajectory_error`] | distances between estimated and true camera positions (ATE) |
//! | [`projection_difference`](evcal_geometry::lens::projection_difference) | difference of the projections of two calibrations |
//! | [`comparison`] | all of it, from the files of a calibration and of the truth |
//! | [`intrinsics`] | differences of the parameters |
//! | [`captured`] | comparison of a trajectory with motion capture |
//! | [`printed_board`] | estimated and simulated shape of the board |
//!
//! Parameters of a lens model are correlated with each other and with the camera's orientation, so the projection difference is
//! the reliable measure; the parameters are for information.

pub mod captured;
pub mod comparison;
pub mod intrinsics;
pub mod pose_by_intrinsics;
pub mod printed_board;
pub mod trajectory_error;
