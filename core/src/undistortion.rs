//! Fast removal of lens distortion from event coordinates by a look-up in a coarse table.
//!
//! Many lens models have no inverse in closed form and need an iteration per event. The table needs four reads and a
//! bilinear interpolation. Its nodes form a regular grid over the sensor, with the outermost nodes at the outermost
//! pixels. Each node contains the exact pixel of an ideal camera. The error between nodes decreases with the square of
//! their distance; [`UndistortionTable::accuracy`] measures it at every pixel.
//!
//! ```
//! use evcal_core::camera::{Camera, ModelKind};
//! use evcal_core::sensor::Sensor;
//! use evcal_core::undistortion::{IdealCamera, UndistortionTable};
//!
//! let lens = [330.0, 330.0, 172.5, 129.5, -0.35, 0.15, 0.0, 0.0_f32];
//! let camera = Camera::from_parameters(ModelKind::Radtan4, &lens).ok_or("no camera")?;
//! let sensor = Sensor { width: 346, height: 260 };
//! let ideal = IdealCamera { fx: 330.0, fy: 330.0, cx: 172.5, cy: 129.5 };
//! // 44×33 nodes: every 8 pixels, 11.6 kB.
//! let table = UndistortionTable::new(&camera, &ideal, sensor, [44, 33], [[0.0; 2]; 1452])?;
//! let [x, y] = table.undistort(10.0, 20.0).ok_or("outside")?;
//! assert!(x < 10.0 && y < 20.0);
//! assert!(table.accuracy(&camera, &ideal).largest_error < 0.06);
//! # Ok::<(), Box<dyn core::error::Error>>(())
//! ```

use core::fmt;

use nalgebra::{RealField, Vector2};

use crate::camera::Camera;
use crate::sensor::Sensor;

/// A camera without distortion: pixel = (fx X/Z + cx, fy Y/Z + cy).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdealCamera<T> {
    /// Focal length along x in pixels.
    pub fx: T,
    /// Focal length along y in pixels.
    pub fy: T,
    /// Column of the principal point in pixels.
    pub cx: T,
    /// Row of the principal point in pixels.
    pub cy: T,
}

impl<T: RealField + Copy> IdealCamera<T> {
    /// Returns the camera whose pixels are X/Z and Y/Z.
    pub fn normalised() -> Self {
        Self { fx: T::one(), fy: T::one(), cx: T::zero(), cy: T::zero() }
    }

    /// Returns the pixel of this camera that has the same bearing as `pixel` of `camera`; `None` if the bearing is
    /// outside the domain of either camera.
    pub fn of_pixel(&self, camera: &Camera<T>, pixel: &Vector2<T>) -> Option<Vector2<T>> {
        let bearing = camera.unproject(pixel)?;
        if bearing.z <= T::zero() {
            return None;
        }
        Some(Vector2::new(self.fx * (bearing.x / bearing.z) + self.cx, self.fy * (bearing.y / bearing.z) + self.cy))
    }
}

/// Reason why a table cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TableError {
    /// The storage has too little room for the nodes.
    TooManyNodes,
    /// The table has fewer than 2 nodes, or the sensor fewer than 2 pixels, in one direction.
    TooSmall,
}

impl fmt::Display for TableError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::TooManyNodes => "the table has no room for columns × rows nodes",
            Self::TooSmall => "a table needs 2 nodes and 2 pixels in each direction",
        })
    }
}

impl core::error::Error for TableError {}

/// Accuracy of a table.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TableAccuracy {
    /// Largest distance from the exact value over all pixels, in pixels of the ideal camera.
    pub largest_error: f32,
    /// The pixel of the largest error.
    pub at: [u16; 2],
    /// Pixels with an exact value but without a table value, at the edge of the model's domain.
    pub without_value: u32,
}

/// The table. Its nodes of eight bytes each are stored where the caller chooses: in an array, a slice in flash, or a
/// `Vec`.
#[derive(Clone, Debug, PartialEq)]
pub struct UndistortionTable<N> {
    sensor: Sensor,
    /// Columns and rows of nodes.
    size: [u16; 2],
    /// Nodes per pixel in x and y.
    scale: [f32; 2],
    /// Nodes row by row; NaN where the camera models have no value.
    nodes: N,
}

impl UndistortionTable<&'static [[f32; 2]]> {
    /// Creates a table from nodes that were computed before, row by row; for a static in flash.
    ///
    /// # Errors
    /// Returns an error if there are fewer nodes than columns × rows, or fewer than 2 in a direction.
    pub const fn from_nodes(sensor: Sensor, size: [u16; 2], nodes: &'static [[f32; 2]]) -> Result<Self, TableError> {
        match check(sensor, size, nodes.len()) {
            Ok(()) => Ok(Self { sensor, size, scale: scale(sensor, size), nodes }),
            Err(error) => Err(error),
        }
    }
}

