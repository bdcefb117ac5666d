//! Detection of files that continue each other, because programs split long recordings by size or time.

use std::ops::RangeInclusive;

use crate::reader::RecordingInformation;
use crate::recording::Recording;

/// Range of the pause in µs between the last event of a file and the first event of its continuation. It covers the
/// pause between two events of a moving board and the jitter of events that were split by message.
const PAUSE: RangeInclusive<i64> = -1000..=100_000;

/// Finds recordings that continue each other: format, sensor and camera are the same, and each begins when the previous
/// one ends. Returns one list per chain of two or more recordings, with their indices in `recordings` in order of time.
pub fn chains(recordings: &[&Recording]) -> Vec<Vec<usize>> {
    let mut beginnings: Vec<(i64, usize)> =
        recordings.iter().enumerate().filter_map(|(index, recording)| Some((first_time(recording)?, index))).collect();
    beginnings.sort_unstable();
    let mut chains: Vec<Vec<usize>> = Vec::new();
    let mut chain: Vec<usize> = Vec::new();
    for &(first, index) in &beginnings {
        let before = chain.last().and_then(|before| recordings.get(*before));
        if let (Some(before), Some(recording)) = (before, recordings.get(index))
            && have_same_camera_and_format(before, recording)
            && ends_at(before, first)
        {
            chain.push(index);
        } else {
            chains.push(std::mem::replace(&mut chain, vec![index]));
        }
    }
    chains.push(chain);
    chains.retain(|chain| chain.len() > 1);
    chains
}

fn first_time(recording: &Recording) -> Option<i64> {
    let (mut reader, mut batch) = (recording.open().ok()?, Vec::new());
    reader.next_batch(&mut batch).ok()?;
    Some(batch.first()?.t)
}

fn have_same_camera_and_format(one: &Recording, other: &Recording) -> bool {
    let known = |recording: &Recording| {
        let reader = recording.open().ok()?;
        let RecordingInformation { format, sensor, camera_name, .. } = reader.information().clone();
        Some((format, sensor, camera_name))
    };
    known(one).is_some_and(|one| known(other) == Some(one))
}

/// Returns `true` if the last event comes shortly before `time` (µs). Stops reading at the first event after it.
fn ends_at(recording: &Recording, time: i64) -> bool {
    let Ok(mut reader) = recording.open() else { return false };
    let (mut batch, mut last) = (Vec::new(), None);
    loop {
        match reader.next_batch(&mut batch) {
            Ok(true) => last = batch.last().map(|event| event.t),
            Ok(false) => return last.is_some_and(|last| PAUSE.contains(&(time - last))),
            Err(_) => return false,
        }
        if last.is_some_and(|last| time - last < *PAUSE.start()) {
            return false;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use evcal_core::event::{Event, Polarity};
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::RecordingOptions;
    use crate::encode::OutputFormat;
    use crate::write::EventWriter;

    /// Returns 3000 events 70 µs apart, the first at time `first`.
    fn events(first: i64) -> Vec<Event> {
        (0..3000)
            .map(|index| Event {
                t: first + 70 * index,
                x: (index * 37 % 346) as u16,
                y: (index * 91 % 260) as u16,
                polarity: Polarity::On,
            })
            .collect()
    }

    fn write(path: &Path, first: i64) -> Recording {
        let output = OutputFormat::from_extension(path).unwrap();
        let mut writer = EventWriter::create(path, output, Sensor::new(346, 260), "").unwrap();
        writer.write(&events(first)).unwrap();
        writer.finish().unwrap();
        Recording::new(path, RecordingOptions::default()).unwrap()
    }

    fn read(recording: &Recording) -> Vec<Event> {
        let (mut reader, mut all, mut batch) = (recording.open().unwrap(), Vec::new(), Vec::new());
        while reader.next_batch(&mut batch).unwrap() {
            all.extend_from_slice(&batch);
        }
        all
    }

    #[test]
    fn files_that_continue_each_other_are_one_recording() {
        const LENGTH: i64 = 3000 * 70;
        for extension in ["npz", "bag", "mcap", "aedat4", "csv"] {
            let folder = tempfile::tempdir().unwrap();
            // In a shell's order, 10 precedes 2. File 20 begins 0.3 s after the others end, file 30 during
            // them.
            let starts = [(1, 0), (10, 2 * LENGTH), (2, LENGTH), (20, 3 * LENGTH + 300_000), (30, LENGTH / 2)];
            let name = |number: i32| folder.path().join(format!("part_{number}.{extension}"));
            let files = starts.map(|(number, start)| write(&name(number), 1_000_003 + start));
            let chains = chains(&files.each_ref());
            // A file that lies within others breaks the chain, because the order is then ambiguous.
            assert_eq!(chains, [vec![2, 1]], "{extension}");
            let three = [&files[0], &files[1], &files[2], &files[3]];
            assert_eq!(super::chains(&three), [vec![0, 2, 1]], "{extension}");
            let chain = Recording::chain([0, 2, 1].map(|place: usize| files[place].clone()).into()).unwrap();
            let expected = [events(1_000_003), events(1_000_003 + LENGTH), events(1_000_003 + 2 * LENGTH)].concat();
            assert!(read(&chain) == expected, "{extension}");
            assert!(read(&chain) == expected, "read again: {extension}");
            let within = chain.section(1_000_003 + LENGTH - 70..1_000_003 + LENGTH + 70);
            assert_eq!(read(&within).len(), 2, "{extension}");
            assert_eq!(chain.files().len(), 3);
        }
    }
}
