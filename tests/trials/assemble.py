#!/usr/bin/env python3
"""Assembled photographs beside OpenCV's: the recovered response and the radiance.

    python3 -m venv v && v/bin/pip install numpy opencv-python-headless
    cargo build && v/bin/python tests/trials/assemble.py target/debug/pipeline [MAP]

Seven exposures of a map, two stops apart, with eight bits and the sRGB curve, are published as PNG files and read by both. Both
recover the response after Debevec and Malik; the truth is known. One line per comparison; exit 1 if one fails.
"""
import csv
import math
import pathlib
import subprocess
import sys
import tempfile

from trial import must, pfm

STOPS = [-10, -8, -6, -4, -2, 0, 2]
SHOTS = ", ".join(f"{{ name: s{index}, stops: {stops}, seconds: {2.0**stops!r} }}" for index, stops in enumerate(STOPS))
PIPELINE = f"""
version: 1
pipeline: assemble
params: {{ map: synthetic:cathedral }}
axes: {{ shot: [{SHOTS}] }}
stages:
  env: {{ load: {{ path: $map, resize: 512 }}, save: pfm }}
  shot: {{ tone-map: {{ of: env, exposure_stops: $shot.stops }}, save: png }}
  hdr:
    assemble: {{ of: shot, seconds: shot.seconds, response: recovered, weighting: hat, ignore_below: 0, ignore_above: 1 }}
    save: {{ image: pfm, response: csv }}
"""


def main():
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    try:
        import cv2
        import numpy
    except ImportError as error:
        print(f"skipped: {error.name} is not installed")
        return
    source = sys.argv[2] if len(sys.argv) == 3 else "synthetic:cathedral"
    source = source if source.startswith("synthetic:") else str(pathlib.Path(source).resolve())
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        (folder / "p.yaml").write_text(PIPELINE)
        subprocess.run([pathlib.Path(sys.argv[1]).resolve(), "run", "p.yaml", "-q", "-s", f"map={source}"], cwd=folder, check=True)
        outputs = folder / "outputs/assemble"
        images = [cv2.imread(str(outputs / f"shot/shot=s{index}.png")) for index in range(len(STOPS))]
        times = numpy.array([2.0**stops for stops in STOPS], dtype="f4")
        theirs = cv2.createCalibrateDebevec(samples=400, lambda_=10.0, random=False).process(images, times.copy())
        merged = cv2.createMergeDebevec().process(images, times.copy(), theirs)[:, :, ::-1].astype("f8")
        theirs = numpy.log(theirs[:, 0, ::-1].astype("f8"))
        rows = list(csv.DictReader((outputs / "hdr.response.csv").open()))
        ours = numpy.array([[float(row[channel]) for channel in "rgb"] for row in rows])
        radiance, truth = pfm(outputs / "hdr.pfm"), pfm(outputs / "env.pfm")

    code = numpy.arange(256) / 255
    curve = numpy.log(numpy.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4) + 1e-30)[:, None]
    used = slice(20, 236)

    def shape(values):
        return values - values[128]

    errors = [abs(shape(values) - shape(curve))[used].max() for values in (ours, theirs)]
    print(f"OpenCV {cv2.__version__}: largest error of its ln response, codes 20 to 235: {errors[1]:.2e}")
    must("largest error of our ln response, codes 20 to 235", errors[0], 0.03)
    must("our error over OpenCV's", errors[0] / errors[1], 1.0)

    # Well exposed: white in no more than the two longest, and not dark in the longest.
    shown = (truth.max(axis=2) < 2.0 ** (-STOPS[0] - 1)) & (truth.min(axis=2) > 0.05 / 2.0 ** STOPS[-1])
    ratios = [numpy.log(values[shown] / truth[shown]) for values in (radiance, merged)]
    spreads = [abs(ratio - numpy.median(ratio, axis=0)) for ratio in ratios]
    print(f"{shown.mean():.1%} of the pixels; OpenCV: median and 99th percentile of |ln error| {numpy.median(spreads[1]):.2e}, {numpy.percentile(spreads[1], 99):.2e}")
    must("ours: median of |ln error|", float(numpy.median(spreads[0])), 5e-3)
    must("ours: 99th percentile of |ln error|", float(numpy.percentile(spreads[0], 99)), 0.05)
    must("ours: factor between our radiance and the truth, |ln|", abs(numpy.median(ratios[0], axis=0)).max(), math.log(1.02))


if __name__ == "__main__":
    main()
