//! What the first camera and the poses of frames start from: evcal's own functions, or those of a library.

use std::fmt::Debug;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;

use super::native_start::native_start;
use super::planar_pose::{PlanarPose, PlanePoint, planar_pose};
use super::report::OpencvStart;
use super::settings::InitialSettings;
use super::sighting::BoardPoint;

/// Finds a first camera and the pose of a plane.
///
/// [`NativeStart`] is part of this crate; `evcal-opencv` has the other one.
pub trait Start: Debug + Send + Sync {
    /// Name for people.
    fn name(&self) -> &'static str;

    /// A first camera of model `kind` from some `views` of the board.
    fn camera(
        &self,
        kind: ModelKind,
        views: &[&[BoardPoint]],
        sensor: Sensor,
        settings: &InitialSettings,
    ) -> StartedCamera;

    /// `T_camera_world` of a plane of which some points may be wrong, by at most `iterations` samples. Points within `threshold` of
    /// their image, in units of the focal length, agree.
    fn plane_pose(&self, points: &[PlanePoint], threshold: f64, iterations: u16) -> Option<PlanarPose>;
}

/// Starts are equal that have the same name.
impl PartialEq for dyn Start {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

/// A first camera.
#[derive(Clone, Debug)]
pub struct StartedCamera {
    /// The camera; `None` where none was found.
    pub camera: Option<Camera<f64>>,
    /// How the calibration of OpenCV went; `None` for the native start.
    pub opencv: Option<OpencvStart>,
}

/// A scan over focal lengths, and IPPE in RANSAC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NativeStart {
    /// Seed of RANSAC's samples.
    pub seed: u64,
}

impl Start for NativeStart {
    fn name(&self) -> &'static str {
        "native"
    }

    fn camera(
        &self,
        kind: ModelKind,
        views: &[&[BoardPoint]],
        sensor: Sensor,
        settings: &InitialSettings,
    ) -> StartedCamera {
        let camera = native_start(kind, views, sensor, settings).map(|bundle| bundle.camera);
        StartedCamera { camera, opencv: None }
    }

    fn plane_pose(&self, points: &[PlanePoint], threshold: f64, iterations: u16) -> Option<PlanarPose> {
        planar_pose(points, threshold, iterations, self.seed)
    }
}
