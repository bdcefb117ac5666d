//! A calibrated camera.

use std::path::PathBuf;
use std::sync::OnceLock;

use evcal_calibrate::result::calibrated_camera::CalibratedCamera;
use evcal_calibrate::undistort::PixelMap;
use evcal_calibrate::undistort::recording::write_camera;
use evcal_calibrate::undistort::target::{TargetProjection, target_camera};
use evcal_core::camera::ModelKind;
use evcal_core::sensor::Sensor;
use evcal_geometry::lens::camera_file::CameraDescription;
use nalgebra::{Vector2, Vector3};
use numpy::ndarray::{Array2, ArrayD};
use numpy::{AllowTypeChange, IntoPyArray, PyArray1, PyArray2, PyArrayDyn, PyArrayLikeDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::events::{EventArray, NewPlaces, filled, sensor as to_sensor, sub_pixel_dtype, viewed};
use crate::{exception, failed};

/// One coordinate of a map (x or y in px) for each pixel of an image: height x width.
type Map<'py> = Bound<'py, PyArray2<f32>>;

/// A camera: its lens model with parameters, and its size in pixels. Pixel (0, 0) is the centre of the top-left pixel.
#[pyclass(frozen, module = "evcal")]
pub struct Camera {
    camera: evcal_core::camera::Camera<f64>,
    sensor: Sensor,
    sigma: Option<Vec<f64>>,
    /// Map to the camera with the same matrix and no distortion, computed when it is first needed.
    forth: OnceLock<NewPlaces>,
}

impl Camera {
    /// Creates the camera of a lens and a sensor, with the standard deviations of its parameters if they are known.
    pub fn of(camera: evcal_core::camera::Camera<f64>, sensor: Sensor, sigma: Option<Vec<f64>>) -> Self {
        Self { camera, sensor, sigma, forth: OnceLock::new() }
    }

    pub fn lens(&self) -> &evcal_core::camera::Camera<f64> {
        &self.camera
    }

    pub fn size(&self) -> Sensor {
        self.sensor
    }

    /// Returns the camera as `evaluate` and `export` need it.
    pub fn known(&self) -> CalibratedCamera {
        CalibratedCamera { sigma: self.sigma.clone(), ..CalibratedCamera::seen_everywhere(self.camera, self.sensor) }
    }

    fn named<'py>(&self, py: Python<'py>, values: impl IntoIterator<Item = f64>) -> PyResult<Bound<'py, PyDict>> {
        let named = PyDict::new(py);
        for (name, value) in self.camera.kind().parameter_names().iter().zip(values) {
            named.set_item(name, value)?;
        }
        Ok(named)
    }

    /// Returns the lens of the undistorted pixels.
    fn target(&self, new_camera: Option<&Self>) -> PyResult<evcal_core::camera::Camera<f64>> {
        match new_camera {
            Some(new) if new.sensor == self.sensor => Ok(new.camera),
            Some(_) => Err(PyValueError::new_err("new_camera is for another sensor")),
            None => target_camera(&self.camera, TargetProjection::Pinhole, self.sensor, None).map_err(failed),
        }
    }
}

/// Model, parameters, sensor and sigma of a camera.
type NewArguments = (&'static str, Vec<f64>, (u16, u16), Option<Vec<f64>>);

/// Points or pixels as an argument.
type Rows<'py> = PyArrayLikeDyn<'py, f64, AllowTypeChange>;

/// Applies `map` to each row of `given` (N x A, or one row of A numbers) and returns the results in the same form.
fn mapped<'py, const A: usize, const B: usize>(
    py: Python<'py>,
    given: &Rows<'py>,
    what: &str,
    map: impl Fn(&[f64; A]) -> [f64; B] + Send,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let mut shape = given.shape().to_vec();
    match shape.as_mut_slice() {
        [width] | [_, width] if *width == A => *width = B,
        _ => return Err(PyValueError::new_err(format!("{what} are an array of N x {A}, or one of {A} numbers"))),
    }
    let given: Vec<f64> = given.as_array().iter().copied().collect();
    let values = py.detach(|| given.as_chunks::<A>().0.iter().flat_map(map).collect());
    Ok(ArrayD::from_shape_vec(shape, values).map_err(exception)?.into_pyarray(py))
}

