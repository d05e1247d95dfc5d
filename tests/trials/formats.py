#!/usr/bin/env python3
"""Other programs read what we write: numpy the NPY, the OpenEXR wheel the EXR, Pillow the PNG.

    python3 -m venv v && v/bin/pip install numpy OpenEXR pillow
    cargo build && v/bin/python tests/trials/formats.py target/debug/pipeline

Needs `pipeline convert`. Prints one line per comparison; exit 1 at the first difference, and says aloud what it skips.
"""
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


def same(what, found, expected):
    if found != expected:
        print(f"{what}: DIFFERENT")
        sys.exit(1)
    print(f"{what}: same bytes")


if __name__ == "__main__":
    main()
