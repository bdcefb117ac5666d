//! Diagnosis of a recording without a board: camera, light and readout.

pub mod bad_pixels;
pub mod disorder;
pub mod double_edges;
pub mod fingerprint;
pub mod flicker;
pub mod information;
pub mod lost_events;
pub mod rounded;
pub mod saturation;
pub mod silent_lines;
mod time_bins;
pub mod time_steps;