#[pymethods]
impl Camera {
    /// A camera with a model of evcal, such as "radtan"; parameters by name or in the order of the model.
    ///
    /// sigma: the standard deviation of each parameter, in the model's order, if it is known.
    #[new]
    #[pyo3(signature = (model, parameters, sensor, sigma=None))]
    fn new(model: &str, parameters: &Bound<'_, PyAny>, sensor: (u16, u16), sigma: Option<Vec<f64>>) -> PyResult<Self> {
        let kind: ModelKind =
            model.parse().map_err(|error| PyValueError::new_err(format!("{error}: not {model:?}")))?;
        let names = kind.parameter_names();
        let values: Vec<f64> = match parameters.cast::<PyDict>() {
            Ok(named) => names.iter().map(|name| named.as_any().get_item(name)?.extract()).collect::<PyResult<_>>()?,
            Err(_) => parameters.extract()?,
        };
        let wrong = || {
            PyValueError::new_err(format!("{kind} takes {}, all finite, the focal lengths positive", names.join(", ")))
        };
        let camera = evcal_core::camera::Camera::from_parameters(kind, &values).ok_or_else(wrong)?;
        if sigma.as_ref().is_some_and(|sigma| sigma.len() != names.len()) {
            return Err(PyValueError::new_err(format!("sigma has a number for each of {}", names.join(", "))));
        }
        Ok(Self::of(camera, to_sensor(sensor)?, sigma))
    }

    /// Returns the arguments from which a copy is made: cameras can be pickled.
    fn __getnewargs__(&self) -> NewArguments {
        (self.model(), self.camera.parameters().to_vec(), self.sensor(), self.sigma.clone())
    }

