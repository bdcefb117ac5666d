//! Dark quadrilaterals of a picture, which are candidates for tags.
//!
//! Pixels darker than the mean of their surroundings, for surroundings of several sizes, form connected regions. The
//! outermost pixels of a region are removed first, because the corners of tags may touch dark squares. A region is a
//! candidate if its convex hull is nearly a quadrilateral.

use crate::picture::Picture;

/// The picture is enlarged by this factor.
const ENLARGEMENT: usize = 2;
/// Standard deviation in pixels of the smoothing before the search.
const SMOOTHING: f32 = 0.7;
/// For large quadrilaterals the search is repeated in the picture at half the scale, down to this width or height in
/// pixels.
const LEAST_PICTURE: usize = 100;
/// Half the side of the surroundings in enlarged pixels.
const SURROUNDINGS: [usize; 4] = [7, 13, 22, 36];
/// A pixel is dark if it is darker than its surroundings by this fraction of the contrast.
const DARKER: f32 = 0.03;
/// The brightest pixel of a picture, after it was scaled for sums of integers; the darkest is 0. The sum over the largest surroundings
/// has 27 bits.
const MOST: f32 = 16_384.0;
/// Smallest side of a quadrilateral in pixels of the picture.
const LEAST_SIDE: f32 = 8.0;
/// Smallest fraction of the quadrilateral that the hull of the region fills.
const LEAST_FILLED: f32 = 0.8;
/// Distance in enlarged pixels by which the sides are moved outwards, because the outermost pixels of a region were
/// removed.
const TAKEN_OFF: f32 = 1.2;

/// The corners of a quadrilateral, clockwise in the picture (x to the right, y down).
pub type Quad = [[f32; 2]; 4];

/// Finds dark quadrilaterals; the same one may be found several times.
pub fn find_quads(picture: &Picture) -> Vec<Quad> {
    quads_by_scale(picture).flatten().collect()
}

/// Finds dark quadrilaterals, the largest ones first: in the picture at the smallest scale, then at twice this scale, and so on.
pub(crate) fn quads_by_scale(picture: &Picture) -> impl Iterator<Item = Vec<Quad>> + '_ {
    let is_large = |picture: &Picture| picture.width().min(picture.height()) >= LEAST_PICTURE;
    let smaller = |picture: &Picture| picture.halved().filter(is_large);
    let reduced: Vec<Picture> = std::iter::successors(smaller(picture), smaller).collect();
    let count = reduced.len() + 1;
    (0..count).rev().map(move |number| {
        let scale = (1_usize << number) as f32;
        let large = |quad: Quad| quad.map(|corner| corner.map(|place| (place + 0.5) * scale - 0.5));
        let at_scale = number.checked_sub(1).and_then(|number| reduced.get(number)).unwrap_or(picture);
        quads_at_scale(at_scale).into_iter().map(large).collect()
    })
}

/// Finds the quadrilaterals whose size matches the surroundings.
fn quads_at_scale(picture: &Picture) -> Vec<Quad> {
    let large = picture.blurred(SMOOTHING).enlarged(ENLARGEMENT);
    let darkest = large.values().iter().copied().fold(f32::INFINITY, f32::min);
    let brightest = large.values().iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let scale = MOST / (brightest - darkest);
    if !scale.is_finite() {
        return Vec::new();
    }
    let darker = DARKER * scale * large.contrast();
    let large = large.map(|value| scale * (value - darkest));
    let sums = sums(&large);
    let mut quads = Vec::new();
    for half in SURROUNDINGS {
        let dark = shrunk(&dark_pixels(&large, &sums, half, darker), large.width());
        for hull in hulls(&dark, large.width()) {
            quads.extend(quad_of(hull).map(|quad| {
                let scale = ENLARGEMENT as f32;
                quad.map(|corner| corner.map(|place| (place + 0.5) / scale - 0.5))
            }));
        }
    }
    quads
}

/// Returns the sums over the rectangles from the top left corner to each pixel, without their highest bits, which cancel in the sum
/// over surroundings; the first row and column are 0.
fn sums(picture: &Picture) -> Vec<i32> {
    let width = picture.width() + 1;
    let mut sums = vec![0_i32; width * (picture.height() + 1)];
    for (y, row) in picture.values().chunks_exact(picture.width()).enumerate() {
        let (above, below) = sums.split_at_mut((y + 1) * width);
        let above = &above[y * width..];
        let mut sum = 0_i32;
        for (x, value) in row.iter().enumerate() {
            sum = sum.wrapping_add((*value + 0.5) as i32);
            below[x + 1] = above[x + 1].wrapping_add(sum);
        }
    }
    sums
}

