//! Units of the numbers in the messages of a recording, for drivers that do not use the units of the message.

use std::str::FromStr;

use super::csv::{ACCELERATION, RATE};
use super::sample::Sample;

/// Units of accelerations and angular velocities in messages, which should be m/s² and rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MessageUnits {
    /// Unit of accelerations in m/s².
    acceleration: f64,
    /// Unit of angular velocities in rad/s.
    rate: f64,
}

/// Error: a text does not name units.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{given:?} is not a unit of accelerations (g, m_s2) or angular velocities (deg_s, rad_s); write for example g,deg_s"
)]
pub struct UnknownUnit {
    given: String,
}

/// Parses the units that differ from those of the message, such as `g,deg_s` or `g`.
impl FromStr for MessageUnits {
    type Err = UnknownUnit;

    fn from_str(text: &str) -> Result<Self, UnknownUnit> {
        let mut units = Self { acceleration: 1.0, rate: 1.0 };
        for given in text.split(',').map(str::trim) {
            let in_table = |table: &[(&str, f64)]| table.iter().find(|(name, _)| *name == given).map(|(_, unit)| *unit);
            match (in_table(ACCELERATION), in_table(RATE)) {
                (Some(unit), _) => units.acceleration = unit,
                (_, Some(unit)) => units.rate = unit,
                (None, None) => return Err(UnknownUnit { given: given.to_owned() }),
            }
        }
        Ok(units)
    }
}

impl MessageUnits {
    /// Corrects samples that were read as m/s² and rad/s.
    pub fn correct(&self, samples: &mut [Sample]) {
        for sample in samples {
            sample.acceleration *= self.acceleration;
            sample.angular_velocity *= self.rate;
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

    #[test]
    fn units_are_named_in_any_order_and_the_others_stay() {
        let corrected = |text: &str| {
            let one = Vector3::new(1.0, 0.0, 0.0);
            let mut samples = [Sample { t: 0.0, acceleration: one, angular_velocity: one }];
            text.parse::<MessageUnits>().unwrap().correct(&mut samples);
            (samples[0].acceleration.x, samples[0].angular_velocity.x.to_degrees().round())
        };
        assert_eq!(corrected("g"), (STANDARD_GRAVITY, 57.0));
        assert_eq!(corrected("deg_s, g"), (STANDARD_GRAVITY, 1.0));
        assert_eq!(corrected("m_s2,deg_s"), (1.0, 1.0));
        assert!("g,rpm".parse::<MessageUnits>().unwrap_err().to_string().contains("\"rpm\" is not a unit"));
    }
}
