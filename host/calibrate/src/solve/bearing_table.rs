//! Bearings of all pixels and their derivatives, computed once for each set of intrinsics.
//!
//! The bearings are those of every pixel; their derivatives change slowly and are kept for cells of
//! 4 × 4 pixels, with their slopes: the table is read at random, so that its size is time.

use evcal_core::camera::{Camera, MAX_COEFFICIENTS, Unprojection};
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;
use rayon::prelude::*;

/// A row for x and one for y: derivatives of the pixel of a fixed bearing by the coefficients.
type ByCoefficient = [[f32; MAX_COEFFICIENTS]; 2];

/// Derivatives at the centre of a cell, and how they change over it. It begins with a cache line, for cells are read at random.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub struct Cell {
    /// How the bearing changes over the cell.
    pub slopes: BearingSlopes,
    /// Whether all of it is in the model's domain.
    is_known: bool,
    /// Derivative of the pixel of a fixed bearing by each coefficient of the camera model.
    by_coefficient: ByCoefficient,
    /// Slope of `by_coefficient` along pixel x and pixel y.
    by_coefficient_slope: [ByCoefficient; 2],
}

/// How a bearing changes about the centre of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct BearingSlopes {
    /// Derivative of the bearing by pixel x and pixel y.
    pub by_pixel: [[f32; 3]; 2],
    /// Second derivatives of the bearing by pixel: xx, xy, yy.
    pub by_pixel_twice: [[f32; 3]; 3],
}

/// What of the camera and the sensor counts at every place of the image.
#[derive(Clone, Copy, Debug)]
pub struct ImagePlane {
    inverse_focal_length: [f64; 2],
    principal_point: [f64; 2],
    middle: [f64; 2],
    inverse_corner: f64,
}

impl ImagePlane {
    /// Distance from the principal point in focal lengths: derivative of the pixel by fx and fy.
    #[inline(always)]
    pub fn by_focal_length(&self, pixel: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| (pixel[axis] - self.principal_point[axis]) * self.inverse_focal_length[axis])
    }

    /// Squared distance from the middle of the sensor, 1 at its corners.
    #[inline(always)]
    pub fn corner_share(&self, pixel: [f64; 2]) -> f64 {
        let [x, y] = [pixel[0] - self.middle[0], pixel[1] - self.middle[1]];
        (x * x + y * y) * self.inverse_corner
    }
}

/// Bearings of a whole sensor and of a margin around it: the edge that an event on the rim of the
/// sensor belongs to may lie just outside.
pub struct BearingTable {
    size: (usize, usize),
    cell_columns: usize,
    plane: ImagePlane,
    /// Unit vectors in the camera frame; not numbers outside the model's domain.
    bearings: Vec<[f64; 3]>,
    cells: Vec<Cell>,
}

/// Column and row of a pixel in a table.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    column: u32,
    row: u32,
}

/// A place on the image.
#[derive(Clone, Copy, Debug)]
pub struct Place<'a> {
    /// Bearing of the nearest pixel.
    pub pixel_bearing: &'a [f64; 3],
    /// The cell around that pixel.
    pub cell: &'a Cell,
    /// Where the place lies from the nearest pixel, in pixels.
    pub beside_pixel: [f64; 2],
    /// Where the place lies from the centre of the cell, in pixels.
    pub beside_cell: [f64; 2],
}

/// Pixels beyond the sensor on each side.
const MARGIN: usize = 8;
/// Pixels along the side of a cell.
const CELL: usize = 4;
/// From the first pixel of a cell to its centre.
const CELL_CENTER: f64 = 0.5 * (CELL as f64 - 1.0);
/// fx, fy, cx, cy.
const LINEAR_PARAMETERS: usize = 4;

impl Place<'_> {
    /// The bearing, to second order, and its derivative by pixel x and y.
    #[inline(always)]
    pub fn bearing(&self) -> ([f64; 3], [[f64; 3]; 2]) {
        self.cell.slopes.bearing(*self.pixel_bearing, self.beside_pixel, self.beside_cell)
    }
}

