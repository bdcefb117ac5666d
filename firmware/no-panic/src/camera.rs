//! Camera models, and conversion between models.

use core::hint::black_box;

use evcal_core::camera::conversion::{inverse_radial_from_radtan, radtan_from_inverse_radial};
use evcal_core::camera::refit::{difference, refit};
use evcal_core::camera::{Camera, CameraModel, InverseRadial, ModelKind, Radtan5};
use evcal_core::sensor::Sensor;
use evcal_core::undistortion::{IdealCamera, UndistortionTable};
use nalgebra::{RealField, Vector2, Vector3};

use crate::any;

fn kind() -> ModelKind {
    // `black_box` hides the index from the compiler.
    ModelKind::ALL.get(black_box(0)).copied().unwrap_or(ModelKind::Radtan)
}

/// Projection and its inverse with derivatives, for every model.
#[inline(never)]
pub fn every_model<T: RealField + Copy>() {
    black_box(ModelKind::from_name(black_box("radtan")).map(|kind| (kind.name(), kind.parameter_names())));
    let parameters = [any::<T>(); 12];
    let Some(camera) = Camera::from_parameters(kind(), black_box(parameters.as_slice())) else { return };
    black_box((camera.kind(), camera.parameters()));
    let pixel = Vector2::new(any::<T>(), any());
    let point = Vector3::new(any::<T>(), any(), any());
    black_box((camera.project(&point), camera.unproject(&pixel)));
    black_box((camera.project_with_jacobians(&point), camera.unproject_with_jacobians(&pixel)));
}

/// Conversion and refit.
#[inline(never)]
pub fn conversions<T: RealField + Copy>() {
    let parameters = [any::<T>(); 9];
    let parameters: &[T] = black_box(&parameters);
    let sensor = Sensor { width: black_box(1), height: black_box(1) };
    if let Some(camera) = Radtan5::from_parameters(parameters) {
        black_box(inverse_radial_from_radtan(&camera, sensor));
    }
    if let Some(camera) = InverseRadial::from_parameters(parameters) {
        black_box(radtan_from_inverse_radial(&camera, sensor));
    }
    let Some(camera) = Camera::from_parameters(kind(), parameters) else { return };
    if let Some(other) = refit(kind(), &camera, sensor) {
        black_box(difference(&camera, &other, sensor));
    }
}

/// The undistortion table: created from a camera, or from nodes, and used.
#[inline(never)]
pub fn undistortion<T: RealField + Copy>() {
    let sensor = Sensor { width: black_box(1), height: black_box(1) };
    let ideal = IdealCamera { fx: any::<T>(), fy: any(), cx: any(), cy: any() };
    let parameters = [any::<T>(); 9];
    if let Some(camera) = Camera::from_parameters(kind(), black_box(parameters.as_slice()))
        && let Ok(table) = UndistortionTable::new(&camera, &ideal, sensor, black_box([2, 2]), black_box([[0.0; 2]; 64]))
    {
        black_box(table.accuracy(&camera, &ideal));
    }
    let table = UndistortionTable::from_nodes(sensor, black_box([2, 2]), black_box(&[[0.0; 2]; 64]));
    black_box(table.map(|table| table.undistort(black_box(1.0), black_box(1.0)).is_some()).is_ok());
}
