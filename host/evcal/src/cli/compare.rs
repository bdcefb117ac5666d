//! `evcal compare`.

use std::path::PathBuf;

use evcal_calibrate::result::same_camera::{Sameness, compare_calibrations};

use super::{Negative, print};

/// Arguments of `evcal compare`.
#[derive(clap::Args)]
pub struct Arguments {
    /// A calibration: its folder or calibration.json
    #[arg(value_name = "FILE|DIR")]
    first: PathBuf,
    /// Another calibration
    #[arg(value_name = "FILE|DIR")]
    second: PathBuf,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `evcal compare`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let compared = compare_calibrations(&arguments.first, &arguments.second)?;
    if arguments.json {
        print::json(&compared)?;
    } else {
        print::line(&compared)?;
    }
    match compared.sameness {
        Sameness::Same => Ok(()),
        Sameness::Near | Sameness::Different | Sameness::Unknown => Err(Negative::Comparison.into()),
    }
}
