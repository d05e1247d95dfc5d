//! Every option of a scene, tried: each gives a picture, and one that differs from those of the option's other values.
//!
//! One pipeline with a stage for each value. Values of a family stand in one place of the scene; the first one stands
//! there twice, which must give the same content, so that a difference means something.

use crate::space::Space;

/// A subject before a floor under a map and lights; `NAME` are the places of the families.
const SCENE: &str = "{ camera: CAMERA, film: { resolution: [12, 8] FILM }, sampler: SAMPLER, integrator: INTEGRATOR,
      materials: { subject: BSDF },
      shapes: [
        { SHAPE, transform: TRANSFORM, bsdf: subject },
        { sphere: { center: [-1.2, 0.1, 0.4], radius: 0.5 }, bsdf: { rough-conductor: { metal: gold, alpha: 0.3 } } },
        { rectangle: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: -90 } }, { scale: 3 }, { translate: [0, -1, 0] }] },
        { disk: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: 90 } }, { translate: [0, 3, 0] }], bsdf: { diffuse: {} }, emitter: AREA } ],
      emitters: [EMITTERS] }";

/// What stands in each place where another family is tried.
const USUAL: [(&str, &str); 9] = [
    ("CAMERA", "{ perspective: { origin: [0, 1, 5] } }"),
    ("FILM", ""),
    ("SAMPLER", "{ sobol: { samples_per_pixel: 4 } }"),
    ("INTEGRATOR", "{ path: { max_depth: 3 } }"),
    ("BSDF", "{ diffuse: { reflectance: [0.8, 0.5, 0.3] } }"),
    ("SHAPE", "sphere: {}"),
    ("TRANSFORM", "[]"),
    ("AREA", "{ area: { radiance: 2 } }"),
    ("EMITTERS", ""),
];

