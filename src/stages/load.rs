//! `load`: a file, or a synthetic map by name, as a map, an image or a mesh.
//!
//! Values first (`apply_scale`, `sanitize`, `clamp`, `exposure_stops`), then geometry (`flip`,
//! `rotate_degrees`, `resize`). Knows no format; see `formats`.

use std::borrow::Cow;
use std::ffi::OsStr;

use rayon::prelude::*;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::catalogue;
use crate::engine::artifact::{AnyArtifact, Artifact, TypeName};
use crate::engine::job::Job;
use crate::engine::parameter::InputFile;
use crate::engine::stage::{InputSizes, InputTypes, Mistake, ResultDeclaration, Stage, StageError};
use crate::formats::{self, Content, Decoded, Limits};
use crate::image::display;
use crate::image::filter::{self, Rows};
use crate::image::raster::{Image, Layer, Plane, Raster};
use crate::light::envmap::{Angles, EnvMap};
use crate::light::synthesis::{self, Synthetic};
use crate::math::elementary;
use crate::render::mesh::{self, Mesh};
use crate::render::shape::generated;

/// Reads an environment map or an image: PFM, Radiance HDR, OpenEXR, NPY, and for images PNG and PPM; or a mesh: OBJ,
/// PLY, glTF, GLB.
///
/// The format is told from the content. Non-finite and negative pixels are counted and reported.
///
/// ```yaml
/// env: { load: { path: sky.exr, rotate_degrees: 90 } }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// The file, relative to the pipeline file; or `synthetic:NAME` for a map of the kind `synthesize` or a generated mesh
    /// (`blob`, `knot`, `icosphere`, `uv-sphere`, `torus`) with default parameters.
    pub path: InputFile,
    /// What the file is read as; by default what the stages that use it ask for, else a map.
    #[serde(default)]
    pub r#as: Option<LoadAs>,
    /// Largest value of a channel, in the units of the file; what is brighter is cut, which loses light.
    /// By default nothing is cut. The second report's maps are cut at 1.
    #[serde(default)]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub clamp: Option<f64>,
    /// Turns a map about +y, right-handed: what was at direction d is then at R_y(a) d. Parts of a pixel are shared by
    /// neighbors exactly.
    #[serde(default)]
    #[schemars(extend("x-unit" = "degrees"))]
    pub rotate_degrees: f64,
    /// Mirrors the pixels, for maps that are stored upside down or as seen from outside.
    #[serde(default)]
    pub flip: Flip,
    /// New size in pixels, `[width, height]` or the width alone (then a map is half as high, and an image keeps its shape).
    /// A map keeps the light of every direction exactly; an image is averaged where it shrinks and interpolated where it
    /// grows. By default the size of the file.
    #[serde(default)]
    pub resize: Option<Resize>,
    /// Multiplies by two to this power.
    #[serde(default)]
    #[schemars(range(min = -64.0, max = 64.0), extend("x-unit" = "stops"))]
    pub exposure_stops: f64,
    /// What to do with pixels that are not finite, or negative.
    #[serde(default)]
    pub sanitize: Sanitize,
    /// Which direction a pixel of a map stands for.
    #[serde(default)]
    pub angles: Angles,
    /// Multiplies by the unit factor that a PFM header gives (the absolute value of its scale), which few writers mean.
    #[serde(default)]
    pub apply_scale: bool,
    /// Files in which a glTF file keeps its numbers, found by their names. A GLB and data URIs need none.
    #[serde(default)]
    pub buffers: Vec<InputFile>,
    /// Scales and moves a mesh so that its longest side has this length and it stands on y = 0 about the y axis.
    #[serde(default)]
    #[schemars(range(max = 1e6), extend("exclusiveMinimum" = 0))]
    pub fit: Option<f64>,
}

/// What a file can be read as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LoadAs {
    /// A lat-long map of radiance, without alpha and layers.
    Envmap,
    /// An image with its alpha and layers; a picture for displays is made linear by the sRGB curve.
    Image,
    /// Triangles with the normals and texture coordinates of the file; options of pixels do not apply.
    Mesh,
}

/// How pixels are mirrored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Flip {
    /// As in the file.
    #[default]
    None,
    /// Left to right.
    Horizontal,
    /// Top to bottom.
    Vertical,
    /// Both, which is half a turn of the picture.
    Both,
}

