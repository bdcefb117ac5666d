//! Normal equations of events together with other observations along the trajectories: bands of control points with a border of
//! any size.
//!
//! They have the form of the normal equations of the [joint solve](crate::solve). The border has other parameters before the
//! global parameters of the events.

use std::collections::BTreeMap;
use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::bearing_table::BearingTable;
use super::control_band::{Block, NotPositiveDefinite, banded_times, factored, mean_diagonal};
use super::lens_step::observed_pixels;
use super::levenberg::{linearised, moved};
use super::normal::RangeEquations;
use super::observation_range::{ObservationRange, RANGES_TOGETHER, observation_ranges};
use super::smoothness::accelerations;
use super::stiffness::{Stiffness, add_jerk};
use super::system::{Contribution, PackedContribution};
use super::{GLOBAL_COUNT, Problem, State};
use crate::trajectory::Trajectory;
use crate::trajectory::jerk::jerks;

/// Number of parameters of a control point.
const POINT: usize = 6;
/// Largest number of iterations.
const ITERATIONS: usize = 15;
/// Iterations end when the cost falls by less than this.
const SETTLED: f64 = 0.02;
const FIRST_DAMPING: f64 = 1e-9;
const LARGEST_DAMPING: f64 = 1e4;

/// Normal equations of some observations of one segment.
#[derive(Clone, Debug)]
pub struct Part {
    /// Index of the segment.
    pub segment: usize,
    /// Time of the first observation (s).
    pub t: f64,
    /// Index of the first control point.
    pub first: usize,
    /// Number of control points that act at one time.
    pub order: usize,
    /// For each control point its blocks with itself (lower triangle) and with the control points before it.
    pub blocks: Vec<Block>,
    /// Border parameters that the observations depend on.
    pub globals: Range<usize>,
    /// Border block: six rows per control point, one column for each of these border parameters.
    pub border: DMatrix<f64>,
    /// Gradient of the control points, six rows each.
    pub gradient: DVector<f64>,
    /// Matrix of these border parameters.
    pub corner: DMatrix<f64>,
    /// Gradient of these border parameters.
    pub corner_gradient: DVector<f64>,
    /// Sum of ρ.
    pub cost: f64,
}

impl Part {
    /// Builds a part from the equations of events, weighted by `weight`. `free` are the indices of their estimated global
    /// parameters, which begin at `offset` of the border.
    pub fn from_events(
        segment: usize,
        t: f64,
        equations: &RangeEquations,
        free: &[usize],
        offset: usize,
        weight: f64,
    ) -> Self {
        let count = equations.control_point_count();
        let corner = &equations.corner;
        Self {
            segment,
            t,
            first: equations.first,
            order: equations.order,
            blocks: equations.blocks.iter().map(|block| block * weight).collect(),
            globals: offset..offset + free.len(),
            border: DMatrix::from_fn(POINT * count, free.len(), |row, column| {
                weight * equations.border[row / POINT][row % POINT][free[column]]
            }),
            gradient: DVector::from_iterator(
                POINT * count,
                equations.gradient.iter().flatten().map(|one| weight * one),
            ),
            corner: DMatrix::from_fn(free.len(), free.len(), |row, column| {
                weight * corner[(free[row.max(column)], free[row.min(column)])]
            }),
            corner_gradient: DVector::from_fn(free.len(), |row, _| weight * equations.corner_gradient[free[row]]),
            cost: weight * equations.loss.cost,
        }
    }

    /// Builds a part from the Gram matrix `product` of some rows. A row has six columns for each of `order` control points, then
    /// the `globals` border parameters, then the residual.
    pub fn from_product(
        segment: usize,
        t: f64,
        first: usize,
        order: usize,
        globals: usize,
        product: &DMatrix<f64>,
        cost: f64,
    ) -> Self {
        let points = POINT * order;
        let residual = points + globals;
        let mut blocks = vec![Block::zeros(); order * order];
        for row in 0..order {
            for back in 0..=row {
                blocks[row * order + back]
                    .copy_from(&product.view((POINT * row, POINT * (row - back)), (POINT, POINT)));
            }
        }
        Self {
            segment,
            t,
            first,
            order,
            blocks,
            globals: 0..globals,
            border: product.view((0, points), (points, globals)).into_owned(),
            gradient: DVector::from_fn(points, |row, _| product[(row, residual)]),
            corner: product.view((points, points), (globals, globals)).into_owned(),
            corner_gradient: DVector::from_fn(globals, |row, _| product[(points + row, residual)]),
            cost,
        }
    }

