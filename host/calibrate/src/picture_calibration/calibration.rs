//! The ordinary calibration from pictures: every picture has its own pose.

use std::collections::BTreeMap;
use std::fmt;

use evcal_core::camera::{Camera, MAX_PARAMETERS, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::bundle::{PictureBundle, PictureView, SeenDot, picture_bundle};
use super::circle_image::center_bias;
use evcal_detection::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use evcal_detection::detection::no_board::NoBoard;
use evcal_detection::detection::pictures::search::PictureSearchReport;
use evcal_files::remedies;
use evcal_geometry::board::Board;
use evcal_solve::initial::{InitialError, InitialModel, InitialSettings, PosedFrame, initial_model};
use evcal_solve::solve::residual_statistics::Measured;
use evcal_solve::solve::residual_statistics::ResidualStatistics;

/// Distance from which a centre counts linearly instead of squared, in units of the centres' spread (σ).
pub(super) const HUBER: f64 = 2.5;

/// The kind of pictures of a calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum PictureSource {
    /// Frames of the camera.
    #[default]
    #[serde(rename = "frames")]
    Frames,
    /// Views of a board that blinks in front of a camera at rest, made of events.
    #[serde(rename = "views")]
    StillViews,
}

impl fmt::Display for PictureSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The same text as in reports.
        self.serialize(f)
    }
}

/// Counts of the pictures of all recordings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PictureReport {
    /// Their kind.
    #[serde(default)]
    pub source: PictureSource,
    /// Statistics of the search for the board.
    pub detection: PictureSearchReport,
    /// Number of pictures in the calibration.
    pub used: usize,
    /// Reasons why the others with a board were dropped, in words.
    pub dropped: String,
    /// Number of centres of dots in the calibration.
    pub dots_used: usize,
}

/// A camera calibrated from pictures.
#[derive(Clone, Debug)]
pub struct PictureCalibration {
    /// The camera.
    pub camera: Camera<f64>,
    /// Covariance of its parameters, in the order of the model, from the scatter between pictures.
    pub covariance: DMatrix<f64>,
    /// Ratio of the variance of the parameters to that with independent residuals, on average.
    pub inflation: f64,
    /// Standard deviation of a centre along one axis (px).
    pub spread: f64,
    /// Root mean square distance of the centres from their prediction (px).
    pub rms: f64,
    /// Median of that distance (px).
    pub median: f64,
    /// Reference frames of the pictures with the board; centres are centres of area.
    pub frames: Vec<ReferenceFrame>,
    /// The used pictures with their poses; `center` of a circle is the image of its centre.
    pub posed: Vec<PosedFrame>,
    /// The kind of distance of the residuals.
    pub measured: Measured,
    /// The initial model.
    pub initial: InitialModel,
    /// Counts of the pictures.
    pub report: PictureReport,
}

impl PictureCalibration {
    /// Returns the standard deviation of each of the camera's parameters.
    pub fn sigma(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect()
    }

    /// Returns statistics of the distances of the centres from their prediction.
    pub fn residuals(&self) -> ResidualStatistics {
        ResidualStatistics { count: self.report.dots_used, rms: self.rms, median: self.median }
    }

    /// Returns the summary of a result from pictures alone.
    pub fn summary(&self) -> PictureSummary {
        PictureSummary {
            sigma: self.sigma(),
            spread: self.spread,
            inflation: self.inflation,
            report: self.report.clone(),
        }
    }
}

/// Summary of a result from pictures alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureSummary {
    /// Standard deviation of each of the camera's parameters, in the order of the model.
    pub sigma: Vec<f64>,
    /// Standard deviation of a centre along one axis (px).
    pub spread: f64,
    /// Ratio of the variance of the parameters to that with independent residuals, on average.
    pub inflation: f64,
    /// Counts of the pictures.
    pub report: PictureReport,
}

/// Reason why the pictures yielded no camera, and counts of the pictures.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{reason}")]
pub struct NoPictureCalibration {
    /// The reason, with a remedy.
    pub reason: PictureFailure,
    /// Counts of the pictures.
    pub report: Box<PictureReport>,
}

