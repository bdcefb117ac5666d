//! Synthetic frames whose camera and poses are known.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Board, ObservedCircle, ProjectedCircle, ReferenceFrame, SeenIn};

pub const SENSOR: Sensor = Sensor::new(346, 260);

pub fn board() -> Board {
    "acircles:9x4:55mm:r17.5mm".parse().unwrap()
}

pub fn true_camera(kind: ModelKind) -> Camera<f64> {
    let parameters: &[f64] = match kind {
        ModelKind::Radtan4 => &[345.0, 344.0, 170.0, 127.0, -0.3, 0.09, 0.0008, -0.0005],
        ModelKind::Radtan => &[345.0, 344.0, 170.0, 127.0, -0.36, 0.18, 0.0008, -0.0005, -0.04],
        ModelKind::Radtan8 => &[345.0, 344.0, 170.0, 127.0, 0.1, 0.05, 0.0008, -0.0005, 0.01, 0.45, 0.1, 0.02],
        ModelKind::KannalaBrandt => &[150.0, 149.0, 174.0, 131.0, 0.02, -0.01, 0.004, -0.001],
        ModelKind::InverseRadial => &[345.0, 344.0, 170.0, 127.0, 0.3, 0.15, 0.1, 0.05, 0.02],
        ModelKind::Ucm => &[190.0, 189.0, 174.0, 131.0, 0.62],
        ModelKind::Eucm => &[190.0, 189.0, 174.0, 131.0, 0.6, 1.1],
        ModelKind::DoubleSphere => &[152.0, 151.0, 174.0, 131.0, -0.2, 0.58],
        ModelKind::Fov => &[190.0, 189.0, 174.0, 131.0, 0.95],
        ModelKind::Omni => &[418.0, 416.0, 174.0, 131.0, 1.2, -0.1, 0.05, 0.0008, -0.0005],
    };
    Camera::from_parameters(kind, parameters).unwrap()
}

pub fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..1.0));
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// A hand's motion: `T_camera_world` of a board that moves through the image, tilts to all sides and rolls, at a distance at
/// which it fills most of the image of `camera`.
pub fn pose(camera: &Camera<f64>, board: &Board, t: f64) -> Isometry3<f64> {
    let wave = |rate: f64, phase: f64| (rate * t + phase).sin();
    let tilt = UnitQuaternion::from_euler_angles(0.6 * wave(2.1, 0.3), 0.6 * wave(1.7, 1.9), 0.5 * wave(0.9, 0.0));
    let focal = camera.axial_focal_lengths().unwrap()[0];
    let distance = 0.6 * focal / 345.0 * (1.15 + 0.25 * wave(1.1, 0.7));
    let sideways = Vector3::new(0.3 * wave(1.3, 2.0), 0.22 * wave(2.7, 0.4), 1.0) * distance;
    let middle = board.middle();
    Isometry3::from_parts(Translation3::from(sideways), tilt) * Translation3::new(-middle.x, -middle.y, 0.0)
}

pub fn image(camera: &Camera<f64>, pose: &Isometry3<f64>, board: &Board, index: usize) -> Option<Vector2<f64>> {
    let center = board.point(index);
    let pixel = camera.project(&(pose * Point3::new(center.x, center.y, 0.0)).coords)?;
    let inside = |value: f64, size: u16| value > 8.0 && value < f64::from(size) - 9.0;
    (inside(pixel.x, SENSOR.width) && inside(pixel.y, SENSOR.height)).then_some(pixel)
}

/// A deliberate fault of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    None,
    Mirrored,
    Turned,
    Shifted,
}

pub struct Scene {
    pub camera: Camera<f64>,
    pub board: Board,
    pub noise: f64,
    /// One of this number of circles is misplaced.
    pub misplaced: u32,
    pub step: f64,
    pub count: usize,
}

impl Scene {
    pub fn new(kind: ModelKind) -> Self {
        Self { camera: true_camera(kind), board: board(), noise: 0.15, misplaced: 50, step: 0.02, count: 300 }
    }

    pub fn truth(&self, frame: usize) -> Isometry3<f64> {
        pose(&self.camera, &self.board, frame as f64 * self.step)
    }

    /// Returns circles as detectors see them, at the centres of their elliptic images, some misplaced; parts of the board outside
    /// the image are missing.
    pub fn frames(&self, seed: u64, fault: impl Fn(usize) -> Fault) -> Vec<ReferenceFrame> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let columns = usize::from(self.board.lattice().columns);
        let count = self.board.point_count();
        (0..self.count)
            .map(|frame| {
                let t = frame as f64 * self.step;
                let pose = self.truth(frame);
                let mut circles = Vec::new();
                for index in 0..count {
                    let Some(projected) =
                        ProjectedCircle::new(&self.camera, &pose, self.board.point(index), self.board.dot_radius())
                    else {
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
                    let misplaced = if rng.random_range(0..self.misplaced) == 0 { 12.0 } else { self.noise };
                    let noise = Vector2::new(gauss(&mut rng), gauss(&mut rng)) * misplaced;
                    if let Some(index) = named {
                        let center = projected.middle + noise;
                        circles.push(ObservedCircle { index, t, center, radius: None, velocity: None });
                    }
                }
                circles.sort_by_key(|circle| circle.index);
                ReferenceFrame { recording: 0, start: t - 1e-3, end: t + 1e-3, circles, seen_in: SeenIn::Circles }
            })
            .collect()
    }
}
