//! One lens per camera model, with its simulated recordings and their calibrations.

use std::path::{Path, PathBuf};

use evcal_core::camera::ModelKind;

use crate::{BOARD, made, text};

/// A camera model with the parameters of a plausible lens in front of 346 × 260 pixels.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    /// Name of the model.
    pub model: &'static str,
    /// Its parameters, as on the command line.
    pub parameters: &'static str,
}

/// Barrel distortion of a short lens, without a sixth-order term.
pub const RADTAN4: Lens = Lens { model: "radtan4", parameters: "331.2,330.7,174.1,127.3,-0.33,0.12,0.0006,-0.0004" };
/// Barrel distortion of a short lens, with a sixth-order term.
pub const RADTAN: Lens =
    Lens { model: "radtan", parameters: "344.1,343.6,170.6,131.2,-0.37,0.19,-0.0005,0.0003,-0.06" };
/// A rational lens.
pub const RADTAN8: Lens =
    Lens { model: "radtan8", parameters: "338.4,338.1,173.3,128.4,0.25,-0.06,0.0004,0.0005,0.004,0.6,0.02,0.001" };
/// A wide lens: 100 degrees from corner to corner.
pub const KANNALA_BRANDT: Lens =
    Lens { model: "kannala-brandt", parameters: "196.4,196.0,171.9,130.3,-0.018,0.006,-0.003,0.0006" };
/// A lens given by the paper's polynomial from pixels to rays.
pub const INVERSE_RADIAL: Lens =
    Lens { model: "inverse-radial", parameters: "335.3,334.9,171.2,128.8,0.33,0.16,0.09,0.04,0.02" };
/// A wide lens of the unified model.
pub const UCM: Lens = Lens { model: "ucm", parameters: "196.4,196.0,171.9,130.3,0.62" };
/// A wide lens of the enhanced unified model.
pub const EUCM: Lens = Lens { model: "eucm", parameters: "196.4,196.0,171.9,130.3,0.6,1.12" };
/// A wide lens of the double sphere model.
pub const DOUBLE_SPHERE: Lens = Lens { model: "double-sphere", parameters: "157.1,156.8,171.9,130.3,-0.2,0.58" };
/// A wide lens of the field-of-view model.
pub const FOV: Lens = Lens { model: "fov", parameters: "182.4,182.0,171.9,130.3,0.93" };
/// A wide lens with tangential distortion.
pub const OMNI: Lens = Lens { model: "omni", parameters: "432.1,431.2,171.9,130.3,1.2,-0.12,0.05,0.0006,-0.0004" };

/// All lenses.
pub const ALL: [Lens; 10] =
    [RADTAN4, RADTAN, RADTAN8, KANNALA_BRANDT, INVERSE_RADIAL, UCM, EUCM, DOUBLE_SPHERE, FOV, OMNI];

impl Lens {
    /// Camera model.
    pub fn kind(&self) -> ModelKind {
        ModelKind::from_name(self.model).expect("the model is one of evcal's")
    }

    /// Folder of a simulated recording through this lens, with events.aedat4 (or .csv), truth.json and
    /// trajectory.txt.
    pub fn simulation(&self, name: &str, options: &[&str]) -> PathBuf {
        let name = format!("{name}-{}", self.model);
        let lens = ["--board", BOARD, "--model", self.model, "--parameters", self.parameters];
        made(&name, &[&["simulate"][..], &lens, options].concat())
    }

    /// A recording of 4 s from which this lens can be calibrated.
    pub fn recording(&self) -> PathBuf {
        self.simulation("recording", &["--motion", "fast", "--duration", "4s"])
    }

    /// A recording of 5 s with pauses and with the board out of view in between.
    pub fn interrupted_recording(&self) -> PathBuf {
        self.simulation("interrupted", &["--motion", "interrupted", "--duration", "5s", "--seed", "2"])
    }

    /// A recording of 4 s with 25 frames per second.
    pub fn recording_with_frames(&self) -> PathBuf {
        self.simulation("frames", &["--motion", "fast", "--duration", "4s", "--frames"])
    }

    /// Folder of the calibration of a simulation with these options.
    pub fn calibration_with(&self, name: &str, recording: &Path, options: &[&str]) -> PathBuf {
        let events = recording.join("events.aedat4");
        let common = ["calibrate", text(&events), "--board", BOARD, "--model", self.model, "--accept-any"];
        made(name, &[&common[..], options].concat())
    }

    /// Folder of the calibration from these event files with this lens' model, on two threads.
    pub fn calibration(&self, name: &str, events: &[&Path]) -> PathBuf {
        let events: Vec<&str> = events.iter().map(|path| text(path)).collect();
        let options = ["--board", BOARD, "--model", self.model, "--threads", "2", "--accept-any"];
        made(&format!("{name}-{}", self.model), &[&["calibrate"][..], &events, &options].concat())
    }

    /// Folder of the calibration from [`Lens::recording`].
    pub fn own_calibration(&self) -> PathBuf {
        self.calibration("calibration", &[&self.recording().join("events.aedat4")])
    }
}