impl BearingSlopes {
    /// The bearing, to second order, and its derivative by pixel x and y, `beside_pixel` from the pixel of `bearing` and
    /// `beside_cell` from the centre of the cell.
    #[inline(always)]
    pub fn bearing(
        &self,
        mut bearing: [f64; 3],
        beside_pixel: [f64; 2],
        beside_cell: [f64; 2],
    ) -> ([f64; 3], [[f64; 3]; 2]) {
        let [x, y] = beside_pixel;
        // The derivative half-way to the pixel makes the step exact to second order.
        let [half_x, half_y] = [beside_cell[0] - 0.5 * x, beside_cell[1] - 0.5 * y];
        let mut by_pixel = [[0.0; 3]; 2];
        for axis in 0..3 {
            let (by_x, by_y) = (f64::from(self.by_pixel[0][axis]), f64::from(self.by_pixel[1][axis]));
            let [xx, xy, yy] = &self.by_pixel_twice;
            let (xx, xy, yy) = (f64::from(xx[axis]), f64::from(xy[axis]), f64::from(yy[axis]));
            bearing[axis] += x * (by_x + half_x * xx + half_y * xy) + y * (by_y + half_x * xy + half_y * yy);
            by_pixel[0][axis] = by_x + beside_cell[0] * xx + beside_cell[1] * xy;
            by_pixel[1][axis] = by_y + beside_cell[0] * xy + beside_cell[1] * yy;
        }
        (bearing, by_pixel)
    }
}

impl BearingTable {
    /// Unprojects every pixel of a sensor of (width, height) pixels. The first parameters of all camera
    /// models are fx, fy, cx, cy, and act last: pixel = f · y + c with y of the bearing and the
    /// coefficients alone.
    pub fn new(camera: &Camera<f64>, sensor: Sensor) -> Self {
        let extent = |length: u16| (usize::from(length) + 2 * MARGIN).next_multiple_of(CELL);
        let size = (extent(sensor.width), extent(sensor.height));
        let middle = [f64::from(sensor.width) / 2.0 - 0.5, f64::from(sensor.height) / 2.0 - 0.5];
        let (cell_columns, cell_rows) = (size.0 / CELL, size.1 / CELL);
        let bearings = bearings(camera, size.0, size.1);
        let cells = cells(camera, cell_columns, cell_rows);
        let parameters = camera.parameters();
        let parameter = |index: usize| parameters.get(index).copied().unwrap_or(1.0);
        let plane = ImagePlane {
            inverse_focal_length: [1.0 / parameter(0), 1.0 / parameter(1)],
            principal_point: [parameter(2), parameter(3)],
            middle,
            inverse_corner: 1.0 / (middle[0] * middle[0] + middle[1] * middle[1]),
        };
        Self { size, cell_columns, plane, bearings, cells }
    }

    /// What counts at every place of the image.
    pub fn plane(&self) -> &ImagePlane {
        &self.plane
    }

