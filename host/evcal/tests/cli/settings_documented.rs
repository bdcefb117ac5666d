//! `docs/settings.md` lists the settings of the code.

use evcal_calibrate::settings::document;

#[test]
fn the_tables_of_the_document_are_those_of_the_code() {
    let text = include_str!("../../../../docs/settings.md");
    let made = document(text).expect("marks around the tables");
    let differs = text.lines().zip(made.lines()).find(|(written, made)| written != made);
    assert!(text == made, "run `cargo run -p evcal --example settings_document`: {differs:?}");
}
