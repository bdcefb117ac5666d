//! The whole bordered block-banded system: sum of the intervals, damping, Schur complement.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::control_band::{Block, NotPositiveDefinite, banded_times, factored, mean_diagonal};
use super::eliminated::{ControlCovariance, Eliminated, Following};
use super::loss::Loss;
use super::normal::{BorderBlock, RangeEquations};
use super::observation_range::ObservationRange;
use super::smoothness::{Acceleration, accelerations};
use super::stiffness::{Stiffness, add_jerk};
use super::{GLOBAL_COUNT, places};
use crate::trajectory::Trajectory;
use crate::trajectory::jerk::{Jerk, jerks};

/// Normal equations of one segment: A (block-banded), B (border) and gradient.
pub struct SegmentSystem {
    /// Number of control points that act at one time, 1 without observations.
    pub order: usize,
    /// For each control point its blocks of A with itself (lower triangle) and the `order − 1` before it.
    pub blocks: Vec<Block>,
    border: Vec<BorderBlock>,
    /// For each control point its gradient.
    pub gradient: Vec<[f64; 6]>,
    /// Mean diagonal entry of A from the observations alone.
    scale: f64,
}

/// Normal equations of the whole problem.
pub struct System {
    /// One for each segment.
    pub segments: Vec<SegmentSystem>,
    corner: DMatrix<f64>,
    corner_gradient: DVector<f64>,
    /// Sum of ρ over all observations, and the cost of the trajectory priors.
    pub cost: f64,
    /// Loss of the observations.
    pub loss: Loss,
}

/// A step of all parameters.
pub struct Step {
    /// For each segment, six numbers per control point.
    pub segments: Vec<Vec<f64>>,
    /// Global parameters; zero for fixed parameters.
    pub globals: Vec<f64>,
    /// Decrease of the cost that the linear model predicts.
    pub predicted: f64,
}

/// Contribution of a part of the observations to the equations of the estimated global parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Contribution {
    /// Its part of the gradient.
    pub gradient: DVector<f64>,
    /// Its part of the information matrix.
    pub information: DMatrix<f64>,
}

impl Contribution {
    /// Returns its part for the parameters at `places` alone.
    pub fn of(&self, places: &[usize]) -> Self {
        Self {
            gradient: self.gradient.select_rows(places),
            information: self.information.select_rows(places).select_columns(places),
        }
    }
}

/// A [`Contribution`] in half the memory, because there are hundreds at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedContribution {
    gradient: DVector<f64>,
    /// The lower triangle of the information, column by column.
    lower: Vec<f64>,
}

impl From<Contribution> for PackedContribution {
    fn from(whole: Contribution) -> Self {
        let columns = whole.information.column_iter().enumerate();
        let lower = columns.flat_map(|(column, entries)| entries.iter().skip(column).copied().collect::<Vec<_>>());
        Self { lower: lower.collect(), gradient: whole.gradient }
    }
}

impl PackedContribution {
    /// Sums `parts`, which have the same parameters; `None` if there are no parts.
    pub fn sum<'a>(parts: impl IntoIterator<Item = &'a Self>) -> Option<Contribution> {
        let mut parts = parts.into_iter();
        let first = parts.next()?.clone();
        let sum = parts.fold(first, |mut sum, part| {
            sum.gradient += &part.gradient;
            sum.lower.iter_mut().zip(&part.lower).for_each(|(sum, entry)| *sum += entry);
            sum
        });
        let count = sum.gradient.len();
        let mut information = DMatrix::zeros(count, count);
        let mut entries = sum.lower.iter();
        for column in 0..count {
            for (row, entry) in (column..count).zip(entries.by_ref().take(count - column)) {
                information[(row, column)] = *entry;
            }
        }
        information.fill_upper_triangle_with_lower_triangle();
        Some(Contribution { gradient: sum.gradient, information })
    }
}

impl System {
    /// Creates an empty system of segments with `control_points` control points each.
    pub fn new(control_points: &[usize]) -> Self {
        Self {
            segments: control_points.iter().map(|&count| SegmentSystem::new(count, 1)).collect(),
            corner: DMatrix::zeros(GLOBAL_COUNT, GLOBAL_COUNT),
            corner_gradient: DVector::zeros(GLOBAL_COUNT),
            cost: 0.0,
            loss: Loss::default(),
        }
    }

    /// Adds intervals, in their order.
    pub fn add(&mut self, ranges: &[(ObservationRange, RangeEquations)]) {
        for (range, equations) in ranges {
            let Some(segment) = self.segments.get_mut(range.segment) else { continue };
            let order = equations.order;
            if segment.order != order && !equations.border.is_empty() {
                // The first interval: everything is still zero, and only the number of blocks depends on the order.
                (segment.order, segment.blocks) = (order, vec![Block::zeros(); segment.border.len() * order]);
            }
            segment.add(equations, equations.first);
            for column in 0..GLOBAL_COUNT {
                for row in column..GLOBAL_COUNT {
                    self.corner[(row, column)] += equations.corner[(row, column)];
                }
                self.corner_gradient[column] += equations.corner_gradient[column];
            }
            self.cost += equations.loss.cost;
            self.loss.add(&equations.loss);
        }
    }

