//! `evcal detect`.

/// Arguments of `evcal detect`.
#[derive(clap::Args)]
pub struct Arguments {}

/// Runs `evcal detect`.
pub fn run(_arguments: &Arguments) -> super::Outcome {
    Err("not built yet".into())
}
