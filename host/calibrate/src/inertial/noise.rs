//! The noise of a sensor, from the spectrum of its residuals.
//!
//! At low frequencies the trajectory follows the sensors, so that their noise does not show. At higher frequencies the residuals
//! are noise after the sensor's own low-pass filter. If this filter has two equal poles, the density after it falls as S(f) = S₀
//! / (1 + (f/f_c)²)², so that 1/√S is a straight line in f²; its value at f = 0 is the density before the filter.

use std::f64::consts::TAU;

use evcal_geometry::numerics::statistics::median;

/// Upper end of the frequency band (Hz).
const BAND_END: f64 = 220.0;
/// Lower end of the frequency band, times the knot spacing: 1.5 times the highest frequency that the knots can follow.
const BAND_START: f64 = 0.75;
/// Upper end of the band as a share of the sampling rate.
const LARGEST_SHARE: f64 = 0.4;
/// Length of a piece of the residuals (s).
const PIECE: f64 = 0.25;
/// Fewest samples in a piece, pieces and lines of the spectrum.
const FEWEST: usize = 8;

/// A line of a spectrum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Frequency in Hz.
    pub frequency: f64,
    /// Square root of the two-sided density, in units of the residuals over √Hz: the standard deviation of a sample of white
    /// noise is this times the square root of the sampling rate.
    pub density: f64,
}

/// Computes the spectrum of `residuals` (time in s, value) sampled at `rate`, up to half of it, from pieces without gaps.
pub fn spectrum(residuals: &[(f64, f64)], rate: f64) -> Vec<Line> {
    let length = (PIECE * rate) as usize;
    if length < FEWEST {
        return Vec::new();
    }
    let window: Vec<f64> =
        (0..length).map(|index| 1.0 - libm::cos(TAU * (index as f64 + 0.5) / length as f64)).collect();
    let power: f64 = window.iter().map(|weight| weight * weight).sum();
    let pieces: Vec<&[(f64, f64)]> =
        residuals.chunk_by(|a, b| (b.0 - a.0) * rate < 1.5).flat_map(|run| run.chunks_exact(length)).collect();
    if pieces.len() < FEWEST {
        return Vec::new();
    }
    let line = |number: usize| {
        let step = TAU * number as f64 / length as f64;
        let (cosines, sines): (Vec<f64>, Vec<f64>) =
            (0..length).map(|index| (libm::cos(step * index as f64), libm::sin(step * index as f64))).unzip();
        let power_of = |piece: &&[(f64, f64)]| {
            let mean = piece.iter().map(|one| one.1).sum::<f64>() / length as f64;
            let weighted = |wave: &[f64]| {
                piece
                    .iter()
                    .zip(&window)
                    .zip(wave)
                    .map(|((one, weight), wave)| (one.1 - mean) * weight * wave)
                    .sum::<f64>()
            };
            let (real, imaginary) = (weighted(&cosines), weighted(&sines));
            real * real + imaginary * imaginary
        };
        // The median, so that a knock in one piece does not count as noise; the median of an exponential distribution is ln 2 of
        // its mean.
        let mut powers: Vec<f64> = pieces.iter().map(power_of).collect();
        let middle = median(&mut powers, f64::total_cmp).unwrap_or(0.0);
        let density = middle / (std::f64::consts::LN_2 * power * rate);
        Line { frequency: number as f64 * rate / length as f64, density: density.sqrt() }
    };
    (1..=length / 2).map(line).collect()
}

/// Returns the density of white noise before the sensor's filter, from residuals of a trajectory with knots `spacing` seconds
/// apart; `None` if the sampling is too slow or the recording too short.
pub fn density(spectrum: &[Line], rate: f64, spacing: f64) -> Option<f64> {
    let (start, end) = (BAND_START / spacing, BAND_END.min(LARGEST_SHARE * rate));
    let band: Vec<&Line> =
        spectrum.iter().filter(|line| (start..=end).contains(&line.frequency) && line.density > 0.0).collect();
    if band.len() < FEWEST {
        return None;
    }
    // A straight line through 1/√S over f², weighted by √S because the values have equal relative errors.
    let mut sums = [0.0; 5];
    for line in &band {
        let (x, y, weight) = (line.frequency * line.frequency, 1.0 / line.density, line.density * line.density);
        for (sum, term) in sums.iter_mut().zip([1.0, x, x * x, y, x * y]) {
            *sum += weight * term;
        }
    }
    let [one, x, xx, y, xy] = sums;
    let slope = (one * xy - x * y) / (one * xx - x * x);
    // Noise after a low-pass filter does not grow with frequency.
    let start = if slope > 0.0 { (y - slope * x) / one } else { y / one };
    (start > 0.0 && start.is_finite()).then(|| 1.0 / start)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use evcal_geometry::numerics::random::normal;

    /// White noise of density 0.01 at 8 kHz through two poles of 184 Hz, every eighth value.
    #[test]
    fn the_density_before_the_filter_is_found_within_fifteen_percent() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for (corner, step) in [(110.0, 8), (1e9, 8), (110.0, 20)] {
            let kept = libm::exp(-TAU * corner / 8000.0);
            let (mut first, mut second) = (0.0, 0.0);
            let mut residuals = Vec::new();
            for index in 0..(30 * 8000) {
                let input = 0.01 * 8000.0f64.sqrt() * normal(&mut rng);
                first = input + (first - input) * kept;
                second = first + (second - first) * kept;
                if index % step == 0 {
                    residuals.push((f64::from(index) / 8000.0, second));
                }
            }
            let rate = 8000.0 / f64::from(step);
            let found = density(&spectrum(&residuals, rate), rate, 0.01).unwrap();
            // Without a filter, noise beyond half of the rate is aliased, so the density there differs from the density
            // before sampling.
            let expected = if corner > 1e6 { 0.01 * f64::from(step).sqrt() } else { 0.01 };
            assert!((found / expected - 1.0).abs() < 0.15, "{corner} {rate}: {found}");
        }
    }

    #[test]
    fn slow_sampling_does_not_measure_noise() {
        let residuals: Vec<(f64, f64)> = (0..600).map(|index| (f64::from(index) * 0.05, 1.0)).collect();
        assert_eq!(density(&spectrum(&residuals, 20.0), 20.0, 0.01), None);
    }
}
