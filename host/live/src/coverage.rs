//! Coverage of the sensor by the board, and tilts of the board.

use evcal_core::sensor::Sensor;
use nalgebra::{Matrix3, Vector2};

use super::wanted::Requirement;
use evcal_calibrate::settings::LiveSettings;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_geometry::board::Board;
use evcal_geometry::board::homography::{homography, pose_from_homography};

/// Smallest number of windows with the board.
pub(crate) const BOARDS: u64 = 200;
/// Columns and rows of the cells of the sensor.
const COLUMNS: u16 = 8;
const ROWS: u16 = 6;
/// Smallest number of circles in a covered cell.
const CIRCLES_PER_CELL: u64 = 5;
/// Smallest angle between board and sensor that counts as a tilt (°).
const TILT: f64 = 15.0;

/// Largest number of views whose tilts are computed again when the estimate of the focal length improves. After this
/// number the estimate hardly changes.
const MOST_VIEWS: usize = 2048;

/// The side of the board that is nearest to the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Tilt {
    /// The left side, as the camera sees it.
    Left,
    /// The right side.
    Right,
    /// The upper side.
    Top,
    /// The lower side.
    Bottom,
}

impl Tilt {
    /// All sides, in the order in which they are counted.
    pub const ALL: [Self; 4] = [Self::Left, Self::Right, Self::Top, Self::Bottom];

    /// Returns the side as seen by the camera, or in a mirror.
    pub const fn seen(self, mirrored: bool) -> Self {
        match (self, mirrored) {
            (Self::Left, true) => Self::Right,
            (Self::Right, true) => Self::Left,
            (side, _) => side,
        }
    }

    /// Returns the name for the user.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Top => "top",
            Self::Bottom => "bottom",
        }
    }
}

/// Names of the board's distances for the user, nearest first.
pub const DISTANCES: [&str; 3] = ["near", "middle", "far"];
/// Smallest ratio of the board's longer side to the sensor's shorter side that counts as near, and as middle.
const NEAR: [f64; 2] = [0.75, 0.5];

/// Summary of the coverage so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoverageSummary {
    /// Windows with the board.
    pub boards: u64,
    /// Fraction of the sensor's cells in which circles were seen, 0 to 1.
    pub covered: f64,
    /// Columns and rows of cells.
    pub size: (u16, u16),
    /// Fill level of each cell, 0 to 1, row by row.
    pub cells: Vec<f64>,
    /// Windows with the board tilted to each side, in the order of [`Tilt::ALL`].
    pub tilts: [u64; 4],
    /// Windows with the board at each of [`DISTANCES`].
    pub distances: [u64; 3],
    /// Remaining requirements; empty if enough was seen.
    pub missing: Vec<Requirement>,
    /// Fulfilled fraction of each criterion, 0 to 1: windows with the board, coverage of the sensor, tilts.
    pub fulfilled: [f64; 3],
}

/// Coverage so far.
///
/// Tilts require the focal length. While it is unknown, it is estimated from all views so far by Zhang's method for
/// square pixels without distortion and a principal point in the middle of the sensor. The error is a few per cent,
/// which is enough to distinguish 15° from 0°.
#[derive(Clone, Debug)]
pub struct LiveCoverage {
    settings: LiveSettings,
    board: Board,
    sensor: Sensor,
    cells: Vec<u64>,
    /// One homography per view, for the latest views. It maps the board (in periods of its print) to the image
    /// (relative to the middle of the sensor, in widths of the sensor).
    views: Vec<Matrix3<f64>>,
    /// Numbers of earlier views with the board tilted to each side.
    settled: [u64; 4],
    boards: u64,
    distances: [u64; 3],
    /// Focal length in widths of the sensor, if a camera is known.
    focal_length: Option<f64>,
}

impl LiveCoverage {
    /// Creates an empty coverage of a sensor of this size.
    pub fn new(settings: &LiveSettings, board: &Board, sensor: Sensor) -> Self {
        let cells = vec![0; usize::from(COLUMNS) * usize::from(ROWS)];
        Self {
            settings: settings.clone(),
            board: *board,
            sensor,
            cells,
            views: Vec::new(),
            settled: [0; 4],
            boards: 0,
            distances: [0; 3],
            focal_length: None,
        }
    }

