//! `evcal evaluate`.

/// Arguments of `evcal evaluate`.
#[derive(clap::Args)]
pub struct Arguments {}

/// Runs `evcal evaluate`.
pub fn run(_arguments: &Arguments) -> super::Outcome {
    Err("not built yet".into())
}
