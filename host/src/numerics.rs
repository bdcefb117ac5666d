//! Mathematics that no stage owns: linear algebra, robust weights, statistics, rotations, random numbers.

pub mod banded;
pub mod huber;
pub mod random;
pub mod rigid;
pub mod statistics;
