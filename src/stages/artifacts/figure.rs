//! Figures between stages: the description of a chart; drawn only when it is saved.
//!
//! Canonical form: `pipeline figure 1\n`, then JSON with every number in its shortest form that reads back equal.

use std::io::{self, Read, Write};

use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::figure::chart::Chart;
use crate::formats::ENTRY_PREFIX;

const HEADER: &[u8] = b"pipeline figure 1\n";

impl Artifact for Chart {
    const TYPE: TypeName = "figure";
    const FORMATS: &'static [&'static str] = &["svg", "png", "pdf"];
    const ENCODER_VERSION: u32 = 3;

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(HEADER)?;
        serde_json::to_writer(out, self).map_err(io::Error::from)
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        let mut bytes = Vec::new();
        input.read_to_end(&mut bytes)?;
        let text = bytes.strip_prefix(HEADER).ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "not a figure"))?;
        serde_json::from_slice(text).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
    }

    fn memory(&self) -> u64 {
        let points: usize = self.curves.iter().map(|curve| size_of_val(curve.points.as_slice())).sum();
        let heat = self.heat.as_ref().map_or(0, |heat| size_of_val(heat.values.as_slice()));
        (size_of::<Self>() + size_of_val(self.curves.as_slice()) + points + heat) as u64
    }

    fn save(&self, format: &str, origin: &Origin) -> Result<Saved, SaveError> {
        let entries = origin.entries();
        match format {
            "svg" => Ok(self.to_svg(&entries).into()),
            "png" => {
                // As the pictures name them, so that one reader finds both.
                let named = entries.map(|(name, text)| (format!("{ENTRY_PREFIX}{name}"), text));
                Ok(self.to_png(&named.each_ref().map(|(name, text)| (name.as_str(), *text))).into())
            }
            "pdf" => Ok(self.to_pdf(&entries).into()),
            _ => Err(SaveError(format!("a figure cannot be written as `{format}`"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::chart::{Axis, Curve, Guide, GuideAxis, IntervalLook, Look, Point, Scale};

    fn chart() -> Chart {
        let axis =
            |label: &str| Axis { label: label.into(), unit: "deg".into(), scale: Scale::Linear, range: None, categories: Vec::new() };
        let points = (0..5).map(|k| Point::single(f64::from(k) / 3.0, 0.1 * f64::from(k))).collect();
        let curve =
            Curve { label: "<a & b>".into(), look: Look::Line, hue: 0, dash: 0, points, interval: IntervalLook::Whiskers, fit: None };
        Chart {
            title: "title <&>".into(),
            size_mm: [80.0, 60.0],
            x: axis("x"),
            y: axis("y"),
            curves: vec![curve.clone(), curve],
            guides: vec![Guide { axis: GuideAxis::X, at: 1.0 / 3.0, label: "third".into() }],
            heat: None,
            notes: vec!["note".into()],
        }
    }

    fn written(chart: &Chart) -> Vec<u8> {
        let mut bytes = Vec::new();
        chart.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn the_canonical_form_reads_back_equal() {
        let bytes = written(&chart());
        let read = Chart::read(&mut bytes.as_slice()).unwrap();
        assert_eq!(read, chart());
        assert_eq!(written(&read), bytes);
    }

    #[test]
    fn bytes_that_are_no_figure_are_refused() {
        let bytes = written(&chart());
        for wrong in [&bytes[..10], &bytes[..bytes.len() - 1], &bytes[1..]] {
            assert_eq!(Chart::read(&mut &*wrong).unwrap_err().kind(), io::ErrorKind::InvalidData);
        }
    }

    #[test]
    fn every_format_says_where_the_figure_comes_from_and_is_made_again_equal() {
        let origin = Origin { pipeline: "coursework".into(), stage: "curve".into(), coordinate: "n=64".into(), key: "0123abcd".into() };
        for format in Chart::FORMATS {
            let bytes = chart().save(format, &origin).unwrap().bytes;
            assert_eq!(bytes, chart().save(format, &origin).unwrap().bytes, "{format}");
            let holds = |text: &str| bytes.windows(text.len()).any(|window| window == text.as_bytes());
            assert!(holds("0123abcd") && holds("n=64") && holds("coursework"), "{format}");
        }
        assert!(chart().save("gif", &origin).is_err());
    }
}
