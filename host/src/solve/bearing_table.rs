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
        let position = |index: usize| index as f64 - MARGIN as f64;
        let bearings = (0..size.0 * size.1)
            .into_par_iter()
            .with_min_len(1024)
            .map(|index| {
                let pixel = Vector2::new(position(index % size.0), position(index / size.0));
                camera.unproject(&pixel).map_or([f64::NAN; 3], Into::into)
            })
            .collect();
        let (cell_columns, cell_rows) = (size.0 / CELL, size.1 / CELL);
        let cells = (0..cell_columns * cell_rows)
            .into_par_iter()
            .with_min_len(64)
            .map(|index| {
                let center = |cell: usize| position(CELL * cell) + CELL_CENTER;
                let center = Vector2::new(center(index % cell_columns), center(index / cell_columns));
                Cell::new(camera, center).unwrap_or_default()
            })
            .collect();
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
        let index = |value: f64, length: usize| {
            let shifted = value + (MARGIN as f64 + 0.5);
            // Also false for NaN.
            (shifted >= 0.0 && shifted < length as f64).then_some(shifted as usize)
        };
        let (column, row) = (index(x, self.size.0)?, index(y, self.size.1)?);
        let cell = self.cells.get(row / CELL * self.cell_columns + column / CELL).filter(|cell| cell.is_known)?;
        let position = |index: usize| index as f64 - MARGIN as f64;
        let center = |index: usize| position(index / CELL * CELL) + CELL_CENTER;
        Some(Place {
            pixel_bearing: self.bearings.get(row * self.size.0 + column)?,
            cell,
            beside_pixel: [x - position(column), y - position(row)],
            beside_cell: [x - center(column), y - center(row)],
        })
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

    /// The cell around `center`; `None` where it reaches outside the model's domain.
    fn new(camera: &Camera<f64>, center: Vector2<f64>) -> Option<Self> {
        /// Half the distance of the central differences (px).
        const STEP: f64 = 1.0;
        let at = |x: f64, y: f64| camera.unproject_with_jacobians(&(center + Vector2::new(x, y)));
        let (here, left, right) = (at(0.0, 0.0)?, at(-STEP, 0.0)?, at(STEP, 0.0)?);
        let (above, below) = (at(0.0, -STEP)?, at(0.0, STEP)?);
        let turn = |before: &Unprojection<f64>, after: &Unprojection<f64>, column: usize| -> [f32; 3] {
            std::array::from_fn(|axis| {
                ((after.by_pixel[(axis, column)] - before.by_pixel[(axis, column)]) / (2.0 * STEP)) as f32
            })
        };
        let (by_left, by_right) = (by_coefficient(&left)?, by_coefficient(&right)?);
        let (by_above, by_below) = (by_coefficient(&above)?, by_coefficient(&below)?);
        let slope = |before: &ByCoefficient, after: &ByCoefficient| -> ByCoefficient {
            std::array::from_fn(|row| {
                std::array::from_fn(|index| (after[row][index] - before[row][index]) / (2.0 * STEP as f32))
            })
        };
        Some(Self {
            slopes: BearingSlopes {
                by_pixel: std::array::from_fn(|column| {
                    std::array::from_fn(|axis| here.by_pixel[(axis, column)] as f32)
                }),
                by_pixel_twice: [turn(&left, &right, 0), turn(&left, &right, 1), turn(&above, &below, 1)],
            },
            is_known: true,
            by_coefficient: by_coefficient(&here)?,
            by_coefficient_slope: [slope(&by_left, &by_right), slope(&by_above, &by_below)],
        })
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
