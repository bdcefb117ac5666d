//! Findings about a calibration: one function per check.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;

use super::board_statement::{board_finding, with_sigma};
use super::settings::{
    CERTAIN_DIFFERENCE, KNOWN_TOGETHER, LARGEST_MISFIT, LARGEST_RADIUS_DIFFERENCE, OPEN_FOCAL_LENGTH, POOR, SHORTEST,
    SIGNIFICANT, SMALLEST_COVERAGE, SMALLEST_FILL, SMALLEST_TILT, SQUARE_PIXELS,
};
use super::{Cause, Finding, Severity, VerdictSettings};
use crate::advice::Advice;
use crate::quality::board_evidence::{BoardEvidence, RADIUS};
use crate::quality::coverage::Coverage;
use crate::quality::misfit::OtherModel;
use crate::quality::split_half::SplitHalf;
use crate::quality::{EventQuality, ObservedRadius, Quality};
use evcal_geometry::board::{Board, CircleBoard};
use evcal_geometry::lens::folds::{folded_share, jumps};
use evcal_solve::solve::left_out::{LeftOut, Reason};

/// Models that project points in front of the camera only.
const PINHOLE: [ModelKind; 4] = [ModelKind::Radtan4, ModelKind::Radtan, ModelKind::Radtan8, ModelKind::InverseRadial];

/// Share of the pixels up to which a fold affects only the outermost pixels of the corners, which a lens with strong barrel distortion
/// does not fill.
const FOLDED_CORNERS: f64 = 0.01;

/// Runs all checks.
pub(super) fn findings_on(
    camera: &Camera<f64>,
    quality: &Quality,
    events: Option<&EventQuality>,
    board: &Board,
    sensor: Sensor,
    settings: &VerdictSettings,
) -> Vec<Finding> {
    let more = if events.is_some() { "record longer" } else { "take more views" };
    let mut findings = Vec::from_iter(uncertain(quality, more, settings));
    findings.extend(views(&quality.coverage));
    findings
        .extend(events.and_then(|events| radius(&events.radius?, events.board.evidence.as_ref(), board.circles()?)));
    findings.extend(events.and_then(|events| board_finding(&events.board, board, camera)));
    findings.extend(pixels_not_square(camera, quality));
    let better = match events {
        Some(events) => events.misfit.as_ref().and_then(|misfit| Some(misfit.better.as_ref()?.kind)),
        // Pictures are not solved with other models. Most lenses that fold over with a pinhole model are wide.
        None => PINHOLE.contains(&camera.kind()).then_some(ModelKind::KannalaBrandt),
    };
    let folded = not_one_to_one(camera, better, sensor);
    let folds = folded.is_some();
    findings.extend(folded);
    findings.extend(events.and_then(|events| fixed(camera, &events.undetermined)));
    findings.extend(undetermined(camera, quality, events.map_or(&[], |events| &events.undetermined)));
    findings.extend(events.and_then(|events| too_poor(camera, events, folds)));
    findings.extend(events.and_then(|events| other_model(events.rival.as_ref()?, settings)));
    findings.extend(events.and_then(|events| halves(events.split_half.as_ref()?)));
    findings.extend(events.and_then(|events| unexplained(&events.left_out)));
    findings.extend(events.and_then(saturated));
    findings
}

/// Returns the total length (s) of the intervals, and the first of them in words.
fn places<'a>(intervals: impl Iterator<Item = &'a LeftOut>) -> Option<(f64, String)> {
    /// Number of intervals that are listed individually.
    const LISTED: usize = 4;
    let intervals: Vec<&LeftOut> = intervals.collect();
    if intervals.is_empty() {
        return None;
    }
    let seconds = intervals.iter().map(|interval| interval.seconds()).sum();
    let mut places: Vec<String> = intervals.iter().take(LISTED).map(ToString::to_string).collect();
    if intervals.len() > LISTED {
        places.push(format!("{} more", intervals.len() - LISTED));
    }
    Some((seconds, places.join(", ")))
}

/// Excluded time (s) below which the finding is only a note: the first moment of a recording, or one jerk.
const SHORT: f64 = 0.1;

