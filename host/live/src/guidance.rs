//! Guidance for the board: the pose that would reduce the uncertainty of the camera most.
//!
//! Every window with the board adds its information about the intrinsics ([`evcal_solve::initial::information`]).
//! The value of a pose is the amount by which one second at this pose reduces the projection's mean variance over the
//! sensor. The information at a pose is averaged over the typical errors of a person's hands (`board_pose`). The best
//! pose becomes the *ghost*. It stays until most of its value has been gained, until the board does not come nearer any
//! more, or until another pose is worth much more. Time is the sensor's, so the same recording produces the same hints.
//!
//! The camera used here is provisional: an ordinary lens (`radtan`) estimated from the windows so far, and again
//! whenever their number has doubled. Its uncertainty ([`Guidance::sigma`]) is based on windows alone and therefore
//! larger than the uncertainty of a calibration of the same recording.

mod board_pose;
mod hint;
#[cfg(test)]
mod tests;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Point3, Vector2};

use self::board_pose::{Candidate, candidates, expected_information};
use self::hint::{choose, errors};
use evcal_detection::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use evcal_geometry::board::Board;
use evcal_solve::initial::InitialSettings;
use evcal_solve::initial::information::{Information, ProjectionMeasure, prior, sigma_in_cells, view_information};
use evcal_solve::initial::provisional::{provisional_camera, provisional_pose};

pub use self::board_pose::BoardPose;
pub use self::hint::{Hint, Swing};

/// Interval between windows that count fully (s); after a shorter interval a window counts in proportion to it.
const WINDOW: f64 = 0.1;
/// Number of windows that one second at a pose is worth.
const WINDOWS_OF_A_STAY: f64 = 10.0;
/// Largest number of views stored; when there are more, every second one is dropped.
const MOST_VIEWS: usize = 1024;
/// Number of views from which the first camera is estimated.
const FIRST_VIEWS: u64 = 24;
/// Largest number of views among which the views for a camera are chosen.
const CAMERA_VIEWS: usize = 128;
/// Interval at which the ghost is reconsidered (s).
const THINK: f64 = 0.5;
/// The ghost moves on when this fraction of its value has been gained.
const ENOUGH_OF_A_PLACE: f64 = 0.8;
/// The ghost moves on when the board was near it for this time (s).
const LONGEST_VISIT: f64 = 2.0;
/// The ghost moves on when the board has not come nearer for this time (s).
const PATIENCE: f64 = 4.0;
/// The ghost moves to another pose whose value is larger by this factor.
const WORTH_CHANGE: f64 = 1.5;
/// Shortest time for which the ghost stays (s).
const SHORTEST_STAY: f64 = 2.0;
/// A board that was not seen for this time is lost (s).
const LOST_AFTER: f64 = 1.0;
/// Largest error of a board that is near the ghost, in units of the tolerance of the hints.
const NEAR: f64 = 1.5;
/// Number of points of the outline on each side of the board.
const POINTS_A_SIDE: usize = 6;

/// One window with the board.
struct View {
    t: f64,
    circles: Vec<ObservedCircle>,
    weight: f64,
}

/// The target pose of the board.
#[derive(Clone, Copy, Debug)]
struct Ghost {
    place: BoardPose,
    /// Information of one window at this pose.
    information: Information,
    /// Start time.
    since: f64,
    /// Variance of the projection when the ghost was chosen, and expected variance after one second there (px²).
    variance: (f64, f64),
    /// Smallest error so far, and its time.
    nearest: (f64, f64),
    /// Time at which the board was first near it.
    reached: Option<f64>,
}

/// The ghost in the image.
#[derive(Clone, Debug, PartialEq)]
pub struct GhostOutline {
    /// Outline of the board (px), clockwise on the print from the corner next to the first circle.
    pub outline: Vec<Vector2<f64>>,
    /// The corners of this outline that the lens sees, in the same order.
    pub corners: Vec<Vector2<f64>>,
    /// Fraction of its value gained, 0 to 1.
    pub gained: f64,
    /// Distance of the board from it, in units of the tolerance; `None` while the board is not seen.
    pub distance: Option<f64>,
    /// Motion of the board once it is there.
    pub swing: Swing,
}

