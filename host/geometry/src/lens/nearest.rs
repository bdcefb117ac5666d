//! The camera that a file format can represent: the calibrated one, or the nearest of another model.

use evcal_core::sensor::Sensor;

use evcal_core::camera::refit::refit_where;
use evcal_core::camera::{Camera, ModelKind};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::covered_region::CoveredRegion;

/// Approximate number of pixels at which two cameras are compared.
const SAMPLES: f64 = 1e5;

/// Distance in pixels within which a model of OpenCV's family replaces another of the family even if a different model
/// comes nearer, because users expect the coefficients that they know.
const SAME_FAMILY: f64 = 0.1;

/// OpenCV's models; each has the coefficients of the previous one and more.
const RADTAN_FAMILY: [ModelKind; 3] = [ModelKind::Radtan4, ModelKind::Radtan, ModelKind::Radtan8];

/// Returns `true` if both models are OpenCV's.
fn are_related(one: ModelKind, other: ModelKind) -> bool {
    RADTAN_FAMILY.contains(&one) && RADTAN_FAMILY.contains(&other)
}

/// A camera of a model that the format supports.
#[derive(Clone, Debug, PartialEq)]
pub struct Nearest {
    /// The camera.
    pub camera: Camera<f64>,
    /// Error of the replacement, if the calibrated model is another one.
    pub refit: Option<Replacement>,
}

/// Replacement of a camera by the nearest one of another model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Replacement {
    /// The calibrated model.
    pub from: ModelKind,
    /// The model that replaces it.
    pub to: ModelKind,
    /// Distance between the cameras in the region where the board was seen, which was used in the fit.
    pub covered: Distance,
    /// Distance between the cameras on the whole sensor.
    pub sensor: Distance,
}

/// Distance between two cameras.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distance {
    /// Root mean square, in pixels.
    pub rms: f64,
    /// Largest, in pixels.
    pub largest: f64,
    /// Fraction of the pixels that the replacement cannot see.
    pub unseen: f64,
}

impl Replacement {
    /// Describes in a sentence the error of a file for `program`, which supports these `models`.
    pub fn sentence(&self, program: &str, models: &[ModelKind]) -> String {
        let Self { from, to, covered, sensor } = self;
        let missing = self.missing(models);
        let lacks = match missing.as_slice() {
            [] => format!("{program} has no model {from}"),
            coefficients => format!("{program} has no {from} with {}", coefficients.join(", ")),
        };
        let unseen = match sensor.unseen > 0.0 {
            true => format!("; {to} does not see {:.1} % of the sensor", 100.0 * sensor.unseen),
            false => String::new(),
        };
        format!(
            "{lacks}: exported as {to}, {} different where the board was seen, {} on the whole sensor{unseen}",
            at_most(covered.largest),
            at_most(sensor.largest)
        )
    }

    /// Returns the coefficients of this model of OpenCV's family that no model of the family among `models` has.
    fn missing(&self, models: &[ModelKind]) -> Vec<&'static str> {
        let is_relative = |model: &&ModelKind| are_related(self.from, **model);
        let relatives = models.iter().filter(is_relative);
        let Some(largest) = relatives.map(|model| model.parameter_names()).max_by_key(|names| names.len()) else {
            return Vec::new();
        };
        self.from.parameter_names().iter().copied().filter(|name| !largest.contains(name)).collect()
    }

    /// Returns `true` if both models are of OpenCV's family and the replacement is close enough to the calibrated
    /// camera.
    fn is_close_relative(&self) -> bool {
        are_related(self.from, self.to) && self.covered.unseen == 0.0 && self.covered.largest <= SAME_FAMILY
    }
}

/// Formats a distance.
fn at_most(pixels: f64) -> String {
    if pixels < 0.01 { "less than 0.01 px".to_owned() } else { format!("up to {pixels:.2} px") }
}

/// Returns the camera of one of `models` that represents `camera`.
///
/// This is `camera` itself if `models` contains its model. Otherwise it is the same camera in another model, if there
/// is one: within OpenCV's family if all coefficients that one of the models lacks are zero, or the unified model as
/// the extended one with beta = 1. Otherwise every model of `substitutes` is fitted to `camera` within `covered`, with
/// all parameters, and the nearest camera is chosen. A model of OpenCV's family is preferred to other models if
/// `camera` is of that family too and the fit is near enough. Returns `None` if no model sees the region.
pub fn nearest(
    camera: &Camera<f64>,
    models: &[ModelKind],
    substitutes: &[ModelKind],
    sensor: Sensor,
    covered: &CoveredRegion,
) -> Option<Nearest> {
    let from = camera.kind();
    if models.contains(&from) {
        return Some(Nearest { camera: *camera, refit: None });
    }
    if let Some(same) = models.iter().find_map(|&to| same_camera(camera, to)) {
        return Some(Nearest { camera: same, refit: None });
    }
    let targets = targets(camera, sensor);
    let fitted = |&to: &ModelKind| {
        let near = refit_where(to, camera, sensor, |pixel| covered.contains(pixel))?;
        let (covered, sensor) = distances(&targets, &near, covered)?;
        Some((near, Replacement { from, to, covered, sensor }))
    };
    let (related, others): (Vec<ModelKind>, Vec<ModelKind>) =
        substitutes.iter().partition(|to| are_related(from, **to));
    let mut cameras: Vec<_> = related.par_iter().filter_map(fitted).collect();
    // A close relative is chosen even if another model is nearer.
    if !cameras.iter().any(|(_, refit)| refit.is_close_relative()) {
        cameras.par_extend(others.par_iter().filter_map(fitted));
    }
    let nearest = cameras.into_iter().min_by(|(_, a), (_, b)| {
        let order = b.is_close_relative().cmp(&a.is_close_relative());
        let order = order.then(a.covered.unseen.total_cmp(&b.covered.unseen));
        order.then(a.covered.largest.total_cmp(&b.covered.largest))
    });
    nearest.map(|(camera, refit)| Nearest { camera, refit: Some(refit) })
}