    /// Read calibration.json, truth.json of a simulation, NAME.camera.json of an undistorted recording, the folder
    /// that contains one of the first two, or a file of OpenCV (YAML, JSON, XML), ROS, Kalibr, basalt, DV, dv-processing or mrcal.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let CalibratedCamera { camera, sensor, sigma, .. } = CalibratedCamera::read(&path).map_err(failed)?;
        Ok(Self::of(camera, sensor, sigma))
    }

    /// Write model, parameters and sensor size, without sigma, as JSON. load and the program evcal read this file.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        write_camera(&path, &self.camera, self.sensor).map_err(failed)
    }

    /// Name of the lens model.
    #[getter]
    fn model(&self) -> &'static str {
        self.camera.kind().name()
    }

    /// Parameters of the model by name: fx, fy, cx, cy in pixels, then the distortion.
    #[getter]
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.named(py, self.camera.parameters().iter().copied())
    }

    /// Standard deviation of each parameter by name; None if unknown.
    #[getter]
    fn sigma<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.sigma.as_ref().map(|sigma| self.named(py, sigma.iter().copied())).transpose()
    }

    /// Width and height in pixels.
    #[getter]
    fn sensor(&self) -> (u16, u16) {
        (self.sensor.width, self.sensor.height)
    }

    /// The camera matrix, 3 x 3.
    #[getter]
    fn matrix<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let parameters = self.camera.parameters();
        let mut values = parameters.iter().copied();
        let mut next = || values.next().unwrap_or(f64::NAN);
        let (fx, fy, cx, cy) = (next(), next(), next(), next());
        numpy::ndarray::arr2(&[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]).into_pyarray(py)
    }

    /// The parameters after fx, fy, cx, cy; for radtan the coefficients k1, k2, p1, p2, k3 of OpenCV.
    #[getter]
    fn distortion<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_iter(py, self.camera.parameters().iter().skip(4).copied())
    }

    /// Pixels (N x 2, or 2 numbers) of points (N x 3, or one point of 3 numbers, in any unit of length) in camera
    /// coordinates: x to the right, y down, z forward. NaN if the lens model does not project the point.
    fn project<'py>(&self, py: Python<'py>, points: Rows<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let project = |point: &[f64; 3]| {
            <[f64; 2]>::from(self.camera.project(&Vector3::from(*point)).unwrap_or(Vector2::repeat(f64::NAN)))
        };
        mapped(py, &points, "points", project)
    }

    /// Bearings of pixels (N x 2, or one pixel of 2 numbers): vectors of length 1 in camera coordinates (N x 3, or 3
    /// numbers). NaN if the lens model has no bearing for the pixel.
    fn unproject<'py>(&self, py: Python<'py>, pixels: Rows<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let unproject = |pixel: &[f64; 2]| {
            <[f64; 3]>::from(self.camera.unproject(&Vector2::from(*pixel)).unwrap_or(Vector3::repeat(f64::NAN)))
        };
        mapped(py, &pixels, "pixels", unproject)
    }

    /// Return a camera without distortion, of the same sensor size, that replaces this one.
    ///
    /// alpha: 0 keeps the largest rectangle without black corners, 1 everything that the lens sees; without it the camera
    /// matrix is unchanged. projection: "pinhole", or "equidistant" for wide lenses, whose outer parts a pinhole camera cannot show.
    #[pyo3(signature = (alpha=None, projection="pinhole"))]
    fn undistorted(&self, alpha: Option<f64>, projection: &str) -> PyResult<Self> {
        if alpha.is_some_and(|alpha| !(0.0..=1.0).contains(&alpha)) {
            return Err(PyValueError::new_err("alpha is from 0 to 1"));
        }
        let projection = TargetProjection::ALL
            .iter()
            .find(|known| known.name() == projection)
            .ok_or_else(|| PyValueError::new_err("projection is \"pinhole\" or \"equidistant\""))?;
        let camera = target_camera(&self.camera, *projection, self.sensor, alpha).map_err(failed)?;
        Ok(Self::of(camera, self.sensor, None))
    }

    /// Move events to the pixels at which a camera without distortion would have seen them. Positions are rounded to
    /// the nearest pixel, and events outside its sensor are left out. Returns an array of the same type as events, or
    /// of the type that read returns if events is not a structured array.
    ///
    /// new_camera: the camera without distortion, of the same sensor size; by default undistorted(). subpixel: keep
    /// fractions of pixels; the fields are then t (int64, µs), x, y (float64, px) and p (uint8). columns, time_unit: as
    /// for calibrate.
    #[pyo3(signature = (events, new_camera=None, *, subpixel=false, columns=None, time_unit=None))]
    fn undistort_events<'py>(
        &self,
        events: &Bound<'py, PyAny>,
        new_camera: Option<&Self>,
        subpixel: bool,
        columns: Option<&str>,
        time_unit: Option<&str>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let array = EventArray::new(events, columns, time_unit)?;
        let records = array.records()?;
        if subpixel {
            let map = PixelMap::new(&self.camera, &self.target(new_camera)?, self.sensor);
            let mut bytes = Vec::new();
            events.py().detach(|| records.between_pixels(&mut bytes, &map));
            return viewed(&sub_pixel_dtype(events.py())?, bytes);
        }
        if !records.hold(self.sensor.width, self.sensor.height) {
            return Err(PyValueError::new_err("the fields x and y are too narrow for the pixels of this sensor"));
        }
        let target = self.target(new_camera)?;
        let forth = || NewPlaces::new(&PixelMap::new(&self.camera, &target, self.sensor));
        filled(array.dtype(), array.len(), |output| match new_camera {
            None => records.moved(output, self.forth.get_or_init(forth)),
            Some(_) => records.moved(output, &forth()),
        })
    }

    /// Position (px) in the distorted image of each pixel of the undistorted image, for cv2.remap: two arrays (x and
    /// y), height x width, float32. -1 if the lens model does not see the pixel. new_camera: as for undistort_events.
    #[pyo3(signature = (new_camera=None))]
    fn undistort_map<'py>(&self, py: Python<'py>, new_camera: Option<&Self>) -> PyResult<(Map<'py>, Map<'py>)> {
        let target = self.target(new_camera)?;
        let Sensor { width, height } = self.sensor;
        let map = py.detach(|| PixelMap::new(&target, &self.camera, self.sensor));
        let axis = |axis: usize| {
            Array2::from_shape_fn((height.into(), width.into()), |(y, x)| {
                let place = map.get(x as u16, y as u16).unwrap_or([-1.0; 2]);
                place.get(axis).copied().unwrap_or(-1.0) as f32
            })
            .into_pyarray(py)
        };
        Ok((axis(0), axis(1)))
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.camera == other.camera && self.sensor == other.sensor
    }

    fn __repr__(&self) -> String {
        let CameraDescription { model, .. } = CameraDescription::new(&self.camera);
        let names = self.camera.kind().parameter_names();
        let parameters = self.camera.parameters();
        let listed: Vec<String> =
            names.iter().zip(&parameters).map(|(name, value)| format!("'{name}': {value:?}")).collect();
        format!("Camera({model:?}, {{{}}}, ({}, {}))", listed.join(", "), self.sensor.width, self.sensor.height)
    }
}
