#!/usr/bin/env python3
"""Renders one scene file with `pipeline` and with Mitsuba 3, for each feature that both have, and holds the means together.

    python3 -m venv v && v/bin/pip install mitsuba==3.9.1 numpy
    v/bin/python tests/trials/mitsuba_scenes.py target/release/pipeline [--only NAME,...] [--size 32] [--samples 256] [--seeds 8] [--keep DIR]

Both read the very same XML. Each renders it with several seeds of independent samples; the mean over the picture may differ by
3 standard errors and 0.3 % of it. Columns: the means, their difference in percent and in standard errors, and the
largest |z| of 4 x 4 tiles of the picture: with 8 seeds 5 is nothing unusual among 48 numbers, with 4 seeds 10.

What is there in one of them alone is said in two ways: `nori` is a scene in Nori's XML, which Mitsuba reads in its own; `disney` is our
YAML beside Mitsuba's `principled`, another model: shape (correlation of pixels) and energy are compared and not the means.

Skipped aloud without the wheel, or with another version of it than the one that the tolerances were found with.
"""
import argparse
import pathlib
import subprocess
import sys
import tempfile

VERSION = "3.9.1"
SHARE = 0.003
ERRORS = 3.0
# Of Disney's model, which is another one there.
ENERGY = 0.05
SHAPE = 0.99

# Below the media: where a boundary lies in a surface, Mitsuba goes through both. The means of this scene in its 32 x 24 pixels, with the floor
# in the bottom of the cube: .05656 without a medium, .04005 with one of sigma_t 1e-6; apart from it .05004 and .05004.
FLOOR = """<shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/><translate y="-1.1"/></transform>
  <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.4, 0.3"/></bsdf></bsdf></shape>"""
LAMP = """<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="90"/><translate y="2.5" z="0.5"/></transform>
  <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area"><rgb name="radiance" value="6, 5, 4"/></emitter></shape>"""
LIGHT = """<shape type="rectangle"><transform name="to_world"><scale value="4"/><translate z="5"/><rotate y="1" angle="180"/></transform>
  <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area"><rgb name="radiance" value="0.4, 0.5, 0.6"/></emitter></shape>"""


def ball(bsdf, more=""):
    return f'<shape type="sphere"><float name="radius" value="0.9"/>{bsdf}{more}</shape>'


def rough(kind, distribution, alpha, more=""):
    return (f'<bsdf type="rough{kind}">{more}<string name="distribution" value="{distribution}"/>'
            f'<float name="alpha" value="{alpha}"/></bsdf>')


def quad(inside, to_world=""):
    return f'<shape type="rectangle"><transform name="to_world">{to_world}</transform>{inside}</shape>'


def bitmap(name, file, raw="false"):
    return (f'<texture name="{name}" type="bitmap"><string name="filename" value="{file}"/><boolean name="raw" value="{raw}"/></texture>')


def medium(g, sigma_t=1.5):
    phase = f'<phase type="hg"><float name="g" value="{g}"/></phase>' if g else '<phase type="isotropic"/>'
    return (f'<shape type="cube"><bsdf type="null"/><medium name="interior" type="homogeneous"><float name="sigma_t" value="{sigma_t}"/>'
            f'<rgb name="albedo" value="0.9, 0.8, 0.6"/>{phase}</medium></shape>')


FOG = """<shape type="cube"><bsdf type="null"/><medium name="interior" type="heterogeneous"><float name="scale" value="3"/>
  <volume name="sigma_t" type="gridvolume"><string name="filename" value="fog.vol"/>
    <transform name="to_world"><translate value="-0.5"/><scale value="2"/></transform></volume>
  <volume name="albedo" type="constvolume"><rgb name="value" value="0.9, 0.8, 0.7"/></volume>
  <phase type="hg"><float name="g" value="0.3"/></phase></medium></shape>"""

GOLD = '<string name="material" value="Au"/>'
SPOT = """<emitter type="spot"><transform name="to_world"><lookat origin="1, 2.5, 1.5" target="0, -0.5, 0" up="0, 1, 0"/></transform>
  <rgb name="intensity" value="12, 11, 9"/><float name="cutoff_angle" value="28"/><float name="beam_width" value="15"/></emitter>"""
