#!/usr/bin/env python3
"""Renders the same scenes with `pipeline` and with Mitsuba 3, one after the other, and prints them side by side.

  PIPELINE_BIN=target/release/pipeline python3 benches/mitsuba_render.py [--size 512] [--counts 8,64]
      [--scenes sphere,mesh,box,diffuse,glass,metal] [--programs pipeline,llvm_ad_rgb,llvm_ad_rgb+best,scalar_rgb]
      [--venv DIR] [--json FILE]

Needs the network once: installs the wheels `mitsuba` and `numpy` by name into a virtual environment. The variant
llvm_ad_rgb also needs a libLLVM, 16 or later (Debian: apt-get install libllvm19, or DRJIT_LIBLLVM_PATH); without one it
is skipped aloud. `+best` is
Mitsuba with `multijitter` and `mis_compensation`; all others run at their defaults.

Scenes: the diffuse sphere as a shape and as 16 000 triangles (max depth 2) and a displaced sphere of a million triangles in
diffuse, glass and rough copper (max depth 8), under a map of 1024 x 512 pixels with a dim gradient and six small windows
(largest over smallest luminance 1.4e5, 89 % of the energy in the windows); a box with mirror and glass under a lamp.

Columns, all times processor time of the whole process and its threads (user and system), on two threads:
  Ms/cpu-s   million samples per processor second between the two counts, so without start-up and loading
  cpu-s@N    the whole process at the smaller count
  relMSE*n   at the larger count, over the pixels that the shape covers: mean((a - b)^2 / (2 (m^2 + 0.01))), m = (a + b) / 2
  to .01     samples a pixel at which relMSE is .01, between the counts that enclose it, and processor seconds for them by the rate
  load       wall seconds for reading the mesh and building its tree (the difference to a run with a sphere in its place)
  MB         peak of resident memory at the smaller count
  |z|        largest deviation of the mean over one of 8 x 8 tiles of the picture from a long run of the same program with
             independent samples of other seeds, in standard errors; among 64 tiles and 3 channels 4.0 is usual
"""
import argparse, json, math, os, shutil, subprocess, sys, tempfile, time, venv

MITSUBA = r"""
import json, resource, sys, time
job = json.loads(sys.argv[1])
import mitsuba as mi
mi.set_variant(job["variant"])
import numpy as np
T = mi.ScalarTransform4f
size = job["size"]

def camera(origin, target, degrees):
    return {"type": "perspective", "fov": degrees, "fov_axis": "x", "to_world": T().look_at(origin=origin, target=target, up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
            "sampler": {"type": job["sampler"], "sample_count": job["samples"]}}

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
    return {"type": "rectangle", "to_world": to_world @ T().scale(scale),
            "b": {"type": "twosided", "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}}}}

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
    shape = {"type": "sphere"} if job["mesh"] is None else {"type": "ply", "filename": job["mesh"]}
    scene["shape"] = {**shape, "b": BSDFS[name]}
    scene["env"] = {"type": "envmap", "filename": job["map"], "mis_compensation": job["compensation"]}
start = time.perf_counter()
scene = mi.load_dict(scene)
seconds = time.perf_counter() - start
image = np.array(mi.render(scene, seed=job["seed"])).astype("<f4")
np.save(job["out"], image)
print(json.dumps({"load": seconds}))
"""

