//! Votes of frames on their neighbours in time: a frame that most of its neighbours contradict is wrong.
//!
//! No frame is trusted because it came first. The frame with the worst vote is removed, its neighbours' votes are counted again,
//! and so on until no frame is outvoted.

/// Neighbouring frames on each side that vote on a frame.
const REACH: usize = 3;

/// A frame that takes part in a vote.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Voter {
    /// Recording of the frame; frames of different recordings are not neighbours.
    pub recording: usize,
    /// Time of the frame in seconds.
    pub t: f64,
}

/// Votes against and for a frame.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    against: usize,
    for_it: usize,
}

impl Tally {
    fn outvoted(self) -> bool {
        self.against > self.for_it
    }

    /// Returns `true` if this tally contradicts its frame more strongly than `other`.
    fn worse_than(self, other: Self) -> bool {
        let here = self.against * (other.against + other.for_it);
        let there = other.against * (self.against + self.for_it);
        (here, self.against) > (there, other.against)
    }
}

/// Returns `true` for each of `voters`, in the order of recording and time, that is kept.
///
/// `agree(i, j)` returns `Some(true)` if frames `i` and `j` can both be right, `None` if that is not known; it is
/// called for the [`REACH`] nearest frames on each side.
pub fn vote(voters: &[Voter], agree: impl Fn(usize, usize) -> Option<bool>) -> Vec<bool> {
    let mut alive: Vec<usize> = (0..voters.len()).collect();
    let tally = |alive: &[usize], position: usize| {
        let mut tally = Tally::default();
        let Some(&own) = alive.get(position) else { return tally };
        let first = position.saturating_sub(REACH);
        for &other in alive.iter().skip(first).take(position - first + REACH + 1) {
            let neighbours = other != own
                && voters.get(other).zip(voters.get(own)).is_some_and(|(other, own)| other.recording == own.recording);
            match neighbours.then(|| agree(own.min(other), own.max(other))).flatten() {
                Some(true) => tally.for_it += 1,
                Some(false) => tally.against += 1,
                None => {}
            }
        }
        tally
    };
    let mut tallies: Vec<Tally> = (0..alive.len()).map(|position| tally(&alive, position)).collect();
    loop {
        let mut worst: Option<(usize, Tally)> = None;
        for (position, &tally) in tallies.iter().enumerate() {
            if tally.outvoted() && worst.is_none_or(|(_, worst)| tally.worse_than(worst)) {
                worst = Some((position, tally));
            }
        }
        let Some((position, _)) = worst else { break };
        alive.remove(position);
        tallies.remove(position);
        let first = position.saturating_sub(REACH);
        for (position, slot) in tallies.iter_mut().enumerate().skip(first).take(2 * REACH) {
            *slot = tally(&alive, position);
        }
    }
    let mut kept = vec![false; voters.len()];
    for index in alive {
        if let Some(kept) = kept.get_mut(index) {
            *kept = true;
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(values: &[f64]) -> Vec<bool> {
        let voters: Vec<Voter> = (0..values.len()).map(|index| Voter { recording: 0, t: index as f64 }).collect();
        vote(&voters, |a, b| Some((values[a] - values[b]).abs() < 1.5 * (b - a) as f64))
    }

    #[test]
    fn wrong_frames_are_removed_at_any_position() {
        let mut values: Vec<f64> = (0..20).map(|index| (f64::from(index) * 0.4).sin()).collect();
        let wrong = [0, 7, 8, 19];
        for &index in &wrong {
            values[index] = 50.0;
        }
        let kept = run(&values);
        for (index, kept) in kept.into_iter().enumerate() {
            assert_eq!(kept, !wrong.contains(&index), "{index}");
        }
    }

    #[test]
    fn frames_without_neighbours_stay() {
        assert_eq!(run(&[1.0]), [true]);
        assert_eq!(run(&[]), Vec::<bool>::new());
        let voters = [Voter { recording: 0, t: 0.0 }, Voter { recording: 1, t: 0.0 }];
        assert_eq!(vote(&voters, |_, _| Some(false)), [true, true]);
        assert_eq!(vote(&voters, |_, _| None), [true, true]);
    }
}
