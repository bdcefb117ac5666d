//! Pictures of boards with a known ground truth, for tests.

use evcal_core::camera::{Camera, ModelKind};
use evcal_geometry::board::squares::raster::Raster;
use evcal_geometry::board::tag::Tag;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};

use crate::picture::Picture;

pub const WIDTH: usize = 346;
pub const HEIGHT: usize = 260;

/// A camera's view of the board plane.
#[derive(Clone, Copy)]
pub struct View {
    to_image: Matrix3<f64>,
}

impl View {
    /// Creates a view with the board's `middle` (x, y) in the middle of the picture, at `distance` and rotated by
    /// `rotation` (radians about x, y, z); f is 330 px.
    pub fn new(middle: [f64; 2], distance: f64, rotation: [f64; 3]) -> Self {
        let turn = Rotation3::from_euler_angles(rotation[0], rotation[1], rotation[2]).into_inner();
        let middle = Vector3::new(middle[0], middle[1], 0.0);
        let translation = Vector3::new(0.0, 0.0, distance) - turn * middle;
        let camera = Matrix3::new(330.0, 0.0, 172.5, 0.0, 330.0, 129.5, 0.0, 0.0, 1.0);
        Self { to_image: camera * Matrix3::from_columns(&[turn.column(0).into(), turn.column(1).into(), translation]) }
    }

    /// Returns the view moved in the picture.
    pub fn moved(self, x: f64, y: f64) -> Self {
        Self { to_image: Matrix3::new(1.0, 0.0, x, 0.0, 1.0, y, 0.0, 0.0, 1.0) * self.to_image }
    }

    pub fn pixel(&self, point: Vector2<f64>) -> [f32; 2] {
        let image = self.to_image * point.push(1.0);
        [(image.x / image.z) as f32, (image.y / image.z) as f32]
    }

    /// Renders a board with this brightness at (x, y), slightly blurred.
    pub fn render(&self, brightness: impl Fn(f64, f64) -> f32) -> Picture {
        self.render_in_parts(8, brightness)
    }

    /// Renders a board as [`View::render`] does, with `parts` × `parts` samples per pixel.
    pub fn render_in_parts(&self, parts: usize, brightness: impl Fn(f64, f64) -> f32) -> Picture {
        let to_board = self.to_image.try_inverse().unwrap();
        let pixel = |index: usize| {
            let samples = (0..parts * parts).map(|part| {
                let [dx, dy] = [part % parts, part / parts].map(|part| (part as f64 + 0.5) / parts as f64 - 0.5);
                let board = to_board * Vector3::new((index % WIDTH) as f64 + dx, (index / WIDTH) as f64 + dy, 1.0);
                brightness(board.x / board.z, board.y / board.z)
            });
            samples.sum::<f32>() / (parts * parts) as f32
        };
        Picture::new(WIDTH, HEIGHT, (0..WIDTH * HEIGHT).map(pixel).collect()).unwrap().blurred(0.7)
    }
}

/// Numbers between −1 and 1, the same in every run.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x1234_5678_9abc_def1)
    }

    pub fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() * 0.5
    }
}

/// A view of a board through a lens, in light that a [`Light`] describes.
pub struct Shot<'a> {
    pub raster: &'a Raster,
    pub camera: Camera<f64>,
    pub pose: Isometry3<f64>,
}

/// Blur, noise and light of a picture.
#[derive(Clone, Copy)]
pub struct Light {
    /// Standard deviation of the blur (px).
    pub blur: f64,
    /// Motion during the exposure (px).
    pub motion: [f64; 2],
    /// Noise as a share of the contrast.
    pub noise: f64,
    /// Share of the light that is missing in the corners of the picture.
    pub vignetting: f64,
    /// Exponent of the response of the camera.
    pub gamma: f64,
}

impl Light {
    pub const EVEN: Self = Self { blur: 0.6, motion: [0.0; 2], noise: 0.0, vignetting: 0.0, gamma: 1.0 };
}

/// A part of a picture.
pub struct Part {
    pub picture: Picture,
    /// Its first pixel.
    pub position: [usize; 2],
}

/// A lens with distortion for pictures of 346 × 260 pixels.
pub fn lens(k1: f64) -> Camera<f64> {
    Camera::from_parameters(ModelKind::Radtan4, &[332.0, 332.0, 173.3, 128.6, k1, -0.4 * k1, 0.0, 0.0]).unwrap()
}

