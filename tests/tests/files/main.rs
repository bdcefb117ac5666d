//! Files that evcal reads and writes, against other programs, and the documents of the project.

mod board;
mod calibration_file;
mod camera_yaml;
mod circles;
mod corpus;
mod exports;
mod formats;
mod image_topics;
mod links;
mod recordings;
mod undistort;
