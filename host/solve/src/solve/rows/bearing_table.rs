//! Bearings of all image positions and their derivatives, computed once for each set of intrinsics.
//!
//! Bearings are stored to second order for cells of 4 × 4 pixels, derivatives by the coefficients of the camera model for cells
//! of 12 × 12. The table is read in random order, so its size determines the time of a look-up.

use evcal_core::camera::{Camera, MAX_COEFFICIENTS, Unprojection};
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;
use rayon::prelude::*;

/// Derivatives of the pixel of a fixed bearing by the coefficients: one row for x and one for y.
type ByCoefficient = [[f32; MAX_COEFFICIENTS]; 2];

/// The bearing at the centre of a cell, and its derivatives. A cell takes one and a half cache lines and never spans three.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
struct Cell {
    /// Unit vector in the camera frame; NaN outside the model's domain.
    center: [f64; 3],
    slopes: BearingSlopes,
}

/// Derivative of the pixel of a fixed bearing by each coefficient of the camera model, to second order about the centre
/// of a large cell: the derivative there, its slopes along pixel x and y, and its second derivatives xx, xy and yy.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct CoefficientCell([ByCoefficient; 6]);

/// Derivatives of the bearing at the centre of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct BearingSlopes {
    /// Derivative of the bearing by pixel x and pixel y.
    pub by_pixel: [[f32; 3]; 2],
    /// Second derivatives of the bearing by pixel: xx, xy, yy.
    pub by_pixel_twice: [[f32; 3]; 3],
}

/// Constants of the camera and the sensor that every image position needs.
#[derive(Clone, Copy, Debug)]
pub struct ImagePlane {
    inverse_focal_length: [f64; 2],
    principal_point: [f64; 2],
    middle: [f64; 2],
    inverse_corner: f64,
}

impl ImagePlane {
    /// Returns the distance from the principal point in focal lengths, which is the derivative of the pixel by fx and fy.
    #[inline(always)]
    pub fn by_focal_length(&self, pixel: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| (pixel[axis] - self.principal_point[axis]) * self.inverse_focal_length[axis])
    }

    /// Returns the squared distance from the middle of the sensor; 1 at its corners.
    #[inline(always)]
    pub fn corner_share(&self, pixel: [f64; 2]) -> f64 {
        let [x, y] = [pixel[0] - self.middle[0], pixel[1] - self.middle[1]];
        (x * x + y * y) * self.inverse_corner
    }
}

/// Bearings of a whole sensor and of a margin around it. The margin is needed because an event at the border of the sensor may
/// belong to an edge just outside it.
pub struct BearingTable {
    size: (usize, usize),
    cell_columns: usize,
    plane: ImagePlane,
    cells: Vec<Cell>,
    coefficient_cells: Vec<CoefficientCell>,
}

/// Column and row of a pixel in a table.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    column: u32,
    row: u32,
}

/// A position on the image, with the bearing data of its cell.
#[derive(Clone, Copy, Debug)]
pub struct Place<'a> {
    /// Bearing at the centre of its cell.
    pub center: &'a [f64; 3],
    /// Derivatives of the bearing there.
    pub slopes: &'a BearingSlopes,
    /// Position relative to that centre, in pixels.
    pub offset: [f64; 2],
}

/// Cell in which the derivatives by the coefficients are expanded.
#[derive(Clone, Copy, Debug)]
pub struct CoefficientPlace<'a> {
    /// The large cell.
    pub cell: &'a CoefficientCell,
    /// Vector from its centre to the centre of the bearing's cell (px).
    pub to_cell: [f32; 2],
}

