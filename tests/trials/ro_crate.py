#!/usr/bin/env python3
"""Holds the crate of a run against rules of RO-Crate and its profiles, and against the public roc-validator.

  PIPELINE_BIN=target/release/pipeline python3 tests/trials/ro_crate.py [CONTEXTS]

The rules are those of `FIELDS` and `faults` below, after RO-Crate 1.1 and the Workflow Run profiles 0.5; they need nothing from outside, and
each of them is shown to notice what it forbids. Then it installs roc-validator from PyPI into a virtual environment in a temporary folder; without a registry it says so and
ends there. CONTEXTS is a folder with `ro-crate-1.1.json` (RO-Crate 1.1's context.jsonld) and `workflow-run.json` (that of
ro-terms); with it no network is needed for the contexts, without it the validator fetches them itself.
"""
import copy, hashlib, json, os, re, subprocess, sys, tempfile, textwrap, urllib.parse, urllib.request

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


CRATE = "https://w3id.org/ro/crate/1.1"
PROFILE = "https://w3id.org/ro/wfrun/"
MOMENT = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(Z|[+-]\d\d:\d\d)"

# What an entity of a type must have: a pattern for text, a type in brackets for references to such entities.
FIELDS = {
    "Dataset": {"name": ".", "description": ".", "datePublished": MOMENT, "license": "[CreativeWork]", "conformsTo": "[CreativeWork]",
                "mainEntity": "[ComputationalWorkflow]", "hasPart": "[File]", "mentions": "[Action]"},
    "File": {"name": "."},
    "ComputationalWorkflow": {"name": ".", "programmingLanguage": "[ComputerLanguage]", "input": "[FormalParameter]", "output": "[FormalParameter]"},
    "HowTo": {"step": "[HowToStep]", "hasPart": "[SoftwareApplication]"},
    "HowToStep": {"name": ".", "position": r"\d+", "workExample": "[SoftwareApplication]"},
    "ComputerLanguage": {"name": "."},
    "SoftwareApplication": {"name": ".", "softwareVersion": "."},
    "FormalParameter": {"name": ".", "additionalType": "PropertyValue|File"},
    "PropertyValue": {"name": ".", "value": ""},
    "CreateAction": {"name": ".", "instrument": "[ComputationalWorkflow|SoftwareApplication]",
                     "actionStatus": r"http://schema\.org/(Completed|Failed)ActionStatus"},
    "ControlAction": {"name": ".", "instrument": "[HowToStep]", "object": "[CreateAction]"},
    "OrganizeAction": {"name": ".", "instrument": "[SoftwareApplication]", "object": "[ControlAction]", "result": "[CreateAction]"},
}


def listed(value):
    return value if isinstance(value, list) else [value]


def types_of(entity):
    return listed(entity.get("@type", []))


def references(entity, field):
    return [item["@id"] for item in listed(entity.get(field, [])) if isinstance(item, dict)]


def field_faults(entity, kind, field, wanted, by_id):
    if field not in entity:
        return [f"{entity['@id']}: a {kind} has no {field}"]
    if not wanted.startswith("["):
        right = isinstance(entity[field], str) and re.match(wanted, entity[field])
        return [] if right else [f"{entity['@id']}: {field} is {entity[field]!r}"]
    kinds = wanted.strip("[]").split("|")
    found = [by_id.get(target, {}) for target in references(entity, field)]
    right = [target for target in found if any(one.endswith(kind) for one in types_of(target) for kind in kinds)]
    return [] if len(right) == len(found) == len(listed(entity[field])) else [f"{entity['@id']}: {field} leads to something else than {kinds}"]