/// Returns 1 for each pixel that is darker by `darker` than the mean of its surroundings.
fn dark_pixels(picture: &Picture, sums: &[i32], half: usize, darker: f32) -> Vec<u8> {
    let (width, height) = (picture.width(), picture.height());
    let mut dark = vec![0; width * height];
    let wide = |x: usize| (x + half + 1).min(width) - x.saturating_sub(half);
    let widths: Vec<f32> = (0..width).map(|x| 1.0 / wide(x) as f32).collect();
    // Zeros on the left and the last value on the right, so that the columns near the border need no special case.
    let mut column_sums = vec![0_i32; width + 1 + 2 * half];
    for (y, (row, out)) in picture.values().chunks_exact(width).zip(dark.chunks_exact_mut(width)).enumerate() {
        let (top, bottom) = (y.saturating_sub(half), (y + half + 1).min(height));
        let (above, below) = (&sums[top * (width + 1)..][..=width], &sums[bottom * (width + 1)..][..=width]);
        for (sum, (above, below)) in column_sums[half..].iter_mut().zip(above.iter().zip(below)) {
            *sum = below.wrapping_sub(*above);
        }
        let last = column_sums[half + width];
        column_sums[half + width + 1..].fill(last);
        let high = 1.0 / (bottom - top) as f32;
        let ends = column_sums.iter().zip(&column_sums[2 * half + 1..]);
        for ((out, value), ((left, right), wide)) in out.iter_mut().zip(row).zip(ends.zip(&widths)) {
            *out = u8::from(*value + darker < right.wrapping_sub(*left) as f32 * (wide * high));
        }
    }
    dark
}

/// Returns the pixels whose eight neighbours are set too.
fn shrunk(set: &[u8], width: usize) -> Vec<u8> {
    let mut along = vec![0; set.len()];
    for (row, out) in set.chunks_exact(width).zip(along.chunks_exact_mut(width)) {
        let three = row.iter().zip(row.iter().skip(1)).zip(row.iter().skip(2));
        for (((before, value), after), out) in three.zip(out.iter_mut().skip(1)) {
            *out = before & value & after;
        }
    }
    let mut shrunk = vec![0; set.len()];
    let rows = along.chunks_exact(width);
    let three = rows.clone().zip(rows.clone().skip(1)).zip(rows.skip(2));
    for (((above, row), below), out) in three.zip(shrunk.chunks_exact_mut(width).skip(1)) {
        for (out, ((above, value), below)) in out.iter_mut().zip(above.iter().zip(row).zip(below)) {
            *out = above & value & below;
        }
    }
    shrunk
}

/// Neighbouring set pixels of a row.
struct Run {
    y: usize,
    first: usize,
    last: usize,
    /// A run of the same region, or itself.
    parent: usize,
}

/// Returns the convex hulls of the connected regions that are large enough, clockwise in the picture.
fn hulls(set: &[u8], width: usize) -> Vec<Vec<[f32; 2]>> {
    let mut runs: Vec<Run> = Vec::new();
    let mut above = 0..0;
    for (y, row) in set.chunks_exact(width).enumerate() {
        let begin = runs.len();
        let mut candidate = above.start;
        let mut x = 0;
        while let Some(gap) = row[x..].iter().position(|value| *value != 0) {
            let first = x + gap;
            let length = row[first..].iter().position(|value| *value == 0).unwrap_or(width - first);
            x = first + length;
            let index = runs.len();
            runs.push(Run { y, first, last: x - 1, parent: index });
            while candidate < above.end && runs[candidate].last < first {
                candidate += 1;
            }
            let mut touching = candidate;
            while touching < above.end && runs[touching].first < x {
                join(&mut runs, touching, index);
                touching += 1;
            }
        }
        above = begin..runs.len();
    }
    let mut order: Vec<(usize, usize)> = (0..runs.len()).map(|index| (root(&mut runs, index), index)).collect();
    order.sort_unstable();
    let least = LEAST_SIDE * ENLARGEMENT as f32 * 0.7;
    let regions = order.chunk_by(|a, b| a.0 == b.0).filter(|region| region.len() as f32 >= least);
    let ends = |region: &[(usize, usize)]| -> Vec<[f32; 2]> {
        let ends = region.iter().flat_map(|&(_, index)| {
            let run = &runs[index];
            [[run.first as f32, run.y as f32], [run.last as f32, run.y as f32]]
        });
        ends.collect()
    };
    regions.map(|region| convex_hull(ends(region))).filter(|hull| hull.len() >= 4).collect()
}

fn root(runs: &mut [Run], mut index: usize) -> usize {
    while runs[index].parent != index {
        let grandparent = runs[runs[index].parent].parent;
        runs[index].parent = grandparent;
        index = grandparent;
    }
    index
}

fn join(runs: &mut [Run], a: usize, b: usize) {
    let (a, b) = (root(runs, a), root(runs, b));
    runs[a.max(b)].parent = a.min(b);
}

