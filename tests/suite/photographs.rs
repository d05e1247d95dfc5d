//! Photographs to maps and lights to rigs, from outside: what is published, and what is said of bad sets.

use serde_json::Value as Json;

use crate::space::Space;

/// A PPM of one row.
fn ppm(codes: &[u8]) -> String {
    let pixels: Vec<String> = codes.iter().map(|code| format!("{code} {code} {code}")).collect();
    format!("P3 {} 1 255\n{}\n", codes.len(), pixels.join("\n"))
}

/// Files of a set, and the stage that puts them together, on line 6.
fn assembling(files: &str) -> Space {
    let space = Space::new();
    space.pipeline(&format!("stages:\n  hdr:\n    assemble: {{ files: [{files}] }}\n    save: pfm\n"));
    space.write("short.ppm", ppm(&[40, 250, 9])).write("long.ppm", ppm(&[120, 255, 30]));
    space.write("wide.ppm", ppm(&[1, 2, 3, 4])).write("white.ppm", ppm(&[255, 255, 255]));
    space
}

#[test]
fn photographs_become_an_image_and_what_they_do_not_show_is_counted() {
    let space = assembling("{ path: short.ppm, seconds: 0.25 }, { path: long.ppm, seconds: 2 }");
    let finished = space.run(&["run", "p.yaml"]);
    finished.expect(0, &["1 pixels (33.33 %) are saturated", "`short.ppm` with 0.25 s"]);
    assert!(space.read("outputs/p/hdr.pfm").starts_with(b"PF\n3 1\n"));
    // The key rests on content: the same photographs under other names are the same set.
    space.write("copy.ppm", space.read("short.ppm"));
    let text = String::from_utf8(space.read("p.yaml")).unwrap().replace("short.ppm", "copy.ppm");
    space.write("p.yaml", text);
    assert_eq!(space.executed(&[]), 0);
}

#[test]
fn a_set_that_is_none_is_refused_at_its_line() {
    for (files, words) in [
        ("{ path: short.ppm }, { path: long.ppm, seconds: 2 }", "`seconds`"),
        ("{ path: short.ppm, seconds: 0 }, { path: long.ppm, seconds: 2 }", "greater than 0"),
        ("{ path: short.ppm, seconds: -0.5 }, { path: long.ppm, seconds: 2 }", "greater than 0"),
        ("{ path: short.ppm, seconds: fast }, { path: long.ppm, seconds: 2 }", "`fast`"),
        ("{ path: short.ppm, seconds: 1 }", "one exposure"),
        ("", "no photographs"),
        ("{ path: short.ppm, seconds: 1 }, { path: gone.ppm, seconds: 2 }", "gone.ppm"),
        ("{ path: short.ppm, seconds: 1, stops: 2 }, { path: long.ppm, seconds: 2 }", "`stops`"),
    ] {
        assembling(files).run(&["run", "p.yaml"]).expect(2, &["p.yaml:6:", "stage `hdr`", words]);
    }
}

#[test]
fn sizes_that_differ_and_sets_without_a_middle_tone_fail_by_name() {
    for (files, words) in [
        ("{ path: short.ppm, seconds: 1 }, { path: wide.ppm, seconds: 2 }", "`wide.ppm` has 4 x 1 pixels, but `short.ppm` has 3 x 1"),
        ("{ path: white.ppm, seconds: 1 }, { path: white.ppm, seconds: 2 }", "all are black or saturated (`white.ppm`, `white.ppm`)"),
        ("{ path: short.ppm, seconds: 1 }, { path: p.yaml, seconds: 2 }", "p.yaml"),
    ] {
        let space = assembling(files);
        space.run(&["run", "p.yaml"]).expect(1, &["hdr", words]);
        assert!(!space.path("outputs/p/hdr.pfm").exists());
    }
}

/// Photographs of other stages, with these parameters of `assemble`; its line is 9.
fn sweeping(parameters: &str) -> Space {
    let space = Space::new();
    space.pipeline(&format!(
        "axes:\n  shot: [{{ name: a, stops: -2, seconds: 0.25 }}, {{ name: b, stops: 0, seconds: 1 }}]\nstages:\n  \
         env: {{ synthesize: {{ name: gradient, width: 32 }} }}\n  \
         shots: {{ tone-map: {{ of: env, exposure_stops: $shot.stops }} }}\n  \
         hdr: {{ assemble: {{ {parameters} }}, save: {{ image: pfm, response: csv, range: csv }} }}\n"
    ));
    space
}

