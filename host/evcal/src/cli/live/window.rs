//! The page of `evcal live`, and the content that the program shows on it.

use std::env;
use std::error::Error;
use std::fs;
use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use evcal_calibrate::quality::verdict::Grade;
use evcal_calibrate::result::calibration_file::CalibrationFile;
use evcal_core::sensor::Sensor;
use evcal_files::folder::OutputFolder;
use evcal_files::visible;
use evcal_live::Seen;
use evcal_live::checkpoint::CalibrationStep;
use evcal_live::frames::FrameFeed;
use evcal_live::latest::Latest;
use evcal_live::page::view::{Context, FileLink, Losses, Outcome, Phase, calibrating, ended, observing};
use evcal_live::page::{Next, Page, PageError, Publisher};
use evcal_live::picture::EventPicture;
use evcal_report::output::folder::results_in;
use event_recordings::Recording;
use event_recordings::pictures::GreyImage;

use super::super::print;
use super::super::progress::Listener;
use super::browser::{self, Redirect, is_desktop};

/// Time without a request after which a page counts as closed.
const GONE: Duration = Duration::from_secs(10);
/// Interval between checks whether the program should end.
const PATIENCE: Duration = Duration::from_millis(100);

/// The page, with the state that it shows in addition to the observations.
pub struct Window {
    page: Page,
    context: Arc<Mutex<Context>>,
    /// File that redirects a browser to the page.
    redirect: Option<Redirect>,
    is_local: bool,
}

impl Window {
    /// Serves the page on the address `listen`, by default to this computer only.
    pub fn open(listen: Option<IpAddr>, port: Option<u16>, context: Context) -> Result<Self, PageError> {
        let address = listen.unwrap_or(Ipv4Addr::LOCALHOST.into());
        let page = Page::start(address, port)?;
        Ok(Self { page, context: Arc::new(Mutex::new(context)), redirect: None, is_local: address.is_loopback() })
    }

    /// Prints the URL; if a browser `is_wanted` and there is a desktop, opens one through a file in `folder`.
    pub fn announce(&mut self, is_wanted: bool, folder: &Path) {
        let url = self.page.url();
        if is_wanted && is_desktop(|name| env::var_os(name)) {
            self.redirect = browser::open(&url, folder).ok();
        }
        print::aside(match (&self.redirect, self.is_local) {
            (Some(_), _) => format!("the page opens in a browser: {url}"),
            (None, true) => format!("open {url} in a browser on this computer"),
            (None, false) => format!("open {url} in a browser"),
        });
        if !self.is_local {
            print::aside(
                "other computers can open this page: anybody with this URL can see the camera and end the recording; the \
                 connection is not encrypted",
            );
        }
    }

    /// Returns a handle with which another thread shows pictures, and the frames of `recording` if there is one.
    pub fn screen(&self, recording: Option<Recording>) -> Screen {
        Screen { publisher: self.page.publisher(), context: Arc::clone(&self.context), recording, frames: None }
    }