def faults(document, folder):
    """What is wrong with a crate whose files stand in a folder."""
    wrong = []
    if f"{CRATE}/context" not in listed(document.get("@context")):
        wrong.append("the context is not that of RO-Crate")
    graph = document["@graph"]
    by_id = {entity.get("@id"): entity for entity in graph}
    if len(by_id) != len(graph) or None in by_id:
        wrong.append("an @id is missing or stands twice")
    for entity in graph:
        if not types_of(entity):
            wrong.append(f"{entity['@id']} has no type")
        for field, value in entity.items():
            for item in listed(value):
                # Flat JSON-LD: text, or a reference and nothing else.
                if isinstance(item, dict) and (list(item) != ["@id"] or not (item["@id"] in by_id or item["@id"].startswith("http"))):
                    wrong.append(f"{entity['@id']}: {field} leads to {item}, which is not there")
                elif not isinstance(item, (dict, str)):
                    wrong.append(f"{entity['@id']}: {field} is {item!r}")
        for kind in types_of(entity):
            for field, wanted in FIELDS.get(kind, {}).items():
                wrong += field_faults(entity, kind, field, wanted, by_id)
    descriptor = by_id.get("ro-crate-metadata.json", {})
    if references(descriptor, "about") != ["./"] or references(descriptor, "conformsTo")[:1] != [CRATE]:
        wrong.append("the descriptor does not tell the crate's version or what it is about")
    root = by_id.get("./", {})
    if not any(profile.startswith(PROFILE) for profile in references(root, "conformsTo")):
        wrong.append("the root names no profile of a run")
    parts = set(references(root, "hasPart"))
    for entity in graph:
        name = entity.get("@id", "")
        if "File" not in types_of(entity) or re.match("[a-z]+:", name):
            continue
        path = os.path.join(folder, urllib.parse.unquote(name))
        if name not in parts:
            wrong.append(f"{name} is no part of the root")
        if not os.path.isfile(path):
            wrong.append(f"{name} is not there")
        elif entity.get("sha256", "") not in ("", hashlib.sha256(open(path, "rb").read()).hexdigest()):
            wrong.append(f"{name} has other bytes than its entity says")
    runs = [entity for entity in graph if "CreateAction" in types_of(entity) and references(entity, "instrument") == references(root, "mainEntity")]
    if len(runs) != 1 or runs[0]["@id"] not in references(root, "mentions"):
        wrong.append("there is not one run of the workflow that the root mentions")
    for moment in ("startTime", "endTime"):
        if any(not re.fullmatch(MOMENT, action.get(moment, "")) for action in runs):
            wrong.append(f"the run has no {moment}")
    for formal in (entity for entity in graph if "FormalParameter" in types_of(entity)):
        for example in references(formal, "workExample"):
            if formal["@id"] not in references(by_id[example], "exampleOfWork"):
                wrong.append(f"{example} does not say that it is an example of {formal['@id']}")
    return wrong


def check_rules(folder):
    """The crate of a folder follows the rules; and no field that they ask for can go without their noticing."""
    with open(os.path.join(folder, "ro-crate-metadata.json")) as file:
        document = json.load(file)
    found = faults(document, folder)
    tried = 0
    for index, entity in enumerate(document["@graph"]):
        for field in {field for kind in types_of(entity) for field in FIELDS.get(kind, {})} & set(entity) | {"@type"}:
            broken = copy.deepcopy(document)
            del broken["@graph"][index][field]
            tried += 1
            if not faults(broken, folder):
                found.append(f"{entity['@id']} without {field} is not noticed")
    for fault in found:
        print(f"wrong: {fault}")
    print(f"{'failed' if found else 'passed'}: rules of RO-Crate: {len(document['@graph'])} entities, {tried} fields taken away one by one")
    return not found


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
    with tempfile.TemporaryDirectory() as folder:
        with open(os.path.join(folder, "crate.yaml"), "w") as file:
            file.write(textwrap.dedent(PIPELINE))
        with open(os.path.join(folder, "map.pfm"), "wb") as file:
            file.write(b"PF\n4 2\n-1.0\n" + b"\0\0\x80?" * 24)
        validator = validator_in(folder, contexts)
        runs = [
            ("everything is executed", [], "provenance-run-crate"),
            ("some of it is", ["-s", "map=map.pfm", "--force", "samples[n=4]"], "provenance-run-crate"),
            ("nothing is, files are restored", None, "workflow-run-crate"),
        ]
        for name, arguments, profile in runs:
            if arguments is None:
                os.remove(os.path.join(folder, "outputs/crate/sky.png"))
            run([program, "run", "crate.yaml", "-q", *(arguments or [])], cwd=folder, check=True, stdout=subprocess.DEVNULL)
            if not check_rules(os.path.join(folder, "outputs/crate")):
                return 1
            command = ["-y", "validate", "-p", profile, "-l", os.environ.get("SEVERITY", "required"), "--no-paging", "--verbose", "outputs/crate"]
            if validator and run([*validator, *command], cwd=folder).returncode != 0:
                print(f"failed: {name}: the crate does not pass")
                return 1
            print(f"passed: {name}: {profile if validator else 'by the rules alone'}")
    return 0


def validator_in(folder, contexts):
    """The command of the public validator, installed into a folder; `None`, said aloud, where it cannot be had."""
    if not contexts and not can_fetch("https://w3id.org/ro/crate/1.1/context"):
        print("skipped: roc-validator: the contexts of RO-Crate cannot be fetched here; give a folder with them")
        return None
    python = os.environ.get("ROC_PYTHON", os.path.join(folder, "venv", "bin", "python"))
    if "ROC_PYTHON" not in os.environ:
        run([sys.executable, "-m", "venv", os.path.join(folder, "venv")], check=True)
        if run([python, "-m", "pip", "install", "-q", "roc-validator==0.13.0"]).returncode != 0:
            print("skipped: roc-validator cannot be installed here")
            return None
    driver = os.path.join(folder, "driver.py")
    with open(driver, "w") as file:
        file.write(DRIVER)
    return [python, driver, contexts] if contexts else [os.path.join(os.path.dirname(python), "rocrate-validator")]


sys.exit(main())