    /// Completes the system after the last interval.
    pub fn close(&mut self) {
        self.corner.fill_upper_triangle_with_lower_triangle();
        for segment in &mut self.segments {
            segment.scale = mean_diagonal(&segment.blocks, segment.order);
        }
    }

    /// Returns the information about the global parameter at `place` with everything else known: one over its variance.
    pub fn information_of(&self, place: usize) -> f64 {
        self.corner.get((place, place)).copied().unwrap_or(0.0)
    }

    /// Adds the acceleration priors of the control points of each segment, in their order.
    pub fn add_smoothness(&mut self, segments: &[Vec<Acceleration>]) {
        for (segment, accelerations) in self.segments.iter_mut().zip(segments) {
            for acceleration in accelerations {
                self.cost += acceleration.add_to(segment.order, &mut segment.blocks, &mut segment.gradient);
            }
        }
    }

    /// Adds the weighted jerks of the trajectory of `segment`.
    pub fn add_jerks(&mut self, segment: usize, jerks: &[Jerk], weights: &[[f64; 2]]) {
        let Some(segment) = self.segments.get_mut(segment).filter(|segment| segment.order > 3) else { return };
        for (jerk, weights) in jerks.iter().zip(weights) {
            self.cost += add_jerk(jerk, *weights, segment.order, &mut segment.blocks, &mut segment.gradient);
        }
    }

    /// Computes the step of the estimated parameters. `damping` is a share of the diagonal that the global parameters have after the
    /// elimination of the control points. A step with hardly any damping is lengthened as the loss requires
    /// ([`Loss::lengthening`]).
    pub fn step(&self, damping: f64, free: &[bool; GLOBAL_COUNT]) -> Result<Step, NotPositiveDefinite> {
        let Reduced { free, segments: eliminated, schur, right } = self.reduced(damping, free)?;
        let factor = schur.cholesky().ok_or(NotPositiveDefinite)?;
        let length = if damping <= SMALL_DAMPING { self.loss.lengthening() } else { 1.0 };
        let reduced = factor.solve(&right);
        let mut globals = vec![0.0; GLOBAL_COUNT];
        for (&global, value) in free.iter().zip(reduced.iter()) {
            globals[global] = length * value;
        }
        let of_segment = |part: &Eliminated| {
            let mut step = part.back_substitute(&reduced);
            step.iter_mut().for_each(|value| *value *= length);
            step
        };
        let segments: Vec<Vec<f64>> = eliminated.iter().map(of_segment).collect();
        let predicted = self.predicted_decrease(&segments, &globals);
        Ok(Step { segments, globals, predicted })
    }

    /// Returns −gᵀδ − ½ δᵀHδ for a step δ of the control points of each segment and the global parameters, with Hδ = −g: half of
    /// −gᵀδ.
    fn predicted_decrease(&self, segments: &[Vec<f64>], globals: &[f64]) -> f64 {
        let mut sum = 0.0;
        for (segment, step) in self.segments.iter().zip(segments) {
            sum += segment.gradient.iter().flatten().zip(step).map(|(g, s)| g * s).sum::<f64>();
        }
        sum += self.corner_gradient.iter().zip(globals).map(|(g, s)| g * s).sum::<f64>();
        -0.5 * sum
    }

    /// Eliminates the control points from the system, whose global parameters are damped by `damping`; of these, only the parameters
    /// that are `free` remain.
    pub fn reduced(&self, damping: f64, free: &[bool; GLOBAL_COUNT]) -> Result<Reduced, NotPositiveDefinite> {
        let free = places(free);
        let segments = self.segments.par_iter().map(|segment| segment.eliminated(damping, &free));
        let segments = segments.collect::<Result<_, NotPositiveDefinite>>()?;
        Ok(Reduced::new(free, segments, &self.corner, &self.corner_gradient, damping))
    }

    /// Does the same and consumes the system: each segment is dropped as soon as it is eliminated.
    pub fn into_reduced(self, damping: f64, free: &[bool; GLOBAL_COUNT]) -> Result<Reduced, NotPositiveDefinite> {
        let free = places(free);
        let segments = self.segments.into_par_iter().map(|segment| segment.eliminated(damping, &free));
        let segments = segments.collect::<Result<_, NotPositiveDefinite>>()?;
        Ok(Reduced::new(free, segments, &self.corner, &self.corner_gradient, damping))
    }
}

