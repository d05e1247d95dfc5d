"""What the trials share: runs of the coursework at small size, its path-traced spheres in parts, and what must hold after each.

Python 3.11, standard library only but for `pfm`.
"""

import argparse
import hashlib
import json
import os
import pathlib
import random
import struct
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Another file of the same name and parameters can be given, for a program of another version.
PIPELINE = pathlib.Path(os.environ.get("TRIAL_PIPELINE", ROOT / "pipelines" / "coursework.yaml"))
SMALL = ["-s", "size=31"]


def arguments(text, default_count):
    """The program, how many rounds, and where to write."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=lambda path: pathlib.Path(path).resolve(), help="the binary")
    parser.add_argument("count", type=int, nargs="?", default=default_count, help=f"rounds (default {default_count})")
    parser.add_argument("--scratch", help="folder for everything (default: a temporary one)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments and places")
    given = parser.parse_args()
    random.seed(given.seed)
    if given.scratch is None:
        holder = tempfile.TemporaryDirectory()
        given.holder, given.scratch = holder, holder.name
    given.scratch = pathlib.Path(given.scratch).resolve()
    given.scratch.mkdir(parents=True, exist_ok=True)
    small_map(given.scratch / "map.pfm")
    if "TRIAL_PIPELINE" not in os.environ:
        in_parts(given.scratch / "coursework.yaml")
    SMALL.extend(["-s", f"map={given.scratch / 'map.pfm'}"])
    return given


def in_parts(path):
    """The pipeline with its renders in parts: the same results from more jobs."""
    global PIPELINE
    text = PIPELINE.read_text()
    divided = text.replace("\n  traced:\n", "\n  traced:\n    split: 4\n")
    if divided == text:
        fail(f"{PIPELINE} has no stage `traced`")
    path.write_text(divided)
    PIPELINE = path


def small_map(path, width=128, height=64):
    """A map with a dim sky and a sun, so that a whole run takes a second or two."""
    with open(path, "wb") as out:
        out.write(b"PF\n%d %d\n-1.0\n" % (width, height))
        for y in range(height):
            for x in range(width):
                sun = 500.0 / (1 + (x - 40) ** 2 + (y - 44) ** 2)
                out.write(struct.pack("<3f", 0.2 + y / height + sun, 0.3 + sun, 0.5 + x / width + sun))


def fail(message):
    print(f"wrong: {message}", file=sys.stderr)
    sys.exit(1)


def command(program, outputs, *further):
    return [str(program), "run", str(PIPELINE), "--outputs", str(outputs), "--format", "json", *SMALL, *further]


def start(program, outputs, *further, **settings):
    """A run in a session of its own, so that signals hit nothing else."""
    environment = {**os.environ, "NO_COLOR": "1", **settings.pop("env", {})}
    return subprocess.Popen(
        command(program, outputs, *further),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment, **settings,
    )


def finish(process):
    """The summary of a run that must succeed, and what it said."""
    out, said = process.communicate(timeout=600)
    if process.returncode != 0:
        fail(f"exit code {process.returncode}: {said}{out}")
    return json.loads(out), said


def run(program, outputs, *further, **settings):
    return finish(start(program, outputs, *further, **settings))


def executed(summary):
    return summary["measured"]["jobs"].get("ran", 0)


def executed_with_parts(summary):
    """The same with the parts of renders, which are no jobs of their own: all that left a record."""
    if not executed(summary):
        return 0
    jobs = json.loads(pathlib.Path(summary["manifest"]).read_text())["jobs"]
    return executed(summary) + sum(part["outcome"] == "ran" for job in jobs for part in job.get("parts", []))


class Right:
    """What every run must give, and how long one from nothing takes."""

    def __init__(self, program, scratch):
        outputs = scratch / "right"
        begun = time.monotonic()
        summary, _ = run(program, outputs)
        self.seconds = time.monotonic() - begun
        self.jobs = executed(summary)
        self.result_id = summary["result_id"]
        manifest = json.loads((outputs / "coursework" / "manifest.json").read_text())
        self.files = {entry["path"]: entry["sha256"] for entry in manifest["published"]}
        self.check(outputs, summary)
        print(f"{self.jobs} jobs, {len(self.files)} files, {self.seconds:.2f} s from nothing")

    def check(self, outputs, summary):
        """Every file has its bytes, nothing else stands there, and nothing is left over."""
        if summary["result_id"] != self.result_id or summary["status"] != "done":
            fail(f"result {summary['result_id']}, {summary['status']}, expected {self.result_id}")
        folder = outputs / "coursework"
        found = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
        found = {path for path in found if not path.startswith("runs/") and "/" in path or path in self.files}
        if found != set(self.files):
            fail(f"files differ: {sorted(found ^ set(self.files))[:5]}")
        for path, digest in self.files.items():
            if hashlib.sha256((folder / path).read_bytes()).hexdigest() != digest:
                fail(f"{path} has other bytes")
        check_nothing_left(outputs)


def check_nothing_left(outputs):
    for folder in (outputs / ".tmp", outputs / ".store/v1/tmp", outputs / ".store/v1/claims"):
        left = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
        if left:
            fail(f"left over in {folder.name}: {left[:5]}")


def records(outputs):
    """Names of the result records in a store."""
    return {path.name for path in (outputs / ".store/v1/ac").glob("*/*")}


def check_resumed(right, outputs, before, summary):
    """Only what had no record was computed."""
    new = len(records(outputs) - before)
    if executed_with_parts(summary) != new:
        fail(f"{executed_with_parts(summary)} jobs and parts ran, but {new} records are new")
    return new


def must(what, found, allowed):
    """One line, and the end if the number is too large."""
    right = found <= allowed
    print(f"{what}: {found:.2e} (allowed {allowed:.1e}){'' if right else ' WRONG'}", flush=True)
    if not right:
        sys.exit(1)


def pfm(path):
    """Pixels of a little-endian color PFM, top row first; needs numpy."""
    import numpy
    with open(path, "rb") as file:
        assert file.readline() == b"PF\n"
        width, height = map(int, file.readline().split())
        assert float(file.readline()) < 0
        return numpy.frombuffer(file.read(), "<f4").reshape(height, width, 3)[::-1].astype("f8")
