//! Knots from data: which of them the events ask for.
//!
//! The normal equations on the finest knots tell, without another look at the events, what every coarser curve
//! would cost: such a curve is one on the finest knots whose control points lie in a subspace. With A the
//! matrix of the control points (the global parameters held), c the best control points on the finest knots and
//! d those of the best curve on coarser ones, Q = (d − c)ᵀ A (d − c). Noise alone makes Q grow by six for
//! each control point that is taken away, times what makes events no measurements of their own (λ, which the
//! step from the finest knots to the next tells, for there is hardly a motion in it). Taking one away halves the
//! scatter of the curve there; where the bend that it followed is larger than that, Q grows by more than twice as much. So the
//! knots are those that make Q / λ + 2 · 6 · (number of control points) least, cell by cell of a
//! grid of halved cells: Mallows' C_p, or Akaike's criterion with inflated noise.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::knot_fit::{Displacement, KnotFit};
use super::levenberg::assemble;
use super::stiffness::{Stiffness, weigh_jerks};
use super::stretch::stretches;
use super::system::SegmentSystem;
use super::{Problem, SegmentObservations, State};
use crate::trajectory::knot_grid::{KnotGrid, KnotSettings, cheapest_levels};
use crate::trajectory::{CONTROL_POINT_PARAMETERS as CONTROL_POINT, Trajectory};
use evcal_geometry::numerics::statistics::median;

/// What was chosen.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct KnotReport {
    /// Control points of all segments.
    pub control_points: usize,
    /// The finest distance of knots (s).
    pub finest: f64,
    /// Seconds of trajectory at each distance of knots, from the finest on, each twice the one before.
    pub seconds: Vec<f64>,
    /// How much larger the scatter of the curve is than if every event were a measurement of its own, as the
    /// square of σ.
    pub inflation: f64,
}

impl KnotReport {
    /// Adds spans of `span` seconds each that have these `levels`.
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

/// Trajectories on the knots that were chosen.
pub struct KnotChoice {
    /// One for each segment.
    pub trajectories: Vec<Trajectory>,
    /// What the jerks of each weigh; empty where it stayed as it was.
    pub stiffness: Vec<Stiffness>,
    /// What was chosen.
    pub report: KnotReport,
}

/// Fewest knot spans over which costs are averaged, in spans of the level concerned.
const NEIGHBOURHOOD: usize = 3;
/// Finest spans of one sample of the scatter.
const SAMPLE: usize = 6;
/// How much better a curve must explain the events for each number that it has more, in units of what noise alone gains. 2 is where
/// the error of a curve too stiff is that of one too loose.
const GAIN: f64 = 2.0;
/// Factor by which the information of the events about the trajectory is reduced because their errors are correlated.
const NOISE: f64 = 5.0;

/// The trajectories of `state` on the knots that the observations of `problem` ask for, and what these are. A trajectory whose
/// knots are not those of a grid of `settings`, or which has no events, stays as it is.
pub fn choose_knots(problem: &Problem, state: &State, settings: &KnotSettings) -> KnotChoice {
    let on_finest = on_finest_knots(problem, state, settings);
    let system = assemble(problem, &with_finest(state, &on_finest), &stretches(&problem.segments));
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
    // The curves on the chosen knots, and the segments that they are of.
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
    KnotChoice { trajectories, stiffness, report }
}

/// Each trajectory on its finest even knots; `None` where it stays as it is.
fn on_finest_knots(problem: &Problem, state: &State, settings: &KnotSettings) -> Vec<Option<(KnotGrid, KnotFit)>> {
    let of_segment = |(trajectory, observations): (&Trajectory, &SegmentObservations)| {
        let grid = settings.grid(trajectory);
        let fit = KnotFit::new(trajectory, grid.even(0, trajectory.degree))?;
        (!observations.events.is_empty()).then_some((grid, fit))
    };
    state.trajectories.iter().zip(&problem.segments).map(of_segment).collect()
}

/// `state` with these trajectories.
fn with_finest(state: &State, on_finest: &[Option<(KnotGrid, KnotFit)>]) -> State {
    let mut fine = state.clone();
    for (trajectory, fit) in fine.trajectories.iter_mut().zip(on_finest) {
        if let Some((_, fit)) = fit {
            *trajectory = fit.trajectory.clone();
        }
    }
    fine
}

/// For each level and each finest span what the best curve on even knots of that level costs more than that on
/// the finest.
fn level_costs(grid: &KnotGrid, fit: &KnotFit, equations: &SegmentSystem) -> Option<Vec<Vec<f64>>> {
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

/// Costs averaged over neighbouring spans of their level, in units of the noise.
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

/// What makes the scatter of the curve larger than independent events would: from the step from the finest knots
/// to the next level, by the median over samples, so that hard motion here and there does not count.
fn inflation<'a>(costs: impl Iterator<Item = &'a Vec<Vec<f64>>>) -> f64 {
    let mut samples: Vec<f64> = Vec::new();
    for levels in costs {
        if let Some(first) = levels.get(1) {
            samples.extend(first.chunks_exact(SAMPLE).map(|spans| spans.iter().sum::<f64>()));
        }
    }
    // Half of the control points are taken away; the median of χ² by Wilson and Hilferty.
    let freedom = (CONTROL_POINT * SAMPLE) as f64 / 2.0;
    let middle = freedom * (1.0 - 2.0 / (9.0 * freedom)).powi(3);
    (median(&mut samples, f64::total_cmp).unwrap_or(middle) / middle).max(1.0)
}
