//! Gates against wrong frames: neighbours in time vote on a frame that moves in a way in which no hand moves.

mod neighbour_vote;
pub(super) mod rotation_gate;
pub(super) mod velocity_gate;