/// Pixels beyond the sensor on each side.
const MARGIN: usize = 8;
/// Pixels along the side of a cell.
const CELL: usize = 4;
/// Distance from the first pixel of a cell to its centre (px).
const CELL_CENTER: f64 = 0.5 * (CELL as f64 - 1.0);
/// Within a cell, x³ / 6 is approximated by a multiple of x, and x² y / 2 by a multiple of y. These factors minimise the largest
/// remainder in the cell (Chebyshev); for y, x² has its mean value.
const ALONG: f64 = (CELL * CELL) as f64 / 32.0;
const ACROSS: f64 = (CELL * CELL) as f64 / 24.0;
/// Cells along the side of a large cell.
const CELLS: usize = 3;
/// Number of linear parameters: fx, fy, cx, cy.
const LINEAR_PARAMETERS: usize = 4;

impl Place<'_> {
    /// Returns the bearing to second order, and its derivative by pixel x and y.
    #[inline(always)]
    pub fn bearing(&self) -> ([f64; 3], [[f64; 3]; 2]) {
        self.slopes.bearing(*self.center, self.offset)
    }
}

impl BearingSlopes {
    /// Returns the bearing to second order and its derivative by pixel x and y, at the `offset` (pixels) from the centre
    /// of the cell, where the bearing is `center`.
    #[inline(always)]
    pub fn bearing(&self, center: [f64; 3], offset: [f64; 2]) -> ([f64; 3], [[f64; 3]; 2]) {
        let [x, y] = offset;
        let (mut bearing, mut by_pixel) = (center, [[0.0; 3]; 2]);
        for axis in 0..3 {
            let (by_x, by_y) = (f64::from(self.by_pixel[0][axis]), f64::from(self.by_pixel[1][axis]));
            let [xx, xy, yy] = &self.by_pixel_twice;
            let (xx, xy, yy) = (f64::from(xx[axis]), f64::from(xy[axis]), f64::from(yy[axis]));
            let (turn_x, turn_y) = (x * xx + y * xy, x * xy + y * yy);
            bearing[axis] += x * (by_x + 0.5 * turn_x) + y * (by_y + 0.5 * turn_y);
            by_pixel[0][axis] = by_x + turn_x;
            by_pixel[1][axis] = by_y + turn_y;
        }
        (bearing, by_pixel)
    }
}

impl BearingTable {
    /// Unprojects the centres of all cells of a sensor. The first parameters of all camera models are fx, fy, cx and cy, and they
    /// are applied last: pixel = f · y + c, where y depends only on the bearing and the coefficients.
    pub fn new(camera: &Camera<f64>, sensor: Sensor) -> Self {
        let extent = |length: u16| (usize::from(length) + 2 * MARGIN).next_multiple_of(CELLS * CELL);
        let size = (extent(sensor.width), extent(sensor.height));
        let middle = [f64::from(sensor.width) / 2.0 - 0.5, f64::from(sensor.height) / 2.0 - 0.5];
        let (cell_columns, cell_rows) = (size.0 / CELL, size.1 / CELL);
        let (cells, coefficient_cells) = cells(camera, cell_columns, cell_rows);
        let parameters = camera.parameters();
        let parameter = |index: usize| parameters.get(index).copied().unwrap_or(1.0);
        let plane = ImagePlane {
            inverse_focal_length: [1.0 / parameter(0), 1.0 / parameter(1)],
            principal_point: [parameter(2), parameter(3)],
            middle,
            inverse_corner: 1.0 / (middle[0] * middle[0] + middle[1] * middle[1]),
        };
        Self { size, cell_columns, plane, cells, coefficient_cells }
    }

    /// Returns the constants that every image position needs.
    pub fn plane(&self) -> &ImagePlane {
        &self.plane
    }

