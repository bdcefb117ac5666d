//! Residuals of observations and their derivatives: the rows of the joint solve.
//!
//! An event has a distance from an edge of the print ([`event_row`]), a circle centre a reprojection error ([`point_row`]). Most events
//! are computed in batches ([`row_batch`]).

pub mod bearing_table;
pub mod board_edge;
pub mod board_ray;
pub mod board_surface;
pub mod burst;
pub mod edge_batch;
pub mod event_bias;
pub mod event_row;
pub mod loss;
pub mod point_row;
pub mod pose_bin;
pub mod row_batch;
pub mod row_products;