    /// Returns a function for another thread; it returns `true` if the page shows frames.
    pub fn frames_wanted(&self) -> impl Fn() -> bool + Send + 'static {
        let publisher = self.page.publisher();
        move || publisher.are_frames_wanted()
    }

    /// Returns whether the user wants to end the recording.
    pub fn is_finish_asked(&self) -> bool {
        self.page.is_finish_asked()
    }

    fn context(&self) -> MutexGuard<'_, Context> {
        self.context.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the number of lost events and transfers to show.
    pub fn set_losses(&self, losses: Losses) {
        self.context().losses = losses;
    }

    fn publish(&self, phase: Phase, sensor: Sensor, seen: &Seen, outcome: Option<&Outcome>) {
        let context = *self.context();
        let state = ended(phase, [sensor.width, sensor.height], seen, context, outcome);
        self.page.publisher().publish(&state, &[], &[]);
    }

    /// Shows that the recording has ended and the calibration is running.
    pub fn calibrating(&self, sensor: Sensor, seen: &Seen) {
        self.step_listener(sensor, seen)("", None);
    }

    /// Shows the steps of the calibration after the recording.
    pub fn step_listener(&self, sensor: Sensor, seen: &Seen) -> Listener {
        let (publisher, context, seen) = (self.page.publisher(), *self.context(), seen.clone());
        let mut shown: Option<(String, Instant)> = None;
        Box::new(move |text, done| {
            let is_known = |(before, at): &(String, Instant)| before == text && at.elapsed() < PATIENCE;
            if shown.as_ref().is_some_and(is_known) {
                return;
            }
            shown = Some((text.to_owned(), Instant::now()));
            let step = CalibrationStep { text: text.to_owned(), done };
            publisher.publish(&calibrating([sensor.width, sensor.height], &seen, context, step), &[], &[]);
        })
    }

    /// Shows the beginning of a recording that is calibrated together with `before` earlier ones.
    pub fn begin(&self, before: usize) {
        let mut context = self.context();
        (context.losses, context.before) = (Losses::default(), before);
        drop(context);
        self.page.begin();
    }

    /// Shows the result of the calibration until the user closes the page or the program, or starts another recording, if that
    /// `is_possible`.
    pub fn finish(
        &self,
        sensor: Sensor,
        seen: &Seen,
        folder: &OutputFolder,
        calibrated: &super::super::Outcome,
        is_possible: bool,
    ) -> Next {
        let failure = calibrated.as_ref().err().filter(|failure| !failure.is_negative());
        let outcome = match failure {
            Some(failure) => Err(failure.advised()),
            None => self.outcome(folder.path(), seen).map_err(|error| error.to_string()),
        };
        let (phase, outcome) = match outcome {
            Ok(outcome) => (Phase::Done, outcome),
            Err(verdict) => (Phase::Failed, Outcome { verdict, ..Outcome::default() }),
        };
        self.publish(phase, sensor, seen, Some(&Outcome { can_record: is_possible, ..outcome }));
        if self.page.is_watched(GONE) {
            print::aside(
                "the page shows the result; evcal ends 10 s after you close the tab, or with \"Close evcal\" or Ctrl-C",
            );
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

    /// Reads the results from their folder, and lets the page link to the files.
    fn outcome(&self, folder: &Path, seen: &Seen) -> Result<Outcome, Box<dyn Error>> {
        let calibration: CalibrationFile = serde_json::from_str(&fs::read_to_string(folder.join("calibration.json"))?)?;
        let report = fs::read_to_string(folder.join("report.html"))?;
        let names: Vec<String> = results_in(folder).into_iter().map(|file| file.name).collect();
        let paths = self.page.set_files(folder, &names);
        let camera = calibration.camera.camera()?;
        let parameters = camera.parameters();
        let parameter = |index: usize| parameters.get(index).copied().unwrap_or(f64::NAN);
        // Without tilts, even a small reported error is not reliable.
        let is_target_met = seen.coverage.missing.is_empty()
            && calibration.verdict.grade != Grade::NotGood
            && calibration.uncertainty.projection_rms <= seen.target;
        Ok(Outcome {
            is_target_met,
            verdict: calibration.verdict.sentence,
            model: calibration.camera.model,
            matrix: [[parameter(0), 0.0, parameter(2)], [0.0, parameter(1), parameter(3)], [0.0, 0.0, 1.0]],
            distortion: parameters.get(4..).unwrap_or_default().to_vec(),
            sigma: Some(calibration.uncertainty.projection_rms),
            folder: visible::path(folder),
            report: Some(self.page.set_report(report)),
            files: names.into_iter().zip(paths).map(|(name, path)| FileLink { name, path }).collect(),
            can_record: false,
        })
    }
}

/// A handle that shows pictures on the page.
pub struct Screen {
    publisher: Publisher,
    context: Arc<Mutex<Context>>,
    /// Recording whose frames are read as soon as the page shows frames.
    recording: Option<Recording>,
    frames: Option<FrameFeed>,
}

impl Screen {
    /// Shows a picture with the latest observations, and the frame of the recording at that time if the page shows frames.
    pub fn show(&mut self, picture: &EventPicture, latest: &Latest) {
        let frame = match self.publisher.are_frames_wanted() {
            true => {
                if let Some(recording) = self.recording.take() {
                    self.frames = Some(FrameFeed::start(recording));
                }
                self.frames.as_ref().and_then(|frames| frames.at(picture.seconds()))
            }
            false => None,
        };
        self.show_with(picture, frame.as_deref(), latest);
    }

    /// Shows a picture and a frame with the latest observations.
    pub fn show_with(&self, picture: &EventPicture, frame: Option<&GreyImage>, latest: &Latest) {
        let shows_frames = self.publisher.are_frames_wanted();
        let context = Context { shows_frames, ..*self.context.lock().unwrap_or_else(PoisonError::into_inner) };
        let seen = latest.get();
        let pixels = frame.map_or(&[][..], |frame| &frame.pixels);
        self.publisher.publish(&observing(picture, frame, &seen, context), picture.pixels(), pixels);
    }
}
