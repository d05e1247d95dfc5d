//! Replays the seeds of the fuzz targets, findings among them, and every cut of the small ones.

#[path = "../fuzz/targets.rs"]
mod targets;

use std::fs;
use std::path::Path;

/// Seeds up to this many bytes are also tried cut off at every byte.
const CUT_LIMIT: usize = 400;

#[test]
fn every_seed_passes_its_target() {
    for (name, target) in targets::TARGETS {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds").join(name);
        let mut paths: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        assert!(!paths.is_empty(), "`{name}` has seeds");
        for path in paths {
            println!("{}", path.display());
            let bytes = fs::read(&path).unwrap();
            target(&bytes);
            let cuts = if bytes.len() <= CUT_LIMIT { 0..bytes.len() } else { 0..0 };
            cuts.for_each(|length| target(&bytes[..length]));
        }
    }
}

#[test]
fn a_target_stands_for_each_format() {
    for format in pipeline::formats::FORMATS {
        assert!(targets::TARGETS.iter().any(|(name, _)| *name == format.name), "{}", format.name);
        targets::run(format.name, b"");
    }
}
