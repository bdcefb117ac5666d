//! All events in two pictures: on the sensor, and transformed to the board.

use maud::html;
use nalgebra::Vector2;
use rayon::prelude::*;

use super::example_frames::{figure, scale};
use super::number::count;
use super::page::Section;
use crate::report::drawing::{OFF, ON, Picture};
use evcal_calibrate::calibrate::calibrated::{Calibrated, EventCalibration};
use evcal_calibrate::task::Task;
use evcal_core::event::Polarity;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::Board;
use evcal_solve::solve::event_sample::{RankedEvent, Run};
use evcal_solve::solve::residual_statistics::Measured;
use evcal_solve::solve::rows::bearing_table::BearingTable;
use evcal_solve::solve::rows::board_ray::{BoardRay, is_in_front};
use evcal_solve::solve::rows::board_surface::{BoardGround, BoardSurface};
use evcal_solve::solve::rows::pose_bin::PoseBin;
use evcal_solve::trajectory::Trajectory;

/// Columns of the picture of the board: its pixels are smaller than sensor pixels.
const BOARD_COLUMNS: u16 = 800;
/// Parts of a recording, which have a picture each. The number is independent of the number of threads.
const PIECES: usize = 2;
/// Time over which the motion of the camera is approximated as uniform (s).
const BIN: f64 = 0.5e-3;

/// Number of events in each pixel of a picture.
struct Accumulation {
    size: Sensor,
    /// By the index of the polarity.
    counts: Vec<[u32; 2]>,
}

impl Accumulation {
    fn new(size: Sensor) -> Self {
        Self { size, counts: vec![[0; 2]; size.pixel_count()] }
    }

    fn add(&mut self, place: Vector2<f64>, polarity: Polarity) {
        // Conversions to integers round down.
        let (column, row) = (place.x + 0.5, place.y + 0.5);
        if !(column >= 0.0 && row >= 0.0 && column < f64::from(self.size.width) && row < f64::from(self.size.height)) {
            return;
        }
        if let Some(counts) = self.counts.get_mut(row as usize * usize::from(self.size.width) + column as usize) {
            counts[polarity.index()] += 1;
        }
    }

    /// Adds the counts of another picture of the same size.
    fn include(&mut self, other: &Self) {
        let counts = self.counts.as_flattened_mut().iter_mut();
        counts.zip(other.counts.as_flattened()).for_each(|(count, more)| *count += more);
    }

    /// Returns the count of one polarity that 0.5 % of the pixels with such events exceed.
    fn brightest(&self, polarity: Polarity) -> f64 {
        let counts = self.counts.iter().map(|counts| counts[polarity.index()]);
        let mut counts: Vec<u32> = counts.filter(|&count| count > 0).collect();
        let place = counts.len().saturating_sub(1 + counts.len() / 200);
        if counts.is_empty() { 0.0 } else { f64::from(*counts.select_nth_unstable(place).1) }
    }

    /// Returns a picture that is white without events and takes on the colours [`ON`] and [`OFF`] with the number of events.
    fn picture(&self, scale: f64) -> Picture {
        let full = self.brightest(Polarity::On).max(self.brightest(Polarity::Off)).max(1.0);
        let share = |count: u32| (f64::from(count) / full).sqrt().min(1.0);
        Picture::of_sensor(self.size, scale, |place| {
            let (column, row) = (place.x.round().max(0.0) as usize, place.y.round().max(0.0) as usize);
            let index = row * usize::from(self.size.width) + column;
            let counts = self.counts.get(index).copied().unwrap_or_default();
            let (on, off) = (share(counts[Polarity::On.index()]), share(counts[Polarity::Off.index()]));
            let absorbed = |color: u8, share: f64| 1.0 - share * (1.0 - f64::from(color) / 255.0);
            std::array::from_fn(|channel| {
                (255.0 * absorbed(ON[channel], on) * absorbed(OFF[channel], off)).round() as u8
            })
        })
    }
}