impl<N: AsRef<[[f32; 2]]>> UndistortionTable<N> {
    /// Computes the table of `size` (columns, rows) nodes from pixels of `camera` to pixels of `ideal`, in `storage`.
    ///
    /// # Errors
    /// Returns an error if the storage has too little room for the nodes, or if there are fewer than 2 in a direction.
    pub fn new<T: RealField + Copy>(
        camera: &Camera<T>,
        ideal: &IdealCamera<T>,
        sensor: Sensor,
        size: [u16; 2],
        mut storage: N,
    ) -> Result<Self, TableError>
    where
        N: AsMut<[[f32; 2]]>,
    {
        check(sensor, size, storage.as_ref().len())?;
        let [columns, rows] = size;
        let along = |node: usize, nodes: u16, pixels: u16| {
            let place = node as f64 * f64::from(pixels.saturating_sub(1)) / f64::from(nodes.saturating_sub(1));
            nalgebra::convert::<f64, T>(place)
        };
        let lines = storage.as_mut().chunks_mut(usize::from(columns.max(1)));
        for (row, nodes) in lines.take(rows.into()).enumerate() {
            for (column, node) in nodes.iter_mut().enumerate() {
                let pixel = Vector2::new(along(column, columns, sensor.width), along(row, rows, sensor.height));
                *node = match ideal.of_pixel(camera, &pixel) {
                    Some(value) => [nalgebra::convert_unchecked(value.x), nalgebra::convert_unchecked(value.y)],
                    None => [f32::NAN; 2],
                };
            }
        }
        Ok(Self { sensor, size, scale: scale(sensor, size), nodes: storage })
    }

    /// Returns the sensor that the table was made for.
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the number of columns and rows of nodes.
    pub const fn size(&self) -> [u16; 2] {
        self.size
    }

    /// Returns the nodes, row by row; NaN where the camera models have no value.
    pub fn nodes(&self) -> &[[f32; 2]] {
        let [columns, rows] = self.size;
        self.nodes.as_ref().get(..usize::from(columns) * usize::from(rows)).unwrap_or_default()
    }

    /// Returns the pixel of the ideal camera that corresponds to pixel (x, y) of the sensor.
    ///
    /// Returns `None` outside the sensor (−0.5 … width − 0.5) and where the lens model has no value.
    #[inline]
    pub fn undistort(&self, x: f32, y: f32) -> Option<[f32; 2]> {
        let [columns, rows] = self.size;
        let (column, right) = cell(x, self.sensor.width, self.scale[0], columns)?;
        let (row, below) = cell(y, self.sensor.height, self.scale[1], rows)?;
        let (columns, nodes) = (usize::from(columns), self.nodes.as_ref());
        let first = row.wrapping_mul(columns).wrapping_add(column);
        let &[top_left, top_right] = nodes.get(first..)?.first_chunk::<2>()?;
        let &[bottom_left, bottom_right] = nodes.get(first.wrapping_add(columns)..)?.first_chunk::<2>()?;
        let between = |from: f32, to: f32, share: f32| from + (to - from) * share;
        let value = |axis: fn([f32; 2]) -> f32| {
            let top = between(axis(top_left), axis(top_right), right);
            let bottom = between(axis(bottom_left), axis(bottom_right), right);
            between(top, bottom, below)
        };
        let value = [value(|node| node[0]), value(|node| node[1])];
        (value[0].is_finite() && value[1].is_finite()).then_some(value)
    }

    /// Compares the table with the exact inverse at every pixel of the sensor.
    pub fn accuracy<T: RealField + Copy>(&self, camera: &Camera<T>, ideal: &IdealCamera<T>) -> TableAccuracy {
        let mut accuracy = TableAccuracy::default();
        for y in 0..self.sensor.height {
            for x in 0..self.sensor.width {
                let pixel = Vector2::new(f64::from(x), f64::from(y)).map(nalgebra::convert::<f64, T>);
                let Some(exact) = ideal.of_pixel(camera, &pixel) else { continue };
                let Some([u, v]) = self.undistort(f32::from(x), f32::from(y)) else {
                    accuracy.without_value = accuracy.without_value.saturating_add(1);
                    continue;
                };
                let difference = Vector2::new(u, v).map(nalgebra::convert::<f32, T>) - exact;
                let error: f32 = nalgebra::convert_unchecked(difference.norm());
                if error > accuracy.largest_error {
                    (accuracy.largest_error, accuracy.at) = (error, [x, y]);
                }
            }
        }
        accuracy
    }
}

