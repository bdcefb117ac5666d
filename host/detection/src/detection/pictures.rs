//! Search for the board in the camera's own pictures: dark spots, dots, search; then points measured again, with the lens
//! and without the pattern of the pixels.

mod corner_fits;
pub mod dark_spots;
pub mod dot;
mod dot_fits;
pub mod pixel_pattern;
pub mod point_fits;
pub mod search;
pub mod settings;
