//! Reading and writing a 4096 x 2048 map in each format.
//!
//! `cargo bench --bench formats`

use divan::Bencher;
use divan::counter::BytesCount;
use pipeline::formats::{self, Limits};
use pipeline::image::raster::{Image, Raster};

const WIDTH: usize = 4096;
const HEIGHT: usize = 2048;

fn main() {
    divan::main();
}

/// A map with some noise, so that compressions have work to do.
fn map() -> Image {
    let noise = |index: usize, channel: u32| (index as u32).wrapping_mul(2_654_435_761).rotate_left(channel * 7) >> 24;
    let pixel = |index: usize| [0, 1, 2].map(|channel| 1.0 + (index % WIDTH) as f32 / 512.0 + noise(index, channel) as f32 / 4096.0);
    Image::opaque(Raster::new(WIDTH, HEIGHT, (0..WIDTH * HEIGHT).map(pixel).collect()))
}

#[divan::bench(args = ["pfm", "hdr", "exr", "npy"], sample_count = 5)]
fn read(bencher: Bencher<'_, '_>, format: &str) {
    let bytes = formats::encode(&map(), format, &[]).unwrap().0;
    bencher.counter(BytesCount::new(WIDTH * HEIGHT * 12)).bench(|| formats::read(&bytes, "", &Limits::default()).unwrap());
}

#[divan::bench(args = ["pfm", "hdr", "exr", "npy", "png"], sample_count = 5)]
fn write(bencher: Bencher<'_, '_>, format: &str) {
    let map = map();
    bencher.counter(BytesCount::new(WIDTH * HEIGHT * 12)).bench(|| formats::encode(&map, format, &[]).unwrap());
}