    /// The place (x, y) in pixels; `None` far outside the sensor or outside the camera model's domain.
    #[inline(always)]
    pub fn place(&self, x: f64, y: f64) -> Option<Place<'_>> {
        self.place_at(self.spot(x, y)?, x, y)
    }

    /// Where the table has the place (x, y) in pixels; `None` far outside the sensor.
    #[inline(always)]
    pub fn spot(&self, x: f64, y: f64) -> Option<Spot> {
        let index = |value: f64, length: usize| {
            let shifted = value + (MARGIN as f64 + 0.5);
            // Also false for NaN.
            (shifted >= 0.0 && shifted < length as f64).then_some(shifted as u32)
        };
        Some(Spot { column: index(x, self.size.0)?, row: index(y, self.size.1)? })
    }

    /// Reads all that [`BearingTable::place_at`] refers to, so that it is in the cache afterwards. The number has no meaning.
    #[inline(always)]
    pub fn touch(&self, spot: Spot) -> f64 {
        let (bearing, cell) = self.at(spot);
        let [first, .., last] = bearing.copied().unwrap_or_default();
        let of_cell = cell.map_or(0.0, |cell| {
            let [x, y] = &cell.by_coefficient_slope;
            cell.slopes.by_pixel[0][0] + cell.by_coefficient[1][0] + x[1][0] + y[1][0]
        });
        first + last + f64::from(of_cell)
    }

    /// The place (x, y) in pixels, which is at `spot`; `None` outside the camera model's domain.
    #[inline(always)]
    pub fn place_at(&self, spot: Spot, x: f64, y: f64) -> Option<Place<'_>> {
        let (bearing, cell) = self.at(spot);
        let Spot { column, row } = spot;
        let center = |index: u32| position(index as usize / CELL * CELL) + CELL_CENTER;
        Some(Place {
            pixel_bearing: bearing?,
            cell: cell.filter(|cell| cell.is_known)?,
            beside_pixel: [x - position(column as usize), y - position(row as usize)],
            beside_cell: [x - center(column), y - center(row)],
        })
    }

    #[inline(always)]
    fn at(&self, Spot { column, row }: Spot) -> (Option<&[f64; 3]>, Option<&Cell>) {
        let (column, row) = (column as usize, row as usize);
        (self.bearings.get(row * self.size.0 + column), self.cells.get(row / CELL * self.cell_columns + column / CELL))
    }
}

/// From the index of a column or row of the table to its pixel coordinate.
#[inline(always)]
fn position(index: usize) -> f64 {
    index as f64 - MARGIN as f64
}

/// Nodes between which a bearing is interpolated, in each direction.
const NODES: usize = 4;

/// Unit vectors of all pixels of a table of `width` × `height`. One of sixteen is computed, the others are interpolated (error below a
/// hundred-thousandth of a pixel); at the border of the model's domain all are computed.
fn bearings(camera: &Camera<f64>, width: usize, height: usize) -> Vec<[f64; 3]> {
    let exact = |x: f64, y: f64| camera.unproject(&Vector2::new(x, y)).map_or([f64::NAN; 3], Into::into);
    // From one before the first pixel to two beyond the last.
    let (columns, rows) = (width / CELL + NODES - 1, height / CELL + NODES - 1);
    let node = |index: usize| (CELL * index) as f64 - (CELL + MARGIN) as f64;
    let nodes: Vec<[f64; 3]> = (0..columns * rows)
        .into_par_iter()
        .with_min_len(256)
        .map(|index| exact(node(index % columns), node(index / columns)))
        .collect();
    let weights: [[f64; NODES]; CELL] = std::array::from_fn(|step| cubic_weights(step as f64 / CELL as f64));
    let between = |step: usize, nodes: [[f64; 3]; NODES]| -> [f64; 3] {
        let weights = &weights[step];
        std::array::from_fn(|axis| nodes.iter().zip(weights).map(|(node, weight)| weight * node[axis]).sum())
    };
    let of_row = |row: usize| {
        let at_height = |column: usize| {
            let nodes = std::array::from_fn(|index| nodes[(row / CELL + index) * columns + column]);
            between(row % CELL, nodes)
        };
        let line: Vec<[f64; 3]> = (0..columns).map(at_height).collect();
        let pixel = move |column: usize| {
            let found = between(column % CELL, std::array::from_fn(|index| line[column / CELL + index]));
            if found[0].is_nan() { exact(position(column), position(row)) } else { found }
        };
        (0..width).map(pixel).collect::<Vec<_>>()
    };
    (0..height).into_par_iter().flat_map_iter(of_row).collect()
}

/// Lagrange's weights of the values at −1, 0, 1 and 2 for the one at `t`, between 0 and 1.
fn cubic_weights(t: f64) -> [f64; NODES] {
    let (before, after, last) = (t + 1.0, t - 1.0, t - 2.0);
    [-t * after * last / 6.0, before * after * last / 2.0, -before * t * last / 2.0, before * t * after / 6.0]
}

