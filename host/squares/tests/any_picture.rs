//! No picture causes a panic in a finder.

use evcal_geometry::board::tag::Tag;
use evcal_squares::checkerboard::find_checkerboard;
use evcal_squares::picture::Picture;
use evcal_squares::recognition::recognise;
use evcal_squares::tags::TagFinder;

/// Creates a finder for a tag of 3 × 3 modules with a light middle.
fn finder() -> TagFinder {
    let light = (0..9).map(|index| index == 4).collect();
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    TagFinder::new(&[Tag { id: 0, corners, side: 3, light }]).unwrap()
}

fn refused(picture: &Picture) -> bool {
    let moments = [vec![picture.clone()], vec![picture.clone()], vec![picture.clone()]];
    find_checkerboard(picture, 6, 9, None).is_err()
        && finder().find(picture, &[]).is_err()
        && recognise(&moments).is_none()
}

#[test]
fn small_pictures_have_no_board() {
    for (width, height) in [(1, 1), (1, 40), (40, 1), (2, 3), (5, 4), (12, 12), (13, 30)] {
        let values = (0..width * height).map(|index| (index * 7 % 5) as f32).collect();
        assert!(refused(&Picture::new(width, height, values).unwrap()), "{width} x {height}");
    }
}

#[test]
fn pictures_of_values_that_are_not_numbers_have_no_board() {
    for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN_POSITIVE] {
        for every in [1, 3, 1000] {
            let values =
                (0..120 * 90).map(|index| if index % every == 0 { odd } else { (index % 17) as f32 }).collect();
            assert!(refused(&Picture::new(120, 90, values).unwrap()), "{odd} {every}");
        }
    }
}