const fn check(sensor: Sensor, [columns, rows]: [u16; 2], room: usize) -> Result<(), TableError> {
    if columns < 2 || rows < 2 || sensor.width < 2 || sensor.height < 2 {
        return Err(TableError::TooSmall);
    }
    if columns as usize * rows as usize > room {
        return Err(TableError::TooManyNodes);
    }
    Ok(())
}

const fn scale(sensor: Sensor, [columns, rows]: [u16; 2]) -> [f32; 2] {
    let along = [columns as f32 - 1.0, rows as f32 - 1.0];
    [along[0] / (sensor.width as f32 - 1.0), along[1] / (sensor.height as f32 - 1.0)]
}

/// Returns the cell of nodes that contains a coordinate, and the position in it from 0 to 1.
#[inline]
fn cell(coordinate: f32, pixels: u16, scale: f32, nodes: u16) -> Option<(usize, f32)> {
    let inside = coordinate >= -0.5 && coordinate <= f32::from(pixels) - 0.5;
    if !inside {
        return None;
    }
    let place = coordinate * scale;
    // A cast to an integer saturates, so positions before the first node belong to the first cell.
    let cell = (place as usize).min(usize::from(nodes.saturating_sub(2)));
    Some((cell, place - cell as f32))
}

#[cfg(test)]
mod tests {
    use std::vec;
    use std::vec::Vec;

    use super::*;
    use crate::camera::ModelKind;

    const SENSOR: Sensor = Sensor { width: 346, height: 260 };

    /// Returns one lens of each model, with the field of view of a DAVIS346 with its usual lens or wider.
    fn lenses() -> impl Iterator<Item = Camera<f64>> {
        let base = [330.0, 331.0, 170.0, 131.0];
        ModelKind::ALL.iter().map(move |&kind| {
            let rest: &[f64] = match kind {
                ModelKind::Radtan4 => &[-0.36, 0.14, 0.001, -0.0005],
                ModelKind::Radtan => &[-0.36, 0.18, 0.001, -0.0005, -0.04],
                ModelKind::Radtan8 => &[0.3, 0.1, 0.001, -0.0005, 0.01, 0.65, 0.2, 0.03],
                ModelKind::KannalaBrandt => &[-0.02, 0.01, -0.003, 0.0005],
                ModelKind::InverseRadial => &[0.2, 0.1, 0.0, 0.0, 0.0],
                ModelKind::Ucm => &[0.6],
                ModelKind::Eucm => &[0.6, 1.1],
                ModelKind::DoubleSphere => &[0.0, 0.6],
                ModelKind::Fov => &[0.9],
                ModelKind::Omni => &[0.0, -0.36, 0.14, 0.001, -0.0005],
            };
            Camera::from_parameters(kind, &[base.as_slice(), rest].concat()).unwrap()
        })
    }

    fn ideal<T: RealField + Copy>() -> IdealCamera<T> {
        IdealCamera {
            fx: nalgebra::convert(330.0),
            fy: nalgebra::convert(331.0),
            cx: nalgebra::convert(172.5),
            cy: nalgebra::convert(129.5),
        }
    }

    #[test]
    fn the_table_is_accurate_at_every_pixel_for_every_model() {
        for camera in lenses() {
            let table = UndistortionTable::new(&camera, &ideal(), SENSOR, [44, 33], vec![[0.0; 2]; 1452]).unwrap();
            let accuracy = table.accuracy(&camera, &ideal());
            assert!(accuracy.largest_error < 0.15, "{}: {accuracy:?}", camera.kind());
            assert_eq!(accuracy.without_value, 0);
        }
    }

    /// The error of a bilinear interpolation decreases with the square of the distance of the nodes.
    #[test]
    fn four_times_the_nodes_have_a_quarter_of_the_error() {
        for camera in lenses() {
            let coarse = UndistortionTable::new(&camera, &ideal(), SENSOR, [23, 17], vec![[0.0; 2]; 400]).unwrap();
            let fine = UndistortionTable::new(&camera, &ideal(), SENSOR, [45, 33], vec![[0.0; 2]; 1600]).unwrap();
            let ratio =
                coarse.accuracy(&camera, &ideal()).largest_error / fine.accuracy(&camera, &ideal()).largest_error;
            assert!((3.0..5.0).contains(&ratio), "{}: {ratio}", camera.kind());
        }
    }

