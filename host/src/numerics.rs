//! Mathematics that no stage owns: linear algebra, robust weights, statistics, rotations, random numbers.

pub mod arrow;
pub mod banded;
pub mod huber;
pub mod levenberg_marquardt;
pub mod random;
pub mod rigid;
pub mod statistics;
