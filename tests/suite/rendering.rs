//! Scenes through the whole program: their mistakes, their files, and renders that go on from earlier ones.

use crate::space::Space;

const SCENE: &str = "camera: { perspective: { origin: [0, 1, 5] } }
film: { resolution: [24, 16] }
sampler: { sobol: { samples_per_pixel: $spp } }
integrator: { path: { max_depth: 3 } }
shapes:
  - { sphere: { radius: 1 }, bsdf: { diffuse: { reflectance: 0.8 } } }
  - { mesh: { path: pyramid.obj }, transform: [{ translate: [1.5, 0, 0] }] }
";

const PYRAMID: &str = "v -1 0 -1\nv 1 0 -1\nv 0 0 1\nv 0 1 0\nf 1 2 4\nf 2 3 4\nf 3 1 4\nf 3 2 1\n";

const PIPELINE: &str = "params: { spp: 4 }
stages:
  env: { load: { path: 'synthetic:gradient' } }
  picture: { render: { env: env, scene: scenes/still.yaml }, save: exr }
";

fn still() -> Space {
    let space = Space::new();
    space.pipeline(PIPELINE).write("scenes/still.yaml", SCENE).write("scenes/pyramid.obj", PYRAMID);
    space
}

/// The first error of `check`, as `FILE:LINE: message; hint`.
fn errors(space: &Space) -> Vec<String> {
    let finished = space.run(&["check", "p.yaml", "--format", "json"]);
    assert_eq!(finished.code, 2, "{}{}", finished.stdout, finished.stderr);
    let found: serde_json::Value = serde_json::from_str(&finished.stdout).unwrap();
    let list = found["diagnostics"].as_array().or(found.as_array()).unwrap_or_else(|| panic!("{found}")).clone();
    let said = |one: &serde_json::Value| {
        let hint = one["hint"].as_str().unwrap_or_default();
        format!("{}:{}: {}; {hint}", one["file"].as_str().unwrap_or_default(), one["line"], one["message"].as_str().unwrap_or_default())
    };
    list.iter().map(said).collect()
}

#[test]
fn mistakes_of_a_scene_are_shown_in_its_own_file_with_the_nearest_word() {
    for (right, wrong, expected) in [
        (
            "radius: 1 }",
            "raduis: 1 }",
            "scenes/still.yaml:6: unknown parameter `raduis` of `scene.shapes[0].sphere`; did you mean `radius`?",
        ),
        ("  - { sphere:", "  - { shpere:", "scenes/still.yaml:6: unknown parameter `shpere` of `scene.shapes[0]`; did you mean `sphere`?"),
        ("{ diffuse: { reflectance: 0.8 } }", "copper", "scenes/still.yaml:6: there is no material `copper`"),
        ("reflectance: 0.8", "reflectance: 1.8", "scenes/still.yaml:6: `scene.shapes[0].bsdf.diffuse.reflectance` must be"),
        ("perspective:", "perspectiv:", "scenes/still.yaml:1: `scene.camera` has no choice `perspectiv`; did you mean `perspective`?"),
        ("origin: [0, 1, 5]", "origin: [0, 0, 0]", "scenes/still.yaml:1: `target` of the camera is its `origin`"),
        ("$spp", "0", "scenes/still.yaml:3: `scene.sampler.sobol.samples_per_pixel` must be"),
        ("$spp", "$ssp", "scenes/still.yaml:3: unknown name `$ssp`"),
        ("pyramid.obj", "pyramide.obj", "scenes/still.yaml:7: input file `pyramide.obj`: no such file; did you mean `pyramid.obj`?"),
        ("max_depth: 3", "max_depth: -1", "scenes/still.yaml:4: `scene.integrator.path.max_depth` must be"),
        ("translate: [1.5, 0, 0]", "scale: 0", "scenes/still.yaml:7: step 1 of the transform"),
        (
            "mesh: { path: pyramid.obj }",
            "box: { min: [0, 0, 0], max: [1, 0, 1] }",
            "scenes/still.yaml:7: `min` of the box must be below `max`",
        ),
        ("mesh: { path: pyramid.obj }", "mesh: { of: pyramid }", "scenes/still.yaml:7: there is no mesh `pyramid`"),
    ] {
        let space = still();
        assert!(SCENE.contains(right));
        space.write("scenes/still.yaml", SCENE.replace(right, wrong));
        let found = errors(&space);
        assert!(found.iter().any(|error| error.starts_with(expected)), "{wrong}: {found:#?}");
    }
}

#[test]
fn a_scene_file_that_is_missing_or_no_map_is_an_error_at_its_name() {
    let space = still();
    space.pipeline(&PIPELINE.replace("still.yaml", "stil.yaml"));
    assert!(errors(&space)[0].contains("no such file"));
    let space = still();
    space.write("scenes/still.yaml", "- a list\n");
    assert!(errors(&space)[0].starts_with("scenes/still.yaml:1: the file must hold a map"));
}

