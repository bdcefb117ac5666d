//! Pictures of boards with a known truth, for tests.

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

use crate::picture::Picture;

pub const WIDTH: usize = 346;
pub const HEIGHT: usize = 260;

/// A camera's view of the board plane.
#[derive(Clone, Copy)]
pub struct View {
    to_image: Matrix3<f64>,
}

impl View {
    /// The board's `middle` (x, y) is in the middle of the picture, `distance` away and turned by `rotation` (radians about x, y,
    /// z); f is 330 px.
    pub fn new(middle: [f64; 2], distance: f64, rotation: [f64; 3]) -> Self {
        let turn = Rotation3::from_euler_angles(rotation[0], rotation[1], rotation[2]).into_inner();
        let middle = Vector3::new(middle[0], middle[1], 0.0);
        let translation = Vector3::new(0.0, 0.0, distance) - turn * middle;
        let camera = Matrix3::new(330.0, 0.0, 172.5, 0.0, 330.0, 129.5, 0.0, 0.0, 1.0);
        Self { to_image: camera * Matrix3::from_columns(&[turn.column(0).into(), turn.column(1).into(), translation]) }
    }

    /// The view moved in the picture.
    pub fn moved(self, x: f64, y: f64) -> Self {
        Self { to_image: Matrix3::new(1.0, 0.0, x, 0.0, 1.0, y, 0.0, 0.0, 1.0) * self.to_image }
    }

    pub fn pixel(&self, point: Vector2<f64>) -> [f32; 2] {
        let image = self.to_image * point.push(1.0);
        [(image.x / image.z) as f32, (image.y / image.z) as f32]
    }

    /// What the camera sees of a board with this brightness at (x, y), slightly blurred.
    pub fn render(&self, brightness: impl Fn(f64, f64) -> f32) -> Picture {
        const PARTS: usize = 8;
        let to_board = self.to_image.try_inverse().unwrap();
        let pixel = |index: usize| {
            let parts = (0..PARTS * PARTS).map(|part| {
                let [dx, dy] = [part % PARTS, part / PARTS].map(|part| (part as f64 + 0.5) / PARTS as f64 - 0.5);
                let board = to_board * Vector3::new((index % WIDTH) as f64 + dx, (index / WIDTH) as f64 + dy, 1.0);
                brightness(board.x / board.z, board.y / board.z)
            });
            parts.sum::<f32>() / (PARTS * PARTS) as f32
        };
        Picture::new(WIDTH, HEIGHT, (0..WIDTH * HEIGHT).map(pixel).collect()).unwrap().blurred(0.7)
    }
}

/// Adds the same noise in ± `amplitude` in every run.
pub fn noisy(picture: &Picture, amplitude: f32) -> Picture {
    let mut state = 12345_u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 8) as f32 / (1 << 23) as f32 - 1.0) * amplitude
    };
    let values = picture.values().iter().map(|value| value + noise()).collect();
    Picture::new(picture.width(), picture.height(), values).unwrap()
}