/// Reasons why the pictures yielded no camera.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PictureFailure {
    /// Too few of them show the board.
    #[error("the board was found in {found} of {read} frames, {required} are needed{}: {advice}", in_words(.refused))]
    TooFewPictures {
        /// Number of pictures with the board.
        found: usize,
        /// Number of pictures read.
        read: u64,
        /// Number of required pictures.
        required: usize,
        /// Pictures without a board, by reason.
        refused: BTreeMap<NoBoard, u64>,
        /// Remedy.
        advice: String,
    },
    /// Too few views of a board that blinks show it.
    #[error("the board blinks and was found in {found} of {read} views of a camera at rest, {required} are needed{}", in_words(.refused))]
    TooFewViews {
        /// Number of views with the board.
        found: usize,
        /// Number of all views.
        read: u64,
        /// Number of required views.
        required: usize,
        /// Views without a board, by reason.
        refused: BTreeMap<NoBoard, u64>,
    },
    /// There is no first camera.
    #[error("{0}")]
    Initial(#[from] InitialError),
    /// The views are too similar.
    #[error("the {count} {pictures} with the board do not determine the camera: tilt the board more")]
    Undetermined {
        /// Number of used pictures.
        count: usize,
        /// Their kind.
        pictures: PictureSource,
    },
}

remedies! { PictureFailure, say;
    Self::Initial(_) => "check {} and {}", say.board, say.model;
    Self::Undetermined { .. } => "add views with the board tilted to all sides";
    _ => "give more views, of this recording or others: hold still for half a second each, with the board near, tilted to all sides, and all of it in view";
}

impl PictureFailure {
    /// Adds that the events show a larger board than stated, which explains the failure instead of light and motion.
    pub fn with_larger_board(self) -> Self {
        match self {
            Self::TooFewPictures { found, read, required, refused, .. } if !refused.is_empty() => {
                let advice = "the stated board is only a part of the one in view".to_owned();
                Self::TooFewPictures { found, read, required, refused, advice }
            }
            other => other,
        }
    }
}

/// Formats reasons and their counts, most frequent first, in parentheses; empty without any.
fn in_words(refused: &BTreeMap<NoBoard, u64>) -> String {
    let mut reasons: Vec<_> = refused.iter().collect();
    reasons.sort_by(|a, b| b.1.cmp(a.1).then(a.0.cmp(b.0)));
    let reasons: Vec<String> = reasons.iter().map(|(reason, count)| format!("{reason}: {count}")).collect();
    if reasons.is_empty() { String::new() } else { format!(" ({})", reasons.join(", ")) }
}

/// Calibrates a camera of model `kind` on a sensor of (width, height) pixels from the pictures in which `board` was found, and completes
/// the `report` of their search. The camera's parameters with a value in `fixed` keep it.
///
/// # Errors
/// [`NoPictureCalibration`] if too few pictures are left, or they do not determine the camera.
pub fn calibrate_pictures(
    frames: Vec<ReferenceFrame>,
    mut report: PictureReport,
    board: &Board,
    sensor: Sensor,
    kind: ModelKind,
    settings: &InitialSettings,
    fixed: &[Option<f64>; MAX_PARAMETERS],
) -> Result<PictureCalibration, NoPictureCalibration> {
    let initial = match start(&frames, &report, board, sensor, kind, settings) {
        Ok(initial) => initial,
        Err(reason) => return Err(NoPictureCalibration { reason, report: Box::new(report) }),
    };
    report.dropped = initial.report.reasons();
    let views: Vec<PictureView> = initial
        .frames
        .iter()
        .map(|posed| {
            let measured = frames.get(posed.frame).map_or(&[][..], |frame| &frame.circles);
            let dots = posed.circles.iter().filter_map(|circle| {
                let (object, radius) = (board.point(circle.index), board.dot_radius());
                Some(SeenDot { object, radius, image: nearest(measured, circle)? })
            });
            PictureView { dots: dots.collect(), pose: posed.pose.inverse() }
        })
        .collect();
    let bundle = picture_bundle(&initial.camera, &views, sensor, HUBER, fixed);
    let Some(PictureBundle { camera, poses, covariance, inflation, spread, rms, median, .. }) = bundle else {
        let reason = PictureFailure::Undetermined { count: views.len(), pictures: report.source };
        return Err(NoPictureCalibration { reason, report: Box::new(report) });
    };
    let mut posed = initial.frames.clone();
    for ((posed, view), pose) in posed.iter_mut().zip(&views).zip(&poses) {
        posed.pose = pose.inverse();
        let mut squares = 0.0;
        for (circle, dot) in posed.circles.iter_mut().zip(&view.dots) {
            let Some(bias) = center_bias(&camera, pose, dot.object, board.dot_radius()) else { continue };
            circle.center = dot.image - bias;
            let projected = camera.project(&(pose * nalgebra::Point3::new(dot.object.x, dot.object.y, 0.0)).coords);
            squares += projected.map_or(0.0, |projected| (projected - circle.center).norm_squared());
        }
        posed.rms = (squares / posed.circles.len().max(1) as f64).sqrt();
    }
    report.used = views.len();
    report.dots_used = views.iter().map(|view| view.dots.len()).sum();
    let measured = if board.circles().is_some() { Measured::CircleCentres } else { Measured::Corners };
    Ok(PictureCalibration {
        camera,
        covariance,
        inflation,
        spread,
        rms,
        median,
        frames,
        posed,
        measured,
        initial,
        report,
    })
}

