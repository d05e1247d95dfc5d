#!/usr/bin/env python3
"""Watches `pipeline watch`: it runs at once, again after each change, survives mistakes, and ends at a signal.

  PIPELINE_BIN=target/release/pipeline python3 tests/trials/watch.py
"""
import os, signal, subprocess, sys, tempfile, time

TEXT = """version: 1
pipeline: watched
include: [more.yaml]
stages:
  env: { load: { path: sky.pfm }, save: pfm }
"""
MORE = "stages:\n  sky: { synthesize: { name: gradient, width: WIDTH }, save: png }\n"
PATIENCE = float(os.environ.get("PATIENCE", "20"))


def pfm(value):
    import struct
    return b"PF\n4 2\n-1.0\n" + struct.pack("<24f", *[value] * 24)


def main():
    program = os.path.abspath(os.environ.get("PIPELINE_BIN", "target/release/pipeline"))
    with tempfile.TemporaryDirectory() as folder:
        def write(name, content):
            # As editors do: a new file in the place of the old one.
            path = os.path.join(folder, name)
            with open(path + "~", "wb") as file:
                file.write(content if isinstance(content, bytes) else content.encode())
            os.replace(path + "~", path)

        write("watched.yaml", TEXT)
        write("more.yaml", MORE.replace("WIDTH", "16"))
        write("sky.pfm", pfm(1.0))
        log = open(os.path.join(folder, "log"), "w+")
        watcher = subprocess.Popen([program, "watch", "watched.yaml", "--report"], cwd=folder, stdout=subprocess.DEVNULL, stderr=log)

        def expect(text, count=1):
            end = time.time() + PATIENCE
            while time.time() < end:
                seen = open(log.name).read()
                if seen.count(text) >= count:
                    print(f"passed: {text} ({count})", flush=True)
                    return
                time.sleep(0.05)
            sys.exit(f"failed: `{text}` was not said {count} times:\n{open(log.name).read()}")

        try:
            expect("waiting for changes of 3 files")
            write("sky.pfm", pfm(2.0))
            expect("file sky.pfm changed")
            expect("waiting for changes", 2)
            write("more.yaml", MORE.replace("WIDTH", "32"))
            expect("parameter width 16 -> 32")
            expect("waiting for changes", 3)
            page = open(os.path.join(folder, "outputs/watched/report.html")).read()
            if "parameter width 16 -&gt; 32" not in page:
                sys.exit("failed: the report is not fresh")
            print("passed: the report is fresh after a change")
            write("watched.yaml", TEXT.replace("load:", "laod:"))
            expect("waiting for a repair")
            write("watched.yaml", TEXT.replace("sky.pfm", "gone.pfm"))
            expect("waiting for a repair", 2)
            write("gone.pfm", pfm(3.0))
            expect("parameter path sky.pfm -> gone.pfm")
            expect("waiting for changes", 4)
            time.sleep(3)
            ticks = sum(map(int, open(f"/proc/{watcher.pid}/stat").read().split()[13:15]))
            print(f"processor time so far: {ticks / os.sysconf('SC_CLK_TCK'):.2f} s")
            watcher.send_signal(signal.SIGINT)
            code = watcher.wait(5)
            if code != 130:
                sys.exit(f"failed: ended with {code}")
            print("passed: a signal ends it with 130")
        finally:
            watcher.kill()


main()
