//! Motion of the camera.

use std::ops::Range;

use maud::{Markup, html};

use super::chart::{Chart, Color, Series, range_of};
use super::number::count;
use super::page::{Section, scrolling};
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::calibrate::stretch_choice::StretchChoice;
use evcal_calibrate::solve::left_out::{LeftOut, Reason};
use evcal_calibrate::solve::pose_covariance::{PoseCovariance, PoseSigma};
use evcal_calibrate::solve::refinement::Refined;
use evcal_calibrate::trajectory::Trajectory;

/// Angles about x, y and z of the board, applied in this order.
const ANGLES: [&str; 3] = ["roll (about x)", "pitch (about y)", "yaw (about z)"];
/// Number of points of a curve over a whole recording.
const POINTS: f64 = 700.0;
/// Largest number of recordings that are plotted.
const PLOTTED: usize = 4;
/// Largest number of segments that are listed.
const LISTED: usize = 60;

/// Returns position and rotation over time, and the segments.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let events = calibrated.events()?;
    let refined = &events.refined;
    let trajectories = &refined.state.trajectories;
    let recordings = calibrated.starts.len();
    let plots = (0..recordings.min(PLOTTED))
        .filter_map(|recording| plots(trajectories, &events.trust.poses, recording, recordings));
    let content = html! {
        p {
            "The camera's pose in the frame of the board: the origin is the first circle, x runs along a row, y from row to row, and the camera is at "
            "negative z. Gaps are times without the board; each stretch between gaps is a segment with a spline of its own."
        }
        @for plots in plots { (plots) }
        @if let Some(choice) = &events.choice { (chosen(choice, recordings)) }
        (left_out(&events.trust.left_out))
        @if recordings > PLOTTED { p.faint { "The other recordings are in the trajectory files." } }
        details {
            summary { (trajectories.len()) @if trajectories.len() == 1 { " segment" } @else { " segments" } }
            (scrolling("Segments", &segments(refined)))
            @if trajectories.len() > LISTED { p.faint { "The first " (LISTED) " segments; all are in calibration.json." } }
        }
    };
    Some(Section { id: "trajectory", title: "How the camera moved", content })
}

/// Describes the intervals in the joint solve, and the contribution of each.
fn chosen(choice: &StretchChoice, recordings: usize) -> Markup {
    let of_recording = |recording: usize| {
        let seconds = choice.chosen.iter().filter(move |second| second.recording == recording);
        let gains: Vec<(f64, f64)> =
            seconds.filter_map(|second| Some((second.start + 0.5, 100.0 * second.gain?))).collect();
        (recording, gains)
    };
    html! {
        h3 { "What is in the joint solve" }
        p {
            "The board was in view for " (choice.seconds) " s, more than the joint solve takes. The recordings were cut into "
            (choice.chosen.len()) " parts, and of each part it took the second that says most about the camera. The curves above are of these. Along "
            "the others the trajectory was solved afterwards, with the camera as it came out; its poses are in the trajectory files."
        }
        @for (recording, gains) in (0..recordings.min(PLOTTED)).map(of_recording).filter(|(_, gains)| !gains.is_empty()) {
            figure {
                (gains_chart(&gains).render())
                figcaption {
                    "How much each second" @if recordings > 1 { " of recording " (recording + 1) }
                    " brought: by how much the variance of the projection would grow without it, as far as the windows tell."
                }
            }
        }
    }
}

fn gains_chart(gains: &[(f64, f64)]) -> Chart<'static> {
    let (first, last) = (gains.first().map_or(0.0, |gain| gain.0), gains.last().map_or(1.0, |gain| gain.0));
    Chart {
        description: "What each second in the joint solve brought, over time.".to_owned(),
        x_label: "time (s)",
        y_label: "brought (%)",
        x: first - 0.5..last + 0.5,
        y: 0.0..1.1 * gains.iter().map(|gain| gain.1).fold(0.1, f64::max),
        series: vec![Series { name: String::new(), color: Color::Off, curves: Vec::new(), points: gains.to_vec() }],
    }
}

/// One curve for each segment.
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
            let place = pose.translation.vector.iter().copied();
            let (places, angles) = poses.split_at_mut(3);
            places.iter_mut().zip(place).for_each(|(curve, value)| curve.push((t, value)));
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

/// Returns the angle (°) plus the multiple of 360° that brings it nearest to `last`.
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
            figure { (rotation.render()) figcaption { "Rotation of the camera against the board; 0 is straight on." } }
        }
        @if let Some([position, rotation]) = sigmas {
            div.pair {
                figure { (position.render()) figcaption { "How sure the position is: one σ along each axis of the board." } }
                figure { (rotation.render()) figcaption { "How sure the rotation is: one σ about each axis of the camera." } }
            }
        }
    })
}

/// Describes the intervals that are left out, and the reasons.
fn left_out(stretches: &[LeftOut]) -> Markup {
    /// Largest number of intervals that are named.
    const NAMED: usize = 20;
    let of = |reason: Reason| stretches.iter().filter(move |stretch| stretch.reason == reason);
    let reasons = [
        (Reason::Unexplained, "no curve explains the events there"),
        (Reason::Saturated, "there were more events than the camera can send"),
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
