//! Curves in space and rotation.

use core::hint::black_box;

use evcal_core::spline::rotation::{exp, log, right_jacobian, right_jacobian_inverse, skew};
use evcal_core::spline::{Knots, quaternion, so3, vector};
use nalgebra::{Quaternion, RealField, UnitQuaternion, Vector3};

use crate::any;

/// Knots of any degree, and the three curves on them.
#[inline(never)]
pub fn curves<T: RealField + Copy>() {
    let knots = [any::<T>(); 8];
    let knots: &[T] = black_box(&knots);
    let degree = black_box(3);
    let knots = match Knots::new(knots, degree) {
        Ok(knots) => knots,
        Err(error) => {
            black_box(error);
            Knots::assume_valid(knots, degree)
        }
    };
    black_box((knots.degree(), knots.control_point_count(), knots.start(), knots.end(), knots.as_slice()));
    black_box(knots.find_span(any()).is_ok());
    let Ok(basis) = knots.basis(any()) else { return };
    let points = [Vector3::repeat(any::<T>()); 4];
    black_box(vector::evaluate(&basis, black_box(points.as_slice())));
    let mut quaternions = [Quaternion::new(any::<T>(), any(), any(), any()); 4];
    quaternion::align_signs(black_box(quaternions.as_mut_slice()));
    black_box(quaternion::evaluate(&basis, black_box(quaternions.as_slice())));
    black_box(quaternion::motion(&basis, black_box(quaternions.as_slice())));
    let rotations = quaternions.map(UnitQuaternion::new_unchecked);
    black_box(so3::evaluate(&basis, black_box(rotations.as_slice())));
    black_box(so3::motion(&basis, black_box(rotations.as_slice())));
}

/// Rotation vectors.
#[inline(never)]
pub fn rotations<T: RealField + Copy>() {
    let phi = Vector3::new(any::<T>(), any(), any());
    black_box((skew(&phi), right_jacobian(&phi), right_jacobian_inverse(&phi), log(&black_box(exp(&phi)))));
}
