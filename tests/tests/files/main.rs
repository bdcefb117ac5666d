//! Comparison of evcal's files and camera models with other programs.

mod board;
mod calibration_file;
mod camera_files;
mod camera_models;
mod camera_yaml;
mod circles;
mod corpus;
mod exports;
mod formats;
mod image_topics;
mod recordings;
mod undistort;
