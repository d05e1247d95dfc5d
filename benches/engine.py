#!/usr/bin/env python3
"""Times the engine on trivial jobs, beside ninja in the same run.

    python3 benches/engine.py [PIPELINE] [--jobs 100,1000,10000] [--shapes groups,chain,fan] [--repeat 5]

Every job computes on images of one pixel and publishes a file. `groups` are ten jobs each: one trunk
(chained to the trunk before it), eight leaves with a parameter of their own, and one that gathers them; `chain` and
`fan` are what they say. Each stage is written out in the file, so that parsing is measured too. ninja, if it
is installed, builds the same graph from `printf` commands. Times are the least and the median of the repetitions,
in milliseconds; `user+sys` is processor time, `MiB` the most memory that any of them held. Exit code 1 if other jobs run than must.

Nothing is deleted before the end, but put aside: ext4 without a journal looks for a free inode past each one that
was freed lately, which made every file cost a third of a millisecond, ours and ninja's.
"""

import argparse
import json
import os
import shutil
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def pixel_file(path, value, endian="<"):
    """A PFM of one pixel; the same image in either byte order."""
    scale = "-1.0" if endian == "<" else "1.0"
    path.write_bytes(f"PF\n1 1\n{scale}\n".encode() + struct.pack(endian + "3f", *[value] * 3))