/// Returns the cross product of the steps from `a` to `b` and on to `c`: positive for a turn to the right in the
/// picture.
fn turn(a: [f32; 2], b: [f32; 2], c: [f32; 2]) -> f32 {
    (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
}

/// Returns the convex hull (Andrew's monotone chain), clockwise in the picture.
fn convex_hull(mut points: Vec<[f32; 2]>) -> Vec<[f32; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut hull: Vec<[f32; 2]> = Vec::new();
    for backwards in [false, true] {
        let fixed = hull.len() + 1;
        for index in 0..points.len() {
            let point = points[if backwards { points.len() - 1 - index } else { index }];
            while hull.len() > fixed && turn(hull[hull.len() - 2], hull[hull.len() - 1], point) <= 0.0 {
                hull.pop();
            }
            hull.push(point);
        }
        // The last point is the first of the other half.
        hull.pop();
    }
    hull
}

fn area(polygon: &[[f32; 2]]) -> f32 {
    let next = polygon.iter().cycle().skip(1);
    0.5 * polygon.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f32>()
}

/// Returns the intersection of the lines through `a`, `b` and through `c`, `d`.
fn meeting(a: [f32; 2], b: [f32; 2], c: [f32; 2], d: [f32; 2]) -> Option<[f32; 2]> {
    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [d[0] - c[0], d[1] - c[1]]);
    let cross = u[0] * v[1] - u[1] * v[0];
    let along = ((c[0] - a[0]) * v[1] - (c[1] - a[1]) * v[0]) / cross;
    along.is_finite().then(|| [a[0] + along * u[0], a[1] + along * u[1]])
}

/// Returns the quadrilateral around a hull, if the hull nearly fills it.
fn quad_of(mut hull: Vec<[f32; 2]>) -> Option<Quad> {
    let filled = area(&hull);
    // Removes one edge after another, always the one whose neighbours meet after adding the least area.
    while hull.len() > 4 {
        let count = hull.len();
        let without = |edge: usize| {
            let [before, a, b, after] = [count - 1, 0, 1, 2].map(|step| hull[(edge + step) % count]);
            let meeting = meeting(before, a, after, b)?;
            // They must meet on the outer side.
            let added = 0.5 * turn(a, meeting, b);
            (added >= 0.0).then_some((added, edge, meeting))
        };
        let (_, edge, meeting) = (0..count).filter_map(without).min_by(|a, b| a.0.total_cmp(&b.0))?;
        hull[edge] = meeting;
        hull.remove((edge + 1) % count);
    }
    let quad: Quad = hull.try_into().ok()?;
    let quad = outset(&quad, TAKEN_OFF)?;
    let least = LEAST_SIDE * ENLARGEMENT as f32;
    let side = |index: usize| {
        let (a, b) = (quad[index], quad[(index + 1) % 4]);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    let sides = [0, 1, 2, 3].map(side);
    let (shortest, longest) =
        sides.iter().fold((f32::INFINITY, 0.0_f32), |(low, high), &side| (low.min(side), high.max(side)));
    let whole = filled + TAKEN_OFF * sides.iter().sum::<f32>();
    let good = shortest >= least && longest < 4.0 * shortest && whole >= LEAST_FILLED * area(&quad);
    good.then_some(quad)
}

/// Returns the quadrilateral with its sides moved outwards.
fn outset(quad: &Quad, by: f32) -> Option<Quad> {
    let mut lines = [[[0.0; 2]; 2]; 4];
    for (index, line) in lines.iter_mut().enumerate() {
        let (a, b) = (quad[index], quad[(index + 1) % 4]);
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        let out = [(b[1] - a[1]) / length * by, -(b[0] - a[0]) / length * by];
        *line = [[a[0] + out[0], a[1] + out[1]], [b[0] + out[0], b[1] + out[1]]];
    }
    let mut moved = [[0.0; 2]; 4];
    for (index, corner) in moved.iter_mut().enumerate() {
        let ([a, b], [c, d]) = (lines[(index + 3) % 4], lines[index]);
        *corner = meeting(a, b, c, d)?;
    }
    Some(moved)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Dark squares on a plain board of which the rest of a large picture shows nothing but weak noise.
    #[test]
    fn small_squares_in_a_large_picture_are_found_at_their_places() {
        let (width, height) = (640, 480);
        let squares = [[100, 80], [140, 80], [100, 120]];
        let value = |index: usize| {
            let (x, y) = (index % width, index / width);
            let is_dark = |[left, top]: &[usize; 2]| (*left..left + 20).contains(&x) && (*top..top + 20).contains(&y);
            let noise = (index as u32).wrapping_mul(2_654_435_761) >> 24;
            0.0002 * noise as f32 - if squares.iter().any(is_dark) { 6.0 } else { 0.0 }
        };
        let picture = Picture::new(width, height, (0..width * height).map(value).collect()).unwrap();
        let quads = find_quads(&picture);
        for [left, top] in squares {
            let middle = [left as f32 + 9.5, top as f32 + 9.5];
            let is_near = |quad: &Quad| {
                [0, 1]
                    .iter()
                    .all(|&axis| (quad.iter().map(|corner| corner[axis]).sum::<f32>() / 4.0 - middle[axis]).abs() < 1.0)
            };
            assert!(quads.iter().any(is_near), "{left} {top}");
        }
        assert_eq!(find_quads(&picture.map(|_| 1.0)), Vec::<Quad>::new());
    }
}
