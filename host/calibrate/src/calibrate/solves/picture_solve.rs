//! Use of the camera's own pictures together with the events: their dots along the trajectories, and the solve of both.

use super::board_solve::BoardSolve;
use super::joint_solve::solve;
use crate::calibrate::calibrated::OwnPictures;
use crate::calibrate::pictures::{CalibratedPictures, observations, require};
use crate::picture_calibration::joint::{JointPoints, JointReport};
use crate::quality::board_evidence::BoardEstimate;
use crate::task::PictureUse;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::progress::Progress;
use evcal_solve::solve::FreeParameters;
use evcal_solve::solve::refinement::RefinementInput;

/// A joint solve, with its pictures.
pub(in crate::calibrate) struct WithPictures {
    pub(in crate::calibrate) solve: BoardSolve,
    /// Statistics of the joint solve of pictures and events, if there was one.
    pub(in crate::calibrate) joint: Option<JointReport>,
    /// The pictures, if they are used as pictures of a second camera.
    pub(in crate::calibrate) own: Option<OwnPictures>,
}

/// Solves pictures and events together, or only assigns the pictures' dots to the trajectories of `solve`, as the task requires.
///
/// # Errors
/// [`CalibrateError`].
pub(in crate::calibrate) fn join_pictures(
    task: &Task,
    input: RefinementInput<CalibrateError>,
    solve: BoardSolve,
    pictures: Option<&CalibratedPictures>,
    progress: &Progress,
) -> Result<WithPictures, CalibrateError> {
    let is_joint = match task.pictures {
        PictureUse::Joint => true,
        PictureUse::SecondCamera => false,
        PictureUse::Ignore | PictureUse::CrossCheck | PictureUse::Only => {
            return Ok(WithPictures { solve, joint: None, own: None });
        }
    };
    let calibration = require(task, pictures)?;
    let JointPoints { points, report } = observations(task, &solve.refined, &solve.certainty.intrinsics, calibration)?;
    if is_joint {
        let input = RefinementInput { points, point_sigma: report.sigma, ..input };
        let solve = solve_with_pictures(task, input, solve, progress)?;
        Ok(WithPictures { solve, joint: Some(report), own: None })
    } else {
        let own = OwnPictures { camera: calibration.camera, sigma: calibration.sigma(), points, report };
        Ok(WithPictures { solve, joint: None, own: Some(own) })
    }
}

/// Solves again from `solved` on, with the centres of dots in pictures that `input` contains in addition to the events. The same
/// parameters are estimated.
fn solve_with_pictures(
    task: &Task,
    input: RefinementInput<CalibrateError>,
    solved: BoardSolve,
    progress: &Progress,
) -> Result<BoardSolve, CalibrateError> {
    let BoardSolve { refined, board, with_nominal_board, undetermined, fixed_values, .. } = solved;
    let FreeParameters { board: free_board, intrinsics, .. } = refined.problem.free;
    let fixed = std::array::from_fn(|index| !intrinsics[index] || undetermined.contains(&index));
    let input = RefinementInput { free_board, fixed, ..input };
    let (refined, certainty) = solve(task, &input, refined.into_state(), progress)?;
    let board = BoardEstimate { shape: refined.state.board, sigma: certainty.board_sigma, ..board };
    Ok(BoardSolve { refined, certainty, board, with_nominal_board, undetermined, fixed_values })
}
