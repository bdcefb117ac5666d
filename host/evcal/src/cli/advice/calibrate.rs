//! Advice about calibrations, boards and the page, with options and commands of the program.

use std::error::Error;

use evcal_calibrate::advice::Advice;
use evcal_calibrate::calibrate::repeat::{RepeatError, shorter_parts};
use evcal_calibrate::evaluate::captured::CapturedError;
use evcal_calibrate::evaluate::comparison::{CompareError, TrajectoryOf};
use evcal_calibrate::inertial::error::{IN_DEGREES, IN_G, InertialError};
use evcal_calibrate::picture_calibration::calibration::PictureFailure;
use evcal_calibrate::second_camera::error::SecondCameraError;
use evcal_calibrate::task::board_choice::BoardChoiceError;
use evcal_calibrate::task::error::CalibrateError;
use evcal_calibrate::task::parameter_request::ParameterError;
use evcal_calibrate::undistort::target::TargetError;
use evcal_core::circle::Extraction;
use evcal_detection::circles::file::EventsError;
use evcal_detection::detection::no_board::NoBoard;
use evcal_detection::detection::recognition::other_board::OtherReading;
use evcal_detection::detection::recognition::radius::OtherRadius;
use evcal_detection::detection::{NoPattern, NoPatternCause};
use evcal_geometry::board::sheet::DoesNotFit;
use evcal_geometry::board::{BoardError, BoardProblem, CircleBoardError};
use evcal_live::page::PageError;
use evcal_solve::initial::InitialError;
use evcal_solve::motion_capture::file::{CaptureError, CaptureFileError};

use super::super::source_arguments::command;
use super::recordings::add_sensor;

/// Returns advice about an error of evcal-calibrate, evcal-geometry or evcal-live.
pub fn advice(error: &(dyn Error + 'static)) -> Option<String> {
    if let Some(EventsError::Circles(_)) = error.downcast_ref() {
        return Some("evcal calibrate reads this file; other commands need the recording".to_owned());
    }
    let of_boards = || {
        let known = error.downcast_ref().and_then(about_no_pattern);
        let known = known.or_else(|| error.downcast_ref().map(about_radius));
        let known = known.or_else(|| error.downcast_ref().and_then(about_board_choice));
        let known = known.or_else(|| error.downcast_ref().and_then(about_board));
        known.or_else(|| error.downcast_ref().and_then(about_sheet))
    };
    let of_others = || {
        let known = error.downcast_ref().and_then(about_second_camera);
        let known = known.or_else(|| error.downcast_ref().and_then(about_inertial));
        let known = known.or_else(|| error.downcast_ref().and_then(about_capture));
        known.map(str::to_owned)
    };
    let of_results = || {
        let known = error.downcast_ref().and_then(about_captured);
        let known = known.or_else(|| error.downcast_ref().and_then(about_comparison));
        let known = known.or_else(|| error.downcast_ref().and_then(about_target));
        known.or_else(|| error.downcast_ref().map(about_page)).map(str::to_owned)
    };
    let of_calibration = error.downcast_ref().and_then(about_calibration);
    let of_calibration = of_calibration.or_else(|| error.downcast_ref().and_then(about_initial).map(str::to_owned));
    let of_calibration = of_calibration.or_else(|| error.downcast_ref().and_then(about_parameter).map(str::to_owned));
    let of_calibration = of_calibration.or_else(|| error.downcast_ref().and_then(about_parts));
    of_calibration.or_else(of_boards).or_else(of_others).or_else(of_results)
}

/// Returns `advice` with options of the command line.
pub fn worded(advice: &Advice) -> String {
    match advice {
        Advice::TakeModel(kind) => format!("calibrate again with --model {kind}"),
        Advice::TakeWholeBoard(board) => format!(
            "calibrate again with --board {board}, which uses more of the recording; the lens is correct within the reported uncertainty"
        ),
        Advice::CountRows => {
            "count rows and columns of the board: --board has more than the board, or a part of the board was never in view".to_owned()
        }
        Advice::CheckLensAndBoard => {
            "check whether the board is wavy or the lens dirty (a smooth bend and an uneven print are estimated, unless fixed with --fix)"
                .to_owned()
        }
        Advice::Free(names) => {
            let options: Vec<String> = names.iter().map(|name| format!("--free {name}")).collect();
            format!(
                "bring the board into the corners of the image, or estimate them anyway with {}",
                options.join(" ")
            )
        }
        Advice::NameSensor(Some(sensor)) => add_sensor(Some(*sensor)),
        Advice::NameSensor(None) => "add --sensor WIDTHxHEIGHT, the size of the camera's sensor".to_owned(),
        Advice::NameTimeUnit(Some(unit)) => format!("add --time-unit {}", unit.symbol()),
        Advice::CountFromZero { sensor, name_sensor: true } => {
            let without = Advice::CountFromZero { sensor: *sensor, name_sensor: false };
            format!("{without}, and {}", add_sensor(Some(*sensor)))
        }
        Advice::ExchangeAxes => {
            "x and y are swapped: correct --columns, or swap the two numbers of --sensor".to_owned()
        }
        Advice::NameColumns(outside) => {
            format!("{outside}: check the order of the columns, and give it with --columns, such as x,y,t,p")
        }
        Advice::CorrectSensor(outside) => format!("{outside}: give the true size of the sensor with --sensor"),
        Advice::BothPolarities(_) => format!("{advice} with --columns"),
        Advice::NameBoard => {
            "no board was recognised: describe it with --board, for example acircles:9x4:55mm:r17.5mm or checkerboard:6x9:25mm"
                .to_owned()
        }
        Advice::Measure(found) => {
            let measure = found.to_measure();
            format!("the board is {found}: {measure}, for example --board {}", found.example())
        }
        Advice::FindBoard(error) => {
            about_no_pattern(error).map_or_else(|| error.to_string(), |next| format!("{error}; {next}"))
        }
        Advice::CorrectRadius(error) => format!("{error}; {}", about_radius(error)),
        Advice::Calibrate { recording, options, board } => {
            command("calibrate", recording, options, &["--board", board, "-o", "calibration"])
        }
        others => others.to_string(),
    }
}

fn about_calibration(error: &CalibrateError) -> Option<String> {
    let next = match error {
        CalibrateError::TimeUnit { unit, .. } => return Some(worded(&Advice::NameTimeUnit(unit.unit))),
        CalibrateError::LargerBoard(larger) => return Some(format!("use --board {}", larger.board)),
        CalibrateError::ImpossibleValues => "change the values of --fix",
        CalibrateError::FixedFarOff => "leave out --fix",
        CalibrateError::OnlyFrames { .. } => {
            "add --frames-only, or give a recording of events first and the frames with --with"
        }
        CalibrateError::Views(none) => return Some(about_views(&none.reason).to_owned()),
        CalibrateError::BlinkingWithFrames { .. } => {
            "leave out --joint-frames or --with-frames: evcal then calibrates from the views"
        }
        CalibrateError::BoardOfPictures => "leave out --fix and --free of the board",
        CalibrateError::NoPictures { .. } => "record with --frames, or leave out the option that needs frames",
        _ => return None,
    };
    Some(next.to_owned())
}

fn about_views(failure: &PictureFailure) -> &'static str {
    match failure {
        PictureFailure::Initial(_) => "check --board and --model",
        PictureFailure::Undetermined { .. } => "add views with the board tilted to all sides",
        _ => {
            "give more views, of this recording or others: hold still for half a second each, with the board near, tilted to all sides, and all of it in view"
        }
    }
}

