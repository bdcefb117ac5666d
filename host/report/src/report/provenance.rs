//! The origin of the result: recordings, board, command line, version, settings and files.

use maud::{Markup, html};
use toml::{Table, Value};

use super::ResultFile;
use super::number::count;
use super::page::{Section, scrolling};
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::result::calibration_file::InputFile;
use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::Task;

/// Returns the inputs of the calibration, and the command that repeats it.
pub fn section(calibrated: &Calibrated, task: &Task, inputs: &[InputFile]) -> Option<Section> {
    let content = html! {
        p {
            "Board " code { (task.board) } ", evcal " (env!("CARGO_PKG_VERSION")) ". The same version with the same input and options writes the same "
            "calibration, byte for byte."
        }
        @if !task.command_line.is_empty() { pre.command { (task.command_line) } }
        (scrolling("Recordings", &recordings(calibrated, task)))
        @if !inputs.is_empty() { (scrolling("Checksums", &checksums(inputs))) }
    };
    Some(Section { id: "provenance", title: "Recordings and command", folded: false, content })
}

fn checksums(inputs: &[InputFile]) -> Markup {
    html! {
        table.checksums {
            thead { tr { th scope="col" { "file" } th.number scope="col" { "bytes" } th scope="col" { "SHA-256" } } }
            tbody {
                @for InputFile { path, bytes, sha256 } in inputs {
                    tr { th.path scope="row" { (path) } td.number { (count(*bytes)) } td.path { code { (sha256) } } }
                }
            }
        }
    }
}

/// Returns the settings, and the files in the folder of the report.
pub fn settings(task: &Task, files: &[ResultFile]) -> Option<Section> {
    let changed = changed(task.settings);
    let content = html! {
        @if !files.is_empty() {
            h3 { "Files" }
            (scrolling("Files", &table_of(files)))
        }
        h3 { "Settings" }
        @if changed.is_empty() {
            p { "All settings have their default values." }
        } @else {
            p { "Settings that differ from their defaults: " }
            ul { @for (name, value) in &changed { li { code { (name) " = " (value) } } } }
        }
        details.screen { summary { "All settings" } pre { (task.settings.to_toml()) } }
    };
    Some(Section { id: "settings", title: "Settings and files", folded: true, content })
}

fn recordings(calibrated: &Calibrated, task: &Task) -> Markup {
    html! {
        table {
            thead { tr {
                th scope="col" { "file" }
                th scope="col" { "camera" }
                th scope="col" { "recorded" }
                th.number scope="col" { "events or points" }
                th.number scope="col" { "duration (s)" }
                th scope="col" { "notes" }
            } }
            tbody {
                @for (input, report) in task.inputs.iter().zip(&calibrated.recordings) {
                    tr {
                        th.path scope="row" { (input.name()) }
                        td { (report.camera_name.as_deref().unwrap_or("unknown")) }
                        td { (report.began.as_deref().unwrap_or("unknown")) }
                        td.number { (count(report.count)) }
                        td.number { (format!("{:.3}", report.duration)) }
                        td.words { (report.notes.join("; ")) }
                    }
                }
            }
        }
    }
}

/// Contents of the result files, by the beginnings of their names.
const MEANINGS: [(&str, &str); 21] = [
    ("calibration.json", "all results, for programs"),
    ("camera.yaml", "the camera for OpenCV"),
    ("exports/camera_info.yaml", "the camera for ROS"),
    ("exports/camchain-cameras.yaml", "all cameras on the mount for Kalibr"),
    ("exports/stereo", "both cameras for OpenCV, with the names of stereoCalibrate"),
    ("exports/static_transforms.yaml", "poses of the other cameras for ROS"),
    ("exports/camchain-imucam.yaml", "camera and IMU for Kalibr"),
    ("exports/camchain.yaml", "the camera for Kalibr"),
    ("exports/imu.yaml", "noise of the IMU for Kalibr"),
    ("exports/kalibr_im", "camera and IMU for OpenVINS"),
    ("exports/vins-fusion.yaml", "camera and IMU for VINS-Fusion"),
    ("exports/basalt-imu.json", "camera and IMU for basalt"),
    ("exports/dv-processing-imu.json", "camera and IMU for DV"),
    ("exports/static_transform.yaml", "pose of the camera relative to the IMU for ROS"),
    ("circles", "detected circles or corners"),
    ("settings.toml", "all settings of this calibration"),
    ("stages.txt", "input, output and rejected data of each stage"),
    ("good-frame.png", "the window with the smallest error of the initial model"),
    ("bad-frame.png", "the window with the largest error"),
    ("trajectory", "poses of the camera; .csv with standard deviations"),
    ("report.html", "this page"),
];

fn table_of(files: &[ResultFile]) -> Markup {
    let meaning =
        |name: &str| MEANINGS.iter().find(|(start, _)| name.starts_with(start)).map_or("", |(_, meaning)| meaning);
    html! {
        table.short {
            thead { tr { th scope="col" { "file" } th.number scope="col" { "kB" } th scope="col" { "content" } } }
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

/// Returns the settings that differ from their defaults: dotted name and value.
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
    fn changed_settings_are_listed() {
        let mut settings = Settings::default();
        assert!(changed(&settings).is_empty());
        settings.refinement.most_seconds = 30.0;
        settings.detection.window.gap = 7;
        let names: Vec<(String, String)> = changed(&settings);
        let pair = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        assert_eq!(names, [pair("detection.window.gap", "7"), pair("refinement.most_seconds", "30.0")]);
    }
}
