//! Tests of image messages.

use super::super::fields::MessageError;
use super::super::message::Kind;
use super::super::picture::{description, frame, unread_encoding};
use super::*;

/// 24 x 16 pixels that become brighter from left to right, written by OpenCV (`cv2.imencode`, quality 95): grey, and in
/// colours of which red is the brightest.
const GREY_JPEG: &[u8] = include_bytes!("grey.jpg");
const RED_JPEG: &[u8] = include_bytes!("red.jpg");

#[test]
fn images_of_other_encodings_are_converted_to_eight_bits() {
    for (encoding, step, bytes, pixels, channels) in [
        ("mono16", 6, [[9, 1], [9, 2], [9, 3], [9, 4], [9, 5], [9, 255]].concat(), vec![1, 2, 3, 4, 5, 255], 1),
        // 12 of the 16 bits are in use.
        ("mono16", 6, [[16, 0], [32, 0], [0, 1], [255, 15], [15, 0], [0, 0]].concat(), vec![1, 2, 16, 255, 0, 0], 1),
        ("rgb8", 9, (0..18).collect(), vec![2, 1, 0, 5, 4, 3, 8, 7, 6, 11, 10, 9, 14, 13, 12, 17, 16, 15], 3),
        ("BGR8", 9, (0..18).collect(), (0..18).collect(), 3),
        ("8UC3", 9, (0..18).collect(), (0..18).collect(), 3),
        // Brightness and colour alternate.
        ("uyvy", 6, (0..12).collect(), vec![1, 3, 5, 7, 9, 11], 1),
        ("yuv422", 6, (0..12).collect(), vec![1, 3, 5, 7, 9, 11], 1),
        ("yuyv", 6, (0..12).collect(), vec![0, 2, 4, 6, 8, 10], 1),
        ("yuv422_yuy2", 6, (0..12).collect(), vec![0, 2, 4, 6, 8, 10], 1),
        // A plane with colours follows the image.
        ("nv21", 3, (0..9).collect(), (0..6).collect(), 1),
        ("nv24", 3, (0..18).collect(), (0..6).collect(), 1),
    ] {
        let message = image(Wire::Cdr, 5, encoding, step, &bytes);
        let frame = frame(Kind::Image, Wire::Cdr, &message).unwrap().unwrap();
        assert_eq!((frame.pixels, frame.channels), (pixels, channels), "{encoding}");
        assert_eq!(unread_encoding(Wire::Cdr, &message), None);
    }
    // The driver of iniVation's cameras writes grey frames in this form.
    for (encoding, samples, in_order) in [
        ("rgb16", 3, [2, 1, 0]),
        ("bgr16", 3, [0, 1, 2]),
        ("16UC3", 3, [0, 1, 2]),
        ("rgba16", 4, [2, 1, 0]),
        ("bgra16", 4, [0, 1, 2]),
        ("16UC4", 4, [0, 1, 2]),
    ] {
        let pixel = |index: usize| (0..samples).flat_map(move |sample| [7, (10 * index + sample + 100) as u8]);
        let bytes: Vec<u8> = (0..6).flat_map(pixel).collect();
        let message = image(Wire::Cdr, 5, encoding, 6 * samples as u32, &bytes);
        let frame = frame(Kind::Image, Wire::Cdr, &message).unwrap().unwrap();
        let pixels: Vec<u8> =
            (0..6).flat_map(|index| in_order.map(|sample| (10 * index + sample + 100) as u8)).collect();
        assert_eq!((frame.pixels, frame.channels), (pixels, 3), "{encoding}");
    }
    let named = unread_encoding(Wire::Ros1, &image(Wire::Ros1, 5, "16SC1", 6, &[0; 12]));
    assert_eq!(named.as_deref(), Some("16SC1"));
    let named = unread_encoding(Wire::Ros1, &image(Wire::Ros1, 5, "16UC1", 6, &[0; 12]));
    assert_eq!(named.as_deref(), Some("16UC1 (possibly distances)"));
    assert_eq!(frame(Kind::Image, Wire::Ros1, &image(Wire::Ros1, 5, "32FC1", 12, &[0; 24])), Ok(None));
    assert!(frame(Kind::Image, Wire::Ros1, &image(Wire::Ros1, 5, "mono8", 2, &[0; 4])).is_err());
    assert!(frame(Kind::Image, Wire::Ros1, &image(Wire::Ros1, 5, "mono8", u32::MAX, &[0; 4])).is_err());
}

