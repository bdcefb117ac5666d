//! The functions of OpenCV that this crate calls, with slices; `bridge.cpp` is the C++ side.

use std::ffi::{CStr, c_int};
use std::marker::PhantomData;

use evcal_core::pattern::{Layout, Pattern};

use super::{Intrinsics, OpencvCalibration, OpencvError, View, isometry};

/// A slice that C++ reads.
#[repr(C)]
struct Input<'a, T> {
    data: *const T,
    length: usize,
    slice: PhantomData<&'a [T]>,
}

impl<'a, T> From<&'a [T]> for Input<'a, T> {
    fn from(slice: &'a [T]) -> Self {
        Self { data: slice.as_ptr(), length: slice.len(), slice: PhantomData }
    }
}

/// A slice that C++ writes.
#[repr(C)]
struct Output<'a, T> {
    data: *mut T,
    length: usize,
    slice: PhantomData<&'a mut [T]>,
}

impl<'a, T> From<&'a mut [T]> for Output<'a, T> {
    fn from(slice: &'a mut [T]) -> Self {
        Self { data: slice.as_mut_ptr(), length: slice.len(), slice: PhantomData }
    }
}

type Points<'a> = Input<'a, [f64; 2]>;
/// The error message of OpenCV, terminated by a zero.
type Message<'a> = Output<'a, u8>;

/// `T_camera_world` in OpenCV's form.
#[repr(C)]
#[derive(Clone, Copy, Default)]
pub struct Pose {
    /// Axis times angle (rad).
    pub rotation: [f64; 3],
    /// In metres.
    pub translation: [f64; 3],
}

/// Points of all views, one view after the other.
#[repr(C)]
struct Views<'a> {
    sizes: Input<'a, usize>,
    object: Points<'a>,
    image: Points<'a>,
}

/// Settings of a calibration.
#[repr(C)]
pub struct Limits {
    /// Size of the sensor in pixels, for the initial principal point.
    pub width: c_int,
    pub height: c_int,
    /// Largest number of iterations, and the relative change of the parameters at which they end.
    pub iterations: c_int,
    pub change: f64,
}

/// Start values of a calibration, and then its result. OpenCV either fills in everything or fails.
#[repr(C)]
struct Solved<'a> {
    camera: [f64; 4],
    rms: f64,
    coefficients: Output<'a, f64>,
    view_rms: Output<'a, f64>,
    poses: Output<'a, Pose>,
}

// SAFETY: these are the functions of bridge.cpp. They stay within the slices, whose lengths they receive, keep no
// pointer, and throw no exception.
unsafe extern "C" {
    safe fn evcal_opencv_calibrate_pinhole(
        views: &Views<'_>,
        limits: &Limits,
        tangential: bool,
        guess: bool,
        solved: &mut Solved<'_>,
        message: Message<'_>,
    ) -> c_int;

    safe fn evcal_opencv_calibrate_fisheye(
        views: &Views<'_>,
        limits: &Limits,
        solved: &mut Solved<'_>,
        message: Message<'_>,
    ) -> c_int;

    safe fn evcal_opencv_find_circles_grid(
        points: Points<'_>,
        columns: c_int,
        rows: c_int,
        asymmetric: bool,
        grid: Output<'_, [f64; 2]>,
        message: Message<'_>,
    ) -> c_int;

    safe fn evcal_opencv_solve_pnp_ransac(
        object: Points<'_>,
        image: Points<'_>,
        iterations: c_int,
        threshold: f32,
        inliers: Output<'_, c_int>,
        found: &mut usize,
        message: Message<'_>,
    ) -> c_int;

    safe fn evcal_opencv_solve_ippe(
        object: Points<'_>,
        image: Points<'_>,
        poses: Output<'_, Pose>,
        found: &mut usize,
        message: Message<'_>,
    ) -> c_int;
}

/// Calls OpenCV; returns `true` if it found something.
fn answered(call: &'static str, ask: impl FnOnce(Message<'_>) -> c_int) -> Result<bool, OpencvError> {
    let mut message = [0; 4096];
    match ask(message.as_mut_slice().into()) {
        0 => Ok(true),
        1 => Ok(false),
        _ => {
            let message = CStr::from_bytes_until_nul(&message).unwrap_or_default().to_string_lossy();
            Err(OpencvError::Exception { call, message: message.trim().to_owned() })
        }
    }
}

/// Stack size of the calibrations: OpenBLAS, which many machines use instead of the reference BLAS, puts work space on
/// the stack that exceeds the usual 2 to 8 MiB.
const STACK: usize = 64 << 20;

