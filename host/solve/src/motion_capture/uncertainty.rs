//! σ of the relation of camera and capture.
//!
//! Errors of a trajectory last longer than the time between captured poses, so residuals are not independent. Blocks of
//! time that are long enough are independent. The σ are computed from them by the jackknife, to first order.

use super::error::MotionCaptureError;
use super::fit::{COUNT, Equations, Fitted, Gradient, Normal};
use super::path::Path;
use evcal_geometry::timed_pose::TimedPose;

/// Lengths of blocks (s).
const BLOCKS: [f64; 3] = [0.5, 1.0, 2.0];

/// Returns σ of each parameter: the mean over blocks of several lengths, at least the σ of independent residuals.
///
/// # Errors
/// [`MotionCaptureError::Singular`] if the poses do not determine the parameters.
pub fn sigmas(path: &Path, capture: &[TimedPose], fitted: &Fitted) -> Result<[f64; COUNT], MotionCaptureError> {
    let at = &fitted.hand_eye;
    let rows: Vec<_> = at
        .matched(path, capture)
        .map(|(body, moment)| {
            let mut equations = Equations::none();
            let (error, by) = at.row(body, &moment);
            equations.add(&error, &by, &fitted.spread);
            (at.event_time(body.t), equations)
        })
        .collect();
    let mut whole = Normal::zeros();
    rows.iter().for_each(|(_, equations)| whole += equations.normal);
    fitted.priors.add(at, &mut whole, &mut Gradient::zeros());
    let formal = whole.cholesky().ok_or(MotionCaptureError::Singular)?.inverse();
    let mut variance = Gradient::zeros();
    for length in BLOCKS {
        variance += jackknife(&rows, &whole, length)? / BLOCKS.len() as f64;
    }
    Ok(std::array::from_fn(|index| variance[index].max(formal[(index, index)]).sqrt()))
}

/// Returns (K − 1)/K Σ δ², δ = (S − S_k)⁻¹ g_k, over the K blocks.
fn jackknife(rows: &[(f64, Equations)], whole: &Normal, length: f64) -> Result<Gradient, MotionCaptureError> {
    let block = |t: f64| (t / length).floor() as i64;
    let mut sum = Gradient::zeros();
    let mut count = 0.0;
    for block in rows.chunk_by(|a, b| block(a.0) == block(b.0)) {
        let (mut normal, mut gradient) = (*whole, Gradient::zeros());
        for (_, equations) in block {
            normal -= equations.normal;
            gradient += equations.gradient;
        }
        let moved = normal.cholesky().ok_or(MotionCaptureError::Singular)?.solve(&gradient);
        sum += moved.component_mul(&moved);
        count += 1.0;
    }
    Ok(sum * ((count - 1.0) / f64::max(count, 1.0)))
}
