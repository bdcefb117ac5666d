//! Plots and sensor maps as inline SVG. Colours, dashes and letters are those of the page's style sheet.

use std::ops::Range;

use evcal_core::sensor::Sensor;
use maud::{Markup, html};

use super::palette::Palette;

/// Width of the drawings in their own units; the page scales them.
const WIDTH: f64 = 960.0;
/// Height of the letters, which the style sheet sets.
const TEXT: f64 = 34.0;
/// Room around the plotting area for labels; on the right for half of the last one.
const LEFT: f64 = 166.0;
const RIGHT: f64 = 32.0;
const TOP: f64 = 16.0;
const BOTTOM: f64 = 100.0;
const ROOM: f64 = WIDTH - LEFT - RIGHT;
/// Distance between an axis and its numbers.
const GAP: f64 = 10.0;
/// Height of the plotting area of a chart, and the limits of a map's.
const HEIGHT: f64 = 444.0;
const HEIGHTS: Range<f64> = 200.0..2.0 * WIDTH;

/// A colour and dash of the style sheet. The colours of ON and OFF events are not among them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Color {
    /// Red, solid.
    First,
    /// Green, dashed.
    Second,
    /// Indigo, dotted.
    Third,
    /// Brown, dash and dot.
    Fourth,
}

impl Color {
    /// All, in the order in which curves use them; the axes x, y and z use the first three.
    pub const ALL: [Self; 4] = [Self::First, Self::Second, Self::Third, Self::Fourth];

    /// Class of the style sheet for lines of this colour and dash.
    pub fn class(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::Second => "second",
            Self::Third => "third",
            Self::Fourth => "fourth",
        }
    }
}

/// A group of curves or points.
pub struct Series {
    /// Name in the legend; empty for a series without an entry.
    pub name: String,
    /// Colour.
    pub color: Color,
    /// Curves; each is drawn without gaps.
    pub curves: Vec<Vec<(f64, f64)>>,
    /// Single points.
    pub points: Vec<(f64, f64)>,
}

/// A plot of curves and points.
pub struct Chart<'a> {
    /// Alternative text for screen readers.
    pub description: String,
    /// Quantity and unit along x.
    pub x_label: &'a str,
    /// Quantity and unit along y.
    pub y_label: &'a str,
    /// Range of the x axis.
    pub x: Range<f64>,
    /// Range of the y axis.
    pub y: Range<f64>,
    /// Curves and points.
    pub series: Vec<Series>,
}

/// Returns the smallest range around `values` with a margin, at least `narrowest` wide.
pub fn range_of(values: impl Iterator<Item = f64>, narrowest: f64) -> Range<f64> {
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return -0.5 * narrowest..0.5 * narrowest;
    }
    let half = (0.54 * (high - low)).max(0.5 * narrowest);
    let middle = 0.5 * (low + high);
    middle - half..middle + half
}

/// The axes around a plotting area.
struct Axes<'a> {
    /// Alternative text for screen readers.
    description: &'a str,
    /// Quantities and units along x and y.
    labels: [&'a str; 2],
    /// Values at the left and right side.
    x: [f64; 2],
    /// Values at the lower and upper side.
    y: [f64; 2],
    /// Height of the plotting area in units of the drawing.
    height: f64,
}

impl Axes<'_> {
    /// Returns the place of a point in the plotting area.
    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let share = |value: f64, [from, to]: [f64; 2]| (value - from) / (to - from);
        [ROOM * share(x, self.x), self.height * (1.0 - share(y, self.y))].map(round)
    }

    /// Returns the points as the attribute of a polyline; those that are not finite are left out.
    fn points(&self, curve: &[(f64, f64)]) -> String {
        let places =
            curve.iter().map(|&(x, y)| self.at(x, y)).filter(|place| place.iter().all(|side| side.is_finite()));
        places.map(|[x, y]| format!("{x},{y}")).collect::<Vec<_>>().join(" ")
    }

    /// Returns the drawing with `content` in its plotting area, which cuts it off.
    fn draw(&self, content: &Markup) -> Markup {
        let (right, bottom) = (WIDTH - RIGHT, TOP + self.height);
        let columns: Vec<_> = ticks(self.x, 7).into_iter().map(|x| (LEFT + self.at(x, self.y[0])[0], x)).collect();
        let rows: Vec<_> = ticks(self.y, 6).into_iter().map(|y| (TOP + self.at(self.x[0], y)[1], y)).collect();
        let lines = columns.iter().map(|(x, _)| format!("M{x} {TOP}V{bottom}"));
        let lines: String = lines.chain(rows.iter().map(|(y, _)| format!("M{LEFT} {y}H{right}"))).collect();
        html! {
            svg.plot role="img" aria-label=(self.description) viewBox={ "0 0 " (WIDTH) " " (round(bottom + BOTTOM)) } {
                path.grid d=(lines) {}
                svg x=(LEFT) y=(TOP) width=(ROOM) height=(round(self.height)) { (content) }
                path.axis d={ "M" (LEFT) " " (TOP) "V" (bottom) "H" (right) } {}
                @for (x, value) in &columns {
                    text x=(round(*x)) y=(bottom + GAP + TEXT) text-anchor="middle" { (label(value)) }
                }
                @for (y, value) in &rows {
                    text x=(LEFT - GAP) y=(round(y + 0.35 * TEXT)) text-anchor="end" { (label(value)) }
                }
                text x=(LEFT + 0.5 * ROOM) y=(bottom + BOTTOM - GAP) text-anchor="middle" { (self.labels[0]) }
                text x="0" y="0" text-anchor="middle" transform={ "translate(" (TEXT) "," (round(TOP + 0.5 * self.height)) ") rotate(-90)" } {
                    (self.labels[1])
                }
            }
        }
    }
}

