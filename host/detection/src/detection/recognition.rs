//! Recognition of the board: its kind, layout and size, for users who did not state them or stated them wrongly.

pub mod larger_pattern;
pub mod layout;
pub mod other_board;
pub mod radius;
pub mod recognised;
pub mod stated_board;