THIN = '<float name="aperture_radius" value="0.25"/><float name="focus_distance" value="4.2"/>'

SUN = '<emitter type="constant"><rgb name="radiance" value="0.3, 0.4, 0.5"/></emitter>'
SKY = '<emitter type="envmap"><string name="filename" value="sky.exr"/><float name="scale" value="0.7"/>TURN</emitter>'
TURN = '<transform name="to_world"><rotate y="1" angle="50"/></transform>'
TENT = '<shape type="obj"><string name="filename" value="tent.obj"/><boolean name="face_normals" value="true"/><bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.5, 0.2"/></bsdf></shape>'

# The scene "nori", as Nori has it; rectangles are meshes there.
NORI = """<scene>
<integrator type="path_mis"/>
<sampler type="independent"><integer name="sampleCount" value="SAMPLES"/></sampler>
<camera type="perspective"><float name="fov" value="42"/><integer name="width" value="WIDTH"/><integer name="height" value="HEIGHT"/><rfilter type="box"/>
  <transform name="toWorld"><scale value="-1,1,1"/><lookat origin="0.6, 1, 4.4" target="0, 0, 0" up="0, 1, 0"/></transform></camera>
<mesh type="obj"><string name="filename" value="tent.obj"/><bsdf type="diffuse"><color name="albedo" value="0.8, 0.5, 0.2"/></bsdf></mesh>
<mesh type="obj"><string name="filename" value="square.obj"/><bsdf type="diffuse"><color name="albedo" value="0, 0, 0"/></bsdf>
  <transform name="toWorld"><rotate axis="1,0,0" angle="90"/><translate value="0,2.5,0.5"/></transform>
  <emitter type="area"><color name="radiance" value="6, 5, 4"/></emitter></mesh>
<mesh type="sphere"><point name="center" value="1.1,-0.3,0.8"/><float name="radius" value="0.4"/><bsdf type="dielectric"/></mesh>
<emitter type="point"><point name="position" value="-2,2,2"/><color name="power" value="100,100,120"/></emitter>
</scene>"""
POINT = '<emitter type="point"><point name="position" x="-2" y="2" z="2"/><rgb name="intensity" value="7.957747, 7.957747, 9.549297"/></emitter>'
GLASS = '<shape type="sphere"><point name="center" x="1.1" y="-0.3" z="0.8"/><float name="radius" value="0.4"/><bsdf type="dielectric"/></shape>'

DISNEY = {
    "disney plastic": ("base_color: [0.2, 0.5, 0.8], roughness: 0.4", '<rgb name="base_color" value="0.2, 0.5, 0.8"/><float name="roughness" value="0.4"/>'),
    "disney metal": (
        "base_color: [0.9, 0.6, 0.2], roughness: 0.3, metallic: 1",
        '<rgb name="base_color" value="0.9, 0.6, 0.2"/><float name="roughness" value="0.3"/><float name="metallic" value="1"/>',
    ),
    "disney coat": (
        "base_color: [0.7, 0.1, 0.1], roughness: 0.7, clearcoat: 1, clearcoat_gloss: 0.8",
        '<rgb name="base_color" value="0.7, 0.1, 0.1"/><float name="roughness" value="0.7"/><float name="clearcoat" value="1"/><float name="clearcoat_gloss" value="0.8"/>',
    ),
}
# The frame of `xml` with its floor, lamp and light, for a ball of ours.
OURS = """{ camera: { perspective: { origin: [0.6, 1, 4.4], target: [0, 0, 0], up: [0, 1, 0], fov_degrees: 42 } }, film: { resolution: [WIDTH, HEIGHT], filter: { box: {} } },
  sampler: { independent: { samples_per_pixel: SAMPLES } }, integrator: { path: { max_depth: 11 } }, shapes: [
    { rectangle: {}, transform: [{ scale: 3 }, { rotate: { axis: [1, 0, 0], degrees: -90 } }, { translate: [0, -1.1, 0] }], bsdf: { diffuse: { reflectance: [0.5, 0.4, 0.3] } } },
    { rectangle: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: 90 } }, { translate: [0, 2.5, 0.5] }], bsdf: { diffuse: { reflectance: 0 } }, emitter: { area: { radiance: [6, 5, 4] } } },
    { rectangle: {}, transform: [{ scale: 4 }, { translate: [0, 0, 5] }, { rotate: { axis: [0, 1, 0], degrees: 180 } }], bsdf: { diffuse: { reflectance: 0 } }, emitter: { area: { radiance: [0.4, 0.5, 0.6] } } },
    { sphere: { radius: 0.9 }, bsdf: { disney: { BALL, specular_g: burley-2014 } } }] }"""

