//! Findings on the calibration of a second camera, with remedies.

use std::fmt;

/// A problem of a result, or a quantity that was not measured.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Finding {
    /// The relative position was not measured.
    PlaceNotMeasured {
        /// Largest σ (m).
        sigma: f64,
    },
    /// The relative rotation was not measured.
    RotationNotMeasured {
        /// Largest σ (rad).
        sigma: f64,
    },
    /// The offset of the clocks was not measured.
    OffsetNotMeasured {
        /// σ (s).
        sigma: f64,
    },
    /// The clocks run at different rates.
    ClockRate {
        /// Relative rate by which the second is faster.
        rate: f64,
        /// Its σ.
        sigma: f64,
    },
    /// The events of the second camera fit the trajectory of the first worse than its own.
    Loose {
        /// Ratio of the residuals.
        ratio: f64,
    },
    /// The first camera did not see the board when the second did.
    LeftOut {
        /// Share of the second camera's events.
        share: f64,
    },
    /// A rolling shutter was requested, and none was found.
    NoLineDelay {
        /// Time from row to row (s).
        line_delay: f64,
        /// Its σ.
        sigma: f64,
    },
    /// The solve of both changed a camera.
    CameraMoved {
        /// Index of the camera: 0 or 1.
        camera: usize,
        /// Change in σ.
        sigmas: f64,
    },
    /// The fixed intrinsics differ from the intrinsics of this recording.
    OtherCamera {
        /// Index of the camera: 0 or 1.
        camera: usize,
        /// Difference in σ.
        sigmas: f64,
    },
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PlaceNotMeasured { sigma } => write!(
                f,
                "the relative position of the cameras was hardly measured (± {:.1} mm): record longer, near the board",
                1e3 * sigma
            ),
            Self::RotationNotMeasured { sigma } => write!(
                f,
                "the relative rotation of the cameras was hardly measured (± {:.2}°): record longer, near the board",
                sigma.to_degrees()
            ),
            Self::OffsetNotMeasured { sigma } => write!(
                f,
                "the offset of the clocks was hardly measured (± {:.1} ms): move faster, back and forth",
                1e3 * sigma
            ),
            Self::ClockRate { rate, sigma } => write!(
                f,
                "the second clock gains {:.1} ± {:.1} µs a second on the first; the offset is that in the middle of what both saw: put both \
                 cameras on one clock",
                1e6 * rate,
                1e6 * sigma
            ),
            Self::Loose { ratio } => write!(
                f,
                "the second camera's events fit the trajectory of the first {ratio:.2} times worse than one of its own: fix both to a stiff \
                 mount"
            ),
            Self::LeftOut { share } => write!(
                f,
                "{:.0} % of what the second camera saw was left out, for the first did not see the board then: keep the board in view of \
                 both",
                100.0 * share
            ),
            Self::NoLineDelay { line_delay, sigma } => write!(
                f,
                "no line delay was found ({:.3} ± {:.3} µs per row): it has a global shutter: do not state a rolling shutter",
                1e6 * line_delay,
                1e6 * sigma
            ),
            Self::CameraMoved { camera, sigmas } => write!(
                f,
                "the solve of both changed an intrinsic parameter of the {} camera by {sigmas:.1} σ: check its own report",
                ["first", "second"][(*camera).min(1)]
            ),
            Self::OtherCamera { camera, sigmas } => write!(
                f,
                "the intrinsics of the {} camera that were fixed are {sigmas:.1} σ from those of this recording: fix those of the same lens with \
                 the same focus",
                ["first", "second"][(*camera).min(1)]
            ),
        }
    }
}
