//! Whether a calibration is good, in words, and if not, why and what to do.

use std::fmt;

use evcal_core::camera::Camera;
use nalgebra::{DVector, Vector2};
use serde::{Deserialize, Serialize};

use crate::board::Board;
use crate::coverage::Coverage;
use crate::initial::axial_focal_gradients;
use crate::trust::Trust;

/// Bounds of the verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VerdictSettings {
    /// A calibration whose projection is known better than this over the sensor is good (px, 95 %).
    pub good: f64,
    /// One that is known worse than this is not good enough (px, 95 %).
    pub poor: f64,
    /// Trajectories shorter than this in all are too short (s).
    pub shortest: f64,
    /// The board must fill at least this much of the image's shorter side at times.
    pub smallest_fill: f64,
    /// The board must be tilted at least so much at times (degrees).
    pub smallest_tilt: f64,
    /// Smallest part of the sensor that must be covered.
    pub coverage: f64,
    /// Largest relative difference of the circles' radius from the stated one.
    pub radius: f64,
    /// Displacements over the sensor that are larger than noise explains, by less than this, are let pass (px).
    pub pattern: f64,
    /// Displacements must be so many times what noise makes of them to count.
    pub pattern_ratio: f64,
    /// Largest relative difference of fx and fy, if it is also beyond four σ.
    pub square_pixels: f64,
}

impl Default for VerdictSettings {
    fn default() -> Self {
        Self {
            good: 0.1,
            poor: 0.3,
            shortest: 2.5,
            smallest_fill: 0.5,
            smallest_tilt: 20.0,
            coverage: 0.7,
            radius: 0.06,
            pattern: 0.008,
            pattern_ratio: 1.5,
            square_pixels: 0.01,
        }
    }
}

/// How good a calibration is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grade {
    /// Nothing speaks against it.
    Good,
    /// It can be used, with what the findings say in mind.
    Usable,
    /// It should be done again.
    NotGood,
}

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Worth knowing.
    Note,
    /// Lowers trust.
    Warning,
    /// Makes the calibration not good enough.
    Failure,
}

/// What a finding is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
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
    /// The circles are larger or smaller than stated, for the stated spacing.
    RadiusDisagrees,
    /// fx and fy differ.
    PixelsNotSquare,
    /// The lens model folds over inside the sensor.
    NotOneToOne,
    /// A distortion coefficient cannot be told from zero.
    ParameterUndetermined,
    /// The lens model leaves a pattern of residuals.
    ModelTooPoor,
    /// Two halves of the recording differ by more than they should.
    HalvesDisagree,
    /// The camera's own frames give another camera.
    FramesDisagree,
}

/// Something that speaks for caution.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What it is about.
    pub cause: Cause,
    /// How much it matters.
    pub severity: Severity,
    /// What is the case, as the end of a sentence.
    pub reason: String,
    /// What to do.
    pub advice: String,
}

/// The verdict.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// How good.
    pub grade: Grade,
    /// In one sentence.
    pub sentence: String,
    /// The reasons, gravest first.
    pub findings: Vec<Finding>,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence)?;
        for finding in &self.findings {
            let mark = match finding.severity {
                Severity::Note => "note",
                Severity::Warning => "warning",
                Severity::Failure => "failure",
            };
            write!(f, "\n  {mark}: {}; {}", finding.reason, finding.advice)?;
        }
        Ok(())
    }
}

/// The verdict on `camera`, with findings of other origin in `more`.
pub fn verdict(
    camera: &Camera<f64>,
    trust: &Trust,
    board: &Board,
    sensor: (u16, u16),
    more: Vec<Finding>,
    settings: &VerdictSettings,
) -> Verdict {
    let mut findings = more;
    findings.extend(uncertain(trust, settings));
    findings.extend(views(&trust.coverage, settings));
    findings.extend(radius(trust, board, settings));
    findings.extend(pixels_not_square(camera, trust, settings));
    findings.extend(not_one_to_one(camera, sensor));
    findings.extend(undetermined(camera, trust));
    findings.extend(too_poor(camera, trust, settings));
    findings.extend(halves(trust));
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    let worst = findings.first().map(|finding| finding.severity);
    let grade = match worst {
        Some(Severity::Failure) => Grade::NotGood,
        Some(Severity::Warning) => Grade::Usable,
        Some(Severity::Note) | None => Grade::Good,
    };
    Verdict { grade, sentence: sentence(grade, camera, trust, &findings), findings }
}

