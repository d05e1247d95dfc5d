#!/usr/bin/env python3
"""Our `denoise` beside Intel's Open Image Denoise on the same renders: errors against many samples.

    python3 -m venv v && v/bin/pip install numpy OpenEXR pyoidn
    v/bin/python benches/oidn.py target/release/pipeline [--spp 4,16,64] [-s NAME=VALUE ...]

Runs pipelines/denoise.yaml, reads its EXR files, and prints RMSE and relMSE of what is noisy, of every stage of ours
and of OIDN with color alone and with albedo and normals. OIDN is a network trained on renders; ours knows the noise only.
"""
import argparse
import pathlib
import subprocess
import sys
import tempfile

STAGES = ["noisy", "centers", "patches", "joint", "two"]


def channels(path, names):
    file = OpenEXR.File(str(path), separate_channels=True)
    missing = [name for name in names if name not in file.channels()]
    if missing:
        sys.exit(f"{path} lacks {missing}; it has {sorted(file.channels())}")
    return numpy.ascontiguousarray(numpy.stack([file.channels()[name].pixels for name in names], axis=2).astype("<f4"))


def errors(image, truth):
    square = (image.astype("f8") - truth) ** 2
    return numpy.sqrt(square.mean()), (square / (truth.astype("f8") ** 2 + 1e-2)).mean()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--spp", default="4,16,64")
    parser.add_argument("-s", dest="settings", action="append", default=[])
    given = parser.parse_args()
    root = pathlib.Path(__file__).resolve().parents[1]
    with tempfile.TemporaryDirectory() as scratch:
        settings = [part for setting in given.settings for part in ("-s", setting)]
        command = [given.program, "run", root / "pipelines/denoise.yaml", "--outputs", scratch, "-q", "-a", f"spp={given.spp}", *settings]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        folder = pathlib.Path(scratch, "denoise")
        truth = channels(folder / "truth.exr", "RGB")
        print(f"{'samples':>7} {'':28} {'RMSE':>9} {'relMSE':>9}")
        for spp in given.spp.split(","):
            noisy = folder / "noisy" / f"spp={spp}.exr"
            rows = [(stage, channels(folder / stage / f"spp={spp}.exr", "RGB")) for stage in STAGES]
            color = channels(noisy, "RGB")
            albedo, normal = (channels(noisy, [f"{layer}.{c}" for c in axes]) for layer, axes in (("albedo", "RGB"), ("normal", NORMAL)))
            rows.append(("OIDN, color", pyoidn.denoise(color, hdr=True)))
            rows.append(("OIDN, albedo and normals", pyoidn.denoise(color, albedo.clip(0, 1), normal, hdr=True)))
            for name, image in rows:
                rmse, relmse = errors(image, truth)
                print(f"{spp:>7} {name:28} {rmse:9.4f} {relmse:9.5f}")


NORMAL = "RGB"

if __name__ == "__main__":
    try:
        import numpy
        import OpenEXR
        import pyoidn
    except ImportError as missing:
        print(f"skipped: {missing}")
        sys.exit(0)
    main()
