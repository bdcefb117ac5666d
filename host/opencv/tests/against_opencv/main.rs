//! Comparison of evcal's own grid finder, poses and start with OpenCV's.

mod grid;
mod starts;
