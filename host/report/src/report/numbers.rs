//! The parameters of the lens, and the choice of its model.

use evcal_core::camera::Camera;
use maud::{Markup, html};
use nalgebra::Vector2;

use super::number::{signed, with_sigma};
use super::page::{Section, scrolling};
use super::palette::Palette;
use super::words::{Words, words};
use super::{distortion, to_copy};
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::quality::board_evidence::BoardEstimate;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::Board;
use evcal_geometry::board::shape::PARAMETERS;
use evcal_solve::initial::model_choice::{ModelChoice, WIDELY_SUPPORTED};

/// Returns the parameters with their standard deviations; the model comparison, the board, correlations and texts to copy are folded.
pub fn section(calibrated: &Calibrated, board: &Board) -> Option<Section> {
    let camera = calibrated.camera();
    let initial = calibrated.initial().camera.parameters();
    let table = parameters(camera, &calibrated.quality.uncertainty.sigma(), Some(&initial));
    let content = html! {
        p {
            "Camera model " code { (camera.kind().name()) } ". " (view(camera, calibrated.sensor)) "Pixel (0, 0) is the centre of the top-left pixel, as in OpenCV "
            "and ROS. ± σ is one standard deviation: the true value is within 2σ in about 95 of 100 calibrations. Observations of one moment share "
            "their errors; σ accounts for this."
        }
        div.trio {
            div.wide { (scrolling("Camera parameters", &table)) }
            (distortion::curve_figure(calibrated))
        }
        @if let Some(choice) = &calibrated.model_choice { (chosen(choice)) }
        @if let Some(events) = calibrated.events() { (printed_board(&events.quality.board, words(board))) }
        (distortion::reprojection_errors(calibrated, board))
        details {
            summary { "Correlation of the parameters" }
            p {
                "If a correlation is near ±1, the recording does not determine the two parameters separately. Distortion coefficients are always "
                "correlated; their combined effect is the uncertainty of the projection, in the map at the top."
            }
            (scrolling("Correlation of the parameters", &correlation(calibrated)))
        }
        (to_copy::forms(calibrated, board))
    };
    Some(Section { id: "numbers", title: "Lens parameters", folded: false, content })
}

/// Returns a table of the parameters of a lens with their standard deviations, and with their `initial` values if there are any.
pub fn parameters(camera: &Camera<f64>, sigma: &[f64], initial: Option<&[f64]>) -> Markup {
    let values = camera.parameters();
    let rows = camera.kind().parameter_names().iter().zip(&values).enumerate();
    html! {
        table.short {
            thead { tr {
                th scope="col" { "parameter" }
                th.number scope="col" { "value" }
                th.number scope="col" { "± σ" }
                @if initial.is_some() { th.number scope="col" { "initial" } }
                th scope="col" { "meaning" }
            } }
            tbody {
                @for (index, (name, &value)) in rows {
                    @let (value, sigma) = with_sigma(value, sigma.get(index).copied().unwrap_or(0.0));
                    @let decimals = value.split_once('.').map_or(0, |(_, decimals)| decimals.len());
                    tr {
                        th scope="row" { code { (name) } }
                        td.number { (value) }
                        td.number { (sigma) }
                        @if let Some(initial) = initial {
                            td.number { @if let Some(&initial) = initial.get(index) { (signed(initial, decimals)) } }
                        }
                        td.words { (meaning(name)) }
                    }
                }
            }
        }
    }
}

/// Returns the shape of the board that was used, next to the shape if all its parameters are estimated.
fn printed_board(estimate: &BoardEstimate, words: Words) -> Markup {
    let rows: [(&str, &str, f64); PARAMETERS] = [
        ("ratio of the print's scales along x and y", "", 1.0),
        ("bend along x", "mm", 1e3),
        ("bend along y", "mm", 1e3),
        (words.size, "mm", 1e3),
    ];
    let values = estimate.shape.parameters();
    let free = |index: usize| {
        let evidence = estimate.evidence?;
        evidence.sigma[index].is_finite().then(|| (evidence.values[index], evidence.sigma[index]))
    };
    html! {
        details {
        summary { "Shape of the board" }
        p {
            "If the recording shows that the board is bent, unevenly printed or has other " (words.parts) ", the calibration estimates this together with the camera. "
            "Positive bend: the centre of the board is farther away than its edges. Last column: the values if all four are estimated."
        }
        (scrolling("Shape of the board", &html! {
            table.short {
                thead { tr {
                    th scope="col" { "" }
                    th.number scope="col" { "value" }
                    th.number scope="col" { "± σ" }
                    th.number scope="col" { "if estimated" }
                } }
                tbody {
                    @for (index, (name, unit, factor)) in rows.into_iter().enumerate() {
                        @let (value, sigma) = with_sigma(factor * values[index], factor * estimate.sigma[index]);
                        tr {
                            th scope="row" { (name) @if !unit.is_empty() { " (" (unit) ")" } }
                            td.number { (value) }
                            td.number { @if estimate.estimated[index] { (sigma) } @else { "fixed" } }
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
}

fn chosen(choice: &ModelChoice) -> Markup {
    let figure = |value: Option<f64>| value.map(|value| signed(value, 4)).unwrap_or_default();
    let is_nearly =
        choice.candidates.iter().any(|candidate| candidate.model == choice.chosen && candidate.nearly_as_good);
    html! {
        details {
        summary { "Choice of the camera model: " (choice.chosen) }
        p {
            code { (choice.chosen) } " has the fewest parameters of the models that predict points of other frames as well as the best one"
            @if is_nearly { ", or nearly as well" }
            @if WIDELY_SUPPORTED.iter().any(|kind| kind.name() == choice.chosen) { ", among the models that OpenCV and ROS support" }
            "."
        }
        (scrolling("Camera models compared", &html! {
            table.short {
                thead { tr {
                    th scope="col" { "model" }
                    th.number scope="col" { "parameters" }
                    th.number scope="col" { "error in other frames (px)" }
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
}

fn correlation(calibrated: &Calibrated) -> Markup {
    let names = calibrated.camera().kind().parameter_names();
    let correlation = calibrated.quality.uncertainty.correlation();
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

/// Returns the angle of view in a sentence.
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
            (format!("Angle of view: {across:.1}° horizontally, {down:.1}° vertically. "))
        }
    }
}

fn meaning(name: &str) -> &'static str {
    match name {
        "fx" => "focal length along the rows (px)",
        "fy" => "focal length along the columns (px)",
        "cx" => "principal point, column (px)",
        "cy" => "principal point, row (px)",
        "p1" | "p2" => "tangential distortion (decentred lens)",
        "xi" | "alpha" | "beta" | "w" => "shape of the projection",
        _ => "radial distortion",
    }
}
