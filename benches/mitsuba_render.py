#!/usr/bin/env python3
"""Renders the scenes of issue 5 with `pipeline` and with Mitsuba 3, one after the other, and prints them side by side.

  PIPELINE_BIN=target/release/pipeline python3 benches/mitsuba_render.py [--size 512] [--variants scalar_rgb,llvm_ad_rgb]
      [--counts 8,64] [--scenes sphere,mesh,box,diffuse,glass,metal] [--venv DIR]

Needs the network once: installs the wheels `mitsuba` and `numpy` by name into a virtual environment (the variant
llvm_ad_rgb also needs Debian's libllvm). Per scene and program: million samples per processor second between the two
sample counts, so that start-up and loading do not count; processor seconds of the whole process at the smaller count; and
relMSE x samples at the larger count from two seeds, mean((a - b)^2 / (2 (m^2 + 0.01))), with the difference of the two
programs' mean images (the maps' azimuths differ, so only scenes without a map can be compared there).
Processor time is that of the child process; both programs use all cores.
"""
import argparse, json, os, resource, subprocess, sys, tempfile, venv

MITSUBA = r"""
import json, sys
job = json.loads(sys.argv[1])
import mitsuba as mi
mi.set_variant(job["variant"])
import numpy as np
T = mi.ScalarTransform4f
size = job["size"]

def camera(origin, target, degrees):
    return {"type": "perspective", "fov": degrees, "fov_axis": "x", "to_world": T().look_at(origin=origin, target=target, up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
            "sampler": {"type": "independent", "sample_count": job["samples"]}}

WHITE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
BSDFS = {
    "sphere": WHITE, "mesh": WHITE,
    "diffuse": {"type": "twosided", "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}},
    "glass": {"type": "dielectric", "int_ior": 1.45, "ext_ior": 1.0},
    "metal": {"type": "roughconductor", "material": "Cu", "alpha": 0.25, "distribution": "ggx"},
}

def wall(scale, axis, degrees, move, color):
    to_world = T().translate(move)
    if degrees: to_world = to_world @ T().rotate(axis, degrees)
    return {"type": "rectangle", "to_world": to_world @ T().scale(scale), "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}}}

name = job["scene"]
scene = {"type": "scene", "integrator": {"type": "path", "max_depth": job["depth"] + 1}}
if name == "box":
    scene["camera"] = camera([0, 1, 4.2], [0, 1, 0], 38)
    white = [0.7] * 3
    scene["floor"] = wall([1.3, 1, 1], [1, 0, 0], -90, [0, 0, 0], white)
    scene["ceiling"] = wall([1.3, 1, 1], [1, 0, 0], 90, [0, 2, 0], white)
    scene["back"] = wall([1.3, 1, 1], [0, 1, 0], 0, [0, 1, -1], white)
    scene["left"] = wall([1, 1, 1], [0, 1, 0], 90, [-1.3, 1, 0], [0.6, 0.08, 0.06])
    scene["right"] = wall([1, 1, 1], [0, 1, 0], -90, [1.3, 1, 0], [0.08, 0.12, 0.55])
    scene["mirror"] = {"type": "sphere", "center": [-0.55, 0.42, -0.35], "radius": 0.42, "b": {"type": "conductor", "material": "none"}}
    scene["glass"] = {"type": "sphere", "center": [0.55, 0.42, 0.25], "radius": 0.42, "b": {"type": "dielectric", "int_ior": 1.45, "ext_ior": 1.0}}
    scene["lamp"] = {"type": "rectangle", "to_world": T().translate([0, 1.99, 0]) @ T().rotate([1, 0, 0], 90) @ T().scale(0.35),
                     "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
                     "e": {"type": "area", "radiance": {"type": "rgb", "value": [12, 11, 9]}}}
else:
    scene["camera"] = camera([0, 0, 4], [0, 0, 0], 36)
    shape = {"type": "sphere"} if name == "sphere" else {"type": "ply", "filename": job["mesh"]}
    scene["shape"] = {**shape, "b": BSDFS[name]}
    scene["env"] = {"type": "envmap", "filename": job["map"]}
images = [np.array(mi.render(mi.load_dict(scene), seed=seed)).astype("<f4") for seed in job["seeds"]]
np.save(job["out"], np.stack(images))
"""

COMPARE = r"""
import sys, numpy as np
a, b = (x.astype("f8")[..., :3] for x in np.load(sys.argv[1]))
m = (a + b) / 2
print(float(((a - b) ** 2 / (2 * (m * m + 0.01))).mean()), float(m.mean()))
"""

