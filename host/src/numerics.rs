//! Mathematics that no stage owns: linear algebra, robust weights, statistics, rotations, random numbers.

pub mod banded;
pub mod random;