/// The values of a family; all differ from each other.
const FAMILIES: [(&str, &[&str]); 22] = [
    (
        "CAMERA",
        &[
            "{ perspective: { origin: [0, 1, 5] } }",
            "{ perspective: { origin: [0, 1, 5], target: [0.5, 0, 0] } }",
            "{ perspective: { origin: [0, 1, 5], up: [1, 1, 0] } }",
            "{ perspective: { origin: [0, 1, 5], fov_degrees: 60 } }",
            "{ thin-lens: { origin: [0, 1, 5], aperture_radius: 0.3, focus_distance: 4 } }",
            "{ thin-lens: { origin: [0, 1, 5], aperture_radius: 0.3, focus_distance: 6 } }",
            "{ thin-lens: { origin: [0, 1, 5], target: [0.5, 0, 0], up: [1, 1, 0], fov_degrees: 60, aperture_radius: 0.1, focus_distance: 4 } }",
            "{ orthographic: {} }",
            "{ orthographic: { width: 5 } }",
            "{ orthographic: { origin: [0, 2, 4], target: [0.2, 0, 0], up: [1, 1, 0] } }",
        ],
    ),
    (
        "FILM",
        &[
            "",
            ", filter: { box: { radius: 2 } }",
            ", filter: { tent: {} }",
            ", filter: { tent: { radius: 3 } }",
            ", filter: { gaussian: {} }",
            ", filter: { gaussian: { radius: 3 } }",
            ", filter: { gaussian: { radius: 3, deviation: 1.5 } }",
            ", layers: [albedo]",
            ", layers: [normal]",
            ", layers: [depth]",
            ", layers: [variance]",
            ", layers: [albedo, normal, depth, variance]",
            ", background: transparent",
        ],
    ),
    (
        "SAMPLER",
        &[
            "{ sobol: { samples_per_pixel: 4 } }",
            "{ sobol: { samples_per_pixel: 6 } }",
            "{ sobol: { samples_per_pixel: 4, replicates: 2 } }",
            "{ independent: { samples_per_pixel: 4 } }",
            "{ independent: { samples_per_pixel: 5 } }",
            "{ stratified: { samples_per_pixel: 4 } }",
            "{ stratified: { samples_per_pixel: 5 } }",
            "{ stratified: { samples_per_pixel: 4, replicates: 2 } }",
        ],
    ),
    (
        "INTEGRATOR",
        &[
            "{ path: {} }",
            "{ normals: {} }",
            "{ direct: {} }",
            "{ direct: { strategy: emitter } }",
            "{ direct: { strategy: bsdf } }",
            "{ direct: { environment: uniform } }",
            "{ direct: { mis_compensation: false } }",
            "{ direct: { bsdf_sampling: cosine } }",
            "{ direct: { emitter_samples: 3 } }",
            "{ direct: { emitter_candidates: 1 } }",
            "{ direct: { emitter_candidates: 9 } }",
            "{ direct: { emitter_samples: 2, emitter_candidates: 9 } }",
            "{ path: { max_depth: 0 } }",
            "{ path: { max_depth: 2 } }",
            "{ path: { roulette_depth: 0 } }",
            "{ path: { strategy: emitter } }",
            "{ path: { strategy: bsdf } }",
            "{ path: { environment: uniform } }",
            "{ path: { mis_compensation: false } }",
            "{ path: { bsdf_sampling: cosine } }",
            "{ path: { emitter_candidates: 1 } }",
            "{ path: { clamp_indirect: 0.01 } }",
        ],
    ),
    (
        "SHAPE",
        &[
            "sphere: {}",
            "sphere: { radius: 0.7 }",
            "sphere: { center: [0.3, 0.2, 0] }",
            "rectangle: {}",
            "disk: {}",
            "disk: { radius: 0.7 }",
            "box: {}",
            "box: { min: [-0.5, -0.5, -0.5] }",
            "box: { max: [0.5, 0.6, 0.7] }",
            "mesh: { path: pyramid.obj }",
            "mesh: { path: pyramid.obj, normals: flat }",
            "mesh: { path: triangle.gltf, buffers: [triangle.bin] }",
            "icosphere: { subdivisions: 1 }",
            "icosphere: { subdivisions: 1, radius: 0.8 }",
            "icosphere: { subdivisions: 2, relief: { amplitude: 0.3 } }",
            "icosphere: { subdivisions: 2, relief: { amplitude: 0.3, frequency: 2 } }",
            "icosphere: { subdivisions: 2, relief: { amplitude: 0.3, octaves: 1 } }",
            "icosphere: { subdivisions: 2, relief: { amplitude: 0.3, seed: 4 } }",
            "uv-sphere: { columns: 8, rows: 6 }",
            "uv-sphere: { columns: 9, rows: 6 }",
            "uv-sphere: { columns: 8, rows: 5, radius: 0.8 }",
            "uv-sphere: { columns: 8, rows: 6, relief: { amplitude: 0.3 } }",
            "torus: { columns: 12, rows: 8 }",
            "torus: { columns: 12, rows: 8, radius: 0.8 }",
            "torus: { columns: 12, rows: 8, tube_radius: 0.2 }",
            "knot: { columns: 60, rows: 6 }",
            "knot: { columns: 60, rows: 6, p: 3, q: 4 }",
            "knot: { columns: 60, rows: 6, tube_radius: 0.25 }",
            "knot: { columns: 60, rows: 6, ridges: 0.4 }",
            "blob: { subdivisions: 2 }",
            "blob: { subdivisions: 2, fur: 0.2 }",
            "blob: { subdivisions: 2, fur: 0.2, seed: 9 }",
        ],
    ),
    (
        "TRANSFORM",
        &[
            "[]",
            "[{ scale: 0.5 }]",
            "[{ scale: [1, 0.5, 2] }]",
            "[{ rotate: { axis: [0, 0, 1], degrees: 30 } }, { scale: [1, 0.5, 2] }]",
            "[{ translate: [0.2, 0, 0] }]",
            "[{ matrix: [[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]] }]",
            "[{ scale: [1, 0.5, 2] }, { look-at: { origin: [0, 0, 0], target: [1, 1, 1] } }]",
            "[{ scale: [1, 0.5, 2] }, { look-at: { origin: [0, 0, 0], target: [1, 1, 1], up: [1, 0, 0] } }]",
        ],
    ),
    (
        "BSDF",
        &[
            "{ diffuse: {} }",
            "{ diffuse: { reflectance: 0.8 } }",
            "{ diffuse: { reflectance: [0.8, 0.5, 0.3] } }",
            "{ diffuse: { reflectance: { checker: { a: 0.1, b: [0.9, 0.5, 0.2], scale: 4 } } } }",
            "{ mirror: {} }",
            "{ mirror: { reflectance: 0.5 } }",
            "{ dielectric: {} }",
            "{ dielectric: { eta: 1.2 } }",
            "{ dielectric: { reflectance: 0 } }",
            "{ dielectric: { transmittance: 0.3 } }",
            "{ dielectric: { fresnel: schlick, eta: 2.5 } }",
            "{ dielectric: { eta: 2.5 } }",
            "{ plastic: {} }",
            "{ plastic: { eta: 1.9 } }",
            "{ plastic: { diffuse: 0.9 } }",
            "{ plastic: { diffuse: 0.9, nonlinear: true } }",
            "{ plastic: { specular: 0 } }",
        ],
    ),
    (
        "BSDF",
        &[
            "{ conductor: { metal: aluminum } }",
            "{ conductor: { metal: copper } }",
            "{ conductor: { metal: gold } }",
            "{ conductor: { metal: platinum } }",
            "{ conductor: { metal: silver } }",
            "{ conductor: { metal: ideal } }",
            "{ conductor: { metal: copper, spectrum: three-wavelengths } }",
            "{ conductor: { metal: copper, fresnel: approximate } }",
            "{ conductor: { metal: copper, reflectance: 0.5 } }",
            "{ conductor: { eta: 1.5, k: [1, 2, 3] } }",
        ],
    ),
    (
        "BSDF",
        &[
            "{ rough-conductor: { metal: copper, alpha: 0.3 } }",
            "{ rough-conductor: { metal: gold, alpha: 0.3 } }",
            "{ rough-conductor: { metal: copper, alpha: 0.3, spectrum: three-wavelengths } }",
            "{ rough-conductor: { metal: copper } }",
            "{ rough-conductor: { metal: copper, alpha: { checker: { a: 0.1, b: 0.6, scale: 4 } } } }",
            "{ rough-conductor: { metal: copper, alpha: 0.3, distribution: beckmann } }",
            "{ rough-conductor: { metal: copper, alpha: 0.3, distribution: beckmann, sampling: all-normals } }",
            "{ rough-conductor: { metal: copper, alpha: 0.3, masking: separable } }",
            "{ rough-conductor: { metal: copper, alpha: 0.3, sampling: all-normals } }",
            "{ rough-conductor: { metal: copper, alpha: 0.3, reflectance: 0.5 } }",
            "{ rough-conductor: { metal: copper, alpha: 0.3, fresnel: approximate } }",
            "{ rough-conductor: { eta: 1.5, k: [1, 2, 3], alpha: 0.3 } }",
            "{ rough-conductor: { eta: { checker: { a: 1.5, b: 0.2, scale: 4 } }, k: [1, 2, 3], alpha: 0.3 } }",
            "{ rough-conductor: { eta: 1.5, k: { checker: { a: [1, 2, 3], b: 4, scale: 4 } }, alpha: 0.3 } }",
        ],
    ),
    (
        "BSDF",
        &[
            "{ rough-dielectric: { alpha: 0.3 } }",
            "{ rough-dielectric: { alpha: 0.3, eta: 1.2 } }",
            "{ rough-dielectric: {} }",
            "{ rough-dielectric: { alpha: { checker: { a: 0.1, b: 0.6, scale: 4 } } } }",
            "{ rough-dielectric: { alpha: 0.3, distribution: beckmann } }",
            "{ rough-dielectric: { alpha: 0.3, masking: separable } }",
            "{ rough-dielectric: { alpha: 0.3, sampling: all-normals } }",
            "{ rough-dielectric: { alpha: 0.3, reflectance: 0 } }",
            "{ rough-dielectric: { alpha: 0.3, transmittance: [0.2, 0.5, 0.9] } }",
            "{ rough-dielectric: { alpha: 0.3, fresnel: schlick } }",
        ],
    ),
    ("SHAPE", &["rectangle: {}", "mesh: { of: given }"]),
    (
        "AREA",
        &[
            "{ area: { radiance: 2 } }",
            "{ area: { radiance: [1, 2, 3] } }",
            "{ area: { radiance: { checker: { a: 1, b: 5, scale: 3 } } } }",
        ],
    ),
    (
        "EMITTERS",
        &[
            "",
            "{ environment: { strength: 2 } }",
            "{ environment: { rotate_degrees: 50 } }",
            "{ lights: { strength: 3 } }",
            "{ lights: { rotate_degrees: 100 } }",
            "{ point: { position: [1, 2, 3], intensity: 4 } }",
            "{ point: { position: [-1, 2, 3], intensity: [4, 1, 1] } }",
            "{ directional: { towards: [1, 1, 1], irradiance: 2 } }",
            "{ directional: { towards: [-1, 1, 1], irradiance: [2, 1, 3] } }",
        ],
    ),
    // The back of a surface that is black behind, and of one that is not.
    ("ONE-SIDED", &["{ diffuse: {} }", "{ diffuse: { one_sided: true } }"]),
    ("ONE-SIDED", &["{ mirror: {} }", "{ mirror: { one_sided: true } }"]),
    ("ONE-SIDED", &["{ conductor: { metal: gold } }", "{ conductor: { metal: gold, one_sided: true } }"]),
    ("ONE-SIDED", &["{ rough-conductor: { metal: gold } }", "{ rough-conductor: { metal: gold, one_sided: true } }"]),
    ("ONE-SIDED", &["{ plastic: {} }", "{ plastic: { one_sided: true } }"]),
    (
        "SHAPE",
        &[
            "mesh: { path: smooth.obj, normals: auto }",
            "mesh: { path: smooth.obj, normals: smooth }",
            "mesh: { path: smooth.obj, normals: flat }",
        ],
    ),
    ("SHAPE", &["mesh: { path: pyramid.obj }", "mesh: { path: pyramid.obj, normals: file }"]),
    ("BSDF", &["{ mirror: {} }", "{ mirror: { reflectance: { checker: { a: 1, b: 0.2, scale: 3 } } } }"]),
    ("SAMPLER", &["{ sobol: { samples_per_pixel: 4 } }", "{ sobol: { samples_per_pixel: 4, replicates: 4 } }"]),
];

