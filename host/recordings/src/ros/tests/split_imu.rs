//! Accelerations and angular velocities in topics of their own, as drivers of RealSense cameras publish them.

use super::files::{Messages, START, event_array, events, imu_of};
use super::{Wire, files};
use crate::extras::Extra;
use crate::{Recording, RecordingOptions};

const IMU: &str = "sensor_msgs/msg/Imu";

fn messages(wire: Wire) -> Messages {
    let mut messages: Messages = vec![("/camera/events", "dvs_msgs/msg/EventArray", event_array(wire, &events(0, 7)))];
    // Another IMU, which is complete, but not of this camera.
    messages.push(("/body/imu", IMU, imu_of(wire, START, [1.0, 1.0, 1.0], [1.0, 2.0, 3.0])));
    for index in 0..40_i64 {
        let t = START + 1000 * index;
        if index % 4 == 0 {
            let acceleration = 9.80665 * index as f64;
            messages.push(("/camera/accel/sample", IMU, imu_of(wire, t, [0.0; 3], [acceleration, 0.0, 9.80665])));
        }
        messages.push(("/camera/gyro/sample", IMU, imu_of(wire, t + 500, [0.0, index as f64, 1.0], [0.0; 3])));
    }
    messages
}

#[test]
fn samples_are_put_together_from_two_topics() {
    for content in files(messages) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, &content).unwrap();
        let mut extras = Recording::new(&path, RecordingOptions::default()).unwrap().open_extras().unwrap();
        let chosen = extras.chosen().join("; ");
        assert!(chosen.contains("IMU samples are read from /camera/gyro/sample"), "{chosen}");
        assert!(chosen.contains("their accelerations are read from /camera/accel/sample"), "{chosen}");
        let (mut count, mut lost) = (0, Vec::new());
        while let Some(extra) = extras.next_until(i64::MAX, &mut lost) {
            let Extra::Inertial(sample) = extra else { panic!("a sample") };
            // Both grow by one unit per millisecond.
            let elapsed = (sample.t - START) as f32 / 1000.0;
            assert!((sample.acceleration[0] - elapsed).abs() < 1e-3, "{sample:?} at {elapsed}");
            assert!(
                (sample.angular_velocity[1].to_radians() - (elapsed - 0.5)).abs() < 1e-3,
                "{sample:?} at {elapsed}"
            );
            count += 1;
        }
        // Those after the last acceleration have none.
        assert_eq!((count, lost.len()), (36, 0));
    }
}
