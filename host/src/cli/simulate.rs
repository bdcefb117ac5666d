//! `evcal simulate`.

/// Arguments of `evcal simulate`.
#[derive(clap::Args)]
pub struct Arguments {}

/// Runs `evcal simulate`.
pub fn run(_arguments: &Arguments) -> super::Outcome {
    Err("not built yet".into())
}