/// Finds times without a curve that explains the events. Late events of a saturated readout are the cause of those that it mostly
/// covers, which [`saturated`] reports.
fn unexplained(left_out: &[LeftOut]) -> Option<Finding> {
    let of = |reason: Reason| left_out.iter().filter(move |interval| interval.reason == reason);
    let is_late = |interval: &LeftOut| {
        of(Reason::Saturated).map(|other| interval.seconds_within(other)).sum::<f64>() > 0.5 * interval.seconds()
    };
    let (seconds, places) = places(of(Reason::Unexplained).filter(|interval| !is_late(interval)))?;
    Some(Finding {
        cause: Cause::Unexplained,
        severity: if seconds < SHORT { Severity::Note } else { Severity::Warning },
        reason: format!("the motion could not be followed for {seconds:.2} s ({places}): these times were not used"),
        advice: "did something else move, or was the board hidden? If not, move the camera more smoothly".into(),
    })
}

fn saturated(events: &EventQuality) -> Option<Finding> {
    let advice =
        "move the camera more slowly, from further away, or raise the contrast thresholds of its pixels".into();
    let what = "there were more events than the camera can send";
    if let Some((seconds, _)) = places(events.saturated.iter()) {
        let reason =
            format!("{what} for {seconds:.2} s, most of the recording: their times are late by an unknown amount");
        return Some(Finding { cause: Cause::Saturated, severity: Severity::Failure, reason, advice });
    }
    let (seconds, places) = places(events.left_out.iter().filter(|interval| interval.reason == Reason::Saturated))?;
    let reason = format!("{what} for {seconds:.2} s ({places}): their times are late there, and they were not used");
    let severity = if seconds < SHORT { Severity::Note } else { Severity::Warning };
    Some(Finding { cause: Cause::Saturated, severity, reason, advice })
}

/// Finds a bound that is too large; `more` is what a longer recording is called.
fn uncertain(quality: &Quality, more: &str, settings: &VerdictSettings) -> Option<Finding> {
    let bound = quality.projection.rms_95;
    let severity = if bound > POOR * settings.good {
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
        advice: Advice::Plain(format!(
            "{more}, with the board near, tilted to all sides and in every corner of the image"
        )),
    })
}

fn views(coverage: &Coverage) -> Vec<Finding> {
    let warning =
        |cause, reason, advice: &str| Finding { cause, severity: Severity::Warning, reason, advice: advice.into() };
    let mut findings = Vec::new();
    if let Some(duration) = coverage.duration
        && duration < SHORTEST
    {
        findings.push(warning(
            Cause::Short,
            format!("the board was tracked for only {duration:.1} s"),
            "record five to ten seconds in which the whole board moves",
        ));
    }
    if coverage.fill.high < SMALLEST_FILL {
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
    if coverage.tilt.high < SMALLEST_TILT {
        findings.push(warning(
            Cause::HeadOn,
            format!("the board was seen head-on, tilted by {:.0}° at most", coverage.tilt.high),
            "tilt the board by 30° to 45° to all sides: head-on views do not separate focal length and distance",
        ));
    }
    if coverage.covered < SMALLEST_COVERAGE {
        findings.push(warning(
            Cause::Uncovered,
            format!(
                "the board covered only {:.0} % of the sensor, with nothing {}",
                100.0 * coverage.covered,
                empty_places(coverage)
            ),
            "move the board through the whole image, including its corners: elsewhere the distortion is not measured",
        ));
    }
    findings
}

/// Describes the corners and sides of the sensor without observations.
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
        [] => "in many small areas".to_owned(),
        [one] => (*one).to_owned(),
        [first @ .., last] => format!("{} or {last}", first.join(", ")),
    }
}

/// Variation of the mean offset of events between kinds of light and of motion (px).
const DIFFERENT_OFFSETS: f64 = 0.25;
/// Number of standard deviations from which the evidence distinguishes a radius from its estimate.
const DISTINGUISHED: f64 = 2.0;
/// Variation of the mean offset when dots are small and pixels are slow (px): less than exchanged polarities or light dots cause.
const MOST_DIFFERENT_OFFSETS: f64 = 0.5;

