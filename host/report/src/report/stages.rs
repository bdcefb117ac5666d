//! Input, output and rejected data of each stage.

use maud::{Markup, html};

use super::number::count;
use super::page::{Section, scrolling};
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::result::stage_lines::{Amount, StageLine, stage_lines};

/// Returns the stages as a table.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let content = html! {
        p { "How much of the data each stage keeps. If a calibration is poor, first examine a stage that rejects most of its input." }
        (scrolling("Stages", &table(&stage_lines(calibrated))))
    };
    Some(Section { id: "stages", title: "Data kept by each stage", folded: true, content })
}

fn table(lines: &[StageLine]) -> Markup {
    let in_words = |amount: &Amount| format!("{} {}", count(amount.count), amount.what);
    let rest = |line: &StageLine| {
        let dropped = line.dropped.iter().map(|amount| format!("{}: {}", amount.what, count(amount.count)));
        dropped.chain(line.notes.iter().cloned()).collect::<Vec<_>>().join("; ")
    };
    html! {
        table.stages {
            thead { tr {
                th scope="col" { "stage" }
                th scope="col" { "input" }
                th scope="col" { "output" }
                th scope="col" { "rejected, and notes" }
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
