//! Images of a frame camera in bags written by rosbags, with JPEG and PNG images written by OpenCV.

use std::path::Path;

use evcal_tests::readers::{ask, python};
use evcal_tests::{evcal, text};
use event_recordings::Damage;
use event_recordings::image_folder::Stamps;
use event_recordings::images::Images;
use event_recordings::pictures::GreyImage;
use serde_json::{Value, json};

/// Reads the only image of a topic.
fn image(bag: &Path, topic: &str, written: &Value) -> GreyImage {
    let images = Images::open(bag, Some(topic), Damage::Refuse, Stamps::Middle).unwrap().unwrap();
    let mut found = Vec::new();
    assert_eq!(images.visit(|image| found.push(image)).unwrap(), None);
    assert_eq!(found.len(), 1, "{topic}");
    let image = found.remove(0);
    assert_eq!(json!(image.exposure.0), written["time"]);
    let image = image.image.unwrap();
    assert_eq!(json!([image.width(), image.height()]), written["size"]);
    image
}

/// Returns the centroid of the dark region.
fn middle(image: &GreyImage) -> [f64; 2] {
    let paper = f64::from(image.pixels[0]);
    let mut sums = [0.0; 3];
    for (index, pixel) in image.pixels.iter().enumerate() {
        let (x, y) = ((index % image.width()) as f64, (index / image.width()) as f64);
        let darkness = paper - f64::from(*pixel);
        sums = [sums[0] + darkness, sums[1] + darkness * x, sums[2] + darkness * y];
    }
    [sums[1] / sums[0], sums[2] / sums[0]]
}

#[test]
fn images_of_other_writers_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let written = ask(&python(), "images.py", &json!({"folder": folder.path()}));
    let center: [f64; 2] = serde_json::from_value(written["center"].clone()).unwrap();
    let topics: Vec<(String, Option<String>)> = serde_json::from_value(written["topics"].clone()).unwrap();
    assert_eq!(topics.len(), 13);
    for ending in ["bag", "db3", "mcap"] {
        let bag = folder.path().join(format!("images.{ending}"));
        for (topic, grey) in &topics {
            let found = image(&bag, topic, &written);
            if let Some(grey) = grey {
                let expected = grey.as_bytes().as_chunks::<2>().0.iter();
                let expected = expected.map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap());
                let most = found.pixels.iter().zip(expected).map(|(one, other)| one.abs_diff(other)).max();
                // The two JPEG decoders round differently.
                assert!(most <= Some(if topic.contains("jpeg") { 3 } else { 1 }), "{topic} of {ending}: {most:?}");
            }
            let middle = middle(&found);
            let error = (middle[0] - center[0]).hypot(middle[1] - center[1]);
            assert!(error < 0.03, "{topic} of {ending}: {middle:?}, not {center:?}");
        }
        let listed = evcal(&["info", text(&bag)]);
        assert!(
            topics.iter().all(|(topic, _)| listed.stderr.contains(topic) || listed.stdout.contains(topic)),
            "{listed:?}"
        );
    }
}