fn sentence(grade: Grade, camera: &Camera<f64>, trust: &Trust, findings: &[Finding]) -> String {
    let focal = focal_length(camera, trust)
        .map_or_else(String::new, |(what, value, sigma)| format!(", {what} {value:.2} ± {sigma:.2} px"));
    let known = format!("pixels are known to {:.3} px over the sensor (95 %){focal}", trust.projection.rms_95);
    let grave = || findings.iter().filter(|finding| finding.severity > Severity::Note);
    // How well the projection is known is told anyway: here the causes count, if there are any.
    let causes: Vec<&str> =
        grave().filter(|finding| finding.cause != Cause::Uncertain).map(|finding| finding.reason.as_str()).collect();
    let reasons: Vec<&str> =
        if causes.is_empty() { grave().map(|finding| finding.reason.as_str()).collect() } else { causes };
    match grade {
        Grade::Good => format!("Good: {known}."),
        Grade::Usable => format!("Usable, but {}: {known}.", reasons.join("; ")),
        Grade::NotGood => format!("Not good enough, because {}: {known}.", reasons.join("; ")),
    }
}

/// Name, value and σ of the focal length along x. In models whose fx can only be told together with a shape
/// parameter it is that of the image's middle.
fn focal_length(camera: &Camera<f64>, trust: &Trust) -> Option<(&'static str, f64, f64)> {
    let covariance = &trust.uncertainty.covariance;
    let [value, _] = camera.axial_focal_lengths()?;
    let [gradient, _] = axial_focal_gradients(camera)?;
    let count = covariance.nrows();
    let gradient = DVector::from_fn(count, |index, _| gradient.get(index).copied().unwrap_or(0.0));
    let sigma = gradient.dot(&(covariance * &gradient)).max(0.0).sqrt();
    let plain = camera.parameters().first().is_some_and(|fx| (fx - value).abs() <= 1e-9 * value);
    Some((if plain { "fx" } else { "focal length on the axis" }, value, sigma))
}

fn uncertain(trust: &Trust, settings: &VerdictSettings) -> Option<Finding> {
    let bound = trust.projection.rms_95;
    let severity = if bound > settings.poor {
        Severity::Failure
    } else if bound > settings.good {
        Severity::Warning
    } else {
        return None;
    };
    Some(Finding {
        cause: Cause::Uncertain,
        severity,
        reason: format!("the projection is only known to {bound:.2} px"),
        advice: "record longer, with the board near, tilted to all sides and in every corner of the image".to_owned(),
    })
}

fn views(coverage: &Coverage, settings: &VerdictSettings) -> Vec<Finding> {
    let warning =
        |cause, reason, advice: &str| Finding { cause, severity: Severity::Warning, reason, advice: advice.to_owned() };
    let mut findings = Vec::new();
    if coverage.duration < settings.shortest {
        findings.push(warning(
            Cause::Short,
            format!("the board was followed for {:.1} s only", coverage.duration),
            "record five to ten seconds in which the whole board moves",
        ));
    }
    if coverage.fill.high < settings.smallest_fill {
        findings.push(warning(
            Cause::FarAway,
            format!(
                "the board was never closer than {:.2} m and filled at most {:.0} % of the image's shorter side",
                coverage.distance.low,
                100.0 * coverage.fill.high
            ),
            "bring the board so near that it fills the image",
        ));
    }
    if coverage.tilt.high < settings.smallest_tilt {
        findings.push(warning(
            Cause::HeadOn,
            format!("the board was seen head-on, tilted by {:.0}° at most", coverage.tilt.high),
            "tilt the board by 30° to 45° to all sides: head-on, focal length and distance cannot be told apart",
        ));
    }
    if coverage.covered < settings.coverage {
        findings.push(warning(
            Cause::Uncovered,
            format!(
                "only {:.0} % of the sensor saw the board, nothing {}",
                100.0 * coverage.covered,
                empty_places(coverage)
            ),
            "move the board through the whole image, its corners too: elsewhere the distortion is a guess",
        ));
    }
    findings
}

/// Which corners and sides of the sensor saw nothing.
fn empty_places(coverage: &Coverage) -> String {
    let names = [
        ["at the upper left", "at the top", "at the upper right"],
        ["at the left", "in the middle", "at the right"],
        ["at the lower left", "at the bottom", "at the lower right"],
    ];
    let (width, height) = (coverage.columns.div_ceil(3), coverage.rows.div_ceil(3));
    let mut empty = Vec::new();
    for (row, names) in names.iter().enumerate() {
        for (column, name) in names.iter().enumerate() {
            let inside =
                |index: &usize| index % coverage.columns / width == column && index / coverage.columns / height == row;
            let cells: Vec<usize> = (0..coverage.counts.len()).filter(inside).collect();
            let covered = cells.iter().filter(|&&index| coverage.is_covered(index)).count();
            if covered * 2 < cells.len() {
                empty.push(*name);
            }
        }
    }
    match empty.as_slice() {
        [] => "in many small places".to_owned(),
        [one] => (*one).to_owned(),
        [first @ .., last] => format!("{} or {last}", first.join(", ")),
    }
}

