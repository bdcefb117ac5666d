//! Choice of the camera model: the simplest one that predicts unseen data as well as any other ([`ModelRequest::Auto`]).
//!
//! Every candidate goes through the initial stage. The candidate whose model explains the most circles provides the
//! circles on which all candidates are compared. Each frame is held out of the calibration that predicts it
//! ([`crate::initial::held_out`]). The best candidate has the smallest mean cost. A candidate is as good as the best if
//! its cost exceeds the best one's by at most one standard error of the difference. Of these, the one with the fewest
//! parameters is chosen, if possible one that OpenCV and ROS support: the one-standard-error rule (Breiman et al. 1984;
//! Hastie, Tibshirani and Friedman, *The Elements of Statistical Learning*, section 7.10). The standard error is
//! computed from the difference block by block, because a difficult block is difficult for all models. If OpenCV and
//! ROS support none of these, the models that they do support count too, if their excess is too small to matter. A
//! candidate that folds over inside the image counts only if all do.

use evcal_core::sensor::Sensor;
use std::fmt;
use std::str::FromStr;

use evcal_core::camera::{ModelKind, UnknownModel};
use serde::{Deserialize, Serialize};

use crate::initial::held_out::{ComparedCircles, HeldOutCost, held_out};
use crate::initial::{InitialError, InitialModel, InitialSettings, initial_model};
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_geometry::board::Board;
use evcal_geometry::lens::folds::folds;

/// Models that `auto` tries: the models that other programs can read.
pub const CANDIDATES: [ModelKind; 9] = [
    ModelKind::Radtan4,
    ModelKind::Radtan,
    ModelKind::Radtan8,
    ModelKind::KannalaBrandt,
    ModelKind::Ucm,
    ModelKind::Eucm,
    ModelKind::DoubleSphere,
    ModelKind::Fov,
    ModelKind::Omni,
];

/// Models that OpenCV and ROS support: plumb bob, rational polynomial and equidistant.
pub const WIDELY_SUPPORTED: [ModelKind; 4] =
    [ModelKind::Radtan4, ModelKind::Radtan, ModelKind::Radtan8, ModelKind::KannalaBrandt];

/// The model of common lenses.
pub const USUAL: ModelKind = ModelKind::Radtan;

/// Models that are compared if [`USUAL`] does not suit the lens. Models with more freedom, or of other families, need the events as
/// evidence: where the board was not seen they differ by pixels, although they predict the points equally well.
pub const USUAL_CANDIDATES: [ModelKind; 3] = [ModelKind::Radtan4, USUAL, ModelKind::KannalaBrandt];

/// The requested camera model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ModelRequest {
    /// [`USUAL`], or, if it does not fit the lens, a model that does: one of [`USUAL_CANDIDATES`] by the points, or another one by the
    /// events.
    #[default]
    Usual,
    /// A given model.
    Given(ModelKind),
    /// The one of [`CANDIDATES`] that suits the recording.
    Auto,
}

impl ModelRequest {
    /// Name of [`ModelRequest::Auto`].
    pub const AUTO: &'static str = "auto";

    /// Returns the name of the model, or `auto`. The usual model has its own name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Usual => USUAL.name(),
            Self::Given(kind) => kind.name(),
            Self::Auto => Self::AUTO,
        }
    }
}

impl FromStr for ModelRequest {
    type Err = UnknownModel;

    fn from_str(name: &str) -> Result<Self, UnknownModel> {
        if name == Self::AUTO { Ok(Self::Auto) } else { name.parse().map(Self::Given) }
    }
}

/// Largest excess of a model's held-out cost over the best one's, in standard errors, at which it is as good.
const STANDARD_ERRORS: f64 = 1.0;
/// Difference of two models' held-out costs that chance does not cause, in standard errors.
const CERTAIN_ERRORS: f64 = 3.0;
/// Largest relative excess of an OpenCV/ROS model's cost over the best one's at which it is chosen, if OpenCV and ROS support
/// none of the equally good models.
const NEGLIGIBLE: f64 = 1e-3;