/// Priors of the trajectory of a segment, in addition to its observations.
pub struct TrajectoryPriors<'a> {
    /// Accelerations of its control points.
    pub accelerations: Vec<Acceleration>,
    /// Its jerks.
    pub jerks: Vec<Jerk>,
    /// Weights of the jerks.
    pub stiffness: &'a Stiffness,
}

impl<'a> TrajectoryPriors<'a> {
    /// Returns the priors of `trajectory`, whose jerks have this `stiffness`.
    pub fn new(trajectory: &Trajectory, stiffness: &'a Stiffness) -> Self {
        Self { accelerations: accelerations(trajectory), jerks: jerks(trajectory), stiffness }
    }
}

/// A system whose control points are eliminated.
pub struct Reduced {
    free: Vec<usize>,
    segments: Vec<Eliminated>,
    schur: DMatrix<f64>,
    right: DVector<f64>,
}

impl Reduced {
    /// Builds it from its `segments` and the equations of the global parameters.
    fn new(
        free: Vec<usize>,
        segments: Vec<Eliminated>,
        corner: &DMatrix<f64>,
        gradient: &DVector<f64>,
        damping: f64,
    ) -> Self {
        let mut schur = DMatrix::from_fn(free.len(), free.len(), |row, column| corner[(free[row], free[column])]);
        let mut right = DVector::from_fn(free.len(), |row, _| -gradient[free[row]]);
        for part in &segments {
            let (of_segment, right_of_segment) = part.schur();
            schur -= of_segment;
            right -= right_of_segment;
        }
        for place in 0..free.len() {
            schur[(place, place)] *= 1.0 + damping;
        }
        Self { free, segments, schur, right }
    }

    /// Returns the indices of its `free` global parameters.
    pub fn places(&self, free: &[bool; GLOBAL_COUNT]) -> Vec<usize> {
        (0..self.free.len()).filter(|&place| free[self.free[place]]).collect()
    }

    /// Returns the covariance of the global parameters at `places` with the others fixed: the inverse of the undamped Schur
    /// complement.
    pub fn covariance(&self, places: &[usize]) -> Result<DMatrix<f64>, NotPositiveDefinite> {
        let schur = self.schur.select_rows(places).select_columns(places);
        Ok(schur.cholesky().ok_or(NotPositiveDefinite)?.inverse())
    }

    /// Returns the step of all its global parameters; zero for the others.
    pub fn global_step(&self) -> Result<Vec<f64>, NotPositiveDefinite> {
        let step = self.schur.clone().cholesky().ok_or(NotPositiveDefinite)?.solve(&self.right);
        let mut globals = vec![0.0; GLOBAL_COUNT];
        self.free.iter().zip(step.iter()).for_each(|(&global, value)| globals[global] = *value);
        Ok(globals)
    }

    /// Returns the dependence of the control points on its global parameters.
    pub fn into_follows(self) -> Follows {
        let segments = self.segments.into_iter().map(Eliminated::into_following).collect();
        Follows { segments, free: self.free }
    }
}

/// Dependence of the control points of each segment on the estimated global parameters.
pub struct Follows {
    segments: Vec<Following>,
    free: Vec<usize>,
}

impl Follows {
    /// Returns the contribution of each of `ranges` to the equations of the estimated global parameters, after elimination of
    /// the control points.
    ///
    /// With A⁻¹B, by which the control points follow the global parameters, an interval with the equations (Aₖ, Bₖ, Cₖ) and the
    /// gradient (gₖ, hₖ) has the gradient hₖ − (A⁻¹B)ᵀgₖ and the information Cₖ − BₖᵀA⁻¹B − (BₖᵀA⁻¹B)ᵀ + (A⁻¹B)ᵀAₖA⁻¹B. Over all
    /// intervals these add up to the equations of the system, without the trajectory priors.
    pub fn contributions(&self, ranges: &[(ObservationRange, RangeEquations)]) -> Vec<PackedContribution> {
        let free = &self.free;
        let of_range = |(range, equations): &(ObservationRange, RangeEquations)| {
            let segment = self.segments.get(range.segment)?;
            let rows = 6 * equations.control_point_count();
            let follows = &segment.of_points(equations.first, equations.control_point_count());
            let gradient = DVector::from_iterator(rows, equations.gradient.iter().flatten().copied());
            let own = DVector::from_fn(free.len(), |row, _| equations.corner_gradient[free[row]]);
            let border =
                DMatrix::from_fn(rows, free.len(), |row, column| equations.border[row / 6][row % 6][free[column]]);
            let corner = DMatrix::from_fn(free.len(), free.len(), |row, column| {
                equations.corner[(free[row.max(column)], free[row.min(column)])]
            });
            let mixed = border.transpose() * follows;
            let moved = banded_times(&equations.blocks, equations.order, follows);
            let contribution = Contribution {
                gradient: own - follows.transpose() * gradient,
                information: corner - &mixed - mixed.transpose() + follows.transpose() * moved,
            };
            Some(contribution.into())
        };
        ranges.par_iter().filter_map(of_range).collect()
    }

