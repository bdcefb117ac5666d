//! The functions and constants of OpenCV that this crate uses. OpenCV 5 divides the module `calib3d` of OpenCV 4 and has
//! one set of flags for both lens models.

#[cfg(not(feature = "opencv5"))]
opencv::opencv_branch_5! {
    compile_error!("OpenCV 5 needs the feature `opencv5`, which adds its module `objdetect`");
}

opencv::opencv_branch_5! {
    pub use opencv::calib::{
        CALIB_FIX_K3, CALIB_FIX_SKEW as FISHEYE_FIX_SKEW, CALIB_RATIONAL_MODEL,
        CALIB_RECOMPUTE_EXTRINSIC as FISHEYE_RECOMPUTE_EXTRINSIC, CALIB_USE_INTRINSIC_GUESS, CALIB_USE_LU,
        CALIB_ZERO_TANGENT_DIST, calibrate as fisheye_calibrate, calibrate_camera_extended,
    };
    pub use opencv::geometry::{
        SOLVEPNP_IPPE, SOLVEPNP_IPPE as GENERIC_IPPE, project_points_2_def as fisheye_project_points,
        solve_pnp_generic, solve_pnp_ransac,
    };
    pub use opencv::objdetect::{CALIB_CB_ASYMMETRIC_GRID, CALIB_CB_SYMMETRIC_GRID, find_circles_grid};
}

opencv::not_opencv_branch_5! {
    pub use opencv::calib3d::{
        CALIB_CB_ASYMMETRIC_GRID, CALIB_CB_SYMMETRIC_GRID, CALIB_FIX_K3, CALIB_RATIONAL_MODEL,
        CALIB_USE_INTRINSIC_GUESS, CALIB_USE_LU, CALIB_ZERO_TANGENT_DIST,
        Fisheye_CALIB_FIX_SKEW as FISHEYE_FIX_SKEW,
        Fisheye_CALIB_RECOMPUTE_EXTRINSIC as FISHEYE_RECOMPUTE_EXTRINSIC, SOLVEPNP_IPPE,
        calibrate as fisheye_calibrate, calibrate_camera_extended, find_circles_grid,
        fisheye_project_points_vec_def as fisheye_project_points, solve_pnp_generic, solve_pnp_ransac,
    };
    pub const GENERIC_IPPE: opencv::calib3d::SolvePnPMethod = opencv::calib3d::SolvePnPMethod::SOLVEPNP_IPPE;
}
