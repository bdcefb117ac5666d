//! Statistics of events, windows and circles in the detection.

use std::collections::BTreeMap;

use std::fmt;

use evcal_core::circle::{CircleCounts, Extraction};
use evcal_core::event::{Event, Polarity};
use evcal_files::remedy::{Remedy, Words};
use serde::{Deserialize, Serialize};

use super::no_board::{NoBoard, only_one_polarity};
use super::settings::DetectionSettings;
use crate::detection::counted::counted;
use crate::detection::recognition::other_board::OtherReading;

/// Reason why a pair of clusters is not a circle. The order of the variants is the order in `calibration.json`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum NoCircle {
    /// The visible part of the circle is too short.
    #[serde(rename = "arc too short")]
    ArcTooShort,
    /// The clusters do not face each other.
    #[serde(rename = "arcs that do not face each other", alias = "back to back")]
    BackToBack,
    /// The fitted centre is far from the middle between the clusters.
    #[serde(rename = "centre not between the arcs", alias = "centre against midpoint")]
    CenterAgainstMidpoint,
    /// The pixels are too far from the fitted circle.
    #[serde(rename = "fit error")]
    FitError,
    /// A cluster has a better partner.
    #[serde(rename = "fits another cluster better", alias = "not mutual")]
    NotMutual,
    /// The fitted radius is inconsistent with the distance of the clusters.
    #[serde(rename = "radius does not fit the distance", alias = "radius against distance")]
    RadiusAgainstDistance,
    /// The radius is too small or too large.
    #[serde(rename = "radius out of bounds")]
    RadiusOutOfBounds,
}

impl fmt::Display for NoCircle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The same text as in reports.
        self.serialize(f)
    }
}

/// A recording with fewer events is reported as too short, and nothing else is reported about it.
pub const FEWEST_EVENTS: u64 = 1000;

/// Statistics of the detection.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DetectionReport {
    /// Number of input events.
    pub events: u64,
    /// Number of ON events among them; in files only if a board was found.
    #[serde(skip)]
    pub on_events: u64,
    /// Windows with too few events for a search.
    pub too_few_events: u64,
    /// Windows that were searched.
    pub windows: u64,
    /// Windows in which the board was found.
    pub found: u64,
    /// Number of those windows in which only neighbouring frames determined the position of the board.
    pub found_by_neighbours: u64,
    /// Circles found in all windows.
    pub circles: u64,
    /// Pairs of clusters that were refused, by reason.
    pub pairs_refused: BTreeMap<NoCircle, u64>,
    /// Windows without a board, by reason.
    pub grids_refused: BTreeMap<NoBoard, u64>,
    /// Windows in which the detector's capacity was exceeded.
    pub overflowed: u64,
    /// Circles of the frames found.
    pub board_circles: u64,
}

impl DetectionReport {
    /// Adds the counts of another part.
    pub fn add(&mut self, other: &Self) {
        self.events += other.events;
        self.on_events += other.on_events;
        self.too_few_events += other.too_few_events;
        self.windows += other.windows;
        self.found += other.found;
        self.found_by_neighbours += other.found_by_neighbours;
        self.circles += other.circles;
        self.overflowed += other.overflowed;
        self.board_circles += other.board_circles;
        for (reason, count) in &other.pairs_refused {
            *self.pairs_refused.entry(*reason).or_default() += count;
        }
        for (reason, count) in &other.grids_refused {
            *self.grids_refused.entry(*reason).or_default() += count;
        }
    }

    /// Returns the reason why no window contained the board, which is the most frequent one. `settings` are the settings of
    /// the search, `other` is the board that the circles fit instead.
    pub fn no_pattern(&self, settings: &DetectionSettings, other: Option<OtherReading>) -> NoPattern {
        let max_interval = settings.window.max_interval;
        NoPattern { report: Box::new(self.clone()), max_interval, extraction: settings.extraction, other, views: None }
    }

    /// Returns the polarity of all events, if they have only one.
    fn only_polarity(&self) -> Option<Polarity> {
        match self.on_events {
            _ if self.events < FEWEST_EVENTS => None,
            0 => Some(Polarity::Off),
            on if on == self.events => Some(Polarity::On),
            _ => None,
        }
    }

