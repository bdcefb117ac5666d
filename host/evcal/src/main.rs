//! The `evcal` program: one file a subcommand in `cli`, no algorithm here.
// No input makes it panic.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable)]

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
