//! Selection of the knots that the events support.
//!
//! The normal equations on the finest knots determine the cost of every coarser curve without processing the events
//! again: a coarser curve is one on the finest knots whose control points lie in a subspace. With A the matrix of the
//! control points (the global parameters fixed), c the best control points on the finest knots and d the control points
//! of the best curve on coarser knots, Q = (d − c)ᵀ A (d − c). Noise alone increases Q by six for each removed control
//! point, times λ, the factor by which correlated events overstate the information. λ is estimated from the two finest
//! levels, where real motion contributes almost nothing. Removing a control point reduces the scatter of the curve, but
//! the curve then lacks the bend that the control point followed. The bend is larger than the scatter if Q grows by
//! more than twice as much as from noise alone. So the knots minimise Q / λ + 2 · 6 · (number of control points), cell
//! by cell of a grid of halved cells: Mallows' C_p, or Akaike's criterion with inflated noise.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Problem;
use super::SegmentObservations;
use super::SolveError;
use super::State;
use super::levenberg::assemble;
use super::observation_range::observation_ranges;
use crate::solve::equations::band::Band;
use crate::solve::equations::border::Columns;
use crate::solve::equations::knot_fit::{Displacement, KnotFit};
use crate::solve::equations::stiffness::{Stiffness, weigh_jerks};
use crate::trajectory::knot_grid::{KnotGrid, KnotSettings, cheapest_levels};
use crate::trajectory::{CONTROL_POINT_PARAMETERS as CONTROL_POINT, Trajectory};
use evcal_geometry::numerics::statistics::median;

/// Statistics of the selected knots.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct KnotReport {
    /// Number of control points of all segments.
    pub control_points: usize,
    /// The finest knot spacing (s).
    pub finest: f64,
    /// Seconds of trajectory at each knot spacing, from the finest on; each spacing is twice the one before.
    pub seconds: Vec<f64>,
    /// Factor by which the variance of the curve exceeds the variance of independent events.
    pub inflation: f64,
}

impl KnotReport {
    /// Adds spans of `span` seconds each with these `levels`.
    fn add(&mut self, levels: &[usize], span: f64) {
        for &level in levels {
            if self.seconds.len() <= level {
                self.seconds.resize(level + 1, 0.0);
            }
            if let Some(seconds) = self.seconds.get_mut(level) {
                *seconds += span;
            }
        }
    }
}

/// Trajectories on the selected knots.
pub struct KnotChoice {
    /// One trajectory per segment.
    pub trajectories: Vec<Trajectory>,
    /// Weights of the jerks of each trajectory; empty if it was not changed.
    pub stiffness: Vec<Stiffness>,
    /// Statistics of the selected knots.
    pub report: KnotReport,
}

/// Number of knot spans over which costs are averaged; a span has the length of the level whose costs are averaged.
const NEIGHBOURHOOD: usize = 3;
/// Number of finest spans that form one sample of the scatter.
const SAMPLE: usize = 6;
/// Factor by which each additional parameter of a curve must improve the cost, relative to the improvement by noise
/// alone. At 2, the errors of a curve that is too stiff and of one that is too loose are equal.
const GAIN: f64 = 2.0;
/// Factor by which the information of the events about the trajectory is reduced because their errors are correlated.
const NOISE: f64 = 5.0;

/// Puts the trajectories of `state` on the knots that the observations of `problem` support. A trajectory whose knots do not
/// belong to a grid of `settings`, or which has no events, is not changed.
///
/// # Errors
/// [`SolveError::OutOfBand`] if observations and trajectories do not fit together.
pub fn choose_knots(problem: &Problem, state: &State, settings: &KnotSettings) -> Result<KnotChoice, SolveError> {
    let on_finest = on_finest_knots(problem, state, settings);
    let ranges = observation_ranges(&problem.segments);
    let system = assemble(problem, &with_finest(state, &on_finest), &ranges, &Columns::none())?;
    let costs: Vec<Option<Vec<Vec<f64>>>> = on_finest
        .par_iter()
        .zip(&system.segments)
        .map(|(fit, equations)| {
            let (grid, fit) = fit.as_ref()?;
            level_costs(grid, fit, equations)
        })
        .collect();
    let inflation = inflation(costs.iter().flatten());
    let mut report = KnotReport { inflation, finest: settings.finest, seconds: Vec::new(), control_points: 0 };
    // The curves on the selected knots, and their segments.
    let (mut places, mut nearest) = (Vec::new(), Vec::new());
    for (segment, (fit, costs)) in on_finest.iter().zip(&costs).enumerate() {
        let (Some((grid, fit)), Some(costs)) = (fit, costs) else { continue };
        let trajectory = &fit.trajectory;
        let scaled: Vec<Vec<f64>> =
            costs.iter().enumerate().map(|(level, costs)| smoothed(costs, level, inflation)).collect();
        let levels = cheapest_levels(&scaled, GAIN * CONTROL_POINT as f64);
        let knots = grid.uneven(&levels, trajectory.degree);
        if let Some(curve) = system.segments.get(segment).and_then(|equations| fit.nearest_on(&knots, equations)) {
            places.push((segment, fit));
            nearest.push(curve);
        }
        report.add(&levels, (trajectory.end() - trajectory.start()) / levels.len().max(1) as f64);
    }
    let mut trajectories = state.trajectories.clone();
    let mut stiffness = vec![Stiffness::new(); trajectories.len()];
    let stiff = weigh_jerks(&nearest, NOISE);
    for (((segment, fit), (curve, _)), stiff) in places.into_iter().zip(nearest).zip(stiff) {
        let moved = stiff.and_then(|(weights, step)| Some((fit.moved(curve, &step)?, weights)));
        let of_segment = trajectories.get_mut(segment).zip(stiffness.get_mut(segment));
        if let (Some(moved), Some((trajectory, stiffness))) = (moved, of_segment) {
            (*trajectory, *stiffness) = moved;
        }
    }
    report.control_points = trajectories.iter().map(Trajectory::control_point_count).sum();
    Ok(KnotChoice { trajectories, stiffness, report })
}

