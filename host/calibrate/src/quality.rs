//! Quality of a calibration: uncertainty, coverage, comparison of halves, verdict.

pub mod board_evidence;
pub mod coverage;
pub mod cross_check;
pub mod drift;
pub mod misfit;
pub mod poses;
pub mod residual_map;
pub mod split_half;
pub mod uncertainty;
pub mod verdict;

use evcal_core::camera::ModelKind;
use evcal_core::sensor::Sensor;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::picture_calibration::calibration::{PictureCalibration, PictureSource};
use crate::quality::board_evidence::BoardEstimate;
use crate::quality::coverage::{Coverage, coverage, coverage_of};
use crate::quality::drift::Drift;
use crate::quality::misfit::{Misfit, OtherModel, misfit, rival, with_misfit};
use crate::quality::residual_map::histogram::{ClassResiduals, class_residuals};
use crate::quality::residual_map::{ResidualMap, residual_map};
use crate::quality::split_half::{SplitHalf, split_half};
use crate::quality::uncertainty::parts::ProjectionParts;
use crate::quality::uncertainty::projection::{ProjectionUncertainty, projection_uncertainty};
use crate::quality::uncertainty::{BiasSigma, SolveUncertainty, Uncertainty};
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_geometry::board::Board;
use evcal_geometry::lens::folds::folds;
use evcal_solve::solve::equations::pose_covariance::PoseCovariance;
use evcal_solve::solve::left_out::LeftOut;
use evcal_solve::solve::refinement::Refined;
use evcal_solve::solve::rows::board_edge::BoardEdges;
use evcal_solve::solve::rows::burst::RANK_COUNT;
use evcal_solve::solve::rows::event_bias::bias::Bias;
use evcal_solve::solve::rows::event_bias::{CLASS_COUNT, EventKind};
use evcal_solve::solve::{Problem, SolveError, State};

/// Quality measures of a calibration, whatever its input was.
#[derive(Clone, Debug)]
pub struct Quality {
    /// Covariance of the intrinsics.
    pub uncertainty: Uncertainty,
    /// Uncertainty of the projection that follows from it.
    pub projection: ProjectionUncertainty,
    /// Coverage of the sensor, and the poses of the board.
    pub coverage: Coverage,
}

/// Quality measures of a calibration along trajectories, in addition to [`Quality`].
#[derive(Clone, Debug)]
pub struct EventQuality {
    /// Contribution of each cause to the uncertainty of the projection.
    pub projection_parts: ProjectionParts,
    /// Standard deviations of the event biases.
    pub bias_sigma: BiasSigma,
    /// Comparison of two halves that were calibrated separately; `None` if the recordings are too short.
    pub split_half: Option<SplitHalf>,
    /// A change of the lens or the board within the recordings; `None` if there is none.
    pub drift: Option<Drift>,
    /// The residuals over the sensor.
    pub residuals: ResidualMap,
    /// The residuals of each event class.
    pub classes: [ClassResiduals; CLASS_COUNT],
    /// The residuals of each polarity, OFF first, and rank in the burst.
    pub ranks: [ClassResiduals; 2 * RANK_COUNT],
    /// Difference between the lens model and the lens; `None` if the residuals do not contradict the model.
    pub misfit: Option<Misfit>,
    /// A lens model that may be right instead, if evcal chose the model: the one that differs most.
    pub rival: Option<OtherModel>,
    /// The estimated board.
    pub board: BoardEstimate,
    /// Indices of the coefficients of the lens that were fixed because the observations do not determine them.
    pub undetermined: Vec<usize>,
    /// Radius of the circles from the events; `None` if the input consists of circle centres.
    pub radius: Option<ObservedRadius>,
    /// Covariance of the poses.
    pub poses: PoseCovariance,
    /// Excluded intervals.
    pub left_out: Vec<LeftOut>,
    /// Intervals with a saturated readout that are too long to be excluded.
    pub saturated: Vec<LeftOut>,
}

