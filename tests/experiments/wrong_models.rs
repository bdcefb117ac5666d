//! Lenses calibrated with models that are not theirs: is the error inside the stated bound, and is the right model named?
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/wrong_models [SEED]
//! ```

use evcal_tests::lens::{EUCM, FOV, KANNALA_BRANDT, Lens, RADTAN, RADTAN8};
use evcal_tests::{BOARD, json, read_json, succeed, text};
use serde_json::Value;

/// Lenses, and the models that they are calibrated with.
const WRONG: [(Lens, [&str; 3]); 5] = [
    (RADTAN, ["radtan4", "ucm", "fov"]),
    (RADTAN8, ["radtan4", "ucm", "fov"]),
    (KANNALA_BRANDT, ["radtan4", "radtan", "fov"]),
    (EUCM, ["radtan4", "radtan", "ucm"]),
    (FOV, ["radtan4", "radtan", "ucm"]),
];

fn main() {
    let seed = std::env::args().nth(1).unwrap_or_else(|| "7".to_owned());
    println!("| lens | calibrated as | true error rms / max (px) | stated, 95 % (px) | verdict | model named |");
    println!("|---|---|---|---|---|---|");
    for (lens, models) in WRONG {
        let folder = tempfile::tempdir().expect("a folder can be made");
        let simulation = folder.path().join("simulation");
        let camera = ["--board", BOARD, "--model", lens.model, "--parameters", lens.parameters];
        let motion = ["--motion", "fast", "--duration", "4s", "--seed", &seed, "-o", text(&simulation)];
        succeed(&[&["simulate"][..], &camera, &motion].concat());
        let events = simulation.join("events.aedat4");
        for model in models {
            let calibration = folder.path().join(model);
            let options = ["--board", BOARD, "--model", model, "--accept-any", "-o", text(&calibration)];
            succeed(&[&["calibrate", text(&events)][..], &options].concat());
            let result = read_json(&calibration.join("calibration.json"));
            let evaluation = json(&["evaluate", text(&calibration), "--truth", text(&simulation), "--json"]);
            let number = |value: &Value| value.as_f64().expect("a number");
            let error = &evaluation["projection_difference"];
            println!(
                "| `{}` | `{model}` | {:.3} / {:.2} | {:.3} | {} | {} |",
                lens.model,
                number(&error["rms_px"]),
                number(&error["max_px"]),
                number(&result["uncertainty"]["projection_rms_95"]),
                result["verdict"]["grade"].as_str().expect("a grade"),
                result["misfit"]["better_model"].as_str().unwrap_or("none"),
            );
        }
    }
}