/// What becomes of values that light cannot have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Sanitize {
    /// They stay, with a warning that counts them.
    #[default]
    Keep,
    /// NaN, infinities and negative values become 0, with a warning that counts them.
    Zero,
    /// The first one is an error.
    Error,
}

/// A size in pixels: both sides, or the width alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Resize {
    /// Pixels in a row.
    pub width: u32,
    /// Rows; absent where the width decides.
    pub height: Option<u32>,
}

const LARGEST_SIDE: u32 = 65_536;

impl Serialize for Resize {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.height {
            Some(height) => [self.width, height].serialize(serializer),
            None => serializer.serialize_u32(self.width),
        }
    }
}

impl<'de> Deserialize<'de> for Resize {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ResizeVisitor)
    }
}

struct ResizeVisitor;

impl ResizeVisitor {
    fn side<E: serde::de::Error>(value: u64) -> Result<u32, E> {
        let side = u32::try_from(value).ok().filter(|side| (1..=LARGEST_SIDE).contains(side));
        side.ok_or_else(|| E::custom(format!("`{value}` is not a number of pixels from 1 to {LARGEST_SIDE}")))
    }
}

impl<'de> serde::de::Visitor<'de> for ResizeVisitor {
    type Value = Resize;

    fn expecting(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str("a width in pixels, or [width, height]")
    }

    fn visit_u64<E: serde::de::Error>(self, width: u64) -> Result<Resize, E> {
        Ok(Resize { width: Self::side(width)?, height: None })
    }

    fn visit_i64<E: serde::de::Error>(self, width: i64) -> Result<Resize, E> {
        self.visit_u64(u64::try_from(width).unwrap_or(0))
    }

    fn visit_seq<A: serde::de::SeqAccess<'de>>(self, mut sides: A) -> Result<Resize, A::Error> {
        use serde::de::Error;
        let (width, height) = (sides.next_element::<u64>()?, sides.next_element::<u64>()?);
        match (width, height, sides.next_element::<serde::de::IgnoredAny>()?) {
            (Some(width), Some(height), None) => Ok(Resize { width: Self::side(width)?, height: Some(Self::side(height)?) }),
            _ => Err(A::Error::custom("expected two numbers: [width, height]")),
        }
    }
}

impl JsonSchema for Resize {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Resize".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let side = json_schema!({ "type": "integer", "minimum": 1, "maximum": LARGEST_SIDE });
        json_schema!({
            "anyOf": [side, { "type": "array", "items": side, "minItems": 2, "maxItems": 2 }],
            "x-unit": "pixels",
        })
    }
}

impl Stage for Load {
    const KIND: &'static str = "load";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[EnvMap::TYPE, Image::TYPE, Mesh::TYPE] }];
    type Output = Vec<AnyArtifact>;