/// Calibrates from all `views`; returns an error unless the result is finite and the focal lengths are positive.
fn calibrate(
    call: &'static str,
    views: &[&View],
    camera: [f64; 4],
    mut coefficients: Vec<f64>,
    run: impl FnOnce(&Views<'_>, &mut Solved<'_>, Message<'_>) -> c_int + Send,
) -> Result<OpencvCalibration, OpencvError> {
    let sizes: Vec<usize> = views.iter().map(|view| view.object.len()).collect();
    let object: Vec<[f64; 2]> = views.iter().flat_map(|view| &view.object).copied().collect();
    let image: Vec<[f64; 2]> = views.iter().flat_map(|view| &view.image).copied().collect();
    let mut view_rms = vec![0.0; views.len()];
    let mut poses = vec![Pose::default(); views.len()];
    let work = || {
        let views = Views { sizes: (&*sizes).into(), object: (&*object).into(), image: (&*image).into() };
        let mut solved = Solved {
            camera,
            rms: 0.0,
            coefficients: (&mut *coefficients).into(),
            view_rms: (&mut *view_rms).into(),
            poses: (&mut *poses).into(),
        };
        let found = answered(call, |message| run(&views, &mut solved, message))?;
        if found { Ok((solved.camera, solved.rms)) } else { Err(OpencvError::Unusable { call }) }
    };
    let (camera, rms) = std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, work);
        let thread = thread.map_err(|error| OpencvError::Exception { call, message: error.to_string() })?;
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })?;
    let [fx, fy, cx, cy] = camera;
    let finite = camera.iter().chain([&rms]).chain(&coefficients).chain(&view_rms).all(|value| value.is_finite());
    match poses.iter().map(isometry).collect() {
        Some(poses) if finite && fx > 0.0 && fy > 0.0 => {
            let intrinsics = Intrinsics { focal: [fx, fy], center: [cx, cy], distortion: coefficients };
            Ok(OpencvCalibration { intrinsics, rms, views: (0..view_rms.len()).collect(), view_rms, poses })
        }
        _ => Err(OpencvError::Unusable { call }),
    }
}

/// Calls `calibrateCamera` with 4, 5 or 8 `coefficients`; p1 and p2 stay zero unless `tangential` is set. With a
/// `guess` it starts from the given camera and coefficients.
pub fn calibrate_pinhole(
    views: &[&View],
    limits: &Limits,
    tangential: bool,
    coefficients: Vec<f64>,
    guess: Option<[f64; 4]>,
) -> Result<OpencvCalibration, OpencvError> {
    let camera = guess.unwrap_or([1.0, 1.0, 0.0, 0.0]);
    calibrate("calibrateCamera", views, camera, coefficients, |views, solved, message| {
        evcal_opencv_calibrate_pinhole(views, limits, tangential, guess.is_some(), solved, message)
    })
}

/// Calls `fisheye::calibrate`.
pub fn calibrate_fisheye(views: &[&View], limits: &Limits) -> Result<OpencvCalibration, OpencvError> {
    calibrate("fisheye::calibrate", views, [0.0; 4], vec![0.0; 4], |views, solved, message| {
        evcal_opencv_calibrate_fisheye(views, limits, solved, message)
    })
}

/// Calls `findCirclesGrid`: returns the centres in board order, which equal `points` up to rounding.
pub fn find_circles_grid(points: &[[f64; 2]], pattern: Pattern) -> Result<Option<Vec<[f64; 2]>>, OpencvError> {
    let mut grid = vec![[0.0; 2]; pattern.circle_count()];
    let (columns, rows) = (c_int::from(pattern.columns), c_int::from(pattern.rows));
    let asymmetric = pattern.layout == Layout::Asymmetric;
    let found = answered("findCirclesGrid", |message| {
        let grid = (&mut *grid).into();
        evcal_opencv_find_circles_grid(points.into(), columns, rows, asymmetric, grid, message)
    })?;
    Ok(found.then_some(grid))
}

/// Calls `solvePnPRansac`: returns the indices of the points that agree with a pose; no indices if there is no pose.
pub fn solve_pnp_ransac(
    object: &[[f64; 2]],
    image: &[[f64; 2]],
    iterations: u16,
    threshold: f32,
) -> Result<Vec<c_int>, OpencvError> {
    let (mut inliers, mut found) = (vec![0; object.len()], 0);
    let posed = answered("solvePnPRansac", |message| {
        let (object, image, inliers) = (object.into(), image.into(), (&mut *inliers).into());
        evcal_opencv_solve_pnp_ransac(object, image, iterations.into(), threshold, inliers, &mut found, message)
    })?;
    inliers.truncate(if posed { found } else { 0 });
    Ok(inliers)
}

/// Calls `solvePnPGeneric` with IPPE: returns both poses of a plane, the better one first.
pub fn solve_ippe(object: &[[f64; 2]], image: &[[f64; 2]]) -> Result<Vec<Pose>, OpencvError> {
    let (mut poses, mut found) = (vec![Pose::default(); 2], 0);
    let solved = answered("solvePnPGeneric", |message| {
        let (object, image, poses) = (object.into(), image.into(), (&mut *poses).into());
        evcal_opencv_solve_ippe(object, image, poses, &mut found, message)
    })?;
    poses.truncate(if solved { found } else { 0 });
    Ok(poses)
}
