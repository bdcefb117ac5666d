//! `evcal info`.

/// Arguments of `evcal info`.
#[derive(clap::Args)]
pub struct Arguments {}

/// Runs `evcal info`.
pub fn run(_arguments: &Arguments) -> super::Outcome {
    Err("not built yet".into())
}
