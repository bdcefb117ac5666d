//! The page, from the program's side.

use std::error::Error;
use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use evcal::files::folder::OutputFolder;
use evcal::live::Seen;
use evcal::live::latest::Latest;
use evcal::live::picture::EventPicture;
use evcal::page::view::{Losses, Outcome, Phase, ended, looking};
use evcal::page::{Next, Page, PageError, Publisher};
use evcal::result::calibration_file::CalibrationFile;
use evcal_core::sensor::Sensor;

use super::super::NotGoodEnough;
use super::super::print;

/// A page that has not asked for so long is closed.
const GONE: Duration = Duration::from_secs(10);
/// Time between two looks at whether the program should end.
const PATIENCE: Duration = Duration::from_millis(100);

/// The page, and what the camera says of itself.
pub struct Window {
    page: Page,
    losses: Arc<Mutex<Losses>>,
}

impl Window {
    /// Serves the page and says where.
    pub fn open(port: Option<u16>) -> Result<Self, PageError> {
        let page = Page::start(port)?;
        print::aside(format!("open {} in a browser on this computer", page.url()));
        Ok(Self { page, losses: Arc::default() })
    }

    /// Something that shows pictures, for the thread that has them.
    pub fn screen(&self) -> Screen {
        Screen { publisher: self.page.publisher(), losses: Arc::clone(&self.losses) }
    }

    /// Whether the person asked to end the recording.
    pub fn is_finish_asked(&self) -> bool {
        self.page.is_finish_asked()
    }

    /// Tells what was lost so far.
    pub fn set_losses(&self, losses: Losses) {
        *self.losses.lock().unwrap_or_else(PoisonError::into_inner) = losses;
    }

    fn publish(&self, phase: Phase, sensor: Sensor, seen: &Seen, outcome: Option<&Outcome>) {
        let losses = *self.losses.lock().unwrap_or_else(PoisonError::into_inner);
        let state = ended(phase, [sensor.width, sensor.height], seen, losses, outcome);
        self.page.publisher().publish(&state, &[]);
    }

    /// Says that the recording is over and the camera is being calibrated.
    pub fn calibrating(&self, sensor: Sensor, seen: &Seen) {
        self.publish(Phase::Calibrating, sensor, seen, None);
    }

    /// A recording begins.
    pub fn begin(&self) {
        self.page.begin();
    }

    /// Shows how the calibration ended, until the person closes the page or the program, or wants another recording where
    /// that `is_possible`.
    pub fn finish(
        &self,
        sensor: Sensor,
        seen: &Seen,
        folder: &OutputFolder,
        calibrated: &super::super::Outcome,
        is_possible: bool,
    ) -> Next {
        let failure = calibrated.as_ref().err().filter(|error| !error.is::<NotGoodEnough>());
        let outcome = match failure {
            Some(error) => Err(error.to_string()),
            None => self.outcome(folder.path()).map_err(|error| error.to_string()),
        };
        let (phase, outcome) = match outcome {
            Ok(outcome) => (Phase::Done, outcome),
            Err(verdict) => (Phase::Failed, Outcome { verdict, ..Outcome::default() }),
        };
        self.publish(phase, sensor, seen, Some(&Outcome { can_record: is_possible, ..outcome }));
        if self.page.is_watched(GONE) {
            print::aside("the page shows the result; it ends with \"Close evcal\", with its tab, or with Ctrl-C");
        }
        while self.page.is_watched(GONE) {
            match self.page.take_next() {
                Some(Next::Again | Next::Add) if !is_possible => {}
                Some(next) => return next,
                None => thread::sleep(PATIENCE),
            }
        }
        Next::Close
    }

    /// What is in the folder of the results.
    fn outcome(&self, folder: &Path) -> Result<Outcome, Box<dyn Error>> {
        let calibration: CalibrationFile = serde_json::from_str(&fs::read_to_string(folder.join("calibration.json"))?)?;
        let report = fs::read_to_string(folder.join("report.html"))?;
        let camera = calibration.camera.camera()?;
        let parameters = camera.parameters();
        let parameter = |index: usize| parameters.get(index).copied().unwrap_or(f64::NAN);
        Ok(Outcome {
            verdict: calibration.verdict.sentence,
            model: calibration.camera.model,
            matrix: [[parameter(0), 0.0, parameter(2)], [0.0, parameter(1), parameter(3)], [0.0, 0.0, 1.0]],
            distortion: parameters.get(4..).unwrap_or_default().to_vec(),
            sigma: Some(calibration.uncertainty.projection_rms),
            folder: folder.display().to_string(),
            report: Some(self.page.set_report(report)),
            can_record: false,
        })
    }
}

/// Shows pictures.
pub struct Screen {
    publisher: Publisher,
    losses: Arc<Mutex<Losses>>,
}

impl Screen {
    /// Shows a picture with what was seen last.
    pub fn show(&mut self, picture: &EventPicture, latest: &Latest) {
        let losses = *self.losses.lock().unwrap_or_else(PoisonError::into_inner);
        let seen = latest.get();
        self.publisher.publish(&looking(picture, &seen, losses), picture.pixels());
    }
}