/// The cells of a table of `columns` × `rows` cells.
fn cells(camera: &Camera<f64>, columns: usize, rows: usize) -> Vec<Cell> {
    let center = |column: usize, row: usize| {
        Vector2::new(position(CELL * column) + CELL_CENTER, position(CELL * row) + CELL_CENTER)
    };
    let centers: Vec<Option<Slopes>> = (0..columns * rows)
        .into_par_iter()
        .with_min_len(64)
        .map(|index| Slopes::new(camera, center(index % columns, index / columns)))
        .collect();
    let at = |column: usize, row: usize| {
        let is_inside = column < columns && row < rows;
        centers.get(row * columns + column).filter(|_| is_inside)?.as_ref()
    };
    let cell = |column: usize, row: usize| {
        let here = at(column, row)?;
        let neighbours = || {
            let (left, above) = (at(column.checked_sub(1)?, row)?, at(column, row.checked_sub(1)?)?);
            Some(Cell::new(here, [left, at(column + 1, row)?], [above, at(column, row + 1)?], CELL as f64))
        };
        // At the border of the table or of the model's domain one is missing.
        neighbours().or_else(|| {
            let beside = |x: f64, y: f64| Slopes::new(camera, center(column, row) + Vector2::new(x, y));
            let (left, right) = (beside(-1.0, 0.0)?, beside(1.0, 0.0)?);
            let (above, below) = (beside(0.0, -1.0)?, beside(0.0, 1.0)?);
            Some(Cell::new(here, [&left, &right], [&above, &below], 1.0))
        })
    };
    (0..columns * rows)
        .into_par_iter()
        .with_min_len(64)
        .map(|index| cell(index % columns, index / columns).unwrap_or_default())
        .collect()
}

/// Derivatives at one place.
struct Slopes {
    by_pixel: [[f64; 3]; 2],
    by_coefficient: ByCoefficient,
}

impl Slopes {
    fn new(camera: &Camera<f64>, pixel: Vector2<f64>) -> Option<Self> {
        let unprojection = camera.unproject_with_jacobians(&pixel)?;
        let by_pixel = std::array::from_fn(|column| std::array::from_fn(|axis| unprojection.by_pixel[(axis, column)]));
        Some(Self { by_pixel, by_coefficient: by_coefficient(&unprojection)? })
    }
}

impl Cell {
    /// Derivative of a distance on the image by the coefficients, `beside` the centre of the cell, where `gradient` is its
    /// derivative by the pixel of a fixed bearing.
    #[inline(always)]
    pub fn by_coefficients(&self, beside: [f32; 2], gradient: [f32; 2]) -> [f32; MAX_COEFFICIENTS] {
        let [slope_x, slope_y] = &self.by_coefficient_slope;
        let mut coefficients = [0.0; MAX_COEFFICIENTS];
        for (index, coefficient) in coefficients.iter_mut().enumerate() {
            let at = |row: usize| {
                self.by_coefficient[row][index] + beside[0] * slope_x[row][index] + beside[1] * slope_y[row][index]
            };
            *coefficient = gradient[0] * at(0) + gradient[1] * at(1);
        }
        coefficients
    }

    /// The cell around `here`, from what is `distance` pixels left and right, above and below.
    fn new(here: &Slopes, [left, right]: [&Slopes; 2], [above, below]: [&Slopes; 2], distance: f64) -> Self {
        let turn = |before: &Slopes, after: &Slopes, column: usize| -> [f32; 3] {
            std::array::from_fn(|axis| {
                ((after.by_pixel[column][axis] - before.by_pixel[column][axis]) / (2.0 * distance)) as f32
            })
        };
        let slope = |before: &Slopes, after: &Slopes| -> ByCoefficient {
            std::array::from_fn(|row| {
                std::array::from_fn(|index| {
                    (after.by_coefficient[row][index] - before.by_coefficient[row][index]) / (2.0 * distance as f32)
                })
            })
        };
        Self {
            slopes: BearingSlopes {
                by_pixel: here.by_pixel.map(|column| column.map(|value| value as f32)),
                by_pixel_twice: [turn(left, right, 0), turn(left, right, 1), turn(above, below, 1)],
            },
            is_known: true,
            by_coefficient: here.by_coefficient,
            by_coefficient_slope: [slope(left, right), slope(above, below)],
        }
    }
}

