//! Commands around the runs: init, completions, man, help; and what a terminal may see.

use crate::space::Space;

#[test]
fn the_starter_runs_without_data_and_is_never_overwritten() {
    let space = Space::new();
    let begun = space.run(&["init", "night-sky"]);
    begun.expect(0, &[]);
    assert!(begun.stdout.contains("pipeline run night-sky.yaml"), "{}", begun.stdout);
    space.run(&["check", "night-sky.yaml"]).expect(0, &[]);
    // As it stands it is meant for a release build.
    let text = String::from_utf8(space.read("night-sky.yaml")).unwrap();
    assert!(text.contains("pipeline: night-sky") && !text.contains('@'), "{text}");
    let small = text.replace("{ load: { path: $map } }", "{ synthesize: { name: studio, width: 32 } }").replace("size: 128", "size: 16");
    space.write("small.yaml", small.replace("1, 8, 1", "1, 2, 1"));
    space.run(&["run", "small.yaml"]).expect(0, &[]);
    assert!(space.read("outputs/night-sky/curve.svg").starts_with(b"<svg"));
    space.run(&["init", "night-sky"]).expect(2, &["exists already"]);
    assert_eq!(space.read("night-sky.yaml"), text.as_bytes());
    for name in ["../x", "", "-x", "a b", "x/y"] {
        space.run(&["init", "--", name]).expect(2, &["is no name"]);
    }
}

#[test]
fn completions_and_manual_pages_come_from_the_definitions() {
    let space = Space::new();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let finished = space.run(&["completions", shell]);
        finished.expect(0, &[]);
        assert!(finished.stdout.contains("keep-going") && finished.stdout.contains("verify"), "{shell}");
    }
    assert!(
        space.run(&["man", "run"]).stdout.contains(".TH pipeline\\-run 1")
            || space.run(&["man", "run"]).stdout.contains(".TH pipeline-run 1")
    );
    space.run(&["man", "rnu"]).expect(2, &["there is no command `rnu`", "verify"]);
    space.run(&["man", "--dir", "man1"]).expect(0, &[]);
    assert!(space.files("man1").contains(&"pipeline-verify.1".to_owned()) && space.files("man1").contains(&"pipeline.1".to_owned()));
}

#[test]
fn every_command_has_help_for_a_newcomer() {
    let space = Space::new();
    let help = space.run(&["--help"]);
    help.expect(0, &[]);
    assert!(help.stdout.contains("pipeline init"), "{}", help.stdout);
    let commands =
        ["run", "plan", "check", "verify", "diff", "which", "watch", "init", "completions", "man", "stages", "schema", "info", "convert"];
    for command in commands {
        let finished = space.run(&[command, "--help"]);
        finished.expect(0, &[]);
        assert!(finished.stdout.contains("Usage:"), "{command}");
    }
}

/// Escape, C1 control, right-to-left override, zero-width space.
const HOSTILE: &str = "x\u{1b}[2J\u{9b}31m\u{202e}\u{200b}y";

/// Runs a command and sees that nothing of the text reaches the terminal as it is.
#[track_caller]
fn expect_escaped(space: &Space, arguments: &[&str]) {
    let finished = space.run(arguments);
    for (stream, text) in [("stdout", &finished.stdout), ("stderr", &finished.stderr)] {
        let odd = text.chars().find(|c| (c.is_control() && *c != '\n' && *c != '\t') || "\u{202e}\u{200b}".contains(*c));
        assert_eq!(odd, None, "{arguments:?} {stream}: {text:?}");
    }
    assert!(!finished.stderr.contains("panicked"), "{}", finished.stderr);
    // The parser of arguments takes terminal sequences out by itself.
    let all = format!("{}{}", finished.stdout, finished.stderr);
    assert!(all.contains("\\u{1b}") || all.contains("\\u{202e}"), "{arguments:?} echoes nothing: {all}");
}

#[test]
fn every_message_that_echoes_text_escapes_it() {
    let space = Space::new();
    let quoted = "\"x\\e[2J\\u009b31m\\u202e\\u200by\"";
    let sky = "sky: { synthesize: { name: gradient, width: 16 } }";
    // Where the hostile text stands, in turn: stage, kind, key, choice, reference, file, parameter, axis value, format, about.
    let bodies = [
        format!("stages:\n  {quoted}: {{ synthesize: {{ name: gradient }} }}\n"),
        format!("stages:\n  a: {{ {quoted}: {{ }} }}\n"),
        format!("stages:\n  a: {{ synthesize: {{ {quoted}: 1 }} }}\n"),
        format!("stages:\n  a: {{ synthesize: {{ name: {quoted} }} }}\n"),
        format!("stages:\n  a: {{ tone-map: {{ of: {quoted} }} }}\n"),
        format!("stages:\n  a: {{ load: {{ path: {quoted} }} }}\n"),
        format!("params: {{ {quoted}: 1 }}\nstages:\n  a: {{ synthesize: {{ name: gradient, width: $z }} }}\n"),
        format!("axes: {{ n: [{quoted}] }}\nstages:\n  a: {{ synthesize: {{ name: gradient, width: $n }} }}\n"),
        format!("stages:\n  {sky}\n  a: {{ tone-map: {{ of: sky }}, save: {quoted} }}\n"),
        format!("stages:\n  {sky}\n  a: {{ tone-map: {{ of: \"sky[{}=1]\" }} }}\n", "x\\e[2J"),
        format!("include: [{quoted}]\nstages:\n  {sky}\n"),
        format!("{quoted}: 1\nstages:\n  {sky}\n"),
    ];
    for body in bodies {
        space.pipeline(&body);
        expect_escaped(&space, &["check", "p.yaml"]);
    }
}

