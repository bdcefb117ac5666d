//! Order statistics without sorting.

use nalgebra::RealField;

/// Returns the value that sorting would put at `rank` (quickselect); reorders the values.
pub(super) fn select<T: RealField + Copy>(values: &mut [T], rank: usize) -> Option<T> {
    let mut rest = values;
    let mut rank = rank;
    loop {
        let pivot = *rest.get(rest.len() / 2)?;
        let (mut below, mut equal) = (0, 0);
        // Three-way partition: below the pivot, equal to it, above it.
        for index in 0..rest.len() {
            let value = *rest.get(index)?;
            if value < pivot {
                exchange(rest, index, below + equal);
                exchange(rest, below + equal, below);
                below += 1;
            } else if value == pivot {
                exchange(rest, index, below + equal);
                equal += 1;
            }
        }
        if rank < below {
            rest = rest.get_mut(..below)?;
        } else if rank < below + equal {
            return Some(pivot);
        } else if equal == 0 {
            // Reached only if values cannot be ordered (NaN).
            return None;
        } else {
            rank -= below + equal;
            rest = rest.get_mut(below + equal..)?;
        }
    }
}

/// Does the same as `swap` of a slice, without its panic.
pub(super) fn exchange<T: Copy>(values: &mut [T], one: usize, other: usize) {
    let (Some(&first), Some(&second)) = (values.get(one), values.get(other)) else { return };
    for (index, value) in [(one, second), (other, first)] {
        if let Some(place) = values.get_mut(index) {
            *place = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_sorting(values in prop::collection::vec(0_u8..20, 1..40), rank in 0_usize..40) {
            let mut values: std::vec::Vec<f64> = values.into_iter().map(f64::from).collect();
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            prop_assert_eq!(select(&mut values, rank), sorted.get(rank).copied());
        }
    }

    #[test]
    fn nan_values_end_the_search() {
        assert_eq!(select(&mut [f64::NAN, 1.0, f64::NAN], 1).filter(|value| value.is_nan()), None);
        assert_eq!(select::<f64>(&mut [], 0), None);
    }
}