impl Shot<'_> {
    /// Returns a pose in which `target` of the board appears at `pixel` with this many pixels per metre, tilted and
    /// rotated by `rotation`.
    pub fn pose(
        camera: &Camera<f64>,
        target: Vector2<f64>,
        pixel: [f64; 2],
        scale: f64,
        [a, b, c]: [f64; 3],
    ) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_euler_angles(a, b, c);
        let bearing = camera.unproject(&Vector2::from(pixel)).unwrap();
        let [focal, _] = camera.axial_focal_lengths().unwrap();
        let place = bearing * (focal / scale);
        Isometry3::from_parts(Translation3::from(place - rotation * target.push(0.0)), rotation)
    }

    pub fn pixel(&self, point: Vector2<f64>) -> Vector2<f64> {
        self.camera.project(&(self.pose * Point3::from(point.push(0.0))).coords).unwrap()
    }

    /// Renders the part of the picture within `reach` pixels of `middle`. Each pixel has `PARTS` × `PARTS` samples at
    /// random places of their parts; the blur is a Gaussian on them.
    pub fn render(&self, middle: Vector2<f64>, reach: f64, light: &Light, random: &mut Random) -> Part {
        const PARTS: usize = 10;
        let low = [middle.x, middle.y].map(|middle| (middle - reach).floor().max(0.0) as usize);
        let size: [usize; 2] = std::array::from_fn(|axis| {
            let end = ((middle[axis] + reach).ceil()).min([WIDTH, HEIGHT][axis] as f64) as usize;
            end - low[axis]
        });
        let margin = (4.0 * light.blur + light.motion[0].abs().max(light.motion[1].abs())).ceil() as usize;
        let fine = size.map(|size| (size + 2 * margin) * PARTS);
        let inverse = self.pose.inverse();
        let mut samples = Vec::with_capacity(fine[0] * fine[1]);
        for y in 0..fine[1] {
            for x in 0..fine[0] {
                let [x, y] = [(x, 0), (y, 1)].map(|(at, axis)| {
                    let jitter = 0.5 + 0.5 * random.next();
                    (at as f64 + jitter) / PARTS as f64 - 0.5 - margin as f64 + low[axis] as f64
                });
                let ray = inverse.rotation * self.camera.unproject(&Vector2::new(x, y)).unwrap();
                let from = inverse.translation.vector;
                let at = from - ray * (from.z / ray.z);
                samples.push(if self.raster.is_dark_at([at.x, at.y]) { 0.0 } else { 1.0 });
            }
        }
        let mut fine = Picture::new(fine[0], fine[1], samples).unwrap();
        let taps = |along: usize| {
            let sigma = light.blur * PARTS as f64;
            let reach = (4.0 * sigma).ceil() as isize;
            let weights: Vec<f64> = (-reach..=reach).map(|at| libm::exp(-0.5 * (at as f64 / sigma).powi(2))).collect();
            let sum: f64 = weights.iter().sum();
            let step = if along == 0 { [1.0, 0.0] } else { [0.0, 1.0] };
            (-reach..=reach)
                .zip(weights)
                .map(|(at, weight)| (step.map(|step| step * at as f64), weight / sum))
                .collect()
        };
        let mut passes: Vec<Vec<([f64; 2], f64)>> = vec![taps(0), taps(1)];
        if light.motion != [0.0; 2] {
            let count = 31;
            let at = |index: usize| (index as f64 + 0.5) / f64::from(count) - 0.5;
            let tap =
                |index: usize| (light.motion.map(|motion| motion * PARTS as f64 * at(index)), 1.0 / f64::from(count));
            passes.push((0..count as usize).map(tap).collect());
        }
        for taps in passes {
            let mut blurred = vec![0.0; fine.values().len()];
            let (width, height) = (fine.width() as isize, fine.height() as isize);
            for ([dx, dy], weight) in taps {
                let (dx, dy) = (dx.round() as isize, dy.round() as isize);
                for y in 0..height {
                    let from = (y + dy).clamp(0, height - 1) * width;
                    for x in 0..width {
                        let value = fine.values()[(from + (x + dx).clamp(0, width - 1)) as usize];
                        blurred[(y * width + x) as usize] += weight as f32 * value;
                    }
                }
            }
            fine = Picture::new(width as usize, height as usize, blurred).unwrap();
        }
        // A point of the blurred picture, between the four samples around the middle of the pixel.
        let value = |index: usize| {
            let [x, y] = [index % size[0], index / size[0]];
            let at = |place: usize| ((place + margin) * PARTS + PARTS / 2) as f32 - 0.5;
            let share = f64::from(fine.bilinear(at(x), at(y)));
            let [x, y] = [(x + low[0]) as f64, (y + low[1]) as f64];
            let from_middle = (x - 172.5).hypot(y - 129.5) / 172.5_f64.hypot(129.5);
            let linear = (0.08 + 0.8 * share) * (1.0 - light.vignetting * from_middle * from_middle);
            255.0 * linear.powf(light.gamma)
        };
        let contrast = 255.0 * 0.8;
        let values = (0..size[0] * size[1]).map(value).collect::<Vec<f64>>();
        let values =
            values.into_iter().map(|value| (value + light.noise * contrast * random.normal()) as f32).collect();
        Part { picture: Picture::new(size[0], size[1], values).unwrap(), position: low }
    }
}

