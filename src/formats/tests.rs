//! Laws that every row of `FORMATS` keeps.

use proptest::prelude::*;

use super::*;
use crate::image::raster::PictureSamples;

/// An image that every linear format holds exactly: powers of two by small whole numbers, no alpha, no layers.
fn sample_image(width: usize, height: usize) -> Image {
    let pixel = |index: usize| [1.0 + (index % 7) as f32, 0.5 * (index % 5) as f32, (index % 3) as f32];
    Image::opaque(Raster::new(width, height, (0..width * height).map(pixel).collect()))
}

fn sample_picture() -> Picture {
    let samples = PictureSamples::Eight((0..60).map(|index| [index, 255 - index, 7]).collect());
    Picture { width: 12, height: 5, samples, alpha: None }
}

/// Each format's bytes of the samples.
fn written(format: &Format) -> Vec<Vec<u8>> {
    let linear = (format.write)(&sample_image(12, 5), &[("stage", "s")]).unwrap().0;
    let picture = format.write_picture.map(|write| write(&sample_picture(), &[("stage", "s")]).unwrap().0);
    [linear].into_iter().chain(picture).collect()
}

#[test]
fn every_format_reads_what_it_writes() {
    for format in FORMATS {
        let name = format!("sample.{}", format.extensions[0]);
        if let Some(write) = format.write_picture {
            let decoded = read(&write(&sample_picture(), &[]).unwrap().0, &name, &Limits::default()).unwrap();
            assert_eq!(decoded.content, Content::Display(sample_picture()), "{}", format.name);
            assert_eq!(decoded.warnings, [""; 0], "{}", format.name);
        } else {
            for (width, height) in [(12, 5), (1, 1), (7, 40)] {
                let image = sample_image(width, height);
                let decoded = read(&(format.write)(&image, &[]).unwrap().0, &name, &Limits::default()).unwrap();
                assert_eq!(decoded.content, Content::Linear(image), "{}", format.name);
                assert_eq!((decoded.format, decoded.warnings), (format.name, vec![]));
            }
        }
    }
}

#[test]
fn a_file_cut_anywhere_is_an_error() {
    for format in FORMATS {
        for bytes in written(format) {
            let step = (bytes.len() / 200).max(1);
            for end in (0..bytes.len()).step_by(step) {
                // What follows the pixels of a PNG is no part of the picture.
                let is_complete = format.name == "png" && end + 12 >= bytes.len();
                assert!(is_complete || read(&bytes[..end], "cut", &Limits::default()).is_err(), "{} cut at {end}", format.name);
            }
        }
    }
}

#[test]
fn a_file_with_a_flipped_byte_never_panics() {
    for format in FORMATS {
        for original in written(format) {
            for index in 0..original.len().min(2000) {
                for flipped in [original[index] ^ 1, original[index] ^ 0x80, 0, 0xff] {
                    let mut bytes = original.clone();
                    bytes[index] = flipped;
                    let _ = read(&bytes, "flipped", &Limits { side: 4096, bytes: 1 << 24 });
                    let _ = origin(&bytes);
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_after_a_true_beginning_never_panic(
        row in 0..FORMATS.len(), kept in 2usize..120, noise in prop::collection::vec(any::<u8>(), 0..300),
    ) {
        for mut bytes in written(&FORMATS[row]) {
            bytes.truncate(kept);
            bytes.extend(&noise);
            let _ = read(&bytes, "noise", &Limits { side: 4096, bytes: 1 << 24 });
        }
    }

    #[test]
    fn any_floats_survive_the_exact_formats(
        width in 1usize..20, values in prop::collection::vec(any::<[u32; 3]>(), 1..60),
    ) {
        let pixels: Vec<_> = values.iter().map(|bits| bits.map(f32::from_bits)).collect();
        let height = pixels.len().div_ceil(width);
        let pixels = pixels.iter().copied().cycle().take(width * height).collect();
        let image = Image::opaque(Raster::new(width, height, pixels));
        for name in ["pfm", "exr", "npy"] {
            let decoded = read(&encode(&image, name, &[]).unwrap().0, "", &Limits::default()).unwrap();
            let Content::Linear(found) = decoded.content else { panic!("{name} is linear") };
            let bits = |image: &Image| image.color.pixels().iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(bits(&found), bits(&image));
        }
    }
}

#[test]
fn the_reader_is_chosen_by_content_and_a_wrong_name_is_noted() {
    let bytes = encode(&sample_image(4, 3), "exr", &[]).unwrap().0;
    let decoded = read(&bytes, "folder/map.HDR", &Limits::default()).unwrap();
    assert_eq!(decoded.format, "exr");
    assert_eq!(decoded.warnings, ["the content is of the format OpenEXR, although the name ends in `.HDR`"]);
    assert!(read(&bytes, "map.exr", &Limits::default()).unwrap().warnings.is_empty());
}

#[test]
fn entries_go_into_png_and_exr_and_nowhere_else() {
    let entries = [("pipeline", "p"), ("stage", "sphere")];
    for format in FORMATS {
        let bytes = (format.write)(&sample_image(4, 3), &entries).unwrap().0;
        let expected = if ["png", "exr"].contains(&format.name) { 2 } else { 0 };
        assert_eq!(origin(&bytes).len(), expected, "{}", format.name);
    }
}

#[test]
fn odd_pixels_are_counted_from_the_top_left() {
    let mut raster = Raster::filled(4, 3, [1.0; 3]);
    for (x, y, value) in [(3, 0, -1.0), (1, 2, f32::NAN), (2, 1, f32::INFINITY), (0, 2, -0.0)] {
        raster.set_pixel(x, y, [1.0, value, 1.0]);
    }
    let found = survey(&raster);
    assert_eq!(found.non_finite, Some(Found { count: 2, first: (2, 1) }));
    assert_eq!(found.negative, Some(Found { count: 1, first: (3, 0) }));
    let expected = ["2 pixels are not finite (NaN or infinite), the first at (2, 1)", "1 pixel is negative, at (3, 0)"];
    assert_eq!(found.warnings(), expected);
}

#[test]
fn a_message_shows_nothing_that_acts_on_a_terminal() {
    let shown = escaped("a\u{1b}[31m\u{202e}`é\n");
    assert_eq!(shown, "a\\u{1b}[31m\\u{202e}'é\\n");
}
