//! Camera models: from points in camera coordinates to pixels, and back, with all derivatives.
//!
//! Camera coordinates are right-handed: x to the right, y down, z forward along the optical axis. Pixel (0, 0) is the
//! centre of the top-left pixel. All models share the same camera matrix, `pixel = (fx u + cx, fy v + cy)`. They differ
//! in the map from the point to the image point (u, v) in the plane at distance 1, which has up to 8 distortion
//! coefficients.
//!
//! | model | file | coefficients | known as |
//! |---|---|---|---|
//! | `radtan4` | [`radtan`] | k1 k2 p1 p2 | OpenCV with 4 coefficients, Kalibr radtan |
//! | `radtan` | [`radtan`] | k1 k2 p1 p2 k3 | OpenCV's default, ROS `plumb_bob` |
//! | `radtan8` | [`radtan`] | k1 k2 p1 p2 k3 k4 k5 k6 | OpenCV and ROS rational model |
//! | `kannala-brandt` | [`kannala_brandt`] | k1 k2 k3 k4 | OpenCV fisheye, Kalibr and ROS equidistant |
//! | `inverse-radial` | [`inverse_radial`] | k1 k2 k3 k4 k5 | Drap and Lefèvre 2016 |
//! | `ucm` | [`ucm`] | alpha | unified model as basalt writes it |
//! | `eucm` | [`eucm`] | alpha beta | enhanced unified model of Kalibr and basalt |
//! | `double-sphere` | [`double_sphere`] | xi alpha | `ds` of Kalibr and basalt |
//! | `fov` | [`fov`] | w | ATAN; pinhole with `fov` in Kalibr |
//! | `omni` | [`omni`] | xi k1 k2 p1 p2 | OpenCV's `omnidir`, Kalibr omni-radtan |
//!
//! Every model guarantees:
//! - The **domain** is fixed when the camera is created, and the model is one-to-one on it. Outside, and for NaN or
//!   infinite input, the result is `None`, never a pixel or bearing of another branch of the model.
//! - `unproject` inverts `project` and vice versa on the whole domain, up to the precision of `T`. Very close to a fold
//!   of the model, where the derivative vanishes, `T` cannot resolve the inverse and the result is `None`.
//! - The number of iterations is bounded, nothing panics, nothing allocates.
//!
//! ```
//! use evcal_core::camera::{Camera, ModelKind};
//! use nalgebra::Vector3;
//!
//! let camera = Camera::from_parameters(ModelKind::Radtan4, &[345.0, 345.0, 170.0, 127.0, -0.3, 0.1, 0.0, 0.0]);
//! let pixel = camera.and_then(|camera| camera.project(&Vector3::new(0.2, -0.1, 1.0)));
//! assert!(pixel.is_some_and(|pixel| pixel.x < 170.0 + 345.0 * 0.2));
//! ```

use core::fmt;
use core::str::FromStr;

use nalgebra::{RealField, SMatrix, Vector2, Vector3};

mod camera_matrix;
pub mod conversion;
mod denominator;
pub mod double_sphere;
pub mod eucm;
pub mod expectation;
pub mod fov;
pub mod inverse_radial;
pub mod kannala_brandt;
pub mod omni;
mod polynomial;
pub mod radtan;
pub mod refit;
#[cfg(test)]
mod tests;
pub mod ucm;

pub use double_sphere::DoubleSphere;
pub use eucm::Eucm;
use expectation::Expectation;
pub use fov::Fov;
pub use inverse_radial::InverseRadial;
pub use kannala_brandt::KannalaBrandt;
pub use omni::Omni;
pub use radtan::{Radtan4, Radtan5, Radtan8};
pub use ucm::Ucm;

/// Largest number of parameters of a model: fx, fy, cx, cy and [`MAX_COEFFICIENTS`] more.
pub const MAX_PARAMETERS: usize = 12;

/// Largest number of distortion coefficients of a model.
pub const MAX_COEFFICIENTS: usize = MAX_PARAMETERS - 4;

/// Derivative of a pixel with respect to the point in camera coordinates, in pixels per unit of length.
pub type PointJacobian<T> = SMatrix<T, 2, 3>;

/// Derivative of a pixel with respect to the model's parameters, in their order; unused columns are zero.
pub type ProjectionParameterJacobian<T> = SMatrix<T, 2, MAX_PARAMETERS>;

/// A pixel with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection<T> {
    /// The pixel.
    pub pixel: Vector2<T>,
    /// Its derivative with respect to the point.
    pub by_point: PointJacobian<T>,
    /// Its derivative with respect to the parameters.
    pub by_parameters: ProjectionParameterJacobian<T>,
}

/// A bearing with its derivatives, which are tangent to the unit sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unprojection<T> {
    /// Unit vector in camera coordinates.
    pub bearing: Vector3<T>,
    /// Its derivative with respect to the pixel.
    pub by_pixel: SMatrix<T, 3, 2>,
    /// Its derivative with respect to the parameters, in their order; unused columns are zero.
    pub by_parameters: SMatrix<T, 3, MAX_PARAMETERS>,
}

