//! Files that other programs load.

pub mod opencv_yaml;
pub mod undistortion_table;
