//! Conversion of the pipeline's data to messages of the link.

use evcal_core::circle::CircleCandidate;
use evcal_core::detector::Detection;
use evcal_core::window::Window;
use evcal_link::{Circle, DeviceName, Hello, Losses, PROTOCOL_VERSION, WindowEnd};

use crate::Settings;

/// Number of events, runs and clusters that fit into a window.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Capacities {
    pub events: usize,
    pub runs: usize,
    pub clusters: usize,
}

/// Converts a time; times before the clock's zero become zero.
pub(crate) fn time(time_us: i64) -> u64 {
    u64::try_from(time_us).unwrap_or(0)
}

pub(crate) fn hello(settings: &Settings, capacities: Capacities, first: bool, time_us: i64) -> Hello {
    let mut device = DeviceName::new();
    for character in settings.device.chars() {
        if device.push(character).is_err() {
            break;
        }
    }
    let (window, cluster, circle) = (&settings.window, &settings.detector.cluster, &settings.detector.circle);
    Hello {
        protocol: PROTOCOL_VERSION,
        first,
        time_us: time(time_us),
        device,
        sensor_width: settings.sensor.width,
        sensor_height: settings.sensor.height,
        step_us: window.step,
        min_interval: window.min_interval,
        max_interval: window.max_interval,
        gap: window.gap,
        most_events: window.most_events,
        fewest_events: window.fewest_events,
        fewest_circles: settings.fewest_circles,
        epsilon: cluster.epsilon,
        min_points: cluster.min_points,
        min_pixels: cluster.min_pixels,
        min_radius: circle.min_radius,
        max_radius: circle.max_radius,
        refractory_us: settings.filter.refractory_us,
        background_us: settings.filter.background_us,
        hot_events: settings.filter.hot_events,
        capacity_events: capacities.events as u32,
        capacity_runs: capacities.runs as u32,
        capacity_clusters: capacities.clusters as u32,
    }
}

pub(crate) fn circle(number: u32, window: &Window, found: &CircleCandidate<f32>) -> Circle {
    Circle {
        window: number,
        time_us: time(window.center_us()),
        x: found.center.x,
        y: found.center.y,
        radius: found.radius,
        error: found.error,
        on_pixels: found.on_pixels,
        off_pixels: found.off_pixels,
    }
}

pub(crate) fn window_end(number: u32, window: &Window, detection: &Detection, losses: Losses) -> WindowEnd {
    let [off, on] = detection.clusters.clusters;
    WindowEnd {
        window: number,
        start_us: time(window.start_us),
        length_us: u32::try_from(window.end_us.saturating_sub(window.start_us)).unwrap_or(u32::MAX),
        events: detection.clusters.events,
        clusters: u16::try_from(off.saturating_add(on)).unwrap_or(u16::MAX),
        circles: u16::try_from(detection.circles.circles).unwrap_or(u16::MAX),
        pixels_over_capacity: detection.clusters.pixels_over_capacity,
        clusters_over_capacity: detection.clusters.clusters_over_capacity,
        circles_over_capacity: detection.circles.pairs_over_capacity,
        losses,
    }
}

/// Returns the losses between two states of the counts.
pub(crate) fn losses_since(before: &Losses, now: &Losses) -> Losses {
    Losses {
        undecodable: now.undecodable.wrapping_sub(before.undecodable),
        hot: now.hot.wrapping_sub(before.hot),
        background: now.background.wrapping_sub(before.background),
        refractory: now.refractory.wrapping_sub(before.refractory),
        shed: now.shed.wrapping_sub(before.shed),
        overflow: now.overflow.wrapping_sub(before.overflow),
        in_gap: now.in_gap.wrapping_sub(before.in_gap),
    }
}
