//! The initial model against synthetic frames whose camera and poses are known.

use evcal_core::camera::{Camera, ModelKind, conversion::difference};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

const SENSOR: (u16, u16) = (346, 260);

fn board() -> Board {
    "acircles:9x4:55mm:r17.5mm".parse().unwrap()
}

fn true_camera(kind: ModelKind) -> Camera<f64> {
    let parameters: &[f64] = match kind {
        ModelKind::Radtan4 => &[345.0, 344.0, 170.0, 127.0, -0.3, 0.09, 0.0008, -0.0005],
        ModelKind::Radtan => &[345.0, 344.0, 170.0, 127.0, -0.36, 0.18, 0.0008, -0.0005, -0.04],
        ModelKind::Radtan8 => &[345.0, 344.0, 170.0, 127.0, 0.1, 0.05, 0.0008, -0.0005, 0.01, 0.45, 0.1, 0.02],
        ModelKind::KannalaBrandt => &[150.0, 149.0, 174.0, 131.0, 0.02, -0.01, 0.004, -0.001],
        ModelKind::InverseRadial => &[345.0, 344.0, 170.0, 127.0, 0.3, 0.15, 0.1, 0.05, 0.02],
    };
    Camera::from_parameters(kind, parameters).unwrap()
}

fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..1.0));
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// A hand's motion: `T_camera_world` of a board that wanders through the image, tilts to all sides and
/// rolls, at a distance at which it fills most of the image of `camera`.
fn pose(camera: &Camera<f64>, board: &Board, t: f64) -> Isometry3<f64> {
    let wave = |rate: f64, phase: f64| (rate * t + phase).sin();
    let tilt = UnitQuaternion::from_euler_angles(0.6 * wave(2.1, 0.3), 0.6 * wave(1.7, 1.9), 0.5 * wave(0.9, 0.0));
    let focal = camera.parameters()[0];
    let distance = 0.6 * focal / 345.0 * (1.15 + 0.25 * wave(1.1, 0.7));
    let sideways = Vector3::new(0.3 * wave(1.3, 2.0), 0.22 * wave(2.7, 0.4), 1.0) * distance;
    let middle = board.middle();
    Isometry3::from_parts(Translation3::from(sideways), tilt)
        * Translation3::new(-middle.x, -middle.y, 0.0)
}

fn image(camera: &Camera<f64>, pose: &Isometry3<f64>, board: &Board, index: usize) -> Option<Vector2<f64>> {
    let center = board.circle_center(index);
    let pixel = camera.project(&(pose * Point3::new(center.x, center.y, 0.0)).coords)?;
    let inside = |value: f64, size: u16| value > 8.0 && value < f64::from(size) - 9.0;
    (inside(pixel.x, SENSOR.0) && inside(pixel.y, SENSOR.1)).then_some(pixel)
}

/// What is wrong with a frame on purpose.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    Mirrored,
    Turned,
    Shifted,
}

struct Scene {
    camera: Camera<f64>,
    board: Board,
    noise: f64,
    step: f64,
    count: usize,
}

impl Scene {
    fn new(kind: ModelKind) -> Self {
        Self { camera: true_camera(kind), board: board(), noise: 0.15, step: 0.02, count: 300 }
    }

    fn truth(&self, frame: usize) -> Isometry3<f64> {
        pose(&self.camera, &self.board, frame as f64 * self.step)
    }

    /// Circles at the centres of their images, circle by circle one in fifty misplaced; parts of the
    /// board that leave the image are missing.
    fn frames(&self, seed: u64, fault: impl Fn(usize) -> Fault) -> Vec<ReferenceFrame> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let columns = usize::from(self.board.pattern.columns);
        let count = self.board.circle_count();
        // Centres of ellipses are what detectors find; the correction for that is tested by its own.
        (0..self.count)
            .map(|frame| {
                let t = frame as f64 * self.step;
                let pose = self.truth(frame);
                let mut circles = Vec::new();
                for index in 0..count {
                    let Some(projected) = ProjectedCircle::new(
                        &self.camera,
                        &pose,
                        self.board.circle_center(index),
                        self.board.radius,
                    ) else {
                        continue;
                    };
                    if image(&self.camera, &pose, &self.board, index).is_none() {
                        continue;
                    }
                    let named = match fault(frame) {
                        Fault::None => Some(index),
                        Fault::Mirrored => Some(index / columns * columns + columns - 1 - index % columns),
                        Fault::Turned => Some(count - 1 - index),
                        Fault::Shifted => (index + 2 * columns < count).then_some(index + 2 * columns),
                    };
                    let misplaced = if rng.random_range(0..50) == 0 { 12.0 } else { self.noise };
                    let noise = Vector2::new(gauss(&mut rng), gauss(&mut rng)) * misplaced;
                    if let Some(index) = named {
                        let center = projected.middle + noise;
                        circles.push(ObservedCircle { index, t, center, radius: None, velocity: None });
                    }
                }
                circles.sort_by_key(|circle| circle.index);
                ReferenceFrame { recording: 0, start: t - 1e-3, end: t + 1e-3, circles, pixels: Vec::new() }
            })
            .collect()
    }
}

/// Root mean square and largest difference in pixels over the sensor, without rotation taken out.
fn error(truth: &Camera<f64>, found: &Camera<f64>) -> (f64, f64, usize) {
    let difference = difference(truth, found, SENSOR.0, SENSOR.1);
    (difference.root_mean_square, difference.largest, difference.outside)
}

#[test]
fn every_model_comes_back_from_noisy_partial_boards_with_wrong_frames() {
    for &kind in ModelKind::ALL {
        let scene = Scene::new(kind);
        let fault = |frame| match frame {
            0 | 100 => Fault::Turned,
            37 | 38 => Fault::Shifted,
            200 | 299 => Fault::Mirrored,
            _ => Fault::None,
        };
        let frames = scene.frames(7, fault);
        let model = initial_model(&frames, &scene.board, SENSOR, kind, &InitialSettings::default()).unwrap();
        let (rms, largest, _) = error(&scene.camera, &model.camera);
        println!("{kind} {rms:.3} {largest:.3} {:?} sigma {:.3?}", model.camera.parameters(), model.sigma);
        println!("{:?}", model.report.dropped_by_step());
        println!("{:?}", InitialReport{dropped:vec![],..model.report.clone()});
        for dropped in &model.report.dropped {
        }
        for frame in &model.frames {
            assert_eq!(fault(frame.frame), Fault::None, "{kind} {}", frame.frame);
        }
    }
}
