//! Time of one evaluation of a cubic spline, basis functions included.

use std::hint::black_box;

use divan::Bencher;
use evcal_core::spline::rotation::exp;
use evcal_core::spline::{Basis, Knots, quaternion, so3, vector};
use nalgebra::{Quaternion, RealField, UnitQuaternion, Vector3, convert};

fn main() {
    divan::main();
}

const KNOTS: [f64; 13] = [0.0, 0.0, 0.0, 0.0, 0.1, 0.25, 0.3, 0.5, 0.8, 1.0, 1.0, 1.0, 1.0];

fn knots<T: RealField + Copy>() -> [T; 13] {
    KNOTS.map(convert)
}

fn basis<T: RealField + Copy>(knots: &[T]) -> Option<Basis<T>> {
    Knots::assume_valid(black_box(knots), black_box(3)).basis(black_box(convert(0.4))).ok()
}

fn rotations<T: RealField + Copy>() -> [UnitQuaternion<T>; 9] {
    std::array::from_fn(|i| exp(&Vector3::new(0.1, 0.05, -0.02).map(|turn: f64| convert(turn * i as f64))))
}

#[divan::bench(types = [f32, f64])]
fn position_and_velocity<T: RealField + Copy>(bencher: Bencher) {
    let knots = knots::<T>();
    let control: [Vector3<T>; 9] = std::array::from_fn(|i| Vector3::repeat(convert(i as f64)));
    bencher.bench(|| {
        let sample = vector::evaluate(&basis(&knots)?, black_box(&control))?;
        Some((sample.value, sample.first_derivative))
    });
}

#[divan::bench(types = [f32, f64])]
fn quaternion_with_jacobians<T: RealField + Copy>(bencher: Bencher) {
    let knots = knots::<T>();
    let control: [Quaternion<T>; 9] = rotations().map(UnitQuaternion::into_inner);
    bencher.bench(|| quaternion::evaluate(&basis(&knots)?, black_box(&control)));
}

#[divan::bench(types = [f32, f64])]
fn so3_with_jacobians<T: RealField + Copy>(bencher: Bencher) {
    let knots = knots::<T>();
    let control: [UnitQuaternion<T>; 9] = rotations();
    bencher.bench(|| so3::evaluate(&basis(&knots)?, black_box(&control)));
}
