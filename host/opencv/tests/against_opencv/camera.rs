//! The camera models against OpenCV's `projectPoints` and `fisheye::projectPoints`: pixels and all
//! derivatives. OpenCV's fisheye is defined in front of the camera only, so are the points here.

use evcal_core::camera::{Camera, ModelKind};
use nalgebra::{DMatrix, Vector2, Vector3};
use opencv::core::{Mat, Point2d, Point3d, Vec3d, Vector};
use opencv::prelude::*;
use opencv::{Result, calib3d};

/// Pixels of OpenCV, and their derivatives by point, fx, fy, cx, cy and coefficients.
struct Reference {
    pixels: Vec<Vector2<f64>>,
    /// Two rows for each point; columns x, y, z of the point, then the parameters.
    derivatives: DMatrix<f64>,
}

/// Projects with OpenCV, with camera and world frame the same.
fn reference(camera: &Camera<f64>, points: &[Vector3<f64>]) -> Result<Reference> {
    let parameters = camera.parameters();
    let [fx, fy, cx, cy] = parameters[..4] else { unreachable!("four parameters come first") };
    let matrix = Mat::from_slice_2d(&[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])?;
    let coefficients = Vector::from_slice(&parameters[4..]);
    let objects: Vector<Point3d> = points.iter().map(|point| Point3d::new(point.x, point.y, point.z)).collect();
    let zero = Vec3d::all(0.0);
    let mut pixels = Vector::<Point2d>::new();
    let mut jacobian = Mat::default();
    // First columns of tvec, fx and the coefficients.
    let (translation, focal, distortion) = if camera.kind() == ModelKind::KannalaBrandt {
        calib3d::fisheye_project_points_vec(
            &objects,
            &mut pixels,
            &zero,
            &zero,
            &matrix,
            &coefficients,
            0.0,
            &mut jacobian,
        )?;
        (11, 0, 4)
    } else {
        calib3d::project_points(&objects, &zero, &zero, &matrix, &coefficients, &mut pixels, &mut jacobian, 0.0)?;
        (3, 6, 10)
    };
    let columns: Vec<i32> = (translation..translation + 3)
        .chain(focal..focal + 4)
        .chain(distortion..distortion + parameters.len() as i32 - 4)
        .collect();
    let mut derivatives = DMatrix::zeros(2 * points.len(), columns.len());
    for row in 0..derivatives.nrows() {
        for (index, &column) in columns.iter().enumerate() {
            derivatives[(row, index)] = *jacobian.at_2d::<f64>(row as i32, column)?;
        }
    }
    Ok(Reference { pixels: pixels.iter().map(|pixel| Vector2::new(pixel.x, pixel.y)).collect(), derivatives })
}

fn cameras() -> Vec<Camera<f64>> {
    let sets: &[(ModelKind, f64, &[f64])] = &[
        (ModelKind::Radtan4, 345.0, &[-0.3, 0.1, 0.001, -0.0005]),
        (ModelKind::Radtan4, 345.0, &[0.2, 0.05, -0.003, 0.002]),
        (ModelKind::Radtan, 345.0, &[-0.37, 0.16, 0.0001, -0.0002, -0.03]),
        (ModelKind::Radtan, 345.0, &[0.1, -0.1, 0.002, 0.001, 0.3]),
        (ModelKind::Radtan8, 345.0, &[0.5, 0.1, 0.0005, -0.0003, 0.02, 0.8, 0.3, 0.05]),
        (ModelKind::Radtan8, 345.0, &[3.0, 1.5, 1e-4, 2e-4, 0.1, 3.4, 2.3, 0.4]),
        (ModelKind::KannalaBrandt, 140.0, &[0.0, 0.0, 0.0, 0.0]),
        (ModelKind::KannalaBrandt, 140.0, &[-0.02, 0.01, -0.005, 0.001]),
        (ModelKind::KannalaBrandt, 140.0, &[0.1, 0.02, 0.01, 0.002]),
    ];
    sets.iter()
        .map(|&(kind, focal, coefficients)| {
            let parameters: Vec<f64> =
                [focal, focal * 0.99, 170.3, 127.8].iter().chain(coefficients).copied().collect();
            Camera::from_parameters(kind, &parameters).unwrap()
        })
        .collect()
}

/// Points at depths from 0.5 to 1.5 that are seen all over a DAVIS346.
fn points(camera: &Camera<f64>) -> Vec<Vector3<f64>> {
    (0..=25)
        .flat_map(|row| (0..=34).map(move |column| Vector2::new(f64::from(column) * 10.0, f64::from(row) * 10.0)))
        .filter_map(|pixel| {
            let bearing = camera.unproject(&pixel)?;
            let depth = 0.5 + (pixel.x * 0.37 + pixel.y * 0.73).fract();
            (bearing.z > 0.05).then(|| bearing * (depth / bearing.z))
        })
        .collect()
}

#[test]
fn pixels_and_derivatives_agree_with_opencv() -> Result<()> {
    for camera in cameras() {
        let points = points(&camera);
        assert!(points.len() > 800, "{camera:?}: {} points", points.len());
        let expected = reference(&camera, &points)?;
        for (index, point) in points.iter().enumerate() {
            let projection = camera.project_with_jacobians(point).unwrap();
            let pixel = expected.pixels[index];
            assert!((projection.pixel - pixel).norm() < 1e-10, "{camera:?} {point} {pixel}");
            for row in 0..2 {
                let (by_point, by_parameters) = (projection.by_point.row(row), projection.by_parameters.row(row));
                let opencv = expected.derivatives.row(2 * index + row);
                let pairs = by_point.iter().chain(by_parameters.iter()).zip(opencv.iter());
                for (column, (own, opencv)) in pairs.enumerate() {
                    let difference = (own - opencv).abs();
                    assert!(difference < 1e-9 * (1.0 + opencv.abs()), "{camera:?} {point} {column}: {own} {opencv}");
                }
            }
        }
    }
    Ok(())
}

#[test]
fn opencv_projects_our_bearings_to_their_pixels() -> Result<()> {
    for camera in cameras() {
        let (pixels, bearings): (Vec<_>, Vec<_>) = (0..=34)
            .flat_map(|column| (0..=25).map(move |row| Vector2::new(f64::from(column) * 10.0, f64::from(row) * 10.0)))
            .filter_map(|pixel| Some((pixel, camera.unproject(&pixel)?)))
            .filter(|(_, bearing)| bearing.z > 0.05)
            .unzip();
        for (pixel, projected) in pixels.iter().zip(reference(&camera, &bearings)?.pixels) {
            assert!((pixel - projected).norm() < 1e-9, "{camera:?} {pixel} {projected}");
        }
    }
    Ok(())
}