    /// Returns the position (x, y) in pixels; `None` far outside the sensor or outside the camera model's domain.
    #[inline(always)]
    pub fn place(&self, x: f64, y: f64) -> Option<Place<'_>> {
        self.place_at(self.spot(x, y)?, x, y)
    }

    /// Returns the table's column and row for the position (x, y) in pixels; `None` far outside the sensor.
    #[inline(always)]
    pub fn spot(&self, x: f64, y: f64) -> Option<Spot> {
        let index = |value: f64, length: usize| {
            let shifted = value + (MARGIN as f64 + 0.5);
            // Also false for NaN.
            (shifted >= 0.0 && shifted < length as f64).then_some(shifted as u32)
        };
        Some(Spot { column: index(x, self.size.0)?, row: index(y, self.size.1)? })
    }

    /// Reads everything that [`BearingTable::place_at`] refers to, to bring it into the cache. The returned number has no
    /// meaning.
    #[inline(always)]
    pub fn touch(&self, spot: Spot) -> f64 {
        self.cell(spot).map_or(0.0, |cell| cell.center[0] + f64::from(cell.slopes.by_pixel_twice[2][2]))
    }

    /// Does the same for [`BearingTable::coefficients`].
    #[inline(always)]
    pub fn touch_coefficients(&self, spot: Spot) -> f64 {
        let place = self.coefficients(spot);
        place.map_or(0.0, |place| place.cell.0.iter().map(|by_coefficient| f64::from(by_coefficient[0][0])).sum())
    }

    /// Returns the position (x, y) in pixels, whose column and row are `spot`; `None` outside the camera model's domain.
    #[inline(always)]
    pub fn place_at(&self, spot: Spot, x: f64, y: f64) -> Option<Place<'_>> {
        let Cell { center, slopes } = self.cell(spot)?;
        let middle = |index: u32| position(index as usize / CELL * CELL) + CELL_CENTER;
        let offset = [x - middle(spot.column), y - middle(spot.row)];
        (!center[0].is_nan()).then_some(Place { center, slopes, offset })
    }

    /// Returns the cell in which the derivatives by the coefficients at `spot` are expanded.
    #[inline(always)]
    pub fn coefficients(&self, Spot { column, row }: Spot) -> Option<CoefficientPlace<'_>> {
        let (column, row) = (column as usize / CELL, row as usize / CELL);
        let index = row / CELLS * (self.cell_columns / CELLS) + column / CELLS;
        let to_cell = [column, row].map(to_cell);
        Some(CoefficientPlace { cell: self.coefficient_cells.get(index)?, to_cell })
    }

    #[inline(always)]
    fn cell(&self, Spot { column, row }: Spot) -> Option<&Cell> {
        self.cells.get(row as usize / CELL * self.cell_columns + column as usize / CELL)
    }
}

/// Returns the offset (px) from the centre of a large cell to the centre of its small cell with this column or row.
#[inline(always)]
fn to_cell(index: usize) -> f32 {
    CELL as f32 * ((index % CELLS) as f32 - 0.5 * (CELLS as f32 - 1.0))
}

/// Converts the index of a column or row of the table to its pixel coordinate.
#[inline(always)]
fn position(index: usize) -> f64 {
    index as f64 - MARGIN as f64
}