/// Comparison of a candidate with the best one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Mean cost minus the mean cost of the best candidate.
    pub excess: f64,
    /// Standard error of `excess`.
    pub standard_error: f64,
    /// `true` if the candidate is as good as the best.
    pub as_good: bool,
    /// `true` if the candidate counts although it is worse, because its excess is too small to matter.
    pub nearly_as_good: bool,
}

/// A candidate of [`choose`].
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Number of the model's parameters.
    pub parameters: usize,
    /// `true` if OpenCV and ROS support it.
    pub widely_supported: bool,
    /// `true` if its distortion folds over inside the image.
    pub folds: bool,
    /// Its held-out statistics, on the same blocks for all candidates.
    pub held_out: HeldOutCost,
}

/// Returns mean and standard error of the mean of `values`; the error is 0 for fewer than two.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    let error = if values.len() < 2 { 0.0 } else { (squares / (count - 1.0) / count).sqrt() };
    (mean, error)
}

/// Compares all candidates and returns the index of the chosen one with the comparisons; `None` without candidates.
///
/// A model that folds over inside the image counts only if all do. Models that OpenCV and ROS support have priority. Of
/// candidates with equally many parameters, the one with the smaller cost is chosen.
pub fn choose(candidates: &[Candidate]) -> Option<(usize, Vec<Comparison>)> {
    let cost = |candidate: &Candidate| candidate.held_out.mean();
    let best = candidates.iter().min_by(|a, b| a.folds.cmp(&b.folds).then(cost(a).total_cmp(&cost(b))))?;
    let mut comparisons: Vec<Comparison> = candidates
        .iter()
        .map(|candidate| {
            let pairs = candidate.held_out.block_costs.iter().zip(&best.held_out.block_costs);
            let differences: Vec<f64> = pairs.map(|(own, best)| own - best).collect();
            let (excess, standard_error) = mean_and_error(&differences);
            let as_good = candidate.folds == best.folds && excess <= STANDARD_ERRORS * standard_error;
            Comparison { excess, standard_error, as_good, nearly_as_good: false }
        })
        .collect();
    if !candidates
        .iter()
        .zip(&comparisons)
        .any(|(candidate, comparison)| candidate.widely_supported && comparison.as_good)
    {
        for (candidate, comparison) in candidates.iter().zip(&mut comparisons) {
            comparison.nearly_as_good = candidate.widely_supported
                && candidate.folds == best.folds
                && comparison.excess <= NEGLIGIBLE * cost(best);
        }
    }
    let counts = |comparison: &Comparison| comparison.as_good || comparison.nearly_as_good;
    let good = candidates.iter().zip(&comparisons).enumerate().filter(|(_, (_, comparison))| counts(comparison));
    let simplest = good.min_by(|(_, (a, _)), (_, (b, _))| {
        let supported = b.widely_supported.cmp(&a.widely_supported);
        supported.then(a.parameters.cmp(&b.parameters)).then(cost(a).total_cmp(&cost(b)))
    })?;
    Some((simplest.0, comparisons))
}

/// Result of one candidate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CandidateReport {
    /// Name of the model.
    pub model: String,
    /// Number of its parameters.
    pub parameters: usize,
    /// Number of held-out points; 0 for a candidate that failed.
    pub count: usize,
    /// Square root of the mean cost of a held-out point (px).
    pub root_mean_cost: Option<f64>,
    /// Mean cost minus the mean cost of the best candidate (px²).
    pub excess: Option<f64>,
    /// Standard error of the excess (px²).
    pub standard_error: Option<f64>,
    /// `true` if it is as good as the best.
    pub as_good: bool,
    /// `true` if it counts although it is worse, because its excess is too small to matter.
    #[serde(default)]
    pub nearly_as_good: bool,
    /// `true` if its distortion folds over inside the image.
    #[serde(default)]
    pub folds: bool,
    /// Reason of its failure.
    pub failure: Option<String>,
}

