//! Tests with valid folders of images and with every kind of mistake.

use super::*;
use crate::image_file::Samples;
use crate::pictures::GreyImage;

fn grey(image: ImageFile) -> Option<GreyImage> {
    TimedImage::from(Frame::of_file(image, 0)?).image.ok()
}

/// Creates a folder with this table, and images of 4 × 3 pixels with these names.
fn folder(table: &str, names: &[&str]) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    fs::create_dir(directory.path().join(IMAGES)).unwrap();
    fs::write(directory.path().join(TABLE), table).unwrap();
    for (number, name) in names.iter().enumerate() {
        picture((4, 3), 1, number as u8).write_png(&directory.path().join(IMAGES).join(name)).unwrap();
    }
    directory
}

fn picture(size: (u32, u32), channels: usize, level: u8) -> ImageFile {
    ImageFile { size, channels, samples: Samples::Eight(vec![level; (size.0 * size.1) as usize * channels]) }
}

fn images(path: &Path, stamps: Stamps) -> Vec<TimedImage> {
    let mut images = Vec::new();
    ImageFolder::open(path, stamps).unwrap().visit(|image| images.push(image)).unwrap();
    images
}

fn refused(path: &Path) -> String {
    let error = match ImageFolder::open(path, Stamps::Middle) {
        Ok(folder) => folder.visit(|_| {}).unwrap_err(),
        Err(error) => error,
    };
    error.to_string()
}

const TWO: &str = "#timestamp [ns],filename\r\n1403636579763555584,a.png\r\n1403636579796888000, b.png\r\n\r\n";

#[test]
fn images_are_read_in_order_with_their_times() {
    let directory = folder(TWO, &["a.png", "b.png"]);
    let folder = ImageFolder::open(directory.path(), Stamps::Start).unwrap();
    assert_eq!((folder.sensor(), folder.exposure_known()), (Sensor::new(4, 3), false));
    let [first, second] = images(directory.path(), Stamps::Start).try_into().unwrap();
    // Rounded to the nearest microsecond.
    assert_eq!(first.exposure, (1_403_636_579_763_556, 1_403_636_579_763_556));
    assert_eq!((second.exposure.0, second.exposure_known), (1_403_636_579_796_888, false));
    assert_eq!(first.image, GreyImage::new(4, 3, vec![0; 12]).ok_or(NoImage::NotGrey));
    assert_eq!(second.image.unwrap().get(3, 2), Some(1));
}

#[test]
fn the_exposure_is_placed_relative_to_the_timestamp_as_requested() {
    let table = "#timestamp [ns],filename,exposure [ms]\n10000000,a.png,4\n20000000,b.png,2.5\n";
    let directory = folder(table, &["a.png", "b.png"]);
    let times = |stamps| images(directory.path(), stamps).iter().map(|image| image.exposure).collect::<Vec<_>>();
    assert_eq!(times(Stamps::Start), [(10_000, 14_000), (20_000, 22_500)]);
    assert_eq!(times(Stamps::Middle), [(8000, 12_000), (18_750, 21_250)]);
    assert_eq!(times(Stamps::End), [(6000, 10_000), (17_500, 20_000)]);
    assert!(images(directory.path(), Stamps::End).iter().all(|image| image.exposure_known));
}

#[test]
fn the_folder_of_a_data_set_is_accepted_if_it_has_one_camera() {
    let whole = tempfile::tempdir().unwrap();
    assert!(refused(whole.path()).contains("holds no data.csv"));
    for name in ["cam0", "cam1"] {
        let camera = whole.path().join("mav0").join(name);
        fs::create_dir_all(camera.join(IMAGES)).unwrap();
        fs::write(camera.join(TABLE), "5,a.png\n").unwrap();
        picture((4, 3), 1, 9).write_png(&camera.join(IMAGES).join("a.png")).unwrap();
        if name == "cam0" {
            assert_eq!(images(whole.path(), Stamps::Middle).len(), 1);
        }
    }
    assert!(refused(whole.path()).contains("several cameras (mav0/cam0, mav0/cam1)"), "{}", refused(whole.path()));
    assert_eq!(images(&whole.path().join("mav0/cam1"), Stamps::Middle).len(), 1);
}

#[test]
fn mistakes_name_the_line_or_the_file() {
    let wrong = |table: &str, words: &[&str]| {
        let directory = folder(table, &["a.png", "b.png"]);
        let message = refused(directory.path());
        assert!(words.iter().all(|word| message.contains(word)), "{words:?}: {message}");
    };
    wrong("#timestamp [ns],filename\n5,a.png\n7,c.png\n", &["data.csv: line 3", "there is no file", "c.png"]);
    wrong("5,a.png\n5,b.png\n", &["line 2", "5 ns is not after 5 ns"]);
    wrong("5,a.png\n-3,b.png\n", &["line 2", "-3 ns is not after 5 ns"]);
    wrong("5,a.png\n1.5e9,b.png\n", &["line 2", "\"1.5e9\" is not a whole number of nanoseconds"]);
    wrong("5,a.png\n\n7\n", &["line 3", "\"7\" is not a line TIMESTAMP_NS"]);
    wrong("5,a.png\n7,\n", &["line 2", "is not a line TIMESTAMP_NS"]);
    wrong("#timestamp [ns],filename,exposure [us]\n5,a.png,fast\n", &["line 2", "\"fast\" is not an exposure"]);
    wrong("#timestamp [ns],filename,exposure [us]\n5,a.png\n", &["line 2", "\"\" is not an exposure"]);
    wrong("#timestamp [ns],filename\n", &["data.csv names no image"]);
}

#[test]
fn images_that_cannot_be_read_or_have_a_wrong_size_are_named() {
    let directory = folder(TWO, &["a.png", "b.png"]);
    let second = directory.path().join(IMAGES).join("b.png");
    picture((5, 3), 1, 7).write_png(&second).unwrap();
    let message = refused(directory.path());
    assert!(message.contains("b.png has 5 x 3 pixels, the images before it 4 x 3"), "{message}");
    for (content, word) in [(&b"\x89PNG\r\n\x1a\nrubbish"[..], "not a valid PNG"), (b"BM", "neither PNG nor JPEG")] {
        fs::write(&second, content).unwrap();
        let message = refused(directory.path());
        assert!(message.contains("b.png: ") && message.contains(word), "{message}");
    }
    picture((70_000, 1), 1, 7).write_png(&directory.path().join(IMAGES).join("a.png")).unwrap();
    let message = refused(directory.path());
    assert!(message.ends_with("a.png has 70000 x 1 pixels: an image needs 1 to 65535 columns and rows"), "{message}");
}

#[test]
fn colours_and_sixteen_bits_become_grey() {
    let colour = ImageFile { size: (1, 1), channels: 3, samples: Samples::Eight(vec![30, 20, 10]) };
    // 0.299 · 30 + 0.587 · 20 + 0.114 · 10 = 21.85.
    assert_eq!(grey(colour), GreyImage::new(1, 1, vec![22]));
    let alpha = ImageFile { size: (2, 1), channels: 2, samples: Samples::Eight(vec![30, 255, 40, 255]) };
    assert_eq!(grey(alpha), GreyImage::new(2, 1, vec![30, 40]));
    // 12 bits in 16.
    let deep = ImageFile { size: (2, 1), channels: 1, samples: Samples::Sixteen(vec![4095, 1024]) };
    assert_eq!(grey(deep), GreyImage::new(2, 1, vec![255, 64]));
}