    fn result_types(&self, _: &InputTypes) -> Vec<Vec<TypeName>> {
        vec![match self.r#as {
            Some(LoadAs::Envmap) => vec![EnvMap::TYPE],
            Some(LoadAs::Image) => vec![Image::TYPE],
            Some(LoadAs::Mesh) => vec![Mesh::TYPE],
            None => vec![EnvMap::TYPE, Image::TYPE, Mesh::TYPE],
        }]
    }

    fn decide_type(&mut self, type_name: TypeName) {
        self.r#as = Some(match type_name {
            _ if type_name == Image::TYPE => LoadAs::Image,
            _ if type_name == Mesh::TYPE => LoadAs::Mesh,
            _ => LoadAs::Envmap,
        });
    }

    fn mistakes(&self) -> Vec<Mistake> {
        let limits = Limits::default();
        let resize = self.resize.and_then(|resize| {
            let height = resize.height.unwrap_or(resize.width.div_ceil(2));
            let message = limits.checked("resize", resize.width.into(), height.into()).err()?.to_string();
            Some(Mistake { field: "resize".into(), message, hint: None })
        });
        let (own, other) = match self.r#as {
            Some(LoadAs::Image) => ("an image", "as: envmap"),
            Some(LoadAs::Mesh) => ("a mesh", "as: envmap"),
            _ => ("a map", "as: mesh"),
        };
        let foreign = |field: &str| Mistake {
            field: field.into(),
            message: format!("`{field}` means nothing here, since the file is read as {own}"),
            hint: Some(format!("leave it out, or set `{other}`")),
        };
        let set_for_others = self.set_for_others();
        let unknown = self.unknown_name().map(|(message, hint)| Mistake { field: "path".into(), message, hint: Some(hint) });
        [unknown, resize].into_iter().flatten().chain(set_for_others.into_iter().map(foreign)).collect()
    }

    fn caveats(&self) -> Vec<String> {
        let clamp = self.clamp.map(|limit| format!("radiance was cut at {limit}, so light is missing"));
        let angles = match self.angles {
            Angles::Center => None,
            Angles::Edge => Some("`angles: edge` (first report): directions are half a pixel off the pixel centers".to_owned()),
            Angles::EdgeInclusive => Some("`angles: edge-inclusive` (second report): rows are stretched to both poles".to_owned()),
        };
        [clamp, angles].into_iter().flatten().collect()
    }

    fn memory(&self, inputs: &InputSizes) -> u64 {
        let pixels = self.resize.map_or(0, |resize| u64::from(resize.width) * u64::from(resize.height.unwrap_or(resize.width / 2)));
        // Beside the file's bytes stand its pixels, which take at least as much.
        12 * pixels + inputs.values().sum::<u64>()
    }

    fn run(&self, job: &Job<'_>) -> Result<Vec<AnyArtifact>, StageError> {
        if self.r#as == Some(LoadAs::Mesh) {
            return Ok(vec![AnyArtifact::new(self.read_mesh(job)?)]);
        }
        let mut image = match self.synthetic_name() {
            Some(name) => Image::opaque(synthesized(name, job)?.raster),
            None => self.read_file(job)?,
        };
        self.change_values(&mut image.color, job)?;
        if self.r#as == Some(LoadAs::Image) {
            return Ok(vec![AnyArtifact::new(self.image_in_place(image, job)?)]);
        }
        let raster = self.map_in_place(image.color, job)?;
        if raster.width() != 2 * raster.height() {
            job.warn(format!("a lat-long map is twice as wide as high, but this one is {} x {}", raster.width(), raster.height()));
        }
        Ok(vec![AnyArtifact::new(EnvMap { raster, angles: self.angles })])
    }
}

impl Load {
    fn synthetic_name(&self) -> Option<&str> {
        self.path.0.to_str()?.strip_prefix("synthetic:")
    }

