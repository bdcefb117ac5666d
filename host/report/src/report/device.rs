//! A device on the mount: its quantities as a table, next to a drawing of its axes.

use maud::{Markup, html};
use nalgebra::Isometry3;

use super::mount_axes::drawing;
use super::number::{signed, with_sigma};
use super::overview::capital;
use super::page::scrolling;
use evcal_calibrate::result::device_description::{DeviceDescription, Quantity, Shown};

/// Returns the description as a table and sentences, next to the axes of the camera and of the `device`, with these short `names`.
pub fn description(
    DeviceDescription { heading, verdict, quantities, notes, findings }: &DeviceDescription,
    device: &str,
    names: [&str; 2],
    device_from_camera: &Isometry3<f64>,
) -> Markup {
    html! {
        p { (capital(heading)) ". " (verdict) }
        @if !findings.is_empty() { ul { @for finding in findings { li { (capital(finding)) } } } }
        div.trio {
            div.wide {
                (scrolling("Quantities of the device", &table(quantities)))
                ul.faint { @for note in notes { li { (capital(note)) } } }
            }
            figure {
                (drawing(device, names, device_from_camera))
                figcaption {
                    "Axes of the camera (x right, y down, z along the line of sight, away from you) and of the " (device)
                    "; the distance between them is not to scale."
                }
            }
        }
    }
}

fn table(quantities: &[Quantity]) -> Markup {
    html! {
        table.short.axes-table {
            thead { tr { td {} @for axis in ["x", "y", "z"] { th.number scope="col" { (axis) } } } }
            tbody {
                @for Quantity { name, unit, values } in quantities {
                    tr {
                        th.wrapped scope="row" { (name) @if !unit.is_empty() { " (" (unit) ")" } }
                        @if let [value] = values.as_slice() {
                            td.number colspan="3" { (shown(value.as_ref(), &html! { " " })) }
                        } @else {
                            @for value in values { td.number { (shown(value.as_ref(), &html! { br; })) } }
                        }
                    }
                }
            }
        }
    }
}

fn shown(value: Option<&Shown>, between: &Markup) -> Markup {
    html! {
        @match value {
            None => "not measured",
            Some(Shown { value, sigma: None, decimals }) => (signed(*value, *decimals)),
            Some(Shown { value, sigma: Some(sigma), .. }) => {
                @let (value, sigma) = with_sigma(*value, *sigma);
                (value) (between) span.faint { "± " (sigma) }
            }
        }
    }
}
