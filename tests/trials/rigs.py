#!/usr/bin/env python3
"""Other programs read our light rigs, and a diffuse sphere gets the same light there as here.

    python3.11 -m venv v && v/bin/pip install numpy mitsuba usd-core bpy
    npm install --prefix v gltf-validator
    cargo build && v/bin/python tests/trials/rigs.py target/debug/pipeline [MAP] --node v/node_modules

One line per comparison, with what was found and what is allowed; exit 1 if one fails, and what cannot be tried here is
skipped aloud. Every program is a process of its own. pbrt is not to be had as a package: its file is parsed after the
published grammar. With a map of moderate size a run takes some minutes.
"""
import argparse
import json
import math
import os
import pathlib
import re
import subprocess
import sys
import tempfile

from trial import must, pfm

SIZE = 63
COUNT = 64
PIPELINE = f"""
version: 1
pipeline: rigs
params: {{ map: synthetic:cathedral }}
stages:
  env:    {{ load: {{ path: $map, resize: 256 }}, save: [pfm, exr] }}
  cut:    {{ median-cut: {{ of: env, count: {COUNT} }}, save: [json, gltf, usda, pbrt, mitsuba, blender] }}
  lights: {{ relight: {{ with: cut, size: {SIZE}, supersample: 8 }}, save: pfm }}
  exact:  {{ relight: {{ env: env, estimator: exact, size: {SIZE}, supersample: 8 }}, save: pfm }}
  traced:
    render:
      lights: cut
      scene:
        camera: {{ orthographic: {{ origin: [0, 0, 4], target: [0, 0, 0], up: [0, 1, 0], width: 2 }} }}
        film: {{ resolution: [{SIZE}, {SIZE}], filter: {{ box: {{}} }} }}
        sampler: {{ sobol: {{ samples_per_pixel: 1024 }} }}
        integrator: {{ path: {{ max_depth: 1 }} }}
        shapes: [{{ sphere: {{}}, bsdf: {{ diffuse: {{ reflectance: 1 }} }} }}]
    save: pfm
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pipeline", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("map", nargs="?", default="synthetic:cathedral")
    parser.add_argument("--node", type=pathlib.Path, help="folder node_modules with gltf-validator")
    parser.add_argument("--inside", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.inside:
        return PARTS[given.inside[0]](pathlib.Path(given.inside[1]), given)
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        (folder / "p.yaml").write_text(PIPELINE)
        source = given.map if given.map.startswith("synthetic:") else str(pathlib.Path(given.map).resolve())
        subprocess.run([given.pipeline, "run", "p.yaml", "-q", "-s", f"map={source}"], cwd=folder, check=True)
        failed = []
        for part in PARTS:
            command = [sys.executable, __file__, *sys.argv[1:], "--inside", part, str(folder / "outputs/rigs")]
            if subprocess.run(command).returncode != 0:
                failed.append(part)
        if failed:
            print(f"FAILED: {', '.join(failed)}")
            sys.exit(1)


class Skipped(Exception):
    """Why something cannot be tried here."""


def part(function):
    def run(folder, given):
        try:
            function(folder, given)
        except Skipped as reason:
            print(f"skipped: {function.__name__}: {reason}")
        except ImportError as error:
            print(f"skipped: {function.__name__}: {error.name} is not installed")

    return run


def cut(folder):
    """Directions and irradiances of the lights that are not black, from our JSON."""
    import numpy
    lights = json.loads((folder / "cut.json").read_text())["lights"]
    lights = [light for light in lights if max(light["irradiance"]) > 0]
    return (numpy.array([light[field] for light in lights]) for field in ("direction", "irradiance"))


def inside():
    """Pixels that the sphere covers whole."""
    import numpy
    edges = 2 * numpy.arange(SIZE + 1) / SIZE - 1
    far = numpy.maximum(abs(edges[:-1]), abs(edges[1:]))
    return far[None, :] ** 2 + far[:, None] ** 2 < 1


def agreement(what, picture, ours, errors=None, slack=1e-3):
    """Two spheres are one: by their mean light, and pixel by pixel.

    `errors` are standard errors of the pixels of `picture`, for which the mean of their squared z must be near 1.
    """
    import numpy
    covered = inside()
    difference = (picture - ours)[covered]
    scale = ours[covered].mean()
    mean = abs(difference.mean(axis=0)).max() / scale
    rms = math.sqrt((difference**2).mean()) / scale
    if errors is None:
        must(f"{what}: mean difference over the mean", mean, 1e-3)
        must(f"{what}: rms difference over the mean, one of {COUNT} lights a sample", rms, 1e-2)
        return
    z2 = ((difference / numpy.maximum(errors[covered], 1e-4 * scale)) ** 2).mean()
    of_mean = math.sqrt((errors[covered] ** 2).mean() / covered.sum()) / scale
    must(f"{what}: mean difference over the mean, whose standard error is {of_mean:.1e}", mean, 4 * of_mean + slack)
    must(f"{what}: rms difference over the mean {rms:.1e}; mean squared z", z2, 1.3)


@part
def ours(folder, _):
    agreement("render: lights against relight: lights", pfm(folder / "traced.pfm"), pfm(folder / "lights.pfm"))


@part
def gltf(folder, given):
    import numpy
    document = json.loads((folder / "cut.gltf").read_text())
    directions, irradiances = cut(folder)
    lights = document["extensions"]["KHR_lights_punctual"]["lights"]
    for node, direction, irradiance in zip(document["nodes"], directions, irradiances, strict=True):
        light = lights[node["extensions"]["KHR_lights_punctual"]["light"]]
        assert numpy.allclose(turned(node["rotation"], [0, 0, -1]), -direction, atol=1e-12)
        assert numpy.allclose(numpy.array(light["color"]) * light["intensity"], irradiance, rtol=1e-12, atol=0)
    print(f"gltf: {len(lights)} directions and irradiances are ours")
    if given.node is None or not (given.node / "gltf-validator").is_dir():
        raise Skipped("gltf-validator is not installed; say where by --node")
    script = (
        "const v = require('gltf-validator'), fs = require('fs');"
        "v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])), {maxIssues: 0}).then(r =>"
        " console.log(JSON.stringify([v.version(), r.issues])))"
    )
    environment = {**os.environ, "NODE_PATH": str(given.node.resolve())}
    found = subprocess.run(["node", "-e", script, folder / "cut.gltf"], env=environment, check=True, capture_output=True, text=True)
    version, issues = json.loads(found.stdout)
    must(f"gltf: gltf-validator {version}: errors, warnings and hints", sum(issues[f"num{sort}"] for sort in ("Errors", "Warnings", "Hints")), 0)


def turned(quaternion, vector):
    import numpy
    axis, real = numpy.array(quaternion[:3]), quaternion[3]
    twice = 2 * numpy.cross(axis, vector)
    return vector + real * twice + numpy.cross(axis, twice)


@part
def usda(folder, _):
    import numpy
    from pxr import Gf, Usd, UsdGeom, UsdLux
    stage = Usd.Stage.Open(str(folder / "cut.usda"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and stage.GetDefaultPrim().GetName() == "lights"
    prims = [prim for prim in stage.Traverse() if prim.IsA(UsdLux.DistantLight)]
    worst = [0.0, 0.0]
    for prim, direction, irradiance in zip(prims, *cut(folder), strict=True):
        light = UsdLux.DistantLight(prim)
        assert light.GetNormalizeAttr().Get() and abs(light.GetAngleAttr().Get() - 0.53) < 1e-6 and light.GetExposureAttr().Get() == 0
        world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
        shines = numpy.array(world.TransformDir(Gf.Vec3d(0, 0, -1)))
        found = light.GetIntensityAttr().Get() * numpy.array(light.GetColorAttr().Get())
        worst = [max(worst[0], abs(shines + direction).max()), max(worst[1], abs(found - irradiance).max() / irradiance.max())]
    version = ".".join(map(str, Usd.GetVersion()))
    must(f"usda: usd-core {version}: {len(prims)} directions", worst[0], 1e-12)
    must("usda: irradiances, relative (single precision)", worst[1], 2e-7)


# After "pbrt-v4 input file format": what a light source may be given, with types.
DISTANT = {"L": ("rgb", 3), "from": ("point3", 3), "to": ("point3", 3), "illuminance": ("float", 1), "scale": ("float", 1)}
TOKEN = re.compile(r'\s*(?:#[^\n]*)?(?:(?P<open>\[)|(?P<close>\])|"(?P<text>[^"\\\n]*)"|(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?=[\s\]])|(?P<word>[A-Za-z]+))')


def pbrt_tokens(text):
    position = 0
    rest = re.compile(r"(?:\s|#[^\n]*(?:\n|$))*")
    while True:
        position = rest.match(text, position).end()
        if position == len(text):
            return
        found = TOKEN.match(text, position)
        assert found, f"no token at {text[position:position + 40]!r}"
        yield found.lastgroup, found[found.lastgroup]
        position = found.end()


@part
def pbrt(folder, _):
    """Directive, type, then `"type name"` with a list in brackets or a single value; nothing else."""
    import numpy
    tokens = list(pbrt_tokens((folder / "cut.pbrt").read_text()))
    lights = []
    while tokens:
        assert tokens.pop(0) == ("word", "LightSource") and tokens.pop(0) == ("text", "distant")
        values = {}
        while tokens and tokens[0][0] == "text":
            sort, name = tokens.pop(0)[1].split()
            expected, count = DISTANT[name]
            assert sort == expected and name not in values
            assert tokens.pop(0)[0] == "open"
            numbers = []
            while tokens[0][0] == "number":
                numbers.append(float(tokens.pop(0)[1]))
            assert tokens.pop(0)[0] == "close" and len(numbers) == count
            values[name] = numpy.array(numbers)
        lights.append(values)
    worst = 0.0
    for light, direction, irradiance in zip(lights, *cut(folder), strict=True):
        way = light["from"] - light["to"]
        worst = max(worst, abs(way / numpy.linalg.norm(way) - direction).max(), abs(light["L"] - irradiance).max())
    must(f"pbrt: {len(lights)} directions and irradiances by the published grammar", worst, 1e-15)


def mitsuba_sphere(mi, lights, samples):
    """Two independent pictures of the diffuse sphere: their mean and the standard errors of its pixels."""
    import numpy
    scene = {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True},
        "sphere": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}},
        "sensor": {
            "type": "orthographic",
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 4], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32"},
            "sampler": {"type": "independent", "sample_count": samples},
        },
        **lights,
    }
    loaded = mi.load_dict(scene)
    pictures = numpy.array([numpy.array(mi.render(loaded, seed=seed)) for seed in range(8)], dtype="f8")
    return pictures.mean(axis=0), smoothed(pictures.std(axis=0, ddof=1) / math.sqrt(len(pictures)))


def smoothed(errors):
    """Standard errors from eight pictures are themselves noisy: the root mean square over 5 x 5 pixels and the channels' own."""
    import numpy
    covered = inside()[..., None].astype("f8")
    def box(values):
        padded = numpy.pad(values, ((2, 2), (2, 2), (0, 0)))
        return sum(padded[y:y + SIZE, x:x + SIZE] for y in range(5) for x in range(5))
    return numpy.sqrt(box(errors**2 * covered) / numpy.maximum(box(covered), 1))


