//! Sets of samples as an artifact: columns by bits; csv and npy for others.

use std::io::{self, Read, Write};

use glam::DVec3;

use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::formats::npy;
use crate::light::samples::{Frame, Sample, SampleSet};
use crate::stages::artifacts::canonical::{Decoder, Encoder, invalid};

const VERSION: u32 = 1;

/// x, y; u, v, direction, pmf, pdf; whether there is a radiance, and that.
const SAMPLE_BYTES: usize = 2 * 4 + 7 * 8 + 1 + 3 * 4;

impl Artifact for SampleSet {
    const TYPE: TypeName = "samples";
    const FORMATS: &'static [&'static str] = &["csv", "npy"];

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut encoder = Encoder::new(out, Self::TYPE, VERSION)?;
        encoder.put(&self.map_width.to_le_bytes())?;
        encoder.put(&self.map_height.to_le_bytes())?;
        encoder.byte(u8::from(self.frame == Frame::Normal))?;
        encoder.count(self.samples.len() as u64)?;
        self.samples.iter().try_for_each(|sample| encoder.put(&bytes_of(sample)))?;
        encoder.finish()
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        let mut decoder = Decoder::new(input, Self::TYPE, VERSION)?;
        let map_width = u32::from_le_bytes(decoder.take()?);
        let map_height = u32::from_le_bytes(decoder.take()?);
        let frame = match decoder.byte()? {
            0 => Frame::World,
            1 => Frame::Normal,
            _ => return Err(invalid("unknown frame")),
        };
        let count = decoder.count()?;
        let samples = decoder.list(count, sample_of)?;
        decoder.finish()?;
        // Users index the map by these positions.
        let is_outside = |sample: &Sample| map_width > 0 && (sample.x >= map_width || sample.y >= map_height);
        if samples.iter().any(is_outside) {
            return Err(invalid("a sample outside its map"));
        }
        Ok(Self { map_width, map_height, frame, samples })
    }

    fn memory(&self) -> u64 {
        (self.samples.len() * size_of::<Sample>()) as u64
    }

    fn save(&self, format: &str, _: &Origin) -> Result<Saved, SaveError> {
        match format {
            "csv" => Ok(csv(self).into()),
            "npy" => Ok(npy(self).into()),
            _ => Err(SaveError(format!("samples are not written as `{format}`"))),
        }
    }
}

fn bytes_of(sample: &Sample) -> [u8; SAMPLE_BYTES] {
    let Sample { x, y, u, v, direction, pmf, pdf, radiance } = *sample;
    let mut bytes = [0; SAMPLE_BYTES];
    bytes[0..4].copy_from_slice(&x.to_le_bytes());
    bytes[4..8].copy_from_slice(&y.to_le_bytes());
    for (place, value) in bytes[8..64].chunks_exact_mut(8).zip([u, v, direction.x, direction.y, direction.z, pmf, pdf]) {
        place.copy_from_slice(&value.to_le_bytes());
    }
    bytes[64] = u8::from(radiance.is_some());
    for (place, value) in bytes[65..].chunks_exact_mut(4).zip(radiance.unwrap_or_default()) {
        place.copy_from_slice(&value.to_le_bytes());
    }
    bytes
}

fn sample_of(bytes: [u8; SAMPLE_BYTES]) -> Sample {
    let whole = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    let double = |k: usize| f64::from_le_bytes(bytes[8 + 8 * k..16 + 8 * k].try_into().expect("eight bytes"));
    let single = |k: usize| f32::from_bits(whole(65 + 4 * k));
    Sample {
        x: whole(0),
        y: whole(4),
        u: double(0),
        v: double(1),
        direction: DVec3::new(double(2), double(3), double(4)),
        pmf: double(5),
        pdf: double(6),
        radiance: (bytes[64] != 0).then(|| [single(0), single(1), single(2)]),
    }
}

/// Whether radiances are columns of the outside forms: every sample has one.
fn has_radiance(set: &SampleSet) -> bool {
    !set.samples.is_empty() && set.samples.iter().all(|sample| sample.radiance.is_some())
}

