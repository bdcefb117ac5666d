//! Tests that run the program as its users do.

mod camera;
mod camera_files;
mod circle_stream;
mod command;
mod convert;
#[cfg(target_os = "linux")]
mod emulated;
mod examples;
mod exit_codes;
mod first_contact;
mod help;
mod live;
mod mistakes;
mod page;
mod printed_commands;
mod progress;
mod regressions;
mod settings_documented;
#[cfg(target_os = "linux")]
mod signals;
mod undistortion_tables;
