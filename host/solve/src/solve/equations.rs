//! Normal equations of the joint solve: block-banded along each trajectory, with a border of global parameters.
//!
//! Pieces of work sum the products of their rows ([`normal`]); [`system`] adds them up and computes steps.

pub mod band;
pub mod border;
pub mod control_band;
pub mod eliminated;
pub mod knot_fit;
pub mod normal;
pub mod pose_covariance;
pub mod pose_products;
pub mod smoothness;
pub mod stiffness;
pub mod system;