/// Returns the same camera in another model: of OpenCV's family, or the unified model as the extended one.
fn same_camera(camera: &Camera<f64>, to: ModelKind) -> Option<Camera<f64>> {
    if (camera.kind(), to) == (ModelKind::Ucm, ModelKind::Eucm) {
        let mut parameters = camera.parameters().to_vec();
        parameters.push(1.0);
        return Camera::from_parameters(to, &parameters);
    }
    if !are_related(camera.kind(), to) {
        return None;
    }
    let count = to.parameter_names().len();
    let mut parameters = camera.parameters().to_vec();
    parameters.resize(parameters.len().max(count), 0.0);
    let (kept, beyond) = parameters.split_at_checked(count)?;
    beyond.iter().all(|value| *value == 0.0).then(|| Camera::from_parameters(to, kept)).flatten()
}

/// Pixels of a row of the sensor at which cameras are compared, with their bearings.
type TargetRow = Vec<(Vector2<f64>, Vector3<f64>)>;

/// Returns the pixels at which cameras are compared with `reference`, and the bearings of `reference` at these pixels.
fn targets(reference: &Camera<f64>, sensor: Sensor) -> Vec<TargetRow> {
    let all = f64::from(sensor.width) * f64::from(sensor.height);
    let step = (all / SAMPLES).sqrt().ceil().max(1.0) as usize;
    let rows: Vec<u16> = (0..sensor.height).step_by(step).collect();
    let of_row = |&y: &u16| {
        let pixels = (0..sensor.width).step_by(step).map(|x| Vector2::new(f64::from(x), f64::from(y)));
        pixels.filter_map(|pixel| Some((pixel, reference.unproject(&pixel)?))).collect()
    };
    rows.par_iter().map(of_row).collect()
}

/// Returns the fraction of the sensor's pixels that see points behind the camera, 0 to 1.
pub fn share_behind(camera: &Camera<f64>, sensor: Sensor) -> f64 {
    let targets = targets(camera, sensor);
    let bearings = || targets.iter().flatten().map(|(_, bearing)| bearing);
    bearings().filter(|bearing| bearing.z <= 0.0).count() as f64 / bearings().count().max(1) as f64
}

/// Returns the distance of `other` from the camera of `targets`, within `covered` and on the whole sensor; `None` if
/// the cameras share no pixel in one of these areas.
fn distances(targets: &[TargetRow], other: &Camera<f64>, covered: &CoveredRegion) -> Option<(Distance, Distance)> {
    let of_row = |row: &TargetRow| {
        let (mut there, mut everywhere) = (Sum::default(), Sum::default());
        for (pixel, bearing) in row {
            let square = other.project(bearing).map(|projected| (projected - pixel).norm_squared());
            everywhere.add(square);
            if covered.contains(pixel) {
                there.add(square);
            }
        }
        (there, everywhere)
    };
    let (mut there, mut everywhere) = (Sum::default(), Sum::default());
    for (there_in_row, everywhere_in_row) in targets.par_iter().map(of_row).collect::<Vec<_>>() {
        there.add_all(&there_in_row);
        everywhere.add_all(&everywhere_in_row);
    }
    Some((there.distance()?, everywhere.distance()?))
}

/// Sum of squared distances.
#[derive(Default)]
struct Sum {
    sum: f64,
    largest: f64,
    seen: u32,
    unseen: u32,
}

impl Sum {
    fn add(&mut self, square: Option<f64>) {
        match square {
            Some(square) => {
                self.sum += square;
                self.largest = self.largest.max(square);
                self.seen += 1;
            }
            None => self.unseen += 1,
        }
    }

    fn add_all(&mut self, other: &Self) {
        self.sum += other.sum;
        self.largest = self.largest.max(other.largest);
        self.seen += other.seen;
        self.unseen += other.unseen;
    }

