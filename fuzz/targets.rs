//! What the fuzz targets try, one function each; `tests/fuzz_seeds.rs` replays the seeds through the same ones.
//!
//! A function returns if the bytes were refused or obeyed the laws below, and panics otherwise. Wherever bytes are
//! accepted, writing and reading them again must give the same.

use std::fs;
use std::sync::OnceLock;

use pipeline::engine::registry::Registry;
use pipeline::engine::request::Request;
use pipeline::engine::source::Findings;
use pipeline::engine::store::record::{PublicationRecord, ResultRecord, seal, unseal};
use pipeline::engine::sweep::build;
use pipeline::formats::{self, Content, FORMATS, Limits};
use pipeline::image::raster::Image;
use pipeline::render::medium::grid::Voxels;
use pipeline::render::mesh::{Mesh, read, write};
use pipeline::stages::{registry, scene_xml};

/// Name of a target, which is also its folder of seeds, and what it tries.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const TARGETS: &[Target] = &[
    ("pfm", |bytes| image("pfm", bytes)),
    ("hdr", |bytes| image("hdr", bytes)),
    ("exr", |bytes| image("exr", bytes)),
    ("png", |bytes| image("png", bytes)),
    ("ppm", |bytes| image("ppm", bytes)),
    ("npy", |bytes| image("npy", bytes)),
    ("ply", mesh),
    ("obj", mesh),
    ("gltf", mesh),
    ("voxels", voxels),
    ("scene", scene),
    ("pipeline", pipeline_file),
    ("arguments", arguments),
    ("record", record),
    ("blob", blob),
];

/// Runs the target of that name.
pub fn run(name: &str, bytes: &[u8]) {
    let (_, target) = TARGETS.iter().find(|(known, _)| *known == name).expect("a target of that name");
    target(bytes);
}

/// A mesh that was read is written and read again as the same.
fn mesh(bytes: &[u8]) {
    let Ok((mesh, _)) = read::read(bytes, &|_| None) else { return };
    // Normals at right angles to their triangle leave its orientation to rounding, so the order of corners does not count.
    let corners = |mesh: &Mesh| {
        let sorted = |triangle: usize| {
            let mut corners = mesh.corners(triangle).map(|corner| corner.to_array().map(f32::to_bits));
            corners.sort_unstable();
            corners
        };
        (0..mesh.triangles().len()).map(sorted).collect::<Vec<_>>()
    };
    for written in [write::ply(&mesh), write::obj(&mesh)] {
        let (again, _) = read::read(&written, &|_| None).expect("our own file");
        assert_eq!(corners(&again), corners(&mesh));
    }
}

/// Small enough that no input takes long or much.
const LIMITS: Limits = Limits { side: 512, bytes: 4 << 20 };

/// What one format reads, another holds exactly.
fn image(format: &str, bytes: &[u8]) {
    let format = FORMATS.iter().find(|known| known.name == format).expect("a format of that name");
    let _ = (format.origin)(bytes);
    let Ok(decoded) = (format.read)(bytes, &LIMITS) else { return };
    match &decoded.content {
        Content::Linear(linear) => {
            let written = formats::encode(linear, "npy", &[]).expect("npy holds every image").0;
            let Content::Linear(again) = formats::read(&written, "again.npy", &LIMITS).expect("our own file").content else {
                panic!("npy holds linear light");
            };
            let bits = |image: &Image| image.color.pixels().iter().map(|pixel| pixel.map(f32::to_bits)).collect::<Vec<_>>();
            assert_eq!(bits(&again), bits(linear));
        }
        Content::Display(picture) => {
            let written = formats::encode_picture(picture, "png", &[]).expect("png holds every picture").0;
            assert_eq!(formats::read(&written, "again.png", &LIMITS).expect("our own file").content, decoded.content);
        }
    }
}

fn kinds() -> &'static Registry {
    static KINDS: OnceLock<Registry> = OnceLock::new();
    KINDS.get_or_init(registry)
}

