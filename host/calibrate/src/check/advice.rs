//! The most important next step.

use super::{Checked, Seen};
use crate::advice::{Advice, Outside};
use crate::quality::verdict::{Finding, Severity};
use evcal_detection::detection::exchanged::Exchanged;
use evcal_detection::detection::focus::EdgeWidth;
use evcal_detection::detection::still_views::FEWEST_VIEWS;
use evcal_detection::detection::{FEWEST_EVENTS, too_short};
use evcal_detection::diagnosis::disorder::Disorder;
use evcal_detection::diagnosis::information::Information;
use event_recordings::{Recording, RecordingOptions};

/// Share of events outside the sensor from which advice is given.
const FEW_EVENTS: f64 = 0.05;
/// Smallest share of the time in which the board should be seen, and of the sensor that it should cover.
const ENOUGH: f64 = 0.3;
/// Shortest useful recording (s).
const SHORT: f64 = 2.0;

/// Returns the most important advice on this recording; `of_board` is what is known about the stated board.
pub fn next_step(checked: &Checked, of_board: Option<&Finding>, recording: &Recording) -> Advice {
    let information = &checked.information;
    if let Some(error) = &information.error {
        return Advice::Plain(format!("the recording is damaged, {error}"));
    }
    let outside = information.report.out_of_range;
    if information.events == 0 && outside == 0 {
        return "there are no events: record again, and see that the lens cap is off".into();
    }
    // A few events do not even determine the unit of their timestamps.
    if checked.whole && outside == 0 && information.events < FEWEST_EVENTS {
        return Advice::Plain(format!("{}: record 10 seconds", too_short(information.events)));
    }
    if information.events == 0 {
        return advice_on_outside(information, recording.format().uses.columns);
    }
    if let Some(other) = &checked.other_unit {
        return Advice::NameTimeUnit(other.unit);
    }
    let is_known = checked.seen.as_ref().is_some_and(Seen::shows_a_known_board);
    if let (Some(coarse), false) = (information.coarse_times, is_known) {
        return Finding::from(coarse).into();
    }
    if let Some(sensor) = checked.counted_from_one {
        return Advice::CountFromZero { sensor, name_sensor: information.sensor.is_none() };
    }
    if information.sensor.is_none() {
        return Advice::NameSensor(information.likely_sensor);
    }
    if outside as f64 > FEW_EVENTS * (information.events + outside) as f64 {
        return advice_on_outside(information, recording.format().uses.columns);
    }
    if let Some(polarity) = information.only_polarity() {
        return Advice::BothPolarities(polarity);
    }
    if let Some(disorder) = Disorder::met(&information.report) {
        return Finding::from(disorder).into();
    }
    if let Some(rounded) = checked.pixels.rounded {
        return Finding::from(rounded).into();
    }
    // Silent lines that make a calibration wrong or impossible; others are only broken.
    let silent = checked.pixels.silent.as_ref().map(Finding::from);
    if let Some(silent) = silent.filter(|silent| silent.severity > Severity::Note) {
        return silent.into();
    }
    if let (Some(repeated), None) = (checked.pixels.repeated, information.coarse_times) {
        return Finding::from(repeated).into();
    }
    if let Some(edges) = checked.double_edges {
        return Finding::from(edges).into();
    }
    if let Some(lost) = checked.lost_events {
        return Finding::from(lost).into();
    }
    match &checked.seen {
        None => "the sensor is larger than evcal supports".into(),
        Some(seen) => match (next_of_board(checked, seen, recording), of_board) {
            (Advice::Calibrate { .. }, Some(finding)) if finding.severity > Severity::Note => finding.clone().into(),
            (next, _) => next,
        },
    }
}

/// Returns advice on many events outside the sensor.
fn advice_on_outside(information: &Information, has_columns: bool) -> Advice {
    let report = &information.report;
    if report.are_coordinates_exchanged() {
        return Advice::ExchangeAxes;
    }
    let count = report.out_of_range;
    let no_pixels = report.no_pixel as f64 > FEW_EVENTS * (information.events + count) as f64;
    let outside = if information.events == 0 { Outside::All } else { Outside::Some(count) };
    if has_columns && (no_pixels || outside == Outside::All) {
        Advice::NameColumns(outside)
    } else {
        Advice::CorrectSensor(outside)
    }
}

/// Returns advice on the board.
fn next_of_board(checked: &Checked, seen: &Seen, recording: &Recording) -> Advice {
    let Seen { board, found, time_share: share, covered, failure, recognised, edges, exchanged, .. } = seen;
    if let Some(exchanged) = exchanged {
        return Advice::Plain(format!("{exchanged}: {}", Exchanged::ADVICE));
    }
    if let Some(failure) = failure {
        return failure.advice();
    }
    if seen.is_at_rest {
        return next_at_rest(seen, recording);
    }
    if let (Some(flicker), true) = (checked.information.flicker, *share < ENOUGH) {
        return Finding::from(flicker).into();
    }
    if let (Some(hot), true) = (checked.pixels.hot, *share < ENOUGH) {
        return Finding::from(hot).into();
    }
    let Some(board) = board else {
        return match (found, recognised) {
            (0, None) => "no circles were seen: is the board in view, in focus and moving?".into(),
            (_, Some(found)) => Advice::Measure(*found),
            (_, None) => Advice::NameBoard,
        };
    };
    if *share < ENOUGH {
        return Advice::Plain(format!(
            "the board is seen in {:.0} % of the time only: keep all of it in view and in focus, and moving",
            100.0 * share
        ));
    }
    if *covered < ENOUGH {
        return Advice::Plain(format!(
            "the board was in {:.0} % of the image only: move it into the corners and closer, and record again",
            100.0 * covered
        ));
    }
    if let Some(edges) = edges.filter(EdgeWidth::is_blurred) {
        return Finding::from(edges).into();
    }
    if checked.whole && checked.information.duration_s < SHORT {
        return "the recording is short: record 10 seconds".into();
    }
    calibrate(recording, board)
}