/// A central camera model: all rays pass through one centre, so the pixel of a point depends only on its direction.
pub trait CameraModel<T: RealField + Copy> {
    /// Name of the model, lower case with hyphens.
    const NAME: &'static str;
    /// Names of the parameters in their order: "fx", "fy", "cx", "cy", then the coefficients.
    const PARAMETER_NAMES: &'static [&'static str];
    /// Prior knowledge of the coefficients.
    const EXPECTATION: Expectation;

    /// Creates the camera with these parameters, in the order of [`CameraModel::PARAMETER_NAMES`].
    ///
    /// Returns `None` if their number is wrong, a value is not finite, a focal length is not positive, or the model
    /// cannot be inverted even at the optical axis.
    fn from_parameters(parameters: &[T]) -> Option<Self>
    where
        Self: Sized;

    /// Returns the parameters, in the order of [`CameraModel::PARAMETER_NAMES`].
    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS>;

    /// Returns the pixel of a point in camera coordinates; `None` outside the domain.
    fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>>;

    /// Returns the pixel of a point in camera coordinates with its derivatives; `None` outside the domain.
    fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>>;

    /// Returns the bearing of a pixel, of length 1; `None` outside the domain.
    fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>>;

    /// Returns the bearing of a pixel with its derivatives; `None` outside the domain.
    ///
    /// Models without a closed form use the derivatives of the implicit function.
    fn unproject_with_jacobians(&self, pixel: &Vector2<T>) -> Option<Unprojection<T>>;
}

/// Error: a model name is not in [`ModelKind::ALL`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownModel;

impl fmt::Display for UnknownModel {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("unknown camera model; supported models are:")?;
        for kind in ModelKind::ALL {
            write!(formatter, " {kind}")?;
        }
        Ok(())
    }
}

impl core::error::Error for UnknownModel {}

/// Generates [`ModelKind`] and [`Camera`] from the list of models.
macro_rules! models {
    ($($(#[$documentation:meta])* $variant:ident($model:ident),)+) => {
        /// A camera model.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum ModelKind {
            $($(#[$documentation])* $variant,)+
        }

        impl ModelKind {
            /// All models.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// Returns the name of the model, lower case with hyphens.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => <$model<f64> as CameraModel<f64>>::NAME,)+
                }
            }

            /// Returns the names of the model's parameters in their order.
            pub const fn parameter_names(self) -> &'static [&'static str] {
                match self {
                    $(Self::$variant => <$model<f64> as CameraModel<f64>>::PARAMETER_NAMES,)+
                }
            }

            /// Returns the prior knowledge of the model's coefficients.
            pub const fn expectation(self) -> Expectation {
                match self {
                    $(Self::$variant => <$model<f64> as CameraModel<f64>>::EXPECTATION,)+
                }
            }
        }

        /// A camera of any model.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum Camera<T> {
            $($(#[$documentation])* $variant($model<T>),)+
        }

        impl<T: RealField + Copy> Camera<T> {
            /// Creates the camera of model `kind` with these parameters; see [`CameraModel::from_parameters`].
            pub fn from_parameters(kind: ModelKind, parameters: &[T]) -> Option<Self> {
                match kind {
                    $(ModelKind::$variant => $model::from_parameters(parameters).map(Self::$variant),)+
                }
            }

            /// Returns the model.
            pub const fn kind(&self) -> ModelKind {
                match self {
                    $(Self::$variant(_) => ModelKind::$variant,)+
                }
            }

            /// Returns the parameters, in the order of [`ModelKind::parameter_names`].
            pub fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
                match self {
                    $(Self::$variant(model) => model.parameters(),)+
                }
            }

            /// Projects a point; see [`CameraModel::project`].
            pub fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>> {
                match self {
                    $(Self::$variant(model) => model.project(point),)+
                }
            }

            /// Projects a point with derivatives; see [`CameraModel::project_with_jacobians`].
            pub fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>> {
                match self {
                    $(Self::$variant(model) => model.project_with_jacobians(point),)+
                }
            }

            /// Returns the bearing of a pixel; see [`CameraModel::unproject`].
            pub fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>> {
                match self {
                    $(Self::$variant(model) => model.unproject(pixel),)+
                }
            }

            /// Returns the bearing of a pixel with derivatives; see [`CameraModel::unproject_with_jacobians`].
            pub fn unproject_with_jacobians(&self, pixel: &Vector2<T>) -> Option<Unprojection<T>> {
                match self {
                    $(Self::$variant(model) => model.unproject_with_jacobians(pixel),)+
                }
            }
        }
    };
}

models! {
    /// Radial and tangential distortion, k1 k2 p1 p2.
    Radtan4(Radtan4),
    /// Radial and tangential distortion, k1 k2 p1 p2 k3: OpenCV's default.
    Radtan(Radtan5),
    /// Rational radial and tangential distortion, k1 k2 p1 p2 k3 k4 k5 k6.
    Radtan8(Radtan8),
    /// Fisheye, k1 k2 k3 k4.
    KannalaBrandt(KannalaBrandt),
    /// Radial polynomial from the distorted to the ideal image, k1 k2 k3 k4 k5.
    InverseRadial(InverseRadial),
    /// Unified model, alpha.
    Ucm(Ucm),
    /// Enhanced unified model, alpha beta.
    Eucm(Eucm),
    /// Double sphere, xi alpha.
    DoubleSphere(DoubleSphere),
    /// Field-of-view model, w.
    Fov(Fov),
    /// Unified model with radial and tangential distortion, xi k1 k2 p1 p2.
    Omni(Omni),
}

impl<T: RealField + Copy> Camera<T> {
    /// Returns the focal lengths along x and y on the optical axis, in pixels: the derivatives of the pixel with
    /// respect to the angle to the axis.
    ///
    /// In most models these are fx and fy; `double-sphere`, `omni` and `fov` scale them.
    pub fn axial_focal_lengths(&self) -> Option<[T; 2]> {
        let by_point = self.project_with_jacobians(&Vector3::z())?.by_point;
        Some([by_point.m11, by_point.m22])
    }
}

impl ModelKind {
    /// Returns the model with this name, if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|kind| kind.name() == name)
    }
}

impl FromStr for ModelKind {
    type Err = UnknownModel;

    fn from_str(name: &str) -> Result<Self, UnknownModel> {
        Self::from_name(name).ok_or(UnknownModel)
    }
}

impl fmt::Display for ModelKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}