@part
def mitsuba(folder, _):
    import numpy
    import mitsuba as mi
    mi.set_variant("scalar_rgb")
    rig = mi.load_file(str(folder / "cut.xml"))
    directions, irradiances = cut(folder)
    emitters = rig.emitters()
    assert len(emitters) == len(irradiances)
    found = [mi.traverse(emitter) for emitter in emitters]
    shines = numpy.array([numpy.array(values["to_world"].matrix)[:3, 2] for values in found])
    light = numpy.array([numpy.array(values["irradiance.value"]).ravel() for values in found])
    order = numpy.array([numpy.argmin(abs(shines + direction).max(axis=1)) for direction in directions])
    assert len(set(order)) == len(order)
    must(f"mitsuba {mi.__version__}: {len(order)} directions", abs(shines[order] + directions).max(), 1e-6)
    must("mitsuba: irradiances, relative", (abs(light[order] - irradiances) / irradiances.max(axis=1)[:, None]).max(), 1e-6)
    included = {f"light{index}": emitter for index, emitter in enumerate(emitters)}
    picture, errors = mitsuba_sphere(mi, included, 512)
    agreement("mitsuba: the sphere under the rig against relight: lights", picture, pfm(folder / "lights.pfm"), errors)

    # Mitsuba has rows on the poles, interpolates, and begins a quarter of a turn further. Each pixel of the map is made
    # 16 x 16 of the same color: then its reading is ours but for a thirty-second of a pixel.
    pixels = numpy.roll(numpy.kron(pfm(folder / "env.pfm"), numpy.ones((16, 16, 1))), 1024, axis=1)
    environment = {"type": "envmap", "bitmap": mi.Bitmap(pixels.astype("f4")), "scale": 1.0}
    picture, errors = mitsuba_sphere(mi, {"environment": environment}, 512)
    agreement("mitsuba: the sphere under the map against relight: exact", picture, pfm(folder / "exact.pfm"), errors)