    /// Adds a window with the board.
    pub fn add(&mut self, frame: &ReferenceFrame) {
        let (width, height) = (f64::from(self.sensor.width), f64::from(self.sensor.height));
        let cell = |position: f64, size: f64, count: u16| {
            let cell = (position + 0.5) / size * f64::from(count);
            (cell.max(0.0) as usize).min(usize::from(count) - 1)
        };
        for circle in &frame.circles {
            let index =
                cell(circle.center.y, height, ROWS) * usize::from(COLUMNS) + cell(circle.center.x, width, COLUMNS);
            if let Some(cell) = self.cells.get_mut(index) {
                *cell += 1;
            }
        }
        let plane: Vec<Vector2<f64>> =
            frame.circles.iter().map(|circle| self.board.point(circle.index) / self.board.print_period()).collect();
        let middle = Vector2::new(0.5 * (width - 1.0), 0.5 * (height - 1.0));
        let image: Vec<Vector2<f64>> = frame.circles.iter().map(|circle| (circle.center - middle) / width).collect();
        let Some(view) = homography(&plane, &image) else { return };
        let size = self.apparent_size(&view);
        let distance = NEAR.iter().position(|least| size >= *least).unwrap_or(NEAR.len());
        if let Some(count) = self.distances.get_mut(distance) {
            *count += 1;
        }
        self.boards += 1;
        self.views.push(view);
        if self.views.len() > MOST_VIEWS {
            let recent = self.views.split_off(MOST_VIEWS / 2);
            self.settled = self.tilts();
            self.views = recent;
        }
    }

    /// Returns the ratio of the board's longer side in the image to the sensor's shorter side, without the effect of
    /// tilt.
    fn apparent_size(&self, view: &Matrix3<f64>) -> f64 {
        let middle = self.board.middle() / self.board.print_period();
        let point = view * middle.push(1.0);
        // |∂(u, v)/∂(x, y)| = |H| / z³ for a homography H.
        let scale = (view.determinant() / (point.z * point.z * point.z)).abs().sqrt();
        let (width, height) = (f64::from(self.sensor.width), f64::from(self.sensor.height));
        scale * self.board.longer_side() / self.board.print_period() * width / width.min(height)
    }

    /// Returns a summary of the coverage so far.
    pub fn summary(&self) -> CoverageSummary {
        let (covered, tilts) = (self.covered(), self.tilts());
        let share = |count: u64, wanted: u64| if wanted == 0 { 1.0 } else { count as f64 / wanted as f64 };
        let share_of_tilts = tilts.map(|count| share(count, self.settings.boards_per_tilt).min(1.0));
        let fulfilled = [
            share(self.boards(), BOARDS),
            if self.settings.coverage > 0.0 { covered / self.settings.coverage } else { 1.0 },
            share_of_tilts.iter().sum::<f64>() / share_of_tilts.len() as f64,
        ];
        CoverageSummary {
            boards: self.boards(),
            covered,
            size: (COLUMNS, ROWS),
            cells: self.cells.iter().map(|circles| share(*circles, CIRCLES_PER_CELL).min(1.0)).collect(),
            tilts,
            distances: self.distances,
            missing: self.remaining_requirements(covered, tilts),
            fulfilled: fulfilled.map(|share| share.clamp(0.0, 1.0)),
        }
    }

    /// Sets the focal length (px).
    pub fn set_focal_length(&mut self, focal_length: f64) {
        self.focal_length = Some(focal_length / f64::from(self.sensor.width));
    }

    /// Returns the number of windows with the board.
    pub fn boards(&self) -> u64 {
        self.boards
    }

    /// Returns the fraction of the sensor's cells in which circles were seen, 0 to 1.
    pub fn covered(&self) -> f64 {
        let covered = self.cells.iter().filter(|&&circles| circles >= CIRCLES_PER_CELL).count();
        covered as f64 / self.cells.len() as f64
    }

    /// Returns the number of windows with the board tilted to each side, in the order of [`Tilt::ALL`].
    pub fn tilts(&self) -> [u64; 4] {
        let focal_length = self.focal_length.unwrap_or_else(|| focal_length(&self.views));
        let mut counts = self.settled;
        for view in &self.views {
            let Some(tilt) = tilt(view, focal_length, TILT.to_radians()) else { continue };
            if let Some(count) = counts.get_mut(tilt as usize) {
                *count += 1;
            }
        }
        counts
    }

    /// Returns the remaining requirements; empty if enough was seen.
    pub fn missing(&self) -> Vec<Requirement> {
        self.remaining_requirements(self.covered(), self.tilts())
    }

    fn remaining_requirements(&self, covered: f64, tilts: [u64; 4]) -> Vec<Requirement> {
        let mut missing = Vec::new();
        if self.boards() < BOARDS {
            missing.push(Requirement::Views(BOARDS - self.boards()));
        }
        if covered < self.settings.coverage {
            let (x, y) = self.emptiest();
            missing.push(Requirement::Part(x, y));
        }
        for (tilt, count) in Tilt::ALL.into_iter().zip(tilts) {
            if count < self.settings.boards_per_tilt {
                missing.push(Requirement::Nearer(tilt, TILT));
            }
        }
        missing
    }

