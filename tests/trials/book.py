#!/usr/bin/env python3
"""Every command block of the documentation runs, and prints what the page says.

    cargo build --release && python3 tests/trials/book.py target/release/pipeline [--python v/bin/python] [--only PAGE] [--keep]

Each page has a scratch folder of its own, with the program on the path. What the words after ```LANGUAGE mean:

    yaml file=NAME    the block is written to NAME (python likewise); a pipeline that no command names must pass `pipeline check`
    yaml append=NAME  the block is added to NAME
    sh                the block runs in bash and must succeed
    sh needs=MODULE   it runs if that Python has the module; else that is said aloud
    sh not-run=WHY    it is not run, and that is said aloud
    text output       each line occurs in this order in what the block before printed; `…` stands for anything

Prints one line per page; exit 1 at the first block that does something else. Python 3.11, standard library only.
"""
import argparse
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
FENCE = re.compile(r"^( *)```(\w+)([^\n]*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)


def blocks(page):
    """Language, words after it, text and line of each block of a page."""
    text = page.read_text()
    for found in FENCE.finditer(text):
        indent, language, words, body = found.groups()
        lines = [line.removeprefix(indent) for line in body.splitlines()]
        yield language, words.strip(), "\n".join(lines) + "\n", text.count("\n", 0, found.start()) + 1


class Page:
    """A page whose blocks run one after the other in a folder."""

    def __init__(self, path, folder, given):
        self.path, self.folder, self.given = path, folder, given
        self.printed = ""
        self.run_count = 0
        self.left_out = []
        (folder / "bin").mkdir()
        (folder / "bin" / "pipeline").symlink_to(given.program)
        (folder / "bin" / "python3").write_text(f'#!/bin/sh\nexec "{given.python}" "$@"\n')
        (folder / "bin" / "python3").chmod(0o755)
        (folder / "work").mkdir()

    def block(self, language, words, text, line):
        where = f"{self.path.relative_to(ROOT)}:{line}"
        name, _, value = words.partition("=")
        if name in ("file", "append"):
            with open(self.folder / "work" / value, "a" if name == "append" else "w") as out:
                out.write(text)
        elif language == "sh":
            self.shell(name, value, text, where)
        elif language == "text" and words == "output":
            self.compare(text, where)
        elif words:
            sys.exit(f"{where}: what does `{words}` mean? The head of {pathlib.Path(__file__).name} says what can stand here")

    def shell(self, name, value, text, where):
        if name == "not-run":
            return self.left_out.append(f"{where}: {value}")
        if name == "needs" and not self.has(value):
            return self.left_out.append(f"{where}: `{value}` is not installed")
        environment = {**os.environ, "PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}", "NO_COLOR": "1", "LC_ALL": "C.UTF-8"}
        for variable in ("PIPELINE_OUTPUTS", "PIPELINE_STORE"):
            environment.pop(variable, None)
        command = ["bash", "-e", "-o", "pipefail", "-c", text]
        done = subprocess.run(
            command, cwd=self.folder / "work", env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300
        )
        self.printed = done.stdout
        self.run_count += 1
        if self.given.show:
            print(f"--- {where}\n{text}--- printed\n{done.stdout}")
        if done.returncode != 0:
            sys.exit(f"{where}: exit code {done.returncode}\n{text}\n{done.stdout}")

    def has(self, module):
        return subprocess.run([self.given.python, "-c", f"import {module}"], stderr=subprocess.DEVNULL).returncode == 0

    def compare(self, text, where):
        """Each line is found after the one before; lines of `…` alone say nothing."""
        printed = self.printed.splitlines()
        position = 0
        for wanted in text.splitlines():
            pattern = re.compile(".*".join(re.escape(part.strip()) for part in wanted.split("…")) if "…" in wanted else re.escape(wanted.rstrip()))
            found = next((k for k in range(position, len(printed)) if pattern.fullmatch(printed[k].rstrip()) or "…" in wanted and pattern.search(printed[k])), None)
            if found is None:
                sys.exit(f"{where}: `{wanted}` is not in what was printed, or not in that order:\n{self.printed}")
            position = found if wanted.strip() == "…" else found + 1


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("--python", default=sys.executable, help="the Python of the pages (default: this one)")
    parser.add_argument("--only", help="pages whose path has this in it")
    parser.add_argument("--show", action="store_true", help="show what every block prints")
    given = parser.parse_args()
    given.python = shutil.which(given.python) or given.python
    given.python = os.path.abspath(given.python)
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    for path in pages:
        if given.only and given.only not in str(path.relative_to(ROOT)):
            continue
        found = list(blocks(path))
        if not any(language == "sh" or words for language, words, _, _ in found):
            continue
        with tempfile.TemporaryDirectory() as folder:
            page = Page(path, pathlib.Path(folder), given)
            begun = time.monotonic()
            for block in found:
                page.block(*block)
            commands = " ".join(text for language, _, text, _ in found if language == "sh")
            for language, words, text, line in found:
                name = words.removeprefix("file=")
                if language == "yaml" and name != words and text.startswith("version:") and name not in commands:
                    page.shell("", "", f"pipeline check {name}", f"{path.relative_to(ROOT)}:{line}")
            print(f"{path.relative_to(ROOT)}: {page.run_count} command blocks, {time.monotonic() - begun:.1f} s", flush=True)
            for left_out in page.left_out:
                print(f"  not run: {left_out}", flush=True)


if __name__ == "__main__":
    main()
