//! Calibrations of simulated and real recordings: accuracy, uncertainty, verdicts and error messages.

mod accuracy;
mod bad_input;
mod default_model;
mod frames;
mod inertial;
mod long_recordings;
mod motion_capture;
mod printed_board;
mod raw_dump;
mod regressions;
mod report;
mod second_camera;
mod squares;
mod stage_texts;
mod stated_boards;
mod two_cameras;
mod uncertainty;
mod verdicts;
mod views;