/// Returns the cells of a table of `columns` × `rows` cells, and the large cells.
fn cells(camera: &Camera<f64>, columns: usize, rows: usize) -> (Vec<Cell>, Vec<CoefficientCell>) {
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
    // Slopes one pixel left and right of a centre, and above and below it.
    let around = |column: usize, row: usize| {
        let slopes_at = |x: f64, y: f64| Slopes::new(camera, center(column, row) + Vector2::new(x, y));
        Some([[slopes_at(-1.0, 0.0)?, slopes_at(1.0, 0.0)?], [slopes_at(0.0, -1.0)?, slopes_at(0.0, 1.0)?]])
    };
    let cell = |column: usize, row: usize| {
        let here = at(column, row)?;
        let neighbours = || {
            let (left, above) = (at(column.checked_sub(1)?, row)?, at(column, row.checked_sub(1)?)?);
            Some(Cell::new(here, [left, at(column + 1, row)?], [above, at(column, row + 1)?], CELL as f64))
        };
        // At the border of the table or of the model's domain a neighbour is missing.
        neighbours().or_else(|| {
            let [[left, right], [above, below]] = around(column, row)?;
            Some(Cell::new(here, [&left, &right], [&above, &below], 1.0))
        })
    };
    let coefficient_cell = |column: usize, row: usize| {
        let whole = || {
            let places = (0..CELLS * CELLS).map(|index| at(column + index % CELLS, row + index / CELLS));
            let nine: Vec<&Slopes> = places.collect::<Option<_>>()?;
            Some(CoefficientCell::between(nine.try_into().ok()?))
        };
        // At the border of the model's domain: expand about a centre that is inside it.
        whole().or_else(|| {
            let places = (0..CELLS * CELLS).map(|index| (column + index % CELLS, row + index / CELLS));
            let (column, row, here) = places.clone().find_map(|(column, row)| Some((column, row, at(column, row)?)))?;
            let [pair_x, pair_y] = around(column, row)?;
            Some(CoefficientCell::about(here, &pair_x, &pair_y, [to_cell(column), to_cell(row)]))
        })
    };
    let large_columns = columns / CELLS;
    let found_cells = (0..columns * rows)
        .into_par_iter()
        .with_min_len(64)
        .map(|index| cell(index % columns, index / columns).unwrap_or(Cell::OUTSIDE))
        .collect();
    let coefficient_cells = (0..large_columns * (rows / CELLS))
        .into_par_iter()
        .with_min_len(64)
        .map(|index| coefficient_cell(CELLS * (index % large_columns), CELLS * (index / large_columns)))
        .map(Option::unwrap_or_default)
        .collect();
    (found_cells, coefficient_cells)
}

/// Bearing and derivatives at one position.
struct Slopes {
    bearing: [f64; 3],
    by_pixel: [[f64; 3]; 2],
    by_coefficient: ByCoefficient,
}

impl Slopes {
    fn new(camera: &Camera<f64>, pixel: Vector2<f64>) -> Option<Self> {
        let unprojection = camera.unproject_with_jacobians(&pixel)?;
        let by_pixel = std::array::from_fn(|column| std::array::from_fn(|axis| unprojection.by_pixel[(axis, column)]));
        let by_coefficient = by_coefficient(&unprojection)?;
        Some(Self { bearing: unprojection.bearing.into(), by_pixel, by_coefficient })
    }
}

impl Cell {
    const OUTSIDE: Self = Self {
        center: [f64::NAN; 3],
        slopes: BearingSlopes { by_pixel: [[0.0; 3]; 2], by_pixel_twice: [[0.0; 3]; 3] },
    };

    /// Returns the cell around `here`, from the slopes at `distance` pixels left and right, above and below.
    fn new(here: &Slopes, [left, right]: [&Slopes; 2], [above, below]: [&Slopes; 2], distance: f64) -> Self {
        let turn = |before: &Slopes, after: &Slopes, column: usize| -> [f32; 3] {
            std::array::from_fn(|axis| {
                ((after.by_pixel[column][axis] - before.by_pixel[column][axis]) / (2.0 * distance)) as f32
            })
        };
        // The slope that approximates the bearing best all over the cell, including the terms beyond second order.
        let slope = |column: usize, along: [&Slopes; 2], across: [&Slopes; 2]| -> [f32; 3] {
            std::array::from_fn(|axis| {
                let at = |slopes: &Slopes| slopes.by_pixel[column][axis];
                let bend =
                    |[before, after]: [&Slopes; 2]| (at(before) - 2.0 * at(here) + at(after)) / (distance * distance);
                (at(here) + ALONG * bend(along) + ACROSS * bend(across)) as f32
            })
        };
        Self {
            center: here.bearing,
            slopes: BearingSlopes {
                by_pixel: [slope(0, [left, right], [above, below]), slope(1, [above, below], [left, right])],
                by_pixel_twice: [turn(left, right, 0), turn(left, right, 1), turn(above, below, 1)],
            },
        }
    }
}

