//! The command line: parsing, exit codes, and one module per subcommand.
//!
//! Exit codes: 0 success; 1 failure, with the reason on standard error; 2 wrong usage; 3 a negative result: the calibration is not good
//! enough, the calibrations are not of the same camera, or the recording is not ready for a calibration.

mod board;
mod board_argument;
mod calibrate;
mod camera_arguments;
mod check;
mod circles_only;
mod compare;
mod completions;
mod convert;
mod detect;
mod devices;
mod evaluate;
mod examples;
mod export;
mod failure;
mod help;
mod info;
mod interrupt;
mod live;
mod man;
mod mistaken;
mod output_arguments;
mod print;
mod progress;
mod record;
mod repeat;
mod settings;
mod simulate;
mod source_arguments;
mod undistort;
mod value;

use std::process::ExitCode;

use clap::{FromArgMatches as _, Parser, Subcommand};
use evcal_files::shell_word::shell_word;

use self::failure::{Failure, Negative, UsageError};

/// Calibrates an event camera from the events of a printed board.
#[derive(Parser)]
#[command(name = "evcal", version, propagate_version = true, after_help = examples::EVCAL)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// Number of threads, 1 to 1024; the result does not depend on it [default: one per core]
    #[arg(long, global = true, value_name = "COUNT", value_parser = value::count(1..=1024))]
    threads: Option<u16>,
}

#[derive(Subcommand)]
enum Command {
    /// Calibrate a camera from one or more recordings of a board
    #[command(after_help = examples::CALIBRATE)]
    Calibrate(calibrate::Arguments),
    /// Find the board's circles in a recording and write them to a file
    #[command(after_help = examples::DETECT)]
    Detect(detect::Arguments),
    /// List the connected cameras
    #[command(after_help = examples::DEVICES)]
    Devices(devices::Arguments),
    /// Record a camera
    #[command(after_help = examples::RECORD)]
    Record(record::Arguments),
    /// Record a camera with guidance until the recording is good enough, then calibrate
    #[command(after_help = examples::LIVE)]
    Live(live::Arguments),
    /// Show what a recording contains
    #[command(after_help = examples::INFO)]
    Info(info::Arguments),
    /// Examine samples of a recording: is it good for a calibration, and what to do next?
    #[command(after_help = examples::CHECK)]
    Check(check::Arguments),
    /// Convert a recording to another format
    #[command(after_help = examples::CONVERT)]
    Convert(convert::Arguments),
    /// Compare a calibration with the truth, another calibration or a trajectory
    #[command(after_help = examples::EVALUATE)]
    Evaluate(evaluate::Arguments),
    /// Test whether two calibrations are of the same camera
    #[command(after_help = examples::COMPARE)]
    Compare(compare::Arguments),
    /// Calibrate random parts of a recording to measure repeatability
    #[command(after_help = examples::REPEAT)]
    Repeat(repeat::Arguments),
    /// Export a calibration for other programs and devices
    #[command(after_help = examples::EXPORT)]
    Export(export::Arguments),
    /// Remove the distortion of the lens from recordings and pictures
    #[command(after_help = examples::UNDISTORT)]
    Undistort(undistort::Arguments),
    /// Print a board at exact scale
    #[command(after_help = examples::BOARD)]
    Board(board::Arguments),
    /// Simulate an event camera in front of a board
    #[command(after_help = examples::SIMULATE)]
    Simulate(simulate::Arguments),
    /// Print a script that lets a shell complete commands and options
    #[command(after_help = examples::COMPLETIONS)]
    Completions(completions::Arguments),
    /// Write the manual pages
    #[command(after_help = examples::MAN)]
    Man(man::Arguments),
}

#[cfg(unix)]
impl Command {
    /// Returns whether the subcommand handles signals and ends by itself.
    fn takes_signals(&self) -> bool {
        matches!(self, Self::Record(_) | Self::Live(_))
    }
}

/// Returns the command line for a shell, without the number of threads and with `DIR` as the output folder: neither changes a result, so
/// files that contain the command stay the same.
fn command_line() -> String {
    repeatable(std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()))
}

fn repeatable(mut words: impl Iterator<Item = String>) -> String {
    let mut command = vec!["evcal".to_owned()];
    while let Some(word) = words.next() {
        let name = word.split('=').next().unwrap_or_default();
        let has_value_after = name == word && matches!(name, "--threads" | "-o" | "--output");
        if has_value_after {
            words.next();
        }
        match name {
            "--threads" => {}
            "--output" => command.push("-o DIR".to_owned()),
            _ if name.starts_with("-o") => command.push("-o DIR".to_owned()),
            _ => command.push(shell_word(&word)),
        }
    }
    command.join(" ")
}

/// Result of a subcommand; `run` prints a failure and sets the exit code.
type Outcome = Result<(), Failure>;

/// Runs the program.
pub fn run() -> ExitCode {
    // clap exits with 2 on wrong usage.
    let words = || std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned());
    let matches = help::command().try_get_matches().unwrap_or_else(|error| mistaken::explained(error, words()).exit());
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    if let Some(threads) = arguments.threads
        && let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()
    {
        print::aside(format!("cannot use {threads} threads: {error}"));
        return ExitCode::FAILURE;
    }
    #[cfg(unix)]
    if !arguments.command.takes_signals()
        && let Err(error) = interrupt::leave_nothing_unfinished()
    {
        print::aside(format!("cannot take signals: {error}"));
        return ExitCode::FAILURE;
    }
    let outcome = match arguments.command {
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Detect(arguments) => detect::run(&arguments),
        Command::Devices(arguments) => devices::run(&arguments),
        Command::Record(arguments) => record::run(&arguments),
        Command::Live(arguments) => live::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(arguments),
        Command::Repeat(arguments) => repeat::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Undistort(arguments) => undistort::run(&arguments),
        Command::Board(arguments) => board::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments),
        Command::Man(arguments) => man::run(&arguments),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.print(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_have_neither_threads_nor_output_folder() {
        for output in [&["-o", "out"][..], &["-oout"], &["--output", "out"], &["--output=out"]] {
            let words =
                [&["--threads", "2", "calibrate", "my a=b.csv"][..], output, &["--threads=3", "--json"]].concat();
            let command = repeatable(words.into_iter().map(str::to_owned));
            assert_eq!(command, "evcal calibrate 'my a=b.csv' -o DIR --json");
        }
    }
}
