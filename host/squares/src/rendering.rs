//! Pictures of boards with a known ground truth, for tests.

use evcal_geometry::board::tag::Tag;
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