/// One line a sample; numbers in the shortest form that reads back as the same value.
fn csv(set: &SampleSet) -> Vec<u8> {
    let has_radiance = has_radiance(set);
    let mut text = String::from(if has_radiance { "x,y,u,v,dx,dy,dz,pmf,pdf,r,g,b\n" } else { "x,y,u,v,dx,dy,dz,pmf,pdf\n" });
    for sample in &set.samples {
        let Sample { x, y, u, v, direction: d, pmf, pdf, .. } = sample;
        text.push_str(&format!("{x},{y},{u:?},{v:?},{:?},{:?},{:?},{pmf:?},{pdf:?}", d.x, d.y, d.z));
        if let (true, Some([r, g, b])) = (has_radiance, sample.radiance) {
            text.push_str(&format!(",{r:?},{g:?},{b:?}"));
        }
        text.push('\n');
    }
    text.into_bytes()
}

/// One row a sample, with the columns of the csv.
fn npy(set: &SampleSet) -> Vec<u8> {
    let column_count = if has_radiance(set) { 12 } else { 9 };
    let numbers = set.samples.iter().flat_map(|sample| {
        let Sample { x, y, u, v, direction: d, pmf, pdf, radiance } = *sample;
        let [r, g, b] = radiance.unwrap_or_default().map(f64::from);
        [f64::from(x), f64::from(y), u, v, d.x, d.y, d.z, pmf, pdf, r, g, b].into_iter().take(column_count)
    });
    npy::write_f64(&[set.samples.len(), column_count], &numbers.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example(radiance: Option<[f32; 3]>) -> SampleSet {
        let sample = Sample { x: 3, y: 1, u: 0.1, v: 0.7, direction: DVec3::new(0.6, -0.8, 0.0), pmf: 1e-9, pdf: 0.25, radiance };
        let other = Sample { x: 0, pmf: -0.0, ..sample };
        SampleSet { map_width: 4, map_height: 2, frame: Frame::World, samples: vec![sample, other] }
    }

    fn bytes(set: &SampleSet) -> Vec<u8> {
        let mut bytes = Vec::new();
        set.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn canonical_bytes_come_back_equal_and_broken_ones_are_refused() {
        let mut partly = example(None);
        partly.samples[1].radiance = Some([1.0, 2.0, 3.0]);
        partly.frame = Frame::Normal;
        for set in [example(None), example(Some([0.5, 1e-20, 7.0])), partly] {
            assert_eq!(SampleSet::read(&mut bytes(&set).as_slice()).unwrap(), set);
            assert_eq!(bytes(&SampleSet::read(&mut bytes(&set).as_slice()).unwrap()), bytes(&set));
        }
        let whole = bytes(&example(None));
        for length in 0..whole.len() {
            assert_eq!(SampleSet::read(&mut &whole[..length]).unwrap_err().kind(), io::ErrorKind::InvalidData);
        }
        let outside = SampleSet { map_width: 3, ..example(None) };
        assert!(SampleSet::read(&mut bytes(&outside).as_slice()).is_err());
    }

    #[test]
    fn the_csv_has_radiance_columns_only_where_there_is_radiance() {
        let text = |set: &SampleSet| String::from_utf8(set.save("csv", &Origin::default()).unwrap().bytes).unwrap();
        let first = "3,1,0.1,0.7,0.6,-0.8,0.0,1e-9,0.25";
        assert_eq!(text(&example(None)).lines().take(2).collect::<Vec<_>>(), ["x,y,u,v,dx,dy,dz,pmf,pdf", first]);
        let lit = text(&example(Some([0.1, 2.0, 1e9])));
        assert!(lit.starts_with("x,y,u,v,dx,dy,dz,pmf,pdf,r,g,b\n"));
        assert_eq!(lit.lines().nth(1).unwrap(), format!("{first},0.1,2.0,1000000000.0"));
    }

    #[test]
    fn the_array_has_a_row_a_sample() {
        let saved = example(None).save("npy", &Origin::default()).unwrap();
        assert!(String::from_utf8_lossy(&saved.bytes[..128]).contains("(2, 9)"));
        assert_eq!(saved.bytes.len() % 64, 2 * 9 * 8 % 64);
    }
}