const PYRAMID: &str = "v -1 0 -1\nv 1 0 -1\nv 0 0 1\nv 0 1 0\nf 1 2 4\nf 2 3 4\nf 3 1 4\nf 3 2 1\n";
/// A roof whose file gives it leaning normals.
const SMOOTH: &str =
    "v -1 -1 0\nv 0 -1 0.6\nv 0 1 0.6\nv 1 -1 0\nvn -0.2 0 1\nvn 0 0.3 1\nvn 0 0 1\nvn 0.5 0 1\nf 1//1 2//2 3//3\nf 2//2 4//4 3//3\n";
const TRIANGLE: &str = r#"{ "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
  "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
  "buffers": [{ "uri": "triangle.bin", "byteLength": 36 }], "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
  "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [-1, -1, 0], "max": [1, 1, 0] }] }"#;

/// The scene with a family's value in its place and the usual ones in all others.
fn scene(family: &str, value: &str) -> String {
    let seen_from_behind = "{ perspective: { origin: [0, 0, -5] } }";
    let place = |name: &str, usual: &str| match family {
        "ONE-SIDED" if name == "BSDF" => value.to_owned(),
        "ONE-SIDED" if name == "SHAPE" => "rectangle: {}".to_owned(),
        "ONE-SIDED" if name == "CAMERA" => seen_from_behind.to_owned(),
        _ if name == family => value.to_owned(),
        _ => usual.to_owned(),
    };
    USUAL.iter().fold(SCENE.to_owned(), |scene, (name, usual)| scene.replacen(name, &place(name, usual), 1))
}