/// The circles' radius from the events.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObservedRadius {
    /// Mean distance of the events from the edge in pixels, positive outside the dot.
    pub mean_offset: f64,
    /// Metres on the board per pixel, on average.
    pub scale: f64,
    /// Radius in metres at which the mean distance would be the usual one.
    pub radius: f64,
}

/// Usual mean distance of events from the edge (px). It is negative (inside the dot): events happen where the logarithm
/// of the brightness changes, and at a blurred edge this is on its dark side.
const USUAL_OFFSET: f64 = -0.41;

/// Returns a lens model that follows the lens of `refined` better than its own model, if there is one.
pub fn better_model(refined: &Refined, inflation: f64) -> Option<ModelKind> {
    let (problem, state) = (&refined.problem, &refined.state);
    let residuals = residual_map(problem, state, &refined.events);
    misfit_of(problem, state, &residuals, inflation)?.better.map(|better| better.kind)
}

/// Returns the misfit if the residuals contradict the model, or if it folds over inside the image and another model does not.
fn misfit_of(problem: &Problem, state: &State, residuals: &ResidualMap, inflation: f64) -> Option<Misfit> {
    let is_suspicious = residuals.pattern.is_suspicious();
    (is_suspicious || folds(&state.camera, problem.sensor))
        .then(|| misfit(problem, state, &residuals.pattern, inflation))
        .filter(|misfit| is_suspicious || misfit.better.is_some())
}

/// Uncertainty of a joint solve, the board in it, and the coefficients that it does not determine.
pub struct SolveCertainty {
    /// Uncertainty of its estimates.
    pub uncertainty: SolveUncertainty,
    /// The board in this solve.
    pub board: BoardEstimate,
    /// Indices of the coefficients that it does not determine.
    pub undetermined: Vec<usize>,
}

/// Computes the quality of `refined`. `saturated` are the intervals with a saturated readout that are in the solve, `scale` is the σ of
/// the focal lengths, as a share of them, that the uncertainty does not include yet, `models` are those that the lens may have instead
/// of its own; none if the user stated the model.
///
/// # Errors
/// [`SolveError::Singular`] if the observations do not determine the camera.
pub fn examine(
    refined: &Refined,
    certainty: SolveCertainty,
    board: &Board,
    saturated: &[LeftOut],
    scale: f64,
    models: &[ModelKind],
) -> Result<(Quality, EventQuality), SolveError> {
    let (problem, state) = (&refined.problem, &refined.state);
    let SolveUncertainty { intrinsics: mut uncertainty, mut parts, bias_sigma, poses, halves, drift, .. } =
        certainty.uncertainty;
    let in_the_image = |uncertainty: &Uncertainty| {
        projection_uncertainty(&state.camera, &uncertainty.covariance, problem.sensor).map_err(|_| SolveError::Singular)
    };
    let of_events = &refined.events;
    // Both halves have the same misfit, so their comparison does not include it.
    let split_half = halves.and_then(|halves| split_half(problem, state, &halves, of_events, &parts));
    if let Some(drift) = &drift {
        // The halves have the change in common, so their comparison does not include it either.
        let distance = drift.covariance();
        uncertainty.covariance += &distance;
        parts.between_parts += distance;
    }
    let focal_lengths = DVector::from_fn(uncertainty.covariance.nrows(), |row, _| {
        let is_estimated = row < 2 && problem.free.intrinsics.get(row).copied().unwrap_or(false);
        if is_estimated { scale * state.camera.parameters().get(row).copied().unwrap_or(0.0) } else { 0.0 }
    });
    let of_scale = &focal_lengths * focal_lengths.transpose();
    uncertainty.covariance += &of_scale;
    uncertainty.systematic_scale = uncertainty.systematic_scale.hypot(scale);
    parts.focal_lengths += of_scale;
    let ((classes, ranks), residuals) = rayon::join(
        || {
            let rank = |kind: EventKind| kind.polarity.index() * RANK_COUNT + usize::from(kind.place.rank);
            (class_residuals(of_events, |kind| kind.class()), class_residuals(of_events, rank))
        },
        || residual_map(problem, state, of_events),
    );
    let misfit = misfit_of(problem, state, &residuals, uncertainty.inflation);
    let rival = rival(problem, state, models, uncertainty.inflation);
    let before = uncertainty.covariance.clone();
    let of_misfit = misfit.as_ref().map_or(0.0, |misfit| misfit.rms);
    let of_model = of_misfit.max(rival.as_ref().map_or(0.0, |rival| rival.difference.rms));
    let mut projection = in_the_image(&uncertainty)?;
    if of_model > 0.0 {
        uncertainty = with_misfit(uncertainty, &projection, of_model);
        projection = in_the_image(&uncertainty)?;
    }
    let projection_parts = parts
        .projection(&state.camera, &(&uncertainty.covariance - before), problem.sensor)
        .map_err(|_| SolveError::Singular)?;
    let events = EventQuality {
        projection_parts,
        bias_sigma,
        split_half,
        drift,
        residuals,
        classes,
        ranks,
        misfit,
        rival,
        radius: observed_radius(refined),
        board: certainty.board,
        undetermined: certainty.undetermined,
        left_out: refined.left_out.clone(),
        saturated: saturated.to_vec(),
        poses,
    };
    Ok((Quality { uncertainty, projection, coverage: coverage(problem, state, board) }, events))
}

