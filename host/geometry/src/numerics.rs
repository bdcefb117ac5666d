//! Mathematics that no stage owns: linear algebra, robust weights, statistics, series in time, rotations, random numbers.

pub mod arrow;
pub mod banded;
pub mod gravity;
pub mod huber;
pub mod lag;
pub mod levenberg_marquardt;
pub mod panel;
pub mod random;
pub mod rigid;
pub mod statistics;