/// A bearing that stays while the parameters move is seen by another pixel:
/// ∂b/∂k + ∂b/∂pixel · ∂pixel/∂k = 0.
fn by_coefficient(unprojection: &Unprojection<f64>) -> Option<ByCoefficient> {
    let by_pixel = unprojection.by_pixel;
    let normal = (by_pixel.transpose() * by_pixel).try_inverse()?;
    let by_parameter = -normal * by_pixel.transpose() * unprojection.by_parameters;
    Some(std::array::from_fn(|row| std::array::from_fn(|index| by_parameter[(row, LINEAR_PARAMETERS + index)] as f32)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_core::camera::ModelKind;

    #[test]
    fn places_between_pixels_have_the_bearing_and_the_derivatives_of_the_camera() {
        let cameras = [
            (ModelKind::Radtan, vec![331.6, 331.1, 176.9, 134.2, -0.352, 0.149, -0.0004, 0.0005, -0.03]),
            (ModelKind::KannalaBrandt, vec![190.0, 191.0, 170.0, 131.0, -0.02, 0.01, -0.004, 0.0007]),
        ];
        for (kind, parameters) in cameras {
            let camera = Camera::from_parameters(kind, &parameters).unwrap();
            let table = BearingTable::new(&camera, Sensor::new(346, 260));
            for step in 0..500 {
                let (x, y) = (-2.0 + 350.0 * f64::from(step % 23) / 22.3, -2.0 + 264.0 * f64::from(step % 37) / 36.7);
                let place = table.place(x, y).unwrap();
                let exact = camera.unproject_with_jacobians(&Vector2::new(x, y)).unwrap();
                let (bearing, by_pixel) = place.bearing();
                for axis in 0..3 {
                    // A ten-thousandth of a pixel.
                    assert!((bearing[axis] - exact.bearing[axis]).abs() < 3e-7, "{kind} {x} {y}");
                    for (column, derivative) in by_pixel.iter().enumerate() {
                        assert!((derivative[axis] - exact.by_pixel[(axis, column)]).abs() < 3e-6);
                    }
                }
                let projected = camera.project_with_jacobians(&exact.bearing).unwrap();
                for row in 0..2 {
                    let mut gradient = [0.0_f64; 2];
                    gradient[row] = 1.0;
                    let by_focal_length = table.plane().by_focal_length([x, y]);
                    let linear = [0, 1].map(|axis| gradient[axis] * by_focal_length[axis]);
                    let coefficients = place.cell.by_coefficients(
                        place.beside_cell.map(|value| value as f32),
                        gradient.map(|value| value as f32),
                    );
                    let linear = linear.into_iter().chain(gradient);
                    let found = linear.chain(coefficients.map(f64::from)).enumerate().take(parameters.len());
                    for (parameter, value) in found {
                        let exact = projected.by_parameters[(row, parameter)];
                        // Second order in the distance from the cell's centre: f (2 px / f)².
                        assert!(
                            (value - exact).abs() < 0.06 + 1e-2 * exact.abs(),
                            "{kind} {parameter}: {value} {exact}"
                        );
                    }
                }
            }
            assert!(table.place(-20.0, 10.0).is_none() && table.place(10.0, 300.0).is_none());
            assert!(table.place(f64::NAN, 10.0).is_none() && table.place(f64::INFINITY, 10.0).is_none());
        }
    }
}
