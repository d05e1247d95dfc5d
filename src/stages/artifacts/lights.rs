//! Lights: canonical bytes, JSON, CSV and the rigs of other programs.
//!
//! Canonical form, little endian: `PLLIGHT1`, width and height of the map (u32), number of lights (u64); then for
//! each light x0 y0 x1 y1 (u32) and position x y, direction x y z, irradiance r g b, solid angle, energy (f64).

use std::io::{self, Read, Write};

use glam::DVec3;
use serde_json::{Map, Value, json};

use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::figure::table::{Cell, Column, Table};
use crate::light::lights::{Light, LightSet, Region};
use crate::light::rigs::{Rig, blender, gltf, mitsuba, pbrt, usda};

const MAGIC: &[u8; 8] = b"PLLIGHT1";

/// Four u32 and ten f64.
const LIGHT_BYTES: usize = 4 * 4 + 10 * 8;

/// Lights that are allocated for before the input has shown that it holds them.
const TRUSTED_COUNT: u64 = 1024;

impl Artifact for LightSet {
    const TYPE: TypeName = "lights";
    const FORMATS: &'static [&'static str] = &["json", "csv", "gltf", "usda", "pbrt", "mitsuba", "blender"];

    fn extension(format: &str) -> &str {
        match format {
            "mitsuba" => "xml",
            "blender" => "py",
            other => other,
        }
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(MAGIC)?;
        out.write_all(&self.map_width.to_le_bytes())?;
        out.write_all(&self.map_height.to_le_bytes())?;
        out.write_all(&(self.lights.len() as u64).to_le_bytes())?;
        self.lights.iter().try_for_each(|light| out.write_all(&bytes(light)))
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        if &taken::<8>(input)? != MAGIC {
            return Err(invalid("these are not lights of version 1"));
        }
        let map_width = u32::from_le_bytes(taken(input)?);
        let map_height = u32::from_le_bytes(taken(input)?);
        let count = u64::from_le_bytes(taken(input)?);
        let mut lights = Vec::with_capacity(count.min(TRUSTED_COUNT) as usize);
        for _ in 0..count {
            lights.push(light(&taken(input)?));
        }
        if input.read(&mut [0])? != 0 {
            return Err(invalid("there are bytes after the last light"));
        }
        Ok(Self { map_width, map_height, lights })
    }

    fn memory(&self) -> u64 {
        (size_of::<Self>() + self.lights.capacity() * size_of::<Light>()) as u64
    }

    fn save(&self, format: &str, origin: &Origin) -> Result<Saved, SaveError> {
        match format {
            "json" => Ok(json_text(self).into_bytes().into()),
            "csv" => csv_text(&rows(self)).map(Saved::from),
            "gltf" => rig(self, origin, gltf::text),
            "usda" => rig(self, origin, usda::text),
            "pbrt" => rig(self, origin, pbrt::text),
            "mitsuba" => rig(self, origin, mitsuba::text),
            "blender" => rig(self, origin, blender::text),
            other => Err(SaveError(format!("lights cannot be saved as `{other}`; choose one of `{}`", Self::FORMATS.join("`, `")))),
        }
    }
}

/// The lights for another program; says by which stage of which pipeline they were made.
fn rig(set: &LightSet, origin: &Origin, text: fn(&Rig, &str) -> String) -> Result<Saved, SaveError> {
    let rig = Rig::of(set).map_err(|error| SaveError(error.to_string()))?;
    let coordinate = if origin.coordinate.is_empty() { String::new() } else { format!("[{}]", printable(&origin.coordinate)) };
    let made_by = format!("pipeline {}, stage {}{coordinate}, key {}", printable(&origin.pipeline), printable(&origin.stage), origin.key);
    Ok(Saved { bytes: text(&rig, &made_by).into_bytes(), warnings: rig.warnings() })
}

/// Text that may stand in a comment or between quotation marks of any of the formats: values of axes are anything.
fn printable(text: &str) -> String {
    let is_plain = |character: char| character.is_ascii_graphic() && !matches!(character, '"' | '\\' | '<' | '>' | '`');
    text.chars().map(|character| if is_plain(character) || character == ' ' { character } else { '_' }).collect()
}

/// Name and unit of each column, in the order of [`cells`].
const COLUMNS: [(&str, &str); 14] = [
    ("x0", "px"),
    ("y0", "px"),
    ("x1", "px"),
    ("y1", "px"),
    ("x", "px"),
    ("y", "px"),
    ("dx", ""),
    ("dy", ""),
    ("dz", ""),
    ("r", "W/m2"),
    ("g", "W/m2"),
    ("b", "W/m2"),
    ("solid_angle", "sr"),
    ("energy", ""),
];

