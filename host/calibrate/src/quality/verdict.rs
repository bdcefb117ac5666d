//! The verdict on a calibration: a grade, and findings with reasons and advice.

pub(crate) mod board_statement;
mod findings;
mod settings;
mod symptoms;

use evcal_core::sensor::Sensor;
use std::fmt;

use evcal_core::camera::Camera;
use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use self::board_statement::with_sigma;
use self::findings::findings_on;
pub use self::settings::{SMALLEST_COVERAGE, VerdictSettings};
use crate::advice::Advice;
use crate::quality::{EventQuality, Quality};
use evcal_files::remedy::Words;
use evcal_geometry::board::Board;
use evcal_geometry::lens::axial_focal::axial_focal_gradients;

/// Grade of a calibration, from best to worst.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grade {
    /// Without warnings.
    Good,
    /// With warnings; the calibration can be used with the findings in mind.
    Usable,
    /// The calibration should be repeated.
    NotGood,
}

impl Grade {
    /// Returns the grade that follows from findings of these severities.
    pub fn of(severities: impl IntoIterator<Item = Severity>) -> Self {
        match severities.into_iter().max() {
            Some(Severity::Failure) => Self::NotGood,
            Some(Severity::Warning) => Self::Usable,
            Some(Severity::Note) | None => Self::Good,
        }
    }

    /// Returns the beginning of the verdict on another sensor, whose findings are listed below it as notes.
    pub fn opening(self) -> &'static str {
        match self {
            Self::Good => "Good",
            Self::Usable => "Usable, with the notes below",
            Self::NotGood => "Not good enough",
        }
    }
}

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Information only.
    Note,
    /// Lowers the quality.
    Warning,
    /// Makes the calibration not good enough.
    Failure,
}

/// Subject of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// The projection is not known well enough.
    Uncertain,
    /// The recording is short.
    Short,
    /// The board was far away.
    FarAway,
    /// The board was hardly tilted.
    HeadOn,
    /// Parts of the sensor never saw the board.
    Uncovered,
    /// The circles are larger or smaller than nominal, relative to the spacing.
    RadiusDisagrees,
    /// The gap between the tags of a board, or the side of its markers, does not fit its first length.
    LengthsDisagree,
    /// The board is bent, or its print differs from the nominal one; both were estimated.
    BoardNotAsStated,
    /// fx and fy differ.
    PixelsNotSquare,
    /// The lens model folds over inside the sensor.
    NotOneToOne,
    /// A distortion coefficient is not significantly different from zero.
    ParameterUndetermined,
    /// The recording contradicts a value that the user fixed.
    FixedValue,
    /// The lens model leaves a pattern of residuals.
    ModelTooPoor,
    /// Two halves of the recording differ by more than they should.
    HalvesDisagree,
    /// Parts of the motion could not be followed.
    Unexplained,
    /// The camera had more events than it could read.
    Saturated,
    /// The light flickers.
    Flicker,
    /// Hot pixels send a large share of the events.
    HotPixels,
    /// Columns of the sensor send nothing, and perhaps rows.
    DeadColumns,
    /// Rows of the sensor send nothing.
    DeadRows,
    /// An area of the sensor sends nothing.
    SilentArea,
    /// Pixels are counted from 1.
    CountedFromOne,
    /// The lens changed within the recordings, or they are of two cameras.
    LensChanged,
    /// The board changed within the recordings.
    BoardChanged,
    /// The points of the board in pictures are not where its description has them.
    UnevenBoard,
    /// Edges appear twice: the events of two cameras were merged.
    DoubleEdges,
    /// Most events were lost at random.
    LostEvents,
    /// The recording contains events more than once.
    RepeatedEvents,
    /// The lens is out of focus, or dirty.
    Defocused,
    /// The calibration from the camera's own frames differs.
    FramesDisagree,
    /// The camera's own frames are flipped, shifted or delayed against its events.
    FramesMisaligned,
    /// Events are not in the order of their times.
    OutOfOrder,
    /// Timestamps have steps of more than a fifth of a millisecond.
    CoarseTimes,
    /// Events were already undistorted.
    Undistorted,
    /// Rows or columns of the board were never found.
    PartOfBoard,
    /// The board has more rows or columns than described.
    LargerBoard,
    /// A recording, or a part of one, is of another camera than the rest.
    OtherCamera,
    /// The sensor has another size than stated.
    OtherSensorSize,
    /// The coordinates of the events were scaled.
    Scaled,
    /// x and y are exchanged.
    ExchangedAxes,
    /// It is not known whether the image is mirrored.
    OrientationNotChecked,
    /// The image is mirrored.
    MirroredImage,
    /// The position of a device on the mount was not measured.
    PositionNotMeasured,
    /// The rotation of a device on the mount was not measured.
    RotationNotMeasured,
    /// The delay or the offset of a clock was not measured.
    DelayNotMeasured,
    /// Scale and misalignment of the accelerometer cannot be separated from its bias and gravity.
    AccelerometerNotMeasured,
    /// The camera was hardly tilted: gravity cannot be separated from the accelerometer's bias.
    HardlyTilted,
    /// Scale and misalignment of the gyroscope were not measured.
    GyroscopeNotMeasured,
    /// Two clocks run at different rates.
    ClockRate,
    /// Samples of the IMU are missing.
    MissingSamples,
    /// Samples of the IMU have no time of their own, and were left out.
    LeftOutSamples,
    /// Several samples of the IMU share each timestamp.
    SharedTimestamps,
    /// Timestamps of the IMU scatter by more than the time between samples.
    ScatteredTimestamps,
    /// The same, and samples do not arrive at a constant rate.
    IrregularTimestamps,
    /// Samples of the IMU could not be read.
    DamagedSamples,
    /// Samples of the IMU are saturated.
    SaturatedSamples,
    /// The board's spacing differs from the stated one, according to the accelerometer.
    BoardSpacing,
    /// The solve with a device changed the camera.
    CameraMoved,
    /// A device is not fixed to the camera.
    Loose,
    /// The times of a device's pictures or samples scatter or jump.
    ScatteredTimes,
    /// Two cameras did not see the board at the same time.
    NotSeenTogether,
    /// A rolling shutter was requested, and none was found.
    NoLineDelay,
}