fn about_initial(error: &InitialError) -> Option<&'static str> {
    match error {
        InitialError::Mirrored { .. } => Some("flip x in the recording or correct --board"),
        InitialError::NoCamera { .. } => Some("check --board and --model"),
        _ => None,
    }
}

fn about_parameter(error: &ParameterError) -> Option<&'static str> {
    match error {
        ParameterError::Unknown { model: None, .. } => Some("give the camera model with --model"),
        ParameterError::Value(_) => Some("for example --fix k3=0"),
        ParameterError::Both(_) => Some("leave out --fix or --free"),
        _ => None,
    }
}

fn about_parts(error: &RepeatError) -> Option<String> {
    match error {
        RepeatError::TooFew { .. } => Some("try longer parts with --seconds".to_owned()),
        RepeatError::TooShort { duration, .. } => {
            shorter_parts(*duration).map(|seconds| format!("try --seconds {seconds:.1}s"))
        }
        _ => None,
    }
}

fn about_no_pattern(error: &NoPattern) -> Option<String> {
    let next = match error.main_cause() {
        NoPatternCause::OtherBoard(OtherReading::Board { board, .. }) => return Some(format!("use --board {board}")),
        NoPatternCause::OtherBoard(OtherReading::Kind(found)) => {
            return Some(format!("for example --board {}", found.example()));
        }
        NoPatternCause::AtRest(_) => "check the kind, rows and columns of --board",
        NoPatternCause::OnePolarity(_) => "give the column of the polarity with --columns",
        NoPatternCause::Windows(NoBoard::TooFewCircles, _) if error.extraction() == Extraction::Hard => {
            "try --extraction soft"
        }
        NoPatternCause::Windows(NoBoard::TooFewCircles | NoBoard::TooFewEvents | NoBoard::NotRound, _)
        | NoPatternCause::TooShort
        | NoPatternCause::Nothing => return None,
        NoPatternCause::Windows(..) => "check layout, rows and columns of --board",
    };
    Some(next.to_owned())
}

