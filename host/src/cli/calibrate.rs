//! `evcal calibrate`.

/// Arguments of `evcal calibrate`.
#[derive(clap::Args)]
pub struct Arguments {}

/// Runs `evcal calibrate`.
pub fn run(_arguments: &Arguments) -> super::Outcome {
    Err("not built yet".into())
}
