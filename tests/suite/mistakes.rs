//! Mistakes in pipeline files and command lines, one of each sort: refused with exit code 2, at the right line,
//! with the right words, and with nothing written.
//!
//! The whole collection, with data files, is run by `tests/trials/corpus.py`.

use crate::space::{Finished, Space};

/// A chain that is right, to hang mistakes on; its first line is line 4 of the file.
const CHAIN: &str = "\
params: { g: 2.2 }
axes: { n: [4, 16], look: [{ name: warm, gain: 2 }, { name: cold, gain: 1 }] }
stages:
  env: { synthesize: { name: gradient, width: 32 } }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n } }
  sphere: { relight: { env: env, with: samples, size: 16 } }
  ldr: { tone-map: { of: sphere, gamma: $g }, save: png }
";

/// What is wrong with a refusal, if anything is.
fn fault(space: &Space, finished: &Finished, case: &str, texts: &[&str]) -> Option<String> {
    let Finished { code, stdout, stderr } = finished;
    let folded = stderr.to_lowercase();
    let missing: Vec<&&str> = texts.iter().filter(|text| !folded.contains(&text.to_lowercase())).collect();
    let odd = stderr.chars().find(|c| (c.is_control() && *c != '\n') || ('\u{202a}'..='\u{202e}').contains(c));
    let is_right = *code == 2 && missing.is_empty() && odd.is_none() && !stderr.contains("panicked") && !space.path("outputs").exists();
    (!is_right).then(|| format!("{case}: exit {code}, without {missing:?}, with {odd:?}:\n{stdout}{stderr}"))
}

/// Mistakes made by exchanging a part of the chain: (part, instead, what must be said).
const EXCHANGED: [(&str, &str, &[&str]); 57] = [
    // Words.
    ("sample:", "smaple:", &["p.yaml:9:", "did you mean `sample`?"]),
    ("relight:", "Relight:", &["p.yaml:10:", "`relight`"]),
    ("count:", "cuont:", &["p.yaml:9:", "stage `samples`", "did you mean `count`?"]),
    ("size: 16", "sise: 16", &["p.yaml:10:", "`size`"]),
    ("name: gradient", "name: graident", &["p.yaml:7:", "`gradient`"]),
    ("save: png", "save: pgn", &["p.yaml:11:", "`png`"]),
    ("save: png", "svae: png", &["p.yaml:11:", "`save`"]),
    ("stages:", "stagse:", &["p.yaml:6:", "`stages`"]),
    ("axes:", "axis:", &["p.yaml:5:", "`axes`"]),
    // References.
    ("of: dist", "of: dits", &["p.yaml:9:", "did you mean `dist`?"]),
    ("of: dist", "of: env", &["p.yaml:9:", "distribution", "envmap"]),
    ("of: dist", "of: \"dist[n=4]\"", &["p.yaml:9:", "n"]),
    ("with: samples", "with: \"samples[n=5]\"", &["p.yaml:10:", "`5`"]),
    ("with: samples", "with: \"samples[m=4]\"", &["p.yaml:10:", "`m`"]),
    ("with: samples", "with: \"samples[n=4\"", &["p.yaml:10:", "]"]),
    ("with: samples", "with: \"samples.map\"", &["p.yaml:10:", "map"]),
    ("of: env", "of: ldr", &["cycle", "ldr", "dist"]),
    ("of: env", "of: dist", &["cycle", "dist"]),
    ("of: env", "of: 3", &["p.yaml:8:"]),
    ("of: env", "of: null", &["p.yaml:8:"]),
    ("of: env", "of: [env]", &["p.yaml:8:"]),
    ("of: env", "of: ../env", &["p.yaml:8:"]),
    // Values.
    ("count: $n", "count: 0", &["p.yaml:9:", "count"]),
    ("count: $n", "count: -3", &["p.yaml:9:", "count"]),
    ("count: $n", "count: 2.5", &["p.yaml:9:", "count", "integer"]),
    ("count: $n", "count: many", &["p.yaml:9:", "count"]),
    ("count: $n", "count: .nan", &["p.yaml:9:", "count"]),
    ("count: $n", "count: true", &["p.yaml:9:", "count"]),
    ("count: $n", "count: 1e30", &["p.yaml:9:", "count"]),
    ("gamma: $g", "gamma: 0", &["p.yaml:11:", "gamma"]),
    ("gamma: $g", "gamma: .inf", &["p.yaml:11:", "gamma"]),
    ("width: 32", "width: 1000000000", &["p.yaml:7:", "width"]),
    ("{ of: dist, count: $n }", "{ of: dist }", &["p.yaml:9:", "`count`", "missing"]),
    ("{ of: dist, count: $n }", "[dist]", &["p.yaml:9:"]),
    ("{ of: dist, count: $n }", "null", &["p.yaml:9:"]),
    // Substitution.
    ("$n", "$m", &["p.yaml:9:", "`$m`"]),
    ("$n", "${n", &["p.yaml:9:"]),
    ("$n", "$n$n", &["p.yaml:9:"]),
    ("$n", "${n + 1}", &["p.yaml:9:"]),
    ("$g", "$HOME", &["p.yaml:11:", "HOME"]),
    ("$n", "$look.gian", &["p.yaml:9:", "gain"]),
    // Axes and exclusions.
    ("[4, 16]", "[]", &["p.yaml:5:", "n"]),
    ("[4, 16]", "[4, 4.0]", &["p.yaml:5:", "twice"]),
    ("[4, 16]", "4", &["p.yaml:5:"]),
    ("[4, 16]", "{ range: [1, 10, 0] }", &["p.yaml:5:"]),
    ("[4, 16]", "{ linspace: [1, 10] }", &["p.yaml:5:", "linspace"]),
    ("[4, 16]", "{ powers: [2, 0, 5000] }", &["p.yaml:5:"]),
    ("[4, 16]", "{ range: [1, 1000000000, 1] }", &["p.yaml:5:", "the limit is 100000"]),
    ("count: $n }", "count: $n }, exclude: [{ n: 5 }]", &["p.yaml:9:", "`5`"]),
    ("params: { g", "params: { n: 1, g", &["n", "axis"]),
    // Names and files.
    ("ldr:", "\"../ldr\":", &["p.yaml:11:", "../ldr"]),
    ("ldr:", "-ldr:", &["p.yaml:11:"]),
    ("ldr:", "sphere:", &["p.yaml:11:", "sphere"]),
    ("ldr:", "\"\":", &["p.yaml:11:"]),
    ("ldr:", "manifest:", &[]),
    ("synthesize: { name: gradient, width: 32 }", "load: { path: nowhere.pfm }", &["p.yaml:7:", "nowhere.pfm", "no such file"]),
    ("synthesize: { name: gradient, width: 32 }", "load: { path: . }", &["p.yaml:7:", "directory"]),
];

