//! Prior knowledge of a model's coefficients, before anything is measured.

/// Effect of a coefficient on the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CoefficientEffect {
    /// Changes the radius by a fraction proportional to this power of the squared radius.
    Radial(i32),
    /// No prior: a few views determine the coefficient.
    Free,
    /// Prior of this value with a standard deviation of 1: the shape of a wide-angle model, which a narrow view does
    /// not determine.
    Shape(f64),
}

/// Start values of estimates of a model's coefficients, and their expected size. Coefficients missing from a list are
/// zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expectation {
    /// Effect of each coefficient, in their order.
    pub effects: &'static [CoefficientEffect],
    /// Start values for fitting the model to a known lens: no distortion, or, if the derivative with respect to the
    /// coefficients vanishes there, the coefficients of a wide lens. There are several if the cost has local minima
    /// between which a fit cannot move.
    pub fit_starts: &'static [&'static [f64]],
    /// Two lenses that bracket an unknown camera: one with little distortion, and one with the barrel distortion of
    /// ordinary lenses, or a fisheye if the model is meant for fisheyes.
    pub usual: [&'static [f64]; 2],
}
