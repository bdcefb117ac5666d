//! What two cameras and their mount are solved for.

use super::mount::Mount;
use crate::solve::State;

/// The parameters of both cameras and of what lies between them.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The first camera, its event biases, its trajectories, and the board.
    pub first: State,
    /// The second camera and its event biases, with the same board and no trajectories of its own.
    pub second: State,
    /// What lies between them.
    pub mount: Mount,
}