# By name: the parts, and what of the frame differs from the usual.
SCENES = {
    "diffuse": (FLOOR + LAMP + LIGHT + ball('<bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.5, 0.2"/></bsdf>'), {}),
    "dielectric": (FLOOR + LAMP + LIGHT + ball('<bsdf type="dielectric"/>'), {}),
    "conductor": (FLOOR + LAMP + LIGHT + ball(f'<bsdf type="conductor">{GOLD}</bsdf>'), {}),
    **{
        f"{distribution} {alpha}": (FLOOR + LAMP + LIGHT + ball(rough("conductor", distribution, alpha, GOLD)), {})
        for distribution in ("beckmann", "ggx")
        for alpha in (0.05, 0.25, 0.5)
    },
    **{
        f"rough glass {distribution}": (FLOOR + LAMP + LIGHT + ball(rough("dielectric", distribution, 0.25)), {})
        for distribution in ("beckmann", "ggx")
    },
    "plastic": (FLOOR + LAMP + LIGHT + ball('<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.2, 0.3, 0.6"/></bsdf>'), {}),
    "plastic nonlinear": (
        FLOOR + LAMP + LIGHT
        + ball('<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.7, 0.3, 0.6"/><boolean name="nonlinear" value="true"/></bsdf>'),
        {},
    ),
    "textured quad": (LAMP + LIGHT + quad(f'<bsdf type="twosided"><bsdf type="diffuse">{bitmap("reflectance", "color.exr")}</bsdf></bsdf>'), {}),
    "normal map": (
        LAMP + LIGHT
        + quad(f'<bsdf type="twosided"><bsdf type="normalmap">{bitmap("normalmap", "normals.exr", "true")}'
               '<bsdf type="roughconductor"><string name="material" value="Cu"/><float name="alpha" value="0.3"/></bsdf></bsdf></bsdf>'),
        {},
    ),
    "thin lens": (FLOOR + LAMP + LIGHT + ball('<bsdf type="diffuse"/>'), {"sensor": "thinlens", "lens": THIN}),
    "spot": (FLOOR + SPOT + ball('<bsdf type="diffuse"/>'), {}),
    "textured light": (
        FLOOR + ball('<bsdf type="diffuse"/>')
        + quad(f'<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area">{bitmap("radiance", "color.exr")}</emitter>',
               '<rotate x="1" angle="70"/><translate y="1.8" z="-1"/>'),
        {},
    ),
    "medium g = 0": (FLOOR + LAMP + LIGHT + medium(0), {"integrator": "volpath"}),
    "medium g = 0.6": (FLOOR + LAMP + LIGHT + medium(0.6), {"integrator": "volpath"}),
    "exponential medium": (FLOOR + LAMP + LIGHT + FOG, {"integrator": "volpath"}),
    "constant": (FLOOR + SUN + ball('<bsdf type="diffuse"/>'), {}),
    "map": (FLOOR + SKY.replace("TURN", "") + ball(f'<bsdf type="conductor">{GOLD}</bsdf>'), {}),
    "map turned": (FLOOR + SKY.replace("TURN", TURN) + ball('<bsdf type="diffuse"/>'), {}),
    "flat mesh": (FLOOR + LAMP + LIGHT + TENT, {}),
    "nori": (TENT + LAMP + GLASS + POINT, {"depth": -1}),
    **{name: (FLOOR + LAMP + LIGHT + ball(f'<bsdf type="principled">{theirs}</bsdf>'), {}) for name, (_, theirs) in DISNEY.items()},
}