    /// Fields that were set and mean nothing to what the file is read as.
    fn set_for_others(&self) -> Vec<&'static str> {
        let of_maps = [("rotate_degrees", self.rotate_degrees != 0.0), ("angles", self.angles != Angles::Center)];
        let of_pixels = [
            ("clamp", self.clamp.is_some()),
            ("flip", self.flip != Flip::None),
            ("resize", self.resize.is_some()),
            ("exposure_stops", self.exposure_stops != 0.0),
            ("sanitize", self.sanitize != Sanitize::Keep),
            ("apply_scale", self.apply_scale),
        ];
        let of_meshes = [("buffers", !self.buffers.is_empty()), ("fit", self.fit.is_some())];
        let fields = match self.r#as {
            Some(LoadAs::Mesh) => [of_maps.as_slice(), &of_pixels].concat(),
            Some(LoadAs::Image) => [of_maps.as_slice(), &of_meshes].concat(),
            Some(LoadAs::Envmap) => of_meshes.to_vec(),
            None => Vec::new(),
        };
        fields.into_iter().filter(|(_, is_set)| *is_set).map(|(field, _)| field).collect()
    }

    /// What is wrong with the name of something synthetic, and what to write instead.
    fn unknown_name(&self) -> Option<(String, String)> {
        let name = self.synthetic_name()?;
        if self.r#as == Some(LoadAs::Mesh) {
            return (!generated::NAMES.contains(&name)).then(|| (unknown("mesh", name), known("meshes", name, &generated::NAMES)));
        }
        let is_known = synthesis::NAMES.contains(&name) || self.r#as.is_none() && generated::NAMES.contains(&name);
        (!is_known).then(|| (unknown("map", name), known("maps", name, &synthesis::NAMES)))
    }

    fn read_mesh(&self, job: &Job<'_>) -> Result<Mesh, StageError> {
        let mesh = match self.synthetic_name() {
            Some(name) => generated::named(name).ok_or_else(|| StageError::content(unknown("mesh", name)))?.map_err(StageError::content)?,
            None => self.read_mesh_file(job)?,
        };
        match self.fit {
            Some(length) => mesh.standing(length).map_err(StageError::content),
            None => Ok(mesh),
        }
    }

    fn read_mesh_file(&self, job: &Job<'_>) -> Result<Mesh, StageError> {
        let buffers = self.buffers.iter().map(|file| Ok((file, job.read(file)?))).collect::<Result<Vec<_>, StageError>>()?;
        let named = |path: &str| buffers.iter().find(|(file, _)| file.0.ends_with(path)).map(|(_, bytes)| bytes.clone());
        let (mesh, warnings) = mesh::read::read(&job.read(&self.path)?, &named).map_err(StageError::content)?;
        warnings.into_iter().for_each(|warning| job.warn(warning));
        Ok(mesh)
    }

    fn read_file(&self, job: &Job<'_>) -> Result<Image, StageError> {
        let name = self.path.0.file_name().unwrap_or(OsStr::new("")).to_string_lossy().into_owned();
        let decoded = formats::read(&job.read(&self.path)?, &name, &Limits::default()).map_err(StageError::content)?;
        decoded.warnings.iter().for_each(|warning| job.warn(warning));
        let factor = decoded.unit_factor;
        let mut image = self.linear(decoded, &name, job)?;
        if self.apply_scale && factor != 1.0 {
            scale(&mut image.color, factor);
        }
        Ok(image)
    }

    /// The linear light of a file, if it is of a sort that was asked for.
    fn linear(&self, decoded: Decoded, name: &str, job: &Job<'_>) -> Result<Image, StageError> {
        match (decoded.content, self.r#as) {
            (Content::Linear(image), Some(LoadAs::Image)) => Ok(image),
            (Content::Linear(image), _) => Ok(Image::opaque(image.color)),
            (Content::Display(picture), Some(LoadAs::Image)) => {
                job.warn("a picture for displays was made linear by the sRGB curve");
                Ok(display::decoded(&picture))
            }
            (Content::Display(_), _) => Err(StageError::content_with_hint(
                format!("`{}` is a picture for displays (format {}), not radiance", formats::escaped(name), decoded.format),
                "a map comes as PFM, Radiance HDR, OpenEXR or NPY; `as: image` reads a picture",
            )),
        }
    }

    fn change_values(&self, color: &mut Raster, job: &Job<'_>) -> Result<(), StageError> {
        match self.sanitize {
            Sanitize::Keep => {}
            Sanitize::Zero => zero_odd_values(color, job),
            Sanitize::Error => {
                if let Some(problem) = formats::survey(color).warnings().into_iter().next() {
                    return Err(StageError::content_with_hint(problem, "`sanitize: zero` sets such values to 0, `keep` lets them be"));
                }
            }
        }
        if let Some(limit) = self.clamp {
            // A NaN is not above the limit and stays what it is.
            let limit = limit as f32;
            each_value(color, |value| if value > limit { limit } else { value });
        }
        if self.exposure_stops != 0.0 {
            scale(color, elementary::exp2(self.exposure_stops));
        }
        Ok(())
    }

    fn map_in_place(&self, mut raster: Raster, job: &Job<'_>) -> Result<Raster, StageError> {
        self.mirror(&mut raster);
        if self.rotate_degrees != 0.0 {
            // Azimuth runs from +x to +z, against a right-handed turn about +y.
            let shift = -self.rotate_degrees / 360.0 * raster.width() as f64;
            raster = filter::shift_columns(&raster, shift, || job.check())?;
        }
        match self.resize {
            Some(resize) => {
                let height = resize.height.unwrap_or(resize.width.div_ceil(2));
                filter::resize_exactly(&raster, [resize.width as usize, height as usize], Rows::SolidAngle, || job.check())
            }
            None => Ok(raster),
        }
    }

    /// Mirrors and resizes color, alpha and layers alike; color counts by its alpha.
    fn image_in_place(&self, mut image: Image, job: &Job<'_>) -> Result<Image, StageError> {
        let placed = |mut raster: Raster| {
            self.mirror(&mut raster);
            self.resized(raster, job)
        };
        let placed_plane = |plane: &Plane| placed(as_raster(plane)).map(|raster| as_plane(&raster));

        if let Some(alpha) = &image.alpha {
            multiply(&mut image.color, alpha, |value, alpha| value * alpha);
        }
        image.color = placed(image.color)?;
        image.alpha = image.alpha.as_ref().map(placed_plane).transpose()?;
        if let Some(alpha) = &image.alpha {
            multiply(&mut image.color, alpha, |value, alpha| if alpha > 0.0 { value / alpha } else { 0.0 });
        }
        for layer in image.layers.values_mut() {
            *layer = match layer {
                Layer::Color(raster) => Layer::Color(placed(raster.clone())?),
                Layer::Scalar(plane) => Layer::Scalar(placed_plane(plane)?),
            };
        }
        Ok(image)
    }

    fn resized(&self, raster: Raster, job: &Job<'_>) -> Result<Raster, StageError> {
        let Some(resize) = self.resize else { return Ok(raster) };
        let width = resize.width as usize;
        let in_shape = (width as f64 * raster.height() as f64 / raster.width() as f64).round().max(1.0);
        let height = resize.height.map_or(in_shape as usize, |height| height as usize);
        if width >= raster.width() && height >= raster.height() {
            filter::resize_bilinear(&raster, [width, height], || job.check())
        } else {
            filter::resize_exactly(&raster, [width, height], Rows::Area, || job.check())
        }
    }

    fn mirror(&self, raster: &mut Raster) {
        if matches!(self.flip, Flip::Horizontal | Flip::Both) {
            filter::flip_horizontally(raster);
        }
        if matches!(self.flip, Flip::Vertical | Flip::Both) {
            filter::flip_vertically(raster);
        }
    }
}

