//! Mathematics shared by all stages: linear algebra, robust weights, statistics, time series, rotations, random
//! numbers.

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