/// Returns at most about `most` multiples of 1, 2 or 5 times a power of ten between two values.
fn ticks([from, to]: [f64; 2], most: u32) -> Vec<f64> {
    let (low, high) = (from.min(to), from.max(to));
    let step = round_steps((high - low) / f64::from(most), &[1.0, 2.0, 5.0]);
    if !(high - low).is_finite() || high <= low {
        return Vec::new();
    }
    let (first, last) = ((low / step).ceil(), (high / step + 1e-9).floor());
    (0..=most + 1).map(|index| first + f64::from(index)).take_while(|at| *at <= last).map(|at| at * step).collect()
}

impl Chart<'_> {
    /// Returns the plot with its legend.
    pub fn render(&self) -> Markup {
        let named = || self.series.iter().filter(|series| !series.name.is_empty());
        let axes = Axes {
            description: &self.description,
            labels: [self.x_label, self.y_label],
            x: [self.x.start, self.x.end],
            y: [self.y.start, self.y.end],
            height: HEIGHT,
        };
        let content = html! {
            @for series in &self.series {
                @for curve in series.curves.iter().filter(|curve| curve.len() > 1) {
                    polyline.(series.color.class()) points=(axes.points(curve)) {}
                }
                @for &(x, y) in series.points.iter().filter(|(x, y)| x.is_finite() && y.is_finite()) {
                    @let [x, y] = axes.at(x, y);
                    circle.(series.color.class()) cx=(x) cy=(y) r="6" {}
                }
            }
        };
        html! {
            (axes.draw(&content))
            @if named().count() > 1 {
                ul.legend {
                    @for series in named() {
                        li { (sample(series.color)) (series.name) }
                    }
                }
            }
        }
    }
}

/// Returns a short line in the colour and dash of a series.
fn sample(color: Color) -> Markup {
    html! {
        i.sample.(color.class()) {}
    }
}

/// Returns a number for an axis, without trailing zeros and with a minus sign (U+2212).
fn label(value: &f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    match text.strip_prefix('-') {
        Some("0") => "0".to_owned(),
        Some(size) => format!("−{size}"),
        None => text.to_owned(),
    }
}

/// Returns the value that [`USUAL`] of the values do not exceed; 0 without values.
pub fn usual_largest(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let last = (values.len() as f64 * USUAL).ceil() as usize;
    values.get(last.saturating_sub(1)).copied().unwrap_or(0.0)
}

/// Returns the largest of 1, 2 and 5 times a power of ten that is not above `value`.
pub fn round_down(value: f64) -> f64 {
    let power = 10_f64.powf(value.max(1e-9).log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|step| step * power).find(|step| *step <= value).unwrap_or(power)
}

/// Returns the smallest of 1, 1.5, 2, 3, 5 and 7 times a power of ten that is not below `value`.
pub fn round_up(value: f64) -> f64 {
    round_steps(value, &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0])
}

fn round_steps(value: f64, steps: &[f64]) -> f64 {
    let power = 10_f64.powf(value.max(1e-9).log10().floor());
    steps.iter().map(|step| step * power).find(|step| *step >= value).unwrap_or(10.0 * power)
}

