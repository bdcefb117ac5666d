//! What every stage took in and gave out.

use maud::{Markup, html};

use super::number::count;
use super::page::{Section, scrolling};
use crate::calibrate::Calibrated;

/// One line of the table.
struct Stage {
    name: &'static str,
    taken: String,
    given: String,
    rest: Vec<String>,
}

/// The stages as a table.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let table = table(&stages(calibrated));
    let content = html! {
        p { "Where a recording loses its data. A stage that keeps little is where to look first when a calibration disappoints." }
        (scrolling("Stages", &table))
    };
    Some(Section { id: "stages", title: "What each stage kept", content })
}

fn stages(calibrated: &Calibrated) -> Vec<Stage> {
    let reports = &calibrated.reports;
    let detection = &reports.detection;
    let reasons = |counts: &std::collections::BTreeMap<&'static str, u64>| {
        counts.iter().map(|(reason, number)| format!("{} {reason}", count(*number))).collect::<Vec<_>>()
    };
    let mut stages = Vec::new();
    if detection.windows + detection.too_few_events > 0 {
        let mut windows = reasons(&detection.grids_refused);
        windows.push(format!("{} had too few events", count(detection.too_few_events)));
        if detection.found_by_neighbours > 0 {
            windows.push(format!(
                "{} of those kept were placed by the frames around them",
                count(detection.found_by_neighbours)
            ));
        }
        stages.push(Stage {
            name: "Board in time windows",
            taken: format!("{} windows", count(detection.windows + detection.too_few_events)),
            given: format!("{} with the board", count(detection.found)),
            rest: windows,
        });
        stages.push(Stage {
            name: "Circles",
            taken: format!("{} circles", count(detection.circles)),
            given: format!("{} on boards", count(detection.board_circles)),
            rest: reasons(&detection.pairs_refused)
                .into_iter()
                .map(|reason| format!("{reason} (pairs of clusters)"))
                .collect(),
        });
    }
    let initial = &reports.initial;
    stages.push(Stage {
        name: "First lens and poses",
        taken: format!("{} frames", count(initial.frames_in as u64)),
        given: format!("{} frames", count(initial.frames_out as u64)),
        rest: if initial.dropped.is_empty() { Vec::new() } else { vec![initial.reasons()] },
    });
    let segments = &reports.segments;
    let mut rest = Vec::new();
    for (number, what) in [
        (segments.too_few_frames, "groups of too few frames"),
        (segments.too_short, "groups too short"),
        (reports.segments_without_spline, "segments without spline"),
    ] {
        if number > 0 {
            rest.push(format!("{} {what}", count(number as u64)));
        }
    }
    if segments.frames_in > 0 {
        stages.push(Stage {
            name: "Trajectory segments",
            taken: format!("{} frames", count(segments.frames_in as u64)),
            given: format!(
                "{} in {} segments of {:.2} s",
                count(segments.frames_out as u64),
                segments.segments,
                segments.duration
            ),
            rest,
        });
    }
    if let Some(round) = reports.rounds.last() {
        let association = &round.association;
        if association.events > 0 {
            let rest = [
                (association.outside_segments, "outside segments"),
                (association.thinned, "left out by thinning"),
                (association.off_board, "not on the board"),
                (association.far_from_edge, "far from an edge"),
                (association.edge_slides, "on a slow or sliding edge"),
                (association.wrong_polarity, "of the wrong polarity"),
            ];
            stages.push(Stage {
                name: "Events to edges (last round)",
                taken: format!("{} events", count(association.events)),
                given: format!("{} events", count(association.kept)),
                rest: rest
                    .into_iter()
                    .filter(|one| one.0 > 0)
                    .map(|(number, what)| format!("{} {what}", count(number)))
                    .collect(),
            });
        }
    }
    for (index, round) in reports.rounds.iter().enumerate() {
        stages.push(Stage {
            name: if index + 1 == reports.rounds.len() { "Joint solve, last round" } else { "Joint solve" },
            taken: format!("{} observations", count(round.solve.observations as u64)),
            given: format!("{} iterations", round.solve.iterations),
            rest: vec![
                format!("cost {:.0} → {:.0}", round.solve.initial_cost, round.solve.final_cost),
                format!("projection moved {:.4} px", round.change),
            ],
        });
    }
    stages
}

fn table(stages: &[Stage]) -> Markup {
    html! {
        table {
            thead { tr {
                th scope="col" { "stage" }
                th scope="col" { "took" }
                th scope="col" { "gave" }
                th scope="col" { "the rest" }
            } }
            tbody {
                @for stage in stages {
                    tr {
                        th scope="row" { (stage.name) }
                        td { (stage.taken) }
                        td { (stage.given) }
                        td.words { (stage.rest.join(", ")) }
                    }
                }
            }
        }
    }
}
