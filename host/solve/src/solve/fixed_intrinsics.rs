//! Intrinsics that are fixed at the intrinsics of another calibration while other parameters are estimated, and the effect of
//! their uncertainty.

use std::ops::Range;

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use nalgebra::DMatrix;

use super::FreeParameters;
use super::Problem;
use super::SolveError;
use crate::solve::equations::system::Reduced;

/// Fixed intrinsics.
#[derive(Clone, Debug)]
pub struct FixedIntrinsics {
    /// The camera with these intrinsics.
    pub camera: Camera<f64>,
    /// Covariance of its parameters, in their order; `None` if it is not known.
    pub covariance: Option<DMatrix<f64>>,
}

/// Returns `problem` with all intrinsics fixed.
pub fn with_fixed(problem: &Problem) -> Problem {
    with_intrinsics(problem, [false; MAX_PARAMETERS])
}

fn with_intrinsics(problem: &Problem, intrinsics: [bool; MAX_PARAMETERS]) -> Problem {
    let free = FreeParameters { intrinsics, ..problem.free };
    Problem { free, ..problem.with_segments(problem.segments.clone()) }
}

impl FixedIntrinsics {
    /// Returns σ of each parameter; 0 if it is not known.
    pub fn sigma(&self) -> Vec<f64> {
        let count = self.camera.parameters().into_iter().count();
        let known = |covariance: &DMatrix<f64>| covariance.diagonal().iter().map(|one| one.max(0.0).sqrt()).collect();
        self.covariance.as_ref().map_or_else(|| vec![0.0; count], known)
    }

    /// Returns `problem` with those intrinsics estimated whose σ is known.
    pub fn with_uncertain_estimated(&self, problem: &Problem) -> Problem {
        let sigma = self.sigma();
        with_intrinsics(problem, std::array::from_fn(|index| sigma.get(index) > Some(&0.0)))
    }

    /// Returns the covariance of the parameters that [`FixedIntrinsics::with_uncertain_estimated`] estimates, in their order.
    pub fn uncertain_covariance(&self) -> DMatrix<f64> {
        let sigma = self.sigma();
        let known: Vec<usize> = (0..sigma.len()).filter(|index| sigma[*index] > 0.0).collect();
        let at =
            |row: usize, column: usize| self.covariance.as_ref().map_or(0.0, |all| all[(known[row], known[column])]);
        DMatrix::from_fn(known.len(), known.len(), at)
    }

    /// Returns the largest difference between a parameter and its value in `own`, whose σ are `sigma`, in units of the σ of the
    /// difference; `None` if the models differ.
    pub fn distance(&self, own: &Camera<f64>, sigma: &[f64]) -> Option<f64> {
        let pairs = self.camera.parameters().into_iter().zip(own.parameters());
        let sigmas = self.sigma().into_iter().zip(sigma).map(|(one, other)| one.hypot(*other));
        let known = pairs.zip(sigmas).filter(|(_, sigma)| *sigma > 0.0);
        let largest = known.map(|((fixed, own), sigma)| (fixed - own).abs() / sigma).fold(0.0, f64::max);
        (self.camera.kind() == own.kind()).then_some(largest)
    }
}

/// Returns the covariance that the uncertainty of fixed intrinsics adds to the other parameters in the border of `reduced`, in which
/// the intrinsics are estimated. Each element of `fixed` has the indices of a camera's intrinsics in the border, and their covariance.
/// Rows and columns of the intrinsics are 0.
///
/// With the normal equations S of the border, an error e of the intrinsics moves the others by −S_oo⁻¹ S_oh e.
///
/// # Errors
/// [`SolveError::Singular`] if the others are not determined.
pub fn share_of_fixed(reduced: &Reduced, fixed: &[(Range<usize>, DMatrix<f64>)]) -> Result<DMatrix<f64>, SolveError> {
    let normal = reduced.normal();
    let of_fixed = |index: usize| fixed.iter().any(|(range, _)| range.contains(&index));
    let others: Vec<usize> = (0..normal.nrows()).filter(|index| !of_fixed(*index)).collect();
    let by_others = DMatrix::from_fn(others.len(), others.len(), |row, column| normal[(others[row], others[column])]);
    let inverse = by_others.cholesky().ok_or(SolveError::Singular)?.inverse();
    let mut share = DMatrix::zeros(normal.nrows(), normal.nrows());
    for (range, covariance) in fixed {
        let between =
            DMatrix::from_fn(others.len(), range.len(), |row, column| normal[(others[row], range.start + column)]);
        let follows = &inverse * between;
        let of_others = &follows * covariance * follows.transpose();
        for (row, to_row) in others.iter().enumerate() {
            for (column, to_column) in others.iter().enumerate() {
                share[(*to_row, *to_column)] += of_others[(row, column)];
            }
        }
    }
    Ok(share)
}