/// Checks the nominal radius against the mean offset of the events. If the `evidence` confirms the nominal radius and
/// contradicts the observed one, a larger offset is accepted, because a small dot in little light changes it too.
fn radius(observed: &ObservedRadius, evidence: Option<&BoardEvidence>, board: &CircleBoard) -> Option<Finding> {
    let ratio = observed.radius / board.radius;
    let pixels = (observed.radius - board.radius) / observed.scale;
    let speaks_against = |evidence: &&BoardEvidence| {
        let deviation = |radius: f64| (evidence.values[RADIUS] - radius).abs() / evidence.sigma[RADIUS];
        deviation(board.radius) < DISTINGUISHED && deviation(observed.radius) > DISTINGUISHED
    };
    let most = evidence.filter(speaks_against).map_or(DIFFERENT_OFFSETS, |_| MOST_DIFFERENT_OFFSETS);
    ((ratio - 1.0).abs() > LARGEST_RADIUS_DIFFERENCE && pixels.abs() > most).then(|| Finding {
        cause: Cause::RadiusDisagrees,
        severity: Severity::Failure,
        reason: format!(
            "the circles appear to have a radius of {:.1} mm, not {:.1} mm, if their spacing is {:.1} mm",
            1e3 * observed.radius,
            1e3 * board.radius,
            1e3 * board.spacing
        ),
        advice: Advice::Plain(format!(
            "measure radius and spacing on the print: one of them is wrong (with the stated radius the spacing would be {:.1} mm)",
            1e3 * board.spacing / ratio
        )),
    })
}

fn pixels_not_square(camera: &Camera<f64>, quality: &Quality) -> Option<Finding> {
    let parameters = camera.parameters();
    let (&[fx, fy], _) = parameters.split_first_chunk::<2>()?;
    let covariance = &quality.uncertainty.covariance;
    let variance = covariance[(0, 0)] + covariance[(1, 1)] - 2.0 * covariance[(0, 1)];
    let difference = (fx - fy).abs();
    let sigma = variance.max(0.0).sqrt();
    (difference > CERTAIN_DIFFERENCE * sigma && difference > SQUARE_PIXELS * fx).then(|| Finding {
        cause: Cause::PixelsNotSquare,
        severity: Severity::Warning,
        reason: format!("fx and fy differ by {} px, but pixels are square", with_sigma(difference, sigma)),
        advice: "tilt and rotate the board more: its print and bend are estimated, but it must be seen from all sides"
            .into(),
    })
}

/// Share of folded pixels that is 0.0 %.
const ONE_CORNER: f64 = 5e-4;

/// Finds a lens that folds over inside the image; `better` is the model that follows the lens better, if there is one.
fn not_one_to_one(camera: &Camera<f64>, better: Option<ModelKind>, sensor: Sensor) -> Option<Finding> {
    let share = folded_share(camera, sensor);
    let reason = if share > 0.0 && share < ONE_CORNER {
        "the distortion folds over in a corner of the image".to_owned()
    } else if share > 0.0 {
        format!("the distortion folds over inside the image, at {:.1} % of the pixels", 100.0 * share)
    } else if jumps(camera, sensor) {
        "the distortion jumps or turns back inside the image, where the reported uncertainty is not valid".to_owned()
    } else {
        return None;
    };
    Some(Finding {
        cause: Cause::NotOneToOne,
        severity: if share > 0.0 && share < FOLDED_CORNERS { Severity::Warning } else { Severity::Failure },
        reason,
        advice: better.map_or_else(|| "cover the corners of the image".into(), Advice::TakeModel),
    })
}

fn fixed(camera: &Camera<f64>, fixed: &[usize]) -> Option<Finding> {
    let (names, values) = (camera.kind().parameter_names(), camera.parameters());
    let listed: Vec<String> = fixed
        .iter()
        .filter_map(|&index| Some(format!("{} was fixed at {}", names.get(index)?, values.get(index)?)))
        .collect();
    (!listed.is_empty()).then(|| Finding {
        cause: Cause::ParameterUndetermined,
        severity: Severity::Note,
        reason: format!("this recording does not determine all lens parameters: {}", listed.join(", ")),
        advice: Advice::Free(fixed.iter().filter_map(|&index| names.get(index).copied()).collect()),
    })
}

