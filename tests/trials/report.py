#!/usr/bin/env python3
"""Opens the page of a run in headless Chromium, uses it as a reader does, and reads pixels back from its canvas.

  python3 tests/trials/report.py target/release/pipeline [--pictures DIR] [--run MANIFEST]

Needs Debian's `chromium` and `chromium-driver`; says so and passes where they are not. `--pictures` writes screenshots of
the page of `--run` (or of the trial's own small run) at 1280 and 390 pixels, light and dark. Standard library only.
"""

import argparse
import base64
import json
import pathlib
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
import zlib

OPERATORS = ["linear", "reinhard", "reinhard-extended", "hable", "aces-narkowicz", "aces-hill", "agx", "neutral"]

PIPELINE = """version: 1
pipeline: page
axes:
  operator: [linear, reinhard, reinhard-extended, hable, aces-narkowicz, aces-hill, neutral]
  gamma: [srgb, 1, 2.2]
  n: [16, 64]
params: { odd: odd.pfm }
stages:
  env: { synthesize: { name: cathedral, width: 128 }, save: exr }
  toned: { tone-map: { of: env, operator: $operator, gamma: $gamma, exposure_stops: -1.5 }, save: png }
  toned-agx: { tone-map: { of: env, operator: agx, exposure_stops: -1.5 }, save: png }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n }, save: csv }
  cut: { median-cut: { of: env, count: 16 }, save: json }
  sphere: { relight: { env: env, with: samples, size: 63 }, save: pfm }
  exact: { relight: { env: env, estimator: exact, size: 63 }, save: pfm }
  error: { compare: { of: sphere, to: exact, metrics: [rmse, relmse] } }
  errors: { table: { of: error }, save: csv }
  curve: { plot: { of: error, x: n, y: [rmse] }, save: svg }
  odd: { load: { path: $odd, as: image, sanitize: keep }, save: pfm }
"""


