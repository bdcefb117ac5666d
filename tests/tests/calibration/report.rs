//! Checks `report.html` without a browser: it is complete, self-contained and small, and file names cannot inject HTML.
//! `tools/report/check.sh` checks it in a browser.

use std::fs;
use std::path::Path;

use evcal_tests::{BOARD, read_json, session_calibration, succeed, text};

const LARGEST: usize = 2_000_000;

fn report(folder: &Path) -> String {
    fs::read_to_string(folder.join("report.html")).expect("calibrate writes report.html")
}

/// Returns the values of all attributes with this name.
fn attributes<'a>(html: &'a str, name: &str) -> Vec<&'a str> {
    let start = format!(" {name}=\"");
    html.split(&start).skip(1).map(|rest| rest.split('"').next().unwrap_or_default()).collect()
}

#[test]
fn the_report_needs_no_other_files() {
    let html = report(&session_calibration());
    assert!(html.len() <= LARGEST, "{} bytes", html.len());
    for link in attributes(&html, "href") {
        assert!(link.starts_with('#') || link.starts_with("data:"), "{link}");
        if let Some(id) = link.strip_prefix('#') {
            assert!(html.contains(&format!("id=\"{id}\"")), "{link} has no target");
        }
    }
    let pictures = attributes(&html, "src");
    assert!(pictures.len() >= 6, "{} pictures", pictures.len());
    for picture in &pictures {
        assert!(picture.starts_with("data:image/png;base64,iVBORw0KGgo"), "{}", &picture[..60.min(picture.len())]);
    }
    for forbidden in ["<script", "@import", "url(", "<link rel=\"stylesheet"] {
        assert!(!html.contains(forbidden), "{forbidden}");
    }
    // The name of the SVG namespace is not a link, and base64 may contain any four letters by chance.
    let text = pictures.iter().fold(html.clone(), |text, picture| text.replace(&picture[..], ""));
    assert_eq!(text.matches("http").count(), text.matches("xmlns=\"http://www.w3.org/2000/svg\"").count() + 1);
    assert_eq!(html.matches("http-equiv").count(), 1);
    // The plotting area within a plot is a drawing of its own.
    let plots = html.matches("<svg ").count() - html.matches("<svg x=").count();
    assert!(plots >= 8, "{plots} plots");
    assert_eq!(html.matches("role=\"img\" aria-label=\"").count(), plots, "every plot has an alternative text");
    assert_eq!(attributes(&html, "alt").len(), pictures.len(), "every image has an alternative text");
}

#[test]
fn the_report_shows_the_values_of_calibration_json() {
    let folder = session_calibration();
    let html = report(&folder);
    let calibration = read_json(&folder.join("calibration.json"));
    for name in ["fx", "fy", "cx", "cy"] {
        let value = calibration["camera"]["parameters"][name].as_f64().unwrap();
        let row = html.split(&format!("<code>{name}</code></th>")).nth(1).expect("the parameter has a row");
        let shown: f64 = row.split(['<', '>']).nth(2).unwrap().parse().unwrap();
        assert!((shown - value).abs() < 0.006, "{name}: {shown} instead of {value}");
    }
    for count in [&calibration["residuals"]["count"], &calibration["stages"]["detection"]["found"]] {
        let digits = count.as_u64().unwrap().to_string();
        assert!(html.replace('\u{202f}', "").contains(&digits), "{digits}");
    }
    assert!(html.contains(BOARD) && html.contains("events.dvraw"));
}

#[test]
fn the_report_has_text_to_copy_and_names_its_files() {
    let folder = session_calibration();
    let html = report(&folder);
    let parameters = &read_json(&folder.join("calibration.json"))["camera"]["parameters"];
    let number = |name: &str| parameters[name].as_f64().unwrap().to_string();
    let [fx, fy, cx, cy] = ["fx", "fy", "cx", "cy"].map(number);
    assert!(html.contains(&format!("K = np.array([[{fx}, 0, {cx}], [0, {fy}, {cy}], [0, 0, 1]])")));
    for part in [
        "distortion_model: plumb_bob",
        "camera_model: pinhole",
        "image from the principal point, towards the farthest corner",
        "Reprojection errors of circles",
    ] {
        assert!(html.contains(part), "{part}");
    }
    assert!(html.contains("<details><summary>Correlation of the parameters"), "correlations are folded");
    for angle in ["roll (about x)", "pitch (about y)", "yaw (about z)"] {
        assert!(html.contains(angle), "{angle}");
    }
    for name in ["calibration.json", "camera.yaml", "exports/camchain.yaml", "circles.csv", "trajectory.csv"] {
        let row = html.split(&format!("<th class=\"path\" scope=\"row\">{name}</th>")).nth(1).unwrap_or_default();
        let shown: f64 = row.split(['<', '>']).nth(2).unwrap_or_default().parse().expect(name);
        let length = fs::metadata(folder.join(name)).unwrap().len() as f64 / 1e3;
        assert!((shown - length).abs() < 0.06, "{name}: {shown} kB instead of {length}");
    }
    // The uncertainties at the top are 95 % bounds, not σ.
    let top = html.split("<dl class=\"figures\">").nth(1).unwrap().split("</dl>").next().unwrap();
    assert!(top.matches("95 of 100").count() == 2 && !top.contains("±"), "{top}");
}

#[test]
fn file_names_are_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let circles = folder.path().join("<b onload=alert(1)>&amp; \"circles\".csv");
    fs::copy(session_calibration().join("circles.csv"), &circles).unwrap();
    let output = folder.path().join("out");
    succeed(&[
        "calibrate",
        text(&circles),
        "--board",
        BOARD,
        "--sensor",
        "346x260",
        "--accept-any",
        "-o",
        text(&output),
    ]);
    let html = report(&output);
    assert!(!html.contains("<b onload"), "a file name became an element");
    assert!(html.contains("&lt;b onload=alert(1)&gt;&amp;amp; &quot;circles&quot;.csv"));
    // A calibration from circles has neither event classes nor pictures of events.
    assert!(
        html.contains("id=\"residuals\"") && !html.contains("id=\"frames\"") && !html.contains("id=\"accumulation\"")
    );
}