/// The synthetic map of that name, 1024 pixels wide.
fn synthesized(name: &str, job: &Job<'_>) -> Result<EnvMap, StageError> {
    match Synthetic::named(name) {
        Some(map) => synthesis::synthesize(&map, 1024, || job.check()),
        None => Err(StageError::content_with_hint(unknown("map", name), known("maps", name, &synthesis::NAMES))),
    }
}

fn unknown(what: &str, name: &str) -> String {
    format!("there is no synthetic {what} `{}`", formats::escaped(name))
}

/// What to write instead of a name that none of them has.
fn known(what: &str, name: &str, names: &[&str]) -> String {
    match catalogue::nearest(name, names.iter().copied()) {
        Some(near) => format!("did you mean `synthetic:{near}`?"),
        None => format!("the {what} are `{}`", names.join("`, `")),
    }
}

fn zero_odd_values(color: &mut Raster, job: &Job<'_>) {
    let is_odd = |value: &&f32| !value.is_finite() || **value < 0.0;
    let count = color.pixels().as_flattened().par_iter().filter(is_odd).count();
    if count > 0 {
        each_value(color, |value| if is_odd(&&value) { 0.0 } else { value });
        job.warn(format!("{count} values were set to 0"));
    }
}

fn scale(color: &mut Raster, factor: f64) {
    each_value(color, |value| (f64::from(value) * factor) as f32);
}

fn each_value(color: &mut Raster, change: impl Fn(f32) -> f32 + Sync) {
    color.pixels_mut().par_iter_mut().for_each(|pixel| *pixel = pixel.map(&change));
}

fn multiply(color: &mut Raster, alpha: &Plane, by: impl Fn(f32, f32) -> f32) {
    for (pixel, alpha) in color.pixels_mut().iter_mut().zip(&alpha.values) {
        *pixel = pixel.map(|value| by(value, *alpha));
    }
}

fn as_raster(plane: &Plane) -> Raster {
    Raster::new(plane.width, plane.height, plane.values.iter().map(|value| [*value; 3]).collect())
}

