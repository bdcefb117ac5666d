//! Search for the board in the camera's own pictures: dark spots, dots, search; corners of squares with the lens.

pub mod corner_fits;
pub mod dark_spots;
pub mod dot;
pub mod search;
pub mod settings;
