#!/usr/bin/env python3
"""Runs the corpus of bad and odd inputs, but for the cases of kinds and options that do not exist yet.

  PIPELINE_BIN=target/release/pipeline python3 tests/trials/corpus.py CORPUS [further options of badinput.py]

What is left out is printed, each with the word that it needs; everything else must pass.
"""
import json, os, re, subprocess, sys

# Words of later issues that a case's pipeline uses where it must be accepted, or names in what it must say.
ABSENT = ["denoise", "lobe", "sobol", "mis_compensation", "defensive"]
TEMPLATES_ABSENT = {"png": "bitmap"}  # textures of images

# Files whose values are not finite: `load` accepts and publishes them, `distribution` refuses them at their line and
# pixel, as the corpus's own decisions say; these cases would have nothing published. A result knows no file name.
PUBLISHED_FIRST = {
    "pfm/mut_014.pfm",
    "exr_public/TestImages_BrightRingsNanInf.exr",
    "exr_public/TestImages_AllHalfValues.exr",
}


def needs(corpus, case):
    if case.get("id", case["file"]) in PUBLISHED_FIRST:
        return "a failed run that publishes nothing"
    if case["kind"] in TEMPLATES_ABSENT and case.get("template") != "load":
        return TEMPLATES_ABSENT[case["kind"]]
    if case["kind"] != "yaml" or "gen" in case:
        return None
    text = open(os.path.join(corpus, case["file"]), "rb").read().decode("utf-8", "replace")
    return next((word for word in ABSENT if re.search(rf"\b{word}\b", text)), None)


def main():
    corpus = sys.argv[1]
    kept, left_out = [], {}
    for name in ("expect.jsonl", "expect_public.jsonl", "expect_yaml.jsonl"):
        for line in open(os.path.join(corpus, name)):
            case = json.loads(line)
            identity = case.get("id", case["file"])
            word = needs(corpus, case)
            if word:
                left_out.setdefault(word, []).append(identity)
            else:
                kept.append(identity)
    for word, identities in left_out.items():
        shown = ", ".join(identities[:6]) + (", …" if len(identities) > 6 else "")
        print(f"skipped: {len(identities)} cases that need `{word}`: {shown}")
    only = "^(" + "|".join(re.escape(identity) for identity in kept) + ")$"
    command = [sys.executable, os.path.join(corpus, "run", "badinput.py"), corpus, "--only", only, *sys.argv[2:]]
    sys.exit(subprocess.run(command).returncode)


main()
