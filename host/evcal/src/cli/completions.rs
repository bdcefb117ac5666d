//! `evcal completions`.

use clap_complete::Shell;

use super::{help, print};

/// Arguments of `evcal completions`.
#[derive(clap::Args)]
pub struct Arguments {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Runs `evcal completions`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut help::command(), "evcal", &mut text);
    print::text(&String::from_utf8_lossy(&text))
}