#[test]
fn a_mistake_is_refused_at_its_line_with_the_right_words() {
    let mut faults = Vec::new();
    for (part, instead, texts) in EXCHANGED {
        assert!(CHAIN.contains(part), "{part}");
        let space = Space::new();
        let body = CHAIN.replacen(part, instead, 1);
        space.pipeline(&body);
        let finished = space.run(&["plan", "p.yaml"]);
        if texts.is_empty() {
            assert_eq!(finished.code, 0, "{instead}: {}", finished.stderr);
        } else {
            faults.extend(fault(&space, &finished, &format!("{part} -> {instead}"), texts));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn text_that_is_no_pipeline_is_refused_quickly() {
    let deep = format!("version: 1\npipeline: p\nx: {}1{}\n", "[".repeat(100), "]".repeat(100));
    let laughs: String = (1..12).map(|n| format!("  a{n}: &a{n} [{}]\n", vec![format!("*a{}", n - 1); 9].join(", "))).collect();
    let laughs = format!("version: 1\npipeline: p\nparams:\n  a0: &a0 [x]\n{laughs}stages: {{}}\n");
    let cases: [(&[u8], &[&str]); 17] = [
        (b"", &["p.yaml"]),
        (b"# nothing\n", &["p.yaml"]),
        (b"[1, 2]\n", &["p.yaml:1:"]),
        (b"version: 1\nversion: 1\npipeline: p\nstages: {}\n", &["p.yaml:2:", "version"]),
        (b"version: 2\npipeline: p\nstages: {}\n", &["p.yaml:1:", "version"]),
        (b"pipeline: p\nstages: { a: { synthesize: { name: gradient } } }\n", &["version"]),
        (b"version: 1\nstages: { a: { synthesize: { name: gradient } } }\n", &["pipeline"]),
        (b"version: 1\npipeline: ../p\nstages: { a: { synthesize: { name: gradient } } }\n", &["p.yaml:2:"]),
        (b"version: 1\npipeline: p\n", &["stages"]),
        (b"version: 1\npipeline: p\nstages: {}\n", &["stages"]),
        (b"version: 1\npipeline: p\nstages: { a: { synthesize: { name: gradient }\n", &["p.yaml"]),
        (b"version: 1\npipeline: p\n\tstages: {}\n", &["p.yaml"]),
        (b"version: 1\n---\npipeline: p\n", &["document"]),
        (b"version: 1\npipeline: \xff\n", &["p.yaml:2:", "UTF-8"]),
        (b"version: 1\npipeline: p\0\n", &["p.yaml:2:", "NUL"]),
        (deep.as_bytes(), &["p.yaml:3:", "64"]),
        (laughs.as_bytes(), &["alias"]),
    ];
    let mut faults = Vec::new();
    for (text, said) in cases {
        let space = Space::new();
        space.write("p.yaml", text);
        let case = String::from_utf8_lossy(&text[..text.len().min(100)]).into_owned();
        faults.extend(fault(&space, &space.run(&["check", "p.yaml"]), &case, said));
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn a_wrong_command_line_is_refused_before_anything_is_read() {
    let cases: [(&[&str], &[&str]); 21] = [
        (&["run"], &["FILE"]),
        (&["run", "absent.yaml"], &["absent.yaml", "no such file"]),
        (&["run", "."], &["directory"]),
        (&["run", "p.yaml", "q.yaml"], &["q.yaml"]),
        (&["run", "p.yaml", "--forcee"], &["--force"]),
        (&["run", "p.yaml", "-s", "g"], &["NAME=VALUE"]),
        (&["run", "p.yaml", "-s", "h=1"], &["unknown parameter `h`"]),
        (&["run", "p.yaml", "-s", "n=1"], &["is an axis"]),
        (&["run", "p.yaml", "-a", "g=1"], &["is a parameter"]),
        (&["run", "p.yaml", "-a", "n="], &["no values"]),
        (&["run", "p.yaml", "-a", "n=4,4"], &["twice"]),
        (&["run", "p.yaml", "-a", "n=four"], &["four"]),
        (&["run", "p.yaml", "-a", "look=wram"], &["did you mean `warm`?"]),
        (&["run", "p.yaml", "--seed", "-1"], &["seed"]),
        (&["run", "p.yaml", "--seed", "18446744073709551616"], &["seed"]),
        (&["run", "p.yaml", "--only", "lrd"], &["did you mean `ldr`?"]),
        (&["run", "p.yaml", "--only", "ldr[n=5]"], &["`5`"]),
        (&["run", "p.yaml", "--force", "nothing"], &["nothing"]),
        (&["run", "p.yaml", "--memory", "banana"], &["512MiB"]),
        (&["run", "p.yaml", "-j", "two"], &["two"]),
        (&["run", "p.yaml", "--format", "dot"], &["-n"]),
    ];
    let space = Space::new();
    space.pipeline(CHAIN);
    let faults: Vec<String> =
        cases.into_iter().filter_map(|(arguments, said)| fault(&space, &space.run(arguments), &arguments.join(" "), said)).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn all_mistakes_are_shown_at_once_and_as_json() {
    let space = Space::new();
    space.pipeline(&CHAIN.replace("count: $n", "cuont: $n").replace("save: png", "save: pgn").replace("name: gradient", "name: graident"));
    let finished = space.run(&["check", "p.yaml"]);
    assert_eq!(fault(&space, &finished, "three mistakes", &["p.yaml:7:", "p.yaml:9:", "p.yaml:11:"]), None);
    let json = space.run(&["check", "p.yaml", "--format", "json"]);
    let answer: serde_json::Value = serde_json::from_str(&json.stdout).unwrap();
    let lines: Vec<u64> = answer["diagnostics"].as_array().unwrap().iter().filter_map(|one| one["line"].as_u64()).collect();
    assert!(lines.contains(&7) && lines.contains(&9) && lines.contains(&11), "{lines:?}");
}
