//! The program as its users run it, and what it says to them.

mod camera;
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
mod progress;
mod regressions;
mod settings_documented;
#[cfg(target_os = "linux")]
mod signals;
mod undistortion_tables;
