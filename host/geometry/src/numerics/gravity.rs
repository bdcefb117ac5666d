//! Standard gravity, the unit of accelerations.

/// One g in m/s².
pub const STANDARD_GRAVITY: f64 = 9.806_65;