fn built(text: &[u8], change: impl FnOnce(&mut Request)) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("p.yaml");
    fs::write(&path, text).expect("the file can be written");
    let mut request = Request::of_file(&path);
    request.max_jobs = 2000;
    change(&mut request);
    match build(kinds(), &request) {
        Ok((graph, _)) => assert!(graph.jobs.len() <= 2000),
        Err(mistakes) => assert!(!mistakes.is_empty(), "a refusal says why"),
    }
}

/// Voxels that were read are as many as they say.
fn voxels(bytes: &[u8]) {
    let Ok(voxels) = Voxels::read(bytes) else { return };
    assert!(voxels.size().iter().product::<usize>() <= bytes.len());
}

/// A scene of another program becomes one of ours in the place of a section, or its mistakes are told.
fn scene(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let mut findings = Findings::default();
    let scene = scene_xml::read(0, text, &mut findings);
    assert_eq!(scene.is_none(), findings.error_count() > 0, "a refusal says why");
    if scene.is_none() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("scene.xml"), text).expect("the file can be written");
    let path = folder.path().join("p.yaml");
    fs::write(&path, "stages: { picture: { render: { scene: scene.xml } } }\n").expect("the file can be written");
    if let Err(mistakes) = build(kinds(), &Request::of_file(&path)) {
        assert!(!mistakes.is_empty(), "a refusal says why");
    }
}

/// Any text gives a graph or the mistakes in it.
fn pipeline_file(bytes: &[u8]) {
    built(bytes, |_| ());
}

/// Lines `s NAME=VALUE`, `a AXIS=VALUES`, `o TARGET`, `f TARGET` and `d SEED` on a fixed pipeline.
fn arguments(bytes: &[u8]) {
    const PIPELINE: &str = "params: { size: 16, map: 'synthetic:gradient', look: { gamma: 2.2 } }
axes: { n: [4, 16], look: [{ name: warm, stops: 1 }, { name: cold, stops: 2 }] }
stages:
  env: { load: { path: $map } }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n } }
  sphere: { relight: { env: env, with: samples, size: $size }, save: pfm }
  ldr: { tone-map: { of: sphere, exposure_stops: $look.stops }, save: png }
";
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    built(PIPELINE.as_bytes(), |request| {
        for line in text.lines() {
            let Some((letter, rest)) = line.split_once(' ') else { continue };
            let pair = || rest.split_once('=').map(|(name, value)| (name.to_owned(), value.to_owned()));
            match letter {
                "s" => request.parameters.extend(pair()),
                "a" => request.axes.extend(pair()),
                "o" => request.only.push(rest.to_owned()),
                "f" => request.force.push(rest.to_owned()),
                "d" => request.seed = Some(rest.to_owned()),
                _ => {}
            }
        }
    });
}

/// A record in a store may hold anything: sealed or not, it parses to what it says or not at all.
fn record(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let inner = unseal(text).unwrap_or(text);
    let sealed = seal(inner);
    assert_eq!(unseal(&sealed), Some(inner));
    if let Ok(record) = serde_json::from_str::<ResultRecord>(inner) {
        let again: ResultRecord = serde_json::from_str(&serde_json::to_string(&record).expect("plain data")).expect("our own text");
        assert_eq!(again, record);
    }
    if let Ok(record) = serde_json::from_str::<PublicationRecord>(inner) {
        let again: PublicationRecord = serde_json::from_str(&serde_json::to_string(&record).expect("plain data")).expect("our own text");
        assert_eq!(again, record);
    }
}

/// The name of a type of artifact, a line break and its bytes: what is read has one form.
fn blob(bytes: &[u8]) {
    let Some(end) = bytes.iter().position(|byte| *byte == b'\n') else { return };
    let Some((_, kind)) = kinds().artifacts().iter().find(|(name, _)| name.as_bytes() == &bytes[..end]) else { return };
    let Ok(artifact) = kind.read(&mut &bytes[end + 1..]) else { return };
    let mut written = Vec::new();
    artifact.write(&mut written).expect("memory takes everything");
    let again = kind.read(&mut written.as_slice()).expect("our own bytes");
    let mut twice = Vec::new();
    again.write(&mut twice).expect("memory takes everything");
    assert_eq!(twice, written);
}
