//! The one thing to do next.

use std::path::Path;

use super::{Checked, Seen};
use crate::files::shell_word::shell_word;

/// Share of events that may lie outside of the sensor, or come from hot pixels.
const FEW_EVENTS: f64 = 0.05;
/// Share of the time in which the board should be seen, and of the sensor that it should cover.
const ENOUGH: f64 = 0.3;
/// Shorter recordings have too little in them (s).
const SHORT: f64 = 2.0;

/// What to do with this recording, the most important thing alone.
pub fn next_step(checked: &Checked, path: &Path) -> String {
    let information = &checked.information;
    if let Some(error) = &information.error {
        return format!("the recording is damaged, {error}");
    }
    if information.events == 0 {
        return "there are no events: record again, and see that the lens cap is off".to_owned();
    }
    if let Some(other) = &checked.other_unit {
        return other.advice();
    }
    if information.sensor.is_none() {
        return match information.likely_sensor {
            Some(likely) => format!("add --sensor {}x{}", likely.width, likely.height),
            None => "add --sensor WIDTHxHEIGHT, the size of the camera's sensor".to_owned(),
        };
    }
    let outside = information.report.out_of_range;
    if outside as f64 > FEW_EVENTS * (information.events + outside) as f64 {
        return if information.report.looks_exchanged() {
            "x and y are exchanged: say where they are with --columns, or turn the numbers of --sensor".to_owned()
        } else {
            format!("{outside} events lie outside of the sensor: give its true size with --sensor")
        };
    }
    match &checked.seen {
        None => "the sensor is larger than evcal supports".to_owned(),
        Some(seen) => next_of_board(checked, seen, path),
    }
}

/// What to do about the board.
fn next_of_board(checked: &Checked, seen: &Seen, path: &Path) -> String {
    let Seen { board, found, time_share: share, covered, failure, recognised, edges, .. } = seen;
    if let Some(failure) = failure {
        return failure.clone();
    }
    if let (Some(flicker), true) = (checked.information.flicker, *share < ENOUGH) {
        return format!(
            "the light flickers at {} Hz and hides the board: use daylight or a lamp on direct current",
            flicker.frequency
        );
    }
    let hot: u64 = checked.information.hottest_pixels.iter().map(|pixel| pixel.events).sum();
    if hot as f64 > FEW_EVENTS * checked.information.events as f64 && *share < ENOUGH {
        return "hot pixels send much of what there is: raise the camera's thresholds, and record again".to_owned();
    }
    let Some(board) = board else {
        return match (found, recognised) {
            (0, _) => "no circles were seen: is the board in view, in focus and moving?".to_owned(),
            (_, Some(layout)) => format!("the board is {layout}: {}", layout.advice()),
            (_, None) => {
                "circles were seen: add --board LAYOUT:ROWSxCOLUMNS:SPACING:rRADIUS to look for your board".to_owned()
            }
        };
    };
    if *share < ENOUGH {
        return format!(
            "the board is seen in {:.0} % of the time only: keep all of it in view and in focus, and moving",
            100.0 * share
        );
    }
    if *covered < ENOUGH {
        return format!(
            "the board was in {:.0} % of the image only: move it into the corners and closer, and record again",
            100.0 * covered
        );
    }
    if edges.is_some_and(|edges| edges.is_blurred()) {
        return "the circles are blurred: focus the lens on the distance of the board, and clean it".to_owned();
    }
    if checked.whole && checked.information.duration_s < SHORT {
        return "the recording is short: record 10 seconds".to_owned();
    }
    format!("evcal calibrate {} --board {board} -o calibration", shell_word(&path.to_string_lossy()))
}
