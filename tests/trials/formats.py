#!/usr/bin/env python3
"""Other programs read what we write: numpy the NPY, the OpenEXR wheel the EXR, Pillow the PNG, pandas the CSV.

    python3 -m venv v && v/bin/pip install numpy OpenEXR pillow pandas
    cargo build && v/bin/python tests/trials/formats.py target/debug/pipeline

Prints one line per comparison; exit 1 at the first difference, and says aloud what it skips.
"""
import json
import pathlib
import subprocess
import sys
import tempfile


def pfm(rows):
    """A PFM of an (h, w, 3) array, top row first."""
    height, width, _ = rows.shape
    return b"PF\n%d %d\n-1.0\n" % (width, height) + rows[::-1].astype("<f4").tobytes()


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    try:
        import numpy
    except ImportError:
        print("skipped: numpy is not installed")
        return
    pipeline = pathlib.Path(sys.argv[1]).resolve()
    generator = numpy.random.default_rng(7)
    rows = generator.lognormal(0, 3, (37, 65, 3)).astype("<f4")
    rows[3, 5] = [numpy.inf, -1.5, 1e-42]
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        (folder / "in.pfm").write_bytes(pfm(rows))

        def converted(name):
            subprocess.run([pipeline, "convert", folder / "in.pfm", folder / name], check=True, stderr=subprocess.DEVNULL)
            return folder / name

        same("numpy reads our NPY", numpy.load(converted("out.npy")).tobytes(), rows.tobytes())
        try:
            import OpenEXR
        except ImportError:
            print("skipped: the OpenEXR wheel is not installed")
        else:
            file = OpenEXR.File(str(converted("out.exr")), separate_channels=True)
            channels = [file.channels()[name].pixels for name in "RGB"]
            same("OpenEXR reads our EXR", numpy.stack(channels, axis=2).astype("<f4").tobytes(), rows.tobytes())
            for compression in ("NO", "RLE", "ZIPS", "ZIP", "PIZ"):
                header = {"compression": getattr(OpenEXR, compression + "_COMPRESSION"), "type": OpenEXR.scanlineimage}
                OpenEXR.File(header, {"RGB": rows.astype("f4")}).write(str(folder / "theirs.exr"))
                subprocess.run([pipeline, "convert", folder / "theirs.exr", folder / "back.npy"], check=True, stderr=subprocess.DEVNULL)
                same(f"we read OpenEXR's {compression}", numpy.load(folder / "back.npy").tobytes(), rows.tobytes())
        try:
            from PIL import Image
        except ImportError:
            print("skipped: Pillow is not installed")
        else:
            theirs = numpy.asarray(Image.open(converted("out.png")))
            light = numpy.clip(numpy.nan_to_num(rows.astype("f8"), posinf=1e30), 0, 1)
            curve = numpy.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
            same("Pillow reads our PNG", theirs.tobytes(), numpy.floor(255 * curve + 0.5).astype("u1").tobytes())


        try:
            import pandas
        except ImportError:
            print("skipped: pandas is not installed")
        else:
            tables(pipeline, folder, numpy, pandas)


# Text that a careless writer of CSV breaks, numbers that need all their digits, and empty cells.
TABLES = """
version: 1
pipeline: tables
seed: 7
axes:
  n: [1, 50]
  way:
    - { name: 'with, comma and "quotes"', method: iid }
    - { name: 'gr\u00fc\u00df dich', method: sobol }
stages:
  env: { synthesize: { name: cathedral, width: 64 } }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n }, save: [csv, npy] }
  drawn: { sample: { of: dist, count: $n, method: $way.method } }
  sphere: { relight: { env: env, with: drawn, size: 9 } }
  truth: { relight: { env: env, estimator: exact, size: 9 } }
  error: { compare: { of: sphere, to: truth, metrics: [rmse, relmse] } }
  level: { compare: { of: truth, to: truth, metrics: [rmse] } }
  errors: { table: { of: [error, level] }, save: [csv, json] }
"""


def tables(pipeline, folder, numpy, pandas):
    """Tables and samples, as pandas reads them, against the same in JSON and NPY."""
    (folder / "tables.yaml").write_text(TABLES)
    command = [pipeline, "run", folder / "tables.yaml", "--outputs", folder / "outputs", "-q"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    published = folder / "outputs" / "tables"

    read = pandas.read_csv(published / "errors.csv")
    written = json.loads((published / "errors.json").read_text())
    names = [column["name"] for column in written["columns"]]
    same("pandas finds the columns of our CSV", read.columns.tolist(), names)
    rows = [[None if pandas.isna(value) else value for value in row] for row in read.astype(object).values.tolist()]
    same("pandas reads our CSV of tables as our JSON", rows, written["rows"])

    read = pandas.read_csv(published / "samples" / "n=50.csv")
    columns = numpy.load(published / "samples" / "n=50.npy")
    same("pandas reads our CSV of samples as numpy our NPY", read.to_numpy("f8").tobytes(), columns.tobytes())


def same(what, found, expected):
    if found != expected:
        print(f"{what}: DIFFERENT\n{found}\n{expected}" if isinstance(found, list) else f"{what}: DIFFERENT")
        sys.exit(1)
    print(f"{what}: same bytes")


if __name__ == "__main__":
    main()
