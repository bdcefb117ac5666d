//! Cross-check with frames: comparison of the calibration from the camera's pictures with the one from its events.
//!
//! Both calibrations are of the same lens, so the difference of their projections over the sensor, with the implied rotation
//! removed, must be consistent with the uncertainty of both.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::picture_calibration::alignment::Misalignment;
use crate::picture_calibration::calibration::{PictureCalibration, PictureFailure, PictureReport};
use crate::quality::uncertainty::projection::{NoView, projection_uncertainty};
use crate::quality::verdict::{Cause, Finding, Severity};
use evcal_geometry::lens::camera_file::{CameraDescription, Parameters};
use evcal_geometry::lens::projection_difference::{NoCommonView, ProjectionDifference, projection_difference};

/// Largest ratio of the projection difference to the expected difference at which pictures and events agree.
const AGREEMENT: f64 = 2.0;
/// Uncertainty of the pictures' projection (px, rms over the sensor) above which they cannot confirm or refute the events.
const TOO_UNCERTAIN: f64 = 1.0;

/// Result of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Agreement {
    /// The difference is explained by both uncertainties.
    Agrees,
    /// The difference is larger.
    Disagrees,
    /// The uncertainty of the pictures is too large for a decision.
    TooUncertain,
}

/// One parameter from events and from pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ComparedParameter {
    /// Its name.
    pub name: String,
    /// From events.
    pub events: f64,
    /// From pictures.
    pub frames: f64,
    /// Standard deviation of the value from pictures.
    pub frames_sigma: f64,
    /// Standard deviation of the difference.
    pub difference_sigma: f64,
}

/// Expected projection difference of two uncertain calibrations (px, rms over the sensor).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpectedDifference {
    /// From the uncertainty of both.
    pub rms: f64,
    /// The events' part.
    pub events: f64,
    /// The pictures' part.
    pub frames: f64,
}

/// Comparison of the calibration from pictures with the one from events, with the difference over the sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureCrossCheck {
    /// The comparison.
    pub comparison: Comparison,
    /// The difference at every point of the sensor.
    pub difference: ProjectionDifference,
}

/// Comparison of two calibrations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// The result in words.
    pub sentence: String,
    /// The result.
    pub agreement: Agreement,
    /// Misalignment of frames and events of the same moment, if there is any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub misalignment: Option<Misalignment>,
    /// Root mean square of the projection difference over the sensor (px), pictures minus events, with the implied rotation
    /// removed.
    pub difference_rms: f64,
    /// Its greatest value (px).
    pub difference_max: f64,
    /// The pixel where it is greatest.
    pub difference_max_at: [f64; 2],
    /// The expected difference.
    pub expected: ExpectedDifference,
    /// Difference over expected difference.
    pub ratio: f64,
    /// The camera from pictures.
    pub camera: CameraDescription,
    /// Parameter by parameter.
    pub parameters: Vec<ComparedParameter>,
    /// Standard deviation of a dot's centre along one axis (px).
    pub spread: f64,
    /// Variance of the camera's parameters over the variance with independent residuals.
    pub inflation: f64,
    /// Number of pictures that were used, and of the rejected ones by reason.
    pub report: PictureReport,
}

/// Result of the cross-check with pictures.
#[derive(Clone, Debug)]
pub enum CrossCheckOutcome {
    /// They were calibrated and compared.
    Compared(Box<PictureCrossCheck>),
    /// The pictures yielded no camera, or a camera that cannot be compared.
    Failed(FailedCrossCheck),
}

/// Reason why pictures cannot be compared with a calibration from events, and counts of the pictures.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{reason}")]
pub struct FailedCrossCheck {
    /// The reason.
    pub reason: NoCrossCheck,
    /// Misalignment of frames and events of the same moment, if there is any.
    pub misalignment: Option<Misalignment>,
    /// Number of pictures that were used, and of the rejected ones by reason.
    pub report: Box<PictureReport>,
}

