//! How the camera moved.

use maud::{Markup, html};

use super::chart::{Chart, Color, Series, range_of};
use super::number::count;
use super::page::{Section, scrolling};
use crate::calibrate::calibrated::Calibrated;
use crate::solve::refinement::Refined;
use crate::trajectory::Trajectory;

/// Points of a curve over a whole recording.
const POINTS: f64 = 700.0;
/// Recordings that are plotted.
const PLOTTED: usize = 4;
/// Segments that are listed.
const LISTED: usize = 60;

/// Position and rotation over time, and the segments.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let refined = &calibrated.events()?.refined;
    let trajectories = &refined.state.trajectories;
    let recordings = calibrated.starts.len();
    let plots = (0..recordings.min(PLOTTED)).filter_map(|recording| plots(trajectories, recording, recordings));
    let content = html! {
        p {
            "The camera's pose in the frame of the board: the origin is the first circle, x runs along a row, y from row to row, and the camera is at "
            "negative z. Gaps are times without the board; each stretch between gaps is a segment with a spline of its own."
        }
        @for plots in plots { (plots) }
        @if recordings > PLOTTED { p.faint { "The other recordings are in the trajectory files." } }
        details {
            summary { (trajectories.len()) " segments" }
            (scrolling("Segments", &segments(refined)))
            @if trajectories.len() > LISTED { p.faint { "The first " (LISTED) " segments; all are in calibration.json." } }
        }
    };
    Some(Section { id: "trajectory", title: "How the camera moved", content })
}

fn plots(trajectories: &[Trajectory], recording: usize, recordings: usize) -> Option<Markup> {
    let of_recording = || trajectories.iter().filter(|one| one.recording == recording);
    let start = of_recording().map(Trajectory::start).min_by(f64::total_cmp)?;
    let end = of_recording().map(Trajectory::end).max_by(f64::total_cmp)?;
    let step = (end - start) / POINTS;
    let mut position: [Vec<Vec<(f64, f64)>>; 3] = Default::default();
    let mut rotation: [Vec<Vec<(f64, f64)>>; 3] = Default::default();
    for trajectory in of_recording() {
        let count = ((trajectory.end() - trajectory.start()) / step).ceil().clamp(2.0, POINTS) as usize;
        let mut curves: [Vec<(f64, f64)>; 6] = Default::default();
        for index in 0..=count {
            let t = trajectory.start() + (trajectory.end() - trajectory.start()) * index as f64 / count as f64;
            let Some(pose) = trajectory.pose(t.min(trajectory.end())) else { continue };
            let turns = pose.rotation.scaled_axis().map(f64::to_degrees);
            let values = pose.translation.vector.iter().chain(turns.iter());
            for (curve, value) in curves.iter_mut().zip(values) {
                curve.push((t, *value));
            }
        }
        for (curve, all) in curves.into_iter().zip(position.iter_mut().chain(&mut rotation)) {
            all.push(curve);
        }
    }
    let position = chart("Position of the camera over time.", "position (m)", position, (start, end), 0.1);
    let rotation = chart("Rotation vector of the camera over time.", "rotation (°)", rotation, (start, end), 10.0);
    Some(html! {
        @if recordings > 1 { h3 { "Recording " (recording + 1) } }
        div.pair {
            figure { (position.render()) figcaption { "Position of the camera." } }
            figure { (rotation.render()) figcaption { "Rotation of the camera: axis times angle." } }
        }
    })
}

fn chart(
    description: &str,
    y_label: &'static str,
    curves: [Vec<Vec<(f64, f64)>>; 3],
    (start, end): (f64, f64),
    narrowest: f64,
) -> Chart<'static> {
    let values: Vec<f64> = curves.iter().flatten().flatten().map(|point| point.1).collect();
    let series = curves.into_iter().zip(["x", "y", "z"]).zip(Color::ALL);
    Chart {
        description: description.to_owned(),
        x_label: "time (s)",
        y_label,
        x: start..end.max(start + 1e-3),
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
