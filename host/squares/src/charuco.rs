//! Chessboard corners of a ChArUco board: predicted from its tags, refined by the four quadrants around them.

use nalgebra::Vector2;

use crate::found_point::FoundPoint;
use crate::picture::Picture;
use crate::saddles::{SaddleTest, refine_saddle};
use crate::tags::{FoundTag, TagFinder};

/// Half the side of the window in which a corner is refined, as a fraction of the corner's distance to the nearest tag
/// along x or y; and its limits in pixels. The window must exclude the tags in the light quadrants.
const WINDOW: f32 = 0.9;
const WINDOWS: [f32; 2] = [2.0, 6.0];
/// Largest distance of a corner from its prediction, as a fraction of the same distance to the nearest tag, but at
/// least one pixel.
const FARTHEST: f32 = 0.6;

/// Finds the corners between the squares of a ChArUco board whose tags were found in the picture, by increasing index.
/// `corners` are their positions on the board, in the order of their indices.
pub fn find_corners(
    picture: &Picture,
    finder: &TagFinder,
    tags: &[FoundTag],
    corners: &[Vector2<f64>],
) -> Vec<FoundPoint> {
    let (low, high) = finder.region(picture, tags);
    let (part, first) = picture.part(low, high);
    let first = first.map(|place| place as f32);
    let in_part = |[x, y]: [f32; 2]| [x - first[0], y - first[1]];
    let test = SaddleTest::new(&part);
    let find = |(index, corner): (usize, &Vector2<f64>)| {
        let near = finder.nearest(tags, *corner)?;
        let map = finder.map_of(&near)?;
        let predicted = map.pixel(*corner);
        let distance = |of_tag: Vector2<f64>| (Vector2::from(map.pixel(of_tag)) - Vector2::from(predicted)).norm();
        // The nearest corner of a tag is equally far away along x and y.
        let tag = finder.tags().get(near.first()?.index)?;
        let nearest = tag.corners.map(|corner| distance(corner.into())).into_iter().fold(f32::INFINITY, f32::min);
        let margin = nearest / std::f32::consts::SQRT_2;
        let half = (WINDOW * margin).clamp(WINDOWS[0], WINDOWS[1]).round() as usize;
        let pixel = refine_saddle(&part, in_part(predicted), half)?.pixel;
        let is_saddle = test.is_saddle(pixel);
        let pixel = [pixel[0] + first[0], pixel[1] + first[1]];
        let moved = (Vector2::from(pixel) - Vector2::from(predicted)).norm();
        (moved <= (FARTHEST * margin).max(1.0) && is_saddle).then_some(FoundPoint { index, pixel })
    };
    corners.iter().enumerate().filter_map(find).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rendering::{View, is_dark, tag};
    use evcal_geometry::board::tag::Tag;

    const ROWS: usize = 5;
    const COLUMNS: usize = 7;
    const MARKER: f64 = 0.73;

    fn is_dark_square(row: usize, column: usize) -> bool {
        (row + column).is_multiple_of(2)
    }

    /// Returns the tags of a board of squares of side 1, in its light squares.
    fn tags() -> Vec<Tag> {
        let squares = (0..ROWS * COLUMNS).map(|index| (index / COLUMNS, index % COLUMNS));
        let light = squares.filter(|&(row, column)| !is_dark_square(row, column));
        let margin = 0.5 - MARKER / 2.0;
        light
            .enumerate()
            .map(|(id, (row, column))| tag(id, 1, column as f64 + margin, row as f64 + margin, MARKER))
            .collect()
    }

    fn brightness() -> impl Fn(f64, f64) -> f32 {
        let tags = tags();
        move |x, y| {
            let inside = x >= 0.0 && y >= 0.0 && x < COLUMNS as f64 && y < ROWS as f64;
            let in_tag = |tag: &Tag| {
                let [u, v] = [(x - tag.corners[0][0]) / MARKER, (y - tag.corners[0][1]) / MARKER];
                (0.0..1.0).contains(&u) && (0.0..1.0).contains(&v) && is_dark(tag, u, v)
            };
            let dark = inside && (is_dark_square(y as usize, x as usize) || tags.iter().any(in_tag));
            if dark { 0.1 } else { 0.9 }
        }
    }

    fn corners() -> Vec<Vector2<f64>> {
        let places = (1..ROWS).flat_map(|row| (1..COLUMNS).map(move |column| (column, row)));
        places.map(|(column, row)| Vector2::new(column as f64, row as f64)).collect()
    }

    #[test]
    fn corners_are_found_between_the_tags() {
        let finder = TagFinder::new(&tags()).unwrap();
        for rotation in [[0.3, -0.35, 0.1], [-0.2, 0.3, 2.0], [0.2, 0.1, -1.0]] {
            let view = View::new([3.5, 2.5], 10.0, rotation);
            let picture = view.render(brightness());
            let tags = finder.find(&picture, &[]).unwrap();
            assert_eq!(tags.len(), 17);
            let corners = corners();
            let found = find_corners(&picture, &finder, &tags, &corners);
            assert!(found.iter().map(|point| point.index).eq(0..24), "{found:?}");
            let off = |point: &FoundPoint| {
                (Vector2::from(point.pixel) - Vector2::from(view.pixel(corners[point.index]))).norm_squared()
            };
            let error = (found.iter().map(off).sum::<f32>() / 24.0).sqrt();
            assert!(error < 0.1, "{error} px");
        }
    }

    #[test]
    fn corners_that_are_not_there_are_not_found() {
        let finder = TagFinder::new(&tags()).unwrap();
        let view = View::new([3.5, 2.5], 10.0, [0.3, -0.35, 0.1]);
        let brightness = brightness();
        // The two rightmost columns of squares are covered.
        let picture = view.render(|x, y| if x > 5.5 { 0.5 } else { brightness(x, y) });
        let tags = finder.find(&picture, &[]).unwrap();
        let found = find_corners(&picture, &finder, &tags, &corners());
        assert!(found.iter().all(|point| point.index % 6 < 5) && found.len() >= 18, "{found:?}");
    }
}
