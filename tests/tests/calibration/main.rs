//! Recordings and their calibrations: how true they are, and what the program says of them.

mod accuracy;
mod bad_input;
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
mod uncertainty;
mod verdicts;