/// Knowledge of the camera, target pose of the board, and current hint.
pub struct Guidance {
    board: Board,
    sensor: Sensor,
    settings: InitialSettings,
    views: Vec<View>,
    seen: u64,
    next_camera: u64,
    camera: Camera<f64>,
    is_estimated: bool,
    measure: Option<ProjectionMeasure>,
    information: Information,
    /// The marked time, and the information up to it.
    mark: Option<(f64, Information)>,
    candidates: Vec<Candidate>,
    latest: Option<(f64, Isometry3<f64>)>,
    thought: Option<f64>,
    ghost: Option<Ghost>,
    /// Number of ghosts whose value has been gained.
    used_up: u64,
    hint: Hint,
}

impl Guidance {
    /// Creates a guidance for `board` and a camera with this sensor, without any view.
    pub fn new(board: &Board, sensor: Sensor, settings: &InitialSettings) -> Option<Self> {
        // 53° across until the views determine it.
        let (width, height) = (f64::from(sensor.width), f64::from(sensor.height));
        let start = [width, width, 0.5 * (width - 1.0), 0.5 * (height - 1.0), 0.0, 0.0, 0.0, 0.0, 0.0];
        let camera = Camera::from_parameters(ModelKind::Radtan, &start)?;
        let mut guidance = Self {
            board: *board,
            sensor,
            settings: settings.clone(),
            views: Vec::new(),
            seen: 0,
            next_camera: FIRST_VIEWS,
            camera,
            is_estimated: false,
            measure: None,
            information: Information::zeros(),
            mark: None,
            candidates: Vec::new(),
            latest: None,
            thought: None,
            ghost: None,
            used_up: 0,
            hint: Hint::Show,
        };
        guidance.rebuild();
        Some(guidance)
    }

    /// Returns the provisional camera; `None` until the views determine it.
    pub fn camera(&self) -> Option<&Camera<f64>> {
        self.is_estimated.then_some(&self.camera)
    }

    /// Returns the root mean square over the sensor of the projection's standard deviation (px), from windows alone
    /// (the quick estimate); `None` before the first camera.
    pub fn sigma(&self) -> Option<f64> {
        self.camera()?;
        self.measure.as_ref()?.sigma(&self.information)
    }

    /// Returns the root mean square of the standard deviation (px) in each cell, row by row, if the sensor is divided
    /// into columns and rows; `None` for cells that the lens does not see.
    pub fn sigma_in_cells(&self, columns: u16, rows: u16) -> Option<Vec<Option<f64>>> {
        sigma_in_cells(self.camera()?, self.sensor, columns, rows, &self.information)
    }

    /// Starts another recording of the same camera with its own clock; the knowledge of the camera is kept.
    pub fn begin_again(&mut self) {
        self.views.iter_mut().for_each(|view| view.t = f64::NEG_INFINITY);
        (self.mark, self.latest, self.thought, self.ghost) = (None, None, None, None);
        self.hint = Hint::Show;
    }

    /// Marks a time, from which [`Guidance::ratio_since_mark`] counts.
    pub fn mark(&mut self, t: f64) {
        self.mark = Some((t, self.information_until(t)));
    }

    /// Returns the ratio of [`Guidance::sigma`] now to its value at the marked time, both computed with the current
    /// camera: at most 1.
    pub fn ratio_since_mark(&self) -> Option<f64> {
        let (_, before) = self.mark.as_ref()?;
        Some((self.sigma()? / self.measure.as_ref()?.sigma(before)?).min(1.0))
    }

    /// Returns the current hint for the board.
    pub fn hint(&self) -> Hint {
        self.hint
    }

    /// Returns the pose of the ghost.
    pub fn place(&self) -> Option<BoardPose> {
        self.ghost.map(|ghost| ghost.place)
    }

    /// Returns the number of ghosts whose value has been gained.
    pub fn used_up(&self) -> u64 {
        self.used_up
    }