#[test]
fn what_a_scene_names_is_an_input_and_how_it_is_written_is_not() {
    let space = still();
    assert_eq!(space.executed(&[]), 2);
    assert_eq!(space.executed(&[]), 0);
    space.write("scenes/still.yaml", format!("# another comment\n{SCENE}"));
    assert_eq!(space.executed(&[]), 0);
    space.write("scenes/pyramid.obj", PYRAMID.replace("v 0 1 0", "v 0 2 0"));
    assert_eq!(space.executed(&[]), 1);
}

#[test]
fn more_samples_go_on_from_the_store_with_the_bytes_of_one_piece() {
    let exr = |space: &Space| space.read("outputs/p/picture.exr");
    for sampler in ["sobol", "independent"] {
        let write = |space: &Space| {
            space.write("scenes/still.yaml", SCENE.replace("sobol", sampler));
        };
        let (continued, alone) = (still(), still());
        write(&continued);
        write(&alone);
        continued.summary(&["-s", "spp=8"]);
        continued.summary(&["-s", "spp=32"]);
        alone.summary(&["-s", "spp=32"]);
        assert!(exr(&continued) == exr(&alone), "{sampler}");
    }
}

/// The same as `SCENE`, but for its name and the light.
const XML: &str = r#"<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="40"/>
  <transform name="to_world"><lookat origin="0, 1, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
  <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/><rfilter type="box"/></film>
  <sampler type="ldsampler"><integer name="sample_count" value="4"/></sampler></sensor>
<integrator type="path"><integer name="max_depth" value="4"/><integer name="rr_depth" value="4"/></integrator>
<shape type="sphere"><bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf></bsdf></shape>
<shape type="obj"><string name="filename" value="pyramid.obj"/><transform name="to_world"><translate x="1.5"/></transform>
  <bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
</scene>
"#;

#[test]
fn a_scene_of_mitsuba_renders_to_the_bytes_of_the_same_in_yaml() {
    let (ours, theirs) = (still(), still());
    // A PFM, which does not carry the key: it differs by a BSDF that is said, and is the default.
    let pipeline = PIPELINE.replace("save: exr", "save: pfm");
    ours.pipeline(&pipeline);
    theirs.pipeline(&pipeline.replace("still.yaml", "still.xml")).write("scenes/still.xml", XML);
    ours.summary(&[]);
    theirs.summary(&[]);
    assert!(ours.read("outputs/p/picture.pfm") == theirs.read("outputs/p/picture.pfm"));
    // What it names is an input, and what it says is in the key; how it says it is not.
    theirs.write("scenes/still.xml", XML.replace("<shape type=\"sphere\">", "<!-- a ball --><shape type=\"sphere\">"));
    assert_eq!(theirs.executed(&[]), 0);
    theirs.write("scenes/pyramid.obj", PYRAMID.replace("v 0 1 0", "v 0 2 0"));
    assert_eq!(theirs.executed(&[]), 1);
    theirs.write("scenes/still.xml", XML.replace("0.8", "0.7"));
    assert_eq!(theirs.executed(&[]), 1);
}

#[test]
fn mistakes_of_a_scene_of_mitsuba_have_its_lines() {
    let space = still();
    space.pipeline(&PIPELINE.replace("still.yaml", "still.xml"));
    for (right, wrong, expected) in [
        ("type=\"sphere\"", "type=\"shpere\"", "scenes/still.xml:7: `<shape type=\"shpere\">` is not read; did you mean `sphere`?"),
        (
            "value=\"0.8\"",
            "value=\"1.8\"",
            "scenes/still.xml:7: `scene.shapes[0].bsdf.diffuse.reflectance[0]` must be a number from 0 to 1",
        ),
        ("pyramid.obj", "pyramide.obj", "scenes/still.xml:8: input file `pyramide.obj`: no such file; did you mean `pyramid.obj`?"),
        ("</sensor>", "", "scenes/still.xml:10: not well-formed XML"),
    ] {
        space.write("scenes/still.xml", XML.replace(right, wrong));
        let found = errors(&space);
        assert!(found.iter().any(|error| error.starts_with(expected)), "{wrong}: {found:#?}");
    }
}

