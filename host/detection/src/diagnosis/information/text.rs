//! The summary as lines of text.

use std::fmt;

use evcal_files::visible;

use super::{Information, Peak, SaturatedReadout, seconds};
use crate::diagnosis::bad_pixels::HOT_FACTOR;
use crate::diagnosis::flicker::Flicker;

impl fmt::Display for Information {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write_recording(f)?;
        self.write_events(f)?;
        self.write_pixels(f)?;
        self.write_streams(f)?;
        for other in &self.other_spans {
            line(f, "warning", other.to_string())?;
        }
        for warning in self.report.warnings() {
            line(f, "warning", warning)?;
        }
        if self.events == 0 && self.error.is_none() {
            line(f, "warning", "it contains no events".to_owned())?;
        }
        for note in &self.notes {
            line(f, "note", note.clone())?;
        }
        if let Some(error) = &self.error {
            line(f, "error", format!("reading stopped: {}", error.kind))?;
        }
        Ok(())
    }
}

/// Returns a number of events per second as text. A few events in a day are no "0.000 Mev/s".
fn rate_in_words(rate: f64) -> String {
    match rate {
        rate if rate >= 5e3 => format!("{:.3} Mev/s", rate / 1e6),
        rate if rate >= 0.05 => format!("{rate:.1} events per second"),
        rate => format!("{rate:.1e} events per second"),
    }
}

fn line(f: &mut fmt::Formatter<'_>, name: &str, value: String) -> fmt::Result {
    writeln!(f, "{name:<12}{}", visible::name(&value))
}

impl Information {
    /// Writes file, camera and length.
    fn write_recording(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        line(f, "file", self.path.clone())?;
        line(f, "format", self.format.to_owned())?;
        line(f, "camera", self.camera_name.clone().unwrap_or_else(|| "not named".to_owned()))?;
        if let Some(began) = &self.began {
            line(f, "recorded", began.clone())?;
        }
        line(
            f,
            "sensor",
            match (self.sensor, self.likely_sensor) {
                (Some(sensor), _) => format!("{sensor} pixels"),
                (None, Some(likely)) => format!("not given; the events suggest {likely} pixels"),
                (None, None) => "not given".to_owned(),
            },
        )?;
        if let Some((first, last)) = self.times_us {
            line(f, "duration", format!("{:.6} s (timestamps {first} to {last} us)", self.duration_s))?;
        }
        Ok(())
    }

    /// Writes number and rate of the events.
    fn write_events(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let share = self.on_share.map(|share| format!(", {:.1} % ON", 100.0 * share)).unwrap_or_default();
        line(f, "events", format!("{}{share}", self.events))?;
        let mean = rate_in_words(self.mean_rate);
        if let Some(Peak { rate, t_s }) = self.peak {
            let peak = rate_in_words(rate);
            line(f, "rate", format!("mean {mean}, at most {peak} (over 10 ms, {t_s:.3} s after the first event)"))?;
        } else if self.mean_rate > 0.0 {
            line(f, "rate", format!("mean {mean}"))?;
        }
        if let Some(SaturatedReadout { rate, duration_s, t_s }) = self.saturation {
            let rate = rate / 1e6;
            line(
                f,
                "saturated",
                format!(
                    "for {duration_s:.3} s, first at {t_s:.3} s: the sensor cannot read more than {rate:.3} Mev/s, so the times of events are late"
                ),
            )?;
        }
        if let Some(Flicker { frequency, share, fills_readout }) = self.flicker {
            let share = 100.0 * share;
            let value =
                format!("the light flickers at {frequency} Hz, and the event rate varies with it by {share:.0} %");
            let full = if fills_readout { ", up to the limit of the readout: times are late" } else { "" };
            line(f, "flicker", value + full)?;
        }
        if let Some(coarse) = self.coarse_times {
            line(f, "times", coarse.to_string())?;
        }
        if self.gap_count > 0 {
            let shown = self.longest_gaps.iter().map(|gap| format!("{:.3} s at {:.3} s", gap.duration_s, gap.t_s));
            let shown = shown.collect::<Vec<_>>().join(", ");
            line(f, "gaps", format!("{} of more than 0.1 s without events; the longest: {shown}", self.gap_count))?;
        }
        Ok(())
    }

    /// Writes pixels with too many or no events.
    fn write_pixels(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.hot_pixel_count > 0 {
            let shown = self.hottest_pixels.iter().map(|pixel| format!("({}, {}): {}", pixel.x, pixel.y, pixel.events));
            let shown = shown.collect::<Vec<_>>().join(", ");
            let count = self.hot_pixel_count;
            line(
                f,
                "hot pixels",
                format!(
                    "{count} with more than {HOT_FACTOR} times the events of their neighbours; the hottest: {shown}"
                ),
            )?;
        }
        if let Some(silent) = &self.silent {
            line(f, "silent", silent.to_string())?;
        }
        Ok(())
    }

    /// Writes all streams of the file.
    fn write_streams(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for stream in self.streams.iter().filter(|stream| stream.packets > 0) {
            let seconds = stream.times_us.map_or(0.0, |(first, last)| seconds(last.saturating_sub(first)));
            let rate =
                if seconds > 0.0 { format!(", {:.1}/s", stream.elements as f64 / seconds) } else { String::new() };
            let unread = stream.unread.as_ref().map(|encoding| format!("; their encoding, {encoding}, is not read"));
            let unread = unread.unwrap_or_default();
            let text = format!("{}: {} in {} packets{rate}{unread}", stream.name, stream.elements, stream.packets);
            line(f, "stream", text)?;
        }
        if self.streams.is_empty() {
            for (name, count) in &self.report.other_packets {
                line(f, "stream", format!("{name}: {count}"))?;
            }
        }
        Ok(())
    }
}