COMPARE = r"""
import json, sys, numpy as np
job = json.loads(sys.argv[1])
read = lambda path: np.load(path).astype("f8")
alpha = read(job["mask"])
inside = (alpha[..., 3] if alpha.shape[-1] == 4 else np.ones(alpha.shape[:2])) >= 1
found = {}
a, b = (read(path)[..., :3] for path in job["pair"])
m = (a + b) / 2
found["error"] = float(((a - b) ** 2 / (2 * (m * m + 0.01)))[inside].mean())
found["mean"] = float(m[inside].mean())
if job["long"]:
    c, d = (read(path)[..., :3] for path in job["long"])
    split = lambda x: [tile for row in np.array_split(x * inside[..., None], 8) for tile in np.array_split(row, 8, axis=1)]
    tiles = lambda x: np.stack([tile.sum((0, 1)) for tile in split(x)])
    squared = tiles((a - b) ** 2 / 4) + tiles((c - d) ** 2 / 4)
    off = tiles(m - (c + d) / 2)
    used = squared > 0
    found["z"] = float(np.abs(off[used] / np.sqrt(squared[used])).max())
    found["long"] = float(((c + d) / 2)[inside].mean())
print(json.dumps(found))
"""

INPUTS = r"""
import sys, numpy as np
folder = sys.argv[1]

def windows(width=1024):
    height = width // 2
    v, u = (np.arange(height) + .5) / height, (np.arange(width) + .5) / width
    up = np.cos(np.pi * v)[:, None, None]
    map = (.005 + .495 * (.5 + .5 * up)) * np.array([.8, 1, 1.3]) * np.ones((1, width, 1))
    for u0, u1, v0, v1, radiance in [(.10, .13, .25, .32, 120), (.145, .175, .25, .32, 120), (.19, .22, .25, .32, 120),
                                     (.60, .61, .40, .45, 700), (.70, .71, .40, .45, 350), (.40, .42, .12, .16, 300)]:
        map[np.ix_((v >= v0) & (v < v1), (u >= u0) & (u < u1))] = radiance * np.array([1.1, 1, .8])
    return map

map = windows()
open(f"{folder}/map.pfm", "wb").write(f"PF\n{map.shape[1]} {map.shape[0]}\n-1.0\n".encode() + map[::-1].astype("<f4").tobytes())

def sphere(path, columns, rows, relief):
    theta, phi = np.meshgrid(np.pi * np.arange(rows + 1) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    d = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], -1)
    places = [(4, (1, .3, .2)), (9, (-.4, 1, .5)), (21, (.2, -.6, 1)), (47, (1, 1, -1)), (101, (-1, .5, .8))]
    waves = sum(np.sin(f * d @ np.array(k) + f) / f for f, k in places)
    points = (d * (1 + relief * waves)[..., None]).reshape(-1, 3).astype("<f4")
    r, c = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a, b = r * columns + c, r * columns + (c + 1) % columns
    upper, lower = np.stack([a, a + columns, b + columns], -1)[:-1], np.stack([a, b + columns, b], -1)[1:]
    corners = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    faces = np.empty(len(corners), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, corners
    head = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
            f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
    open(path, "wb").write(head.encode() + points.tobytes() + faces.tobytes())

sphere(f"{folder}/thousands.ply", 128, 64, 0)
sphere(f"{folder}/million.ply", 1000, 500, 0.2)
"""

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
MESHES = {"mesh": "thousands.ply", "diffuse": "million.ply", "glass": "million.ply", "metal": "million.ply"}
# A long run needs less where samples are dear.
LONG = {"sphere": 64, "mesh": 64, "box": 64, "diffuse": 32, "glass": 32, "metal": 32}


def run(command):
    """Processor seconds, wall seconds and peak megabytes of a command and its threads, and what it printed."""
    start = time.perf_counter()
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(command, stdout=said, stderr=subprocess.STDOUT, text=True)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall = time.perf_counter() - start
        said.seek(0)
        text = said.read()
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(map(str, command[:3]))} ... failed:\n{text[-3000:]}")
    return {"cpu": usage.ru_utime + usage.ru_stime, "wall": wall, "megabytes": usage.ru_maxrss / 1024, "text": text}