#[test]
fn media_ask_for_an_integrator_that_sees_them_and_for_a_grey_extinction() {
    let space = still();
    let fog = "  - { box: {}, medium: { homogeneous: { sigma_t: 2 } } }\n";
    let scene = format!("{}{fog}", SCENE.replace("path: {", "volume-path: {"));
    space.write("scenes/still.yaml", &scene);
    space.summary(&[]);
    for (right, wrong, expected) in [
        ("volume-path", "path", "scenes/still.yaml:8: the integrator sees no media; set `integrator: { volume-path: {} }`"),
        ("sigma_t: 2", "sigma_t: [1, 2, 3]", "scenes/still.yaml:8: `scene.shapes[2].medium.homogeneous.sigma_t` must be"),
        ("box: {}, medium", "rectangle: {}, medium", "scenes/still.yaml:8: a medium fills a shape"),
        ("box: {}, medium", "box: {}, bsdf: { mirror: {} }, medium", "scenes/still.yaml:8: no light gets through"),
        ("homogeneous: { sigma_t: 2 }", "grid: {}", "scenes/still.yaml:8: the grid needs"),
        ("homogeneous: { sigma_t: 2 }", "grid: { path: fog.npy }", "scenes/still.yaml:8: input file `fog.npy`: no such file"),
    ] {
        assert!(scene.contains(right), "{right}");
        space.write("scenes/still.yaml", scene.replace(right, wrong));
        let found = errors(&space);
        assert!(found.iter().any(|error| error.starts_with(expected)), "{wrong}: {found:#?}");
    }
}

#[test]
fn biased_tracking_says_so_in_the_manifest() {
    let space = still();
    let fog = "  - { box: {}, medium: { exponential: {} } }\n";
    space.write("scenes/still.yaml", format!("{}{fog}", SCENE.replace("path: {", "volume-path: { tracking: squared-density,")));
    space.summary(&[]);
    assert!(space.manifest().to_string().contains("`tracking: squared-density` (fourth report) is biased"));
}

#[test]
fn meshes_come_from_other_stages_too() {
    let space = still();
    space.pipeline(
        &PIPELINE
            .replace("scene: scenes", "meshes: { pyramid: mesh }, scene: scenes")
            .replace("  picture:", "  mesh: { load: { path: scenes/pyramid.obj, as: mesh } }\n  picture:"),
    );
    let from_file = still();
    space.write("scenes/still.yaml", SCENE.replace("path: pyramid.obj", "of: pyramid"));
    space.summary(&[]);
    from_file.summary(&[]);
    let names = |space: &Space| space.manifest()["jobs"].as_array().unwrap().len();
    assert_eq!((names(&space), names(&from_file)), (3, 2));
}

/// Four pixels of light: 0, 128 and 255 of red.
const PICTURE: &str = "P3\n2 2\n255\n255 0 0  128 0 0\n0 0 0  255 255 255\n";

/// The scene with a picture on the ball, whose parameters are these beside its path.
fn painted(more: &str) -> Space {
    let space = still();
    let bitmap = format!("{{ bitmap: {{ path: picture.ppm {more} }} }}");
    space
        .write("scenes/still.yaml", SCENE.replace("reflectance: 0.8", &format!("reflectance: {bitmap}")))
        .write("scenes/picture.ppm", PICTURE);
    space
}

#[test]
fn a_picture_that_a_scene_names_is_an_input_wherever_it_stands() {
    let space = painted("");
    assert_eq!((space.executed(&[]), space.executed(&[])), (2, 0));
    space.write("scenes/picture.ppm", PICTURE.replace("128", "127"));
    assert_eq!(space.executed(&[]), 1);
    // In a light, and within a normal map over a blend.
    for scene in [
        SCENE.replace("radius: 1 }", "radius: 1 }, emitter: { area: { radiance: { bitmap: { path: picture.ppm } } } }"),
        SCENE.replace(
            "bsdf: { diffuse: { reflectance: 0.8 } }",
            "bsdf: { normal-map: { map: [0.6, 0.5, 1], bsdf: { blend: { weight: { bitmap: { path: picture.ppm } }, first: { diffuse: {} }, second: { mirror: {} } } } } }",
        ),
    ] {
        space.write("scenes/still.yaml", &scene).write("scenes/picture.ppm", PICTURE);
        space.summary(&[]);
        space.write("scenes/picture.ppm", PICTURE.replace("128", "127"));
        assert_eq!(space.executed(&[]), 1, "{scene}");
    }
}

