"""Times building a distribution and drawing from it: numpy against `benches/sampling.rs`, in one run on one map.

    python3 benches/numpy_sampling.py [--width 4096] [--count 4000000] [--rounds 3]

Needs numpy, and cargo on the path. Building uses all cores on our side (numpy has one); drawing is compared per core,
ours with one thread. Each figure is the best of several rounds. numpy's side is the fastest of four ways to invert:

  marginal   searchsorted of the marginal CDF, then of row + conditional CDF laid end to end
  flat       one searchsorted in the CDF of all pixels
  sorted     the same two with the random numbers sorted first (kinder to the cache; the order of samples is lost)

Both sides make their random numbers; numpy gives row, column and probability, ours whole samples
(pixel, position, direction, probability, density).
"""

import argparse
import os
import subprocess
import tempfile
import time

import numpy as np


def rough_map(width, height):
    """Smooth sky, a small sun five decades above it, and noise of each pixel."""
    rng = np.random.default_rng(1)
    theta = (np.arange(height) + 0.5) * np.pi / height
    phi = (np.arange(width) + 0.5) * 2 * np.pi / width
    sky = (1.2 + np.cos(theta))[:, None] * (1.1 + np.sin(phi))[None, :]
    sun = 1e5 * np.exp(-((theta[:, None] - 0.9) ** 2 + (phi[None, :] - 2.0) ** 2) / (2 * 0.004**2))
    value = (sky + sun) * rng.lognormal(0, 1, (height, width))
    return np.stack([value, 0.9 * value, 0.7 * value], -1).astype(np.float32)


def build(image):
    """Luminance times sine, row sums, cumulative sums of each row, normalized."""
    height = image.shape[0]
    luminance = 0.2126 * image[..., 0] + 0.7152 * image[..., 1] + 0.0722 * image[..., 2]
    weight = luminance * np.sin((np.arange(height) + 0.5) * np.pi / height)[:, None]
    conditional = np.cumsum(weight, axis=1, dtype=np.float64)
    rows = conditional[:, -1].copy()
    conditional /= rows[:, None]
    marginal = np.cumsum(rows)
    marginal /= marginal[-1]
    return weight, rows, marginal, conditional


def draw_marginal(tables, count, rng, is_sorted):
    weight, rows, marginal, _, laid_out, _ = tables
    height, width = weight.shape
    u = rng.random((2, count))
    if is_sorted:
        u.sort(axis=1)
    y = np.minimum(np.searchsorted(marginal, u[0], side="right"), height - 1)
    k = np.minimum(np.searchsorted(laid_out, y + u[1], side="right"), width * height - 1)
    return y, k - y * width, weight.ravel()[k] / rows.sum()


def draw_flat(tables, count, rng, is_sorted):
    weight, rows, _, _, _, flat = tables
    u = rng.random(count)
    if is_sorted:
        u.sort()
    k = np.minimum(np.searchsorted(flat, u, side="right"), weight.size - 1)
    y, x = np.divmod(k, weight.shape[1])
    return y, x, weight.ravel()[k] / rows.sum()


def best_seconds(runs, work):
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def ours(binary, path, image, count, threads):
    height, width, _ = image.shape
    environment = dict(os.environ, RAYON_NUM_THREADS=str(threads))
    command = [*binary, "--times", path, str(width), str(height), str(count)]
    lines = subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.splitlines()
    return {name: float(seconds) for name, seconds in (line.split() for line in lines)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=4096)
    parser.add_argument("--count", type=int, default=4_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    binary = ["cargo", "bench", "--quiet", "--manifest-path", os.path.join(root, "Cargo.toml"), "--bench", "sampling", "--"]
    subprocess.run(["cargo", "bench", "--no-run", "--manifest-path", os.path.join(root, "Cargo.toml"), "--bench", "sampling"], check=True)

    image = rough_map(options.width, options.width // 2)
    cores = len(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "map.f32")
        image.astype("<f4").tofile(path)
        tables = build(image)
        laid_out = (tables[3] + np.arange(image.shape[0])[:, None]).ravel()
        flat = np.cumsum(tables[0], dtype=np.float64)
        tables = (*tables, laid_out, flat / flat[-1])
        rng = np.random.default_rng(7)
        ways = {
            "marginal": lambda: draw_marginal(tables, options.count, rng, False),
            "marginal, sorted": lambda: draw_marginal(tables, options.count, rng, True),
            "flat": lambda: draw_flat(tables, options.count, rng, False),
            "flat, sorted": lambda: draw_flat(tables, options.count, rng, True),
        }
        rounds = []
        # Turn by turn, so that what else the machine does falls on all alike.
        for _ in range(options.rounds):
            times = {f"ours, {threads}": ours(binary, path, image, options.count, threads) for threads in (1, cores)}
            times["numpy build"] = best_seconds(2, lambda: build(image))
            rounds.append(times | {name: best_seconds(1, way) for name, way in ways.items()})

    best = {name: min(times[name] for times in rounds) for name in ["numpy build", *ways]}
    one_core, all_cores = ({what: min(times[f"ours, {threads}"][what] for times in rounds) for what in ("build", "draw")}
                           for threads in (1, cores))
    numpy_build, draws = best["numpy build"], {name: best[name] for name in ways}

    print(f"map {options.width} x {options.width // 2}, {options.count} samples, numpy {np.__version__}, {cores} cores")
    print(f"build: numpy {1e3 * numpy_build:.1f} ms, ours {1e3 * all_cores['build']:.1f} ms on {cores} cores"
          f" ({1e3 * one_core['build']:.1f} ms on one)")
    for name, seconds in draws.items():
        print(f"draw, numpy {name}: {1e9 * seconds / options.count:.0f} ns a sample")
    print(f"draw, ours on one core: {1e9 * one_core['draw'] / options.count:.0f} ns a sample"
          f" ({1e9 * all_cores['draw'] / options.count:.0f} ns on {cores})")
    print(f"ratio build {numpy_build / all_cores['build']:.1f}, draw per core"
          f" {min(draws['marginal'], draws['flat']) / one_core['draw']:.1f}"
          f" (with sorted numbers {min(draws.values()) / one_core['draw']:.1f})")


if __name__ == "__main__":
    main()
