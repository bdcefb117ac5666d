//! Grey images from sensors with a Bayer filter: squares of two by two pixels, of which one is red, two are green and
//! one is blue.
//!
//! Each pixel becomes a weighted mean of itself (weight 4), its four direct neighbours (2 each) and its four diagonal
//! neighbours (1 each). With these weights red contributes a quarter, green a half and blue a quarter at every pixel,
//! whatever the order of the filters. The weights are symmetric, so the image is not shifted, whereas the mean over a
//! two-by-two square would shift it by half a pixel.

/// A sample of 8 or 16 bits.
pub trait Sample: Copy + Into<u32> {
    /// Converts a number that does not exceed the largest sample.
    fn from_sum(sum: u32) -> Self;
}

impl Sample for u8 {
    fn from_sum(sum: u32) -> Self {
        sum as u8
    }
}

impl Sample for u16 {
    fn from_sum(sum: u32) -> Self {
        sum as u16
    }
}

/// Converts `samples`, in rows of `width`, to a grey image.
pub fn grey<T: Sample>(samples: &[T], width: usize) -> Vec<T> {
    let rows: Vec<&[T]> = samples.chunks_exact(width.max(1)).collect();
    let mut pixels = Vec::with_capacity(samples.len());
    // Weighted sums over three rows.
    let mut sums = vec![0_u32; width];
    for (y, row) in rows.iter().enumerate() {
        let [above, below] = around(y, rows.len()).map(|y| rows.get(y).copied().unwrap_or(row));
        for (sum, ((here, up), down)) in sums.iter_mut().zip(row.iter().zip(above).zip(below)) {
            *sum = 2 * (*here).into() + (*up).into() + (*down).into();
        }
        pixels.extend(sums.iter().enumerate().map(|(x, sum)| {
            let sides: u32 = around(x, width).iter().map(|x| sums.get(*x).copied().unwrap_or(*sum)).sum();
            T::from_sum((2 * sum + sides + 8) / 16)
        }));
    }
    pixels
}

/// Returns the two neighbours of `index` among `count`. At the ends the only neighbour is returned twice, because the
/// filter pattern continues symmetrically beyond the border.
fn around(index: usize, count: usize) -> [usize; 2] {
    let before = index.checked_sub(1);
    let after = Some(index + 1).filter(|after| *after < count);
    [before.or(after).unwrap_or(index), after.or(before).unwrap_or(index)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sensitivity to red, green and blue.
    const COLOURS: [f64; 3] = [0.4, 1.0, 0.7];
    /// Colours of the pixels of a square, row by row.
    const ORDERS: [[usize; 4]; 4] = [[0, 1, 1, 2], [2, 1, 1, 0], [1, 2, 0, 1], [1, 0, 2, 1]];

    /// Returns the samples of a sensor with this order of filters for an image of these values.
    fn mosaic(order: [usize; 4], width: usize, height: usize, value: impl Fn(usize, usize) -> f64) -> Vec<u8> {
        let at = |index: usize| {
            let (x, y) = (index % width, index / width);
            (value(x, y) * COLOURS[order[y % 2 * 2 + x % 2]]).round() as u8
        };
        (0..width * height).map(at).collect()
    }

    #[test]
    fn a_uniform_image_shows_no_filter_pattern() {
        for order in ORDERS {
            for (width, height) in [(7, 5), (2, 2), (8, 3)] {
                let pixels = grey(&mosaic(order, width, height, |_, _| 200.0), width);
                // A quarter of 80, half of 200, a quarter of 140.
                assert_eq!(pixels, vec![155; width * height], "{order:?}");
                let sixteen: Vec<u16> =
                    mosaic(order, width, height, |_, _| 200.0).iter().map(|one| u16::from(*one) * 257).collect();
                assert_eq!(grey(&sixteen, width), vec![155 * 257; width * height], "{order:?}");
            }
        }
        assert_eq!(grey::<u8>(&[], 0), [0; 0]);
        assert_eq!(grey(&[9_u8], 1), [9]);
    }

    /// Returns the centre of a dark dot on bright paper, weighted by darkness.
    fn middle(pixels: &[u8], width: usize) -> [f64; 2] {
        let paper = f64::from(pixels[0]);
        let mut sums = [0.0; 3];
        for (index, pixel) in pixels.iter().enumerate() {
            let darkness = paper - f64::from(*pixel);
            let at = [(index % width) as f64, (index / width) as f64];
            sums = [sums[0] + darkness, sums[1] + darkness * at[0], sums[2] + darkness * at[1]];
        }
        [sums[1] / sums[0], sums[2] / sums[0]]
    }

    #[test]
    fn the_centre_of_a_dot_is_not_shifted() {
        const SUBPIXELS: u32 = 8;
        let (width, height) = (40, 36);
        for (order, center) in ORDERS.iter().zip([[18.3, 17.6], [19.9, 16.2], [20.5, 18.5], [17.71, 19.13]]) {
            let radius = 8.2;
            let value = |x: usize, y: usize| {
                let inside = |index: u32| {
                    let offset = |index: usize, step: u32, axis: usize| {
                        index as f64 - 0.5 + (f64::from(step) + 0.5) / f64::from(SUBPIXELS) - center[axis]
                    };
                    offset(x, index % SUBPIXELS, 0).hypot(offset(y, index / SUBPIXELS, 1)) < radius
                };
                let dark = (0..SUBPIXELS * SUBPIXELS).filter(|index| inside(*index)).count();
                230.0 - 200.0 * dark as f64 / f64::from(SUBPIXELS * SUBPIXELS)
            };
            let pixels = grey(&mosaic(*order, width, height, value), width);
            let found = middle(&pixels, width);
            let error = (found[0] - center[0]).hypot(found[1] - center[1]);
            assert!(error < 0.02, "{order:?}: {found:?}, not {center:?}");
            let direct = middle(&mosaic([1; 4], width, height, value), width);
            assert!((direct[0] - center[0]).hypot(direct[1] - center[1]) < 0.01, "{direct:?}");
        }
    }
}
