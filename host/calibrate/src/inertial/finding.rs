//! Findings on the calibration of an IMU, with remedies.

use std::fmt;

use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

/// A problem of a result, or a quantity that was not measured.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Finding {
    /// The position of the IMU along a direction of the camera was not measured.
    PositionNotMeasured {
        /// Nearest axis of the camera.
        axis: usize,
        /// σ along it (m).
        sigma: f64,
    },
    /// The rotation was not measured.
    RotationNotMeasured {
        /// Largest σ (rad).
        sigma: f64,
    },
    /// The delay of a sensor was not measured.
    DelayNotMeasured {
        /// Its name.
        sensor: &'static str,
    },
    /// Scale and misalignment of the accelerometer cannot be separated from its bias and gravity.
    AccelerometerNotMeasured,
    /// The camera was hardly tilted: gravity cannot be separated from the accelerometer's bias.
    HardlyTilted {
        /// Largest angle between gravity and its mean direction, as seen from the camera (rad).
        tilt: f64,
        /// Largest σ of the accelerometer's bias (m/s²).
        sigma: f64,
    },
    /// Scale and misalignment of the gyroscope were not measured.
    GyroscopeNotMeasured,
    /// The clocks run at different rates.
    ClockDrift {
        /// Rate of the IMU's clock relative to the events' clock.
        drift: f64,
        /// Its σ.
        sigma: f64,
    },
    /// Samples are missing.
    Missing {
        /// Their share.
        share: f64,
    },
    /// Samples have no time of their own, and were left out.
    LeftOut {
        /// Their share.
        share: f64,
    },
    /// Several samples share each timestamp.
    Groups {
        /// Samples per timestamp, the median.
        samples: usize,
        /// Time that so many samples take (s).
        interval: f64,
        /// Delay of the gyroscope, if a timestamp belongs to the last of its samples (s).
        delay: f64,
    },
    /// Timestamps scatter by more than the time between samples, and the samples were placed at their constant rate.
    Scattered {
        /// Scatter (s, root mean square).
        scatter: f64,
    },
    /// Timestamps scatter, and samples do not arrive at a constant rate.
    Irregular {
        /// Scatter (s, root mean square).
        scatter: f64,
    },
    /// Samples could not be read.
    Damaged {
        /// Description of the loss and its cause.
        what: String,
    },
    /// Samples are saturated.
    Saturated {
        /// Their share.
        share: f64,
    },
    /// The board's spacing differs from the stated one.
    BoardSpacing {
        /// True divided by stated spacing.
        scale: f64,
        /// Its σ, including the accelerometer's nonlinearity.
        sigma: f64,
    },
    /// The solve with the IMU changed the camera.
    CameraMoved {
        /// Change in σ.
        sigmas: f64,
    },
    /// The fixed intrinsics differ from the intrinsics of this recording.
    OtherCamera {
        /// Difference in σ.
        sigmas: f64,
    },
    /// Blocks of time disagree.
    Loose {
        /// Ratio of the scatter of blocks to the formal one.
        scatter: f64,
    },
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PositionNotMeasured { axis, .. } => {
                let (name, others) = [("x", "y or z"), ("y", "x or z"), ("z", "x or y")][(*axis).min(2)];
                write!(f, "the lever arm along the camera's {name} was not measured: rotate quickly about {others} too")
            }
            Self::RotationNotMeasured { .. } => {
                write!(f, "the rotation of the IMU was not measured: rotate the camera about two of its axes")
            }
            Self::DelayNotMeasured { sensor } => {
                write!(
                    f,
                    "the delay of the {sensor} was not measured: rotate the camera back and forth, not at a constant rate"
                )
            }
            Self::AccelerometerNotMeasured => write!(
                f,
                "scale and misalignment of the accelerometer were not measured and make its bias and gravity less certain: tilt the camera by more than 30 degrees to all sides"
            ),
            Self::HardlyTilted { tilt, sigma } => write!(
                f,
                "the camera was tilted by {:.0}° at most, so the accelerometer's bias and the direction of gravity are known to only {:.1} mg: tilt it by more than 30 degrees to all sides",
                tilt.to_degrees(),
                1e3 * sigma / STANDARD_GRAVITY
            ),
            Self::GyroscopeNotMeasured => write!(
                f,
                "scale and misalignment of the gyroscope were not measured: rotate about all three axes of the camera"
            ),
            Self::ClockDrift { drift, sigma } => write!(
                f,
                "the IMU's clock drifts by {:.0} ± {:.0} ppm against the events' clock; delays apply to the middle of the recording: put both on one clock",
                1e6 * drift,
                1e6 * sigma
            ),
            Self::Missing { share } => {
                write!(
                    f,
                    "{:.1} % of the IMU samples are missing: check for a slow disk or a full buffer",
                    100.0 * share
                )
            }
            Self::LeftOut { share } => write!(
                f,
                "{:.1} % of the IMU samples are not later than the samples before them and were left out: stamp each sample with the time at which it was taken",
                100.0 * share
            ),
            Self::Groups { samples, interval, delay } => write!(
                f,
                "{samples} IMU samples, as a rule, share one timestamp; they were spread evenly over the {:.2} ms up to it. The recording does not contain the sample to which a timestamp belongs, so no delay is certain: if it is the last one, timestamps of the gyroscope are {:.3} ms {} than events. Stamp each sample with the time at which it was taken",
                1e3 * interval,
                1e3 * delay.abs(),
                if *delay < 0.0 { "earlier" } else { "later" }
            ),
            Self::Scattered { scatter } => write!(
                f,
                "the timestamps of the IMU scatter by {:.2} ms (rms), more than the samples are apart: samples were placed evenly in the order in which they arrived, and the delays refer to the mean timestamp: stamp samples when they are taken, not when they arrive",
                1e3 * scatter
            ),
            Self::Irregular { scatter } => write!(
                f,
                "the timestamps of the IMU scatter by {:.2} ms (rms), more than the samples are apart, and the samples do not arrive at a constant rate, so their times are not known: stamp samples when they are taken, not when they arrive",
                1e3 * scatter
            ),
            Self::Damaged { what } => {
                write!(f, "the recording is damaged; IMU samples were lost: {what}")
            }
            Self::Saturated { share } => write!(
                f,
                "{:.1} % of the IMU samples are saturated and were excluded: set a larger range",
                100.0 * share
            ),
            Self::BoardSpacing { scale, sigma } => write!(
                f,
                "the board seems to be {scale:.4} ± {sigma:.4} of its stated size: measure its spacing with a ruler"
            ),
            Self::CameraMoved { sigmas } => write!(
                f,
                "the solve with the IMU changed an intrinsic parameter by {sigmas:.1} σ: fix the intrinsics at the values of a slower recording"
            ),
            Self::OtherCamera { sigmas } => write!(
                f,
                "the fixed intrinsics differ by {sigmas:.1} σ from the values of this recording: use a calibration of the same lens with the same focus"
            ),
            Self::Loose { .. } => write!(
                f,
                "parts of the recording disagree on the position of the IMU: fix it to the camera, or check for vibration"
            ),
        }
    }
}