/// Reasons why pictures cannot be compared with a calibration from events.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoCrossCheck {
    /// They yield no camera.
    #[error("{0}")]
    NoCalibration(#[source] PictureFailure),
    /// Their camera covers another part of the sensor than the camera from events.
    #[error("{0}")]
    NoCommonView(#[from] NoCommonView),
    /// A camera covers almost nothing of the sensor.
    #[error("{0}")]
    NoView(#[from] NoView),
}

impl CrossCheckOutcome {
    /// Returns the counts of the pictures.
    pub fn report(&self) -> &PictureReport {
        match self {
            Self::Compared(cross_check) => &cross_check.comparison.report,
            Self::Failed(failure) => &failure.report,
        }
    }

    /// Adds to the reason of a failure that the events show a larger board than the nominal one.
    pub fn with_larger_board(self) -> Self {
        match self {
            Self::Failed(FailedCrossCheck { reason: NoCrossCheck::NoCalibration(reason), misalignment, report }) => {
                let reason = NoCrossCheck::NoCalibration(reason.with_larger_board());
                Self::Failed(FailedCrossCheck { reason, misalignment, report })
            }
            other => other,
        }
    }

    /// Returns the finding for the verdict if pictures and events disagree or are misaligned.
    pub fn finding(&self) -> Option<Finding> {
        let misalignment = match self {
            Self::Compared(cross_check) => cross_check.comparison.misalignment,
            Self::Failed(failure) => failure.misalignment,
        };
        if let Some(misalignment) = misalignment {
            return Some(Finding {
                cause: Cause::FramesMisaligned,
                // The events may be the ones that were turned, and with them the principal point.
                severity: if misalignment.is_turned() { Severity::Failure } else { Severity::Warning },
                reason: misalignment.to_string(),
                advice: misalignment.advice().into(),
            });
        }
        let Self::Compared(cross_check) = self else { return None };
        let cross_check = &cross_check.comparison;
        (cross_check.agreement == Agreement::Disagrees).then(|| Finding {
            cause: Cause::FramesDisagree,
            severity: Severity::Warning,
            reason: format!(
                "the camera's own frames differ from its events by {:.3} px, {:.1} times what the uncertainty of both \
                 makes likely",
                cross_check.difference_rms, cross_check.ratio
            ),
            advice:
                "both look through the same lens: is it in focus, is the board flat, was it seen all over the image, \
                     did lens or board change while recording?"
                    .into(),
        })
    }
}

/// Compares the calibration from pictures with the `camera` from events, whose parameters have `covariance`. If frames
/// and events are misaligned, the result is [`Agreement::Disagrees`], however similar the cameras are.
///
/// # Errors
/// [`NoCrossCheck`] if both have no part of the sensor in common.
pub fn cross_check_pictures(
    camera: &Camera<f64>,
    covariance: &DMatrix<f64>,
    pictures: &PictureCalibration,
    sensor: Sensor,
    misalignment: Option<Misalignment>,
) -> Result<PictureCrossCheck, NoCrossCheck> {
    let difference = projection_difference(camera, &pictures.camera, sensor)?;
    let expected =
        |camera, covariance| projection_uncertainty(camera, covariance, sensor).map(|uncertainty| uncertainty.rms);
    let from_events = expected(camera, covariance)?;
    let from_frames = expected(&pictures.camera, &pictures.covariance)?;
    let expected = ExpectedDifference { rms: from_events.hypot(from_frames), events: from_events, frames: from_frames };
    let ratio = difference.rms / expected.rms.max(f64::MIN_POSITIVE);
    let agreement = if misalignment.is_some() {
        Agreement::Disagrees
    } else if from_frames > TOO_UNCERTAIN {
        Agreement::TooUncertain
    } else if ratio <= AGREEMENT {
        Agreement::Agrees
    } else {
        Agreement::Disagrees
    };
    let names = camera.kind().parameter_names();
    let sigma = pictures.sigma();
    let event_parameters = camera.parameters();
    let frame_parameters = pictures.camera.parameters();
    let parameters = names
        .iter()
        .zip(event_parameters.iter().zip(frame_parameters.iter()).zip(&sigma))
        .enumerate()
        .map(|(index, (name, ((events, frames), sigma)))| ComparedParameter {
            name: (*name).to_owned(),
            events: *events,
            frames: *frames,
            frames_sigma: *sigma,
            difference_sigma: covariance.get((index, index)).map_or(0.0, |value| value.max(0.0).sqrt()).hypot(*sigma),
        })
        .collect();
    let comparison = Comparison {
        sentence: match misalignment {
            Some(misalignment) => format!(
                "the camera's {} frames DISAGREE with its events: {misalignment}; {}",
                pictures.report.used,
                misalignment.advice()
            ),
            None => sentence(agreement, &difference, &expected, ratio, pictures.report.used),
        },
        agreement,
        misalignment,
        difference_rms: difference.rms,
        difference_max: difference.max,
        difference_max_at: difference.max_at,
        expected,
        ratio,
        camera: CameraDescription {
            model: camera.kind().name().to_owned(),
            parameters: Parameters::new(names.iter().copied().zip(frame_parameters.iter().copied())),
        },
        parameters,
        spread: pictures.spread,
        inflation: pictures.inflation,
        report: pictures.report.clone(),
    };
    Ok(PictureCrossCheck { comparison, difference })
}

fn sentence(
    agreement: Agreement,
    difference: &ProjectionDifference,
    expected: &ExpectedDifference,
    ratio: f64,
    frames: usize,
) -> String {
    let (rms, max, [x, y]) = (difference.rms, difference.max, difference.max_at);
    let size_in_words =
        format!("their projections differ by {rms:.3} px (rms; at most {max:.3} px, at ({x:.0}, {y:.0}))");
    let expected = expected.rms;
    match agreement {
        Agreement::Agrees => {
            format!(
                "the camera's {frames} frames agree with its events: {size_in_words}, {ratio:.1} times the {expected:.3} px that their uncertainties predict"
            )
        }
        Agreement::Disagrees => format!(
            "the camera's {frames} frames DISAGREE with its events: {size_in_words}, {ratio:.1} times the {expected:.3} px that their uncertainties predict. Both have \
             the same lens, so one of the two is wrong or less certain than reported: is the lens in focus, is \
             the board flat, was it seen all over the image by both, did the lens or the board change while recording?"
        ),
        Agreement::TooUncertain => format!(
            "the camera's {frames} frames can neither confirm nor refute the events: their uncertainties predict a difference of {expected:.3} px. More light, slower motion \
             and a longer recording make better frames"
        ),
    }
}
