use evcal_geometry::board::squares::SquareBoard;

use super::*;
use crate::rendering::{HEIGHT, Light, Random, Shot, WIDTH, lens};

/// Mean shift of corners away from the middle of their tag, its standard error, and the scatter of a corner along
/// one axis (px).
struct Shifts {
    mean: f64,
    error: f64,
    scatter: f64,
    stated: f64,
    blur: f64,
    refused: usize,
}

/// Fits a tag of `board` in several views in which its side is `side` px.
fn shifts(board: &str, side: f64, k1: f64, known: bool, light: &Light, views: usize, seed: u64) -> Shifts {
    let board: SquareBoard = board.parse().unwrap();
    let (tags, raster) = (board.tags(), board.raster());
    let camera = lens(k1);
    let bearings = Bearings::new(&camera, WIDTH, HEIGHT);
    let fits = PrintFits::of_tags(&tags, &raster);
    let mut random = Random::new(seed);
    let (mut outwards, mut squares, mut stated, mut blur, mut refused) = (Vec::new(), 0.0, 0.0, 0.0, 0);
    for view in 0..views {
        let index = (view * 5 + 4) % tags.len();
        let tag = &tags[index];
        let length = 2.0 * (tag.corners[0][0] - tag.middle().x).abs();
        let rotation = [0.45 * random.next(), 0.45 * random.next(), 3.1 * random.next()];
        let reach = [WIDTH, HEIGHT].map(|size| 0.5 * size as f64 - 0.9 * side - 3.0);
        let pixel = [172.5 + reach[0] * random.next(), 129.5 + reach[1] * random.next()];
        let pose = Shot::pose(&camera, tag.middle(), pixel, side / length, rotation);
        let shot = Shot { raster: &raster, camera, pose };
        let truth = tag.corners.map(|corner| shot.pixel(corner.into()));
        let middle = truth.iter().sum::<Vector2<f64>>() / 4.0;
        let part = shot.render(middle, 0.8 * side + 4.0, light, &mut random);
        let origin = Vector2::from(part.position.map(|place| place as f64));
        let seen: Vec<SeenPoint> = tag
            .corners
            .iter()
            .zip(truth)
            .map(|(corner, truth)| {
                let off = Vector2::new(random.next(), random.next()) * 0.25;
                SeenPoint { board: (*corner).into(), pixel: truth + off - origin }
            })
            .collect();
        let Some(fitted) = fits.fit(&part.picture, part.position, known.then_some(&bearings), index, &seen, FIRST_BLUR)
        else {
            refused += 1;
            continue;
        };
        for (corner, truth) in fitted.points.into_iter().zip(truth) {
            let error = corner + origin - truth;
            outwards.push(error.dot(&(truth - middle).normalize()));
            squares += error.norm_squared() / 2.0;
        }
        stated += 4.0 * fitted.sigma.powi(2);
        blur += 4.0 * (0.5 * (fitted.blur[0] + fitted.blur[2])).sqrt();
    }
    let count = outwards.len() as f64;
    let mean = outwards.iter().sum::<f64>() / count;
    let variance = outwards.iter().map(|shift| (shift - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Shifts {
        mean,
        error: (variance / count).sqrt(),
        scatter: (squares / count).sqrt(),
        stated: (stated / count).sqrt(),
        blur: blur / count,
        refused,
    }
}

const GRID: &str = "aprilgrid:3x3:35.2mm:0.3";
const SHEET: &str = "apriltags:3x3:45mm:0.25";
/// Tags with a border of two modules, and without squares between them.
const WIDE: &str = "apriltags:3x3:45mm:0.25:border2";

const NOISY: Light = Light { noise: 0.0125, vignetting: 0.25, ..Light::EVEN };
/// Largest mean shift of the corners of a size (px).
const MOST_SHIFT: f64 = 0.005;

#[test]
fn corners_are_not_shifted_at_any_size() {
    for (board, seed) in [(GRID, 1), (SHEET, 2), (WIDE, 3)] {
        for (side, views) in [(8.0, 24), (12.0, 24), (20.0, 16), (40.0, 6), (80.0, 2)] {
            let of_size = shifts(board, side, -0.35, true, &NOISY, views, seed);
            assert!(of_size.mean.abs() <= MOST_SHIFT, "{board}, {side} px: {} ± {}", of_size.mean, of_size.error);
            // The reported standard deviation is right.
            let ratio = of_size.stated / of_size.scatter;
            assert!((0.6..1.5).contains(&ratio), "{board}, {side} px: {} {}", of_size.stated, of_size.scatter);
            assert!((of_size.blur - NOISY.blur).abs() < 0.02 && of_size.refused == 0, "{board}, {side} px");
        }
    }
}

#[test]
fn corners_are_not_shifted_by_blur() {
    for (blur, side) in [(0.4, 14.0), (0.9, 14.0), (1.3, 20.0)] {
        let of_blur = shifts(SHEET, side, 0.2, true, &Light { blur, ..NOISY }, 16, 4);
        assert!(of_blur.mean.abs() <= MOST_SHIFT, "blur {blur} px: {} ± {}", of_blur.mean, of_blur.error);
        assert!((of_blur.blur - blur).abs() < 0.03, "{}", of_blur.blur);
    }
}

/// Motion while the shutter is open is not a normal distribution, and the response of an ordinary camera is far from
/// linear.
#[test]
fn motion_and_response_of_the_camera_shift_corners_by_little() {
    let moving = Light { motion: [3.0, 2.0], ..NOISY };
    let bright = Light { gamma: 0.45, ..NOISY };
    for (light, most) in [(moving, 0.015), (bright, 0.02)] {
        let of_light = shifts(GRID, 24.0, -0.35, true, &light, 8, 5);
        assert!(of_light.mean.abs() <= most, "{} ± {}", of_light.mean, of_light.error);
    }
}

/// The error of a crossing: its mean along the diagonal of the dark squares, the standard error of that, its scatter and
/// the stated one along one axis (px).
struct CrossingErrors {
    mean: f64,
    error: f64,
    scatter: f64,
    stated: f64,
    refused: usize,
}

/// Fits crossings of `board` in several views in which a square's side is `side` px.
fn crossing_errors(board: &str, side: f64, light: &Light, views: usize, seed: u64) -> CrossingErrors {
    let board: SquareBoard = board.parse().unwrap();
    let (points, raster) = (board.points(), board.raster());
    let columns = usize::from(board.lattice().columns);
    let square = points[1].x - points[0].x;
    let camera = lens(-0.35);
    let bearings = Bearings::new(&camera, WIDTH, HEIGHT);
    let fits = PrintFits::of_crossings(&points, square, &raster);
    let mut random = Random::new(seed);
    let (mut along, mut squares, mut stated, mut refused) = (Vec::new(), 0.0, 0.0, 0);
    for view in 0..views {
        let index = (view * 5 + 3) % points.len();
        let rotation = [0.45 * random.next(), 0.45 * random.next(), 3.1 * random.next()];
        let reach = [WIDTH, HEIGHT].map(|size| 0.5 * size as f64 - 1.8 * side - 3.0);
        let pixel = [172.5 + reach[0] * random.next(), 129.5 + reach[1] * random.next()];
        let pose = Shot::pose(&camera, points[index], pixel, side / square, rotation);
        let shot = Shot { raster: &raster, camera, pose };
        let truth = shot.pixel(points[index]);
        let part = shot.render(truth, 1.2 * side.min(15.0) + 4.0, light, &mut random);
        let origin = Vector2::from(part.position.map(|place| place as f64));
        let is_near = |other: &usize| {
            (other / columns).abs_diff(index / columns) <= 1 && (other % columns).abs_diff(index % columns) <= 1
        };
        let near = (0..points.len()).filter(is_near).map(|other| {
            // The errors of an earlier pass: scale and perspective near the crossing come from its neighbours.
            let off = Vector2::new(random.next(), random.next()) * 0.02;
            SeenPoint { board: points[other], pixel: shot.pixel(points[other]) + off - origin }
        });
        let seen: Vec<SeenPoint> = near.collect();
        let Some(fitted) = fits.fit(&part.picture, part.position, Some(&bearings), index, &seen, FIRST_BLUR) else {
            refused += 1;
            continue;
        };
        let error = fitted.points[0] + origin - truth;
        let towards = points[index] + Vector2::new(0.2, 0.2) * square;
        let sign = if raster.is_dark_at(towards.into()) { 1.0 } else { -1.0 };
        let diagonal = shot.pixel(points[index] + Vector2::new(0.2, 0.2 * sign) * square) - truth;
        along.push(error.dot(&diagonal.normalize()));
        squares += error.norm_squared() / 2.0;
        stated += fitted.sigma.powi(2);
    }
    let count = along.len() as f64;
    let mean = along.iter().sum::<f64>() / count;
    let variance = along.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / (count - 1.0);
    CrossingErrors {
        mean,
        error: (variance / count).sqrt(),
        scatter: (squares / count).sqrt(),
        stated: (stated / count).sqrt(),
        refused,
    }
}

/// The search's crossings scatter by 0.05 px: its values between pixels are bilinear, and the tags of a ChArUco board pull.
#[test]
fn crossings_are_as_exact_as_the_noise_of_the_pixels_allows() {
    let with_tags = "charuco:5x7:30mm:22mm:DICT_5X5_100";
    let sides = [8.0, 12.0, 20.0, 40.0].map(|side| ("checkerboard:6x9:25mm", side));
    let sides = sides.into_iter().chain([12.0, 20.0, 40.0].map(|side| (with_tags, side)));
    for (board, side) in sides {
        let CrossingErrors { mean, error, scatter, stated, refused } = crossing_errors(board, side, &NOISY, 60, 1);
        assert!(mean.abs() <= MOST_SHIFT, "{board}, {side} px: {mean} ± {error}");
        assert!(scatter < 0.012 && refused == 0, "{board}, {side} px: {scatter}, {refused}");
        assert!((0.7..1.4).contains(&(stated / scatter)), "{board}, {side} px: {stated} {scatter}");
    }
}

#[test]
fn a_tag_that_is_not_there_is_refused() {
    let board: SquareBoard = GRID.parse().unwrap();
    let fits = PrintFits::of_tags(&board.tags(), &board.raster());
    let corners = board.tags()[0].corners.map(Vector2::from);
    let start = [[20.0, 20.0], [50.0, 20.0], [50.0, 50.0], [20.0, 50.0]];
    let fit = |picture: &Picture, start: &[[f64; 2]; 4]| {
        let seen = |(board, pixel): (Vector2<f64>, &[f64; 2])| SeenPoint { board, pixel: (*pixel).into() };
        let seen: Vec<SeenPoint> = corners.into_iter().zip(start).map(seen).collect();
        fits.fit(picture, [0, 0], None, 0, &seen, FIRST_BLUR)
    };
    let picture = |value: fn(usize) -> f32| Picture::new(70, 70, (0..4900).map(value).collect()).unwrap();
    assert_eq!(fit(&picture(|_| 80.0), &start), None);
    assert_eq!(fit(&picture(|index| (index * 7919 % 256) as f32), &start), None);
    assert_eq!(fit(&picture(|index| (index % 70) as f32), &start), None);
    // Corners that cannot be those of a square.
    for start in [[[f64::NAN; 2]; 4], [[1e9, 3.0]; 4], [[20.0, 20.0]; 4]] {
        assert_eq!(fit(&picture(|index| (index % 70) as f32), &start), None);
    }
}