def xml(parts, size, samples, sensor="perspective", lens="", integrator="path", depth=12):
    return f"""<scene version="3.0.0">
<integrator type="{integrator}"><integer name="max_depth" value="{depth}"/></integrator>
<sensor type="{sensor}">
  <float name="fov" value="42"/><string name="fov_axis" value="x"/>{lens}
  <transform name="to_world"><lookat origin="0.6, 1, 4.4" target="0, 0, 0" up="0, 1, 0"/></transform>
  <film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size * 3 // 4}"/><rfilter type="box"/></film>
  <sampler type="independent"><integer name="sample_count" value="{samples}"/></sampler>
</sensor>
{parts}
</scene>
"""


def inputs(folder):
    """A picture without symmetry, bent normals, and fog that thins out upwards."""
    color = numpy.zeros((4, 6, 3), "f4")
    color[..., 0] = numpy.linspace(0.1, 0.9, 6)
    color[..., 1] = numpy.linspace(0.9, 0.2, 4)[:, None]
    color[1, 2] = [0.05, 0.1, 0.95]
    mitsuba.Bitmap(color).write(str(folder / "color.exr"))
    y, x = numpy.mgrid[0:16, 0:16] / 16 * 2 * numpy.pi
    normals = numpy.stack([0.3 * numpy.sin(x), 0.25 * numpy.cos(y + 0.5), numpy.ones_like(x)], axis=2)
    normals /= numpy.linalg.norm(normals, axis=2, keepdims=True)
    mitsuba.Bitmap(((normals + 1) / 2).astype("f4")).write(str(folder / "normals.exr"))
    y, x = (numpy.mgrid[0:1024, 0:2048] + 0.5) / numpy.array([1024, 2048])[:, None, None]
    sky = numpy.exp(2 * numpy.sin(numpy.pi * y) * numpy.cos(2 * numpy.pi * (x - 0.3)))[..., None] * numpy.array([1, 0.8, 0.5]) + y[..., None]
    mitsuba.Bitmap(sky.astype("f4")).write(str(folder / "sky.exr"))
    corners = "v -0.9 -0.8 0.9\nv 0.9 -0.8 0.9\nv 0.9 -0.8 -0.9\nv -0.9 -0.8 -0.9\nv 0 0.9 0\n"
    (folder / "tent.obj").write_text(corners + "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 4 3 2\nf 4 2 1\n")
    (folder / "square.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3\nf 1 3 4\n")
    height = (numpy.arange(64) + 0.5) / 64 * 2
    fog = numpy.broadcast_to(numpy.exp(-1.5 * height)[None, :, None], (2, 64, 2)).astype("<f4")
    header = b"VOL\x03" + numpy.array([1, 2, 64, 2, 1], "<i4").tobytes() + numpy.array([0, 0, 0, 1, 1, 1], "<f4").tobytes()
    (folder / "fog.vol").write_bytes(header + fog.tobytes())