class Browser:
    """A session of chromedriver, over its plain HTTP protocol."""

    def __init__(self, folder):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"http://127.0.0.1:{port}"
        self.driver = subprocess.Popen(["chromedriver", f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for _ in range(100):
            try:
                self.call("GET", "/status")
                break
            except (urllib.error.URLError, ConnectionError):
                time.sleep(0.1)
        arguments = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                     "--force-color-profile=srgb", "--hide-scrollbars", f"--user-data-dir={folder}"]
        wanted = {"browserName": "chrome", "goog:chromeOptions": {"args": arguments}, "goog:loggingPrefs": {"browser": "ALL"}}
        session = self.call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self.path = "/session/" + session["sessionId"]
        self.set("/timeouts", {"script": 120000, "pageLoad": 120000})

    def call(self, method, path, body=None):
        text = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, text, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=180) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(error.read().decode()[:2000]) from None

    def set(self, path, body):
        return self.call("POST", self.path + path, body)

    def devtools(self, command, **parameters):
        return self.set("/goog/cdp/execute", {"cmd": command, "params": parameters})

    def size(self, width, height, scheme="light", scale=1):
        self.devtools("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=width < 600)
        self.devtools("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def open(self, address):
        self.set("/url", {"url": "about:blank"})
        start = time.time()
        self.set("/url", {"url": address})
        return time.time() - start

    def run(self, script, *arguments):
        return self.set("/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, script, what, seconds=30):
        end = time.time() + seconds
        while time.time() < end:
            if self.run(script):
                return
            time.sleep(0.05)
        fail(f"{what} did not come about; {self.run('return document.querySelector(`.message`)?.textContent')}")

    def picture(self, path):
        pathlib.Path(path).write_bytes(base64.b64decode(self.call("GET", self.path + "/screenshot")))

    def messages(self):
        return [entry["message"] for entry in self.set("/se/log", {"type": "browser"})]

    def close(self):
        try:
            self.call("DELETE", self.path)
        finally:
            self.driver.terminate()
            self.driver.wait(10)


def fail(message):
    sys.exit("failed: " + message)


def check(holds, message):
    if not holds:
        fail(message)
    print("passed: " + message, flush=True)


# What stands on the canvas, once everything is loaded and drawn.
LOADED = "const o = document.querySelector('#viewer'); return o && o.dataset.drawn === 'yes'"
READ = """
const canvas = document.querySelector('#viewer canvas'), gl = canvas.getContext('webgl2');
const bytes = new Uint8Array(4 * canvas.width * canvas.height);
gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
let text = '';
for (let at = 0; at < bytes.length; at += 8192) text += String.fromCharCode(...bytes.subarray(at, at + 8192));
return [canvas.width, canvas.height, btoa(text)];
"""


def canvas(browser):
    width, height, text = browser.run(READ)
    data = base64.b64decode(text)
    return lambda x, y: tuple(data[4 * ((height - 1 - y) * width + x):][:3]), width, height


def png(path):
    """Pixels of an 8-bit RGB PNG."""
    data = path.read_bytes()
    at, packed, width = 8, b"", 0
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            width, height, depth, color = struct.unpack(">IIBB", body[:10])
            assert (depth, color) == (8, 2), (depth, color)
        elif kind == b"IDAT":
            packed += body
        at += 12 + length
    raw, rows, before = zlib.decompress(packed), [], bytearray(3 * width)
    for y in range(height):
        filtering, row = raw[y * (3 * width + 1)], bytearray(raw[y * (3 * width + 1) + 1:(y + 1) * (3 * width + 1)])
        for i in range(3 * width):
            left, up, corner = row[i - 3] if i > 2 else 0, before[i], before[i - 3] if i > 2 else 0
            estimate = left + up - corner
            near = min((left, up, corner), key=lambda value: abs(estimate - value))
            row[i] = (row[i] + (0, left, up, (left + up) // 2, near)[filtering]) & 255
        rows.append(row)
        before = row
    return lambda x, y: tuple(rows[y][3 * x:3 * x + 3]), width, height


def view(browser, page, *fields):
    """Opens an address of the viewer and waits until it is drawn."""
    browser.run("location.hash = ''; document.querySelector('#viewer button[title^=Close]')?.click()")
    browser.run("location.hash = arguments[0]", "#" + "&".join(fields))
    browser.wait(LOADED, "a drawn viewer")


def tone_curves(browser, page, outputs):
    """Every tone curve and encoding of the viewer against the pictures that `tone-map` made."""
    cases = [(operator, gamma, f"toned/operator={operator},gamma={gamma}.png") for operator in OPERATORS for gamma in ["srgb", "1", "2.2"]
             if operator != "agx"] + [("agx", "srgb", "toned-agx.png")]
    worst = 0
    for operator, gamma, file in cases:
        expected, width, height = png(outputs / file)
        view(browser, page, "view=env", "ev=-1.5", "operator=" + operator, "gamma=" + gamma, "zoom=1")
        found, canvas_width, canvas_height = canvas(browser)
        left, top = round_half_up(canvas_width / 2 - width / 2), round_half_up(canvas_height / 2 - height / 2)
        for y in range(height):
            for x in range(width):
                difference = max(abs(a - b) for a, b in zip(found(left + x, top + y), expected(x, y)))
                if difference > 1:
                    fail(f"{operator}, gamma {gamma}: pixel {x}, {y} is {found(left + x, top + y)} and should be {expected(x, y)}")
                worst = max(worst, difference)
    check(worst <= 1, f"{len(cases)} tone curves and encodings agree with tone-map within one code value, every pixel (worst {worst})")


def round_half_up(value):
    return int(value + 0.5)


def odd_pfm(path):
    values = [[1, 1, 1], [float("nan"), 0, 0], [float("inf"), 1, 1], [-0.5, 1, 1], [0.25, 0.5, 0.75], [0, 0, 0]]
    rows = [values[3:], values[:3]]
    path.write_bytes(b"PF\n3 2\n-1.0\n" + b"".join(struct.pack("<3f", *pixel) for row in rows for pixel in row))


def text_of(browser, selector):
    return browser.run("return document.querySelector(arguments[0])?.textContent ?? ''", selector)


def odd_pixels(browser, page):
    view(browser, page, "view=odd", "zoom=32", "pixel=1,1", "gamma=1")
    found, width, height = canvas(browser)
    left, top = round_half_up(width / 2 - 48), round_half_up(height / 2 - 32)
    at = lambda x, y: found(left + 32 * x + 9, top + 32 * y + 9)
    check((at(1, 0), at(2, 0), at(0, 1)) == ((255, 0, 255), (255, 224, 0), (0, 214, 255)), "NaN, infinite and negative pixels are marked")
    check(at(1, 1) == (64, 128, 191), "nearest above 1:1: a pixel is one color")
    side = text_of(browser, "#viewer aside")
    check(all(text in side for text in ["1 NaN pixel", "1 infinite pixel", "1 negative pixel"]), "they are counted")
    check("0.25        0.5       0.75" in side, "the values under the pointer are the file's")


def compare_images(browser, page):
    places = "view=sphere%5Bn%3D16%5D+sphere%5Bn%3D64%5D"
    view(browser, page, places, "reference=exact", "mode=diff", "pixel=31,31", "ev=2")
    side = text_of(browser, "#viewer aside")
    check(side.count("Δ") == 2 and "mean of |difference|" in side, "differences against a reference have values and a legend")
    check(browser.run("return document.querySelectorAll('#viewer .panel').length") == 3, "the values of all compared images are shown")
    browser.run("document.querySelector('#viewer .stagebox').dispatchEvent(new KeyboardEvent('keydown', {key: '2', bubbles: true}))")
    browser.wait("return location.hash.includes('mode=flip&') && location.hash.includes('current=1')", "the flip by a key in the address")
    check(True, "a number key flips, and the address says it")
    view(browser, page, "view=env", "shape=ball", "yaw=1.2", "pitch=0.3", "marks=cut")
    found, width, height = canvas(browser)
    over = browser.run("const c = document.querySelectorAll('#viewer canvas')[1]; return c.getContext('2d').getImageData(0, 0, c.width, c.height).data.reduce((n, v, i) => n + (i % 4 == 3 && v > 0), 0)")
    corner, middle = found(3, height // 2), found(width // 2, height // 2)
    check(corner == (21, 23, 27) and middle != corner and over > 500, "a map is a ball with lights and regions on it")


def tables(browser):
    sizes = browser.run("""
      const table = [...document.querySelectorAll('table[data-sort]')].find((table) => table.closest('#tables'));
      const head = [...table.tHead.rows[0].cells].findIndex((cell) => cell.textContent.startsWith('rmse'));
      const read = () => [...table.tBodies[0].rows].map((row) => Number(row.cells[head].textContent));
      table.tHead.rows[0].cells[head].querySelector('button').click();
      const up = read();
      table.tHead.rows[0].cells[head].querySelector('button').click();
      return [up, read()];""")
    check(sizes[0] == sorted(sizes[0]) and sizes[1] == sorted(sizes[1], reverse=True) and len(sizes[0]) == 2, "tables sort by a column")
    told = browser.run("""
      document.querySelector('#jobs .job').click();
      const text = document.querySelector('dialog[open]').textContent;
      document.querySelector('dialog[open]').close();
      return text;""")
    check("pipeline run page.yaml --only" in told and "kind" in told and "key" in told, "a job tells where it comes from and how to make it again")
    browser.run("document.querySelector('.group[data-group=toned]').scrollIntoView()")
    browser.wait("return document.querySelector('.group[data-group=toned] select')", "a grid that can be arranged")
    shown = browser.run("""
      const group = document.querySelector('.group[data-group=toned]');
      const selects = group.querySelectorAll('select');
      selects[0].value = 'gamma'; selects[0].dispatchEvent(new Event('change'));
      return [group.querySelectorAll('.matrix tbody tr').length, group.querySelectorAll('.matrix thead th').length];""")
    check(shown == [3, 7], f"axes become rows and columns as the reader chooses {shown}")


def without_scripts(browser, page):
    browser.devtools("Emulation.setScriptExecutionDisabled", value=True)
    browser.open(page)
    text = browser.call("GET", browser.path + "/source")
    browser.devtools("Emulation.setScriptExecutionDisabled", value=False)
    check("data:image/png" in text and "sphere against exact" in text, "the page is there without scripts")


def many_jobs(browser, program, folder):
    """The page of a run of 10 000 jobs opens in seconds: three are the aim, ten the bound on a busy machine."""
    (folder / "many.yaml").write_text(
        "version: 1\npipeline: many\naxes: { i: { range: [1, 100, 1] }, j: { range: [1, 100, 1] } }\n"
        "stages:\n  t: { synthesize: { name: constant, width: 2, radiance: [$i, $j, 1] } }\n")
    made = subprocess.run([program, "run", "many.yaml", "-q", "--report"], cwd=folder, capture_output=True, text=True)
    if made.returncode:
        fail(made.stderr)
    page = folder / "outputs/many/report.html"
    seconds = min(browser.open(page.as_uri()) for _ in range(2))
    browser.wait("return document.documentElement.dataset.ready === 'yes'", "a ready page")
    check(seconds < 10, f"10 000 jobs with an image each, {page.stat().st_size / 2**20:.1f} MiB: open in {seconds:.2f} s")


def sidecars(browser, program, folder):
    subprocess.run([program, "report", "page", "--budget", "400KiB", "-q"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    page = folder / "outputs/page/report.html"
    check(any((folder / "outputs/page/report.files").iterdir()) and page.stat().st_size <= 400 << 10, "a small budget puts pixels beside the page")
    browser.open(page.as_uri())
    view(browser, page.as_uri(), "view=env", "ev=-1.5", "zoom=1")
    found, width, height = canvas(browser)
    expected, w, h = png(folder / "outputs/page/toned/operator=linear,gamma=srgb.png")
    left, top = round_half_up(width / 2 - w / 2), round_half_up(height / 2 - h / 2)
    near = all(max(abs(a - b) for a, b in zip(found(left + x, top + 30), expected(x, 30))) <= 1 for x in range(w))
    check(near, "pixels are loaded from beside the page, opened from the disk")
    shutil.rmtree(folder / "outputs/page/report.files")
    browser.open(page.as_uri())
    browser.run("location.hash = '#view=env'")
    browser.wait("return document.querySelector('.message')?.textContent.includes('not beside this page')", "word of what is missing")
    check(True, "a page sent without its folder says what is missing")


def without_webgl(browser, page):
    browser.open(page)
    browser.run("""
      const own = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...more) { return kind === 'webgl2' ? null : own.call(this, kind, ...more); };
      location.hash = '#view=env&pixel=64,32';""")
    browser.wait("return /\\d/.test(document.querySelector('#viewer .values')?.textContent ?? '')", "values without WebGL")
    lit = browser.run("""
      const canvas = document.querySelector('#viewer canvas');
      return canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.filter((v, i) => i % 4 === 1 && v > 60).length;""")
    check(lit > 1000 and "no WebGL2" in text_of(browser, "#viewer .message"), "without WebGL the preview and the values are there, and it is said")


def narrow(browser, page):
    for width in [390, 1280]:
        for scheme in ["light", "dark"]:
            browser.size(width, 844, scheme)
            browser.open(page)
            beyond = browser.run("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
            check(beyond <= 0, f"no scrolling sideways at {width} pixels, {scheme}")


def pictures(browser, page, folder):
    folder.mkdir(parents=True, exist_ok=True)
    for width, height in [(1280, 860), (390, 844)]:
        for scheme in ["light", "dark"]:
            browser.size(width, height, scheme, 2 if width < 600 else 1)
            browser.open(page)
            for part in ["top", "images", "figures", "tables", "time", "jobs"]:
                browser.run("document.documentElement.style.scrollBehavior = 'auto'; const e = document.getElementById(arguments[0]); e && scrollTo(0, arguments[0] === 'top' ? 0 : e.offsetTop - 56)", part)
                time.sleep(0.4)
                browser.picture(folder / f"{part}-{width}-{scheme}.png")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("--pictures", type=pathlib.Path, help="folder for screenshots")
    parser.add_argument("--page", type=lambda path: pathlib.Path(path).resolve(), help="only take pictures, of this page")
    given = parser.parse_args()
    if not shutil.which("chromium") or not shutil.which("chromedriver"):
        print("skipped: chromium and chromedriver are not installed here (apt-get install chromium chromium-driver)")
        return
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        browser = Browser(folder / "profile")
        try:
            if given.page:
                pictures(browser, given.page.as_uri(), given.pictures)
                return
            (folder / "page.yaml").write_text(PIPELINE)
            odd_pfm(folder / "odd.pfm")
            made = subprocess.run([given.program, "run", "page.yaml", "--report"], cwd=folder, capture_output=True, text=True)
            if made.returncode:
                fail(made.stderr)
            page = (folder / "outputs/page/report.html").as_uri()
            browser.size(1280, 860)
            browser.open(page)
            browser.wait("return document.documentElement.dataset.ready === 'yes'", "a ready page")
            tone_curves(browser, page, folder / "outputs/page")
            odd_pixels(browser, page)
            compare_images(browser, page)
            browser.open(page)
            tables(browser)
            faults = [text for text in browser.messages() if "favicon" not in text]
            check(not faults, f"the browser has nothing to complain of {faults[:3]}")
            without_scripts(browser, page)
            without_webgl(browser, page)
            narrow(browser, page)
            browser.size(1280, 860)
            sidecars(browser, given.program, folder)
            many_jobs(browser, given.program, folder)
            if given.pictures:
                pictures(browser, page, given.pictures)
        finally:
            browser.close()


main()
