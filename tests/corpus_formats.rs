//! Bad and odd image files, each with the behavior it must get.
//!
//! The files are not part of this repository; where they are absent the tests say so and pass.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use pipeline::engine::job::{FileSource, Job};
use pipeline::engine::parameter::InputFile;
use pipeline::engine::stage::{Stage, StageError};
use pipeline::formats::{self, Limits};
use pipeline::image::raster::Raster;
use pipeline::light::envmap::EnvMap;
use pipeline::stages::load::Load;
use serde_json::Value as Json;

fn shared() -> Option<PathBuf> {
    let named = std::env::var_os("PIPELINE_SHARED").map(PathBuf::from);
    let folder = named.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"));
    folder.join("corpus").is_dir().then_some(folder)
}

struct Disk;

impl FileSource for Disk {
    fn read(&self, path: &Path) -> Result<Vec<u8>, StageError> {
        fs::read(path).map_err(|source| StageError::System { context: "reading the input".into(), source })
    }
}

/// What became of a file: its pixels where they are radiance, and what was said.
struct Outcome {
    raster: Option<Arc<EnvMap>>,
    said: String,
    is_accepted: bool,
}

/// As the stage `load` reads a map.
fn loaded(path: &Path) -> Outcome {
    let stage: Load = serde_json::from_value(serde_json::json!({ "path": InputFile(path.into()), "as": "envmap" })).unwrap();
    let interrupted = AtomicBool::new(false);
    let job = Job::new(Default::default(), &Disk, 0, &interrupted);
    match stage.run(&job) {
        Ok(artifacts) => Outcome { raster: artifacts[0].get(), said: job.take_warnings().join("\n"), is_accepted: true },
        Err(error) => Outcome { raster: None, said: error.to_string(), is_accepted: false },
    }
}

/// As a texture is read.
fn decoded(path: &Path) -> Outcome {
    match formats::read(&fs::read(path).unwrap(), &path.file_name().unwrap().to_string_lossy(), &Limits::default()) {
        Ok(decoded) => Outcome { raster: None, said: decoded.warnings.join("\n"), is_accepted: true },
        Err(error) => Outcome { raster: None, said: error.to_string(), is_accepted: false },
    }
}

/// Why an outcome is not the stated one.
fn fault(case: &Json, outcome: &Outcome) -> Option<String> {
    let name = Path::new(case["file"].as_str().unwrap()).file_name().unwrap().to_string_lossy().into_owned();
    let said = outcome.said.replace(&name, "");
    if said.chars().any(|character| character.is_control() && character != '\n') {
        return Some(format!("control characters are shown: {said:?}"));
    }
    // A distribution refuses what is not finite; a reader only counts it and says where.
    let of_pixels = case["say"].is_array();
    match case["want"].as_str().unwrap() {
        _ if of_pixels => (!said.contains("not finite") || !outcome.is_accepted).then(|| format!("expected a count: {said}")),
        "reject" if outcome.is_accepted => Some("accepted".into()),
        "accept" if !outcome.is_accepted => Some(format!("refused: {said}")),
        _ if !outcome.is_accepted => {
            let say = case["say"].as_str().unwrap();
            (!matches(say, &said)).then(|| format!("`{said}` does not say `{say}`"))
        }
        _ => wrong_warning(case, &said).or_else(|| wrong_pixels(&case["result"], outcome.raster.as_deref()?)),
    }
}

fn wrong_warning(case: &Json, said: &str) -> Option<String> {
    let warn = case["warn"].as_str()?;
    // The two look-aheads of the corpus: non-finite pixels, and how many.
    let is_said = if warn.starts_with("(?=") { said.contains("not finite") } else { matches(warn, said) };
    // Alpha is the concern of those who use a picture as a texture, blackness that of those who draw from a map.
    (!is_said && warn != "alpha" && !warn.contains("black")).then(|| format!("warnings `{said}` do not match `{warn}`"))
}