@part
def blender(folder, _):
    import numpy
    import bpy
    bpy.ops.wm.read_factory_settings(use_empty=True)
    directions, irradiances = cut(folder)
    exec(compile((folder / "cut.py").read_text(), "cut.py", "exec"), {})
    suns("the script", irradiances, directions)
    picture, errors = blender_sphere(folder)
    agreement("blender: the sphere under the script's suns against relight: lights", picture, pfm(folder / "lights.pfm"), errors)
    for name, load in (
        ("glTF, unitless mode", lambda: bpy.ops.import_scene.gltf(filepath=str(folder / "cut.gltf"), export_import_convert_lighting_mode="COMPAT")),
        # Blender makes four units of a sun's strength of one of intensity, whatever angle and normalize are.
        ("USD, a quarter", lambda: bpy.ops.wm.usd_import(filepath=str(folder / "cut.usda"), import_lights=True, light_intensity_scale=0.25)),
    ):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        load()
        suns(f"its importer of {name}", irradiances, directions)

    # Without interpolation Blender reads a lat-long map as we do, the same way round, but half a turn further.
    bpy.ops.wm.read_factory_settings(use_empty=True)
    world = bpy.context.scene.world = bpy.data.worlds.new("world")
    world.use_nodes = True
    nodes = world.node_tree.nodes
    texture, background = nodes.new("ShaderNodeTexEnvironment"), nodes.new("ShaderNodeBackground")
    texture.image = bpy.data.images.load(str(folder / "env.exr"))
    texture.image.colorspace_settings.name = "Non-Color"
    texture.interpolation = "Closest"
    texture.texture_mapping.rotation[2] = math.pi
    output = next((node for node in nodes if node.type == "OUTPUT_WORLD"), None) or nodes.new("ShaderNodeOutputWorld")
    world.node_tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    world.node_tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 1024
    picture, errors = blender_sphere(folder)
    # The mean was found to differ by 2e-3, perhaps since the sphere's flat parts hide light that grazes them.
    agreement("blender: the sphere under the map against relight: exact", picture, pfm(folder / "exact.pfm"), errors, slack=4e-3)


