//! The motion of the camera.

use std::ops::Range;

use evcal_geometry::board::Board;
use maud::{Markup, html};

use super::chart::{Chart, Color, Series, range_of};
use super::number::count;
use super::page::{Section, scrolling};
use super::words::words;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::calibrate::interval_choice::IntervalChoice;
use evcal_solve::solve::equations::pose_covariance::{PoseCovariance, PoseSigma};
use evcal_solve::solve::left_out::{LeftOut, Reason};
use evcal_solve::solve::refinement::Refined;
use evcal_solve::trajectory::Trajectory;

/// Angles about x, y and z of the board, in this order of rotations.
const ANGLES: [&str; 3] = ["roll (about x)", "pitch (about y)", "yaw (about z)"];
/// Number of points of a curve over a whole recording.
const POINTS: f64 = 700.0;
/// Limit of plotted recordings.
const PLOTTED: usize = 4;
/// Limit of listed segments.
const LISTED: usize = 60;

/// Returns position and rotation over time, and the segments.
pub fn section(calibrated: &Calibrated, board: &Board) -> Option<Section> {
    let events = calibrated.events()?;
    let refined = &events.refined;
    let trajectories = &refined.state.trajectories;
    let recordings = calibrated.starts.len();
    let plots = (0..recordings.min(PLOTTED))
        .filter_map(|recording| plots(trajectories, &events.quality.poses, recording, recordings));
    let content = html! {
        p {
            "The pose of the camera in the frame of the board: the origin is the first " (words(board).point) ", x is along a row, y across the rows, and the camera is at "
            "negative z. Gaps are times without the board; each segment between gaps has its own spline."
        }
        @for plots in plots { (plots) }
        @if let Some(choice) = &events.choice { (chosen(choice, recordings)) }
        (left_out(&events.quality.left_out))
        @if recordings > PLOTTED { p.faint { "The trajectory files contain the other recordings." } }
        details.screen {
            summary { (trajectories.len()) @if trajectories.len() == 1 { " segment" } @else { " segments" } }
            (scrolling("Segments", &segments(refined)))
            @if trajectories.len() > LISTED { p.faint { "The first " (LISTED) " segments; calibration.json contains all." } }
        }
    };
    Some(Section { id: "trajectory", title: "Motion of the camera", folded: true, content })
}

/// Returns the seconds of a long recording that the joint solve used, with the information in each.
fn chosen(choice: &IntervalChoice, recordings: usize) -> Markup {
    let of_recording = |recording: usize| {
        let seconds = choice.chosen.iter().filter(move |second| second.recording == recording);
        let gains: Vec<(f64, f64)> =
            seconds.filter_map(|second| Some((second.start + 0.5, 100.0 * second.gain?))).collect();
        (recording, gains)
    };
    html! {
        h3 { "Seconds in the joint solve" }
        p {
            "The board was in view for " (choice.seconds) " s, more than the joint solve uses. The recordings were divided into " (choice.chosen.len())
            " parts, and the joint solve used the most informative second of each; the curves above show these. The trajectory at other times was "
            "estimated afterwards, with the camera fixed; its poses are in the trajectory files."
        }
        @for (recording, gains) in (0..recordings.min(PLOTTED)).map(of_recording).filter(|(_, gains)| !gains.is_empty()) {
            figure {
                (gains_chart(&gains).render())
                figcaption {
                    "Information in each second" @if recordings > 1 { " of recording " (recording + 1) }
                    ": the increase of the projection's variance without it, estimated from the reference frames."
                }
            }
        }
    }
}

fn gains_chart(gains: &[(f64, f64)]) -> Chart<'static> {
    let (first, last) = (gains.first().map_or(0.0, |gain| gain.0), gains.last().map_or(1.0, |gain| gain.0));
    Chart {
        description: "Information in each second of the joint solve, over time.".to_owned(),
        x_label: "time (s)",
        y_label: "information (%)",
        x: first - 0.5..last + 0.5,
        y: 0.0..1.1 * gains.iter().map(|gain| gain.1).fold(0.1, f64::max),
        series: vec![Series { name: String::new(), color: Color::First, curves: Vec::new(), points: gains.to_vec() }],
    }
}

/// One curve per segment.
type Curves = Vec<Vec<(f64, f64)>>;

/// Position (m), roll, pitch and yaw (°) and their standard deviations (mm, °) over time, by axis.
#[derive(Default)]
struct PoseCurves {
    position: [Curves; 3],
    rotation: [Curves; 3],
    position_sigma: [Curves; 3],
    rotation_sigma: [Curves; 3],
}

impl PoseCurves {
    /// Adds the curves of one segment, with a point every `step` seconds.
    fn add(&mut self, trajectory: &Trajectory, sigma: impl Fn(f64) -> Option<PoseSigma>, step: f64) {
        let length = trajectory.end() - trajectory.start();
        let count = (length / step).ceil().clamp(2.0, POINTS) as usize;
        let mut poses: [Vec<(f64, f64)>; 6] = Default::default();
        let mut sigmas: [Vec<(f64, f64)>; 6] = Default::default();
        for index in 0..=count {
            let t = (trajectory.start() + length * index as f64 / count as f64).min(trajectory.end());
            let Some(pose) = trajectory.pose(t) else { continue };
            let (roll, pitch, yaw) = pose.rotation.euler_angles();
            let position = pose.translation.vector.iter().copied();
            let (positions, angles) = poses.split_at_mut(3);
            positions.iter_mut().zip(position).for_each(|(curve, value)| curve.push((t, value)));
            angles.iter_mut().zip([roll, pitch, yaw].map(f64::to_degrees)).for_each(|(curve, angle)| {
                let last = curve.last().map_or(angle, |point| point.1);
                curve.push((t, nearest_turn(angle, last)));
            });
            let Some(sigma) = sigma(t) else { continue };
            let values =
                sigma.position.map(|metres| 1e3 * metres).into_iter().chain(sigma.rotation.map(f64::to_degrees));
            sigmas.iter_mut().zip(values).for_each(|(curve, value)| curve.push((t, value)));
        }
        let all = self.position.iter_mut().chain(&mut self.rotation);
        all.zip(poses).for_each(|(all, curve)| all.push(curve));
        let all = self.position_sigma.iter_mut().chain(&mut self.rotation_sigma);
        all.zip(sigmas).for_each(|(all, curve)| all.push(curve));
    }
}

