//! The `evcal` program. Each subcommand is a module of `cli`; the algorithms are in the libraries.
// These lints hold because no input may cause a panic.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable)]

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
