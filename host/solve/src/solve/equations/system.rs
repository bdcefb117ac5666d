//! The whole bordered block-banded system: sum of the pieces, damping, Schur complement.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::band::Band;
use super::border::{Corner, POINT};
use super::control_band::{Block, banded_times, mean_diagonal};
use super::eliminated::{ControlCovariance, Eliminated, Following};
use super::normal::Equations;
use super::smoothness::{Acceleration, accelerations};
use super::stiffness::{Stiffness, add_jerk};
use crate::solve::SolveError;
use crate::solve::rows::loss::Loss;
use crate::trajectory::Trajectory;
use crate::trajectory::jerk::{Jerk, jerks};

/// Normal equations of the whole problem.
pub struct System {
    /// For each segment the equations of its control points.
    pub segments: Vec<Band>,
    /// For each segment the mean diagonal entry of its control points' matrix, from the observations alone.
    scales: Vec<f64>,
    corner: Corner,
    information: Vec<f64>,
    /// The pieces, if they are kept.
    pub pieces: Vec<Equations>,
    /// Sum of ρ over all observations, and the cost of the priors.
    pub cost: f64,
    /// Loss of the observations.
    pub loss: Loss,
}

/// A step of all parameters.
pub struct Step {
    /// For each segment, six numbers per control point.
    pub segments: Vec<Vec<f64>>,
    /// A number for each column of the border.
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
    /// Creates an empty system of segments with `control_points` control points each, and `width` columns of the border.
    pub fn new(control_points: &[usize], width: usize) -> Self {
        Self {
            segments: control_points.iter().map(|&count| Band::new(0, count, 1, width)).collect(),
            scales: Vec::new(),
            corner: Corner::zeros(width),
            information: Vec::new(),
            pieces: Vec::new(),
            cost: 0.0,
            loss: Loss::default(),
        }
    }

    /// Adds pieces, in their order.
    ///
    /// # Errors
    /// [`SolveError::OutOfBand`] if one does not fit to the segments or the border.
    pub fn add(&mut self, pieces: &[Equations]) -> Result<(), SolveError> {
        for piece in pieces {
            let segment = self.segments.get_mut(piece.segment).ok_or(SolveError::OutOfBand)?;
            let (order, count) = (piece.band.order, segment.count());
            if segment.order == 1 && order > 1 && piece.band.count() > 0 {
                // The first piece: everything is still zero, and only the number of blocks depends on the order.
                (segment.order, segment.blocks) = (order, vec![Block::zeros(); count * order]);
            }
            segment.merge(&piece.band, piece.columns.start)?;
            self.corner.add(&piece.corner, piece.columns.start);
            self.information.resize(self.information.len().max(piece.information.len()), 0.0);
            self.information.iter_mut().zip(&piece.information).for_each(|(sum, part)| *sum += part);
            self.cost += piece.loss.cost;
            self.loss.add(&piece.loss);
        }
        Ok(())
    }

    /// Completes the system after the last piece, with the priors of each segment's trajectory: its accelerations, and its jerks with
    /// the weights `stiffness`.
    pub fn close(&mut self, trajectories: &[Trajectory], stiffness: &[Stiffness]) {
        self.corner.matrix.fill_upper_triangle_with_lower_triangle();
        self.scales = self.segments.iter().map(|segment| mean_diagonal(&segment.blocks, segment.order)).collect();
        for (segment, trajectory) in self.segments.iter_mut().zip(trajectories) {
            for acceleration in accelerations(trajectory) {
                self.cost += acceleration.add_to(segment.order, &mut segment.blocks, &mut segment.gradient);
            }
        }
        let segments = self.segments.iter_mut().zip(trajectories).zip(stiffness);
        for ((segment, trajectory), weights) in segments.filter(|((segment, _), _)| segment.order > 3) {
            for (jerk, weights) in jerks(trajectory).iter().zip(weights) {
                self.cost += add_jerk(jerk, *weights, segment.order, &mut segment.blocks, &mut segment.gradient);
            }
        }
    }

    /// Returns the completed sum of `pieces`, which it keeps, with a border of `width` columns; the rest is as in [`System::close`].
    ///
    /// # Errors
    /// [`SolveError::OutOfBand`] if a piece does not fit to the trajectories or the border.
    pub fn of_pieces(
        pieces: Vec<Equations>,
        width: usize,
        trajectories: &[Trajectory],
        stiffness: &[Stiffness],
    ) -> Result<Self, SolveError> {
        let counts: Vec<usize> = trajectories.iter().map(Trajectory::control_point_count).collect();
        let mut system = Self::new(&counts, width);
        system.add(&pieces)?;
        system.close(trajectories, stiffness);
        Ok(Self { pieces, ..system })
    }