#[test]
fn titles_coordinates_files_and_arguments_are_escaped_wherever_they_are_shown() {
    let space = Space::new();
    let quoted = "\"x\\e[2J\\u009b31m\\u202e\\u200by\"";
    space.pipeline(&format!(
        "axes: {{ look: [{quoted}] }}\nstages:\n  a: {{ synthesize: {{ name: gradient, width: 16 }} }}\n  s: {{ profile: {{ of: d }} }}\n  d: {{ distribution: {{ of: a }} }}\n  t: {{ plot: {{ of: s, x: row, y: [pdf], title: $look }}, save: [svg, png] }}\n"
    ));
    for arguments in [
        ["plan", "p.yaml", "-v"].as_slice(),
        &["plan", "p.yaml", "-v", "--format", "dot"],
        &["plan", "p.yaml", "-v", "--format", "mermaid"],
        &["run", "p.yaml"],
    ] {
        expect_escaped(&space, arguments);
    }
    let published = space.files("outputs/p/t").into_iter().find(|name| name.ends_with(".png")).unwrap();
    expect_escaped(&space, &["which", &format!("outputs/p/t/{published}")]);
    let first = space.manifest()["run_id"].as_str().unwrap().to_owned();
    space.pipeline(&format!(
        "axes: {{ look: [{quoted}] }}\nstages:\n  a: {{ synthesize: {{ name: gradient, width: 32 }} }}\n  s: {{ profile: {{ of: d }} }}\n  d: {{ distribution: {{ of: a }} }}\n  t: {{ plot: {{ of: s, x: row, y: [pdf], title: $look }}, save: [svg, png] }}\n"
    ));
    expect_escaped(&space, &["plan", "p.yaml", "-v"]);
    space.summary(&[]);
    expect_escaped(&space, &["diff", &first, "p"]);
    for arguments in [
        ["run", HOSTILE].as_slice(),
        &["check", HOSTILE],
        &["run", "p.yaml", "-s", &format!("{HOSTILE}=1")],
        &["run", "p.yaml", "-a", &format!("look={HOSTILE}"), "-s", &format!("{HOSTILE}=1")],
        &["run", "p.yaml", "--only", HOSTILE],
        &["run", "p.yaml", "--seed", HOSTILE],
        &["run", "p.yaml", "--memory", HOSTILE],
        &["run", "p.yaml", HOSTILE],
        &[HOSTILE],
        &["stages", HOSTILE],
        &["info", HOSTILE],
        &["convert", HOSTILE, "x.png"],
        &["which", HOSTILE],
        &["verify", HOSTILE],
        &["diff", HOSTILE, "p"],
        &["diff", "p", "p", "--metrics", HOSTILE],
        &["diff", "p", "p", "--only", HOSTILE],
        &["init", HOSTILE],
        &["man", HOSTILE],
        &["completions", HOSTILE],
        &["run", "p.yaml", "--events", &format!("nowhere/{HOSTILE}")],
        &["run", "p.yaml", "--outputs", &format!("p.yaml/{HOSTILE}")],
    ] {
        expect_escaped(&space, arguments);
    }
}

#[test]
fn a_hostile_manifest_is_shown_escaped() {
    let space = Space::new();
    space.pipeline("stages:\n  a: { synthesize: { name: gradient, width: 16 }, save: png }\n").summary(&[]);
    let text = String::from_utf8(space.read("outputs/p/manifest.json")).unwrap();
    let hostile = "x\\u001b[2J\\u202e";
    space.write("kind.json", text.replace("\"kind\":\"synthesize\"", &format!("\"kind\":\"{hostile}\"")));
    expect_escaped(&space, &["diff", "kind.json", "p"]);
    space.write("schema.json", text.replace("pipeline-manifest-1", hostile));
    expect_escaped(&space, &["verify", "schema.json"]);
    space.write("stage.json", text.replace("\"stage\":\"a\"", &format!("\"stage\":\"{hostile}\"")));
    expect_escaped(&space, &["verify", "stage.json"]);
    space.write("spec.json", text.replace("gradient, width", &format!("{hostile}, width")));
    expect_escaped(&space, &["verify", "spec.json"]);
}
