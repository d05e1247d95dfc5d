//! The documentation: its reference is what the program says of itself, every page is in the book, and no link leads nowhere.
//!
//! The commands on its pages are run by `tests/trials/book.py`.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::space::Space;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All pages below `docs`, as paths relative to it, sorted.
fn pages() -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![root().join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_dir() {
                folders.push(entry);
            } else if entry.extension().is_some_and(|extension| extension == "md") {
                found.push(entry.strip_prefix(root().join("docs")).unwrap().to_owned());
            }
        }
    }
    found.sort();
    found
}

/// The targets of the links of a page, and of its pictures: what stands in `](…)`, outside of code.
fn links(text: &str) -> Vec<String> {
    let mut is_code = false;
    let prose: Vec<&str> = text
        .lines()
        .filter(|line| {
            let is_fence = line.trim_start().starts_with("```");
            is_code ^= is_fence;
            !is_code && !is_fence
        })
        .collect();
    let prose = prose.join("\n");
    let targets = prose.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target.to_owned());
    targets.filter(|target| !target.starts_with("http")).collect()
}

/// The anchors of a page's headings, as GitHub and mdBook make them.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = text.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim().to_lowercase());
    let letters = |heading: String| heading.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c)).collect::<String>();
    headings.map(|heading| letters(heading).replace(' ', "-")).collect()
}

#[test]
fn the_reference_is_what_the_program_says() {
    let space = Space::new();
    space.run(&["man", "--format", "markdown", "--dir", "reference"]).expect(0, &[]);
    let written = space.files("reference");
    let known: Vec<String> = pages().iter().filter_map(|page| Some(page.strip_prefix("reference").ok()?.to_str()?.to_owned())).collect();
    assert_eq!(written, known, "{AGAIN}");
    for name in written {
        let committed = fs::read(root().join("docs/reference").join(&name)).unwrap();
        assert!(space.read(&format!("reference/{name}")) == committed, "docs/reference/{name} is of another program: {AGAIN}");
    }
}

const AGAIN: &str = "write it again: cargo run -- man --format markdown --dir docs/reference";

#[test]
fn every_page_is_in_the_book_and_links_lead_somewhere() {
    let docs = root().join("docs");
    let summary = links(&fs::read_to_string(docs.join("SUMMARY.md")).unwrap());
    for page in pages() {
        let name = page.to_str().unwrap();
        assert!(name == "SUMMARY.md" || summary.iter().any(|target| target == name), "{name} is not in docs/SUMMARY.md");
    }
    for path in pages().into_iter().map(|page| docs.join(page)).chain([root().join("README.md")]) {
        let text = fs::read_to_string(&path).unwrap();
        for target in links(&text) {
            let (file, anchor) = target.split_once('#').unwrap_or((&target, ""));
            let linked = if file.is_empty() { path.clone() } else { path.parent().unwrap().join(file) };
            assert!(linked.exists(), "{}: {target}", path.display());
            if !anchor.is_empty() {
                let found = anchors(&fs::read_to_string(&linked).unwrap());
                assert!(found.contains(anchor), "{}: {target} is none of {found:?}", path.display());
            }
        }
    }
}

#[test]
fn every_kind_has_an_example_that_is_right() {
    let space = Space::new();
    let kinds = pipeline::stages::registry();
    for name in kinds.kinds().names() {
        let manual = space.run(&["stages", name]).stdout;
        let example = manual.split_once("Example, below `stages:`\n").unwrap_or_else(|| panic!("`{name}` has no example in its comment")).1;
        let example = example.split("\nParameters:").next().unwrap();
        let own: Vec<&str> =
            example.lines().filter_map(|line| line.strip_prefix("  ")?.split(':').next()).filter(|key| !key.starts_with(' ')).collect();
        let others: String = NEIGHBORS
            .lines()
            .filter(|line| !own.iter().any(|own| line.trim_start().starts_with(&format!("{own}:"))))
            .map(|line| format!("{line}\n"))
            .collect();
        space.write("p.yaml", format!("version: 1\npipeline: p\naxes: {{ n: [16, 64], run: [1, 2, 3] }}\nstages:\n{others}{example}"));
        for file in ["sky.exr", "ball-1s.png", "ball-4s.png"] {
            space.write(file, "only its name counts here");
        }
        space.run(&["check", "p.yaml"]).expect(0, &[]);
    }
}

/// Stages to which examples refer, under the names that the whole manual uses.
const NEIGHBORS: &str = "  env: { synthesize: { name: studio, width: 64 } }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n } }
  repeated: { relight: { env: env, with: drawn, size: 31 } }
  drawn: { sample: { of: dist, count: $n, seed: $run } }
  sphere: { relight: { env: env, with: samples, size: 31 } }
  truth: { relight: { env: env, estimator: exact, size: 31 } }
  picture: { tone-map: { of: sphere, gamma: srgb } }
  error: { compare: { of: sphere, to: truth, metrics: [rmse] } }
  ball: { relight: { env: env, view: mirror, size: 31 } }
  traced: { render: { env: env, scene: { film: { resolution: [8, 8], layers: [variance, albedo, normal] }, shapes: [{ sphere: {} }] } } }
";