    /// Returns the ghost in the image.
    pub fn ghost(&self) -> Option<GhostOutline> {
        let ghost = self.ghost.as_ref()?;
        let pose = ghost.place.pose(&self.board);
        let project = |point: &Vector2<f64>| self.camera.project(&(pose * Point3::new(point.x, point.y, 0.0)).coords);
        let corners = corners(&self.board);
        let ends = corners.iter().zip(corners.iter().cycle().skip(1));
        let outline = ends.flat_map(|(from, to)| {
            (0..POINTS_A_SIDE).map(move |step| from.lerp(to, step as f64 / POINTS_A_SIDE as f64))
        });
        Some(GhostOutline {
            outline: outline.filter_map(|point| project(&point)).collect(),
            corners: corners.iter().filter_map(project).collect(),
            gained: self.gained(ghost).unwrap_or(0.0).clamp(0.0, 1.0),
            distance: self.latest.filter(|_| self.hint != Hint::Lost).and_then(|(_, pose)| self.error_of_ghost(&pose)),
            swing: Swing::of(&ghost.place),
        })
    }

    /// Adds a window with the board.
    pub fn add(&mut self, frame: &ReferenceFrame) {
        let since = self.latest.map_or(WINDOW, |(t, _)| frame.t() - t);
        let weight = (since / WINDOW).clamp(0.0, 1.0);
        let view = View { t: frame.t(), circles: frame.circles.clone(), weight };
        let Some(pose) = provisional_pose(&self.camera, &view.circles, &self.board) else { return };
        self.latest = Some((frame.t(), pose));
        self.seen += 1;
        if let Some(information) = self.information_of(&view, &pose) {
            self.information += information;
        }
        self.views.push(view);
        if self.views.len() > MOST_VIEWS {
            let mut index = 0;
            self.views.retain_mut(|view| {
                index += 1;
                view.weight *= 2.0;
                index % 2 == 0
            });
        }
        if self.seen >= self.next_camera {
            self.next_camera *= 2;
            self.estimate();
        }
    }

    /// Updates the ghost and the hint at time `now` (s of the sensor).
    pub fn advise(&mut self, now: f64) {
        if self.seen > 0 && self.thought.is_none_or(|thought| now - thought >= THINK) {
            self.thought = Some(now);
            self.think(now);
        }
        self.hint = match (self.latest, self.seen) {
            (_, 0) | (None, _) => Hint::Show,
            (Some((t, _)), _) if now - t > LOST_AFTER => Hint::Lost,
            (Some((_, pose)), _) => {
                let width = f64::from(self.sensor.width);
                let errors = self.ghost.as_ref().and_then(|ghost| {
                    Some(errors(&self.seen_at(&pose)?, &self.seen_at(&ghost.place.pose(&self.board))?, width))
                });
                match (errors.map_or(Hint::Stay, |errors| choose(&errors, self.hint)), &self.ghost) {
                    (Hint::Stay, Some(ghost)) => Hint::Swing(Swing::of(&ghost.place)),
                    (hint, _) => hint,
                }
            }
        };
    }

    fn seen_at(&self, pose: &Isometry3<f64>) -> Option<hint::Seen> {
        let middle = self.board.middle();
        let middle = (pose * Point3::new(middle.x, middle.y, 0.0)).coords;
        Some(hint::Seen { pose: *pose, middle, pixel: self.camera.project(&middle)? })
    }

    fn information_of(&self, view: &View, pose: &Isometry3<f64>) -> Option<Information> {
        let points = view.circles.iter().map(|circle| self.board.point(circle.index));
        Some(view_information(&self.camera, pose, points)? * view.weight)
    }

    /// Estimates a new camera from the views.
    fn estimate(&mut self) {
        let step = self.views.len().div_ceil(CAMERA_VIEWS).max(1);
        let views: Vec<&[ObservedCircle]> =
            self.views.iter().step_by(step).map(|view| view.circles.as_slice()).collect();
        let camera = provisional_camera(&views, &self.board, self.sensor, ModelKind::Radtan, &self.settings);
        if let Some(camera) = camera {
            self.camera = camera;
            self.is_estimated = true;
            self.rebuild();
        }
    }

    /// Recomputes everything that depends on the camera.
    fn rebuild(&mut self) {
        self.measure = ProjectionMeasure::new(&self.camera, self.sensor);
        self.candidates = candidates(&self.camera, &self.board, self.sensor);
        self.information = self.information_until(f64::INFINITY);
        if let Some((t, _)) = self.mark {
            self.mark(t);
        }
        if let Some(place) = self.place() {
            let information = expected_information(&self.camera, &self.board, self.sensor, &place);
            let variance = (self.variance(None), self.variance(Some(&information)));
            if let (Some(ghost), (Some(before), Some(after))) = (&mut self.ghost, variance) {
                (ghost.information, ghost.variance) = (information, (before, after));
            }
        }
    }

