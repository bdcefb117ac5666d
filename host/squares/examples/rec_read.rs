//! Recognises boards in dumped pictures.
use evcal_squares::picture::Picture;
use evcal_squares::recognition::recognise;

fn main() {
    for path in std::env::args().skip(1) {
        let bytes = std::fs::read(&path).unwrap();
        let word = |index: usize| u32::from_le_bytes(bytes[4 * index..4 * index + 4].try_into().unwrap()) as usize;
        let (count, pictures, width, height) = (word(0), word(1), word(2), word(3));
        let picture = |index: usize| {
            let begin = 16 + 4 * index * width * height;
            let values = bytes[begin..begin + 4 * width * height]
                .chunks_exact(4)
                .map(|four| f32::from_le_bytes(four.try_into().unwrap()));
            Picture::new(width, height, values.collect()).unwrap()
        };
        let moments: Vec<Vec<Picture>> =
            (0..count).map(|moment| (0..pictures).map(|index| picture(moment * pictures + index)).collect()).collect();
        let start = std::time::Instant::now();
        let found = recognise(&moments);
        let text = found.map_or("-".into(), |found| format!("{} {}/{}", found.board, found.fitting, found.moments));
        println!("{} {:.2}s {text}", path.rsplit('/').next().unwrap(), start.elapsed().as_secs_f64());
    }
}