    fn distance(&self) -> Option<Distance> {
        let (seen, unseen) = (f64::from(self.seen), f64::from(self.unseen));
        (self.seen > 0).then(|| Distance {
            rms: (self.sum / seen).sqrt(),
            largest: self.largest.sqrt(),
            unseen: unseen / (seen + unseen),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor::new(346, 260);

    fn camera(kind: ModelKind, coefficients: &[f64]) -> Camera<f64> {
        let parameters: Vec<f64> = [335.3, 334.9, 171.2, 128.8].iter().chain(coefficients).copied().collect();
        Camera::from_parameters(kind, &parameters).unwrap()
    }

    fn region() -> CoveredRegion {
        let corners = [[20.0, 15.0], [320.0, 10.0], [330.0, 250.0], [25.0, 245.0]];
        CoveredRegion::around(corners.map(Vector2::from), SENSOR)
    }

    #[test]
    fn a_refit_reports_its_error() {
        let calibrated = camera(ModelKind::InverseRadial, &[0.33, 0.16, 0.09, 0.04, 0.02]);
        let models = [ModelKind::Radtan, ModelKind::KannalaBrandt];
        let Nearest { camera: near, refit } = nearest(&calibrated, &models, &models, SENSOR, &region()).unwrap();
        let refit = refit.unwrap();
        assert_eq!((near.kind(), refit.from, refit.to), (refit.to, ModelKind::InverseRadial, refit.to));
        let pixels = (0..26).flat_map(|row| (0..34).map(move |column| Vector2::new(column as f64, row as f64) * 10.0));
        let mut largest: f64 = 0.0;
        for pixel in pixels.filter(|pixel| region().contains(pixel)) {
            let bearing = calibrated.unproject(&pixel).unwrap();
            largest = largest.max((near.project(&bearing).unwrap() - pixel).norm());
        }
        let sentence = refit.sentence("ROS", &models);
        assert!(largest <= refit.covered.largest && refit.covered.largest < 0.05, "{largest}: {sentence}");
        assert!(sentence.starts_with("ROS has no model inverse-radial: exported as "), "{sentence}");
        for to in models {
            let other = nearest(&calibrated, &[], &[to], SENSOR, &region()).unwrap().refit.unwrap();
            assert!(refit.covered.largest <= other.covered.largest, "{to}");
        }
    }

    #[test]
    fn coefficients_that_are_zero_can_be_left_out_or_added() {
        let five = camera(ModelKind::Radtan, &[-0.3, 0.1, 0.001, -0.0005, 0.0]);
        let four = camera(ModelKind::Radtan4, &[-0.3, 0.1, 0.001, -0.0005]);
        for (from, to) in [(five, four), (four, five)] {
            let models = [to.kind()];
            assert_eq!(nearest(&from, &models, &models, SENSOR, &region()), Some(Nearest { camera: to, refit: None }));
        }
        let sixth = camera(ModelKind::Radtan, &[-0.3, 0.1, 0.001, -0.0005, -0.05]);
        let refitted = nearest(&sixth, &[ModelKind::Radtan4], &[ModelKind::Radtan4], SENSOR, &region()).unwrap();
        assert_ne!(refitted.camera.parameters()[4..], sixth.parameters()[4..8]);
        let (dropped, _) = distances(&targets(&sixth, SENSOR), &four, &region()).unwrap();
        assert!(refitted.refit.unwrap().covered.largest < 0.2 * dropped.largest);
    }

    #[test]
    fn a_model_of_the_same_family_is_chosen_if_it_is_near() {
        let substitutes = [ModelKind::KannalaBrandt, ModelKind::Radtan4, ModelKind::Eucm];
        let to = |k3: f64| {
            let five = camera(ModelKind::Radtan, &[-0.3, 0.1, 0.001, -0.0005, k3]);
            nearest(&five, &substitutes, &substitutes, SENSOR, &region()).unwrap().refit.unwrap()
        };
        let near = to(-0.01);
        assert!(near.to == ModelKind::Radtan4 && near.covered.largest <= SAME_FAMILY, "{near:?}");
        assert!(
            near.sentence("Kalibr", &substitutes).starts_with("Kalibr has no radtan with k3: exported as radtan4, "),
            "{near:?}"
        );
        // With this k3 four coefficients are not enough; another model is chosen because it comes nearer.
        let far = to(-0.3);
        let four = nearest(
            &camera(ModelKind::Radtan, &[-0.3, 0.1, 0.001, -0.0005, -0.3]),
            &[],
            &[ModelKind::Radtan4],
            SENSOR,
            &region(),
        );
        let four = four.unwrap().refit.unwrap();
        assert!(four.covered.largest > SAME_FAMILY && far.covered.largest <= four.covered.largest, "{far:?} {four:?}");
    }

    #[test]
    fn an_unseen_region_has_no_equivalent() {
        let calibrated = camera(ModelKind::InverseRadial, &[0.33, 0.16, 0.09, 0.04, 0.02]);
        let nothing = CoveredRegion::around([], SENSOR);
        assert_eq!(nearest(&calibrated, &[ModelKind::Radtan], &[ModelKind::Radtan], SENSOR, &nothing), None);
    }
}