    /// Returns the information about a global parameter of events with everything else known: one over its variance.
    pub fn information_of(&self, global: usize) -> f64 {
        self.information.get(global).copied().unwrap_or(0.0)
    }

    /// Adds ½ (distance / σ)² for the parameter of a column that is `distance` above its expected value.
    pub fn add_prior(&mut self, column: usize, distance: f64, sigma: f64) {
        let weight = 1.0 / (sigma * sigma);
        self.corner.matrix[(column, column)] += weight;
        self.corner.gradient[column] += weight * distance;
        self.cost += 0.5 * weight * distance * distance;
    }

    /// Computes the step of the estimated parameters. `damping` is a share of the diagonal that the global parameters have after the
    /// elimination of the control points. A step with hardly any damping is lengthened as the loss requires
    /// ([`Loss::lengthening`]).
    ///
    /// # Errors
    /// [`SolveError::Singular`] if the observations do not determine the step.
    pub fn step(&self, damping: f64) -> Result<Step, SolveError> {
        let Reduced { segments: eliminated, schur, right } = self.reduced(damping)?;
        let factor = schur.cholesky().ok_or(SolveError::Singular)?;
        let length = if damping <= SMALL_DAMPING { self.loss.lengthening() } else { 1.0 };
        let reduced = factor.solve(&right);
        let globals: Vec<f64> = reduced.iter().map(|value| length * value).collect();
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
        sum += self.corner.gradient.iter().zip(globals).map(|(g, s)| g * s).sum::<f64>();
        -0.5 * sum
    }

    /// Eliminates the control points from the system, whose global parameters are damped by `damping`.
    ///
    /// # Errors
    /// [`SolveError::Singular`] if the observations do not determine the control points.
    pub fn reduced(&self, damping: f64) -> Result<Reduced, SolveError> {
        let segments = self.segments.par_iter().zip(&self.scales);
        let segments = segments.map(|(segment, &scale)| segment.eliminated(damping, scale));
        Ok(Reduced::new(segments.collect::<Result<_, _>>()?, &self.corner, damping))
    }

    /// Does the same without damping and consumes the system: each segment is dropped as soon as it is eliminated.
    ///
    /// # Errors
    /// As [`System::reduced`].
    pub fn into_reduced(self) -> Result<Reduced, SolveError> {
        let segments = self.segments.into_par_iter().zip(self.scales);
        let segments = segments.map(|(segment, scale)| segment.into_eliminated(0.0, scale));
        Ok(Reduced::new(segments.collect::<Result<_, _>>()?, &self.corner, 0.0))
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
    segments: Vec<Eliminated>,
    schur: DMatrix<f64>,
    right: DVector<f64>,
}

impl Reduced {
    /// Builds it from its `segments` and the equations of the global parameters.
    fn new(segments: Vec<Eliminated>, corner: &Corner, damping: f64) -> Self {
        let (mut schur, mut right) = (corner.matrix.clone(), -&corner.gradient);
        for part in &segments {
            let (of_segment, right_of_segment) = part.schur();
            schur -= of_segment;
            right -= right_of_segment;
        }
        for column in 0..schur.ncols() {
            schur[(column, column)] *= 1.0 + damping;
        }
        Self { segments, schur, right }
    }

    /// Returns the covariance of all global parameters if observations were independent.
    ///
    /// # Errors
    /// [`SolveError::Singular`] if the observations do not determine them.
    pub fn whole_covariance(&self) -> Result<DMatrix<f64>, SolveError> {
        Ok(self.schur.clone().cholesky().ok_or(SolveError::Singular)?.inverse())
    }

    /// Returns the normal equations of the global parameters.
    pub fn normal(&self) -> &DMatrix<f64> {
        &self.schur
    }

    /// Returns the covariance of the global parameters in these `columns` with the others fixed: the inverse of the undamped Schur
    /// complement.
    ///
    /// # Errors
    /// [`SolveError::Singular`] if the observations do not determine them.
    pub fn covariance(&self, columns: &[usize]) -> Result<DMatrix<f64>, SolveError> {
        let schur = self.schur.select_rows(columns).select_columns(columns);
        Ok(schur.cholesky().ok_or(SolveError::Singular)?.inverse())
    }