impl CoefficientCell {
    /// Returns the large cell whose nine cells have these centres, row by row.
    fn between(centers: [&Slopes; CELLS * CELLS]) -> Self {
        let sum = |weights: [f32; CELLS * CELLS], distance: f32| {
            combined(|row, index| {
                let values = centers.iter().zip(weights);
                values.map(|(center, weight)| weight * center.by_coefficient[row][index]).sum::<f32>() / distance
            })
        };
        let (once, twice) = (2.0 * CELL as f32, (CELL * CELL) as f32);
        Self([
            sum([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 1.0),
            sum([0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0], once),
            sum([0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], once),
            sum([0.0, 0.0, 0.0, 1.0, -2.0, 1.0, 0.0, 0.0, 0.0], twice),
            sum([1.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0], 4.0 * twice),
            sum([0.0, 1.0, 0.0, 0.0, -2.0, 0.0, 0.0, 1.0, 0.0], twice),
        ])
    }

    /// Returns the large cell to first order, from the slopes at `here` (at the `offset` from its centre), one pixel left
    /// and right of it, and one pixel above and below it.
    fn about(here: &Slopes, pair_x: &[Slopes; 2], pair_y: &[Slopes; 2], offset: [f32; 2]) -> Self {
        let [x, y] = [pair_x, pair_y].map(|[before, after]| {
            combined(|row, index| 0.5 * (after.by_coefficient[row][index] - before.by_coefficient[row][index]))
        });
        let center = combined(|row, index| {
            here.by_coefficient[row][index] - offset[0] * x[row][index] - offset[1] * y[row][index]
        });
        let [xx, xy, yy] = [ByCoefficient::default(); 3];
        Self([center, x, y, xx, xy, yy])
    }
}

/// Builds a table with `value` for each row and coefficient.
fn combined(value: impl Fn(usize, usize) -> f32) -> ByCoefficient {
    std::array::from_fn(|row| std::array::from_fn(|index| value(row, index)))
}

impl CoefficientPlace<'_> {
    /// Returns the derivative of a distance on the image by the coefficients, at the `offset` from the centre of the
    /// bearing's cell. `gradient` is the derivative of the distance by the pixel of a fixed bearing.
    #[inline(always)]
    pub fn by_coefficients(&self, offset: [f32; 2], gradient: [f32; 2]) -> [f32; MAX_COEFFICIENTS] {
        let [x, y] = [offset[0] + self.to_cell[0], offset[1] + self.to_cell[1]];
        let weights = [1.0, x, y, 0.5 * x * x, x * y, 0.5 * y * y];
        let mut coefficients = [0.0; MAX_COEFFICIENTS];
        for (row, gradient) in gradient.into_iter().enumerate() {
            for (by_coefficient, weight) in self.cell.0.iter().zip(weights) {
                let weight = gradient * weight;
                for (coefficient, value) in coefficients.iter_mut().zip(by_coefficient[row]) {
                    *coefficient += weight * value;
                }
            }
        }
        coefficients
    }
}

/// Computes the derivative of the pixel by the coefficients for a fixed bearing, from ∂b/∂k + ∂b/∂pixel · ∂pixel/∂k = 0.
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
    fn positions_between_pixels_have_the_bearing_and_the_derivatives_of_the_camera() {
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
                    // 1e-4 of a pixel.
                    assert!((bearing[axis] - exact.bearing[axis]).abs() < 1e-4 / parameters[0], "{kind} {x} {y}");
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
                    let around = table.coefficients(table.spot(x, y).unwrap()).unwrap();
                    let coefficients = around
                        .by_coefficients(place.offset.map(|value| value as f32), gradient.map(|value| value as f32));
                    let linear = linear.into_iter().chain(gradient);
                    let found = linear.chain(coefficients.map(f64::from)).enumerate().take(parameters.len());
                    for (parameter, value) in found {
                        let exact = projected.by_parameters[(row, parameter)];
                        // The remainder of the expansion about the centre of the large cell.
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
