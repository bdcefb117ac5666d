//! Camera parameters by name, in the order of their model.

use std::fmt;

use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Values by name, in the given order. In JSON, an object in that order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters(Vec<(String, f64)>);

impl Parameters {
    /// Creates parameters from values with their names.
    pub fn new<'a>(named: impl IntoIterator<Item = (&'a str, f64)>) -> Self {
        Self(named.into_iter().map(|(name, value)| (name.to_owned(), value)).collect())
    }

    /// Returns the parameters with other values inserted before them.
    pub fn and_before<'a>(self, others: impl IntoIterator<Item = (&'a str, f64)>) -> Self {
        let mut all = Self::new(others);
        all.0.extend(self.0);
        all
    }

    /// Returns the value of this name.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.0.iter().find(|(other, _)| other == name).map(|(_, value)| *value)
    }
}

impl Serialize for Parameters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, value)| (name, value)))
    }
}

impl<'de> Deserialize<'de> for Parameters {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Object;

        impl<'de> Visitor<'de> for Object {
            type Value = Parameters;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("an object of camera parameters by name")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Parameters, A::Error> {
                let mut parameters = Parameters::default();
                while let Some((name, value)) = map.next_entry::<String, f64>()? {
                    if parameters.get(&name).is_some() {
                        return Err(A::Error::custom(format_args!("camera parameter {name} is given twice")));
                    }
                    parameters.0.push((name, value));
                }
                Ok(parameters)
            }
        }

        deserializer.deserialize_map(Object)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_keep_their_order() {
        let text = r#"{"fx":300.0,"cy":129.5,"cx":172.5,"k1":-0.25}"#;
        let parameters: Parameters = serde_json::from_str(text).unwrap();
        assert_eq!(serde_json::to_string(&parameters).unwrap(), text);
        assert_eq!((parameters.get("cx"), parameters.get("k2")), (Some(172.5), None));
    }

    #[test]
    fn a_name_given_twice_is_rejected() {
        let twice = serde_json::from_str::<Parameters>(r#"{"fx":300.0,"fx":301.0}"#).unwrap_err();
        assert!(twice.to_string().contains("fx is given twice"), "{twice}");
    }
}