/// The lights as a table, one row each: region (half open), position, direction, irradiance, solid angle, energy.
pub fn rows(lights: &LightSet) -> Table {
    let mut table = Table::new(COLUMNS.map(|(name, unit)| Column::new(name, unit)).to_vec());
    lights.lights.iter().for_each(|light| table.push(cells(light).to_vec()));
    table
}

fn cells(light: &Light) -> [Cell; 14] {
    let Region { x0, y0, x1, y1 } = light.region;
    let [a, b, c, d] = [x0, y0, x1, y1].map(|edge| Cell::Integer(i128::from(edge)));
    let [e, f, g, h, i, j, k, l, m, n] = numbers(light).map(Cell::Number);
    [a, b, c, d, e, f, g, h, i, j, k, l, m, n]
}

/// Position, direction, irradiance, solid angle, energy.
fn numbers(light: &Light) -> [f64; 10] {
    let Light { x, y, direction: d, irradiance: [r, g, b], solid_angle, energy, .. } = *light;
    [x, y, d.x, d.y, d.z, r, g, b, solid_angle, energy]
}

fn bytes(light: &Light) -> [u8; LIGHT_BYTES] {
    let Region { x0, y0, x1, y1 } = light.region;
    let mut bytes = [0; LIGHT_BYTES];
    let (edges, rest) = bytes.split_at_mut(16);
    edges.chunks_exact_mut(4).zip([x0, y0, x1, y1]).for_each(|(bytes, edge)| bytes.copy_from_slice(&edge.to_le_bytes()));
    rest.chunks_exact_mut(8).zip(numbers(light)).for_each(|(bytes, number)| bytes.copy_from_slice(&number.to_le_bytes()));
    bytes
}

fn light(bytes: &[u8; LIGHT_BYTES]) -> Light {
    let edge = |index: usize| u32::from_le_bytes(std::array::from_fn(|byte| bytes[4 * index + byte]));
    let number = |index: usize| f64::from_le_bytes(std::array::from_fn(|byte| bytes[16 + 8 * index + byte]));
    Light {
        region: Region { x0: edge(0), y0: edge(1), x1: edge(2), y1: edge(3) },
        x: number(0),
        y: number(1),
        direction: DVec3::new(number(2), number(3), number(4)),
        irradiance: [number(5), number(6), number(7)],
        solid_angle: number(8),
        energy: number(9),
    }
}

fn taken<const N: usize>(input: &mut dyn Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    input.read_exact(&mut bytes).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => invalid("the lights end early"),
        _ => error,
    })?;
    Ok(bytes)
}

