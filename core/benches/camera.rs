//! Bearings with all derivatives for every pixel of a DAVIS346, by model; items are pixels.

use divan::Bencher;
use divan::counter::ItemsCount;
use evcal_core::camera::{Camera, ModelKind};
use nalgebra::{RealField, Vector2};

const WIDTH: u16 = 346;
const HEIGHT: u16 = 260;

fn main() {
    divan::main();
}

/// Returns a DAVIS346 with a 6 mm lens of moderate barrel distortion.
fn camera<T: RealField + Copy>(kind: ModelKind) -> Camera<T> {
    let coefficients: &[f64] = match kind {
        ModelKind::Radtan4 => &[-0.3, 0.1, 0.001, -0.0005],
        ModelKind::Radtan => &[-0.37, 0.16, 0.0001, -0.0002, -0.03],
        ModelKind::Radtan8 => &[0.5, 0.1, 0.0005, -0.0003, 0.02, 0.8, 0.3, 0.05],
        ModelKind::KannalaBrandt => &[-0.02, 0.01, -0.005, 0.001],
        ModelKind::InverseRadial => &[0.3, 0.1, 0.1, 0.05, 0.02],
        ModelKind::Ucm => &[0.6],
        ModelKind::Eucm => &[0.6, 1.1],
        ModelKind::DoubleSphere => &[-0.2, 0.6],
        ModelKind::Fov => &[0.9],
        ModelKind::Omni => &[1.2, -0.1, 0.02, 0.001, -0.0005],
    };
    let parameters: Vec<T> =
        [345.0, 345.0, 170.0, 127.0].iter().chain(coefficients).map(|&value| nalgebra::convert(value)).collect();
    Camera::from_parameters(kind, &parameters).expect("the parameters are valid")
}

fn pixels<T: RealField + Copy>() -> Vec<Vector2<T>> {
    let coordinate = |value: u16| nalgebra::convert(f64::from(value));
    (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| Vector2::new(coordinate(x), coordinate(y)))).collect()
}

#[divan::bench(types = [f32, f64], args = ModelKind::ALL)]
fn unproject_with_jacobians<T: RealField + Copy>(bencher: Bencher, kind: ModelKind) {
    let camera = camera::<T>(kind);
    let pixels = pixels::<T>();
    bencher.counter(ItemsCount::new(pixels.len())).bench_local(|| {
        for pixel in &pixels {
            divan::black_box(camera.unproject_with_jacobians(divan::black_box(pixel)));
        }
    });
}

#[divan::bench(types = [f32, f64], args = ModelKind::ALL)]
fn project_with_jacobians<T: RealField + Copy>(bencher: Bencher, kind: ModelKind) {
    let camera = camera::<T>(kind);
    let bearings: Vec<_> = pixels::<T>().iter().filter_map(|pixel| camera.unproject(pixel)).collect();
    bencher.counter(ItemsCount::new(bearings.len())).bench_local(|| {
        for bearing in &bearings {
            divan::black_box(camera.project_with_jacobians(divan::black_box(bearing)));
        }
    });
}