#[test]
fn bayer_patterns_become_grey() {
    // Red 40, green 100, blue 60, weighted by a quarter, a half and a quarter.
    for (order, bytes) in [
        ("rggb", [40, 100, 40, 100, 60, 100]),
        ("bggr", [60, 100, 60, 100, 40, 100]),
        ("gbrg", [100, 60, 100, 40, 100, 40]),
        ("grbg", [100, 40, 100, 60, 100, 60]),
    ] {
        let read = |encoding: &str, step, bytes: &[u8]| {
            let found = frame(Kind::Image, Wire::Ros1, &image(Wire::Ros1, 5, encoding, step, bytes)).unwrap().unwrap();
            assert_eq!((found.channels, found.size), (1, (3, 2)));
            found.pixels
        };
        assert_eq!(read(&format!("bayer_{order}8"), 3, &bytes), [75; 6], "{order}");
        // 12 of 16 bits are in use.
        let twelve: Vec<u8> = bytes.iter().flat_map(|byte| (u16::from(*byte) * 32).to_le_bytes()).collect();
        assert_eq!(read(&format!("bayer_{order}16"), 6, &twelve), [150; 6], "{order}");
        let mosaic = mosaic_png(&bytes);
        for (format, pixels) in [("png compressed ", vec![75; 6]), ("png compressed mono8", bytes.to_vec())] {
            let format = format!("bayer_{order}8; {format}");
            let message = compressed_image(Wire::Cdr, 5, &format, &mosaic);
            assert_eq!(frame(Kind::CompressedImage, Wire::Cdr, &message).unwrap().unwrap().pixels, pixels, "{format}");
        }
    }
}

fn mosaic_png(bytes: &[u8]) -> Vec<u8> {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("mosaic.png");
    ImageFile { size: (3, 2), channels: 1, samples: Samples::Eight(bytes.to_vec()) }.write_png(&path).unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn compressed_images_are_recognised_by_their_bytes() {
    for wire in [Wire::Ros1, Wire::Cdr] {
        for format in ["png", "mono8; png compressed ", "jpeg", ""] {
            let found =
                frame(Kind::CompressedImage, wire, &compressed_image(wire, START, format, &png())).unwrap().unwrap();
            assert_eq!((found.t, found.size, found.pixels), (START, (3, 2), vec![1, 2, 3, 4, 5, 6]));
        }
        let read = |bytes| {
            let message = compressed_image(wire, 5, "bgr8; jpeg compressed bgr8", bytes);
            let found = frame(Kind::CompressedImage, wire, &message).unwrap().unwrap();
            assert_eq!(found.size, (24, 16));
            (found.channels, found.pixels)
        };
        let (channels, grey) = read(GREY_JPEG);
        assert_eq!(channels, 1);
        assert!(grey.iter().enumerate().all(|(index, value)| value.abs_diff((index % 24 * 10) as u8) <= 2), "{grey:?}");
        let (channels, coloured) = read(RED_JPEG);
        assert_eq!(channels, 3);
        for (index, pixel) in coloured.as_chunks::<3>().0.iter().enumerate() {
            let red = (index % 24 * 10) as u8;
            assert!(
                pixel.iter().zip([20, 20, red]).all(|(value, was)| value.abs_diff(was) <= 12),
                "{index}: {pixel:?}"
            );
        }
    }
}

#[test]
fn compressed_images_that_cannot_be_read_are_reported() {
    let read = |format: &str, bytes: &[u8]| {
        frame(Kind::CompressedImage, Wire::Cdr, &compressed_image(Wire::Cdr, 5, format, bytes))
    };
    assert_eq!(read("16UC1; compressedDepth png", &png()), Ok(None));
    assert_eq!(read("h264", &[0, 0, 0, 1, 9]), Ok(None));
    let message = compressed_image(Wire::Ros1, 5, "h264", &[0; 9]);
    assert_eq!(description(Kind::CompressedImage, Wire::Ros1, &message).unwrap().encoding, "h264");
    for whole in [png(), GREY_JPEG.to_vec()] {
        let error = read("jpeg", &whole[..whole.len() / 2]).unwrap_err();
        assert!(matches!(&error, MessageError::Picture(what) if what.starts_with("not a valid ")), "{error}");
    }
    // The header requests 4 GB; its checksum is correct.
    let mut large = png();
    large[16..24].copy_from_slice(&[0, 0, 0xFF, 0xFF, 0, 0, 0xFF, 0xFF]);
    let mut checksum = flate2::Crc::new();
    checksum.update(&large[12..29]);
    large[29..33].copy_from_slice(&checksum.sum().to_be_bytes());
    let error = read("png", &large).unwrap_err().to_string();
    assert!(error.contains("65535 x 65535 pixels, too many for a file of"), "{error}");
}
