//! The native start, and the selection of the start.

use evcal_core::camera::ModelKind;
use evcal_core::sensor::Sensor;

use super::native_start::native_start;
use super::planar_pose::{PlanarPose, PlanePoint, planar_pose};
use super::settings::{InitialSettings, Start, StartedCamera};
use super::sighting::BoardPoint;

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

/// Returns the start in the settings, or the native one.
pub fn start_of(settings: &InitialSettings) -> &'static dyn Start {
    settings.start.unwrap_or(&NativeStart { seed: 0 })
}