fn undetermined(camera: &Camera<f64>, quality: &Quality, fixed: &[usize]) -> Option<Finding> {
    let sigma = quality.uncertainty.sigma();
    let parameters = camera.parameters();
    let names = camera.kind().parameter_names();
    let lost: Vec<&str> = names
        .iter()
        .zip(parameters.iter().zip(&sigma))
        .enumerate()
        .skip(4)
        .filter(|(index, _)| !fixed.contains(index))
        .filter(|(_, (_, (value, sigma)))| value.abs() < SIGNIFICANT * **sigma)
        .map(|(_, (name, _))| *name)
        .collect();
    // Each parameter may be poorly determined although the projection is known: then they are only meaningful together.
    if let (Some(fx), Some(sigma)) = (parameters.first(), sigma.first())
        && *sigma > OPEN_FOCAL_LENGTH * fx
        && quality.projection.rms_95 < sigma * KNOWN_TOGETHER
    {
        return Some(Finding {
            cause: Cause::ParameterUndetermined,
            severity: Severity::Note,
            reason: "focal length and shape parameters of this model are strongly correlated: individual values are not reliable"
                .to_owned(),
            advice: "use their values only together".into(),
        });
    }
    let (simpler, coefficient) = simpler_model(camera.kind()).filter(|(_, coefficient)| lost.contains(coefficient))?;
    Some(Finding {
        cause: Cause::ParameterUndetermined,
        severity: Severity::Note,
        reason: format!("{coefficient} is not significantly different from zero"),
        advice: Advice::Plain(format!("the model {simpler}, without {coefficient}, is probably sufficient")),
    })
}

/// Returns the model that differs from `kind` by the lack of one coefficient, and the name of that coefficient.
fn simpler_model(kind: ModelKind) -> Option<(ModelKind, &'static str)> {
    match kind {
        ModelKind::Radtan => Some((ModelKind::Radtan4, "k3")),
        ModelKind::DoubleSphere => Some((ModelKind::Ucm, "xi")),
        _ => None,
    }
}

/// Finds residuals that stay in the same parts of the image. If the lens model `folds` over, this is the cause of those that no other
/// model explains.
fn too_poor(camera: &Camera<f64>, events: &EventQuality, folds: bool) -> Option<Finding> {
    let pattern = &events.residuals.pattern;
    let misfit = events.misfit.as_ref().filter(|_| pattern.is_suspicious())?;
    let own = camera.kind();
    let Some(OtherModel { kind, difference }) = &misfit.better else {
        return (pattern.is_condemning() && !folds).then(|| Finding {
            cause: Cause::ModelTooPoor,
            severity: Severity::Warning,
            reason: format!(
                "systematic residuals of {:.3} px remain over the image, and no other model explains them better",
                pattern.shift
            ),
            advice: Advice::CheckLensAndBoard,
        });
    };
    Some(Finding {
        cause: Cause::ModelTooPoor,
        severity: if misfit.rms > LARGEST_MISFIT { Severity::Failure } else { Severity::Warning },
        reason: format!(
            "{own} cannot follow this lens; the model {kind} fits better, and its pixels differ by {:.2} px over the sensor ({:.1} px at most)",
            difference.rms, difference.max
        ),
        advice: Advice::TakeModel(*kind),
    })
}

/// Finds another model that may be right, if it differs by more than a good calibration may be wrong.
fn other_model(rival: &OtherModel, settings: &VerdictSettings) -> Option<Finding> {
    let OtherModel { kind, difference } = rival;
    (difference.rms > settings.good).then(|| Finding {
        cause: Cause::Uncovered,
        severity: Severity::Warning,
        reason: format!(
            "{kind} explains the events as well as the chosen lens model, and differs from it by {:.2} px over the sensor ({:.1} px at most)",
            difference.rms, difference.max
        ),
        advice: "move the board through the whole image, including its corners: there the models differ".into(),
    })
}