fn invalid(message: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

/// `{ "units": …, "map": …, "lights": [...] }`, one light a line.
fn json_text(set: &LightSet) -> String {
    let units = json!({
        "position": "pixels from the upper left corner of the map",
        "direction": "unit vector from the scene towards the light; +y up, azimuth from +x towards +z",
        "irradiance": "linear Rec.709 RGB on a surface that faces the light, radiance of the map times steradian",
        "solid_angle": "steradian",
        "energy": "what the cut balanced, in the measure of its variant",
    });
    let map = json!({ "width": set.map_width, "height": set.map_height });
    let lights: Vec<String> = set.lights.iter().map(|light| format!("    {}", json_of(light))).collect();
    format!("{{\n  \"units\": {units},\n  \"map\": {map},\n  \"lights\": [\n{}\n  ]\n}}\n", lights.join(",\n"))
}

fn json_of(light: &Light) -> Value {
    let Region { x0, y0, x1, y1 } = light.region;
    let mut fields = Map::new();
    fields.insert("region".into(), json!({ "x0": x0, "y0": y0, "x1": x1, "y1": y1 }));
    fields.insert("position".into(), json!([light.x, light.y]));
    fields.insert("direction".into(), json!(light.direction.to_array()));
    fields.insert("irradiance".into(), json!(light.irradiance));
    fields.insert("solid_angle".into(), json!(light.solid_angle));
    fields.insert("energy".into(), json!(light.energy));
    fields.into()
}

/// A header of names, then one line per light; numbers in their shortest round-trip form.
fn csv_text(table: &Table) -> Result<Vec<u8>, SaveError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let text = |cell: &Cell| match cell {
        Cell::Integer(value) => value.to_string(),
        Cell::Number(value) => format!("{value:?}"),
        Cell::Empty | Cell::Boolean(_) | Cell::Text(_) => unreachable!("lights are numbers"),
    };
    let refused = |error: csv::Error| SaveError(error.to_string());
    writer.write_record(table.columns.iter().map(|column| &column.name)).map_err(refused)?;
    for row in &table.rows {
        writer.write_record(row.iter().map(text)).map_err(refused)?;
    }
    writer.into_inner().map_err(|error| SaveError(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> LightSet {
        let light = |x0: u32| Light {
            region: Region { x0, y0: 1, x1: x0 + 2, y1: 3 },
            x: f64::from(x0) + 0.1,
            y: 2.0,
            direction: DVec3::new(0.6, 0.0, -0.8),
            irradiance: [1.0, 1e-30, 3.25],
            solid_angle: 0.1,
            energy: 1.0 / 3.0,
        };
        LightSet { map_width: 8, map_height: 4, lights: vec![light(0), light(5)] }
    }

    fn written(set: &LightSet) -> Vec<u8> {
        let mut bytes = Vec::new();
        set.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn lights_survive_their_canonical_form() {
        let bytes = written(&example());
        assert_eq!(bytes.len(), 24 + 2 * LIGHT_BYTES);
        assert_eq!(LightSet::read(&mut bytes.as_slice()).unwrap(), example());
    }

    #[test]
    fn short_long_and_foreign_bytes_are_refused() {
        let bytes = written(&example());
        let kind = |bytes: &[u8]| LightSet::read(&mut { bytes }).unwrap_err().kind();
        for length in 0..bytes.len() {
            assert_eq!(kind(&bytes[..length]), io::ErrorKind::InvalidData);
        }
        assert_eq!(kind(&[bytes.clone(), vec![0]].concat()), io::ErrorKind::InvalidData);
        let mut foreign = bytes.clone();
        foreign[7] = b'2';
        assert_eq!(kind(&foreign), io::ErrorKind::InvalidData);
        // A count that the input does not hold must not be allocated for.
        let mut boastful = bytes;
        boastful[16..24].copy_from_slice(&u64::MAX.to_le_bytes());
        assert_eq!(kind(&boastful), io::ErrorKind::InvalidData);
    }

    #[test]
    fn rigs_name_their_origin_and_have_the_extensions_of_their_programs() {
        let origin = Origin { pipeline: "p".into(), stage: "cut".into(), coordinate: "map=a\"--\n>b".into(), key: "00ff".into() };
        for format in ["gltf", "usda", "pbrt", "mitsuba", "blender"] {
            let text = String::from_utf8(example().save(format, &origin).unwrap().bytes).unwrap();
            assert!(text.contains("pipeline p, stage cut[map=a_"), "{format}: {text}");
            assert!(text.contains("2 directional lights of a 8 x 4 lat-long map"), "{format}");
        }
        assert_eq!(["gltf", "mitsuba", "blender"].map(LightSet::extension), ["gltf", "xml", "py"]);
    }

    #[test]
    fn lights_that_other_programs_cannot_take_are_refused() {
        let mut set = example();
        set.lights[1].irradiance[2] = f64::INFINITY;
        assert!(set.save("gltf", &Origin::default()).unwrap_err().to_string().contains("light 1"));
        assert!(set.save("json", &Origin::default()).is_ok());
    }

    #[test]
    fn json_holds_every_light_with_exact_numbers() {
        let saved = example().save("json", &Origin::default()).unwrap();
        let value: Value = serde_json::from_slice(&saved.bytes).unwrap();
        assert_eq!(value["lights"].as_array().unwrap().len(), 2);
        assert_eq!(value["lights"][1]["region"]["x1"], 7);
        assert_eq!(value["lights"][0]["energy"].as_f64(), Some(1.0 / 3.0));
        assert_eq!(value["map"]["width"], 8);
        assert!(value["units"]["irradiance"].is_string());
    }

    #[test]
    fn csv_has_one_line_per_light() {
        let saved = example().save("csv", &Origin::default()).unwrap();
        let text = String::from_utf8(saved.bytes).unwrap();
        let expected = "x0,y0,x1,y1,x,y,dx,dy,dz,r,g,b,solid_angle,energy\n\
            0,1,2,3,0.1,2.0,0.6,0.0,-0.8,1.0,1e-30,3.25,0.1,0.3333333333333333\n\
            5,1,7,3,5.1,2.0,0.6,0.0,-0.8,1.0,1e-30,3.25,0.1,0.3333333333333333\n";
        assert_eq!(text, expected);
        assert!(example().save("png", &Origin::default()).is_err());
    }
}