impl Cause {
    /// Returns the subjects of other findings that follow from this one, whatever is recorded: a changed lens or board, a board that is
    /// not as described and a wrong fixed value leave an uncertain projection, residuals and halves that differ.
    fn explains(self) -> &'static [Self] {
        match self {
            Self::BoardChanged | Self::UnevenBoard | Self::LengthsDisagree | Self::LensChanged | Self::FixedValue => {
                &[Self::Uncertain, Self::ModelTooPoor, Self::HalvesDisagree]
            }
            Self::Loose => &[Self::CameraMoved],
            Self::ScatteredTimes => &[
                Self::Loose,
                Self::CameraMoved,
                Self::ClockRate,
                Self::PositionNotMeasured,
                Self::RotationNotMeasured,
                Self::DelayNotMeasured,
                Self::AccelerometerNotMeasured,
                Self::GyroscopeNotMeasured,
            ],
            // Pixels shifted by rounding leave a pattern that no lens has.
            Self::Undistorted => &[Self::ModelTooPoor],
            _ => &[],
        }
    }
}

/// A reason for caution. Its advice is data, or a `String` in the words of a program.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding<A = Advice> {
    /// Its subject.
    pub cause: Cause,
    /// Its severity.
    pub severity: Severity,
    /// The observation, as the end of a sentence.
    pub reason: String,
    /// The recommended action.
    pub advice: A,
}

impl Finding {
    /// Returns the finding with this advice.
    pub fn new(cause: Cause, severity: Severity, reason: String, advice: impl Into<Advice>) -> Self {
        Self { cause, severity, reason, advice: advice.into() }
    }
}

impl From<Finding> for Advice {
    /// The reason, and what to do.
    fn from(Finding { reason, advice, .. }: Finding) -> Self {
        match advice {
            Advice::Plain(advice) => Advice::Plain(format!("{reason}: {advice}")),
            others => others,
        }
    }
}

