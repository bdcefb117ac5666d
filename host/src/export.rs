//! Files that other programs load.

pub mod opencv_yaml;
