#!/usr/bin/env python3
"""Measures what the estimators of `pipelines/estimators.yaml` cost, in nanoseconds of processor time on one core.

    cargo build --release && python3 benches/estimator_costs.py [target/release/pipeline] [--map MAP] [--rounds 5]

The pipeline compares estimators at equal time, by costs that are parameters: so its tables are the same on every machine, and those of another machine
are a matter of putting its costs in. Every figure is the difference between a run with and one without the work in question, divided by how
much work that is; of several rounds the least processor time. Prints `setup` (before the first pixel) and `term` (for each
direction or light at each covered pixel). Linux, Python 3.11, standard library only.
"""
import argparse
import os
import pathlib
import resource
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
# Covered pixels of the spheres of 63 and 31 pixels a side.
COVERED = {size: sum((2 * i + 1 - size) ** 2 + (2 * j + 1 - size) ** 2 < size**2 for i in range(size) for j in range(size)) for size in (63, 31)}
STRATEGIES = [("iid", "marginal"), ("rows-then-columns", "marginal"), ("stratified", "marginal"), ("sobol", "marginal"), ("sobol", "alias"), ("sobol", "hierarchical")]
DIST = "dist: { distribution: { of: env, intensity: mean } }"


class Costs:
    def __init__(self, given, folder):
        self.given, self.folder = given, folder
        # Other stages read a map of the size that the pipeline has, whatever loading it costs.
        self.run(f'env: {{ load: {{ path: "{given.map}", resize: 512 }}, save: pfm }}')
        (folder / "outputs/costs/env.pfm").rename(folder / "map.pfm")
        self.env = "env: { load: { path: map.pfm } }"

    def run(self, *stages):
        """Processor time in seconds of a run from nothing."""
        lines = "".join(f"  {stage}\n" for stage in stages)
        (self.folder / "p.yaml").write_text(f"version: 1\npipeline: costs\nseed: 7\nstages:\n{lines}")
        subprocess.run(["rm", "-rf", self.folder / "outputs"], check=True)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([self.given.program, "run", "-q", "-j", "1", "p.yaml"], cwd=self.folder, check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def more(self, without, *further):
        """Nanoseconds that further stages take beside `without`, in turns."""
        rounds = [(self.run(self.env, *without), self.run(self.env, *without, *further)) for _ in range(self.given.rounds)]
        return 1e9 * (min(long for _, long in rounds) - min(short for short, _ in rounds))

    def difference(self, without, short, long):
        """Nanoseconds by which one stage in place of another is slower."""
        rounds = [(self.run(self.env, *without, short), self.run(self.env, *without, long)) for _ in range(self.given.rounds)]
        return 1e9 * (min(b for _, b in rounds) - min(a for a, _ in rounds))


def say(what, setup, term):
    print(f"{what}: setup {max(setup, 0):.2e} ns, term {term:.2f} ns", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", nargs="?", default=ROOT / "target/release/pipeline", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("--map", default="synthetic:cathedral")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    given.map = given.map if given.map.startswith("synthetic:") else os.path.abspath(given.map)
    with tempfile.TemporaryDirectory() as folder:
        costs = Costs(given, pathlib.Path(folder))
        shared(costs)
        cuts(costs)
        own(costs)


def shared(costs):
    """One set of directions for all pixels."""
    count = 1 << 16
    samples = f"samples: {{ sample: {{ of: dist, count: {count} }} }}"
    lit = "lit: { relight: { env: env, with: samples, size: 63 } }"
    term = costs.more([DIST, samples], lit) / count / COVERED[63]
    build = costs.more([], DIST)
    for method, warp in STRATEGIES:
        sample = lambda count: f"samples: {{ sample: {{ of: dist, method: {method}, warp: {warp}, count: {count} }} }}"
        few = costs.more([DIST], sample(16))
        each = costs.difference([DIST], sample(16), sample(1 << 20)) / (1 << 20)
        say(f"{method}, {warp}", build + few, term + each / COVERED[63])
    samples = lambda count: f"samples: {{ sample: {{ method: uniform, env: env, count: {count} }} }}"
    say("uniform", 0, term + costs.difference([], samples(16), samples(1 << 20)) / (1 << 20) / COVERED[63])
    count = 1 << 12
    samples = f"samples: {{ sample: {{ method: cosine, count: {count} }} }}"
    say("cosine, turned", 0, costs.more([samples], lit) / count / COVERED[63])


def cuts(costs):
    for variant in ("debevec", "variance"):
        for count in (16, 256, 4096):
            say(f"{variant} cut into {count}", costs.more([], f"cut: {{ median-cut: {{ of: env, variant: {variant}, count: {count} }} }}"), 0)


def own(costs):
    """Pixels that draw for themselves."""
    for estimator in ("pdf-weighted", "mis-balance", "mis-power", "lobe-weighted"):
        source = "" if estimator == "lobe-weighted" else "with: dist, warp: hierarchical, "
        lit = lambda count: f"own: {{ relight: {{ env: env, {source}estimator: {estimator}, count: {count}, method: sobol, size: 31 }} }}"
        say(f"own, {estimator}", 0, costs.difference([DIST], lit(16), lit(2064)) / 2048 / COVERED[31])


if __name__ == "__main__":
    main()