#[test]
fn times_come_from_an_axis() {
    let space = sweeping("of: shots, seconds: shot.seconds, response: recovered");
    space.run(&["run", "p.yaml"]).expect(0, &[]);
    let response = String::from_utf8(space.read("outputs/p/hdr.response.csv")).unwrap();
    assert_eq!((response.lines().count(), response.lines().next()), (257, Some("code,r,g,b")));
    let range = String::from_utf8(space.read("outputs/p/hdr.range.csv")).unwrap();
    assert!(range.starts_with("exposures,saturated_pixels,black_pixels,") && range.lines().nth(1).unwrap().starts_with("2,"), "{range}");
}

#[test]
fn axes_without_times_are_refused() {
    sweeping("of: shots").run(&["check", "p.yaml"]).expect(2, &["p.yaml:9:", "exposure times are missing"]);
    sweeping("of: shots, seconds: time").run(&["check", "p.yaml"]).expect(2, &["p.yaml:9:", "`shot`", "`time`"]);
    sweeping("of: shots, seconds: shot.time").run(&["run", "p.yaml"]).expect(1, &["`shots[shot=a]` has no axis or field `shot.time`"]);
    sweeping("of: shots, seconds: shot.name").run(&["run", "p.yaml"]).expect(1, &["hdr"]);
    sweeping("of: shots, seconds: shot.stops").run(&["run", "p.yaml"]).expect(1, &["`-2` seconds", "above 0"]);
    sweeping("of: \"shots[shot=a]\", seconds: shot.seconds").run(&["run", "p.yaml"]).expect(1, &["hdr"]);
}

#[test]
fn a_map_comes_back_from_every_layout() {
    let space = Space::new();
    space.pipeline(
        "axes:\n  layout: [cube-cross, cube-strip, octahedral, angular, mirror-ball]\nstages:\n  \
         env: { synthesize: { name: gradient, width: 32 }, save: pfm }\n  \
         laid: { wrap: { of: env, layout: $layout, size: 48 }, save: png }\n  \
         back: { unwrap: { of: laid, layout: $layout, height: 16 }, save: pfm }\n  \
         turned: { rotate: { of: back, axis: [0, 0, 1], degrees: 90 } }\n  \
         error: { compare: { of: back, to: env, metrics: [rmse] } }\n  \
         errors: { table: { of: error }, save: json }\n",
    );
    space.run(&["run", "p.yaml"]).expect(0, &[]);
    let errors: Json = serde_json::from_slice(&space.read("outputs/p/errors.json")).unwrap();
    let text = errors.to_string();
    assert_eq!(text.matches("mirror-ball").count(), 1, "{text}");
    assert!(space.path("outputs/p/back/layout=angular.pfm").exists());
}

#[test]
fn lights_are_saved_for_other_programs_under_the_extensions_they_want() {
    let space = Space::new();
    space.pipeline(
        "stages:\n  env: { synthesize: { name: gradient, width: 32 } }\n  \
         cut: { median-cut: { of: env, count: 4 }, save: [gltf, usda, pbrt, mitsuba, blender, json] }\n",
    );
    space.run(&["run", "p.yaml"]).expect(0, &[]);
    for (extension, beginning) in [("gltf", "{\n"), ("usda", "#usda 1.0"), ("pbrt", "# 4 dir"), ("xml", "<?xml"), ("py", "# 4 dir")] {
        let text = String::from_utf8(space.read(&format!("outputs/p/cut.{extension}"))).unwrap();
        assert!(text.starts_with(beginning) && text.contains("pipeline p, stage cut"), "{extension}: {text}");
    }
    space.pipeline(
        "stages:\n  env: { synthesize: { name: gradient, width: 32 } }\n  cut: { median-cut: { of: env, count: 4 }, save: xml }\n",
    );
    space.run(&["check", "p.yaml"]).expect(2, &["p.yaml:6:", "`xml`", "`mitsuba`"]);
}
