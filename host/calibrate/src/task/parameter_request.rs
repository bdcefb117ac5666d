//! Requests to fix parameters at a value, or to estimate them whatever the data.

use evcal_core::camera::{MAX_PARAMETERS, ModelKind};

use evcal_files::remedies;
use evcal_geometry::board::any_length;
use evcal_geometry::board::shape::PARAMETERS;

/// Names of the board's parameters, in the order of the solve.
pub const BOARD_NAMES: [&str; PARAMETERS] = ["print-ratio", "bend-x", "bend-y", "radius"];

/// Fixed and estimated parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ParameterRequests {
    /// Values at which intrinsics are fixed, in the order of the camera model.
    pub fixed_intrinsics: [Option<f64>; MAX_PARAMETERS],
    /// Intrinsics that are estimated although the data may not determine them.
    pub free_intrinsics: [bool; MAX_PARAMETERS],
    /// Values at which parameters of the board are fixed (ratio, m, m, m).
    pub fixed_board: [Option<f64>; PARAMETERS],
    /// Parameters of the board that are estimated without a test.
    pub free_board: [bool; PARAMETERS],
}

/// Reasons why a request was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ParameterError {
    /// No parameter has this name.
    #[error("no parameter is called {name:?}: write one of {}", names(*.model))]
    Unknown {
        /// The name.
        name: String,
        /// The camera model; `None` if it is not known yet.
        model: Option<ModelKind>,
    },
    /// The value is missing or not a number.
    #[error("{0}: write NAME=VALUE, for example k3=0, bend-x=0mm or radius=17.4mm")]
    Value(String),
    /// No parameter of the lens is left to be estimated.
    #[error("all parameters of the lens are fixed: leave one to be estimated")]
    NothingLeft,
    /// A parameter is both fixed and estimated.
    #[error("{0} cannot be both fixed and estimated")]
    Both(String),
    /// The value is not possible.
    #[error("{0}: this value is not possible for a board")]
    Impossible(String),
}

remedies! { ParameterError, say;
    Self::Unknown { model: None, .. } => "give the camera model with {}", say.model;
    Self::Value(_) => "for example {}", say.fix?.with("k3=0");
    Self::Both(_) => "leave out {} or {}", say.fix?, say.free?;
}

/// Lists all valid names.
fn names(model: Option<ModelKind>) -> String {
    let lens = model.map_or_else(Vec::new, |model| model.parameter_names().to_vec());
    let names: Vec<&str> = lens.into_iter().chain(BOARD_NAMES).collect();
    let hint = if model.is_none() { " (those of the lens only once its model is named)" } else { "" };
    format!("{}{hint}", names.join(", "))
}

/// Index of a parameter.
enum Place {
    Intrinsic(usize),
    Board(usize),
}

impl ParameterRequests {
    /// Returns `true` if an intrinsic parameter is fixed or always estimated.
    pub fn has_intrinsics(&self) -> bool {
        self.fixed_intrinsics.iter().any(Option::is_some) || self.free_intrinsics.contains(&true)
    }

    /// Returns `true` if a parameter of the board is fixed or always estimated.
    pub fn has_board(&self) -> bool {
        self.fixed_board.iter().any(Option::is_some) || self.free_board.contains(&true)
    }