STACK = "import sys, numpy as np; np.save(sys.argv[1], np.stack([np.load(p) for p in sys.argv[2:]]))"


def run(command, **options):
    """Processor seconds of a command and its threads."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, **options)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command[:3]))} failed:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


BOX = """
            - { rectangle: {}, transform: [{ scale: [1.3, 1, 1] }, { rotate: { axis: [1, 0, 0], degrees: -90 } }], bsdf: white }
            - { rectangle: {}, transform: [{ scale: [1.3, 1, 1] }, { rotate: { axis: [1, 0, 0], degrees: 90 } }, { translate: [0, 2, 0] }], bsdf: white }
            - { rectangle: {}, transform: [{ scale: [1.3, 1, 1] }, { translate: [0, 1, -1] }], bsdf: white }
            - { rectangle: {}, transform: [{ rotate: { axis: [0, 1, 0], degrees: 90 } }, { translate: [-1.3, 1, 0] }], bsdf: { diffuse: { reflectance: [0.6, 0.08, 0.06] } } }
            - { rectangle: {}, transform: [{ rotate: { axis: [0, 1, 0], degrees: -90 } }, { translate: [1.3, 1, 0] }], bsdf: { diffuse: { reflectance: [0.08, 0.12, 0.55] } } }
            - { sphere: { center: [-0.55, 0.42, -0.35], radius: 0.42 }, bsdf: { mirror: {} } }
            - { sphere: { center: [0.55, 0.42, 0.25], radius: 0.42 }, bsdf: { dielectric: { eta: 1.45 } } }
            - { rectangle: {}, transform: [{ scale: 0.35 }, { rotate: { axis: [1, 0, 0], degrees: 90 } }, { translate: [0, 1.99, 0] }], bsdf: { diffuse: { reflectance: 0 } }, emitter: { area: { radiance: [12, 11, 9] } } }"""

BSDFS = {
    "sphere": "{ diffuse: { reflectance: 1 } }",
    "mesh": "{ diffuse: { reflectance: 1 } }",
    "diffuse": "{ diffuse: { reflectance: 0.5 } }",
    "glass": "{ dielectric: { eta: 1.45 } }",
    "metal": "{ rough-conductor: { metal: copper, alpha: 0.25, distribution: ggx } }",
}
DEPTHS = {"sphere": 2, "mesh": 2, "box": 8, "diffuse": 8, "glass": 8, "metal": 8}


def scene(name, folder, size, samples):
    if name == "box":
        env, shapes, view = "", BOX, "{ origin: [0, 1, 4.2], target: [0, 1, 0], fov_degrees: 38 }"
    else:
        shape = "{ sphere: {}" if name == "sphere" else f"{{ mesh: {{ path: {mesh(name, folder)} }}"
        env, view = "env: map", "{ origin: [0, 0, 4], target: [0, 0, 0], fov_degrees: 36 }"
        shapes = f"\n            - {shape}, bsdf: {BSDFS[name]} }}"
    return f"""version: 1
pipeline: bench
stages:
  map: {{ load: {{ path: {folder}/map.exr }} }}
  picture:
    render:
      {env}
      scene:
        camera: {{ perspective: {view} }}
        film: {{ resolution: [{size}, {size}] }}
        sampler: {{ sobol: {{ samples_per_pixel: {samples} }} }}
        integrator: {{ path: {{ max_depth: {DEPTHS[name]} }} }}
        materials: {{ white: {{ diffuse: {{ reflectance: 0.7 }} }} }}
        shapes: {shapes}
    save: npy
