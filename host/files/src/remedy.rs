//! What to do about an error, in the words of the program that reports it.
//!
//! An error implements [`Remedy`] next to its message; one that wraps another passes the question on. The table in this file
//! contains the options that remedies name, once for each program.

use std::fmt::{self, Display};

/// An error that may have a remedy.
pub trait Remedy: Display {
    /// Returns what to do in the words of a program; `None` if the message says it, or the program has no option for it.
    fn remedy(&self, _say: &Words) -> Option<String> {
        None
    }

    /// Returns the message and the remedy in one sentence.
    fn advised(&self, say: &Words) -> String {
        match self.remedy(say) {
            Some(next) => format!("{self}; {next}"),
            None => self.to_string(),
        }
    }
}

impl Remedy for std::io::Error {}

/// Implements [`Remedy`] for an error by a table of its variants and their remedies: a text with its arguments, or an
/// expression such as the remedy of a wrapped error. Variants without a row have no remedy.
#[macro_export]
macro_rules! remedies {
    (@($error:ty, $say:ident) [$({$pattern:pat}{$next:expr})*]) => {
        impl $crate::remedy::Remedy for $error {
            fn remedy(&self, $say: &$crate::remedy::Words) -> Option<String> {
                $(if let $pattern = self {
                    return $next;
                })*
                None
            }
        }
    };
    (@$of:tt [$($rows:tt)*] $pattern:pat => $text:literal $(, $word:expr)*; $($rest:tt)*) => {
        $crate::remedies! { @$of [$($rows)* {$pattern}{Some(format!($text $(, $word)*))}] $($rest)* }
    };
    (@$of:tt [$($rows:tt)*] $pattern:pat => $next:expr; $($rest:tt)*) => {
        $crate::remedies! { @$of [$($rows)* {$pattern}{$next}] $($rest)* }
    };
    ($error:ty, $say:ident; $($rows:tt)*) => {
        $crate::remedies! { @($error, $say) [] $($rows)* }
    };
}

/// Name of an option, an argument or a command in a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Word(&'static str);

impl Word {
    /// Returns the option with this value, as users write it.
    pub fn with(self, value: impl Display) -> String {
        let Self(name) = self;
        if name.ends_with('=') { format!("{name}\"{value}\"") } else { format!("{name} {value}") }
    }

    /// Returns the option with this time.
    pub fn with_seconds(self, seconds: f64) -> String {
        let Self(name) = self;
        if name.ends_with('=') { format!("{name}{seconds:.1}") } else { format!("{name} {seconds:.1}s") }
    }
}

impl Display for Word {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}

/// Makes [`Words`] from three tables: words that also findings need, words of errors, and those that only the program has.
macro_rules! words {
    (
        { $($of_all:ident: $program:literal, $python:literal, $library:literal;)* }
        { $($of_both:ident: $of_program:literal, $of_python:literal;)* }
        { $($of_one:ident: $alone:literal;)* }
    ) => {
        /// The names that a program has for options, arguments and commands; `None` if it lacks them.
        #[derive(Debug, PartialEq, Eq)]
        pub struct Words {
            $(#[doc = concat!("`", $program, "`")] pub $of_all: Word,)*
            $(#[doc = concat!("`", $of_program, "`")] pub $of_both: Option<Word>,)*
            $(#[doc = concat!("`", $alone, "`")] pub $of_one: Option<Word>,)*
        }

        impl Words {
            /// The words of the program `evcal`.
            pub const PROGRAM: Self = Self {
                $($of_all: Word($program),)*
                $($of_both: Some(Word($of_program)),)*
                $($of_one: Some(Word($alone)),)*
            };
            /// The words of the Python package.
            pub const PYTHON: Self = Self {
                $($of_all: Word($python),)*
                $($of_both: Some(Word($of_python)),)*
                $($of_one: None,)*
            };
            /// Words for other programs, which have no options of evcal.
            pub const LIBRARY: Self = Self {
                $($of_all: Word($library),)*
                $($of_both: None,)*
                $($of_one: None,)*
            };
        }
    };
}

words! {
    {
        board: "--board", "board=", "the board";
        model: "--model", "model=", "the camera model";
        sensor: "--sensor", "sensor=", "the sensor size";
        columns: "--columns", "columns=", "the order of columns";
        time_unit: "--time-unit", "time_unit=", "the time unit";
    }
    {
        alpha: "--alpha", "alpha=";
        calibrate: "evcal calibrate", "evcal.calibrate";
        equidistant: "--model equidistant", "projection=\"equidistant\"";
        force: "--force", "force=True";
        frames_jointly: "--joint-frames or --with-frames", "frames=\"joint\"";
        frames_only: "--frames-only", "frames=\"only\"";
        imu_file: "--imu FILE.csv", "imu=\"samples.csv\"";
        of_calibrations: "evcal export, evaluate, compare and undistort -c", "evcal.Camera.load";
        rolling_shutter: "--rolling-shutter", "rolling_shutter=True";
        seconds: "--seconds", "seconds=";
        stream: "--stream", "stream=";
        to: "--to", "to=";
        unix_time: "--unix-time", "unix_time=True";
        with: "--with", "with_=";
        with_stream: "--with-stream", "with_stream=";
    }
    {
        board_help: "evcal board --help";
        board_pdf: "evcal board --pdf board.pdf";
        body: "--body";
        device: "--device";
        extraction: "--extraction";
        fix: "--fix";
        follow: "--follow";
        frames: "--frames";
        free: "--free";
        imu_units: "--imu-units";
        no_page: "--no-page";
        output: "-o";
        paper: "--paper";
        port: "--port";
        skip_damaged: "--skip-damaged";
        trajectory: "--trajectory FILE";
        true_trajectory: "--true-trajectory FILE";
        undistort: "evcal undistort";
    }
}

impl Words {
    /// Returns the option for the size of the sensor with these numbers, or with placeholders.
    pub fn size(&self, width: impl Display, height: impl Display) -> String {
        match self.sensor {
            Word(name) if name.ends_with('=') => format!("{name}({width}, {height})"),
            name => format!("{name} {width}x{height}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    enum Mistake {
        #[error("the file exists")]
        File,
        #[error("{0}")]
        Wrapped(Box<Self>),
        #[error("the disk is full")]
        Disk,
    }

    crate::remedies! { Mistake, say;
        Self::File => "replace it with {}, or skip damage with {}", say.force?, say.skip_damaged?;
        Self::Wrapped(error) => error.remedy(say);
    }

    #[test]
    fn a_remedy_needs_a_row_and_all_its_options() {
        let wrapped = Mistake::Wrapped(Box::new(Mistake::File));
        let whole = "the file exists; replace it with --force, or skip damage with --skip-damaged";
        assert_eq!(wrapped.advised(&Words::PROGRAM), whole);
        assert_eq!(wrapped.advised(&Words::PYTHON), "the file exists");
        assert_eq!(Mistake::Disk.remedy(&Words::PROGRAM), None);
    }

    #[test]
    fn values_are_written_as_in_a_shell_in_python_and_in_a_sentence() {
        let board = |say: Words| say.board.with("auto:25mm");
        assert_eq!(board(Words::PROGRAM), "--board auto:25mm");
        assert_eq!(board(Words::PYTHON), "board=\"auto:25mm\"");
        assert_eq!(board(Words::LIBRARY), "the board auto:25mm");
        assert_eq!(Words::PROGRAM.size(346, 260), "--sensor 346x260");
        assert_eq!(Words::PYTHON.size("width", "height"), "sensor=(width, height)");
    }
}