impl<A: fmt::Display> fmt::Display for Finding<A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mark = match self.severity {
            Severity::Note => "note",
            Severity::Warning => "warning",
            Severity::Failure => "failure",
        };
        write!(f, "{mark}: {}; {}", self.reason, self.advice)
    }
}

/// The verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict<A = Advice> {
    /// Grade.
    pub grade: Grade,
    /// The verdict in one sentence.
    pub sentence: String,
    /// The findings, most severe first; among findings of the same severity, causes before consequences.
    pub findings: Vec<Finding<A>>,
}

impl Verdict {
    /// Builds the verdict on `camera` from `findings`.
    pub fn new(camera: &Camera<f64>, quality: &Quality, mut findings: Vec<Finding>) -> Self {
        sort(&mut findings);
        let grade = Grade::of(findings.iter().map(|finding| finding.severity));
        Self { grade, sentence: sentence(grade, camera, quality, &findings), findings }
    }

    /// Returns the verdict with its advice in the words of a program.
    pub fn worded(&self, say: &Words) -> Verdict<String> {
        let findings = self.findings.iter().map(|finding| Finding {
            cause: finding.cause,
            severity: finding.severity,
            reason: finding.reason.clone(),
            advice: finding.advice.worded(say),
        });
        Verdict { grade: self.grade, sentence: self.sentence.clone(), findings: findings.collect() }
    }
}

impl<A: fmt::Display> fmt::Display for Verdict<A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence)?;
        self.findings.iter().try_for_each(|finding| write!(f, "\n  {finding}"))
    }
}

/// Builds the verdict on `camera`, with findings from other checks in `more`; `events` is given for a calibration along
/// trajectories.
pub fn verdict(
    camera: &Camera<f64>,
    quality: &Quality,
    events: Option<&EventQuality>,
    board: &Board,
    sensor: Sensor,
    more: Vec<Finding>,
    settings: &VerdictSettings,
) -> Verdict {
    let mut findings = more;
    findings.extend(findings_on(camera, quality, events, board, sensor, settings));
    without_consequences(&mut findings);
    Verdict::new(camera, quality, findings)
}

/// Removes findings that follow from another one, whose severity becomes the largest of them; notes explain nothing.
pub fn without_consequences(findings: &mut Vec<Finding>) {
    let explains =
        |one: &Finding, other: &Finding| one.severity > Severity::Note && one.cause.explains().contains(&other.cause);
    let Some(place) = findings.iter().position(|one| findings.iter().any(|other| explains(one, other))) else { return };
    let mut cause = findings.remove(place);
    let of_cause = cause.clone();
    let follows = |finding: &Finding| explains(&of_cause, finding);
    cause.severity =
        findings.iter().filter(|one| follows(one)).fold(cause.severity, |severity, one| severity.max(one.severity));
    findings.retain(|finding| !follows(finding));
    findings.insert(0, cause);
    without_consequences(findings);
}

/// Sorts findings by severity. Causes of an uncertain projection come before the uncertainty itself, because without
/// the causes the projection would be less uncertain.
fn sort(findings: &mut [Finding]) {
    findings.sort_by_key(|finding| (std::cmp::Reverse(finding.severity), finding.cause == Cause::Uncertain));
}

fn sentence(grade: Grade, camera: &Camera<f64>, quality: &Quality, findings: &[Finding]) -> String {
    let focal = focal_length(camera, quality)
        .map_or_else(String::new, |(what, value, sigma)| format!(", {what} {} px", with_sigma(value, sigma)));
    let known = format!(
        "expected projection error below {:.3} px over the sensor (95 % confidence){focal}",
        quality.projection.rms_95
    );
    let reasons = reasons(findings);
    match grade {
        Grade::Good => format!("Good: {known}."),
        Grade::Usable => format!("Usable, but {}: {known}.", reasons.join("; ")),
        Grade::NotGood => format!("Not good enough, because {}: {known}.", reasons.join("; ")),
    }
}

