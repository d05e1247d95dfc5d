#!/usr/bin/env python3
"""Draws directions from one map with `pipeline`, Mitsuba 3 and numpy, one after the other, and prints them side by side.

    python3 benches/light_peers.py [--widths 1024,4096] [--count 10000000] [--rounds 3] [--venv DIR]

Needs the network once: installs the wheels `mitsuba` and `numpy` by name into a virtual environment, and Debian's libLLVM for
Mitsuba's variant `llvm_ad_rgb`. A peer that cannot be had is skipped aloud. Every sample has direction, radiance and density, and
random numbers are part of the work; all on one core, in turns, the least processor time of several rounds. Ours lie uniform in solid angle within
pixels, Mitsuba's are interpolated between them, numpy's are the centers of pixels. Building uses all cores, on both sides.

All sides print the integral of the map's green channel over the sphere, estimated from their own samples: they must agree.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile
import venv

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))

MAP = r"""
import sys
sys.path.insert(0, sys.argv[2])
import numpy_sampling
width = int(sys.argv[3])
numpy_sampling.rough_map(width, width // 2).astype("<f4").tofile(sys.argv[1])
"""

MITSUBA = r"""
import json, sys, time
import numpy as np
import drjit as dr
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
path, width, count, cores = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
image = np.fromfile(path, "<f4").reshape(width // 2, width, 3)
bitmap = mi.Bitmap(image)

def best(runs, work, clock=time.perf_counter):
    times = []
    for _ in range(runs):
        start = clock()
        work()
        times.append(clock() - start)
    return min(times)

def build():
    emitter = mi.load_dict({"type": "envmap", "bitmap": bitmap})
    dr.eval(mi.traverse(emitter)["data"])
    dr.sync_thread()
    return emitter

dr.set_thread_count(cores)
built = best(5, build)
scene = mi.load_dict({"type": "scene", "env": {"type": "envmap", "bitmap": bitmap}, "ball": {"type": "sphere"}})
emitter = scene.emitters()[0]
dr.set_thread_count(1)

def draw(seed=[0]):
    seed[0] += 1
    random = mi.PCG32(size=count, initstate=seed[0])
    u = mi.Point2f(random.next_float32(), random.next_float32())
    sample, weight = emitter.sample_direction(dr.zeros(mi.Interaction3f, count), u)
    dr.eval(sample.d, sample.pdf, weight)
    dr.sync_thread()
    return sample, weight

sample, weight = draw()
integral = float(np.mean(np.array(weight[1], dtype=np.float64)))
print(json.dumps({"build": built, "draw": best(6, draw, time.process_time), "integral": integral, "version": mi.__version__}))
"""

NUMPY = r"""
import json, sys, time
import numpy as np
sys.path.insert(0, sys.argv[4])
import numpy_sampling as ours
path, width, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
height = width // 2
image = np.fromfile(path, "<f4").reshape(height, width, 3)

def best(runs, work):
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return min(times), result

built, (weight, rows, marginal, conditional) = best(3, lambda: ours.build(image))
laid_out = (conditional + np.arange(height)[:, None]).ravel()
tables = (weight, rows, marginal, conditional, laid_out, None)
theta = (np.arange(height) + 0.5) * np.pi / height
phi = (np.arange(width) + 0.5) * 2 * np.pi / width
solid = 2 * np.pi / width * 2 * np.sin(np.pi / 2 / height) * np.sin(theta)
rng = np.random.default_rng(7)

def draw():
    y, k, pmf = ours.draw_marginal(tables, count, rng, False)
    direction = np.stack([np.sin(theta)[y] * np.cos(phi)[k], np.cos(theta)[y], np.sin(theta)[y] * np.sin(phi)[k]], -1)
    return direction, image[y, k], pmf / solid[y]

drawn, (direction, radiance, pdf) = best(2, draw)
print(json.dumps({"build": built, "draw": drawn, "integral": float((radiance[:, 1] / pdf).mean()), "version": np.__version__}))
"""


def output(command, **options):
    """What a program prints, or nothing and why."""
    done = subprocess.run(command, capture_output=True, text=True, **options)
    return (done.stdout, None) if done.returncode == 0 else (None, (done.stderr or done.stdout).strip().splitlines()[-1:])


def python_with(packages, folder):
    python = os.path.join(folder, "bin", "python")
    if not os.path.exists(python):
        venv.create(folder, with_pip=True)
    for package in packages:
        if output([python, "-c", f"import {package}"])[1]:
            _, why = output([python, "-m", "pip", "install", "-q", package])
            if why:
                print(f"skipped: {package} cannot be installed: {why}")
    return python


def ours(path, width, count, threads):
    command = ["cargo", "bench", "--quiet", "--manifest-path", os.path.join(ROOT, "Cargo.toml"), "--bench", "sampling", "--"]
    text, why = output([*command, "--lit", path, str(width), str(width // 2), str(count)],
                       env=dict(os.environ, RAYON_NUM_THREADS=str(threads)))
    if why:
        sys.exit(f"benches/sampling.rs failed: {why}")
    return {name: float(value) for name, value in (line.split() for line in text.splitlines() if len(line.split()) == 2)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--widths", default="1024,4096")
    parser.add_argument("--count", type=int, default=10_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--venv", default=os.path.join(tempfile.gettempdir(), "light-peers-venv"))
    options = parser.parse_args()
    python = python_with(["numpy", "mitsuba"], options.venv)
    cores = len(os.sched_getaffinity(0))
    for width in map(int, options.widths.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "map.f32")
            _, why = output([python, "-c", MAP, path, os.path.join(ROOT, "benches"), str(width)])
            if why:
                sys.exit(f"the map cannot be made: {why}")
            best = {}
            for _ in range(options.rounds):
                rounds = {"ours": ours(path, width, options.count, 1)}
                rounds["ours on all cores"] = ours(path, width, 1000, cores)
                for name, script, last in [("mitsuba", MITSUBA, str(cores)), ("numpy", NUMPY, os.path.join(ROOT, "benches"))]:
                    text, why = output([python, "-c", script, path, str(width), str(options.count), last])
                    if why:
                        print(f"skipped: {name} does not run here: {why}")
                    else:
                        rounds[name] = json.loads(text.splitlines()[-1])
                for name, figures in rounds.items():
                    kept = best.setdefault(name, dict(figures))
                    for what, value in figures.items():
                        kept[what] = min(kept[what], value) if isinstance(value, float) and what != "integral" else value
            report(width, options.count, best)


def report(width, count, best):
    mine, mitsuba = best["ours"], best.get("mitsuba")
    nanoseconds = lambda seconds: 1e9 * seconds / count
    print(f"\nmap {width} x {width // 2}, {count} directions with radiance and density, one core")
    for warp in ["marginal", "alias", "hierarchical"]:
        ratio = f", {mitsuba['draw'] / mine[warp]:.2f} x Mitsuba" if mitsuba else ""
        print(f"  ours, {warp}: {nanoseconds(mine[warp]):.1f} ns{ratio}; its table on top of the distribution {1e3 * mine[f'build-{warp}']:.1f} ms")
    for name in ["mitsuba", "numpy"]:
        if name in best:
            print(f"  {name} {best[name]['version']}: {nanoseconds(best[name]['draw']):.1f} ns, integral {best[name]['integral']:.4g}")
    print(f"  ours: integral {mine['integral']:.4g}")
    build = best["ours on all cores"]["build"]
    print(f"  building the distribution: ours {1e3 * build:.1f} ms on all cores, {1e3 * mine['build']:.1f} ms on one")
    for name in ["mitsuba", "numpy"]:
        if name in best:
            print(f"    {name}: {1e3 * best[name]['build']:.1f} ms, {best[name]['build'] / build:.1f} x ours")


if __name__ == "__main__":
    main()