fn calibrate(recording: &Recording, board: &str) -> Advice {
    let options = RecordingOptions { growth: None, ..recording.options().clone() };
    Advice::Calibrate { recording: recording.path().to_owned(), options, board: board.to_owned() }
}

/// Returns advice on a board that blinks.
fn next_at_rest(seen: &Seen, recording: &Recording) -> Advice {
    let Some(board) = &seen.board else {
        let name = || "something blinks in front of a camera at rest, but no board was recognised: name it".into();
        return seen.recognised.map_or_else(name, Advice::Measure);
    };
    if seen.found >= FEWEST_VIEWS as u64 {
        return calibrate(recording, board);
    }
    Advice::Plain(format!(
        "calibrate from {FEWEST_VIEWS} or more such views together, of one recording or many: half a second each, from all sides, near, and with the board in all corners of the image"
    ))
}

#[cfg(test)]
mod tests {
    use evcal_core::event::{Event, Polarity};
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::check::check;
    use evcal_detection::detection::pictures::settings::PictureSettings;
    use evcal_detection::detection::settings::DetectionSettings;

    const DAVIS: Option<Sensor> = Some(Sensor::new(346, 260));

    fn next(recording: &Recording) -> Advice {
        check(recording, None, None, &DetectionSettings::default(), &PictureSettings::default()).unwrap().next
    }

    fn next_of(events: Vec<Event>, sensor: Option<Sensor>) -> Advice {
        next(&Recording::from_events("events", events, RecordingOptions { sensor, ..RecordingOptions::default() }))
    }

    /// Events 10 µs apart all over the sensor, ON and OFF.
    fn events(count: u16) -> Vec<Event> {
        let polarity = |index: u16| if index.is_multiple_of(2) { Polarity::On } else { Polarity::Off };
        let event = |index: u16| Event {
            t: 10 * i64::from(index),
            x: index % 346,
            y: index % 260,
            polarity: polarity(index / 3),
        };
        (0..count).map(event).collect()
    }

    /// The advice is about the polarity, not to focus the lens.
    #[test]
    fn one_polarity_is_reported() {
        let on = |event: Event| Event { polarity: Polarity::On, ..event };
        let advice = next_of(events(20_000).into_iter().map(on).collect(), DAVIS);
        assert_eq!(advice, Advice::BothPolarities(Polarity::On));
        assert!(advice.to_string().starts_with("all events are ON, and a circle is found from ON and OFF"), "{advice}");
        assert!(!next_of(events(20_000), DAVIS).to_string().contains("all events"));
    }

    /// The advice is to count from 0, not to state a larger sensor or to calibrate.
    #[test]
    fn pixels_counted_from_one_are_reported() {
        let one = |event: Event| Event { x: event.x + 1, y: event.y + 1, ..event };
        let counted: Vec<Event> = events(20_000).into_iter().map(one).collect();
        let sensor = Sensor::new(346, 260);
        let advice = Advice::CountFromZero { sensor, name_sensor: false };
        assert_eq!(
            advice.to_string(),
            "pixels are counted from 1, up to column 346 and row 260: subtract 1 from x and y"
        );
        assert_eq!(next_of(counted.clone(), DAVIS), advice);
        assert_eq!(next_of(counted, None), Advice::CountFromZero { sensor, name_sensor: true });
        assert_eq!(next_of(events(20_000), None), Advice::NameSensor(DAVIS));
    }

    #[test]
    fn repeated_events_are_reported() {
        let twice = events(20_000).into_iter().flat_map(|event| [event, event]).collect();
        let advice = next_of(twice, DAVIS).to_string();
        assert!(
            advice.starts_with("50 % of the events repeat another") && advice.contains("export each event once"),
            "{advice}"
        );
    }

    /// The advice is to record more, not to move faster.
    #[test]
    fn a_recording_of_few_events_is_reported_as_too_short() {
        assert_eq!(
            next_of(events(1), DAVIS).to_string(),
            "the recording is too short, with only 1 event: record 10 seconds"
        );
        assert_eq!(
            next_of(events(10), None).to_string(),
            "the recording is too short, with only 10 events: record 10 seconds"
        );
    }

    /// The advice is about the columns, not to take off the lens cap.
    #[test]
    fn columns_in_another_order_are_reported() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.txt");
        // x, y, time and polarity, read as time, x, y and polarity.
        let lines: String =
            (0..2000).map(|index| format!("{} {} {} 1\n", index % 346, index % 260, 40_000 + index)).collect();
        std::fs::write(&path, lines).unwrap();
        for sensor in [DAVIS, None] {
            let options =
                RecordingOptions { sensor, columns: Some("t,x,y,p".parse().unwrap()), ..RecordingOptions::default() };
            let advice = next(&Recording::new(&path, options).unwrap());
            assert_eq!(advice, Advice::NameColumns(Outside::All));
        }
    }
}