    /// Returns the part after a step of all parameters, as if it were a quadratic function of them.
    pub fn moved(&self, step: &Step) -> Self {
        let mut moved = self.clone();
        let rows = POINT * self.control_point_count();
        let points = step.segments.get(self.segment).and_then(|step| step.get(POINT * self.first..)?.get(..rows));
        let (Some(points), Some(globals)) = (points, step.globals.get(self.globals.clone())) else { return moved };
        let points = DMatrix::from_column_slice(rows, 1, points);
        let globals = DVector::from_column_slice(globals);
        let of_points = banded_times(&self.blocks, self.order, &points).column(0) + &self.border * &globals;
        let of_globals = self.border.tr_mul(&points).column(0) + &self.corner * &globals;
        let points = points.column(0);
        moved.cost += self.gradient.dot(&points) + self.corner_gradient.dot(&globals);
        moved.cost += 0.5 * (points.dot(&of_points) + globals.dot(&of_globals));
        moved.gradient += of_points;
        moved.corner_gradient += of_globals;
        moved
    }

    fn control_point_count(&self) -> usize {
        self.border.nrows() / POINT
    }
}

/// Linearises the events of `problem` at `state` and weights them by `weight`. Returns the parts and the number of events. Their
/// estimated global parameters begin at `offset` of the border.
pub fn event_parts(problem: &Problem, state: &State, offset: usize, weight: f64) -> (Vec<Part>, usize) {
    let free = problem.free.places();
    let bearings = BearingTable::new(&state.camera, problem.sensor);
    let part = |(range, equations): &(ObservationRange, RangeEquations)| {
        let t = range.start(&problem.segments);
        (Part::from_events(range.segment, t, equations, &free, offset, weight), equations.loss.count)
    };
    // The equations of an interval are large, so they are dropped as soon as the estimated parameters are extracted.
    let of_group = |group: &[ObservationRange]| -> Vec<(Part, usize)> {
        linearised(problem, state, &bearings, group).par_iter().map(part).collect()
    };
    let (parts, counts): (Vec<Part>, Vec<usize>) =
        observation_ranges(&problem.segments).chunks(RANGES_TOGETHER).flat_map(of_group).unzip();
    (parts, counts.iter().sum())
}

/// Moves the trajectories of `state` by `step`, and its estimated global parameters by the border from `offset` on. Returns
/// `None` if the camera model rejects the parameters.
pub fn moved_by(state: &State, problem: &Problem, step: &Step, offset: usize) -> Option<State> {
    let mut globals = [0.0; GLOBAL_COUNT];
    for (place, value) in problem.free.places().into_iter().zip(step.globals.iter().skip(offset)) {
        globals[place] = *value;
    }
    moved(state, &step.segments, &globals, &observed_pixels(&problem.segments, problem.sensor))
}

/// Minimises a cost by Levenberg-Marquardt, from an estimate and its equations. `system` extracts the [`System`] from the
/// equations. `attempt` gets the number of the iteration, the estimate, its equations and a step; it returns the estimate and the
/// equations after the step, or `None` if the step is impossible.
///
/// # Errors
/// Errors of `attempt`, and [`NotPositiveDefinite`] if the system does not determine a step.
pub fn minimise<E, L, F: From<NotPositiveDefinite>>(
    mut estimate: E,
    mut now: L,
    system: impl Fn(&L) -> &System,
    mut attempt: impl FnMut(usize, (&E, &L), &Step) -> Result<Option<(E, L)>, F>,
) -> Result<(E, L), F> {
    let mut damping = FIRST_DAMPING;
    for iteration in 0..ITERATIONS {
        let step = system(&now).solve(damping)?;
        if step.predicted < SETTLED {
            break;
        }
        match attempt(iteration, (&estimate, &now), &step)? {
            Some((trial, next)) if system(&next).cost < system(&now).cost => {
                let decrease = system(&now).cost - system(&next).cost;
                (estimate, now) = (trial, next);
                damping = (damping * 0.1).max(FIRST_DAMPING);
                if decrease < SETTLED {
                    break;
                }
            }
            _ if damping > LARGEST_DAMPING => break,
            _ => damping = (damping * 30.0).max(1e-5),
        }
    }
    Ok((estimate, now))
}

struct Segment {
    order: usize,
    blocks: Vec<Block>,
    border: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Mean diagonal entry of the control points' matrix, from the observations alone.
    scale: f64,
}

/// Sum of all parts.
pub struct System {
    segments: Vec<Segment>,
    corner: DMatrix<f64>,
    corner_gradient: DVector<f64>,
    /// Sum of ρ of all observations.
    pub cost: f64,
}

/// A step of all parameters.
pub struct Step {
    /// For each segment, six numbers per control point.
    pub segments: Vec<Vec<f64>>,
    /// Border parameters.
    pub globals: Vec<f64>,
    /// Decrease of the cost that the linear model predicts.
    pub predicted: f64,
}

/// Contributions of blocks of time to the equations of the border parameters.
pub struct Blocks {
    /// For each block its segment and a time in it.
    pub times: Vec<(usize, f64)>,
    /// For each block its contribution.
    pub contributions: Vec<PackedContribution>,
}