def blender_sphere(folder):
    """Cycles' picture of a white diffuse sphere under what is in the scene: mean of eight and standard errors."""
    import numpy
    import bpy
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=512, ring_count=256, radius=1)
    sphere = bpy.context.object
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("white")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    material.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    sphere.data.materials.append(material)
    for lamp in bpy.data.lights:
        # The sphere is made of flat parts, which would shadow themselves where light grazes.
        lamp.use_shadow = False
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 2.0
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(scene.camera)
    # From our +z, which is Blender's -y.
    scene.camera.location, scene.camera.rotation_euler = (0, -4, 0), (math.pi / 2, 0, 0)
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = "CPU", 256, False, False
    cycles.pixel_filter_type, cycles.sample_clamp_indirect = "BOX", 0
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    pictures = []
    for seed in range(8):
        cycles.seed = seed
        scene.render.filepath = str(folder / f"blender{seed}.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pictures.append(numpy.array(image.pixels[:]).reshape(SIZE, SIZE, 4)[::-1, :, :3])
    pictures = numpy.array(pictures)
    return pictures.mean(axis=0), smoothed(pictures.std(axis=0, ddof=1) / math.sqrt(len(pictures)))


def suns(what, irradiances, directions):
    """The suns in Blender have our irradiances and directions, in its axes."""
    import numpy
    import bpy
    import mathutils
    bpy.context.view_layer.update()
    lamps = sorted((lamp for lamp in bpy.data.objects if lamp.type == "LIGHT"), key=lambda lamp: lamp.name)
    assert len(lamps) == len(irradiances) and all(lamp.data.type == "SUN" for lamp in lamps), [lamp.name for lamp in lamps]
    light = numpy.array([lamp.data.energy * numpy.array(lamp.data.color) for lamp in lamps])
    towards = numpy.array([lamp.matrix_world.to_quaternion() @ mathutils.Vector((0, 0, 1)) for lamp in lamps])
    expected = numpy.stack([directions[:, 0], -directions[:, 2], directions[:, 1]], axis=1)
    version = ".".join(map(str, bpy.app.version))
    must(f"blender {version}, {what}: directions", abs(towards - expected).max(), 2e-6)
    must(f"blender, {what}: irradiances, relative", (abs(light - irradiances) / irradiances.max(axis=1)[:, None]).max(), 1e-6)


PARTS = {"ours": ours, "gltf": gltf, "usda": usda, "pbrt": pbrt, "mitsuba": mitsuba, "blender": blender}

if __name__ == "__main__":
    main()