    /// Returns the ninth of the image with the least coverage, as column (−1 left, 0, 1 right) and row (−1 top, 0, 1
    /// bottom).
    fn emptiest(&self) -> (i8, i8) {
        const PARTS: [(i8, i8); 9] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (0, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];
        let (columns, rows) = (usize::from(COLUMNS), usize::from(ROWS));
        let mut cells = [(0, 0); 9];
        for (index, &circles) in self.cells.iter().enumerate() {
            let part = (index / columns) * 3 / rows * 3 + (index % columns) * 3 / columns;
            if let Some((covered, all)) = cells.get_mut(part) {
                *covered += usize::from(circles >= CIRCLES_PER_CELL);
                *all += 1;
            }
        }
        // Compares fractions without division; parts without cells count as full.
        let least = PARTS.iter().zip(cells).min_by(|(_, a), (_, b)| {
            let (a, b) = if a.1 == 0 || b.1 == 0 { (b.1, a.1) } else { (a.0 * b.1, b.0 * a.1) };
            a.cmp(&b)
        });
        least.map_or((0, 0), |(part, _)| *part)
    }
}

/// Estimates the focal length in widths of the sensor. The axes of the board are perpendicular and equally long, so
/// each view provides two linear equations for 1/f², which are solved by least squares. Returns one width, a field of
/// view of 53°, if the views do not determine it.
fn focal_length(views: &[Matrix3<f64>]) -> f64 {
    let (mut square, mut product) = (0.0, 0.0);
    for view in views {
        let (first, second) = (view.column(0), view.column(1));
        let scale = 0.5 * (first.xy().norm_squared() + second.xy().norm_squared());
        for (a, b) in [
            (first.xy().dot(&second.xy()), first.z * second.z),
            (first.xy().norm_squared() - second.xy().norm_squared(), first.z * first.z - second.z * second.z),
        ] {
            square += (a / scale) * (a / scale);
            product -= (a / scale) * (b / scale);
        }
    }
    let inverse_square = product / square;
    let focal_length = 1.0 / inverse_square.sqrt();
    // A field of view of 7° to 150°.
    if (0.13..8.0).contains(&focal_length) { focal_length } else { 1.0 }
}

/// Returns the nearest side, if the board is tilted by at least `least` (radians).
fn tilt(view: &Matrix3<f64>, focal_length: f64, least: f64) -> Option<Tilt> {
    let normalised =
        Matrix3::from_diagonal(&nalgebra::Vector3::new(1.0 / focal_length, 1.0 / focal_length, 1.0)) * view;
    let normal = pose_from_homography(&normalised)?.rotation * nalgebra::Vector3::z();
    let angle = normal.xy().norm().atan2(normal.z.abs());
    // Depth on the board decreases along the normal's direction in the image.
    let side = match (normal.x.abs() > normal.y.abs(), normal.x * normal.z > 0.0, normal.y * normal.z > 0.0) {
        (true, true, _) => Tilt::Right,
        (true, false, _) => Tilt::Left,
        (false, _, true) => Tilt::Bottom,
        (false, _, false) => Tilt::Top,
    };
    (angle >= least).then_some(side)
}

#[cfg(test)]
mod tests {
    use evcal_geometry::board::CircleBoard;
    use nalgebra::{Isometry3, Point3, Vector3};

    use super::*;
    use evcal_detection::circles::reference_frame::{ObservedCircle, SeenIn};

    const SENSOR: Sensor = Sensor::new(346, 260);

    fn board() -> CircleBoard {
        "acircles:9x4:55mm:r17.5mm".parse().unwrap()
    }

    /// Returns a view of the board rotated about its middle by `turn`, at `position`, through a pinhole of focal length
    /// `focal` px.
    fn view(turn: Vector3<f64>, position: Vector3<f64>, focal: f64) -> ReferenceFrame {
        let board = board();
        let pose = Isometry3::new(position, turn);
        let circles = (0..board.circle_count()).map(|index| {
            let point = board.circle_center(index) - board.middle();
            let point = pose * Point3::new(point.x, point.y, 0.0);
            let center = Vector2::new(focal * point.x / point.z + 172.5, focal * point.y / point.z + 129.5);
            ObservedCircle { index, t: 0.0, center, radius: None, velocity: None }
        });
        ReferenceFrame { recording: 0, start: 0.0, end: 0.0, circles: circles.collect(), seen_in: SeenIn::Circles }
    }

    fn ahead() -> Vector3<f64> {
        Vector3::new(0.0, 0.0, 1.0)
    }