fn about_radius(error: &OtherRadius) -> String {
    let boards: Vec<String> = error.meant.iter().map(|(_, board)| format!("--board {board}")).collect();
    match boards.is_empty() {
        true => "give the measured lengths with --board".to_owned(),
        false => format!("use {}", boards.join(" or ")),
    }
}

fn about_board_choice(error: &BoardChoiceError) -> Option<String> {
    match error {
        BoardChoiceError::NoEvents => Some("for example --board acircles:9x4:55mm:r17.5mm".to_owned()),
        BoardChoiceError::NotRecognised { .. } => {
            Some("describe the board with --board: evcal board --help lists all kinds".to_owned())
        }
        BoardChoiceError::SizeUnknown { found } => Some(format!("for example --board {}", found.example())),
        BoardChoiceError::WrongRatio(ratio) => Some(format!("use --board {}", ratio.board)),
        BoardChoiceError::Other { found: OtherReading::Board { board, .. }, .. } => {
            Some(format!("use --board {board}"))
        }
        BoardChoiceError::Other { found: OtherReading::Kind(found), .. } => {
            Some(format!("for example --board {}", found.example()))
        }
        _ => None,
    }
}

fn about_board(error: &BoardError) -> Option<String> {
    match error {
        BoardError::Circles(error) => about_circle_board(error),
        BoardError::Squares(_) => None,
    }
}

fn about_circle_board(error: &CircleBoardError) -> Option<String> {
    match error.problem {
        BoardProblem::NoCircles(_) => Some("print one with evcal board --pdf board.pdf".to_owned()),
        BoardProblem::File => Some("give recordings without an option, not with --board".to_owned()),
        _ => None,
    }
}

fn about_sheet(error: &DoesNotFit) -> Option<String> {
    match (&error.largest, error.papers.is_empty()) {
        (_, true) => Some("give the size of your paper as --paper WIDTHxHEIGHTmm".to_owned()),
        (Some(largest), false) => Some(format!("print --board {largest}, or choose a larger --paper")),
        (None, false) => Some("choose a larger --paper".to_owned()),
    }
}

fn about_second_camera(error: &SecondCameraError) -> Option<&'static str> {
    match error {
        SecondCameraError::NoTrajectory => {
            Some("leave out --frames-only, and give a recording of events before --with")
        }
        SecondCameraError::CirclesOfSecond => Some("give its events with --with"),
        SecondCameraError::SeveralRecordings => Some("give one recording before --with"),
        SecondCameraError::SameRecording { .. } => Some("give the recording of another camera with --with"),
        SecondCameraError::RollingShutter { .. } => Some("add --rolling-shutter"),
        _ => None,
    }
}

fn about_inertial(error: &InertialError) -> Option<&'static str> {
    match error {
        InertialError::NoTrajectory => Some("leave out --frames-only"),
        InertialError::NoSamples { .. } => Some("record with the IMU enabled, or give its samples with --imu FILE.csv"),
        InertialError::OneTime { .. } | InertialError::Lacks { .. } => {
            Some("write them to a CSV file, and give it with --imu FILE.csv")
        }
        InertialError::UnitsOfFormat { .. } => Some("leave out --imu-units"),
        InertialError::AccelerationUnit { unit: IN_G, of_file: false, .. } => Some("add --imu-units g"),
        InertialError::AngularUnit { unit: IN_DEGREES, of_file: false, .. } => {
            Some("add --imu-units deg_s, or g,deg_s if accelerations are in g too")
        }
        InertialError::AccelerationUnit { of_file: false, .. } | InertialError::AngularUnit { of_file: false, .. } => {
            Some(
                "correct --imu-units, or write the samples with the units in its header to a CSV file, and give it with --imu FILE.csv",
            )
        }
        _ => None,
    }
}

fn about_capture(error: &CaptureFileError) -> Option<&'static str> {
    match error.reason {
        CaptureError::OtherBodies { .. } | CaptureError::SeveralBodies { .. } => Some("choose it with --body"),
        CaptureError::NoNames => Some("leave out --body"),
        _ => None,
    }
}

fn about_captured(error: &CapturedError) -> Option<&'static str> {
    matches!(error, CapturedError::Open { .. }).then_some("give it with --trajectory FILE")
}

fn about_comparison(error: &CompareError) -> Option<&'static str> {
    match error {
        CompareError::NoTrajectory { which: TrajectoryOf::Calibration, .. } => Some("give it with --trajectory FILE"),
        CompareError::NoTrajectory { which: TrajectoryOf::Truth, .. } => Some("give it with --true-trajectory FILE"),
        _ => None,
    }
}

fn about_target(error: &TargetError) -> Option<&'static str> {
    matches!(error, TargetError::RimUnseen).then_some("leave out --alpha, or use --model equidistant")
}

fn about_page(error: &PageError) -> &'static str {
    match error {
        PageError::Port { .. } => "choose another with --port, or run without a page with --no-page",
        PageError::System(_) => "add --no-page to run without a page",
    }
}
