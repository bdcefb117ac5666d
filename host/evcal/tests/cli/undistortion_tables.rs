//! The tables that `evcal export` writes, compiled as their users do and compared with the exact inverse.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use evcal_core::camera::{Camera, ModelKind};
use nalgebra::Vector2;
use serde_json::Value;
use tempfile::TempDir;

const WIDTH: u16 = 346;
const HEIGHT: u16 = 260;
const LENS: [f64; 9] = [330.0, 331.0, 170.0, 131.5, -0.35, 0.15, 0.001, -0.0005, 0.0];
const IDEAL: [f64; 4] = [300.0, 301.0, 172.5, 129.5];

fn calibration(directory: &TempDir) -> PathBuf {
    let path = directory.path().join("calibration.json");
    let names = ModelKind::Radtan.parameter_names();
    let parameters: serde_json::Map<String, Value> =
        names.iter().zip(LENS).map(|(name, value)| ((*name).to_owned(), value.into())).collect();
    let file = serde_json::json!({
        "sensor": { "width": WIDTH, "height": HEIGHT },
        "camera": { "model": "radtan", "parameters": parameters },
    });
    fs::write(&path, file.to_string()).unwrap();
    path
}

fn run(program: &mut Command) -> String {
    let output = program.output().unwrap();
    assert!(output.status.success(), "{program:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Exports with these options; the JSON report.
fn export(calibration: &Path, options: &[&str]) -> Value {
    let mut program = Command::new(env!("CARGO_BIN_EXE_evcal"));
    let report = run(program.arg("export").arg(calibration).args(options).arg("--json"));
    serde_json::from_str(&report).unwrap()
}

/// Queried pixels: all corners, between pixels, and outside the sensor.
fn queries() -> Vec<(f32, f32)> {
    let mut queries: Vec<(f32, f32)> =
        (0..HEIGHT).step_by(7).flat_map(|y| (0..WIDTH).step_by(5).map(move |x| (x.into(), y.into()))).collect();
    queries.extend([(345.0, 259.0), (-0.5, -0.5), (345.5, 259.5), (10.3, 200.7), (-0.6, 5.0), (5.0, 259.6)]);
    queries
}

/// Every line is `x y` of the query's answer, or `none`.
fn compare(answers: &str, largest_error: f64) {
    let camera = Camera::from_parameters(ModelKind::Radtan, &LENS).unwrap();
    let [fx, fy, cx, cy] = IDEAL;
    let mut answers = answers.lines();
    for (x, y) in queries() {
        let answer = answers.next().unwrap();
        let inside = x >= -0.5 && y >= -0.5 && x <= 345.5 && y <= 259.5;
        let bearing = camera.unproject(&Vector2::new(x.into(), y.into())).unwrap();
        let exact = Vector2::new(fx * bearing.x / bearing.z + cx, fy * bearing.y / bearing.z + cy);
        let values: Vec<f64> = answer.split(' ').filter_map(|value| value.parse().ok()).collect();
        match values.as_slice() {
            &[u, v] if inside => {
                let error = (Vector2::new(u, v) - exact).norm();
                // Beyond the centres of the outermost pixels, the outermost cells are extrapolated.
                let most = if x < 0.0 || y < 0.0 || x > 345.0 || y > 259.0 { 2.0 } else { 1.0 } * largest_error;
                assert!(error <= most, "({x}, {y}): {answer}, not {exact}, off by {error} of {most}");
            }
            [] if !inside => assert_eq!(answer, "none"),
            _ => panic!("({x}, {y}): {answer}"),
        }
    }
    assert_eq!(answers.next(), None);
}

#[test]
fn the_c_header_compiles_and_is_within_its_stated_error() {
    let directory = TempDir::new().unwrap();
    let (header, source) = (directory.path().join("undistortion.h"), directory.path().join("main.c"));
    let calibration = calibration(&directory);
    let options = ["--c-header", header.to_str().unwrap(), "--ideal", "300,301,172.5,129.5", "--max-error", "0.05"];
    let report = export(&calibration, &options);
    let largest_error = report["largest_error_px"].as_f64().unwrap();
    assert!(largest_error > 0.0 && largest_error <= 0.05, "{report}");
    assert_eq!(report["bytes"], 8 * report["columns"].as_u64().unwrap() * report["rows"].as_u64().unwrap());

    let mut program = String::from(
        "#include \"undistortion.h\"\n#include <stdio.h>\nstatic void ask(float x, float y)\n{\n    float u, v;\n    \
         if (evcal_undistort(x, y, &u, &v)) printf(\"%.9g %.9g\\n\", u, v);\n    else printf(\"none\\n\");\n}\n\
         int main(void)\n{\n",
    );
    for (x, y) in queries() {
        let _ = writeln!(program, "    ask({x:?}f, {y:?}f);");
    }
    program += "    return 0;\n}\n";
    fs::write(&source, program).unwrap();
    let binary = directory.path().join("main");
    let strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"];
    run(Command::new("cc").args(strict).arg(&source).arg("-o").arg(&binary));
    // The stated error applies to pixel centres; between them it may be slightly larger, and fx differs from fy.
    compare(&run(&mut Command::new(&binary)), largest_error * 300.0 / 330.0 * 1.1 + 1e-4);
}

#[test]
fn the_rust_table_compiles_and_is_within_its_stated_error() {
    let directory = TempDir::new().unwrap();
    let (module, source) = (directory.path().join("undistortion.rs"), directory.path().join("main.rs"));
    let calibration = calibration(&directory);
    let options = ["--rust-table", module.to_str().unwrap(), "--ideal", "300,301,172.5,129.5", "--nodes", "40x30"];
    let report = export(&calibration, &options);
    assert_eq!((&report["columns"], &report["rows"]), (&Value::from(40), &Value::from(30)));

    let mut program = String::from(
        "#![deny(warnings)]\npub mod undistortion;\nfn ask(x: f32, y: f32) {\n    match undistortion::undistort(x, y) {\n        \
         Some([u, v]) => println!(\"{u} {v}\"),\n        None => println!(\"none\"),\n    }\n}\nfn main() {\n",
    );
    for (x, y) in queries() {
        let _ = writeln!(program, "    ask({x:?}, {y:?});");
    }
    program += "}\n";
    fs::write(&source, program).unwrap();
    let binary = directory.path().join("main");
    let compiler = option_env!("RUSTC").unwrap_or("rustc");
    run(Command::new(compiler).args(["--edition", "2021"]).arg(&source).arg("-o").arg(&binary));
    let largest_error = report["largest_error_px"].as_f64().unwrap();
    compare(&run(&mut Command::new(&binary)), largest_error * 300.0 / 330.0 * 1.1 + 1e-4);
}

#[test]
fn a_smaller_error_needs_more_nodes_and_wrong_usage_is_reported() {
    let directory = TempDir::new().unwrap();
    let calibration = calibration(&directory);
    let header = directory.path().join("t.h");
    let header = header.to_str().unwrap();
    let bytes =
        |error: &str| export(&calibration, &["--c-header", header, "--force", "--max-error", error])["bytes"].as_u64();
    assert!(bytes("0.01") > bytes("0.1"));
    let failure = |options: &[&str]| {
        let mut program = Command::new(env!("CARGO_BIN_EXE_evcal"));
        let output = program.arg("export").arg(&calibration).args(options).output().unwrap();
        (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    for (options, code, part) in [
        (&[] as &[&str], 2, "--c-header"),
        (&["--c-header", header, "--max-error=-1"], 2, "from 0.000001 to 100"),
        (&["--c-header", header, "--nodes", "1x9"], 2, "44x33"),
        (&["--c-header", header, "--ideal", "1,2,3"], 2, "fx,fy,cx,cy"),
        (&["--c-header", header, "--force", "--max-error", "1e-6"], 1, "32-bit"),
        (&["--c-header", "/nonexistent/t.h"], 1, "/nonexistent/t.h"),
    ] {
        let (found, message) = failure(options);
        assert!(found == code && message.contains(part), "{options:?}: {found} {message}");
    }
}
