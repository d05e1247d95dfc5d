#!/usr/bin/env python3
"""Renders one scene file with `pipeline` and with Mitsuba 3, for each feature that both have, and holds the means together.

    python3 -m venv v && v/bin/pip install mitsuba==3.9.1 numpy
    v/bin/python tests/trials/mitsuba_scenes.py target/release/pipeline [--only NAME,...] [--size 32] [--samples 256] [--seeds 8] [--keep DIR]

Both read the very same XML. Each renders it with several seeds of independent samples; the mean over the picture may differ by
3 standard errors and 0.3 % of it. Columns: the means, their difference in percent and in standard errors, and the
largest |z| of 4 x 4 tiles of the picture: with 8 seeds 5 is nothing unusual among 48 numbers, with 4 seeds 10.

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

# Below the media: where a boundary lies in a surface, Mitsuba takes either of them first.
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
}


def xml(parts, size, samples, sensor="perspective", lens="", integrator="path"):
    return f"""<scene version="3.0.0">
<integrator type="{integrator}"><integer name="max_depth" value="12"/></integrator>
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
    height = (numpy.arange(64) + 0.5) / 64 * 2
    fog = numpy.broadcast_to(numpy.exp(-1.5 * height)[None, :, None], (2, 64, 2)).astype("<f4")
    header = b"VOL\x03" + numpy.array([1, 2, 64, 2, 1], "<i4").tobytes() + numpy.array([0, 0, 0, 1, 1, 1], "<f4").tobytes()
    (folder / "fog.vol").write_bytes(header + fog.tobytes())


def ours(program, folder, seeds):
    text = f"""version: 1
pipeline: both
axes: {{ run: {list(range(1, seeds + 1))} }}
stages:
  picture: {{ render: {{ scene: scene.xml, seed: $run }}, save: npy }}
"""
    (folder / "both.yaml").write_text(text)
    done = subprocess.run([program, "run", "both.yaml", "--outputs", "outputs", "-q"], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"our renderer failed:\n{done.stdout}{done.stderr}")
    return numpy.stack([numpy.load(folder / f"outputs/both/picture/run={seed}.npy")[..., :3] for seed in range(1, seeds + 1)])


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
            a, b = ours(program, folder, given.seeds), theirs(folder, given.seeds)
            if given.keep:
                mitsuba.Bitmap(numpy.concatenate([a.mean(0), b.mean(0)], axis=1).astype("f4")).write(str(folder / "both.exr"))
                mitsuba.util.write_bitmap(str(folder / "both.png"), numpy.concatenate([a.mean(0), b.mean(0)], axis=1).astype("f4"))
            mean, other, z, error, worst = compared(a, b)
            is_near = abs(mean - other) <= ERRORS * error + SHARE * other
            if not is_near:
                missed.append(name)
            print(f"{name:22} {mean:9.5f} {other:9.5f} {100 * (mean / other - 1):7.3f} {z:6.2f} {worst:6.2f}{'' if is_near else '  MISSED'}", flush=True)
    if missed:
        sys.exit(f"beyond {ERRORS} standard errors and {100 * SHARE} %: {', '.join(missed)}")
    print(f"all {len(names)} within {ERRORS} standard errors and {100 * SHARE} % of the mean")


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