/// A segment whose control points are eliminated.
struct Eliminated {
    /// A⁻¹g.
    gradient: DVector<f64>,
    /// A⁻¹B.
    follows: DMatrix<f64>,
}

impl System {
    /// Sums parts of segments with `control_points` control points each and `globals` border parameters.
    pub fn new<'a>(
        control_points: &[usize],
        order: usize,
        globals: usize,
        parts: impl Iterator<Item = &'a Part>,
    ) -> Self {
        let mut segments: Vec<Segment> = control_points
            .iter()
            .map(|&count| Segment {
                order,
                blocks: vec![Block::zeros(); count * order],
                border: DMatrix::zeros(POINT * count, globals),
                gradient: DVector::zeros(POINT * count),
                scale: 0.0,
            })
            .collect();
        let mut corner = DMatrix::zeros(globals, globals);
        let mut corner_gradient = DVector::zeros(globals);
        let mut cost = 0.0;
        for part in parts {
            let Some(segment) = segments.get_mut(part.segment) else { continue };
            let count = part.control_point_count();
            let (row, columns) = (POINT * part.first, part.globals.clone());
            if part.order != order || row + POINT * count > segment.gradient.len() {
                continue;
            }
            let sums = segment.blocks.iter_mut().skip(part.first * order);
            sums.zip(&part.blocks).for_each(|(sum, block)| *sum += block);
            let mut border = segment.border.view_mut((row, columns.start), (POINT * count, columns.len()));
            border += &part.border;
            let mut gradient = segment.gradient.rows_mut(row, POINT * count);
            gradient += &part.gradient;
            let mut sum = corner.view_mut((columns.start, columns.start), (columns.len(), columns.len()));
            sum += &part.corner;
            let mut sum = corner_gradient.rows_mut(columns.start, columns.len());
            sum += &part.corner_gradient;
            cost += part.cost;
        }
        for segment in &mut segments {
            segment.scale = mean_diagonal(&segment.blocks, order);
        }
        Self { segments, corner, corner_gradient, cost }
    }

    /// Adds ½ (distance / σ)² for a border parameter that is `distance` above its expected value.
    pub fn add_prior(&mut self, global: usize, distance: f64, sigma: f64) {
        let weight = 1.0 / (sigma * sigma);
        self.corner[(global, global)] += weight;
        self.corner_gradient[global] += weight * distance;
        self.cost += 0.5 * weight * distance * distance;
    }

    /// Adds the acceleration priors of the control points of each segment's trajectory.
    pub fn add_smoothness(&mut self, trajectories: &[Trajectory]) {
        for (segment, trajectory) in self.segments.iter_mut().zip(trajectories) {
            let (gradient, _) = segment.gradient.as_mut_slice().as_chunks_mut();
            for acceleration in accelerations(trajectory) {
                self.cost += acceleration.add_to(segment.order, &mut segment.blocks, gradient);
            }
        }
    }

    /// Adds the weighted jerks of each segment's trajectory.
    pub fn add_jerks(&mut self, trajectories: &[Trajectory], stiffness: &[Stiffness]) {
        let segments = self.segments.iter_mut().zip(trajectories).zip(stiffness);
        for ((segment, trajectory), weights) in segments.filter(|((segment, _), _)| segment.order > 3) {
            let (gradient, _) = segment.gradient.as_mut_slice().as_chunks_mut();
            for (jerk, weights) in jerks(trajectory).iter().zip(weights) {
                self.cost += add_jerk(jerk, *weights, segment.order, &mut segment.blocks, gradient);
            }
        }
    }

    fn eliminated(&self, damping: f64) -> Result<Vec<Eliminated>, NotPositiveDefinite> {
        self.segments.par_iter().map(|segment| segment.eliminate(damping)).collect()
    }

    fn schur(&self, eliminated: &[Eliminated], damping: f64) -> DMatrix<f64> {
        let mut schur = self.corner.clone();
        for index in 0..schur.nrows() {
            schur[(index, index)] *= 1.0 + damping;
        }
        let products: Vec<DMatrix<f64>> = self
            .segments
            .par_iter()
            .zip(eliminated)
            .map(|(segment, eliminated)| segment.border.tr_mul(&eliminated.follows))
            .collect();
        products.iter().for_each(|product| schur -= product);
        (&schur + schur.transpose()) * 0.5
    }

    /// Computes the step that minimises the cost of the linear model.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] if the observations do not determine the step.
    pub fn solve(&self, damping: f64) -> Result<Step, NotPositiveDefinite> {
        let eliminated = self.eliminated(damping)?;
        let schur = self.schur(&eliminated, damping);
        let mut right = -self.corner_gradient.clone();
        for (segment, eliminated) in self.segments.iter().zip(&eliminated) {
            right += segment.border.tr_mul(&eliminated.gradient);
        }
        let globals = scaled_inverse(&schur)? * right;
        let mut predicted = -0.5 * self.corner_gradient.dot(&globals);
        let segments = self.segments.iter().zip(&eliminated).map(|(segment, eliminated)| {
            let step = -(&eliminated.gradient + &eliminated.follows * &globals);
            predicted -= 0.5 * segment.gradient.dot(&step);
            step.as_slice().to_vec()
        });
        let segments = segments.collect();
        Ok(Step { segments, globals: globals.as_slice().to_vec(), predicted })
    }

    /// Returns the normal equations of the border parameters after elimination of the control points.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] if the observations do not determine the control points.
    pub fn normal(&self) -> Result<DMatrix<f64>, NotPositiveDefinite> {
        Ok(self.schur(&self.eliminated(0.0)?, 0.0))
    }

    /// Returns the covariance of the border parameters if observations were independent.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] if the observations do not determine the parameters.
    pub fn covariance(&self) -> Result<DMatrix<f64>, NotPositiveDefinite> {
        scaled_inverse(&self.normal()?)
    }

    /// Computes the contribution of each block of `length` seconds to the equations of the border parameters, after
    /// elimination of the control points, and the middle of each block.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] if the observations do not determine the control points.
    pub fn contributions(&self, parts: &[Part], length: f64) -> Result<Blocks, NotPositiveDefinite> {
        let eliminated = self.eliminated(0.0)?;
        let mut groups: BTreeMap<(usize, i64), Vec<&Part>> = BTreeMap::new();
        for part in parts.iter().filter(|part| part.control_point_count() > 0) {
            groups.entry((part.segment, (part.t / length).floor() as i64)).or_default().push(part);
        }
        let groups: Vec<_> = groups.into_iter().collect();
        let count = self.corner.nrows();
        let sums = groups.par_iter().map(|((segment, _), parts)| {
            let mut sum = Contribution { gradient: DVector::zeros(count), information: DMatrix::zeros(count, count) };
            if let Some(eliminated) = eliminated.get(*segment) {
                parts.iter().for_each(|part| add_contribution(&mut sum, part, &eliminated.follows));
            }
            sum.into()
        });
        let sums = sums.collect();
        let times = groups.iter().map(|((segment, block), _)| (*segment, (*block as f64 + 0.5) * length)).collect();
        Ok(Blocks { times, contributions: sums })
    }
}