    /// Returns the most frequent reason, and its count.
    fn main_reason(&self) -> Option<(NoBoard, u64)> {
        let reasons = self.grids_refused.iter().map(|(reason, count)| (*reason, *count));
        let reasons = reasons.chain([(NoBoard::TooFewEvents, self.too_few_events)]).filter(|(_, count)| *count > 0);
        reasons.min_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)))
    }

    pub(super) fn count_events(&mut self, events: &[Event]) {
        self.events += events.len() as u64;
        self.on_events += events.iter().filter(|event| event.polarity == Polarity::On).count() as u64;
    }

    pub(super) fn count_pairs(&mut self, counts: &CircleCounts) {
        self.circles += u64::from(counts.circles);
        for (reason, count) in [
            (NoCircle::BackToBack, counts.back_to_back),
            (NoCircle::RadiusOutOfBounds, counts.radius_out_of_bounds),
            (NoCircle::ArcTooShort, counts.arc_too_short),
            (NoCircle::RadiusAgainstDistance, counts.radius_against_distance),
            (NoCircle::CenterAgainstMidpoint, counts.center_against_midpoint),
            (NoCircle::FitError, counts.error_too_large),
            (NoCircle::NotMutual, counts.not_mutual),
        ] {
            if count > 0 {
                *self.pairs_refused.entry(reason).or_default() += u64::from(count);
            }
        }
    }
}

/// States that the recording has too few events.
pub fn too_short(events: u64) -> String {
    format!("the recording is too short, with only {}", counted(events, "event", "events"))
}

/// Reason why no window contained the board.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub struct NoPattern {
    report: Box<DetectionReport>,
    max_interval: u16,
    extraction: Extraction,
    other: Option<OtherReading>,
    /// Number of views of a camera at rest, if it was at rest.
    views: Option<u64>,
}

/// The most informative cause.
#[derive(Clone, Debug, PartialEq)]
pub enum NoPatternCause {
    /// Something blinks in front of a camera at rest, and none of this number of views shows the board.
    AtRest(u64),
    /// The circles fit another board.
    OtherBoard(OtherReading),
    /// There are too few events.
    TooShort,
    /// All events have this polarity.
    OnePolarity(Polarity),
    /// This number of windows lacked a board for the same reason.
    Windows(NoBoard, u64),
    /// There were no windows.
    Nothing,
}

impl NoPattern {
    /// Returns the statistics of the detection.
    pub fn report(&self) -> &DetectionReport {
        &self.report
    }

    /// Returns the extraction of circles in the search.
    pub fn extraction(&self) -> Extraction {
        self.extraction
    }

    /// Adds that the camera was at rest and something blinked: none of `views` views shows the board.
    pub fn at_rest(self, views: u64) -> Self {
        Self { views: Some(views), ..self }
    }

    /// Returns the most informative cause.
    pub fn main_cause(&self) -> NoPatternCause {
        if let Some(views) = self.views {
            return NoPatternCause::AtRest(views);
        }
        if let Some(other) = &self.other {
            return NoPatternCause::OtherBoard(other.clone());
        }
        if (1..FEWEST_EVENTS).contains(&self.report.events) {
            return NoPatternCause::TooShort;
        }
        if let Some(polarity) = self.report.only_polarity() {
            return NoPatternCause::OnePolarity(polarity);
        }
        self.report
            .main_reason()
            .map_or(NoPatternCause::Nothing, |(reason, count)| NoPatternCause::Windows(reason, count))
    }
}

impl Remedy for NoPattern {
    fn remedy(&self, say: &Words) -> Option<String> {
        match self.main_cause() {
            NoPatternCause::OtherBoard(other) => other.remedy(say),
            NoPatternCause::AtRest(_) => Some(format!("check the kind, rows and columns of {}", say.board)),
            NoPatternCause::OnePolarity(_) => Some(format!("give the column of the polarity with {}", say.columns)),
            NoPatternCause::Windows(NoBoard::TooFewCircles, _) if self.extraction == Extraction::Hard => {
                Some(format!("try {}", say.extraction?.with("soft")))
            }
            NoPatternCause::Windows(NoBoard::TooFewCircles | NoBoard::TooFewEvents | NoBoard::NotRound, _)
            | NoPatternCause::TooShort
            | NoPatternCause::Nothing => None,
            NoPatternCause::Windows(..) => Some(format!("check layout, rows and columns of {}", say.board)),
        }
    }
}