    /// Returns the covariance of the control points of each segment when the estimated global parameters at `places` have the
    /// covariance `globals`; `None` if that matrix is not a covariance.
    pub fn control_covariances(&self, places: &[usize], globals: &DMatrix<f64>) -> Option<Vec<ControlCovariance>> {
        self.segments.iter().map(|segment| segment.control_covariance(places, globals)).collect()
    }
}

/// Damping of the control points, as a share of the damping of the global parameters. If the board is hardly tilted, the control
/// points compensate nearly all of a change of the focal length; fully damped, they would stop the focal length far from its
/// minimum.
const OF_CONTROL_POINTS: f64 = 1e-3;

/// Up to this damping a step counts as a Gauss-Newton step.
const SMALL_DAMPING: f64 = 1e-5;

impl SegmentSystem {
    /// Creates an empty system of `count` control points that act together in groups of `order`.
    fn new(count: usize, order: usize) -> Self {
        Self {
            order,
            blocks: vec![Block::zeros(); count * order],
            border: vec![[[0.0; GLOBAL_COUNT]; 6]; count],
            gradient: vec![[0.0; 6]; count],
            scale: 0.0,
        }
    }

    /// Adds equations of the same order whose first control point has the index `at` here.
    fn add(&mut self, equations: &RangeEquations, at: usize) {
        let blocks = self.blocks.iter_mut().skip(at * self.order);
        blocks.zip(&equations.blocks).for_each(|(sum, block)| *sum += block);
        for (sum, part) in self.border.iter_mut().skip(at).zip(&equations.border) {
            let pairs = sum.iter_mut().flatten().zip(part.iter().flatten());
            pairs.for_each(|(sum, part)| *sum += part);
        }
        for (sum, part) in self.gradient.iter_mut().skip(at).zip(&equations.gradient) {
            sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
    }

    /// Sums the equations of intervals of one segment, and adds those `priors` of its trajectory that concern
    /// only the control points of these intervals. `None` without observations.
    pub fn of_ranges(ranges: &[(ObservationRange, RangeEquations)], priors: &TrajectoryPriors) -> Option<Self> {
        let concerned = || ranges.iter().map(|(_, equations)| equations).filter(|one| !one.border.is_empty());
        let first = concerned().map(|one| one.first).min()?;
        let end = concerned().map(|one| one.first + one.control_point_count()).max()?;
        let mut segment = Self::new(end - first, concerned().next()?.order);
        concerned().for_each(|equations| segment.add(equations, equations.first - first));
        segment.scale = mean_diagonal(&segment.blocks, segment.order);
        let (blocks, gradient) = (&mut segment.blocks, &mut segment.gradient);
        for acceleration in priors.accelerations.iter().filter(|one| one.first >= first && one.first + 3 <= end) {
            Acceleration { first: acceleration.first - first, ..*acceleration }.add_to(segment.order, blocks, gradient);
        }
        if segment.order > 3 {
            let jerks = priors.jerks.iter().zip(priors.stiffness);
            for (jerk, weights) in jerks.filter(|(jerk, _)| jerk.first >= first && jerk.first + 4 <= end) {
                add_jerk(&Jerk { first: jerk.first - first, ..*jerk }, *weights, segment.order, blocks, gradient);
            }
        }
        Some(segment)
    }

    /// Multiplies the matrix of the control points by `columns`, a vector of six per control point.
    pub fn times(&self, columns: &[[f64; 6]]) -> Vec<[f64; 6]> {
        let mut product = vec![[0.0; 6]; columns.len()];
        for index in 0..columns.len().min(self.border.len()) {
            for back in 0..self.order.min(index + 1) {
                let block = &self.blocks[index * self.order + back];
                for row in 0..6 {
                    for column in 0..6 {
                        if back == 0 {
                            let entry = block[(row.max(column), row.min(column))];
                            product[index][row] += entry * columns[index][column];
                        } else {
                            let entry = block[(row, column)];
                            product[index][row] += entry * columns[index - back][column];
                            product[index - back][column] += entry * columns[index][row];
                        }
                    }
                }
            }
        }
        product
    }

    /// Eliminates the control points from the global parameters that are `free` and damped by `damping`.
    pub fn eliminated(&self, damping: f64, free: &[usize]) -> Result<Eliminated, NotPositiveDefinite> {
        let factor = factored(&self.blocks, self.order, OF_CONTROL_POINTS * damping, self.scale)?;
        Ok(Eliminated::new(factor, self.order, &self.border, &self.gradient, free))
    }
}
