//! The best curve on coarser knots, from the normal equations on finer ones.

use evcal_core::spline::rotation::log;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::band::Band;
use super::stiffness::Quadratic;
use crate::trajectory::fit::on_knots;
use crate::trajectory::knots::{Blend, insertion};
use crate::trajectory::{CONTROL_POINT_PARAMETERS as CONTROL_POINT, RotationControl, RotationSpline, Trajectory};
use evcal_geometry::numerics::banded::BandedCholesky;

/// Displacements of control points: a rotation vector (rad, camera frame) and a translation (m) each.
pub type Displacement = Vec<[f64; CONTROL_POINT]>;

/// Translations (m) and rotations of control points.
type ControlPoints = (Vec<Vector3<f64>>, Vec<Quaternion<f64>>);

/// A trajectory on fine knots, and the data needed to put it on coarser ones.
pub struct KnotFit {
    /// The trajectory on the fine knots.
    pub trajectory: Trajectory,
    /// Its rotations as control points of a quaternion spline.
    quaternions: Vec<Quaternion<f64>>,
}

impl KnotFit {
    /// Puts `trajectory` on `fine` knots, which must include its own knots; otherwise `None`.
    pub fn new(trajectory: &Trajectory, fine: Vec<f64>) -> Option<Self> {
        let mut places = fine.iter();
        if !trajectory.knots.iter().all(|knot| places.any(|fine| fine == knot)) {
            return None;
        }
        let blends = insertion(&trajectory.knots, &fine, trajectory.degree);
        let trajectory = match &trajectory.rotation {
            RotationControl::Quaternion(control) => Trajectory {
                translation: blends
                    .iter()
                    .map(|blend| blended(blend, &trajectory.translation, trajectory.degree))
                    .collect(),
                rotation: RotationControl::Quaternion(
                    blends.iter().map(|blend| blended(blend, control, trajectory.degree)).collect(),
                ),
                knots: fine,
                ..trajectory.clone()
            },
            RotationControl::So3(_) => on_knots(trajectory, fine, RotationSpline::So3).ok()?,
        };
        let quaternions = match &trajectory.rotation {
            RotationControl::Quaternion(control) => control.clone(),
            RotationControl::So3(control) => {
                let mut control: Vec<_> = control.iter().map(|unit| unit.into_inner()).collect();
                evcal_core::spline::quaternion::align_signs(&mut control);
                control
            }
        };
        Some(Self { trajectory, quaternions })
    }

    /// Returns the step to the least cost on the fine knots themselves; `None` if the equations do not determine it.
    pub fn step(&self, equations: &Band) -> Option<Displacement> {
        let count = self.quaternions.len();
        let own: Vec<Blend> = (0..count)
            .map(|first| {
                let mut weights = [0.0; evcal_core::spline::MAX_ORDER];
                weights[0] = 1.0;
                Blend { first, weights }
            })
            .collect();
        let still = vec![[0.0; CONTROL_POINT]; count];
        reduced_step(&own, 1, count, &still, equations)
    }

    /// Returns the displacement from the fine control points to the control points of the best curve on `coarse` knots, a subset
    /// of the fine ones.
    pub fn displacement(&self, coarse: &[f64], equations: &Band) -> Option<Displacement> {
        let degree = self.trajectory.degree;
        let blends = insertion(coarse, &self.trajectory.knots, degree);
        let (start, quaternions) = self.nearest(&blends, coarse.len() - degree - 1)?;
        let displacement = self.displacement_to(&blends, &start, &quaternions);
        let step = reduced_step(&blends, degree + 1, start.len(), &displacement, equations)?;
        let moved = |blend: &Blend, displacement: &[f64; CONTROL_POINT]| {
            let mut sum = *displacement;
            for (part, weight) in step.iter().skip(blend.first).zip(&blend.weights).take(degree + 1) {
                sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += weight * part);
            }
            sum
        };
        Some(blends.iter().zip(&displacement).map(|(blend, displacement)| moved(blend, displacement)).collect())
    }

    /// Returns the nearest curve on `coarse` knots, with quaternions, and the quadratic cost of its control points.
    pub fn nearest_on(&self, coarse: &[f64], equations: &Band) -> Option<(Trajectory, Quadratic)> {
        let degree = self.trajectory.degree;
        let blends = insertion(coarse, &self.trajectory.knots, degree);
        let (translation, quaternions) = self.nearest(&blends, coarse.len() - degree - 1)?;
        let displacement = self.displacement_to(&blends, &translation, &quaternions);
        let cost = reduced(&blends, degree + 1, translation.len(), &displacement, equations)?;
        let trajectory = Trajectory {
            knots: coarse.to_vec(),
            translation,
            rotation: RotationControl::Quaternion(quaternions),
            ..self.trajectory.clone()
        };
        Some((trajectory, cost))
    }

    /// Returns the curve `nearest` after a `step` of its control points, with this trajectory's kind of rotations.
    pub fn moved(&self, mut nearest: Trajectory, step: &[f64]) -> Option<Trajectory> {
        nearest.update(step);
        match self.trajectory.rotation {
            RotationControl::Quaternion(_) => Some(nearest),
            RotationControl::So3(_) => on_knots(&nearest, nearest.knots.clone(), RotationSpline::So3).ok(),
        }
    }

    /// Returns the control points of the curve on coarser knots whose fine control points are nearest to the present ones.
    fn nearest(&self, blends: &[Blend], count: usize) -> Option<ControlPoints> {
        const NUMBERS: usize = 7;
        let order = self.trajectory.degree + 1;
        let mut matrix = BandedCholesky::zeros(count, order - 1);
        let mut right = vec![0.0; NUMBERS * count];
        let points = self.trajectory.translation.iter().zip(&self.quaternions);
        for (blend, (translation, quaternion)) in blends.iter().zip(points) {
            let target = translation.iter().chain(quaternion.coords.iter());
            let weights = blend.weights.iter().take(order).enumerate();
            for (row, row_weight) in weights.clone() {
                for (column, weight) in weights.clone().take(row + 1) {
                    matrix.add(blend.first + row, blend.first + column, row_weight * weight);
                }
                for (number, target) in target.clone().enumerate() {
                    if let Some(sum) = right.get_mut(number * count + blend.first + row) {
                        *sum += row_weight * target;
                    }
                }
            }
        }
        matrix.factor().ok()?;
        matrix.solve_in_place(&mut right);
        let at = |number: usize, index: usize| right.get(number * count + index).copied().unwrap_or(0.0);
        let translation = (0..count).map(|index| Vector3::from_fn(|axis, _| at(axis, index))).collect();
        let quaternions =
            (0..count).map(|index| Quaternion::new(at(6, index), at(3, index), at(4, index), at(5, index))).collect();
        Some((translation, quaternions))
    }

    /// Returns the displacement from the fine control points to the control points of the curve with these coarse ones.
    fn displacement_to(
        &self,
        blends: &[Blend],
        translation: &[Vector3<f64>],
        quaternions: &[Quaternion<f64>],
    ) -> Displacement {
        let degree = self.trajectory.degree;
        let points = self.trajectory.translation.iter().zip(&self.quaternions);
        blends
            .iter()
            .zip(points)
            .map(|(blend, (point, quaternion))| {
                let moved = blended(blend, translation, degree) - point;
                let turned = UnitQuaternion::new_normalize(blended(blend, quaternions, degree));
                let turn = log(&(UnitQuaternion::new_normalize(*quaternion).inverse() * turned));
                [turn.x, turn.y, turn.z, moved.x, moved.y, moved.z]
            })
            .collect()
    }
}