"""


def mesh(name, folder):
    return f"{folder}/{'thousands' if name == 'mesh' else 'million'}.ply"


def ours(pipeline, python, folder, name, size, samples, seeds):
    """Processor seconds of the first seed, and the file of all pictures."""
    spec = f"{folder}/bench.yaml"
    open(spec, "w").write(scene(name, folder, size, samples))
    seconds, files = None, []
    for seed in seeds:
        out = tempfile.mkdtemp(dir=folder)
        spent, _ = run([pipeline, "run", spec, "--outputs", out, "--seed", str(seed), "--only", "picture", "-q"])
        seconds = spent if seconds is None else seconds
        files.append(f"{out}/bench/picture.npy")
    stacked = f"{folder}/ours.npy"
    run([python, "-c", STACK, stacked, *files])
    return seconds, stacked


def mitsuba(python, variant, folder, name, size, samples, seeds):
    """Processor seconds, and the file of all pictures."""
    out = f"{folder}/mitsuba.npy"
    job = {"variant": variant, "scene": name, "size": size, "samples": samples, "seeds": seeds, "depth": DEPTHS[name],
           "mesh": mesh(name, folder), "map": f"{folder}/map.exr", "out": out}
    seconds, _ = run([python, "-c", MITSUBA, json.dumps(job)])
    return seconds, out


def prepare(pipeline, folder):
    """The map: a dim interior with small windows, dynamic range 1e5."""
    spec = "version: 1\npipeline: make\nstages:\n  map: { synthesize: { name: cathedral }, save: exr }\n"
    open(f"{folder}/make.yaml", "w").write(spec)
    run([pipeline, "run", f"{folder}/make.yaml", "--outputs", f"{folder}/made", "-q"])
    os.rename(f"{folder}/made/make/map.exr", f"{folder}/map.exr")


def sphere_ply(path, columns, rows, relief, python):
    """A sphere of triangles, displaced by a few waves where `relief` is not zero."""
    code = r"""
import sys, numpy as np
path, columns, rows, relief = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
theta, phi = np.meshgrid(np.pi * np.arange(rows + 1) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij")
d = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], -1)
waves = sum(np.sin(f * d @ np.array(k) + f) / f for f, k in [(4, (1, .3, .2)), (9, (-.4, 1, .5)), (21, (.2, -.6, 1)), (47, (1, 1, -1)), (101, (-1, .5, .8))])
points = (d * (1 + relief * waves)[..., None]).reshape(-1, 3).astype("<f4")
r, c = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
a, b = r * columns + c, r * columns + (c + 1) % columns
quads = [np.stack([a, a + columns, b + columns], -1)[:-1], np.stack([a, b + columns, b], -1)[1:]]
faces = np.concatenate([q.reshape(-1, 3) for q in quads])
rows_of = np.empty(len(faces), dtype=[("n", "u1"), ("v", "<i4", 3)]); rows_of["n"] = 3; rows_of["v"] = faces
head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
open(path, "wb").write(head.encode() + points.tobytes() + rows_of.tobytes())
"""
    run([python, "-c", code, path, str(columns), str(rows), str(relief)])


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--size", type=int, default=512)
    options.add_argument("--variants", default="scalar_rgb,llvm_ad_rgb")
    options.add_argument("--counts", default="8,64")
    options.add_argument("--scenes", default="sphere,mesh,box,diffuse,glass,metal")
    options.add_argument("--venv")
    options = options.parse_args()
    pipeline = os.path.abspath(os.environ.get("PIPELINE_BIN", "target/release/pipeline"))
    few, many = (int(count) for count in options.counts.split(","))
    with tempfile.TemporaryDirectory() as folder:
        home = options.venv or f"{folder}/venv"
        python = f"{home}/bin/python"
        if not os.path.exists(python):
            venv.create(home, with_pip=True)
        run([python, "-m", "pip", "-q", "install", "mitsuba", "numpy"])
        prepare(pipeline, folder)
        sphere_ply(f"{folder}/thousands.ply", 128, 64, 0, python)
        sphere_ply(f"{folder}/million.ply", 1000, 500, 0.2, python)
        print(f"{'scene':8} {'program':12} {'Msamples/cpu-s':>15} {f'cpu-s at {few}':>12} {'relMSE x samples':>17} {'mean':>9}", flush=True)
        for name in options.scenes.split(","):
            programs = [("pipeline", lambda count, seeds: ours(pipeline, python, folder, name, options.size, count, seeds))]
            for variant in options.variants.split(","):
                programs.append((variant, lambda count, seeds, v=variant: mitsuba(python, v, folder, name, options.size, count, seeds)))
            for program, render in programs:
                start, _ = render(few, [1])
                whole, _ = render(many, [1])
                _, pictures = render(many, [1, 2])
                error, mean = map(float, run([python, "-c", COMPARE, pictures])[1].split())
                # Of a difference that drowns in the times of two starts nothing follows.
                is_known = whole - start > 0.2 * start
                rate = f"{options.size**2 * (many - few) / 1e6 / (whole - start):.2f}" if is_known else "not measurable"
                print(f"{name:8} {program:12} {rate:>15} {start:12.2f} {error * many:17.3f} {mean:9.4f}", flush=True)


main()