/// Returns the reasons that the sentence names, most severe first.
fn reasons(findings: &[Finding]) -> Vec<&str> {
    // A sentence about a failure names no warnings, because they did not cause it.
    let worst = findings.first().map(|finding| finding.severity).filter(|severity| *severity > Severity::Note);
    let grave = || findings.iter().filter(|finding| Some(finding.severity) == worst);
    // The sentence reports the uncertainty of the projection anyway, so only the causes are named, if there are any.
    let causes: Vec<&str> =
        grave().filter(|finding| finding.cause != Cause::Uncertain).map(|finding| finding.reason.as_str()).collect();
    if causes.is_empty() { grave().map(|finding| finding.reason.as_str()).collect() } else { causes }
}

/// Returns name, value and σ of the focal length along x. In models in which fx is only determined together with a shape
/// parameter, it is the focal length in the middle of the image.
fn focal_length(camera: &Camera<f64>, quality: &Quality) -> Option<(&'static str, f64, f64)> {
    let covariance = &quality.uncertainty.covariance;
    let [value, _] = camera.axial_focal_lengths()?;
    let [gradient, _] = axial_focal_gradients(camera)?;
    let count = covariance.nrows();
    let gradient = DVector::from_fn(count, |index, _| gradient.get(index).copied().unwrap_or(0.0));
    let sigma = gradient.dot(&(covariance * &gradient)).max(0.0).sqrt();
    let plain = camera.parameters().first().is_some_and(|fx| (fx - value).abs() <= 1e-9 * value);
    Some((if plain { "fx" } else { "focal length on the axis" }, value, sigma))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(cause: Cause, severity: Severity, reason: &str) -> Finding {
        Finding { cause, severity, reason: reason.to_owned(), advice: "".into() }
    }

    #[test]
    fn findings_are_sorted_with_causes_before_consequences() {
        let uncertain = finding(Cause::Uncertain, Severity::Failure, "known to 1.59 px");
        let poor = finding(Cause::ModelTooPoor, Severity::Failure, "radtan8 cannot follow this lens");
        let far = finding(Cause::FarAway, Severity::Warning, "far away");
        let mut findings = [far, uncertain, poor];
        sort(&mut findings);
        assert_eq!(findings.map(|finding| finding.cause), [Cause::ModelTooPoor, Cause::Uncertain, Cause::FarAway]);
    }

    #[test]
    fn a_change_is_the_cause_of_an_uncertain_projection() {
        let uncertain = finding(Cause::Uncertain, Severity::Failure, "known to 0.43 px");
        let changed = finding(Cause::LensChanged, Severity::Warning, "longer from 3 s on");
        let short = finding(Cause::Short, Severity::Warning, "short");
        let mut findings = vec![uncertain.clone(), changed, short.clone()];
        without_consequences(&mut findings);
        assert_eq!(
            findings.iter().map(|finding| (finding.cause, finding.severity)).collect::<Vec<_>>(),
            [(Cause::LensChanged, Severity::Failure), (Cause::Short, Severity::Warning)]
        );
        // A wrong size of markers, which is a note, changes nothing.
        let markers = finding(Cause::LengthsDisagree, Severity::Note, "markers");
        let mut others = vec![uncertain, short, markers];
        without_consequences(&mut others);
        assert_eq!(others.len(), 3);
    }

    #[test]
    fn the_sentence_names_only_the_gravest_reasons() {
        let uncertain = finding(Cause::Uncertain, Severity::Failure, "known to 0.43 px");
        let poor = finding(Cause::ModelTooPoor, Severity::Warning, "residuals of 0.012 px");
        let bent = finding(Cause::HalvesDisagree, Severity::Failure, "halves differ");
        assert_eq!(reasons(&[uncertain.clone(), poor.clone()]), ["known to 0.43 px"]);
        assert_eq!(reasons(&[uncertain, bent, poor.clone()]), ["halves differ"]);
        assert_eq!(reasons(std::slice::from_ref(&poor)), ["residuals of 0.012 px"]);
        assert!(reasons(&[finding(Cause::Short, Severity::Note, "short")]).is_empty());
    }
}
