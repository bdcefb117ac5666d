//! `camera.yaml` is read by OpenCV, and then OpenCV projects as `calibration.json` says.

use std::path::Path;

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use evcal_geometry::lens::covered_region::CoveredRegion;
use evcal_tests::lens::{INVERSE_RADIAL, KANNALA_BRANDT, Lens, RADTAN, RADTAN4, RADTAN8};
use evcal_tests::{camera, read_json, text};
use nalgebra::{Vector2, Vector3};
use opencv::calib3d::{fisheye_project_points_vec_def, project_points_def};
use opencv::core::{FileStorage, FileStorage_READ, Mat, Point2d, Point3d, Vec3d, Vector};
use opencv::prelude::*;

/// What OpenCV reads.
struct Storage(FileStorage);

impl Storage {
    fn open(path: &Path) -> Self {
        let storage = FileStorage::new(text(path), FileStorage_READ, "").unwrap();
        assert!(storage.is_opened().unwrap(), "{}", path.display());
        Self(storage)
    }

    fn matrix(&self, name: &str) -> Mat {
        self.0.get(name).unwrap().mat().unwrap()
    }

    fn number(&self, name: &str) -> f64 {
        let node = self.0.get(name).unwrap();
        assert!(!node.empty().unwrap(), "{name} is missing");
        node.to_f64().unwrap()
    }

    fn word(&self, name: &str) -> String {
        self.0.get(name).unwrap().to_string().unwrap()
    }

    /// The pixels at which OpenCV sees these points of the camera frame.
    fn project(&self, points: &[Vector3<f64>]) -> Vec<Vector2<f64>> {
        let points: Vector<Point3d> = points.iter().map(|point| Point3d::new(point.x, point.y, point.z)).collect();
        let (camera_matrix, distortion) = (self.matrix("camera_matrix"), self.matrix("distortion_coefficients"));
        let none = Vec3d::default();
        let mut pixels = Vector::<Point2d>::new();
        match self.word("distortion_model").as_str() {
            "radtan" => {
                project_points_def(&points, &none, &none, &camera_matrix, &distortion, &mut pixels).unwrap();
            }
            "fisheye" => {
                fisheye_project_points_vec_def(&points, &mut pixels, &none, &none, &camera_matrix, &distortion)
                    .unwrap();
            }
            other => panic!("OpenCV has no model {other}"),
        }
        pixels.iter().map(|pixel| Vector2::new(pixel.x, pixel.y)).collect()
    }
}

/// The distances between pixels all over the sensor and where OpenCV sees their bearings.
fn distances(storage: &Storage, camera: &Camera<f64>, pixels: impl Iterator<Item = Vector2<f64>>) -> Vec<f64> {
    let seen: Vec<(Vector2<f64>, Vector3<f64>)> =
        pixels.filter_map(|pixel| Some((pixel, camera.unproject(&pixel)?))).collect();
    let bearings: Vec<Vector3<f64>> = seen.iter().map(|(_, bearing)| *bearing).collect();
    let projected = storage.project(&bearings);
    assert_eq!(projected.len(), seen.len());
    projected.iter().zip(&seen).map(|(projected, (pixel, _))| (projected - pixel).norm()).collect()
}

fn pixels() -> impl Iterator<Item = Vector2<f64>> {
    (0..=10).flat_map(|row| (0..=10).map(move |column| Vector2::new(34.5 * f64::from(column), 25.9 * f64::from(row))))
}

fn agrees(lens: Lens) {
    let folder = lens.own_calibration();
    let storage = Storage::open(&folder.join("camera.yaml"));
    assert_eq!((storage.number("image_width"), storage.number("image_height")), (346.0, 260.0));
    let distances = distances(&storage, &camera(&folder.join("calibration.json")), pixels());
    assert!(distances.len() == 121, "{} of 121 pixels have a bearing", distances.len());
    let largest = distances.iter().copied().fold(0.0, f64::max);
    assert!(largest < 1e-6, "{}: {largest} px", lens.model);
}

#[test]
fn radtan4() {
    agrees(RADTAN4);
}

#[test]
fn radtan() {
    agrees(RADTAN);
}

#[test]
fn radtan8() {
    agrees(RADTAN8);
}

#[test]
fn kannala_brandt() {
    agrees(KANNALA_BRANDT);
}

/// OpenCV has no such model: the file holds the nearest that it has, and says how near that is.
#[test]
fn inverse_radial() {
    let folder = INVERSE_RADIAL.own_calibration();
    let storage = Storage::open(&folder.join("camera.yaml"));
    assert_eq!(storage.word("refit_from"), "inverse-radial");
    let file = folder.join("calibration.json");
    let corners: Vec<[f64; 2]> = serde_json::from_value(read_json(&file)["covered_region"].clone()).unwrap();
    let region = CoveredRegion::around(corners.into_iter().map(Vector2::from), Sensor::new(346, 260));
    let [rms, max] = ["refit_error_rms", "refit_error_max"].map(|name| storage.number(name));
    let pixels = (0..26).flat_map(|row| (0..35).map(move |column| Vector2::new(column as f64, row as f64) * 10.0));
    let distances = distances(&storage, &camera(&file), pixels.filter(|pixel| region.contains(pixel)));
    assert!(distances.len() > 500 && max < 0.1, "{} pixels, {max} px", distances.len());
    let largest = distances.iter().copied().fold(0.0, f64::max);
    let mean_square = distances.iter().map(|distance| distance * distance).sum::<f64>() / distances.len() as f64;
    // The file speaks of every pixel.
    assert!(largest <= max && mean_square.sqrt() < 1.2 * rms, "{largest} and {} px", mean_square.sqrt());
}