    /// The device computes in single precision, the host in double; both must agree.
    #[test]
    fn single_precision_suffices() {
        for camera in lenses() {
            let parameters: Vec<f32> = camera.parameters().iter().map(|&value| value as f32).collect();
            let single = Camera::from_parameters(camera.kind(), &parameters).unwrap();
            let table = UndistortionTable::new(&single, &ideal::<f32>(), SENSOR, [20, 20], [[0.0; 2]; 400]).unwrap();
            let exact = UndistortionTable::new(&camera, &ideal::<f64>(), SENSOR, [20, 20], [[0.0; 2]; 400]).unwrap();
            for (node, exact) in table.nodes().iter().zip(exact.nodes()) {
                let distance = (Vector2::from(*node) - Vector2::from(*exact)).norm();
                assert!(distance < 2e-3, "{}: {node:?} {exact:?}", camera.kind());
            }
        }
    }

    #[test]
    fn nodes_are_exact_and_pixels_outside_the_sensor_have_no_value() {
        let camera = lenses().next().unwrap();
        let table = UndistortionTable::new(&camera, &ideal(), SENSOR, [11, 11], [[0.0; 2]; 121]).unwrap();
        for (x, y) in [(0.0, 0.0), (345.0, 0.0), (0.0, 259.0), (345.0, 259.0), (172.5, 129.5), (34.5, 207.2)] {
            let exact = ideal().of_pixel(&camera, &Vector2::new(x, y)).unwrap();
            let [u, v] = table.undistort(x as f32, y as f32).unwrap();
            assert!((Vector2::new(u.into(), v.into()) - exact).norm() < 1e-3);
        }
        for (x, y) in [(-0.5, 0.0), (345.5, 259.5)] {
            assert!(table.undistort(x, y).is_some());
        }
        for (x, y) in [(-0.6, 0.0), (345.6, 1.0), (1.0, 259.6), (f32::NAN, 1.0), (1.0, f32::INFINITY)] {
            assert_eq!(table.undistort(x, y), None);
        }
    }

    #[test]
    fn pixels_that_the_lens_does_not_see_have_no_value() {
        // The image of this fisheye ends 235 px from its centre.
        let camera = Camera::from_parameters(ModelKind::KannalaBrandt, &[150.0, 150.0, 172.5, 129.5, 0., 0., 0., 0.]);
        let camera: Camera<f64> = camera.unwrap();
        let normalised = IdealCamera::normalised();
        let large = Sensor { width: 600, height: 600 };
        let table = UndistortionTable::new(&camera, &normalised, large, [60, 60], vec![[0.0; 2]; 3600]).unwrap();
        assert!(table.undistort(172.0, 129.0).is_some());
        assert_eq!(table.undistort(590.0, 590.0), None);
        let seen = |x: u16, y: u16| normalised.of_pixel(&camera, &Vector2::new(x.into(), y.into())).is_some();
        let mut without = 0;
        for (x, y) in (0..600).flat_map(|y| (0..600).map(move |x| (x, y))) {
            let value = table.undistort(x.into(), y.into());
            assert!(seen(x, y) || value.is_none() || x % 10 == 0 || y % 10 == 0);
            without += u32::from(seen(x, y) && value.is_none());
        }
        assert_eq!(table.accuracy(&camera, &normalised).without_value, without);
    }

    #[test]
    fn impossible_tables_are_rejected() {
        let camera = lenses().next().unwrap();
        let of = |sensor, columns, rows| {
            UndistortionTable::new(&camera, &ideal(), sensor, [columns, rows], [[0.0; 2]; 100]).err()
        };
        assert_eq!(of(SENSOR, 10, 11), Some(TableError::TooManyNodes));
        assert_eq!(of(SENSOR, u16::MAX, u16::MAX), Some(TableError::TooManyNodes));
        assert_eq!(of(SENSOR, 1, 10), Some(TableError::TooSmall));
        assert_eq!(of(Sensor { width: 1, height: 1 }, 10, 10), Some(TableError::TooSmall));
        assert_eq!(of(SENSOR, 10, 10), None);
        static NODES: [[f32; 2]; 4] = [[0.0, 0.0], [345.0, 0.0], [0.0, 259.0], [345.0, 259.0]];
        const TABLE: Result<UndistortionTable<&'static [[f32; 2]]>, TableError> =
            UndistortionTable::from_nodes(SENSOR, [2, 2], &NODES);
        assert_eq!(TABLE.unwrap().undistort(100.0, 200.0).map(|[x, y]| (x.round(), y.round())), Some((100.0, 200.0)));
        assert_eq!(UndistortionTable::from_nodes(SENSOR, [2, 3], &NODES), Err(TableError::TooManyNodes));
    }
}
