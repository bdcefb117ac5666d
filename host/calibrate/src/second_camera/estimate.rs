//! Unknowns of the solve of two cameras and their mount.

use super::mount::Mount;
use evcal_solve::solve::State;

/// The parameters of both cameras and of the mount.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The first camera, its event biases, its trajectories, and the board.
    pub first: State,
    /// The second camera and its event biases, with the same board and no trajectories of its own.
    pub second: State,
    /// The mount.
    pub mount: Mount,
}