fn wrong_pixels(result: &Json, map: &EnvMap) -> Option<String> {
    let size = (result["w"].as_u64()?, result["h"].as_u64()?);
    let raster: &Raster = &map.raster;
    if size != (raster.width() as u64, raster.height() as u64) {
        return Some(format!("size {} x {}, expected {size:?}", raster.width(), raster.height()));
    }
    let tolerance = result["tol"].as_f64().unwrap();
    result["probe"].as_array()?.iter().find_map(|probe| {
        let (x, y) = (probe[0].as_u64().unwrap() as usize, probe[1].as_u64().unwrap() as usize);
        let found = raster.pixel(x, y);
        let differs = (0..3).any(|channel| {
            let Some(expected) = probe[2][channel].as_f64() else { return false };
            let value = f64::from(found[channel]);
            (value - expected).abs() > tolerance * expected.abs().max(1.0) && value != expected
        });
        differs.then(|| format!("pixel ({x}, {y}) is {found:?}, expected {}", probe[2]))
    })
}

/// Whether one of the alternatives is found in a text, without regard to case: letters, `.`, `\d`, `\+` and `?` only.
fn matches(pattern: &str, text: &str) -> bool {
    let text: Vec<char> = text.to_lowercase().chars().collect();
    pattern.split('|').any(|alternative| {
        let alternative: Vec<char> = alternative.to_lowercase().chars().collect();
        (0..=text.len()).any(|start| begins_with(&text[start..], &alternative))
    })
}

fn begins_with(text: &[char], pattern: &[char]) -> bool {
    let Some(first) = pattern.first() else { return true };
    let (fits, size): (fn(char, char) -> bool, usize) = match (first, pattern.get(1)) {
        ('\\', Some('d')) => (|_, found| found.is_ascii_digit(), 2),
        ('\\', _) => (|expected, found| expected == found, 2),
        ('.', _) => (|_, _| true, 1),
        _ => (|expected, found| expected == found, 1),
    };
    let rest = &pattern[size..];
    let expected = pattern[size - 1];
    let takes_one = text.first().is_some_and(|found| fits(expected, *found));
    if rest.first() == Some(&'?') {
        return begins_with(text, &rest[1..]) || (takes_one && begins_with(&text[1..], &rest[1..]));
    }
    takes_one && begins_with(&text[1..], rest)
}

/// Peak memory of this process in MiB since the last call, where the system tells.
fn peak_memory() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let peak = line.split_ascii_whitespace().nth(1)?.parse::<u64>().ok()? / 1024;
    fs::write("/proc/self/clear_refs", "5").ok()?;
    Some(peak)
}

fn check(list: &str) {
    let Some(shared) = shared() else {
        println!("skipped: the corpus of bad inputs is not here");
        return;
    };
    let corpus = shared.join("corpus");
    let text = fs::read_to_string(corpus.join(list)).unwrap();
    let cases: Vec<Json> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let of_images = cases.iter().filter(|case| ["pfm", "hdr", "exr", "png"].contains(&case["kind"].as_str().unwrap()));

    let (mut faults, mut count) = (Vec::new(), 0);
    for case in of_images {
        let file = case["file"].as_str().unwrap();
        let path = corpus.join(file);
        peak_memory();
        let start = Instant::now();
        let outcome = if case["kind"] == "png" { decoded(&path) } else { loaded(&path) };
        let (elapsed, peak) = (start.elapsed(), peak_memory());
        let found = fault(case, &outcome)
            .or_else(|| (elapsed > Duration::from_secs(case["sec"].as_u64().unwrap_or(10))).then(|| format!("took {elapsed:?}")))
            .or_else(|| peak.filter(|peak| *peak > case["rss"].as_u64().unwrap_or(u64::MAX)).map(|peak| format!("needed {peak} MiB")));
        faults.extend(found.map(|fault| format!("{file}: {fault}")));
        count += 1;
    }
    println!("{count} files of {list}");
    assert!(faults.is_empty(), "{} of {count} files:\n{}", faults.len(), faults.join("\n"));
}

// One test, so that no other work of this process is taken for a file's.
#[test]
fn each_file_of_the_corpus_gets_the_behavior_stated() {
    check("expect.jsonl");
    check("expect_public.jsonl");
}

#[test]
fn the_small_patterns_of_the_corpus_are_understood() {
    assert!(matches("trunc|non-?finite", "Non-Finite pixels") && matches("non-?finite", "a nonfinite"));
    assert!(matches(r"65.?536|large", "over 65 536") && matches(r"\+Y|-X", "order +y"));
    assert!(!matches("trunc|end of", "the end") && matches(r"b\d", "ab7"));
}
