//! Origin of the result: recordings, board, command line, settings, version.

use maud::{Markup, html};
use toml::{Table, Value};

use super::ResultFile;
use super::number::count;
use super::page::{Section, scrolling};
use evcal_calibrate::calibrate::Task;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::calibrate::input::Input;
use evcal_calibrate::settings::Settings;

/// Returns all information that is needed to reproduce the result.
pub fn section(calibrated: &Calibrated, task: &Task, files: &[ResultFile]) -> Option<Section> {
    let changed = changed(task.settings);
    let content = html! {
        p { "The same program with the same input gives the same result, byte for byte." }
        (scrolling("Recordings", &recordings(calibrated, task)))
        p { "Board: " code { (task.board) } ". Program: evcal " (env!("CARGO_PKG_VERSION")) "." }
        @if !task.command_line.is_empty() {
            h3 { "Command line" }
            pre.command { (task.command_line) }
        }
        @if !files.is_empty() {
            h3 { "Files" }
            (scrolling("Files", &table_of(files)))
        }
        h3 { "Settings" }
        @if changed.is_empty() {
            p { "All settings have their defaults." }
        } @else {
            p { "Not the default: " }
            ul { @for (name, value) in &changed { li { code { (name) " = " (value) } } } }
        }
        details { summary { "All settings" } pre { (task.settings.to_toml()) } }
    };
    Some(Section { id: "provenance", title: "Where this comes from", content })
}

fn recordings(calibrated: &Calibrated, task: &Task) -> Markup {
    html! {
        table {
            thead { tr {
                th scope="col" { "file" }
                th scope="col" { "camera" }
                th scope="col" { "recorded" }
                th.number scope="col" { "MB" }
                th.number scope="col" { "events or circles" }
                th.number scope="col" { "duration (s)" }
                th scope="col" { "notes" }
            } }
            tbody {
                @for (input, report) in task.inputs.iter().zip(&calibrated.recordings) {
                    tr {
                        th.path scope="row" { (input.name()) }
                        td { (report.camera_name.as_deref().unwrap_or("not named")) }
                        td { (report.began.as_deref().unwrap_or("not told")) }
                        td.number { (megabytes(input).unwrap_or_default()) }
                        td.number { (count(report.count)) }
                        td.number { (format!("{:.3}", report.duration)) }
                        td.words { (report.notes.join("; ")) }
                    }
                }
            }
        }
    }
}

/// Descriptions of the files of a calibration, by the beginning of their names.
const MEANINGS: [(&str, &str); 21] = [
    ("calibration.json", "all results, for programs"),
    ("camera.yaml", "the camera for OpenCV"),
    ("exports/camera_info.yaml", "the camera for ROS"),
    ("exports/camchain-cameras.yaml", "all cameras on the mount for Kalibr"),
    ("exports/stereo", "both cameras for OpenCV, as stereoCalibrate names them"),
    ("exports/static_transforms.yaml", "where the other cameras are, for ROS"),
    ("exports/camchain-imucam.yaml", "camera and inertial unit for Kalibr"),
    ("exports/camchain.yaml", "the camera for Kalibr"),
    ("exports/imu.yaml", "noise of the inertial unit for Kalibr"),
    ("exports/kalibr_im", "camera and inertial unit for OpenVINS"),
    ("exports/vins-fusion.yaml", "camera and inertial unit for VINS-Fusion"),
    ("exports/basalt-imu.json", "camera and inertial unit for basalt"),
    ("exports/dv-processing-imu.json", "camera and inertial unit for DV"),
    ("exports/static_transform.yaml", "where the camera is on the inertial unit, for ROS"),
    ("circles", "where circles were found"),
    ("settings.toml", "all settings as they were used"),
    ("stages.txt", "what every stage took in and gave out"),
    ("good-frame.png", "a window that the first camera explains well"),
    ("bad-frame.png", "the window that it explains worst"),
    ("trajectory", "the camera's poses; .csv has their standard deviations"),
    ("report.html", "this page"),
];

fn table_of(files: &[ResultFile]) -> Markup {
    let meaning =
        |name: &str| MEANINGS.iter().find(|(start, _)| name.starts_with(start)).map_or("", |(_, meaning)| meaning);
    html! {
        table.short {
            thead { tr { th scope="col" { "file" } th.number scope="col" { "kB" } th scope="col" { "what it is" } } }
            tbody {
                @for file in files {
                    tr {
                        th.path scope="row" { (file.name) }
                        td.number { (format!("{:.1}", file.length as f64 / 1e3)) }
                        td.words { (meaning(&file.name)) }
                    }
                }
            }
        }
    }
}

/// Returns the size of the input, if it is a file.
fn megabytes(input: &Input) -> Option<String> {
    let length = std::fs::metadata(input.name()).ok().filter(std::fs::Metadata::is_file)?.len();
    Some(format!("{:.1}", length as f64 / 1e6))
}

/// Returns the settings that differ from their defaults, as dotted name and value.
fn changed(settings: &Settings) -> Vec<(String, String)> {
    let mut found = Vec::new();
    compare(&settings.table(), &Settings::default().table(), "", &mut found);
    found
}

fn compare(used: &Table, default: &Table, prefix: &str, found: &mut Vec<(String, String)>) {
    for (name, value) in used {
        let dotted = format!("{prefix}{name}");
        match (value, default.get(name)) {
            (Value::Table(used), Some(Value::Table(default))) => compare(used, default, &format!("{dotted}."), found),
            (value, before) if before != Some(value) => found.push((dotted, value.to_string())),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_were_changed_are_named() {
        let mut settings = Settings::default();
        assert!(changed(&settings).is_empty());
        settings.refinement.most_seconds = 30.0;
        settings.detection.window.gap = 7;
        let names: Vec<(String, String)> = changed(&settings);
        let pair = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        assert_eq!(names, [pair("detection.window.gap", "7"), pair("refinement.most_seconds", "30.0")]);
    }
}