class Bench:
    def __init__(self, pipeline, python, folder, size):
        self.pipeline, self.python, self.folder, self.size = pipeline, python, folder, size
        self.made = 0

    def fresh(self, suffix):
        self.made += 1
        return f"{self.folder}/{self.made}{suffix}"

    def scene(self, name, sampler, samples, size, shape=None, background="environment"):
        if name == "box":
            env, shapes, view = "", BOX, "{ origin: [0, 1, 4.2], target: [0, 1, 0], fov_degrees: 38 }"
        else:
            mesh = MESHES.get(name)
            shape = shape or ("{ sphere: {}" if mesh is None else f"{{ mesh: {{ path: {self.folder}/{mesh} }}")
            env, view = "env: map", "{ origin: [0, 0, 4], target: [0, 0, 0], fov_degrees: 36 }"
            shapes = f"\n            - {shape}, bsdf: {BSDFS[name]} }}"
        return f"""version: 1
pipeline: bench
stages:
  map: {{ load: {{ path: {self.folder}/map.pfm }} }}
  picture:
    render:
      {env}
      scene:
        camera: {{ perspective: {view} }}
        film: {{ resolution: [{size}, {size}], background: {background} }}
        sampler: {{ {sampler}: {{ samples_per_pixel: {samples} }} }}
        integrator: {{ path: {{ max_depth: {DEPTHS[name]} }} }}
        materials: {{ white: {{ diffuse: {{ reflectance: 0.7 }} }} }}
        shapes: {shapes}
    save: npy
"""

    def ours(self, name, samples, seed, sampler="sobol", **scene):
        spec, out = self.fresh(".yaml"), self.fresh("")
        with open(spec, "w") as file:
            file.write(self.scene(name, sampler, samples, scene.pop("size", self.size), **scene))
        done = run([self.pipeline, "run", spec, "--outputs", out, "--seed", str(seed), "--only", "picture", "--jobs", "2", "-q"])
        picture = self.fresh(".npy")
        os.rename(f"{out}/bench/picture.npy", picture)
        shutil.rmtree(out)
        return done | {"picture": picture}

    def mitsuba(self, program, name, samples, seed, sampler=None, size=None):
        variant, _, best = program.partition("+")
        mesh = MESHES.get(name)
        job = {"variant": variant, "scene": name, "size": size or self.size, "samples": samples, "seed": seed, "depth": DEPTHS[name],
               "sampler": sampler or ("multijitter" if best else "independent"), "compensation": bool(best),
               "mesh": mesh and f"{self.folder}/{mesh}", "map": f"{self.folder}/map.pfm", "out": self.fresh(".npy")}
        done = run([self.python, "-c", MITSUBA, json.dumps(job)])
        return done | {"picture": job["out"], "load": json.loads(done["text"].strip().splitlines()[-1])["load"]}

    def render(self, program, *arguments, **options):
        return self.ours(*arguments, **options) if program == "pipeline" else self.mitsuba(program, *arguments, **options)

    def compared(self, mask, pair, long=()):
        job = {"mask": mask, "pair": [one["picture"] for one in pair], "long": [one["picture"] for one in long]}
        return json.loads(run([self.python, "-c", COMPARE, json.dumps(job)])["text"])

    def load_seconds(self, name):
        """Wall seconds of tiny renders with the mesh beyond those with a sphere; the least of three."""
        least = lambda **scene: min(self.ours(name, 1, 1, size=8, **scene)["wall"] for _ in range(3))
        return least() - least(shape="{ sphere: {}")

    def measured(self, program, name, counts, mask):
        few, many = counts
        start = self.render(program, name, few, 1)
        whole = self.render(program, name, many, 1)
        other = self.render(program, name, many, 2)
        long = [self.render(program, name, LONG[name], seed, sampler="independent") for seed in (11, 12)]
        found = self.compared(mask, [whole, other], long)
        pixels = self.size**2 / 1e6
        # Of a difference that drowns in the times of two starts nothing follows.
        spent = whole["cpu"] - start["cpu"]
        rate = pixels * (many - few) / spent if spent > 0.2 * start["cpu"] else math.nan
        needed = self.needed(program, name, mask, {many: found["error"]})
        load = None
        if name in MESHES:
            load = self.load_seconds(name) if program == "pipeline" else start["load"]
        return {"scene": name, "program": program, "rate": rate, "start": start["cpu"], "noise": found["error"] * many,
                "needed": needed, "seconds": needed * pixels / rate, "load": load, "megabytes": start["megabytes"],
                "mean": found["mean"], "z": found["z"]}

    def needed(self, program, name, mask, errors):
        """Samples a pixel for a relMSE of .01, by a straight line between the logarithms of the errors around it."""
        def error(count):
            if count not in errors:
                errors[count] = self.compared(mask, [self.render(program, name, count, seed) for seed in (1, 2)])["error"]
            return errors[count]
        count = next(iter(errors))
        while error(count) > 0.01 and count < 1024:
            count *= 2
        while count > 1 and error(count // 2) < 0.01:
            count //= 2
        if count == 1 or error(count) > 0.01:
            return math.nan if error(count) > 0.01 else 1
        low, high = math.log(error(count // 2)), math.log(error(count))
        return count / 2 * 2 ** ((low - math.log(0.01)) / (low - high))


def has_variant(bench, program):
    """Whether a variant renders here; says so if not."""
    try:
        bench.mitsuba(program, "metal", 1, 1, size=8)
        return True
    except RuntimeError as error:
        reasons = [line for line in str(error).splitlines() if "rror" in line]
        print(f"skipped: {program} does not run here: {(reasons or ['no reason given'])[-1].strip()}", flush=True)
        return False


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--size", type=int, default=512)
    options.add_argument("--counts", default="8,64")
    options.add_argument("--scenes", default="sphere,mesh,box,diffuse,glass,metal")
    options.add_argument("--programs", default="pipeline,llvm_ad_rgb,llvm_ad_rgb+best,scalar_rgb")
    options.add_argument("--venv")
    options.add_argument("--json")
    options = options.parse_args()
    pipeline = os.path.abspath(os.environ.get("PIPELINE_BIN", "target/release/pipeline"))
    counts = [int(count) for count in options.counts.split(",")]
    with tempfile.TemporaryDirectory() as folder:
        home = options.venv or f"{folder}/venv"
        python = f"{home}/bin/python"
        if not os.path.exists(python):
            venv.create(home, with_pip=True)
            run([python, "-m", "pip", "-q", "install", "mitsuba", "numpy"])
        run([python, "-c", INPUTS, folder])
        bench = Bench(pipeline, python, folder, options.size)
        programs = options.programs.split(",")
        missing = {program for program in programs if program != "pipeline" and not has_variant(bench, program)}
        rows = []
        print(f"{'scene':8} {'program':17} {'Ms/cpu-s':>8} {f'cpu-s@{counts[0]}':>8} {'relMSE*n':>8} {'to .01':>6} {'cpu-s':>6} "
              f"{'load s':>6} {'MB':>5} {'mean':>8} {'|z|':>5}", flush=True)
        for name in options.scenes.split(","):
            mask = bench.ours(name, 4, 1, background="transparent")["picture"]
            for program in (program for program in programs if program not in missing):
                row = bench.measured(program, name, counts, mask)
                rows.append(row)
                load = "" if row["load"] is None else f"{row['load']:.2f}"
                print(f"{name:8} {program:17} {row['rate']:8.2f} {row['start']:8.2f} {row['noise']:8.4f} {row['needed']:6.1f} {row['seconds']:6.2f} "
                      f"{load:>6} {row['megabytes']:5.0f} {row['mean']:8.4f} {row['z']:5.1f}", flush=True)
                for picture in os.listdir(folder):
                    if picture.endswith(".npy") and f"{folder}/{picture}" != mask:
                        os.remove(f"{folder}/{picture}")
        if options.json:
            with open(options.json, "w") as file:
                json.dump(rows, file, indent=1)


main()
