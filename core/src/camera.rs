//! Camera models: from points in camera coordinates to pixels, and back, with all derivatives.
//!
//! Camera coordinates are right-handed: x to the right, y down, z forward along the optical axis.
//! Pixel (0, 0) is the centre of the top-left pixel. Every model ends in the same camera matrix,
//! `pixel = (fx u + cx, fy v + cy)`, and differs in how an image point (u, v) of the plane at
//! distance 1 follows from the point: that part has up to 8 distortion coefficients.
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
//! What every model guarantees:
//! - The **domain** is fixed when the camera is made and the model is one-to-one on it. Outside, and
//!   for NaN or infinite input, the answer is `None`, never a pixel or a bearing of another branch.
//! - What `project` accepts, `unproject` finds again, and the other way round, up to the precision
//!   of `T`. Very close to a fold of the model, where the derivative vanishes, `T` cannot resolve
//!   the inverse any more and the answer is `None`.
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

/// Most parameters a model can have: fx, fy, cx, cy and [`MAX_COEFFICIENTS`] more.
pub const MAX_PARAMETERS: usize = 12;

/// Most distortion coefficients a model can have.
pub const MAX_COEFFICIENTS: usize = MAX_PARAMETERS - 4;

/// Derivative of a pixel by the point in camera coordinates, in pixels per unit of length.
pub type PointJacobian<T> = SMatrix<T, 2, 3>;

/// Derivative of a pixel by the model's parameters, in their order; columns beyond them are zero.
pub type ProjectionParameterJacobian<T> = SMatrix<T, 2, MAX_PARAMETERS>;

/// A pixel and what it depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection<T> {
    /// The pixel.
    pub pixel: Vector2<T>,
    /// Its derivative by the point.
    pub by_point: PointJacobian<T>,
    /// Its derivative by the parameters.
    pub by_parameters: ProjectionParameterJacobian<T>,
}

/// A bearing and what it depends on. The derivatives are tangent to the unit sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unprojection<T> {
    /// Direction of view in camera coordinates, of length 1.
    pub bearing: Vector3<T>,
    /// Its derivative by the pixel.
    pub by_pixel: SMatrix<T, 3, 2>,
    /// Its derivative by the parameters, in their order; columns beyond them are zero.
    pub by_parameters: SMatrix<T, 3, MAX_PARAMETERS>,
}

/// A central camera without memory: one point, one pixel.
pub trait CameraModel<T: RealField + Copy> {
    /// Name of the model, lower case with hyphens.
    const NAME: &'static str;
    /// Names of the parameters in their order: "fx", "fy", "cx", "cy", then the coefficients.
    const PARAMETER_NAMES: &'static [&'static str];
    /// What is known of the coefficients before a lens is seen.
    const EXPECTATION: Expectation;

    /// The camera with these parameters, in the order of [`CameraModel::PARAMETER_NAMES`].
    ///
    /// `None` if their number is wrong, one is not finite, a focal length is not positive, or the
    /// model cannot be inverted even at the optical axis.
    fn from_parameters(parameters: &[T]) -> Option<Self>
    where
        Self: Sized;

    /// The parameters, in the order of [`CameraModel::PARAMETER_NAMES`].
    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS>;

    /// The pixel of a point in camera coordinates; `None` outside the domain.
    fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>>;

    /// The pixel of a point in camera coordinates with its derivatives; `None` outside the domain.
    fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>>;

    /// The direction of view of a pixel, of length 1; `None` outside the domain.
    fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>>;

    /// The direction of view of a pixel with its derivatives; `None` outside the domain.
    ///
    /// Where there is no closed form, the derivatives are those of the implicit function.
    fn unproject_with_jacobians(&self, pixel: &Vector2<T>) -> Option<Unprojection<T>>;
}

/// A model name that is not in [`ModelKind::ALL`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownModel;

impl fmt::Display for UnknownModel {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("unknown camera model; known are:")?;
        for kind in ModelKind::ALL {
            write!(formatter, " {kind}")?;
        }
        Ok(())
    }
}

impl core::error::Error for UnknownModel {}

/// Makes [`ModelKind`] and [`Camera`] from the list of models.
macro_rules! models {
    ($($(#[$documentation:meta])* $variant:ident($model:ident),)+) => {
        /// Which camera model.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum ModelKind {
            $($(#[$documentation])* $variant,)+
        }

        impl ModelKind {
            /// Every model.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// Name of the model, lower case with hyphens.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => <$model<f64> as CameraModel<f64>>::NAME,)+
                }
            }

            /// Names of the model's parameters in their order.
            pub const fn parameter_names(self) -> &'static [&'static str] {
                match self {
                    $(Self::$variant => <$model<f64> as CameraModel<f64>>::PARAMETER_NAMES,)+
                }
            }

            /// What is known of the model's coefficients before a lens is seen.
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
            /// The camera of model `kind` with these parameters; see [`CameraModel::from_parameters`].
            pub fn from_parameters(kind: ModelKind, parameters: &[T]) -> Option<Self> {
                match kind {
                    $(ModelKind::$variant => $model::from_parameters(parameters).map(Self::$variant),)+
                }
            }

            /// The model.
            pub const fn kind(&self) -> ModelKind {
                match self {
                    $(Self::$variant(_) => ModelKind::$variant,)+
                }
            }

            /// The parameters, in the order of [`ModelKind::parameter_names`].
            pub fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
                match self {
                    $(Self::$variant(model) => model.parameters(),)+
                }
            }

            /// See [`CameraModel::project`].
            pub fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>> {
                match self {
                    $(Self::$variant(model) => model.project(point),)+
                }
            }

            /// See [`CameraModel::project_with_jacobians`].
            pub fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>> {
                match self {
                    $(Self::$variant(model) => model.project_with_jacobians(point),)+
                }
            }

            /// See [`CameraModel::unproject`].
            pub fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>> {
                match self {
                    $(Self::$variant(model) => model.unproject(pixel),)+
                }
            }

            /// See [`CameraModel::unproject_with_jacobians`].
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
    /// Focal lengths along x and y on the optical axis, in pixels: derivatives of the pixel by the angle
    /// to the axis there.
    ///
    /// fx and fy themselves in most models; `double-sphere`, `omni` and `fov` scale them.
    pub fn axial_focal_lengths(&self) -> Option<[T; 2]> {
        let by_point = self.project_with_jacobians(&Vector3::z())?.by_point;
        Some([by_point.m11, by_point.m22])
    }
}

impl ModelKind {
    /// The model with this name, if there is one.
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
