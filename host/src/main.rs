//! The `evcal` program: one file a subcommand in `cli`, no algorithm here.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