fn halves(halves: &SplitHalf) -> Option<Finding> {
    (!halves.consistent()).then(|| Finding {
        cause: Cause::HalvesDisagree,
        severity: Severity::Warning,
        reason: format!(
            "two halves of the recording differ by {:.3} px, while {:.3} px are expected (95 % bound: {:.3} px)",
            halves.difference.rms, halves.expected_rms, halves.bound
        ),
        advice: "did anything change in between: focus, board, temperature? The reported ± is too small".into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In little light, dots of 3 px have an offset of their own (11 circles of 8 mm, 2.7 mm/px), which must not be
    /// reported as a wrong radius.
    #[test]
    fn a_radius_that_the_evidence_confirms_is_not_reported() {
        let board: CircleBoard = "acircles:11x5:30mm:r8mm".parse().unwrap();
        let scale = 2.7e-3;
        let listed = |pixels: f64, evidence: Option<(f64, f64)>| {
            let observed = ObservedRadius { mean_offset: pixels - 0.41, scale, radius: board.radius + pixels * scale };
            let evidence = evidence.map(|(radius, sigma)| BoardEvidence {
                values: [1.0, 0.0, 0.0, radius],
                sigma: [1e-4, 1e-4, 1e-4, sigma],
            });
            radius(&observed, evidence.as_ref(), &board).is_some()
        };
        let stated = Some((8.1e-3, 0.23e-3));
        assert!(listed(0.3, None) && !listed(0.3, stated) && !listed(-0.3, stated));
        // Evidence that distinguishes neither, or supports another radius, does not confirm the stated one.
        assert!(listed(0.3, Some((8.1e-3, 1e-3))) && listed(0.3, Some((8.9e-3, 0.23e-3))));
        // Light dots, or exchanged polarities.
        assert!(listed(0.8, stated) && listed(-0.8, stated));
    }

    /// A zero and a pole of the distortion 199 px from the middle, inside the image.
    #[test]
    fn a_pole_inside_the_image_is_reported() {
        let [k1, k4] = [1.9901_f64, 1.99].map(|radius| -1.0 / (radius * radius));
        let parameters = [100.0, 100.0, 159.5, 159.5, k1, 0.0, 0.0, 0.0, 0.0, k4, 0.0, 0.0];
        let camera = Camera::from_parameters(ModelKind::Radtan8, &parameters).unwrap();
        let reason = |size: u16| not_one_to_one(&camera, None, Sensor::new(size, size)).map(|finding| finding.reason);
        assert!(reason(320).is_some_and(|reason| reason.contains("jumps")));
        assert_eq!(reason(160), None);
    }

    /// A pinhole model on a fisheye: half of the pixels have no bearing. The verdict names one model.
    #[test]
    fn a_folded_lens_is_a_failure_that_names_the_better_model() {
        let parameters = [102.7, 102.7, 173.1, 130.1, -0.24, 0.055, 0.0, 0.0, -0.0056];
        let camera = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        let sensor = Sensor::new(346, 260);
        let finding = not_one_to_one(&camera, Some(ModelKind::KannalaBrandt), sensor).unwrap();
        assert_eq!(
            (finding.severity, finding.advice),
            (Severity::Failure, Advice::TakeModel(ModelKind::KannalaBrandt))
        );
        // Barrel distortion that ends just before the farthest corner.
        let parameters = [262.0, 262.0, 171.5, 131.0, -0.37, 0.19, -0.0005, 0.0003, -0.06];
        let corner = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        assert!(not_one_to_one(&corner, None, sensor).is_some_and(|finding| finding.severity == Severity::Warning));
        let alone = not_one_to_one(&camera, None, sensor).unwrap();
        assert_eq!((alone.severity, alone.advice), (Severity::Failure, "cover the corners of the image".into()));
    }

    #[test]
    fn only_motion_without_another_cause_is_unexplained() {
        let interval = |start, end, reason| LeftOut { recording: 0, start, end, reason };
        let late = interval(1.0, 1.5, Reason::Saturated);
        let reason = |start, end| {
            let intervals = [late, interval(start, end, Reason::Unexplained)];
            unexplained(&intervals).map(|finding| finding.reason)
        };
        assert_eq!(reason(0.95, 1.51), None);
        assert!(reason(1.4, 1.7).is_some_and(|reason| reason.contains("for 0.30 s (1.40 to 1.70 s)")));
        assert!(unexplained(&[late, LeftOut { recording: 1, ..interval(1.0, 1.5, Reason::Unexplained) }]).is_some());
    }
}