    /// Returns the information of the windows up to `t`.
    fn information_until(&self, t: f64) -> Information {
        let mut sum = prior(&self.camera);
        for view in self.views.iter().filter(|view| view.t <= t) {
            let pose = provisional_pose(&self.camera, &view.circles, &self.board);
            if let Some(information) = pose.and_then(|pose| self.information_of(view, &pose)) {
                sum += information;
            }
        }
        sum
    }

    /// Returns the mean variance of the projection (px²), now or after a stay at a pose with this information.
    fn variance(&self, stay: Option<&Information>) -> Option<f64> {
        let information = stay.map_or(self.information, |stay| self.information + stay * WINDOWS_OF_A_STAY);
        Some(self.measure.as_ref()?.sigma(&information)?.powi(2))
    }

    /// Returns the fraction of the ghost's value that has been gained.
    fn gained(&self, ghost: &Ghost) -> Option<f64> {
        let (before, after) = ghost.variance;
        Some((before - self.variance(None)?) / (before - after))
    }

    /// Keeps the ghost or chooses another.
    fn think(&mut self, now: f64) {
        if let Some((_, pose)) = self.latest.filter(|(t, _)| now - t <= LOST_AFTER)
            && let Some(error) = self.error_of_ghost(&pose)
            && let Some(ghost) = &mut self.ghost
        {
            if error < ghost.nearest.0 {
                ghost.nearest = (error, now);
            }
            if error < NEAR {
                ghost.reached.get_or_insert(now);
            }
        }
        let Some(variance) = self.variance(None) else { return };
        let worth = |information: &Information| self.variance(Some(information)).map(|after| variance - after);
        // A pose that was given up is not chosen next, because a person who could not reach it before cannot reach it
        // now.
        let before = self.place();
        let others = self.candidates.iter().filter(|candidate| Some(candidate.place) != before);
        let mut best: Option<(f64, Candidate)> = None;
        for candidate in others {
            if let Some(worth) = worth(&candidate.information)
                && best.is_none_or(|(most, _)| worth > most)
            {
                best = Some((worth, *candidate));
            }
        }
        let Some((most, candidate)) = best else { return };
        let stays = self.ghost.as_ref().is_some_and(|ghost| {
            let is_young = now - ghost.since < SHORTEST_STAY;
            let is_used = self.gained(ghost).is_none_or(|gained| gained >= ENOUGH_OF_A_PLACE);
            let is_visited = ghost.reached.is_some_and(|reached| now - reached >= LONGEST_VISIT);
            let is_stuck = now - ghost.nearest.1 > PATIENCE || is_visited;
            let is_poor = worth(&ghost.information).is_none_or(|worth| most > WORTH_CHANGE * worth);
            !is_used && (is_young || !(is_stuck || is_poor))
        });
        if !stays {
            let is_used = self
                .ghost
                .as_ref()
                .and_then(|ghost| self.gained(ghost))
                .is_some_and(|gained| gained >= ENOUGH_OF_A_PLACE);
            self.used_up += u64::from(is_used);
            self.ghost = Some(Ghost {
                place: candidate.place,
                information: candidate.information,
                since: now,
                variance: (variance, variance - most),
                nearest: (f64::INFINITY, now),
                reached: None,
            });
        }
    }

    /// Returns the distance of a board from the ghost, in units of the tolerance.
    fn error_of_ghost(&self, pose: &Isometry3<f64>) -> Option<f64> {
        let goal = self.ghost.as_ref()?.place.pose(&self.board);
        let errors = errors(&self.seen_at(pose)?, &self.seen_at(&goal)?, f64::from(self.sensor.width));
        Some(errors.iter().map(|(_, error)| *error).fold(0.0, f64::max))
    }
}

/// Returns the corners of the printed board (m), clockwise on the print: a spacing beyond its outermost circles, or a
/// square or module beyond its outermost corners.
pub fn corners(board: &Board) -> [Vector2<f64>; 4] {
    let (low, high) = board.extent();
    let margin = match board {
        Board::Circles(board) => board.spacing,
        Board::Squares(board) => board.module(),
    };
    let (low, high) = (low.add_scalar(-margin), high.add_scalar(margin));
    [low, Vector2::new(high.x, low.y), high, Vector2::new(low.x, high.y)]
}