impl fmt::Display for NoPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cause = self.main_cause();
        if let NoPatternCause::AtRest(views) = cause {
            let views = counted(views, "view", "views");
            return write!(
                f,
                "something blinks in front of a camera at rest, but no board was found in {views} of it: is all of the board in view, and described right?"
            );
        }
        write!(f, "no pattern found in {} windows", self.report.windows + self.report.too_few_events)?;
        match cause {
            NoPatternCause::OtherBoard(other) => write!(f, "; {other}"),
            NoPatternCause::TooShort => write!(f, ": {}: record 10 seconds", too_short(self.report.events)),
            NoPatternCause::OnePolarity(polarity) => write!(f, ": {}", only_one_polarity(polarity)),
            NoPatternCause::Windows(reason, count) => {
                write!(f, ": {count} had {reason}: {}", reason.remedy(self.max_interval, self.extraction))
            }
            NoPatternCause::AtRest(_) | NoPatternCause::Nothing => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> DetectionSettings {
        let mut settings = DetectionSettings::default();
        settings.window.max_interval = 100;
        settings
    }

    /// The soft extraction must not be recommended to users who use it.
    #[test]
    fn the_advice_does_not_name_what_was_done_already() {
        let report =
            DetectionReport { grids_refused: BTreeMap::from([(NoBoard::TooFewCircles, 5)]), ..Default::default() };
        let text = |extraction| report.no_pattern(&DetectionSettings { extraction, ..settings() }, None).to_string();
        assert!(text(Extraction::Hard).contains("soft extraction"));
        let soft = text(Extraction::Soft);
        assert!(!soft.contains("soft extraction") && soft.contains("at least 3 px"), "{soft}");
    }

    #[test]
    fn the_most_frequent_reason_is_named_with_advice() {
        let mut report = DetectionReport { windows: 9, too_few_events: 4, ..DetectionReport::default() };
        assert_eq!(
            report.no_pattern(&settings(), None).to_string(),
            "no pattern found in 13 windows: 4 had too few events: move faster, or set a larger detection.window.max_interval (now 100)"
        );
        report.grids_refused = BTreeMap::from([(NoBoard::LargerThanBoard, 5), (NoBoard::NoLattice, 4)]);
        let text = report.no_pattern(&settings(), None).to_string();
        assert!(text.contains("5 had circles beside the board: is the board described right"), "{text}");
        let board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let text =
            report.no_pattern(&settings(), Some(OtherReading::Board { fitting: 7, windows: 8, board })).to_string();
        assert_eq!(
            text,
            "no pattern found in 13 windows; 7 of 8 windows fit the board acircles:9x4:55mm:r17.5mm instead"
        );
        assert_eq!(
            DetectionReport::default().no_pattern(&settings(), None).to_string(),
            "no pattern found in 0 windows"
        );
    }

    /// Recordings without OFF events must not be reported as out of focus, nor recordings of ten events as too slow.
    #[test]
    fn one_polarity_or_too_few_events_come_before_other_reasons() {
        let event = |polarity: Polarity| Event { t: 0, x: 1, y: 1, polarity };
        let message = |events: &[Event]| {
            let mut report = DetectionReport { windows: 9, too_few_events: 9, ..DetectionReport::default() };
            report.count_events(events);
            let mut sum = DetectionReport::default();
            sum.add(&report);
            sum.no_pattern(&settings(), None).to_string()
        };
        for (polarity, name) in [(Polarity::On, "ON"), (Polarity::Off, "OFF")] {
            let text = message(&vec![event(polarity); 1000]);
            assert!(text.contains(&format!("windows: all events are {name}, and")), "{text}");
            assert!(text.contains("export the polarity too") && !text.contains("move faster"), "{text}");
        }
        let both = [vec![event(Polarity::On); 1000], vec![event(Polarity::Off)]].concat();
        assert!(message(&both).contains("too few events: move faster"));
        let few = message(&[event(Polarity::On); 10]);
        assert!(few.ends_with("the recording is too short, with only 10 events: record 10 seconds"), "{few}");
        assert!(message(&[event(Polarity::On)]).contains("only 1 event:"));
    }
}