#[test]
fn mistakes_of_pictures_are_shown_at_their_lines() {
    for (more, expected) in [
        (", of: brick", "scenes/still.yaml:6: `path` and `of` both name the picture"),
        (", wrap: repaet", "scenes/still.yaml:6: `scene.shapes[0].bsdf.diffuse.reflectance.bitmap.wrap` has no choice `repaet`"),
        (", scale: [1, 2, 3]", "scenes/still.yaml:6: `scene.shapes[0].bsdf.diffuse.reflectance.bitmap.scale`"),
    ] {
        let found = errors(&painted(more));
        assert!(found.iter().any(|error| error.starts_with(expected)), "{more}: {found:#?}");
    }
    let space = painted("");
    let scene = String::from_utf8(space.read("scenes/still.yaml")).unwrap();
    for (right, wrong, expected) in [
        (
            "path: picture.ppm",
            "path: pictur.ppm",
            "scenes/still.yaml:6: input file `pictur.ppm`: no such file; did you mean `picture.ppm`?",
        ),
        ("path: picture.ppm", "of: brick", "scenes/still.yaml:6: there is no texture `brick` among the stage's `textures`"),
        ("path: picture.ppm", "", "scenes/still.yaml:6: the bitmap needs a `path`"),
    ] {
        space.write("scenes/still.yaml", scene.replace(right, wrong));
        let found = errors(&space);
        assert!(found.iter().any(|error| error.starts_with(expected)), "{wrong}: {found:#?}");
    }
}

#[test]
fn a_picture_that_is_damaged_or_too_bright_fails_its_job_by_name() {
    let space = painted("");
    space.write("scenes/picture.ppm", "P3 no picture");
    space.run(&["run", "p.yaml"]).expect(1, &["picture.ppm", "PPM"]);
    let space = painted(", factor: 2");
    space.run(&["run", "p.yaml"]).expect(1, &["picture.ppm", "column 0 of row 0", "from 0 to 1", "clamp: true"]);
    painted(", factor: 2, clamp: true").summary(&[]);
}

#[test]
fn pictures_come_from_other_stages_too() {
    let space = painted("");
    let scene = String::from_utf8(space.read("scenes/still.yaml")).unwrap();
    let (by_name, by_file) = (painted(""), painted(""));
    by_name.write("scenes/still.yaml", scene.replace("path: picture.ppm", "of: shown"));
    by_name.pipeline(
        &PIPELINE
            .replace("scene: scenes", "textures: { shown: loaded }, scene: scenes")
            .replace("  picture:", "  loaded: { load: { path: scenes/picture.ppm, as: image } }\n  picture:"),
    );
    by_name.summary(&[]);
    by_file.summary(&[]);
    let pixels = |space: &Space| space.manifest()["jobs"].as_array().unwrap().last().unwrap()["outputs"][0]["sha256"].clone();
    assert_eq!(pixels(&by_name), pixels(&by_file));
}

/// A ball alone, with something around it.
const ALONE: &str = "stages:
  env: { synthesize: { name: gradient, width: 32 }, save: pfm }
  picture:
    render:
      ENV
      scene:
        camera: { orthographic: { width: 1 } }
        film: { resolution: [4, 4] }
        sampler: { independent: { samples_per_pixel: 16 } }
        integrator: { path: { max_depth: 1, strategy: bsdf } }
        shapes: [{ sphere: {}, bsdf: { diffuse: { reflectance: 0.5 } } }]
        emitters: [{ environment: { AROUND } }]
    save: npy
";

fn alone(env: &str, around: &str) -> Space {
    let space = Space::new();
    let map = Space::new();
    map.pipeline(&ALONE.replace("ENV", "env: env").replace("AROUND", ""));
    map.summary(&["--only", "env"]);
    space.write("map.pfm", map.read("outputs/p/env.pfm"));
    space.pipeline(&ALONE.replace("ENV", env).replace("AROUND", around));
    space
}

#[test]
fn a_scene_may_name_what_is_around_it() {
    let picture = |env: &str, around: &str| {
        let space = alone(env, around);
        space.summary(&[]);
        space.read("outputs/p/picture.npy")
    };
    for turned in ["", ", rotate_degrees: 70"] {
        let expected = picture("env: env", &format!("strength: 2{turned}"));
        assert_eq!(picture("", &format!("path: map.pfm, strength: 2{turned}")), expected);
    }
    // Half of what comes from everywhere, whatever directions are drawn.
    let same = picture("", "radiance: [1, 2, 4], strength: 2");
    let values: Vec<f32> =
        same[same.len() - 4 * 4 * 3 * 4..].chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect();
    for pixel in values.chunks_exact(3) {
        assert!(pixel.iter().zip([1.0, 2.0, 4.0]).all(|(found, expected)| (found / expected - 1.0).abs() < 1e-5), "{pixel:?}");
    }
}

#[test]
fn only_one_thing_is_around_a_scene() {
    for (env, around, expected) in [
        ("", "path: map.pfm, radiance: 1", "`path` and `radiance` both say what is around the scene"),
        ("env: env", "radiance: 1", "nothing would be seen of `env`"),
        ("", "strength: 1", "the scene asks for the stage's `env`, which is missing"),
    ] {
        let found = errors(&alone(env, around));
        assert!(found.iter().any(|error| error.contains(expected)), "{around}: {found:#?}");
    }
}
