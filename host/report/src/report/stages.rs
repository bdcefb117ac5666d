//! Input and output of every stage.

use maud::{Markup, html};

use super::number::count;
use super::page::{Section, scrolling};
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::result::stage_lines::{Amount, StageLine, stage_lines};

/// Returns the stages as a table.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let content = html! {
        p { "How much of the data each stage keeps. If a calibration disappoints, look first at a stage that keeps little." }
        (scrolling("Stages", &table(&stage_lines(calibrated))))
    };
    Some(Section { id: "stages", title: "What each stage kept", content })
}

fn table(lines: &[StageLine]) -> Markup {
    let in_words = |amount: &Amount| format!("{} {}", count(amount.count), amount.what);
    let rest = |line: &StageLine| {
        let dropped = line.dropped.iter().map(in_words);
        dropped.chain(line.notes.iter().cloned()).collect::<Vec<_>>().join(", ")
    };
    html! {
        table.stages {
            thead { tr {
                th scope="col" { "stage" }
                th scope="col" { "took" }
                th scope="col" { "gave" }
                th scope="col" { "the rest" }
            } }
            tbody {
                @for line in lines {
                    tr {
                        th scope="row" { (line.stage) }
                        td { (in_words(&line.taken)) }
                        td { (in_words(&line.given)) }
                        td.words { (rest(line)) }
                    }
                }
            }
        }
    }
}