/// Examines a calibration from pictures alone.
///
/// # Errors
/// [`SolveError::Singular`] if the lens covers almost nothing of the sensor.
pub fn examine_pictures(
    calibration: &PictureCalibration,
    board: &Board,
    sensor: Sensor,
) -> Result<Quality, SolveError> {
    let projection = projection_uncertainty(&calibration.camera, &calibration.covariance, sensor)
        .map_err(|_| SolveError::Singular)?
        .of_few_views(calibration.report.used.saturating_sub(1));
    let used: Vec<&ReferenceFrame> =
        calibration.posed.iter().filter_map(|posed| calibration.frames.get(posed.frame)).collect();
    let followed = || {
        let recordings = used.chunk_by(|a, b| a.recording == b.recording);
        recordings.filter_map(|recording| Some(recording.last()?.t() - recording.first()?.t())).sum()
    };
    let duration = (calibration.report.source == PictureSource::Frames).then(followed);
    let pixels = calibration.posed.iter().flat_map(|posed| posed.circles.iter().map(|circle| circle.center.into()));
    let poses = calibration.posed.iter().map(|posed| posed.pose);
    Ok(Quality {
        uncertainty: Uncertainty {
            covariance: calibration.covariance.clone(),
            systematic: DMatrix::zeros(calibration.covariance.nrows(), calibration.covariance.ncols()),
            systematic_scale: 0.0,
            inflation: calibration.inflation,
            observations: calibration.report.dots_used,
            blocks: calibration.report.used,
        },
        projection,
        coverage: coverage_of(&calibration.camera, sensor, board, pixels, poses, duration),
    })
}

fn observed_radius(refined: &Refined) -> Option<ObservedRadius> {
    let bias = &refined.state.bias;
    let radius = refined.state.board.radius;
    let scale = refined.problem.mean_scale;
    let BoardEdges::Rims(_) = refined.problem.edges else { return None };
    let inverse_radius = scale / radius;
    let (mut sum, mut count) = (0.0, 0_usize);
    // The mean over both polarities, because a delay of events shifts them to opposite sides.
    let mut of_polarity = [(0.0, 0_usize); 2];
    for event in refined.problem.segments.iter().flat_map(|segment| &segment.events) {
        let class = usize::from(event.class);
        let polarity = EventKind::of_class(class).polarity.index();
        if let (Some(bias), Some(part)) = (bias.get(class), of_polarity.get_mut(polarity)) {
            part.0 += bias.biases[Bias::Offset] + bias.biases[Bias::Curvature] * inverse_radius;
            part.1 += 1;
        }
    }
    for (part, events) in of_polarity {
        if events > 0 {
            sum += part / events as f64;
            count += 1;
        }
    }
    (count > 0).then(|| {
        let mean_offset = sum / count as f64;
        ObservedRadius { mean_offset, scale, radius: radius + (mean_offset - USUAL_OFFSET) * scale }
    })
}
