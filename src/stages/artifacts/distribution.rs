//! The distribution as an artifact: its parts by bits; densities and CDFs as npz or csv.

use std::io::{self, Read, Write};

use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::formats::npy;
use crate::formats::npz;
use crate::light::distribution::{Distribution, Parts};
use crate::light::envmap::Angles;
use crate::stages::artifacts::canonical::{Decoder, Encoder, invalid};

const VERSION: u32 = 1;

impl Artifact for Distribution {
    const TYPE: TypeName = "distribution";
    const FORMATS: &'static [&'static str] = &["npz", "csv"];

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut encoder = Encoder::new(out, Self::TYPE, VERSION)?;
        encoder.count(self.width() as u64)?;
        encoder.count(self.height() as u64)?;
        encoder.byte(self.angles() as u8)?;
        encoder.byte(u8::from(self.is_uniform()) | u8::from(self.is_compensated()) << 1)?;
        encoder.count(self.negative_count())?;
        encoder.doubles(self.factors())?;
        encoder.singles(self.intensities())?;
        encoder.finish()
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        let mut decoder = Decoder::new(input, Self::TYPE, VERSION)?;
        let (width, height) = (decoder.count()?, decoder.count()?);
        let angles = angles_of(decoder.byte()?)?;
        let flags = decoder.byte()?;
        if flags > 3 {
            return Err(invalid("unknown flags"));
        }
        let (is_uniform, is_compensated) = (flags & 1 != 0, flags & 2 != 0);
        let negative_count = decoder.count()? as u64;
        let pixel_count = width.checked_mul(height).ok_or_else(|| invalid("more pixels than memory can have"))?;
        let factors = decoder.doubles(height)?;
        let intensities = decoder.singles(pixel_count)?;
        decoder.finish()?;
        let parts = Parts { width, height, angles, factors, intensities, negative_count, is_uniform, is_compensated };
        Distribution::from_parts(parts).ok_or_else(|| invalid("weights that are no distribution"))
    }

    fn memory(&self) -> u64 {
        Distribution::memory(self)
    }

    fn save(&self, format: &str, _: &Origin) -> Result<Saved, SaveError> {
        match format {
            "npz" => Ok(npz(self).into()),
            "csv" => Ok(csv(self).into()),
            _ => Err(SaveError(format!("a distribution is not written as `{format}`"))),
        }
    }
}

fn angles_of(byte: u8) -> io::Result<Angles> {
    let all = [Angles::Center, Angles::Edge, Angles::EdgeInclusive];
    all.into_iter().find(|angles| *angles as u8 == byte).ok_or_else(|| invalid("unknown angles"))
}

/// Marginal arrays of a number per row, conditional ones of a number per pixel.
fn npz(distribution: &Distribution) -> Vec<u8> {
    let (width, height) = (distribution.width(), distribution.height());
    let per_row = |value: &dyn Fn(usize) -> f64| npy::write_f64(&[height], &(0..height).map(value).collect::<Vec<_>>());
    let azimuths: Vec<f64> = (0..width).map(|x| distribution.phi(x)).collect();
    let pmf: Vec<f64> = (0..height).flat_map(|y| distribution.conditional_pmf(y)).collect();
    let cdf: Vec<f64> = (0..height).flat_map(|y| distribution.conditional_cdf(y)).collect();
    npz::write(&[
        ("theta", per_row(&|y| distribution.theta(y))),
        ("phi", npy::write_f64(&[width], &azimuths)),
        ("marginal_pmf", per_row(&|y| distribution.marginal_pmf(y))),
        ("marginal_cdf", per_row(&|y| distribution.marginal_cdf(y))),
        ("conditional_pmf", npy::write_f64(&[height, width], &pmf)),
        ("conditional_cdf", npy::write_f64(&[height, width], &cdf)),
        ("solid_angle", per_row(&|y| distribution.solid_angle(y))),
    ])
}

/// One line a pixel.
fn csv(distribution: &Distribution) -> Vec<u8> {
    let mut text = String::from("x,y,marginal_pmf,marginal_cdf,conditional_pmf,conditional_cdf,pmf,pdf\n");
    for y in 0..distribution.height() {
        let row = format!("{:?},{:?}", distribution.marginal_pmf(y), distribution.marginal_cdf(y));
        for (x, (pmf, cdf)) in distribution.conditional_pmf(y).zip(distribution.conditional_cdf(y)).enumerate() {
            let (joint, density) = (distribution.pmf(x, y), distribution.pdf_of_pixel(x, y));
            text.push_str(&format!("{x},{y},{row},{pmf:?},{cdf:?},{joint:?},{density:?}\n"));
        }
    }
    text.into_bytes()
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::image::raster::Raster;
    use crate::light::distribution::Settings;
    use crate::light::envmap::EnvMap;

    fn example() -> Distribution {
        let pixels = (0..35).map(|k| [k as f32, 0.5, -1.0]).collect();
        let mut map = EnvMap::new(Raster::new(7, 5, pixels));
        map.angles = Angles::EdgeInclusive;
        Distribution::build(&map, &Settings::default(), || Ok::<(), Infallible>(())).unwrap()
    }

    #[test]
    fn canonical_bytes_come_back_equal_and_broken_ones_are_refused() {
        let mut bytes = Vec::new();
        example().write(&mut bytes).unwrap();
        assert_eq!(Distribution::read(&mut bytes.as_slice()).unwrap(), example());
        for length in 0..bytes.len() {
            assert_eq!(Distribution::read(&mut &bytes[..length]).unwrap_err().kind(), io::ErrorKind::InvalidData);
        }
        // Every single byte set to 0xff: some value is wrong, or the value is another one; nothing may panic.
        for place in 0..bytes.len() {
            let mut broken = bytes.clone();
            broken[place] = 0xff;
            let _ = Distribution::read(&mut broken.as_slice());
        }
    }

    #[test]
    fn each_line_of_the_csv_holds_densities_that_agree() {
        let saved = example().save("csv", &Origin::default()).unwrap();
        let mut reader = csv::Reader::from_reader(saved.bytes.as_slice());
        let rows: Vec<Vec<f64>> = reader.deserialize().map(|row| row.unwrap()).collect();
        assert_eq!(rows.len(), 35);
        for row in &rows {
            assert!((row[2] * row[4] - row[6]).abs() < 1e-15);
        }
        assert_eq!((rows[34][3], rows[13][5]), (1.0, 1.0));
    }

    #[test]
    fn the_archive_has_every_array() {
        let saved = example().save("npz", &Origin::default()).unwrap();
        let mut archive = zip::ZipArchive::new(io::Cursor::new(saved.bytes)).unwrap();
        let mut bytes = Vec::new();
        archive.by_name("conditional_cdf.npy").unwrap().read_to_end(&mut bytes).unwrap();
        assert_eq!(&bytes[bytes.len() - 8..], 1.0_f64.to_le_bytes());
        assert_eq!(archive.len(), 7);
        assert!(example().save("exr", &Origin::default()).is_err());
    }
}
