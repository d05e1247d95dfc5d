#!/usr/bin/env python3
"""Holds the crate of a run against the public roc-validator.

  PIPELINE_BIN=target/release/pipeline python3 tests/trials/ro_crate.py [CONTEXTS]

Installs roc-validator from PyPI into a virtual environment in a temporary folder; without a registry it says so and
ends. CONTEXTS is a folder with `ro-crate-1.1.json` (RO-Crate 1.1's context.jsonld) and `workflow-run.json` (that of
ro-terms); with it no network is needed for the contexts, without it the validator fetches them itself.
"""
import os, subprocess, sys, tempfile, textwrap, urllib.request

PIPELINE = """
version: 1
pipeline: crate
seed: 7
params: { map: map.pfm }
axes: { n: [4, 8] }
stages:
  env: { load: { path: $map } }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n }, save: csv }
  sky: { synthesize: { name: gradient, width: 16 }, save: [exr, png] }
"""

# Runs the validator with the contexts from a folder in the place of the network.
DRIVER = """
import json, os, sys
folder, arguments = sys.argv[1], sys.argv[2:]
sys.argv = ["rocrate-validator"] + arguments
known = {"https://w3id.org/ro/crate/1.1/context": "ro-crate-1.1.json", "https://w3id.org/ro/terms/workflow-run/context": "workflow-run.json"}
texts = {url: open(os.path.join(folder, name), "rb").read() for url, name in known.items()}
from rocrate_validator.utils import http
import requests
def answer(url):
    response = requests.Response()
    response.status_code, response.url, response._content = 200, url, texts[url]
    response.headers["Content-Type"] = "application/ld+json"
    return response
# Every way out of the process is this one.
plain = requests.Session.request
requests.Session.request = lambda self, method, url, **rest: answer(url) if url in texts else plain(self, method, url, **rest)
from requests_cache import CachedSession
cached = CachedSession.request
CachedSession.request = lambda self, method, url, *rest, **more: answer(url) if url in texts else cached(self, method, url, *rest, **more)
import rdflib.plugins.shared.jsonld.context as context, rdflib.plugins.shared.jsonld.util as util
def source(url, *rest, **more):
    return (json.loads(texts[str(url)]), None) if str(url) in texts else original(url, *rest, **more)
original = util.source_to_json
util.source_to_json = context.source_to_json = source
from rocrate_validator.cli.main import cli
cli()
"""


def run(command, **options):
    print("+", " ".join(command), flush=True)
    return subprocess.run(command, **options)


def can_fetch(address):
    try:
        with urllib.request.urlopen(address, timeout=10):
            return True
    except OSError:
        return False


def main():
    program = os.path.abspath(os.environ.get("PIPELINE_BIN", "target/release/pipeline"))
    contexts = os.path.abspath(sys.argv[1]) if len(sys.argv) > 1 else None
    if not contexts and not can_fetch("https://w3id.org/ro/crate/1.1/context"):
        print("skipped: the contexts of RO-Crate cannot be fetched here; give a folder with them")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        python = os.path.join(folder, "venv", "bin", "python")
        if "ROC_PYTHON" in os.environ:
            python = os.environ["ROC_PYTHON"]
        else:
            run([sys.executable, "-m", "venv", os.path.join(folder, "venv")], check=True)
            if run([python, "-m", "pip", "install", "-q", "roc-validator==0.13.0"]).returncode != 0:
                print("skipped: roc-validator cannot be installed here")
                return 0
        with open(os.path.join(folder, "crate.yaml"), "w") as file:
            file.write(textwrap.dedent(PIPELINE))
        with open(os.path.join(folder, "map.pfm"), "wb") as file:
            file.write(b"PF\n4 2\n-1.0\n" + b"\0\0\x80?" * 24)
        driver = os.path.join(folder, "driver.py")
        with open(driver, "w") as file:
            file.write(DRIVER)
        start = [python, driver, contexts] if contexts else [os.path.join(os.path.dirname(python), "rocrate-validator")]
        runs = [
            ("everything is executed", [], "provenance-run-crate"),
            ("some of it is", ["-s", "map=map.pfm", "--force", "samples[n=4]"], "provenance-run-crate"),
            ("nothing is, files are restored", None, "workflow-run-crate"),
        ]
        for name, arguments, profile in runs:
            if arguments is None:
                os.remove(os.path.join(folder, "outputs/crate/sky.png"))
            run([program, "run", "crate.yaml", "-q", *(arguments or [])], cwd=folder, check=True, stdout=subprocess.DEVNULL)
            command = ["-y", "validate", "-p", profile, "-l", os.environ.get("SEVERITY", "required"), "--no-paging", "--verbose", "outputs/crate"]
            if run([*start, *command], cwd=folder).returncode != 0:
                print(f"failed: {name}: the crate does not pass")
                return 1
            print(f"passed: {name}: {profile}")
    return 0


sys.exit(main())