/// Returns the step of the coarse control points that minimises [`reduced`].
fn reduced_step(
    blends: &[Blend],
    order: usize,
    count: usize,
    displacement: &Displacement,
    equations: &Band,
) -> Option<Displacement> {
    let Quadratic { mut matrix, mut right } = reduced(blends, order, count, displacement, equations)?;
    matrix.factor().ok()?;
    matrix.solve_in_place(&mut right);
    Some(right.as_chunks::<CONTROL_POINT>().0.to_vec())
}

/// Returns ½ (a + Eδ)ᵀA(a + Eδ) + gᵀ(a + Eδ) as a cost of the coarse control points' step δ, with a = `displacement` and E the
/// `blends` of `order` coarse points each; `None` without observations.
fn reduced(
    blends: &[Blend],
    order: usize,
    count: usize,
    displacement: &Displacement,
    equations: &Band,
) -> Option<Quadratic> {
    if equations.order < 2 || equations.gradient.len() != blends.len() {
        return None;
    }
    let dimension = CONTROL_POINT * count;
    let coupled = if order == 1 { equations.order } else { order };
    let mut matrix = BandedCholesky::zeros(dimension, (CONTROL_POINT * coupled - 1).min(dimension - 1));
    let mut right = vec![0.0; dimension];
    let forces = equations.times(displacement);
    for (index, blend) in blends.iter().enumerate() {
        let weights =
            || blend.weights.iter().take(order).enumerate().map(|(place, weight)| (blend.first + place, *weight));
        for (row, weight) in weights() {
            for axis in 0..CONTROL_POINT {
                right[CONTROL_POINT * row + axis] -= weight * (equations.gradient[index][axis] + forces[index][axis]);
            }
        }
        for back in 0..equations.order.min(index + 1) {
            let block = &equations.blocks[index * equations.order + back];
            let other = &blends[index - back];
            for (row, row_weight) in weights() {
                for (column, weight) in other.weights.iter().take(order).enumerate() {
                    let column = other.first + column;
                    let weight = row_weight * weight;
                    if weight != 0.0 {
                        add_block(&mut matrix, row, column, weight, block, back == 0);
                    }
                }
            }
        }
    }
    Some(Quadratic { matrix, right })
}

/// Adds `weight` times `block` at (row, column) of the blocks of `matrix`, and off the diagonal its transpose at (column, row).
/// Only the lower triangle is stored.
fn add_block(
    matrix: &mut BandedCholesky,
    row: usize,
    column: usize,
    weight: f64,
    block: &super::control_band::Block,
    symmetric: bool,
) {
    let entry = |a: usize, b: usize| if symmetric { block[(a.max(b), a.min(b))] } else { block[(a, b)] };
    for a in 0..CONTROL_POINT {
        for b in 0..CONTROL_POINT {
            let (line, place) = (CONTROL_POINT * row + a, CONTROL_POINT * column + b);
            if line >= place {
                matrix.add(line, place, weight * entry(a, b));
            }
            if !symmetric && place >= line {
                matrix.add(place, line, weight * entry(a, b));
            }
        }
    }
}

fn blended<T>(blend: &Blend, control: &[T], degree: usize) -> T
where
    T: Copy + Default + std::ops::Mul<f64, Output = T> + std::ops::Add<Output = T>,
{
    let parts = control.iter().skip(blend.first).zip(&blend.weights).take(degree + 1);
    parts.map(|(&point, &weight)| point * weight).reduce(|sum, part| sum + part).unwrap_or_default()
}