    /// Returns the step of the global parameters.
    ///
    /// # Errors
    /// [`SolveError::Singular`] if the observations do not determine it.
    pub fn global_step(&self) -> Result<Vec<f64>, SolveError> {
        let step = self.schur.clone().cholesky().ok_or(SolveError::Singular)?.solve(&self.right);
        Ok(step.as_slice().to_vec())
    }

    /// Returns the dependence of the control points on its global parameters.
    pub fn into_follows(self) -> Follows {
        let width = self.schur.ncols();
        Follows { segments: self.segments.into_iter().map(Eliminated::into_following).collect(), width }
    }
}

/// Contributions of blocks of time to the equations of the global parameters.
pub struct Blocks {
    /// For each block its segment and its middle (s).
    pub times: Vec<(usize, f64)>,
    /// For each block its contribution.
    pub contributions: Vec<PackedContribution>,
}

/// Dependence of the control points of each segment on the estimated global parameters.
pub struct Follows {
    segments: Vec<Following>,
    /// Number of columns of the border.
    width: usize,
}

impl Follows {
    /// Returns the contribution of each of `pieces`, which have all columns of the border, to the equations of the global
    /// parameters, after elimination of the control points.
    ///
    /// With A⁻¹B, by which the control points follow the global parameters, a piece with the equations (Aₖ, Bₖ, Cₖ) and the
    /// gradient (gₖ, hₖ) has the gradient hₖ − (A⁻¹B)ᵀgₖ and the information Cₖ − BₖᵀA⁻¹B − (BₖᵀA⁻¹B)ᵀ + (A⁻¹B)ᵀAₖA⁻¹B. Over all
    /// pieces these add up to the equations of the system, without the priors.
    pub fn contributions(&self, pieces: &[Equations]) -> Vec<PackedContribution> {
        let of_piece = |piece: &Equations| {
            let (band, count) = (&piece.band, piece.band.count());
            let follows = &self.segments.get(piece.segment)?.of_points(band.first, count);
            let gradient = DVector::from_iterator(POINT * count, band.gradient.iter().flatten().copied());
            let border = band.border.to_matrix(count);
            let mixed = border.transpose() * follows;
            let moved = banded_times(&band.blocks, band.order, follows);
            let contribution = Contribution {
                gradient: &piece.corner.gradient - follows.transpose() * gradient,
                information: piece.corner.whole() - &mixed - mixed.transpose() + follows.transpose() * moved,
            };
            Some(contribution.into())
        };
        pieces.par_iter().filter_map(of_piece).collect()
    }

    /// Returns the contributions of blocks of `length` seconds of `pieces`, which may have a part of the columns each.
    ///
    /// # Errors
    /// [`SolveError::OutOfBand`] if pieces of a block do not fit together.
    pub fn blocks(&self, pieces: &[Equations], length: f64) -> Result<Blocks, SolveError> {
        let mut groups: BTreeMap<(usize, i64), Vec<&Equations>> = BTreeMap::new();
        for piece in pieces.iter().filter(|piece| piece.band.count() > 0) {
            groups.entry((piece.segment, (piece.t / length).floor() as i64)).or_default().push(piece);
        }
        let groups: Vec<_> = groups.into_iter().collect();
        let contribution = |(_, pieces): &(_, Vec<&Equations>)| {
            let sum = Equations::sum(pieces, self.width)?;
            Ok(self.contributions(sum.as_slice()))
        };
        let contributions = groups.par_iter().map(contribution).collect::<Result<Vec<_>, _>>()?.concat();
        let times = groups.iter().map(|((segment, block), _)| (*segment, (*block as f64 + 0.5) * length)).collect();
        Ok(Blocks { times, contributions })
    }

    /// Returns the covariance of the control points of each segment when the global parameters in these `columns` have the
    /// covariance `globals`; `None` if that matrix is not a covariance.
    pub fn control_covariances(&self, columns: &[usize], globals: &DMatrix<f64>) -> Option<Vec<ControlCovariance>> {
        self.segments.iter().map(|segment| segment.control_covariance(columns, globals)).collect()
    }
}

/// Up to this damping a step counts as a Gauss-Newton step.
const SMALL_DAMPING: f64 = 1e-5;

#[cfg(test)]
mod tests;