    /// Parses requests: `NAME=VALUE` fixes a parameter, `NAME` estimates it. `model` is the model of the lens, if it is known.
    ///
    /// # Errors
    /// [`ParameterError`] lists the valid names.
    pub fn new(model: Option<ModelKind>, fix: &[String], free: &[String]) -> Result<Self, ParameterError> {
        let place = |name: &str| place(model, name);
        let mut requests = Self::default();
        for text in fix {
            let (name, value) = text.split_once('=').ok_or_else(|| ParameterError::Value(text.clone()))?;
            let wrong = || ParameterError::Value(text.clone());
            match place(name.trim())? {
                Place::Intrinsic(index) => {
                    let value: f64 = value.trim().parse().map_err(|_| wrong())?;
                    requests.fixed_intrinsics[index] = Some(value).filter(|value| value.is_finite());
                    requests.fixed_intrinsics[index].ok_or_else(wrong)?;
                }
                Place::Board(index) => {
                    let value = if index == 0 { value.trim().parse().ok() } else { any_length(value) };
                    let value = value.ok_or_else(wrong)?;
                    let possible = match index {
                        0 => (0.5..2.0).contains(&value),
                        1 | 2 => value.abs() < 10.0,
                        _ => value > 0.0,
                    };
                    possible.then_some(()).ok_or_else(|| ParameterError::Impossible(text.clone()))?;
                    requests.fixed_board[index] = Some(value);
                }
            }
        }
        for name in free {
            let both = || ParameterError::Both(name.clone());
            match place(name.trim())? {
                Place::Intrinsic(index) => {
                    requests.free_intrinsics[index] = true;
                    requests.fixed_intrinsics[index].is_none().then_some(()).ok_or_else(both)?;
                }
                Place::Board(index) => {
                    requests.free_board[index] = true;
                    requests.fixed_board[index].is_none().then_some(()).ok_or_else(both)?;
                }
            }
        }
        let fixed = requests.fixed_intrinsics.iter().flatten().count();
        if model.is_some_and(|model| fixed == model.parameter_names().len()) {
            return Err(ParameterError::NothingLeft);
        }
        Ok(requests)
    }
}

fn place(model: Option<ModelKind>, name: &str) -> Result<Place, ParameterError> {
    let intrinsic = model.and_then(|model| model.parameter_names().iter().position(|known| *known == name));
    let board = BOARD_NAMES.iter().position(|known| *known == name);
    intrinsic
        .map(Place::Intrinsic)
        .or(board.map(Place::Board))
        .ok_or_else(|| ParameterError::Unknown { name: name.to_owned(), model })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn requests(fix: &[&str], free: &[&str]) -> Result<ParameterRequests, ParameterError> {
        let owned = |texts: &[&str]| texts.iter().map(|&text| text.to_owned()).collect::<Vec<_>>();
        ParameterRequests::new(Some(ModelKind::Radtan), &owned(fix), &owned(free))
    }

    #[test]
    fn names_of_lens_and_board_are_read() {
        let found = requests(&["k3=0", "cx=176.5", "bend-x=-1.5mm"], &["radius", "k2"]).unwrap();
        assert_eq!((found.fixed_intrinsics[8], found.fixed_intrinsics[2]), (Some(0.0), Some(176.5)));
        assert!((found.fixed_board[1].unwrap() + 1.5e-3).abs() < 1e-12);
        assert!(found.free_board[3] && found.free_intrinsics[5] && !found.free_intrinsics[8]);
    }

    #[test]
    fn the_error_about_an_unknown_name_lists_all_names() {
        let message = requests(&["k7=0"], &[]).unwrap_err().to_string();
        assert!(message.contains("fx, fy, cx, cy, k1, k2, p1, p2, k3, print-ratio, bend-x"), "{message}");
        let message = ParameterRequests::new(None, &[], &["k1".to_owned()]).unwrap_err().to_string();
        assert!(message.contains("once its model is named") && message.contains("bend-y"), "{message}");
    }

    #[test]
    fn invalid_values_are_refused() {
        for fix in ["k3", "k3=x", "cx=nan", "bend-x=2", "print-ratio=5", "radius=-1mm"] {
            assert!(requests(&[fix], &[]).is_err(), "{fix}");
        }
        assert_eq!(requests(&["k3=0"], &["k3"]), Err(ParameterError::Both("k3".to_owned())));
        let all = ["fx=1", "fy=1", "cx=1", "cy=1", "k1=1", "k2=1", "p1=1", "p2=1", "k3=1"];
        assert_eq!(requests(&all, &[]), Err(ParameterError::NothingLeft));
    }
}