    /// The number of views that are stored and processed again is limited.
    #[test]
    fn older_views_are_dropped_but_still_counted() {
        let mut coverage = LiveCoverage::new(&LiveSettings::default(), &board().into(), SENSOR);
        let tilted = [Vector3::new(0.0, 0.5, 0.0), Vector3::new(0.5, 0.0, 0.0)].map(|turn| view(turn, ahead(), 330.0));
        for frame in tilted.iter().cycle().take(5 * MOST_VIEWS) {
            coverage.add(frame);
        }
        assert_eq!(coverage.boards(), 5 * MOST_VIEWS as u64);
        assert!(coverage.views.len() <= MOST_VIEWS, "{}", coverage.views.len());
        let mut counts = coverage.tilts();
        counts.sort_unstable();
        let half = 5 * MOST_VIEWS as u64 / 2;
        assert_eq!(counts, [0, 0, half, half]);
    }

    #[test]
    fn tilts_are_named_after_the_nearer_side() {
        for focal in [150.0, 330.0, 700.0] {
            for turn in [[0.0, 0.4], [0.0, -0.4], [0.4, 0.0], [-0.4, 0.0]] {
                let turn = Vector3::new(turn[0], turn[1], 0.0);
                let frame = view(turn, ahead(), focal);
                // Direction in the image towards the circles that are nearer than the board's middle, which is 1 m
                // away.
                let pose = Isometry3::new(ahead(), turn);
                let mut nearer = Vector2::zeros();
                for circle in &frame.circles {
                    let point = board().circle_center(circle.index) - board().middle();
                    let depth = (pose * Point3::new(point.x, point.y, 0.0)).z;
                    nearer += (circle.center - Vector2::new(172.5, 129.5)) * (1.0 - depth);
                }
                let expected = match (nearer.x.abs() > nearer.y.abs(), nearer.x > 0.0, nearer.y > 0.0) {
                    (true, true, _) => Tilt::Right,
                    (true, false, _) => Tilt::Left,
                    (false, _, true) => Tilt::Bottom,
                    (false, _, false) => Tilt::Top,
                };
                let mut coverage = LiveCoverage::new(&LiveSettings::default(), &board().into(), SENSOR);
                coverage.add(&frame);
                let found = Tilt::ALL.into_iter().zip(coverage.tilts()).find(|(_, count)| *count == 1);
                assert_eq!(found.map(|(tilt, _)| tilt), Some(expected), "{focal} {turn:?}");
            }
        }
    }

    #[test]
    fn the_focal_length_follows_from_tilted_views() {
        for focal in [150.0, 330.0, 700.0] {
            let mut coverage = LiveCoverage::new(&LiveSettings::default(), &board().into(), SENSOR);
            for index in 0..12 {
                let angle = f64::from(index) * 0.5;
                coverage.add(&view(Vector3::new(0.3 * angle.sin(), 0.4 * angle.cos(), 0.2), ahead(), focal));
            }
            let found = focal_length(&coverage.views) * f64::from(SENSOR.width);
            assert!((found - focal).abs() < 1e-6 * focal, "{found} {focal}");
        }
        let mut frontal = LiveCoverage::new(&LiveSettings::default(), &board().into(), SENSOR);
        frontal.add(&view(Vector3::zeros(), ahead(), 330.0));
        assert_eq!(frontal.tilts(), [0; 4]);
    }

    #[test]
    fn missing_coverage_is_listed_until_it_is_sufficient() {
        let settings = LiveSettings { boards_per_tilt: 1, ..LiveSettings::default() };
        let mut coverage = LiveCoverage::new(&settings, &board().into(), SENSOR);
        assert_eq!(coverage.missing().len(), 6);
        for side in [-1.0, 1.0] {
            coverage.add(&view(Vector3::new(0.4 * side, 0.0, 0.0), Vector3::new(-0.2, 0.0, 0.9), 330.0));
            coverage.add(&view(Vector3::new(0.0, 0.4 * side, 0.0), Vector3::new(-0.2, 0.0, 0.9), 330.0));
        }
        assert_eq!(coverage.tilts(), [1; 4]);
        let missing = coverage.missing();
        assert!(matches!(missing[..], [Requirement::Views(196), Requirement::Part(1, _)]), "{missing:?}");
        for x in [-0.4, -0.2, 0.0, 0.2, 0.4] {
            for y in [-0.3, -0.1, 0.1, 0.3] {
                let frame = view(Vector3::zeros(), Vector3::new(x, y, 0.9), 330.0);
                (0..10).for_each(|_| coverage.add(&frame));
            }
        }
        assert_eq!(coverage.missing(), []);
        assert!(coverage.covered() >= 0.8 && coverage.boards() == 204);
    }
}