/// Returns the same angle (°) plus the multiple of 360° that brings it nearest to `last`.
fn nearest_turn(angle: f64, last: f64) -> f64 {
    angle + 360.0 * ((last - angle) / 360.0).round()
}

fn plots(
    trajectories: &[Trajectory],
    covariance: &PoseCovariance,
    recording: usize,
    recordings: usize,
) -> Option<Markup> {
    let of_recording = || trajectories.iter().enumerate().filter(|(_, one)| one.recording == recording);
    let start = of_recording().map(|(_, one)| one.start()).min_by(f64::total_cmp)?;
    let end = of_recording().map(|(_, one)| one.end()).max_by(f64::total_cmp)?;
    let step = (end - start) / POINTS;
    let mut curves = PoseCurves::default();
    for (segment, trajectory) in of_recording() {
        curves.add(trajectory, |t| covariance.sigma(segment, trajectory, t), step);
    }
    let PoseCurves { position, rotation, position_sigma, rotation_sigma } = curves;
    let sigmas = (!position_sigma.iter().flatten().all(Vec::is_empty)).then(|| {
        [
            chart("Standard deviation of the position over time.", "σ (mm)", position_sigma, start..end, 0.1),
            chart("Standard deviation of the rotation over time.", "σ (°)", rotation_sigma, start..end, 0.01),
        ]
    });
    let position = chart("Position of the camera over time.", "position (m)", position, start..end, 0.1);
    let mut rotation = chart("Roll, pitch and yaw of the camera over time.", "angle (°)", rotation, start..end, 10.0);
    rotation.series.iter_mut().zip(ANGLES).for_each(|(series, name)| name.clone_into(&mut series.name));
    Some(html! {
        @if recordings > 1 { h3 { "Recording " (recording + 1) } }
        div.pair {
            figure { (position.render()) figcaption { "Position of the camera." } }
            figure { (rotation.render()) figcaption { "Rotation of the camera relative to the board; at 0 it faces the board." } }
        }
        @if let Some([position, rotation]) = sigmas {
            div.pair {
                figure { (position.render()) figcaption { "Uncertainty of the position: σ along each axis of the board." } }
                figure { (rotation.render()) figcaption { "Uncertainty of the rotation: σ about each axis of the camera." } }
            }
        }
    })
}

/// Returns the intervals that are left out, with the reasons.
fn left_out(intervals: &[LeftOut]) -> Markup {
    /// Limit of listed intervals.
    const NAMED: usize = 20;
    let of = |reason: Reason| intervals.iter().filter(move |interval| interval.reason == reason);
    let reasons = [
        (Reason::Unexplained, "no trajectory fits the events"),
        (Reason::Saturated, "the camera sent as many events as it can, and lost others"),
    ];
    html! {
        @for (reason, why) in reasons {
            @let (names, count) = (of(reason).take(NAMED).map(ToString::to_string).collect::<Vec<_>>(), of(reason).count());
            @if count > 0 {
                p {
                    "Left out, because " (why) ": " (names.join(", "))
                    @if count > NAMED { " and " (count - NAMED) " more" }
                    "."
                }
            }
        }
    }
}

fn chart(
    description: &str,
    y_label: &'static str,
    curves: [Vec<Vec<(f64, f64)>>; 3],
    times: Range<f64>,
    narrowest: f64,
) -> Chart<'static> {
    let values: Vec<f64> = curves.iter().flatten().flatten().map(|point| point.1).collect();
    let series = curves.into_iter().zip(["x", "y", "z"]).zip(Color::ALL);
    Chart {
        description: description.to_owned(),
        x_label: "time (s)",
        y_label,
        x: times.start..times.end.max(times.start + 1e-3),
        y: range_of(values.into_iter(), narrowest),
        series: series
            .map(|((curves, name), color)| Series { name: name.to_owned(), color, curves, points: Vec::new() })
            .collect(),
    }
}

fn segments(refined: &Refined) -> Markup {
    let rows = refined.state.trajectories.iter().zip(&refined.problem.segments).take(LISTED);
    html! {
        table {
            thead { tr {
                th.number scope="col" { "recording" }
                th.number scope="col" { "start (s)" }
                th.number scope="col" { "end (s)" }
                th.number scope="col" { "control points" }
                th.number scope="col" { "observations" }
            } }
            tbody {
                @for (trajectory, observations) in rows {
                    tr {
                        td.number { (trajectory.recording + 1) }
                        td.number { (format!("{:.3}", trajectory.start())) }
                        td.number { (format!("{:.3}", trajectory.end())) }
                        td.number { (trajectory.control_point_count()) }
                        td.number { (count((observations.events.len() + observations.points.len()) as u64)) }
                    }
                }
            }
        }
    }
}