/// Puts each trajectory on its finest even knots; `None` if it is not changed.
fn on_finest_knots(problem: &Problem, state: &State, settings: &KnotSettings) -> Vec<Option<(KnotGrid, KnotFit)>> {
    let of_segment = |(trajectory, observations): (&Trajectory, &SegmentObservations)| {
        let grid = settings.grid(trajectory);
        let fit = KnotFit::new(trajectory, grid.even(0, trajectory.degree))?;
        (!observations.events.is_empty()).then_some((grid, fit))
    };
    state.trajectories.iter().zip(&problem.segments).map(of_segment).collect()
}

/// Returns `state` with these trajectories.
fn with_finest(state: &State, on_finest: &[Option<(KnotGrid, KnotFit)>]) -> State {
    let mut fine = state.clone();
    for (trajectory, fit) in fine.trajectories.iter_mut().zip(on_finest) {
        if let Some((_, fit)) = fit {
            *trajectory = fit.trajectory.clone();
        }
    }
    fine
}

/// Returns, for each level and each finest span, the additional cost of the best curve on even knots of that level over the best
/// curve on the finest knots.
fn level_costs(grid: &KnotGrid, fit: &KnotFit, equations: &Band) -> Option<Vec<Vec<f64>>> {
    let spans = grid.finest_spans();
    let degree = fit.trajectory.degree;
    let finest = fit.step(equations)?;
    let of_level = |level: usize| {
        let coarser = fit.displacement(&grid.even(level, degree), equations)?;
        let difference: Displacement =
            coarser.iter().zip(&finest).map(|(a, b)| std::array::from_fn(|axis| a[axis] - b[axis])).collect();
        let mut of_spans = vec![0.0; spans];
        for (index, (force, part)) in equations.times(&difference).iter().zip(&difference).enumerate() {
            let cost: f64 = force.iter().zip(part).map(|(force, part)| force * part).sum();
            // The middle of the spans that the control point acts on; of an even number of them, the two in the middle.
            for back in [degree.div_ceil(2), degree / 2] {
                let span = index.saturating_sub(back).min(spans - 1);
                if let Some(sum) = of_spans.get_mut(span) {
                    *sum += 0.5 * cost;
                }
            }
        }
        Some(of_spans)
    };
    let coarser: Option<Vec<Vec<f64>>> = (1..=grid.levels()).into_par_iter().map(of_level).collect();
    Some([vec![vec![0.0; spans]], coarser?].concat())
}

/// Averages costs over neighbouring spans of their level, in units of the noise.
fn smoothed(costs: &[f64], level: usize, inflation: f64) -> Vec<f64> {
    let half = (NEIGHBOURHOOD << level) / 2;
    let mut sums = vec![0.0];
    sums.extend(costs.iter().scan(0.0, |sum, cost| {
        *sum += cost;
        Some(*sum)
    }));
    (0..costs.len())
        .map(|span| {
            let (first, end) = (span.saturating_sub(half), (span + half + 1).min(costs.len()));
            let sum = sums.get(end).zip(sums.get(first)).map_or(0.0, |(end, first)| end - first);
            sum / ((end - first) as f64 * inflation)
        })
        .collect()
}

/// Returns the factor by which the variance of the curve exceeds the variance of independent events, from the two finest levels.
/// It is the median over samples, so that a few moments of violent motion do not count.
fn inflation<'a>(costs: impl Iterator<Item = &'a Vec<Vec<f64>>>) -> f64 {
    let mut samples: Vec<f64> = Vec::new();
    for levels in costs {
        if let Some(first) = levels.get(1) {
            samples.extend(first.chunks_exact(SAMPLE).map(|spans| spans.iter().sum::<f64>()));
        }
    }
    // Half of the control points are removed; the median of χ² is from Wilson and Hilferty.
    let freedom = (CONTROL_POINT * SAMPLE) as f64 / 2.0;
    let middle = freedom * (1.0 - 2.0 / (9.0 * freedom)).powi(3);
    (median(&mut samples, f64::total_cmp).unwrap_or(middle) / middle).max(1.0)
}
