//! evcal's own grid finder, poses and start against OpenCV's.

mod grid;
mod starts;