/// Result of the choice of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelChoice {
    /// Name of the chosen model.
    pub chosen: String,
    /// Name of the model chosen from circles, if the events showed that it does not fit the lens.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instead_of: Option<String>,
    /// Name of the model whose circles were used for the comparison.
    pub circles_of: String,
    /// All candidates.
    pub candidates: Vec<CandidateReport>,
}

impl fmt::Display for ModelChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.candidates.is_empty() {
            return f.write_str(&self.reason());
        }
        write!(f, "{} chosen; held-out points of {} (px, px²):", self.chosen, self.circles_of)?;
        for candidate in &self.candidates {
            write!(f, "\n{:<14} {:>2} parameters", candidate.model, candidate.parameters)?;
            match (candidate.root_mean_cost, candidate.excess, candidate.standard_error, &candidate.failure) {
                (Some(root), Some(excess), Some(error), _) => {
                    let good = match (candidate.as_good, candidate.nearly_as_good) {
                        (true, _) => ", as good as the best",
                        (false, true) => ", nearly as good as the best",
                        (false, false) => "",
                    };
                    let folds = if candidate.folds { ", folds over inside the image" } else { "" };
                    write!(f, ", {root:.4} px, {excess:.6} ± {error:.6} px² above the best{good}{folds}")?;
                }
                (_, _, _, Some(failure)) => write!(f, ": {failure}")?,
                _ => write!(f, ": not compared")?,
            }
        }
        Ok(())
    }
}

impl ModelChoice {
    /// Returns `true` if `kind` predicts held-out points certainly better than the chosen model, which was chosen because `kind` folds
    /// over where nothing was seen.
    pub fn prefers(&self, kind: ModelKind) -> bool {
        self.candidates.iter().filter(|candidate| candidate.model == kind.name()).any(|candidate| {
            let certain = candidate.standard_error.map(|error| -CERTAIN_ERRORS * error);
            candidate.excess.zip(certain).is_some_and(|(excess, certain)| excess < certain)
        })
    }

    /// Returns the choice of the usual model, without a comparison.
    pub fn usual() -> Self {
        let usual = USUAL.name().to_owned();
        Self { chosen: usual.clone(), instead_of: None, circles_of: usual, candidates: Vec::new() }
    }

    /// Returns the choice after the events showed that `better` can follow the lens, and the chosen model cannot.
    pub fn instead(self, better: ModelKind) -> Self {
        Self { chosen: better.name().to_owned(), instead_of: Some(self.chosen), ..self }
    }

    /// Returns the reason of the choice, in one sentence.
    pub fn reason(&self) -> String {
        if let Some(first) = &self.instead_of {
            if self.candidates.is_empty() {
                return format!("{} chosen: the events show that {first} does not fit this lens", self.chosen);
            }
            return format!(
                "{} chosen: {first} fits the points best, but the events show that it does not fit this lens",
                self.chosen
            );
        }
        let others = self.candidates.iter().filter(|candidate| candidate.as_good && candidate.model != self.chosen);
        let others: Vec<&str> = others.map(|candidate| candidate.model.as_str()).collect();
        let folding: Vec<&str> = self
            .candidates
            .iter()
            .filter(|candidate| candidate.folds && candidate.excess.is_some_and(|excess| excess < 0.0))
            .map(|candidate| candidate.model.as_str())
            .collect();
        if !folding.is_empty() {
            return format!(
                "{} chosen: {} may predict held-out points better, but folds over inside the image",
                self.chosen,
                folding.join(", ")
            );
        }
        if self.candidates.iter().any(|candidate| candidate.nearly_as_good && candidate.model == self.chosen) {
            return format!(
                "{} chosen: OpenCV and ROS support it, and it predicts held-out points nearly as well as {}",
                self.chosen,
                others.join(", ")
            );
        }
        if others.is_empty() {
            return format!("{} chosen: no other model predicts held-out points as well", self.chosen);
        }
        let supported = WIDELY_SUPPORTED.iter().any(|kind| kind.name() == self.chosen);
        let why = if supported { "among those that OpenCV and ROS support" } else { "among these" };
        format!(
            "{} chosen: it predicts held-out points as well as {}; {why} it has the fewest parameters",
            self.chosen,
            others.join(", ")
        )
    }
}