/// Adds noise within ± `amplitude`, the same in every run.
pub fn noisy(picture: &Picture, amplitude: f32) -> Picture {
    let mut state = 12345_u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 8) as f32 / (1 << 23) as f32 - 1.0) * amplitude
    };
    let values = picture.values().iter().map(|value| value + noise()).collect();
    Picture::new(picture.width(), picture.height(), values).unwrap()
}

/// Tags 0 to 23 of the family 36h11, in OpenCV's orientation: 6 × 6 modules, light ones set, row by row from the
/// highest bit.
const CODES: [u64; 24] = [
    0x2_1a14_6bab,
    0x9_2d18_fe9b,
    0x7_0890_14bb,
    0x1_9397_9e27,
    0x4_4153_d3d7,
    0x3_5cd5_b8cf,
    0xa_10ba_56a0,
    0x2_b874_a608,
    0xb_57fb_8d44,
    0x4_e20b_5a64,
    0x6_1d89_7f2c,
    0xa_b346_9ffc,
    0x5_94ca_45c2,
    0xf_a1c2_d2e2,
    0x9_7c24_b972,
    0x7_5928_624a,
    0x1_caaf_e99a,
    0x3_236d_dc16,
    0x8_84e5_27d6,
    0x5_771a_8c7e,
    0xf_5292_5b81,
    0x2_e59c_c1a1,
    0x7_fa58_ab31,
    0xe_b433_84f9,
];

/// A grid of tags of side 1; rows are numbered along y.
#[derive(Clone, Copy)]
pub struct TagGrid {
    pub rows: usize,
    pub columns: usize,
    /// Width of the dark border in modules.
    pub border: usize,
    /// Gap between tags in sides of a tag.
    pub gap: f64,
    pub corner_squares: bool,
    pub first_id: usize,
    /// `true` if y runs upwards on the print, as in Kalibr.
    pub upwards: bool,
}

/// Returns a tag of this id whose top left corner is at (x, y).
pub fn tag(id: usize, border: usize, x: f64, y: f64, length: f64) -> Tag {
    let side = 6 + 2 * border;
    let light = |index: usize| {
        let (row, column) = (index / side, index % side);
        let inside = |place: usize| (border..side - border).contains(&place);
        inside(row) && inside(column) && CODES[id] >> (35 - (row - border) * 6 - (column - border)) & 1 == 1
    };
    let corners = [[x, y], [x + length, y], [x + length, y + length], [x, y + length]];
    Tag { id: id as u16, corners, side, light: (0..side * side).map(light).collect() }
}

/// Returns `true` if this position in a tag's square is dark, in sides from its top left corner.
pub fn is_dark(tag: &Tag, x: f64, y: f64) -> bool {
    let [column, row] = [x, y].map(|place| ((place * tag.side as f64) as usize).min(tag.side - 1));
    !tag.light[row * tag.side + column]
}

impl TagGrid {
    pub fn tags(&self) -> Vec<Tag> {
        let of_place = |place: usize| {
            let [x, y] = [place % self.columns, place / self.columns].map(|step| step as f64 * (1.0 + self.gap));
            let tag = tag(self.first_id + place, self.border, x, y, 1.0);
            let [a, b, c, d] = tag.corners;
            Tag { corners: if self.upwards { [d, c, b, a] } else { tag.corners }, ..tag }
        };
        (0..self.rows * self.columns).map(of_place).collect()
    }

    pub fn middle(&self) -> [f64; 2] {
        [self.columns, self.rows].map(|count| (count as f64 * (1.0 + self.gap) - self.gap) / 2.0)
    }

    pub fn brightness(&self) -> impl Fn(f64, f64) -> f32 {
        let (grid, tags) = (*self, self.tags());
        move |x, y| {
            let period = 1.0 + grid.gap;
            let (column, row) = ((x / period).floor(), (y / period).floor());
            let (dx, dy) = (x - column * period, y - row * period);
            let on_board = |index: f64, count: usize| index >= 0.0 && index < count as f64;
            let dark = if dx < 1.0 && dy < 1.0 {
                on_board(column, grid.columns) && on_board(row, grid.rows) && {
                    let tag = &tags[row as usize * grid.columns + column as usize];
                    is_dark(tag, dx, if grid.upwards { 1.0 - dy } else { dy })
                }
            } else {
                let is_next_to_tag = on_board(column + 1.0, grid.columns + 1) && on_board(row + 1.0, grid.rows + 1);
                grid.corner_squares && is_next_to_tag && dx >= 1.0 && dy >= 1.0
            };
            if dark { 0.1 } else { 0.9 }
        }
    }
}