/// Returns the measured centre that became `circle`, whose centre was corrected by less than its radius.
fn nearest(measured: &[ObservedCircle], circle: &ObservedCircle) -> Option<nalgebra::Vector2<f64>> {
    let distance = |other: &&ObservedCircle| (other.center - circle.center).norm_squared();
    measured.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).map(|nearest| nearest.center)
}

/// Returns the first camera and poses, or the reason why they could not be estimated.
fn start(
    frames: &[ReferenceFrame],
    report: &PictureReport,
    board: &Board,
    sensor: Sensor,
    kind: ModelKind,
    settings: &InitialSettings,
) -> Result<InitialModel, PictureFailure> {
    let required = settings.min_frames;
    if frames.len() < required {
        let detection = &report.detection;
        let (found, read, refused) = (frames.len(), detection.frames, detection.refused.clone());
        if report.source == PictureSource::StillViews {
            return Err(PictureFailure::TooFewViews { found, read, required, refused });
        }
        let usual = refused.iter().max_by_key(|(_, count)| **count).map(|(reason, _)| *reason);
        let advice = match usual {
            None => "record longer".to_owned(),
            Some(reason) if let Some(advice) = reason.advice_on_print() => advice.to_owned(),
            // If frames have an unsupported encoding, the notes name it.
            Some(NoBoard::UnreadEncoding) if refused.len() == 1 => detection.notes.join("; "),
            Some(_) => "more light, slower motion, the whole board in view".to_owned(),
        };
        return Err(PictureFailure::TooFewPictures { found, read, required, refused, advice });
    }
    Ok(initial_model(frames, board, sensor, kind, settings)?)
}

#[cfg(test)]
mod tests {
    use evcal_core::pattern::{Layout, Pattern};

    use super::*;
    use evcal_geometry::board::CircleBoard;

    #[test]
    fn the_remedy_depends_on_the_reasons() {
        let failure = |refused: BTreeMap<NoBoard, u64>| {
            let notes = vec!["7 frames: 32FC1".to_owned()];
            let detection = PictureSearchReport { frames: 7, refused, notes, ..PictureSearchReport::default() };
            let report = PictureReport { detection, ..PictureReport::default() };
            let board = Board::Circles(CircleBoard {
                pattern: Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 },
                spacing: 0.055,
                radius: 0.0175,
            });
            let settings = InitialSettings::default();
            let failure = start(&[], &report, &board, Sensor::new(346, 260), ModelKind::Radtan, &settings);
            failure.err().unwrap()
        };
        let all_good = failure(BTreeMap::new());
        assert!(all_good.to_string().ends_with("needed: record longer"), "{all_good}");
        assert_eq!(all_good.clone().with_larger_board(), all_good);
        let unread = failure(BTreeMap::from([(NoBoard::UnreadEncoding, 7)]));
        assert!(
            unread.to_string().ends_with("needed (in an encoding that is not read: 7): 7 frames: 32FC1"),
            "{unread}"
        );
    }
}
