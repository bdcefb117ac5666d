//! Search for the board in the camera's own pictures: dark spots, dots, search; corners of tags with the lens.

pub mod dark_spots;
pub mod dot;
pub mod search;
pub mod settings;
pub mod tag_corners;