fn as_plane(raster: &Raster) -> Plane {
    let values = raster.pixels().iter().map(|pixel| pixel[0]).collect();
    Plane { width: raster.width(), height: raster.height(), values }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;

    use glam::{DMat3, DVec3};

    use super::*;
    use crate::engine::job::FileSource;
    use crate::image::raster::{Picture, PictureSamples};

    struct OneFile(Vec<u8>);

    impl FileSource for OneFile {
        fn read(&self, _: &Path) -> Result<Vec<u8>, StageError> {
            Ok(self.0.clone())
        }
    }

    fn load(parameters: &str) -> Load {
        serde_yaml::from_str(&format!("{{ path: map.pfm, {parameters} }}")).unwrap()
    }

    fn run(stage: &Load, bytes: Vec<u8>) -> Result<(AnyArtifact, Vec<String>), StageError> {
        let (files, interrupted) = (OneFile(bytes), AtomicBool::new(false));
        let job = Job::new(Default::default(), &files, 0, &interrupted);
        let artifact = stage.run(&job)?.remove(0);
        Ok((artifact, job.take_warnings()))
    }

    fn map(parameters: &str, raster: &Raster) -> Arc<EnvMap> {
        let bytes = formats::encode(&Image::opaque(raster.clone()), "pfm", &[]).unwrap().0;
        run(&load(parameters), bytes).unwrap().0.get().unwrap()
    }

    fn one_pixel(x: usize, y: usize) -> Raster {
        let mut raster = Raster::filled(64, 32, [0.0; 3]);
        raster.set_pixel(x, y, [1.0; 3]);
        raster
    }

    /// Mean direction of a map's light.
    fn direction(map: &EnvMap) -> DVec3 {
        let pixels = (0..map.height()).flat_map(|y| (0..map.width()).map(move |x| (x, y)));
        pixels.map(|(x, y)| map.direction(x, y) * f64::from(map.raster.pixel(x, y)[0])).sum::<DVec3>().normalize()
    }

    #[test]
    fn a_turned_map_shows_what_was_at_d_at_the_turned_d() {
        for degrees in [90.0, -45.0, 5.625, 33.3, 720.0] {
            let original = one_pixel(20, 10);
            let turned = map(&format!("rotate_degrees: {degrees}"), &original);
            let expected = DMat3::from_rotation_y(f64::to_radians(degrees)) * EnvMap::new(original).direction(20, 10);
            // The mean of two neighbors lies within a fraction of a pixel of the true direction.
            assert!((direction(&turned) - expected).length() < 0.003, "{degrees}: {} {expected}", direction(&turned));
            let total: f32 = turned.raster.pixels().iter().map(|pixel| pixel[0]).sum();
            assert!((total - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn values_change_in_the_order_of_the_manual() {
        let raster = Raster::new(2, 1, vec![[3.0, 0.25, -1.0], [f32::NAN, 1.0, 8.0]]);
        let changed = map("clamp: 2, exposure_stops: 1, sanitize: zero", &raster);
        assert_eq!(changed.raster.pixels(), [[4.0, 0.5, 0.0], [0.0, 2.0, 4.0]]);
        assert_eq!(map("flip: both", &raster).raster.pixel(1, 0), [3.0, 0.25, -1.0]);
    }

    #[test]
    fn odd_pixels_are_a_warning_or_an_error() {
        let bytes = formats::encode(&Image::opaque(Raster::new(2, 1, vec![[1.0; 3], [f32::NAN; 3]])), "pfm", &[]).unwrap().0;
        let (_, warnings) = run(&load(""), bytes.clone()).unwrap();
        assert_eq!(warnings, ["1 pixel is not finite (NaN or infinite), at (1, 0)"]);
        let error = run(&load("sanitize: error"), bytes).unwrap_err().to_string();
        assert!(error.contains("(1, 0)"), "{error}");
    }

    #[test]
    fn the_scale_of_a_pfm_counts_only_on_demand() {
        let bytes = [b"Pf 2 1 -3\n".as_slice(), &1f32.to_le_bytes(), &2f32.to_le_bytes()].concat();
        let values = |parameters: &str| -> Vec<f32> {
            let found: Arc<EnvMap> = run(&load(parameters), bytes.clone()).unwrap().0.get().unwrap();
            found.raster.pixels().iter().map(|pixel| pixel[0]).collect()
        };
        assert_eq!((values(""), values("apply_scale: true")), (vec![1.0, 2.0], vec![3.0, 6.0]));
    }

    #[test]
    fn a_picture_is_an_image_and_no_map() {
        let picture = Picture { width: 2, height: 1, samples: PictureSamples::Eight(vec![[255, 0, 118]; 2]), alpha: Some(vec![255, 0]) };
        let bytes = formats::encode_picture(&picture, "png", &[]).unwrap().0;
        assert!(run(&load("as: envmap"), bytes.clone()).unwrap_err().to_string().contains("not radiance"));
        let image: Arc<Image> = run(&load("as: image"), bytes).unwrap().0.get().unwrap();
        assert_eq!(image.color.pixel(1, 0), [0.0; 3]);
        assert_eq!(image.color.pixel(0, 0)[0], 1.0);
        assert!((image.color.pixel(0, 0)[2] - 0.18).abs() < 0.002);
    }

    #[test]
    fn an_image_is_averaged_by_its_alpha() {
        let color = Raster::new(2, 1, vec![[4.0; 3], [0.0; 3]]);
        let alpha = Some(Plane { width: 2, height: 1, values: vec![1.0, 0.0] });
        let bytes = formats::encode(&Image { alpha, ..Image::opaque(color) }, "exr", &[]).unwrap().0;
        let image: Arc<Image> = run(&load("as: image, resize: [1, 1]"), bytes).unwrap().0.get().unwrap();
        assert_eq!(image.color.pixel(0, 0), [4.0; 3]);
        assert_eq!(image.alpha.as_ref().unwrap().values, [0.5]);
    }

    #[test]
    fn a_size_is_two_sides_or_a_width() {
        let raster = Raster::filled(64, 32, [1.0; 3]);
        let size = |map: &EnvMap| (map.width(), map.height());
        assert_eq!(size(&map("resize: 16", &raster)), (16, 8));
        assert_eq!(size(&map("resize: [10, 7]", &raster)), (10, 7));
        for wrong in ["resize: 0", "resize: [1]", "resize: [1, 2, 3]", "resize: -4", "resize: [65537, 1]"] {
            assert!(serde_yaml::from_str::<Load>(&format!("{{ path: a, {wrong} }}")).is_err(), "{wrong}");
        }
        assert!(!load("resize: [65536, 65536]").mistakes().is_empty());
        for text in ["16", "[10,7]"] {
            let resize: Resize = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&resize).unwrap(), text);
        }
    }

    #[test]
    fn a_mesh_is_read_with_its_warnings_and_without_options_of_pixels() {
        let text = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 1 2\n".to_vec();
        let (artifact, warnings) = run(&load("as: mesh"), text.clone()).unwrap();
        let mesh: Arc<Mesh> = artifact.get().unwrap();
        assert_eq!((mesh.triangles().len(), warnings.len()), (1, 1));
        let fields = |text: &str| load(text).mistakes().into_iter().map(|mistake| mistake.field).collect::<Vec<_>>();
        assert_eq!(fields("as: mesh, clamp: 1, angles: edge"), ["angles", "clamp"]);
        assert_eq!(fields("as: image, buffers: [a]"), ["buffers"]);
        assert!(run(&load("as: mesh"), b"v 1 2".to_vec()).unwrap_err().to_string().contains("line 1"));
    }

    #[test]
    fn a_generated_mesh_stands_where_it_is_asked_to() {
        let mut stage = load("as: mesh, fit: 3");
        stage.path.0 = "synthetic:knot".into();
        assert!(stage.mistakes().is_empty());
        let mesh: Arc<Mesh> = run(&stage, Vec::new()).unwrap().0.get().unwrap();
        let extent = |axis: usize| {
            let values = mesh.positions().iter().map(|position| position[axis]);
            values.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
        };
        let [x, y, z] = [extent(0), extent(1), extent(2)];
        let longest = [x, y, z].map(|[low, high]| high - low).into_iter().fold(0.0, f32::max);
        assert!((longest - 3.0).abs() < 1e-5 && y[0].abs() < 1e-6 && (x[0] + x[1]).abs() < 1e-5 && (z[0] + z[1]).abs() < 1e-5);
        stage.path.0 = "synthetic:cathedral".into();
        assert_eq!(stage.mistakes()[0].message, "there is no synthetic mesh `cathedral`");
    }

    #[test]
    fn the_users_decide_what_a_file_is_read_as() {
        let mut stage = load("");
        assert_eq!(stage.result_types(&Default::default()), [["envmap", "image", "mesh"]]);
        Stage::decide_type(&mut stage, "image");
        assert_eq!(stage.result_types(&Default::default()), [["image"]]);
        assert_eq!(serde_json::to_value(&stage).unwrap()["as"], "image");
        let kind = crate::engine::registry::Kind::of::<Load>();
        let properties = &kind.schema()["properties"];
        assert!(properties["as"].is_object() && properties["clamp"]["exclusiveMinimum"] == 0, "{properties}");
    }
}
