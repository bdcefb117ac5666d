//! evcal's own camera models, grid finder, poses and start against OpenCV's.

mod camera;
mod grid;
mod starts;