/// Adds hₖ − (A⁻¹B)ᵀgₖ and Cₖ − BₖᵀA⁻¹B − (BₖᵀA⁻¹B)ᵀ + (A⁻¹B)ᵀAₖA⁻¹B of one part to `sum`.
fn add_contribution(sum: &mut Contribution, part: &Part, follows: &DMatrix<f64>) {
    let rows = POINT * part.control_point_count();
    let follows = follows.rows(POINT * part.first, rows).into_owned();
    let (start, width) = (part.globals.start, part.globals.len());
    sum.gradient -= follows.tr_mul(&part.gradient);
    let mut gradient = sum.gradient.rows_mut(start, width);
    gradient += &part.corner_gradient;
    sum.information += follows.tr_mul(&banded_times(&part.blocks, part.order, &follows));
    let mixed = part.border.tr_mul(&follows);
    let mut lines = sum.information.rows_mut(start, width);
    lines -= &mixed;
    let mut columns = sum.information.columns_mut(start, width);
    columns -= mixed.transpose();
    let mut corner = sum.information.view_mut((start, start), (width, width));
    corner += &part.corner;
}

/// Inverts a positive definite matrix whose rows have very different units.
///
/// # Errors
/// [`NotPositiveDefinite`] if the matrix is not positive definite.
pub fn scaled_inverse(matrix: &DMatrix<f64>) -> Result<DMatrix<f64>, NotPositiveDefinite> {
    let scale = matrix.diagonal().map(|value| if value > 0.0 { 1.0 / value.sqrt() } else { 1.0 });
    let unit = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |row, column| {
        matrix[(row, column)] * scale[row] * scale[column]
    });
    let inverse = unit.cholesky().ok_or(NotPositiveDefinite)?.inverse();
    Ok(DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |row, column| {
        inverse[(row, column)] * scale[row] * scale[column]
    }))
}

impl Segment {
    fn eliminate(&self, damping: f64) -> Result<Eliminated, NotPositiveDefinite> {
        let band = factored(&self.blocks, self.order, damping, self.scale)?;
        let (mut gradient, mut follows) = (self.gradient.clone(), self.border.clone());
        band.solve_in_place(gradient.as_mut_slice());
        band.solve_in_place(follows.as_mut_slice());
        Ok(Eliminated { gradient, follows })
    }
}
