//! Files that other programs load.

pub mod opencv_camera;
pub mod opencv_yaml;
pub mod undistortion_table;
