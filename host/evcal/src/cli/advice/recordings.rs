//! What to do about recordings and files.

use std::error::Error;

/// What to do about `error`, where it is one of event-recordings or evcal-files.
pub fn advice(_error: &(dyn Error + 'static)) -> Option<String> {
    None
}