def ours(program, folder, name, size, samples, seeds):
    sizes = {"WIDTH": size, "HEIGHT": size * 3 // 4, "SAMPLES": samples}
    scene = "scene.xml"
    if name == "nori":
        scene = "nori.xml"
        (folder / scene).write_text(filled(NORI, sizes))
    elif name in DISNEY:
        scene = "scene.yaml"
        (folder / scene).write_text(filled(OURS, sizes | {"BALL": DISNEY[name][0]}))
    text = f"""version: 1
pipeline: both
axes: {{ run: {list(range(1, seeds + 1))} }}
stages:
  picture: {{ render: {{ scene: {scene}, seed: $run }}, save: npy }}
"""
    (folder / "both.yaml").write_text(text)
    done = subprocess.run([program, "run", "both.yaml", "--outputs", "outputs", "-q"], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"our renderer failed:\n{done.stdout}{done.stderr}")
    return numpy.stack([numpy.load(folder / f"outputs/both/picture/run={seed}.npy")[..., :3] for seed in range(1, seeds + 1)])


def filled(text, values):
    for name, value in values.items():
        text = text.replace(name, str(value))
    return text


def theirs(folder, seeds):
    scene = mitsuba.load_file(str(folder / "scene.xml"))
    return numpy.stack([numpy.array(mitsuba.render(scene, seed=1000 + seed))[..., :3] for seed in range(seeds)])


def compared(a, b):
    """Means, their difference in standard errors, and the largest of tiles."""
    def by_seed(x):
        return x.reshape(len(x), -1).mean(1)
    def score(x, y):
        error = numpy.sqrt(x.var(0, ddof=1) / len(x) + y.var(0, ddof=1) / len(y))
        return (x.mean(0) - y.mean(0)) / numpy.where(error > 0, error, numpy.inf), error
    z, error = score(by_seed(a), by_seed(b))
    def tiles(x):
        rows = numpy.array_split(x, 4, axis=1)
        return numpy.stack([part.mean((1, 2)) for row in rows for part in numpy.array_split(row, 4, axis=2)], axis=1)
    worst = numpy.abs(score(tiles(a.astype("f8")), tiles(b.astype("f8")))[0]).max()
    return by_seed(a).mean(), by_seed(b).mean(), float(z), float(error), float(worst)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--only")
    parser.add_argument("--size", type=int, default=32)
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--keep", help="a folder for the scenes and pictures")
    given = parser.parse_args()
    program = str(pathlib.Path(given.program).resolve())
    names = given.only.split(",") if given.only else list(SCENES)
    missed = []
    print(f"{'scene':22} {'ours':>9} {'Mitsuba':>9} {'%':>7} {'z':>6} {'tiles':>6}", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        for name in names:
            folder = pathlib.Path(given.keep or scratch) / name.replace(" ", "-")
            folder.mkdir(parents=True, exist_ok=True)
            inputs(folder)
            parts, frame = SCENES[name]
            (folder / "scene.xml").write_text(xml(parts, given.size, given.samples, **frame))
            a, b = ours(program, folder, name, given.size, given.samples, given.seeds), theirs(folder, given.seeds)
            if given.keep:
                mitsuba.Bitmap(numpy.concatenate([a.mean(0), b.mean(0)], axis=1).astype("f4")).write(str(folder / "both.exr"))
                mitsuba.util.write_bitmap(str(folder / "both.png"), numpy.concatenate([a.mean(0), b.mean(0)], axis=1).astype("f4"))
            mean, other, z, error, worst = compared(a, b)
            is_near = abs(mean - other) <= ERRORS * error + SHARE * other
            shape = ""
            if name in DISNEY:
                alike = numpy.corrcoef(a.mean(0).ravel(), b.mean(0).ravel())[0, 1]
                is_near = abs(mean / other - 1) < ENERGY and alike > SHAPE
                shape = f"  pixels correlate by {alike:.4f}"
            if not is_near:
                missed.append(name)
            print(f"{name:22} {mean:9.5f} {other:9.5f} {100 * (mean / other - 1):7.3f} {z:6.2f} {worst:6.2f}{shape}{'' if is_near else '  MISSED'}", flush=True)
    if missed:
        sys.exit(f"beyond {ERRORS} standard errors and {100 * SHARE} %: {', '.join(missed)}")
    print(f"all {len(names)} within {ERRORS} standard errors and {100 * SHARE} % of the mean, Disney's within {100 * ENERGY} % and correlated by {SHAPE}")


if __name__ == "__main__":
    try:
        import numpy
        import mitsuba
    except ImportError as missing:
        print(f"skipped: {missing}")
        sys.exit(0)
    if mitsuba.__version__ != VERSION:
        print(f"skipped: mitsuba {mitsuba.__version__} is installed, and the tolerances are those of {VERSION}")
        sys.exit(0)
    mitsuba.set_variant("scalar_rgb")
    main()
