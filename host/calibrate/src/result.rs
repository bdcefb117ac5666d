//! Results of a calibration: the calibration file, the camera for other programs, and the reports of all stages.

pub mod calibrated_camera;
pub mod calibration_file;
mod correlated;
pub mod device_description;
pub mod device_verdicts;
pub mod inertial_result;
pub mod printed_board;
pub mod same_camera;
pub mod second_camera_result;
pub mod stage_lines;
pub mod stage_report;