/// Returns a coordinate with one decimal.
pub fn round(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

/// Returns a cell of a map around each point (px) of a regular grid, row by row, with the value at that point.
pub fn cells_of_grid(points: &[([f64; 2], Option<f64>)], columns: usize, rows: usize) -> Vec<Cell> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    let half = |axis: usize, count: usize| 0.5 * (last.0[axis] - first.0[axis]) / count.saturating_sub(1).max(1) as f64;
    let (half_x, half_y) = (half(0, columns), half(1, rows));
    let cell = |([x, y], value): &([f64; 2], Option<f64>)| ([x - half_x, y - half_y, x + half_x, y + half_y], *value);
    points.iter().map(cell).collect()
}

/// Left, top, right and bottom (px) of a cell of a map, and its value; `None` without data.
pub type Cell = ([f64; 4], Option<f64>);

/// Number of steps of a map's colours.
const SHADES: f64 = 48.0;
/// Difference between the sides of neighbouring cells (px).
const ROUNDING: f64 = 1e-6;
/// Share of the values that are within a scale: one odd cell does not set it.
const USUAL: f64 = 0.95;
/// Smallest distance of the number on a line of equal value from the sides of the map.
const NUMBER: f64 = 50.0;

/// Cells of one colour: left, top, right and bottom (px), and their value as a share of the scale.
#[derive(Clone, Copy, PartialEq)]
struct Area {
    sides: [f64; 4],
    shade: Option<f64>,
}

/// A map of the sensor in cells.
pub struct SensorMap {
    /// Alternative text for screen readers.
    pub description: String,
    /// Width and height of the sensor (px).
    pub sensor: Sensor,
    /// Cells, row by row. Their values are 0 or more.
    pub cells: Vec<Cell>,
    /// Colours.
    pub palette: Palette,
    /// Unit of the values.
    pub unit: &'static str,
    /// Arrows: start (px) and vector (px, enlarged by the caller).
    pub arrows: Vec<([f64; 2], [f64; 2])>,
    /// `true` to draw lines of equal value, with numbers.
    pub contours: bool,
}

impl SensorMap {
    /// Returns the map with its scale.
    pub fn render(&self) -> Markup {
        let (width, height) = (f64::from(self.sensor.width.max(1)), f64::from(self.sensor.height.max(1)));
        // The rows of the sensor are counted downwards.
        let axes = Axes {
            description: &self.description,
            labels: ["column (px)", "row (px)"],
            x: [-0.5, width - 0.5],
            y: [height - 0.5, -0.5],
            height: (ROOM * height / width).clamp(HEIGHTS.start, HEIGHTS.end),
        };
        let top = self.top();
        let exceeds = self.cells.iter().any(|cell| cell.1.is_some_and(|value| value > top));
        let content = html! {
            @for Area { sides: [left, upper, right, lower], shade } in self.areas(top) {
                @let [from, to] = [axes.at(left, upper), axes.at(right, lower)];
                @let outline = format!("M{} {}H{}V{}H{}z", from[0], from[1], to[0], to[1], from[0]);
                @match shade {
                    Some(shade) => {
                        @let [red, green, blue] = self.palette.color(shade);
                        path fill=(format!("#{red:02x}{green:02x}{blue:02x}")) d=(outline) {
                            title { (label(&significant(shade * top))) " " (self.unit) }
                        }
                    }
                    None => path.nothing d=(outline) {},
                }
            }
            @for (from, along) in &self.arrows { path.arrow d=(arrow(&axes, *from, *along)) {} }
            @if self.contours { (self.lines(&axes, top)) }
        };
        html! {
            (axes.draw(&content))
            div.scale aria-hidden="true" {
                span { "0" }
                span.bar style=(self.palette.gradient()) {}
                span { @if exceeds { "≥ " } (label(&top)) " " (self.unit) }
                @if self.cells.iter().any(|cell| cell.1.is_none()) { span.nothing {} span { "no data" } }
            }
        }
    }

    /// Returns the value at the end of the scale.
    fn top(&self) -> f64 {
        round_up(usual_largest(self.cells.iter().filter_map(|cell| cell.1)))
    }

    /// Returns the cells in one of [`SHADES`] colours; neighbours of one colour in a row are one area.
    fn areas(&self, top: f64) -> Vec<Area> {
        let mut areas: Vec<Area> = Vec::new();
        for &(sides, value) in &self.cells {
            let shade = value.map(|value| (value / top * SHADES).round().min(SHADES) / SHADES);
            let [left, upper, right, _] = sides;
            match areas.last_mut() {
                Some(last)
                    if last.shade == shade && last.sides[1] == upper && (last.sides[2] - left).abs() < ROUNDING =>
                {
                    last.sides[2] = right;
                }
                _ => areas.push(Area { sides, shade }),
            }
        }
        areas
    }