/// Tries every one of `models` on `frames` and returns the initial model of the one that fits them best.
///
/// `sensor` is (width, height) in pixels; `progress` gets the model that is being tried.
///
/// # Errors
/// The error of the first candidate, if none has an initial model.
pub fn choose_model(
    frames: &[ReferenceFrame],
    board: &Board,
    sensor: Sensor,
    models: &[ModelKind],
    initial: &InitialSettings,
    mut progress: impl FnMut(ModelKind),
) -> Result<(InitialModel, ModelChoice), InitialError> {
    let mut found: Vec<(ModelKind, InitialModel)> = Vec::new();
    let mut failures: Vec<(ModelKind, InitialError)> = Vec::new();
    for &kind in models {
        progress(kind);
        match initial_model(frames, board, sensor, kind, initial) {
            Ok(model) => found.push((kind, model)),
            Err(error) => failures.push((kind, error)),
        }
    }
    // The model that explains most circles; of several, the one with the smallest error.
    let most = found.iter().max_by(|(_, a), (_, b)| {
        a.report.circles.used.cmp(&b.report.circles.used).then(b.report.rms.total_cmp(&a.report.rms))
    });
    let Some((circles_of, reference)) = most else {
        let none = InitialError::NoCamera { views: 0, reason: "there is no model to choose from".to_owned() };
        return Err(failures.into_iter().next().map_or(none, |(_, error)| error));
    };
    let circles_of = *circles_of;
    let circles = ComparedCircles::new(reference, frames, board);
    let costs: Vec<Option<HeldOutCost>> =
        found.iter().map(|(_, model)| held_out(&circles, &model.camera, board, sensor, initial)).collect();
    let compared: Vec<usize> = (0..found.len()).filter(|&index| matches!(costs.get(index), Some(Some(_)))).collect();
    let candidates: Vec<Candidate> = found
        .iter()
        .zip(&costs)
        .filter_map(|((kind, model), held_out)| {
            let parameters = kind.parameter_names().len();
            let widely_supported = WIDELY_SUPPORTED.contains(kind);
            let folds = folds(&model.camera, sensor);
            held_out.clone().map(|held_out| Candidate { parameters, widely_supported, folds, held_out })
        })
        .collect();
    let (chosen, comparisons) = match choose(&candidates) {
        Some((position, comparisons)) => (compared.get(position).copied(), comparisons),
        None => (None, Vec::new()),
    };
    // Without a comparison, the model that explains most circles is chosen.
    let chosen = chosen.or_else(|| found.iter().position(|(kind, _)| *kind == circles_of)).unwrap_or(0);
    let report = |kind: ModelKind| {
        let blank = CandidateReport {
            model: kind.name().to_owned(),
            parameters: kind.parameter_names().len(),
            count: 0,
            root_mean_cost: None,
            excess: None,
            standard_error: None,
            as_good: false,
            nearly_as_good: false,
            folds: false,
            failure: None,
        };
        if let Some((_, error)) = failures.iter().find(|(failed, _)| *failed == kind) {
            return CandidateReport { failure: Some(error.to_string()), ..blank };
        }
        let place = compared.iter().position(|&index| found.get(index).is_some_and(|(found, _)| *found == kind));
        match place.and_then(|place| Some((candidates.get(place)?, comparisons.get(place)?))) {
            Some((candidate, comparison)) => CandidateReport {
                count: candidate.held_out.count,
                root_mean_cost: Some(candidate.held_out.mean().sqrt()),
                excess: Some(comparison.excess),
                standard_error: Some(comparison.standard_error),
                as_good: comparison.as_good,
                nearly_as_good: comparison.nearly_as_good,
                folds: candidate.folds,
                ..blank
            },
            None => CandidateReport { failure: Some("too few views without one of the parts".to_owned()), ..blank },
        }
    };
    let candidates = models.iter().map(|&kind| report(kind)).collect();
    let (kind, model) = found.swap_remove(chosen);
    Ok((
        model,
        ModelChoice {
            chosen: kind.name().to_owned(),
            instead_of: None,
            circles_of: circles_of.name().to_owned(),
            candidates,
        },
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(parameters: usize, block_costs: &[f64]) -> Candidate {
        Candidate {
            parameters,
            widely_supported: true,
            folds: false,
            held_out: HeldOutCost { count: 100, block_costs: block_costs.to_vec() },
        }
    }

    #[test]
    fn the_simplest_model_as_good_as_the_best_is_chosen() {
        let candidates = [
            candidate(12, &[1.00, 2.00, 3.00, 4.00]),
            candidate(8, &[1.01, 1.99, 3.02, 4.00]),
            candidate(5, &[1.5, 2.4, 3.6, 4.5]),
        ];
        let (chosen, comparisons) = choose(&candidates).unwrap();
        assert_eq!(chosen, 1);
        assert!(comparisons[0].as_good && comparisons[1].as_good && !comparisons[2].as_good);
        assert_eq!((comparisons[0].excess, comparisons[0].standard_error), (0.0, 0.0));
        // Mean 0.005; deviations 0.005, -0.015, 0.015, -0.005: s² = 5e-4 / 3.
        assert!((comparisons[1].excess - 0.005).abs() < 1e-12, "{comparisons:?}");
        assert!((comparisons[1].standard_error - (5e-4_f64 / 12.0).sqrt()).abs() < 1e-12, "{comparisons:?}");
    }

    /// Blocks differ much more than the models do; the difference between the models is still detected.
    #[test]
    fn blocks_that_are_difficult_for_all_models_do_not_hide_a_difference() {
        let hard = [0.1, 5.0, 0.3, 9.0, 1.0];
        let worse = hard.map(|cost| cost + 0.01);
        let (chosen, comparisons) = choose(&[candidate(4, &worse), candidate(9, &hard)]).unwrap();
        assert_eq!(chosen, 1);
        assert!(!comparisons[0].as_good && comparisons[0].standard_error < 1e-9);
    }

    #[test]
    fn of_equally_simple_models_the_better_one_is_chosen() {
        let (chosen, _) = choose(&[candidate(8, &[1.1, 0.9]), candidate(8, &[0.9, 1.0])]).unwrap();
        assert_eq!(chosen, 1);
        assert_eq!(choose(&[]), None);
    }

    #[test]
    fn a_model_that_opencv_and_ros_support_has_priority() {
        let rare = Candidate { widely_supported: false, ..candidate(6, &[1.0, 1.2, 0.9]) };
        let common = candidate(8, &[1.01, 1.19, 0.91]);
        let (chosen, comparisons) = choose(&[rare.clone(), common]).unwrap();
        assert_eq!((chosen, comparisons[1].as_good), (1, true), "{comparisons:?}");
        let (chosen, _) = choose(&[rare, candidate(8, &[1.5, 1.7, 1.4])]).unwrap();
        assert_eq!(chosen, 0);
    }

    /// The difference is a thousandth of the cost, and still many standard errors.
    #[test]
    fn a_model_that_opencv_and_ros_support_is_chosen_despite_a_negligible_difference() {
        let rare = Candidate { widely_supported: false, ..candidate(5, &[1.0, 1.2, 0.9]) };
        let slightly_worse = candidate(8, &[1.0009, 1.2010, 0.9011]);
        let simpler = candidate(4, &[1.0007, 1.2008, 0.9009]);
        let choose = |candidates: &[Candidate]| choose(candidates).unwrap().0;
        assert_eq!(choose(&[rare.clone(), slightly_worse.clone()]), 1);
        let twice_as_bad = candidate(8, &[1.0018, 1.2020, 0.9022]);
        assert_eq!(choose(&[rare.clone(), twice_as_bad]), 0);
        // It is not needed if a model that they support is as good as the best.
        let best = candidate(12, &[1.0, 1.2, 0.9]);
        assert_eq!(choose(&[rare, best, simpler, slightly_worse]), 1);
    }

    #[test]
    fn a_folding_model_is_chosen_only_if_all_models_fold() {
        let folding = |model: &Candidate| Candidate { folds: true, ..model.clone() };
        let (better, worse) = (candidate(12, &[1.0, 1.2, 0.9]), candidate(8, &[1.1, 1.3, 1.02]));
        let (chosen, comparisons) = choose(&[folding(&better), worse.clone()]).unwrap();
        assert_eq!((chosen, comparisons[0].as_good, comparisons[1].as_good), (1, false, true));
        assert!(comparisons[0].excess < 0.0 && comparisons[1].excess == 0.0);
        assert_eq!(choose(&[folding(&better), folding(&worse)]).unwrap().0, 0);
        assert_eq!(choose(&[better, worse]).unwrap().0, 0);
    }

    #[test]
    fn the_reason_distinguishes_as_good_from_nearly_as_good() {
        let report = |model: &str, as_good, nearly_as_good| CandidateReport {
            model: model.to_owned(),
            parameters: 8,
            count: 100,
            root_mean_cost: Some(0.2),
            excess: Some(0.0),
            standard_error: Some(0.0),
            as_good,
            nearly_as_good,
            folds: false,
            failure: None,
        };
        let chosen = |of_chosen| ModelChoice {
            chosen: "kannala-brandt".to_owned(),
            instead_of: None,
            circles_of: "fov".to_owned(),
            candidates: vec![report("fov", true, false), report("radtan", false, false), of_chosen],
        };
        let nearly = chosen(report("kannala-brandt", false, true)).reason();
        assert!(nearly.ends_with("held-out points nearly as well as fov"), "{nearly}");
        let as_good = chosen(report("kannala-brandt", true, false)).reason();
        assert!(as_good.contains("held-out points as well as fov;"), "{as_good}");
    }

    #[test]
    fn a_folded_model_is_preferred_only_if_it_is_certainly_better() {
        let choice = |excess: f64| {
            let radtan = CandidateReport {
                model: "radtan".to_owned(),
                parameters: 9,
                count: 100,
                root_mean_cost: Some(0.2),
                excess: Some(excess),
                standard_error: Some(0.01),
                as_good: false,
                nearly_as_good: false,
                folds: true,
                failure: None,
            };
            ModelChoice { candidates: vec![radtan], ..ModelChoice::usual() }
        };
        assert!(choice(-0.04).prefers(USUAL) && !choice(-0.02).prefers(USUAL) && !choice(0.04).prefers(USUAL));
        assert!(!choice(-0.04).prefers(ModelKind::Radtan4) && !ModelChoice::usual().prefers(USUAL));
    }

    #[test]
    fn the_reason_names_the_usual_model_that_does_not_fit() {
        let reason = ModelChoice::usual().instead(ModelKind::KannalaBrandt).reason();
        assert_eq!(reason, "kannala-brandt chosen: the events show that radtan does not fit this lens");
    }

    #[test]
    fn requests_are_read_by_name() {
        assert_eq!((ModelRequest::default(), ModelRequest::default().name()), (ModelRequest::Usual, "radtan"));
        assert_eq!("radtan".parse(), Ok(ModelRequest::Given(ModelKind::Radtan)));
        assert_eq!("auto".parse(), Ok(ModelRequest::Auto));
        assert_eq!("double-sphere".parse(), Ok(ModelRequest::Given(ModelKind::DoubleSphere)));
        assert_eq!("Auto".parse::<ModelRequest>(), Err(UnknownModel));
    }
}