#[test]
fn every_option_of_a_scene_makes_another_picture() {
    let space = Space::new();
    let mut stages = String::from(
        "stages:
  env: { synthesize: { name: studio, width: 64 } }
  cut: { median-cut: { of: env, count: 4 } }
  given: { load: { path: pyramid.obj, as: mesh } }
",
    );
    let mut names = Vec::new();
    for (number, (family, values)) in FAMILIES.iter().enumerate() {
        // The first one twice.
        for (index, value) in values.iter().chain(values.first()).enumerate() {
            let name = format!("f{number}-{index}");
            let scene = scene(family, value);
            stages += &format!("  {name}: {{ render: {{ env: env, lights: cut, meshes: {{ given: given }}, scene: {scene} }} }}\n");
            names.push((number, *family, *value, name));
        }
    }
    let corners = [-1.0_f32, -1.0, 0.0, 1.0, -1.0, 0.0, 0.0, 1.0, 0.0];
    space.pipeline(&stages).write("pyramid.obj", PYRAMID).write("smooth.obj", SMOOTH);
    space.write("triangle.gltf", TRIANGLE).write("triangle.bin", corners.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>());
    space.summary(&[]);
    let manifest = space.manifest();
    let jobs = manifest["jobs"].as_array().unwrap();
    let picture = |name: &str| {
        let job = jobs.iter().find(|job| job["stage"] == name).unwrap_or_else(|| panic!("{name}"));
        job["outputs"].as_array().unwrap().iter().find(|output| output["name"] == "").unwrap()["sha256"].as_str().unwrap()
    };
    let pictures: Vec<_> = names.iter().map(|(number, family, value, name)| (*number, *family, *value, picture(name))).collect();
    for (index, (number, family, value, picture)) in pictures.iter().enumerate() {
        for (other_number, _, other, other_picture) in &pictures[..index] {
            if number == other_number {
                assert_eq!(value == other, picture == other_picture, "{family}: `{value}` and `{other}`");
            }
        }
    }
}
