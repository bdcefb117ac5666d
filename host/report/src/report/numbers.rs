//! The parameters of the lens.

use evcal_core::camera::Camera;
use maud::{Markup, html};
use nalgebra::Vector2;

use super::number::{count, signed, with_sigma};
use super::page::{Section, scrolling};
use super::palette::Palette;
use super::{distortion, to_copy};
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::initial::model_choice::{ModelChoice, WIDELY_HELD};
use evcal_calibrate::trust::board_evidence::BoardEstimate;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::Board;
use evcal_geometry::board::shape::PARAMETERS;

/// Returns the parameters with their standard deviations.
pub fn section(calibrated: &Calibrated, board: &Board) -> Option<Section> {
    let camera = calibrated.camera();
    let uncertainty = &calibrated.trust.uncertainty;
    let sigma = uncertainty.sigma();
    let initial = calibrated.initial().camera.parameters();
    let values = camera.parameters();
    let rows = camera.kind().parameter_names().iter().zip(&values).enumerate();
    let table = html! {
        table.short {
            thead { tr {
                th scope="col" { "parameter" }
                th.number scope="col" { "value" }
                th.number scope="col" { "± σ" }
                th.number scope="col" { "first estimate" }
                th scope="col" { "what it is" }
            } }
            tbody {
                @for (index, (name, &value)) in rows {
                    @let (value, sigma) = with_sigma(value, sigma.get(index).copied().unwrap_or(0.0));
                    @let decimals = value.split_once('.').map_or(0, |(_, decimals)| decimals.len());
                    tr {
                        th scope="row" { code { (name) } }
                        td.number { (value) }
                        td.number { (sigma) }
                        td.number { @if let Some(&initial) = initial.get(index) { (signed(initial, decimals)) } }
                        td.words { (meaning(name)) }
                    }
                }
            }
        }
    };
    let content = html! {
        p {
            "Camera model " code { (camera.kind().name()) } ". Pixel (0, 0) is the centre of the top-left pixel, as in OpenCV and ROS. σ is one standard deviation; the true "
            "value lies within 2σ in about 95 of 100 calibrations. Observations of one moment share their errors: "
            (count(uncertainty.observations as u64)) " observations count as much as " (count(uncertainty.effective_observations() as u64))
            " independent ones, which σ takes into account."
        }
        (scrolling("Camera parameters", &table))
        (view(camera, calibrated.sensor))
        @if let Some(choice) = &calibrated.model_choice { (chosen(choice)) }
        @if let Some(events) = calibrated.events() { (printed_board(&events.trust.board)) }
        (distortion::pictures(calibrated, board))
        (to_copy::forms(calibrated, board))
        h3 { "Correlation" }
        details {
            summary { "Which parameters are correlated" }
            p {
                "Near ±1 the recording cannot tell two parameters apart. Distortion coefficients are always correlated. Only the projection as a whole counts then, "
                "which is mapped below."
            }
            (scrolling("Correlation of the parameters", &correlation(calibrated)))
        }
    };
    Some(Section { id: "numbers", title: "The lens in numbers", content })
}

/// Describes the board: the estimated parameters, and the estimates with all parameters free.
fn printed_board(estimate: &BoardEstimate) -> Markup {
    const ROWS: [(&str, &str, f64); PARAMETERS] = [
        ("scale of the print along x over that along y", "", 1.0),
        ("bend along x", "mm", 1e3),
        ("bend along y", "mm", 1e3),
        ("radius of the circles", "mm", 1e3),
    ];
    let values = estimate.shape.parameters();
    let free = |index: usize| {
        let evidence = estimate.evidence?;
        evidence.sigma[index].is_finite().then(|| (evidence.values[index], evidence.sigma[index]))
    };
    html! {
        h3 { "The board" }
        p {
            "If the recording shows that the board is bent, printed unevenly or with another radius, this is estimated together with the camera. A positive bend means "
            "that the middle of the board is further away than its edges. The last column is what comes out if all four are estimated."
        }
        (scrolling("The board as it is", &html! {
            table.short {
                thead { tr {
                    th scope="col" { "" }
                    th.number scope="col" { "value" }
                    th.number scope="col" { "± σ" }
                    th.number scope="col" { "if estimated" }
                } }
                tbody {
                    @for (index, (name, unit, factor)) in ROWS.into_iter().enumerate() {
                        @let (value, sigma) = with_sigma(factor * values[index], factor * estimate.sigma[index]);
                        tr {
                            th scope="row" { (name) @if !unit.is_empty() { " (" (unit) ")" } }
                            td.number { (value) }
                            td.number { @if estimate.estimated[index] { (sigma) } @else { "as stated" } }
                            td.number {
                                @if let Some((value, sigma)) = free(index) {
                                    @let (value, sigma) = with_sigma(factor * value, factor * sigma);
                                    (value) " ± " (sigma)
                                }
                            }
                        }
                    }
                }
            }
        }))
    }
}