/// Returns both pictures; `None` if the input is not events.
pub fn section(calibrated: &Calibrated, task: &Task) -> Option<Section> {
    let events = calibrated.events()?;
    if events.measured == Measured::CircleCentres {
        return None;
    }
    let bearings = BearingTable::new(calibrated.camera(), calibrated.sensor);
    let frame = BoardFrame::new(task.board, BOARD_COLUMNS);
    let carry = |recording: usize, piece: &[Run]| {
        let (mut sensor, mut board, mut used) =
            (Accumulation::new(calibrated.sensor), Accumulation::new(frame.size), 0_u64);
        let mut carrier = Carrier::new(events, recording, &bearings);
        for event in piece.iter().flat_map(Run::events) {
            if let Some(point) = carrier.carry(&event) {
                used += 1;
                sensor.add(Vector2::new(f64::from(event.x), f64::from(event.y)), event.polarity);
                board.add(frame.place(point), event.polarity);
            }
        }
        (sensor, board, used)
    };
    // There are few pieces, because the pictures of a piece need more memory than its events.
    let pieces: Vec<(usize, &[Run])> = (0..task.inputs.len())
        .flat_map(|recording| {
            let runs = events.sample.runs(recording);
            let piece = runs.len().div_ceil(PIECES).max(1);
            runs.chunks(piece).map(move |piece| (recording, piece))
        })
        .collect();
    let carried = pieces.into_par_iter().map(|(recording, piece)| carry(recording, piece));
    let (sensor, board, used) = carried.reduce_with(|(mut sensor, mut board, used), (on_sensor, on_board, more)| {
        sensor.include(&on_sensor);
        board.include(&on_board);
        (sensor, board, used + more)
    })?;
    if used == 0 {
        return None;
    }
    let (on_sensor, on_board) = rayon::join(
        || {
            figure(
                &sensor.picture(scale(calibrated.sensor).min(2.0)),
                "Events of the whole recording on the sensor: blurred.",
                "On the sensor.",
            )
        },
        || figure(&board.picture(1.0), "The same events on the board: the edges of its print.", "On the board."),
    );
    let content = html! {
        p {
            "Both pictures show the same " (count(used)) " events. On the sensor, the moving board is blurred. On the board, each event "
            "is projected with the calibrated lens and the pose of the camera at the event's own time: the better the calibration, "
            "the sharper the edges."
        }
        div.pair {
            (on_sensor)
            (on_board)
        }
    };
    Some(Section { id: "accumulation", title: "All events on the board", folded: false, content })
}

/// The relation between points of the board and pixels of its picture.
pub struct BoardFrame {
    corner: Vector2<f64>,
    pixels_per_metre: f64,
    /// Width and height of the picture (px).
    pub size: Sensor,
}

impl BoardFrame {
    /// Fits a picture around all points of `board` with a margin: `columns` wide, or less if it would be more than
    /// twice as high as wide.
    pub fn new(board: &Board, columns: u16) -> Self {
        let (low, high) = board.extent();
        let margin = Vector2::repeat(0.6 * board.print_period());
        let corner = low - margin;
        let extent = high + margin - corner;
        let (columns, most_rows) = (f64::from(columns), 2.0 * f64::from(columns));
        let pixels_per_metre = (columns / extent.x).min(most_rows / extent.y);
        let pixels = |metres: f64| (metres * pixels_per_metre).ceil().clamp(1.0, most_rows) as u16;
        Self { corner, pixels_per_metre, size: Sensor::new(pixels(extent.x), pixels(extent.y)) }
    }

    /// Returns the position of a point of the board (m) in the picture (px).
    pub fn place(&self, point: Vector2<f64>) -> Vector2<f64> {
        (point - self.corner) * self.pixels_per_metre
    }

    /// Returns the point of the board (m) at a position in the picture (px).
    pub fn point(&self, place: Vector2<f64>) -> Vector2<f64> {
        place / self.pixels_per_metre + self.corner
    }
}

/// Returns the point where a ray meets the print, if that is in front of the camera.
fn place<S: BoardSurface>(ray: &BoardRay<S>) -> Option<Vector2<f64>> {
    is_in_front(ray.depth()).then(|| ray.point())
}

/// Transforms the events of one recording to the board.
struct Carrier<'a> {
    trajectories: Vec<&'a Trajectory>,
    bearings: &'a BearingTable,
    ground: BoardGround,
    bin: i64,
    pose: Option<PoseBin>,
}

impl<'a> Carrier<'a> {
    fn new(events: &'a EventCalibration, recording: usize, bearings: &'a BearingTable) -> Self {
        let trajectories = events.refined.state.trajectories.iter();
        let trajectories = trajectories.filter(|trajectory| trajectory.recording == recording).collect();
        let ground = BoardGround::of_problem(&events.refined.problem, &events.refined.state.board);
        Self { trajectories, bearings, ground, bin: i64::MIN, pose: None }
    }

    /// Returns the position of the event on the print (m); `None` outside the trajectories.
    fn carry(&mut self, event: &RankedEvent) -> Option<Vector2<f64>> {
        let t = event.t as f64 * 1e-6;
        let bin = (t / BIN).floor() as i64;
        let middle = (bin as f64 + 0.5) * BIN;
        if bin != self.bin {
            self.bin = bin;
            self.pose = self.trajectories.iter().find_map(|trajectory| PoseBin::new(trajectory, middle));
        }
        let pose = self.pose.as_ref()?;
        let (bearing, _) = self.bearings.place(f64::from(event.x), f64::from(event.y))?.bearing();
        let dt = t - middle;
        match &self.ground {
            BoardGround::Flat(surface) => place(&BoardRay::new(surface, pose, dt, &bearing)),
            BoardGround::Shaped(surface) => place(&BoardRay::new(surface, pose, dt, &bearing)),
        }
    }
}
