//! Success rates and time of the grid finder: `cargo bench -p evcal-core --bench grid`.
//!
//! Prints one line per setting: the fraction of views found in the right order, of views in the wrong order, and of
//! visible dots used, and the time per call. Then follow the timings of single calls.

#[path = "../tests/support/grid_views.rs"]
mod grid_views;

use std::time::Instant;

use evcal_core::grid::{GridCircle, GridOptions, GridWorkspace, Ordering, find_grid, find_grid_near, reorder};
use evcal_core::pattern::{Layout, Pattern};
use grid_views::{Lens, Random, SIZE, Setting, View, view};

const ASYMMETRIC: Pattern = Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 };
const CLEAN: Setting =
    Setting { pattern: ASYMMETRIC, lens: Lens::Radtan, tilt: 60.0, noise: 0.2, clutter: 0, missing: 0, cut: false };

fn main() {
    let views = std::env::var("EVCAL_GRID_VIEWS").ok().and_then(|count| count.parse().ok()).unwrap_or(3000);
    if !std::env::args().any(|argument| argument == "--test") {
        print_table(views);
    }
    divan::main();
}

fn print_table(views: usize) {
    println!("{views} random views per line");
    println!(
        "{:<44} {:>8} {:>8} {:>8} {:>8} {:>8} {:>9} {:>8}",
        "", "right", "intruder", "wrong", "none", "dots", "median µs", "95 % µs"
    );
    for lens in [Lens::Radtan, Lens::Fisheye] {
        let clean = Setting { lens, ..CLEAN };
        for clutter in [0, 4, 8, 16] {
            line(&Setting { clutter, ..clean }, views);
        }
        for missing in [1, 3, 6] {
            line(&Setting { missing, ..clean }, views);
        }
        line(&Setting { missing: 6, clutter: 8, ..clean }, views);
        line(&Setting { missing: 6, clutter: 16, ..clean }, views);
        for noise in [0.5, 1.0] {
            line(&Setting { noise, ..clean }, views);
            line(&Setting { noise, missing: 4, clutter: 8, ..clean }, views);
        }
        line(&Setting { missing: 12, ..clean }, views);
        line(&Setting { missing: 20, ..clean }, views);
        for placing in [Placing::Alone, Placing::Near] {
            placed_line(&Setting { cut: true, ..clean }, placing, views);
            placed_line(&Setting { cut: true, missing: 3, clutter: 8, noise: 0.5, ..clean }, placing, views);
        }
        placed_line(&Setting { missing: 20, ..clean }, Placing::Near, views);
    }
    for (rows, columns, layout) in
        [(6, 3, Layout::Symmetric), (5, 5, Layout::Symmetric), (8, 11, Layout::Symmetric), (11, 4, Layout::Asymmetric)]
    {
        let pattern = Pattern { layout, rows, columns };
        line(&Setting { pattern, ..CLEAN }, views);
        line(&Setting { pattern, clutter: 8, missing: 2, ..CLEAN }, views);
    }
}

fn line(setting: &Setting, count: usize) {
    placed_line(setting, Placing::Alone, count);
}

/// Information that the finder gets in addition to the candidates.
#[derive(Clone, Copy, Debug)]
enum Placing {
    Alone,
    /// Positions of the circles with an error of 3 px ([`find_grid_near`]).
    Near,
}

fn placed_line(setting: &Setting, placing: Placing, count: usize) {
    let mut random = Random::new(1);
    let mut workspace = GridWorkspace::<f64, 128>::new();
    let options = GridOptions::new(&setting.pattern, SIZE);
    let (mut right, mut intruder, mut wrong, mut used, mut visible) = (0, 0, 0, 0, 0);
    let mut times = Vec::with_capacity(count);
    for _ in 0..count {
        let view = view(setting, &mut random);
        let shift = nalgebra::Vector2::new(2.4, -1.8);
        let expected: Vec<_> = view.dots.iter().map(|dot| dot.map(|dot| dot + shift)).collect();
        let start = Instant::now();
        let found = match placing {
            Placing::Near => find_grid_near(&view.candidates, &setting.pattern, &options, &expected, &mut workspace),
            Placing::Alone => find_grid(&view.candidates, &setting.pattern, &options, &mut workspace),
        };
        times.push(start.elapsed().as_secs_f64());
        let Ok(found) = found else { continue };
        let orders = match found.ordering {
            Ordering::Unique => 1,
            Ordering::Ambiguous(orders) => usize::from(orders),
        };
        let misplaced = |turn: usize| {
            let wrong = |circle: &&GridCircle| {
                let truth = view.truth[usize::from(circle.candidate)];
                truth.is_some() && truth != reorder(&setting.pattern, usize::from(circle.board), turn)
            };
            found.circles.iter().filter(wrong).count()
        };
        if (0..orders).all(|turn| misplaced(turn) > 0) {
            wrong += 1;
        } else if found.circles.iter().any(|circle| view.truth[usize::from(circle.candidate)].is_none()) {
            intruder += 1;
        } else {
            right += 1;
            used += found.circles.len();
            visible += view.visible;
        }
    }
    times.sort_by(f64::total_cmp);
    let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
    println!(
        "{:<44} {:>7.2}% {:>7.2}% {:>7.2}% {:>7.2}% {:>7.2}% {:>9.1} {:>8.0}",
        name(setting, placing),
        percent(right, count),
        percent(intruder, count),
        percent(wrong, count),
        percent(count - right - intruder - wrong, count),
        percent(used, visible),
        1e6 * times[count / 2],
        1e6 * times[count * 95 / 100]
    );
}

fn name(setting: &Setting, placing: Placing) -> String {
    let layout = match setting.pattern.layout {
        Layout::Asymmetric => "asym",
        Layout::Symmetric => "sym",
    };
    let mut name = format!("{layout} {}x{} {:?}", setting.pattern.rows, setting.pattern.columns, setting.lens);
    name += &format!(" {} px", setting.noise);
    if setting.clutter > 0 {
        name += &format!(" +{}", setting.clutter);
    }
    if setting.missing > 0 {
        name += &format!(" -{}", setting.missing);
    }
    if setting.cut {
        name += " cut";
    }
    match placing {
        Placing::Alone => {}
        Placing::Near => name += ", near",
    }
    name
}

fn views(setting: &Setting) -> Vec<View> {
    let mut random = Random::new(7);
    (0..256).map(|_| view(setting, &mut random)).collect()
}

/// One call with 36 dots and the given number of other candidates.
#[divan::bench(args = [0, 4, 8, 16])]
fn call(bencher: divan::Bencher, clutter: usize) {
    let views = views(&Setting { clutter, ..CLEAN });
    let mut workspace = GridWorkspace::<f64, 128>::new();
    let options = GridOptions::new(&ASYMMETRIC, SIZE);
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % views.len();
        find_grid(&views[next].candidates, &ASYMMETRIC, &options, &mut workspace)
    });
}