fn radius(trust: &Trust, board: &Board, settings: &VerdictSettings) -> Option<Finding> {
    let observed = trust.radius?;
    let ratio = observed.radius / board.radius;
    ((ratio - 1.0).abs() > settings.radius).then(|| Finding {
        cause: Cause::RadiusDisagrees,
        severity: Severity::Failure,
        reason: format!(
            "the circles look like {:.1} mm in radius, not {:.1} mm, if their spacing is {:.1} mm",
            1e3 * observed.radius,
            1e3 * board.radius,
            1e3 * board.spacing
        ),
        advice: format!(
            "measure radius and spacing on the print: one of them is wrong (with the stated radius the spacing would be {:.1} mm)",
            1e3 * board.spacing / ratio
        ),
    })
}

fn pixels_not_square(camera: &Camera<f64>, trust: &Trust, settings: &VerdictSettings) -> Option<Finding> {
    let parameters = camera.parameters();
    let (&[fx, fy], _) = parameters.split_first_chunk::<2>()?;
    let covariance = &trust.uncertainty.covariance;
    let variance = covariance[(0, 0)] + covariance[(1, 1)] - 2.0 * covariance[(0, 1)];
    let difference = (fx - fy).abs();
    let sigma = variance.max(0.0).sqrt();
    (difference > 4.0 * sigma && difference > settings.square_pixels * fx).then(|| Finding {
        cause: Cause::PixelsNotSquare,
        severity: Severity::Warning,
        reason: format!("fx and fy differ by {difference:.2} ± {sigma:.2} px, but pixels are square"),
        advice: "is the print scaled differently along its sides, or is the board bent?".to_owned(),
    })
}

fn not_one_to_one(camera: &Camera<f64>, (width, height): (u16, u16)) -> Option<Finding> {
    let pixels = (0..height).step_by(4).flat_map(|y| (0..width).step_by(4).map(move |x| (x, y)));
    let corners = [(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)];
    let all: Vec<(u16, u16)> = pixels.chain(corners).collect();
    let outside =
        all.iter().filter(|(x, y)| camera.unproject(&Vector2::new(f64::from(*x), f64::from(*y))).is_none()).count();
    (outside > 0).then(|| Finding {
        cause: Cause::NotOneToOne,
        severity: Severity::Warning,
        reason: format!(
            "the distortion folds over inside the image, at {:.1} % of the pixels",
            100.0 * outside as f64 / all.len() as f64
        ),
        advice: "cover the corners of the image, or take a model with fewer coefficients or one for wide lenses"
            .to_owned(),
    })
}

/// A focal length known worse than this part of it may be open for want of a second parameter.
const TOGETHER: f64 = 0.02;

fn undetermined(camera: &Camera<f64>, trust: &Trust) -> Option<Finding> {
    let sigma = trust.uncertainty.sigma();
    let parameters = camera.parameters();
    let names = camera.kind().parameter_names();
    let lost: Vec<&str> = names
        .iter()
        .zip(parameters.iter().zip(&sigma))
        .skip(4)
        .filter(|(_, (value, sigma))| value.abs() < 2.0 * **sigma)
        .map(|(name, _)| *name)
        .collect();
    // Each parameter may be open although the projection is known: then several only count together.
    if let (Some(fx), Some(sigma)) = (parameters.first(), sigma.first())
        && *sigma > TOGETHER * fx
        && trust.projection.rms_95 < sigma * 0.1
    {
        return Some(Finding {
            cause: Cause::ParameterUndetermined,
            severity: Severity::Note,
            reason: "focal length and shape parameters of this model are only known together, each alone is open"
                .to_owned(),
            advice: "use them together, or take a model with fewer coefficients".to_owned(),
        });
    }
    (!lost.is_empty()).then(|| Finding {
        cause: Cause::ParameterUndetermined,
        severity: Severity::Note,
        reason: format!("{} cannot be told from zero", lost.join(", ")),
        advice: "a model with fewer coefficients may do as well".to_owned(),
    })
}

fn too_poor(camera: &Camera<f64>, trust: &Trust, settings: &VerdictSettings) -> Option<Finding> {
    let pattern = trust.residuals.pattern;
    (pattern.shift > settings.pattern && pattern.shift_ratio > settings.pattern_ratio).then(|| Finding {
        cause: Cause::ModelTooPoor,
        severity: Severity::Warning,
        reason: format!(
            "{} cannot follow this lens: residuals of {:.3} px stay in the same places of the image",
            camera.kind(),
            pattern.shift
        ),
        advice: "try --model auto, or a model with more coefficients; is the board flat?".to_owned(),
    })
}

fn halves(trust: &Trust) -> Option<Finding> {
    let halves = trust.split_half.as_ref()?;
    (!halves.consistent()).then(|| Finding {
        cause: Cause::HalvesDisagree,
        severity: Severity::Warning,
        reason: format!(
            "two halves of the recording differ by {:.3} px, more than the {:.3} px that their uncertainty allows",
            halves.difference.rms, halves.bound
        ),
        advice: "did anything change in between: focus, board, temperature? The stated ± is too small".to_owned(),
    })
}
