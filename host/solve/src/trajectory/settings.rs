//! Settings of the curves of a trajectory.

use evcal_core::settings;
use evcal_core::settings::{at_least, from_to};
use evcal_core::spline::MAX_DEGREE;
use serde::{Deserialize, Serialize};

use super::RotationSpline;

settings! {
    /// The curves of the trajectory (section 7 of method.md).
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct SplineSettings {
        /// Curve of the rotation: `"quaternion"` (Kang) or `"so3"` (Sommer).
        pub rotation: RotationSpline = RotationSpline::Quaternion;
        /// Degree p.
        pub degree: usize = 3, "", from_to(2.0, MAX_DEGREE as f32);
        /// Mean distance of knots; for circle tracks longer where frames are sparse.
        pub knot_spacing: f64 = 0.0175, "s", at_least(1e-4);
    }
}