fn chosen(choice: &ModelChoice) -> Markup {
    let figure = |value: Option<f64>| value.map(|value| signed(value, 4)).unwrap_or_default();
    let is_nearly =
        choice.candidates.iter().any(|candidate| candidate.model == choice.chosen && candidate.nearly_as_good);
    html! {
        h3 { "Choice of the model" }
        p {
            code { (choice.chosen) } " was chosen: of the models that predict unseen circles as well as the best one"
            @if is_nearly { ", or nearly so" }
            ", it has the fewest parameters"
            @if WIDELY_HELD.iter().any(|kind| kind.name() == choice.chosen) { ", among those that OpenCV and ROS hold" }
            "."
        }
        (scrolling("Camera models compared", &html! {
            table.short {
                thead { tr {
                    th scope="col" { "model" }
                    th.number scope="col" { "parameters" }
                    th.number scope="col" { "error of unseen circles (px)" }
                    th scope="col" { "" }
                } }
                tbody {
                    @for candidate in &choice.candidates {
                        tr {
                            th scope="row" { code { (candidate.model) } }
                            td.number { (candidate.parameters) }
                            td.number { (figure(candidate.root_mean_cost)) }
                            td.words {
                                @if candidate.as_good { "as good as the best" }
                                @else if candidate.nearly_as_good { "nearly as good as the best" }
                                @else if candidate.folds { "folds over inside the image" }
                                @if let Some(failure) = &candidate.failure { (failure) }
                            }
                        }
                    }
                }
            }
        }))
    }
}

fn correlation(calibrated: &Calibrated) -> Markup {
    let names = calibrated.camera().kind().parameter_names();
    let correlation = calibrated.trust.uncertainty.correlation();
    let rows = names.iter().zip(correlation.row_iter()).enumerate();
    html! {
        table.correlation {
            thead { tr { td {} @for name in names { th.number scope="col" { code { (name) } } } } }
            tbody {
                @for (index, (name, row)) in rows {
                    tr {
                        th scope="row" { code { (name) } }
                        @for &value in row.iter().take(index + 1) {
                            @let [red, green, blue] = Palette::Signed.color(0.5 + 0.5 * value);
                            @let ink = if value.abs() > 0.75 { "#fff" } else { "#000" };
                            td style=(format!("background:rgb({red},{green},{blue});color:{ink}")) { (signed(value, 2)) }
                        }
                    }
                }
            }
        }
    }
}

/// Describes the angle of view.
fn view(camera: &Camera<f64>, Sensor { width, height }: Sensor) -> Markup {
    let (right, bottom) = (f64::from(width) - 0.5, f64::from(height) - 0.5);
    let (middle_x, middle_y) = (0.5 * (right - 0.5), 0.5 * (bottom - 0.5));
    let angle = |from: [f64; 2], to: [f64; 2]| {
        let (from, to) = (camera.unproject(&Vector2::from(from))?, camera.unproject(&Vector2::from(to))?);
        Some(from.angle(&to).to_degrees())
    };
    let across = angle([-0.5, middle_y], [right, middle_y]);
    let down = angle([middle_x, -0.5], [middle_x, bottom]);
    html! {
        @if let (Some(across), Some(down)) = (across, down) {
            p { (format!("Angle of view: {across:.1}° horizontally, {down:.1}° vertically.")) }
        }
    }
}

fn meaning(name: &str) -> &'static str {
    match name {
        "fx" => "focal length along the rows, in pixels",
        "fy" => "focal length along the columns, in pixels",
        "cx" => "principal point: column, in pixels",
        "cy" => "principal point: row, in pixels",
        "p1" | "p2" => "distortion across the radius (a lens that is not quite centred)",
        "xi" | "alpha" | "beta" | "w" => "shape of the projection",
        _ => "distortion along the radius",
    }
}
