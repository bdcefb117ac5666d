//! The joint solve: with the nominal board and with its estimated shape, with another camera model, and with the camera's own pictures.

pub(super) mod board_solve;
pub(super) mod fixed_values;
pub(super) mod joint_solve;
pub(super) mod model_solve;
pub(super) mod picture_solve;