    /// Returns lines of equal value, each with its number.
    fn lines(&self, axes: &Axes, top: f64) -> Markup {
        let levels = ticks([0.0, top], 4).into_iter().filter(|level| *level > 0.0);
        let middle = 0.5 * axes.height;
        html! {
            @for level in levels {
                @let segments: Vec<[[f64; 2]; 2]> = self.contour(level).into_iter().map(|ends| ends.map(|[x, y]| axes.at(x, y))).collect();
                @let path: String = segments.iter().map(|[[x, y], [to_x, to_y]]| format!("M{x} {y}L{to_x} {to_y}")).collect();
                // On the right, where the lines cross the middle row.
                @let place = |segment: &&[[f64; 2]; 2]| (segment[0][1] - middle).abs() - 0.1 * segment[0][0];
                @if let Some([[x, y], _]) = segments.iter().min_by(|a, b| place(a).total_cmp(&place(b))) {
                    path.contour d=(path) {}
                    text.contour x=(x.clamp(NUMBER, ROOM - NUMBER)) y=(round(y + 0.35 * TEXT)) text-anchor="middle" { (label(&level)) }
                }
            }
        }
    }

    /// Returns the ends of the segments (px) of the line on which the values, linear between the centres of the cells, are `level`.
    fn contour(&self, level: f64) -> Vec<[[f64; 2]; 2]> {
        let upper = |cell: &Cell| cell.0[1];
        let columns = self.cells.iter().take_while(|cell| upper(cell) == self.cells.first().map_or(0.0, upper)).count();
        let known = |row: &[Cell], column: usize| {
            let ([left, upper, right, lower], value) = *row.get(column)?;
            Some(([0.5 * (left + right), 0.5 * (upper + lower)], value?))
        };
        let rows: Vec<&[Cell]> = self.cells.chunks_exact(columns.max(1)).collect();
        let mut segments = Vec::new();
        for pair in rows.windows(2) {
            let [above, below] = pair else { continue };
            for column in 1..columns {
                let corners = [(above, column - 1), (above, column), (below, column), (below, column - 1)];
                let corners: Vec<_> = corners.iter().filter_map(|(row, column)| known(row, *column)).collect();
                if corners.len() < 4 {
                    continue;
                }
                let sides = corners.iter().zip(corners.iter().cycle().skip(1));
                let crossed = sides.filter(|(a, b)| (a.1 < level) != (b.1 < level)).map(|(a, b)| {
                    let share = (level - a.1) / (b.1 - a.1);
                    [0, 1].map(|axis| a.0[axis] + share * (b.0[axis] - a.0[axis]))
                });
                let crossed: Vec<[f64; 2]> = crossed.collect();
                segments.extend(crossed.chunks_exact(2).map(|ends| [ends[0], ends[1]]));
            }
        }
        segments
    }
}

/// Returns the outline of an arrow (px).
fn arrow(axes: &Axes, from: [f64; 2], along: [f64; 2]) -> String {
    let tip = [from[0] + along[0], from[1] + along[1]];
    let wing = |turn: f64| [tip[0] - 0.3 * (along[0] - turn * along[1]), tip[1] - 0.3 * (along[1] + turn * along[0])];
    let [from, tip, left, right] = [from, tip, wing(0.5), wing(-0.5)].map(|[x, y]| {
        let [x, y] = axes.at(x, y);
        format!("{x} {y}")
    });
    format!("M{from}L{tip}M{left}L{tip}L{right}")
}