class Groups:
    """One trunk, eight leaves, one gather; ten jobs a group."""

    def __init__(self, count):
        self.groups = max(1, count // 10)

    def stages(self, changed):
        peak = {(0, 0): 3} if changed else {}
        yield "big: { load: { path: big.pfm, as: image } }"
        for group in range(self.groups):
            if group == 0:
                yield "trunk0: { load: { path: root.pfm, as: image }, save: pfm }"
            else:
                # The great pixel swallows what the trunk before it changes by: its mean has the same bytes.
                yield f"trunk{group}: {{ average: {{ of: [trunk{group - 1}, big] }}, save: pfm }}"
            for leaf in range(8):
                value = peak.get((group, leaf), 10 + leaf + 8 * group)
                yield f"leaf{group}-{leaf}: {{ compare: {{ of: trunk{group}, to: big, metrics: [psnr], peak: {value} }}, save: csv }}"
            leaves = ", ".join(f"leaf{group}-{leaf}" for leaf in range(8))
            yield f"all{group}: {{ table: {{ of: [{leaves}] }}, save: csv }}"

    def edges(self):
        for group in range(self.groups):
            before = [f"trunk{group - 1}"] if group else ["root.pfm"]
            yield f"trunk{group}", before
            for leaf in range(8):
                yield f"leaf{group}-{leaf}", [f"trunk{group}"]
            yield f"all{group}", [f"leaf{group}-{leaf}" for leaf in range(8)]

    def job_count(self):
        return self.groups * 10 + 1

    # What must execute after a leaf's parameter changed, and after the root changed.
    leaf_jobs = 2
    root_jobs = 11


class Chain:
    """Each job averages the one before it."""

    def __init__(self, count):
        self.count = count

    def stages(self, changed):
        yield "big: { load: { path: big.pfm, as: image } }"
        yield "link0: { load: { path: root.pfm, as: image }, save: pfm }"
        for link in range(1, self.count):
            yield f"link{link}: {{ average: {{ of: [link{link - 1}, big] }}, save: pfm }}"
        if changed:
            yield f"leaf: {{ average: {{ of: link{self.count - 1} }}, save: pfm }}"

    def edges(self):
        yield "link0", ["root.pfm"]
        for link in range(1, self.count):
            yield f"link{link}", [f"link{link - 1}"]

    def job_count(self):
        return self.count + 1

    leaf_jobs = 1
    root_jobs = 2


class Fan:
    """All jobs use one source."""

    def __init__(self, count):
        self.count = count

    def stages(self, changed):
        yield "big: { load: { path: root.pfm, as: image } }"
        for leaf in range(self.count):
            peak = leaf + (0.5 if changed and leaf == 7 else 1)
            yield f"leaf{leaf}: {{ compare: {{ of: big, to: big, metrics: [psnr], peak: {peak} }}, save: csv }}"

    def edges(self):
        for leaf in range(self.count):
            yield f"leaf{leaf}", ["root.pfm"]

    def job_count(self):
        return self.count + 1

    leaf_jobs = 1
    root_jobs = None


SHAPES = {"groups": Groups, "chain": Chain, "fan": Fan}


class Space:
    """A folder with a pipeline, and the program run in it."""

    def __init__(self, folder, program, shape):
        self.folder, self.program, self.shape = folder, program, shape
        folder.mkdir(parents=True)
        pixel_file(folder / "big.pfm", 1e9)
        pixel_file(folder / "root.pfm", 1)
        self.write(changed=False)

    def write(self, changed):
        lines = "\n".join("  " + line for line in self.shape.stages(changed))
        (self.folder / "p.yaml").write_text(f"version: 1\npipeline: p\nstages:\n{lines}\n")

    def run(self):
        """Wall time, processor time and largest memory (MiB) of one run, and how many jobs it executed."""
        command = [self.program, "run", "-q", "--format", "json", "p.yaml"]
        with open(self.folder / "said", "w+b") as said, open(self.folder / "summary", "w+b") as summary:
            start = time.perf_counter()
            process = subprocess.Popen(command, cwd=self.folder, stdout=summary, stderr=said)
            _, status, usage = os.wait4(process.pid, 0)
            wall = time.perf_counter() - start
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode != 0:
                said.seek(0)
                sys.exit(f"the run failed: {said.read().decode()[-2000:]}")
            summary.seek(0)
            executed = json.load(summary)["measured"]["jobs"].get("ran", 0)
        return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, executed

    def put_aside_outputs(self):
        """Takes the published files away, all but the manifest and the runs."""
        aside = self.folder / "aside"
        aside.mkdir()
        for entry in (self.folder / "outputs" / "p").iterdir():
            if entry.name not in ("runs", "manifest.json"):
                entry.rename(aside / entry.name)


class Ninja:
    """The same graph built by ninja."""

    def __init__(self, folder, shape):
        self.folder = folder
        folder.mkdir(parents=True)
        (folder / "root.pfm").write_text("x")
        rules = "\n".join(f"build {name}: touch {' '.join(inputs)}" for name, inputs in shape.edges())
        (folder / "build.ninja").write_text(f"rule touch\n  command = printf %s $out > $out\n{rules}\n")

    def run(self):
        start = time.perf_counter()
        subprocess.run(["ninja", "-j2"], cwd=self.folder, check=True, capture_output=True)
        return time.perf_counter() - start


def settle():
    """Stamps of files must be older than the steps of the clock before a signature is trusted."""
    time.sleep(0.05)


def measure(program, shape, folder, repeat, ninja):
    """Rows of (name, wall times, processor time of the least, executed, wanted)."""
    rows = {}

    def note(name, sample, wanted):
        rows.setdefault(name, []).append((*sample, wanted))

    for round_number in range(repeat):
        space = Space(folder / f"r{round_number}", program, shape)
        settle()
        note("cold", space.run(), shape.job_count())
        settle()
        space.run()
        for _ in range(3):
            note("no-op", space.run(), 0)
        space.write(changed=True)
        settle()
        note("leaf changed", space.run(), shape.leaf_jobs)
        space.write(changed=False)
        settle()
        note("changed back", space.run(), 0)
        settle()
        if shape.root_jobs:
            pixel_file(space.folder / "root.pfm", 2)
            settle()
            note("root changed", space.run(), shape.root_jobs)
            settle()
            pixel_file(space.folder / "root.pfm", 2, ">")
            settle()
            note("root, same bytes", space.run(), 1)
            settle()
        for file in [*space.folder.glob("*.pfm"), space.folder / "p.yaml"]:
            os.utime(file)
        settle()
        note("sources touched", space.run(), 0)
        space.put_aside_outputs()
        note("outputs deleted", space.run(), 0)
        if ninja:
            peer = Ninja(folder / f"n{round_number}", shape)
            note("ninja cold", (peer.run(), 0, 0, 0), 0)
            peer.run()
            for _ in range(3):
                note("ninja no-op", (peer.run(), 0, 0, 0), 0)
    return rows


def show(title, rows):
    """Prints the rows; how many of them executed other jobs than they must."""
    wrong = 0
    print(f"\n{title}{'least':>19} {'median':>9} {'user+sys':>9} {'MiB':>7}  executed")
    for row, samples in rows.items():
        walls = [sample[0] * 1e3 for sample in samples]
        executed = sorted({sample[3] for sample in samples})
        wanted = samples[0][4]
        bad = executed != [wanted]
        wrong += bad
        cpu, memory = min(sample[1] for sample in samples) * 1e3, max(sample[2] for sample in samples)
        print(
            f"  {row:<22} {min(walls):9.1f} {statistics.median(walls):9.1f} {cpu:9.1f} {memory:7.1f}  "
            f"{'/'.join(map(str, executed))}{f' (must be {wanted})' if bad else ''}"
        )
    return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pipeline", nargs="?", default="target/release/pipeline")
    parser.add_argument("--jobs", default="100,1000,10000")
    parser.add_argument("--shapes", default="groups,chain,fan")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--scratch", help="folder in which all is done (default: that of temporary files)")
    options = parser.parse_args()
    program = str(Path(options.pipeline).resolve())
    ninja = shutil.which("ninja")
    if not ninja:
        print("ninja is not installed (Debian's ninja-build): no row beside it")

    wrong = 0
    with tempfile.TemporaryDirectory(dir=options.scratch) as scratch:
        for name in options.shapes.split(","):
            no_ops = {}
            for jobs in map(int, options.jobs.split(",")):
                rows = measure(program, SHAPES[name](jobs), Path(scratch) / f"{name}{jobs}", options.repeat, ninja)
                wrong += show(f"{name}, {jobs} jobs", rows)
                no_ops[jobs] = min(sample[0] for sample in rows["no-op"])
                if ninja:
                    print(f"  no-op is {no_ops[jobs] / min(sample[0] for sample in rows['ninja no-op']):.2f} times ninja's")
            for few, many in zip(list(no_ops), list(no_ops)[1:]):
                print(f"  a no-op of {many} jobs takes {no_ops[many] / no_ops[few]:.1f} times that of {few}")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
