//! `film`: what the samples of a render add up to, from which it can be continued, merged and made a picture.
//!
//! Bytes: header, window, block of samples, replicates, refused samples, which channels are not zero everywhere, then
//! those channels one after the other, each by row, column and replicate.

use std::io::{self, Read, Write};

use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::formats::npy;
use crate::formats::npz;
use crate::render::film::sums::{Address, Block, CHANNELS, Film, Refused, Sums, Window};
use crate::stages::artifacts::canonical::{Decoder, Encoder, invalid};

const VERSION: u32 = 1;

/// Names of the channels in an archive.
const NAMES: [&str; CHANNELS] = [
    "color_r", "color_g", "color_b", "square_r", "square_g", "square_b", "albedo_r", "albedo_g", "albedo_b", "normal_x", "normal_y",
    "normal_z", "depth", "coverage",
];

impl Artifact for Film {
    const TYPE: TypeName = "film";
    const FORMATS: &'static [&'static str] = &["npz"];

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut encoder = Encoder::new(out, Self::TYPE, VERSION)?;
        let Window { x0, y0, x1, y1 } = self.window;
        let Block { first, count } = self.block;
        for number in [x0, y0, x1, y1, first, count, self.replicates] {
            encoder.count(number.into())?;
        }
        encoder.count(self.refused.count)?;
        let address = self.refused.first.map(|at| [at.y, at.x, at.replicate, at.index]);
        encoder.byte(address.is_some().into())?;
        for number in address.into_iter().flatten() {
            encoder.count(number.into())?;
        }
        for channel in 0..CHANNELS {
            let is_used = self.is_used(channel);
            encoder.byte(is_used.into())?;
            if is_used {
                encoder.singles(&self.channel(channel))?;
            }
        }
        encoder.finish()
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        let mut decoder = Decoder::new(input, Self::TYPE, VERSION)?;
        let mut numbers = [0; 7];
        for number in &mut numbers {
            *number = small(decoder.count()?)?;
        }
        let [x0, y0, x1, y1, first, block_count, replicates] = numbers;
        if x0 >= x1 || y0 >= y1 || replicates == 0 || first.checked_add(block_count).is_none() {
            return Err(invalid("a window or a block of samples that does not exist"));
        }
        let window = Window { x0, y0, x1, y1 };
        let per_pixel = window.width().checked_mul(window.height()).and_then(|count| count.checked_mul(replicates as usize));
        let sum_count = per_pixel.ok_or_else(|| invalid("more sums than memory can have"))?;
        let count = decoder.count()? as u64;
        let address = match decoder.byte()? {
            0 => None,
            1 => {
                let mut at = [0; 4];
                for number in &mut at {
                    *number = small(decoder.count()?)?;
                }
                Some(Address { y: at[0], x: at[1], replicate: at[2], index: at[3] })
            }
            _ => return Err(invalid("a flag that is neither yes nor no")),
        };
        let mut sums: Vec<Sums> = Vec::new();
        for channel in 0..CHANNELS {
            match decoder.byte()? {
                0 => {}
                1 => {
                    let values = decoder.singles(sum_count)?;
                    sums.resize(sum_count, Sums::default());
                    sums.iter_mut().zip(values).for_each(|(sums, value)| sums.0[channel] = value);
                }
                _ => return Err(invalid("a flag that is neither yes nor no")),
            }
        }
        decoder.finish()?;
        if sums.len() != sum_count {
            return Err(invalid("a film without its first channel"));
        }
        let block = Block { first, count: block_count };
        Ok(Self { window, block, replicates, sums, refused: Refused { count, first: address } })
    }

    fn memory(&self) -> u64 {
        size_of_val(self.sums.as_slice()) as u64
    }

    fn save(&self, format: &str, _: &Origin) -> Result<Saved, SaveError> {
        if format != "npz" {
            return Err(SaveError(format!("a film is not written as `{format}`")));
        }
        let shape = [self.window.height(), self.window.width(), self.replicates as usize];
        let used = (0..CHANNELS).filter(|channel| self.is_used(*channel));
        let samples = npy::write_f64(&[2], &[f64::from(self.block.first), f64::from(self.block.count)]);
        let arrays: Vec<(&str, Vec<u8>)> = used.map(|channel| (NAMES[channel], npy::write_f32(&shape, &self.channel(channel)))).collect();
        Ok(npz::write(&[vec![("samples", samples)], arrays].concat()).into())
    }
}

impl Film {
    /// The first channel always is, so that the length of the bytes shows how many sums there are.
    fn is_used(&self, channel: usize) -> bool {
        channel == 0 || self.sums.iter().any(|sums| sums.0[channel].to_bits() != 0)
    }

    fn channel(&self, channel: usize) -> Vec<f32> {
        self.sums.iter().map(|sums| sums.0[channel]).collect()
    }
}

fn small(number: usize) -> io::Result<u32> {
    u32::try_from(number).map_err(|_| invalid("a number of a film is too large"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film() -> Film {
        let sums = (0..12)
            .map(|place| {
                let mut sums = Sums::default();
                sums.0[0] = place as f32 - 0.5;
                sums.0[13] = -0.0;
                sums
            })
            .collect();
        let first = Some(Address { y: 1, x: 2, replicate: 0, index: 7 });
        let window = Window { x0: 1, y0: 2, x1: 4, y1: 4 };
        Film { window, block: Block { first: 8, count: 8 }, replicates: 2, sums, refused: Refused { count: 3, first } }
    }

    #[test]
    fn a_film_comes_back_and_bytes_cut_anywhere_are_refused() {
        let mut bytes = Vec::new();
        film().write(&mut bytes).unwrap();
        let read = Film::read(&mut bytes.as_slice()).unwrap();
        assert_eq!(read, film());
        assert_eq!(read.sums[3].0[13].to_bits(), (-0.0_f32).to_bits());
        assert!((0..bytes.len()).all(|end| Film::read(&mut &bytes[..end]).is_err()));
        for place in 0..bytes.len() {
            let mut broken = bytes.clone();
            broken[place] = 0xff;
            let _ = Film::read(&mut broken.as_slice());
        }
    }

    #[test]
    fn an_archive_has_the_channels_that_are_used() {
        let saved = film().save("npz", &Origin::default()).unwrap();
        let mut archive = zip::ZipArchive::new(io::Cursor::new(saved.bytes)).unwrap();
        let has = ["color_r.npy", "coverage.npy", "samples.npy"].map(|name| archive.by_name(name).is_ok());
        assert_eq!((archive.len(), has), (3, [true; 3]));
        assert!(film().save("exr", &Origin::default()).is_err());
    }
}