/// Returns a value with two significant digits.
fn significant(value: f64) -> f64 {
    let unit = 10_f64.powf(value.max(1e-9).log10().floor() - 1.0);
    (value / unit).round() * unit
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(sensor: Sensor, cells: Vec<Cell>) -> SensorMap {
        let palette = Palette::Error;
        SensorMap { description: String::new(), sensor, cells, palette, unit: "px", arrows: Vec::new(), contours: true }
    }

    #[test]
    fn neighbours_of_one_colour_are_one_area() {
        let points: Vec<([f64; 2], Option<f64>)> = (0..40)
            .map(|index| {
                let (column, row) = (f64::from(index % 10), f64::from(index / 10));
                ([column * 5.0, row * 5.0], (index != 17).then_some(if column < 6.0 { 0.101 } else { 0.9 }))
            })
            .collect();
        let map = map(Sensor::new(50, 20), cells_of_grid(&points, 10, 4));
        let areas = map.areas(1.0);
        // Two colours in each of four rows, and a cell without data within one of them.
        assert_eq!(areas.len(), 2 * 4 + 2);
        let size = |[left, top, right, bottom]: [f64; 4]| (right - left) * (bottom - top);
        let of_areas: f64 = areas.iter().map(|area| size(area.sides)).sum();
        assert!((of_areas - map.cells.iter().map(|cell| size(cell.0)).sum::<f64>()).abs() < 1e-9);
    }

    /// Values that are the distance from a point: the line of equal value is a circle, and its number is on it.
    #[test]
    fn contours_are_where_the_values_are_equal() {
        let distance = |x: f64, y: f64| (x - 24.0).hypot(y - 18.0);
        let points: Vec<_> = (0..25 * 19)
            .map(|index| ([f64::from(index % 25) * 2.0, f64::from(index / 25) * 2.0], index))
            .map(|(at, index)| (at, (index != 200).then_some(distance(at[0], at[1]))))
            .collect();
        let map = map(Sensor::new(50, 38), cells_of_grid(&points, 25, 19));
        let segments = map.contour(10.0);
        assert!(segments.len() > 30, "{}", segments.len());
        for [x, y] in segments.into_iter().flatten() {
            assert!((distance(x, y) - 10.0).abs() < 0.1, "{x} {y}");
        }
        assert!(map.contour(100.0).is_empty());
        let text = map.render().into_string();
        assert!(
            text.contains("<title>10 px</title>") && text.matches("<text class=\"contour\"").count() >= 2,
            "{text}"
        );
    }

    #[test]
    fn one_cell_does_not_set_the_scale() {
        let cell =
            |index: usize| ([index as f64, 0.0, index as f64 + 1.0, 1.0], Some(if index == 7 { 90.0 } else { 0.19 }));
        let map = map(Sensor::new(40, 1), (0..40).map(cell).collect());
        assert_eq!(map.top(), 0.2);
        assert!(map.render().into_string().contains("≥ 0.2 px"));
    }

    #[test]
    fn ticks_are_round_numbers_within_the_axis() {
        assert_eq!(ticks([0.0, 345.5], 7), [0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0]);
        assert_eq!(ticks([2.5, -2.5], 6), [-2.0, -1.0, 0.0, 1.0, 2.0]);
        assert!(ticks([1.0, 1.0], 6).is_empty() && ticks([f64::NAN, 1.0], 6).is_empty());
    }

    #[test]
    fn labels_have_no_needless_digits() {
        for (value, text) in [(0.0, "0"), (-1e-9, "0"), (1.50, "1.5"), (-20.0, "−20"), (0.000_01, "0.00001")] {
            assert_eq!(label(&value), text);
        }
    }

    #[test]
    fn scales_end_at_round_numbers() {
        for (value, down, up) in [(0.37, 0.2, 0.5), (1.0, 1.0, 1.0), (7.2, 5.0, 10.0), (130.0, 100.0, 150.0)] {
            assert!((round_down(value) - down).abs() < 1e-12, "{value}");
            assert!((round_up(value) - up).abs() < 1e-9, "{value}");
        }
    }

    #[test]
    fn ranges_contain_their_values_and_have_a_width() {
        let range = range_of([1.0, 3.0, f64::NAN].into_iter(), 0.1);
        assert!(range.start < 1.0 && range.end > 3.0 && range.end < 3.2);
        assert_eq!(range_of([2.0].into_iter(), 1.0), 1.5..2.5);
        assert_eq!(range_of(std::iter::empty(), 1.0), -0.5..0.5);
    }

    #[test]
    fn a_chart_is_one_labelled_drawing_and_text_is_escaped() {
        let series = |name: &str| Series {
            name: name.to_owned(),
            color: Color::First,
            curves: vec![vec![(0.0, 0.0), (1.0, 1.0)]],
            points: vec![(0.5, 0.5)],
        };
        let chart = Chart {
            description: "a \"plot\" <b>".to_owned(),
            x_label: "x < 1",
            y_label: "y",
            x: 0.0..1.0,
            y: 0.0..1.0,
            series: vec![series("first & last"), series("second")],
        };
        let html = chart.render().into_string();
        assert_eq!(html.matches("role=\"img\"").count(), 1);
        assert!(html.contains("aria-label=\"a &quot;plot&quot; &lt;b&gt;\""));
        assert!(html.contains("x &lt; 1") && html.contains("first &amp; last"));
    }
}
