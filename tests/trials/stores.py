#!/usr/bin/env python3
"""Stores behind a store: folders and S3 servers, honest and weak, slow and failing, forged and damaged.

Whatever is behind it, a run gives the same result_id and the same files; a second machine with an empty store of its own executes
nothing; what fails there is told once and costs work, never a result.

  python3 tests/trials/stores.py target/release/pipeline [--moto moto_server] [--s3s-fs s3s-fs]

The program needs the feature `s3` for the servers (`moto[server]` of PyPI, `cargo install s3s-fs --features binary`); what is not there is skipped aloud.
"""
import argparse
import http.client
import http.server
import json
import os
import pathlib
import random
import re
import shutil
import socket
import subprocess
import tempfile
import threading
import time
import urllib.request

import trial

PIPELINE = """version: 1
pipeline: stores
seed: 7
axes: { n: [4, 16, 64] }
stages:
  env: { synthesize: { name: studio, width: 128 }, save: pfm }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n }, save: csv }
  sphere: { relight: { env: env, with: samples, size: 31 }, save: [pfm, png] }
"""
JOBS = 8
FILES = 10


class Machine:
    """A folder of outputs, and a store that no other machine has."""

    def __init__(self, program, scratch):
        self.program = program
        self.folder = pathlib.Path(tempfile.mkdtemp(dir=scratch))
        (self.folder / "stores.yaml").write_text(PIPELINE)

    def command(self, *arguments, env=None, code=0):
        done = subprocess.run(
            [self.program, *map(str, arguments)], cwd=self.folder, capture_output=True, text=True, timeout=300,
            env={**os.environ, "NO_COLOR": "1", **(env or {})},
        )
        if done.returncode != code or "panicked" in done.stderr:
            trial.fail(f"{arguments}: exit code {done.returncode}\n{done.stderr}{done.stdout}")
        return done

    def run(self, *arguments, env=None):
        done = self.command("run", "stores.yaml", "--format", "json", *arguments, env=env)
        return json.loads(done.stdout), done.stderr

    def files(self):
        folder = self.folder / "outputs" / "stores"
        return {path.relative_to(folder): path.read_bytes() for path in folder.glob("*/*") if "runs" not in path.parts} | {
            path.relative_to(folder): path.read_bytes() for path in folder.glob("*.pfm")
        }


class Right:
    """What a run without anything behind its store gives."""

    def __init__(self, program, scratch):
        self.program, self.scratch = program, scratch
        alone = self.machine()
        summary, _ = alone.run()
        self.result_id, self.files = summary["result_id"], alone.files()
        assert trial.executed(summary) == JOBS, summary

    def machine(self):
        return Machine(self.program, self.scratch)

    def check(self, machine, summary, what):
        if summary["result_id"] != self.result_id or summary["status"] != "done":
            trial.fail(f"{what}: {summary}")
        if machine.files() != self.files:
            trial.fail(f"{what}: files differ")

    def run(self, what, *arguments, env=None, executed=None, says=()):
        """A run of a new machine."""
        machine = self.machine()
        begun = time.monotonic()
        summary, said = machine.run(*arguments, env=env)
        seconds = time.monotonic() - begun
        self.check(machine, summary, what)
        if executed is not None and trial.executed(summary) != executed:
            trial.fail(f"{what}: {trial.executed(summary)} jobs ran, expected {executed}\n{said}")
        for text in says:
            if said.count(text) != 1:
                trial.fail(f"{what}: `{text}` is said {said.count(text)} times:\n{said}")
        if not says and " store" in said:
            trial.fail(f"{what}: {said}")
        print(f"passed: {what} ({trial.executed(summary)} jobs ran, {seconds:.2f} s)", flush=True)
        return machine


def with_store(right, name, remote, env=None):
    """What must hold of every store that is not at fault."""
    far = ["--store-remote", remote]
    right.run(f"{name}: a first machine", *far, env=env, executed=JOBS)
    right.run(f"{name}: a second machine executes nothing", *far, env=env, executed=0)
    right.run(f"{name}: only read", *far, "--store-remote-read-only", env=env, executed=0)
    machine = right.machine()
    key = machine.folder / "key"
    machine.command("store", "keygen", key)
    right.run(
        f"{name}: records of no key that is trusted", *far, "--store-trust", f"{key}.pub", "--store-remote-read-only", env=env,
        executed=JOBS, says=["not signed by a key that is trusted here"],
    )
    right.run(f"{name}: signed anew", *far, "--store-sign", key, "--store-trust", f"{key}.pub", env=env, executed=JOBS,
              says=["not signed by a key that is trusted here"])
    right.run(f"{name}: signed by a trusted key", *far, "--store-trust", f"{key}.pub", env=env, executed=0)

    sender, receiver = right.machine(), right.machine()
    summary, _ = sender.run()
    place = remote.rstrip("/") + "-sent"
    if "://" not in place:
        os.mkdir(place, 0o700)
    sent = json.loads(sender.command("store", "push", "stores", place, "--format", "json", env=env).stdout)
    assert sent["run_id"] == summary["run_id"] and sent["new"] == sent["records"] > JOBS, sent
    again = json.loads(sender.command("store", "push", "stores", place, "--format", "json", env=env).stdout)
    assert again["new"] == 0 and again["records"] == sent["records"], again
    brought = json.loads(receiver.command("store", "pull", "stores", place, "--format", "json", env=env).stdout)
    assert brought["files"] == FILES and brought["records"] == sent["records"], brought
    pulled, _ = receiver.run()
    right.check(receiver, pulled, f"{name}: a run that was pulled")
    assert trial.executed(pulled) == 0, pulled
    receiver.command("store", "verify")
    receiver.command("diff", "stores", str(sender.folder / "outputs" / "stores"))
    print(f"passed: {name}: a run is pushed and pulled")
    checked = sender.command("store", "check", remote, env=env)
    print("".join(f"  {line}\n" for line in checked.stdout.splitlines()), end="", flush=True)


def damage(path, how):
    if how == "gone":
        path.unlink()
    elif how == "short":
        path.write_bytes(path.read_bytes()[:-3])
    else:
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 64
        path.write_bytes(content)


def folders(right, scratch):
    far = scratch / "far"
    far.mkdir(mode=0o700)
    with_store(right, "folder", str(far))
    for how in ("gone", "short", "flipped"):
        for shelf in ("cas", "ac", "publications"):
            for path in sorted((far / "v1" / shelf).glob("*/*")):
                damage(path, how)
            machine = right.machine()
            summary, _ = machine.run("--store-remote", str(far))
            right.check(machine, summary, f"{how} {shelf}")
            right.run(f"folder: every object of {shelf} was {how}, and is healed", "--store-remote", str(far), executed=0)


SWEEP = """version: 1
pipeline: stores
axes: { n: { range: [1, COUNT, 1] } }
stages:
  pixel: { synthesize: { name: constant, width: 2 } }
  leaf: { compare: { of: pixel, to: pixel, metrics: [psnr], peak: $n }, save: csv }
"""


def scale(right, scratch, count):
    """How long it takes to plan, to check and to take over so many cached jobs from a folder."""
    far = scratch / "scale"
    far.mkdir(mode=0o700)
    key = scratch / "scale.key"
    right.machine().command("store", "keygen", key)
    behind = ["--store-remote", far, "--store-sign", key, "--store-trust", f"{key}.pub"]

    def timed(machine, *arguments):
        begun = time.monotonic()
        done = machine.command(*arguments, *behind)
        return time.monotonic() - begun, json.loads(done.stdout)

    def sweep():
        machine = right.machine()
        (machine.folder / "stores.yaml").write_text(SWEEP.replace("COUNT", str(count)))
        return machine

    run = ["run", "stores.yaml", "--format", "json"]
    first, summary = timed(sweep(), *run)
    assert trial.executed(summary) == count + 1, summary["measured"]
    second = sweep()
    plan, jobs = timed(second, "plan", "stores.yaml", "--format", "json")
    hits = sum(job["outcome"] == "hit" for job in jobs["jobs"])
    if hits != count + 1:
        trial.fail(f"{hits} of {count + 1} jobs were found")
    full, again = timed(second, *run)
    if trial.executed(again) != 0 or again["result_id"] != summary["result_id"]:
        trial.fail(f"a second machine: {again['measured']}")
    third = sweep()
    fresh, _ = timed(third, *run)
    print(
        f"{count + 1} signed jobs behind a folder: computed and sent in {first:.2f} s; a second machine plans in {plan:.2f} s, then runs in "
        f"{full:.2f} s; a third, which has not planned, runs in {fresh:.2f} s", flush=True,
    )


def free_port():
    with socket.socket() as made:
        made.bind(("127.0.0.1", 0))
        return made.getsockname()[1]


class Proxy:
    """Passes requests on to a server, and answers some of them as a bad day would."""

    def __init__(self, target, fault=None):
        self.target, self.fault, self.count, self.hits = target, fault, 0, 0
        proxy = self

        class Handler(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def answer(self):
                body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
                proxy.count += 1
                fault = proxy.fault(proxy.count, self.command, self.path) if proxy.fault else None
                if fault:
                    proxy.hits += 1
                if isinstance(fault, int):
                    return self.reply(fault, b"<Error><Code>Injected</Code></Error>")
                headers = {name: value for name, value in self.headers.items() if name.lower() not in ("connection", "content-length")}
                if fault == "unconditional":
                    headers.pop("If-None-Match", None)
                    headers.pop("if-none-match", None)
                connection = http.client.HTTPConnection(proxy.target.removeprefix("http://"), timeout=60)
                connection.request(self.command, self.path, body or None, headers)
                response = connection.getresponse()
                status, head, found = response.status, response.headers, response.read()
                connection.close()
                if fault == "silence":
                    # It was done, and the answer is lost.
                    self.close_connection = True
                    return
                if fault == "flip" and found and status == 200:
                    found = found[:-1] + bytes([found[-1] ^ 1])
                if fault == "absent":
                    status, found = 404, b"<Error><Code>NoSuchKey</Code></Error>"
                self.reply(status, found, head, cut=fault == "short")

            def reply(self, status, body, head=(), cut=False):
                self.send_response(status)
                for name, value in dict(head).items():
                    if name.lower() not in ("connection", "transfer-encoding", "content-length", "date", "server"):
                        self.send_header(name, value)
                length = dict(head).get("Content-Length", "0") if self.command == "HEAD" else str(len(body))
                self.send_header("Content-Length", length)
                self.end_headers()
                if self.command != "HEAD":
                    self.wfile.write(body[: len(body) // 2] if cut else body)
                if cut:
                    self.close_connection = True

            do_GET = do_PUT = do_HEAD = do_POST = do_DELETE = answer

            def log_message(self, *_):
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}"


class Server:
    """An S3 server of its own, ended with the trial."""

    def __init__(self, name, command, scratch):
        self.name, self.port = name, free_port()
        log = open(scratch / f"{name}.log", "w")
        self.process = subprocess.Popen([*command(self.port)], stdout=log, stderr=log)
        self.url = f"http://127.0.0.1:{self.port}"
        for _ in range(200):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.1)
        trial.fail(f"{name} does not start")

    def environment(self, url=None):
        return {
            "AWS_ENDPOINT_URL": url or self.url, "AWS_REGION": "us-east-1", "AWS_ACCESS_KEY_ID": "trial", "AWS_SECRET_ACCESS_KEY": "trial-secret",
        }

    def end(self):
        self.process.terminate()
        self.process.wait(10)


def anonymous(environment):
    return {name: value for name, value in environment.items() if "KEY" not in name}


def faults(right, server, bucket):
    """A server on bad days: the run is right each time, and what it learned there is right for the next machine."""
    draws = random.Random(7)
    some = lambda share: (lambda *_: draws.random() < share)
    days = {
        "503 now and then": lambda n, method, path: 503 if some(0.15)() else None,
        "503 always": lambda n, method, path: 503,
        "403 always": lambda n, method, path: 403,
        "403 to writers": lambda n, method, path: 403 if method in ("PUT", "POST") else None,
        "412 to writers": lambda n, method, path: 412 if method == "PUT" else None,
        "answers lost after success": lambda n, method, path: "silence" if method == "PUT" and some(0.5)() else None,
        "short bodies": lambda n, method, path: "short" if method == "GET" and some(0.5)() else None,
        "flipped bodies": lambda n, method, path: "flip" if method == "GET" and "/v1/" in path else None,
        "listings and looks that lag": lambda n, method, path: "absent" if method in ("GET", "HEAD") else None,
        "conditions ignored": lambda n, method, path: "unconditional",
    }
    for index, (name, fault) in enumerate(days.items()):
        for is_filled in (False, True):
            place = f"s3://{bucket}/day-{index}-{int(is_filled)}"
            if is_filled:
                right.machine().run("--store-remote", place, env=server.environment())
            proxy = Proxy(server.url, fault)
            machine = right.machine()
            begun = time.monotonic()
            summary, said = machine.run("--store-remote", place, env=server.environment(proxy.url))
            seconds = time.monotonic() - begun
            right.check(machine, summary, f"{server.name}: {name}")
            notes = [line for line in said.splitlines() if "remote store" in line]
            if len(set(notes)) != len(notes) or len(notes) > 4:
                trial.fail(f"{server.name}: {name}: it is told more than once:\n{said}")
            after = right.machine()
            summary_after, said_after = after.run("--store-remote", place, env=server.environment())
            right.check(after, summary_after, f"{server.name}: after {name}")
            healed = right.machine()
            last, said_last = healed.run("--store-remote", place, env=server.environment())
            if trial.executed(last) != 0:
                trial.fail(f"{server.name}: after {name}: not healed:\n{said}\n{said_after}\n{said_last}")
            state = "a full store" if is_filled else "an empty store"
            print(
                f"passed: {server.name}: {name}, {state} ({proxy.hits} of {proxy.count} requests, {trial.executed(summary)} jobs ran, "
                f"then {trial.executed(summary_after)}; {len(notes)} warnings, {seconds:.1f} s)", flush=True,
            )
            proxy.server.shutdown()


def has_buckets(program):
    said = subprocess.run([program, "store", "check", "s3://b/p", "--read-only"], capture_output=True, text=True,
                          env={**os.environ, "AWS_ENDPOINT_URL": "http://127.0.0.1:9", "AWS_REGION": "us-east-1"}, timeout=120).stderr
    return "built without" not in said


def ask(server, path, method="PUT", **further):
    """A request of an owner, as far as moto looks."""
    headers = {"Authorization": "AWS4-HMAC-SHA256 Credential=trial/20260101/us-east-1/s3/aws4_request", **further}
    request = urllib.request.Request(f"{server.url}/{path}", None, headers, method=method)
    with urllib.request.urlopen(request, timeout=20) as response:
        return response.read().decode()


def open_to_readers(server, name):
    """Anyone may read what is in the bucket now."""
    public = {"x-amz-acl": "public-read"}
    ask(server, f"{name}?acl", **public)
    for key in re.findall("<Key>(.*?)</Key>", ask(server, f"{name}?list-type=2", "GET")):
        ask(server, f"{name}/{key}?acl", **public)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("--moto", default=shutil.which("moto_server"), help="an S3 server with honest conditions")
    parser.add_argument("--s3s-fs", default=shutil.which("s3s-fs"), help="one whose conditions are checked, then forgotten")
    parser.add_argument("--scale", type=int, default=1000, help="jobs of a sweep whose look-up is timed (default 1000)")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        right = Right(given.program, scratch)
        folders(right, scratch)
        scale(right, scratch, given.scale)
        if not has_buckets(given.program):
            print("skipped: S3 servers, since the program was built without the feature `s3`")
            return
        servers = []
        try:
            if given.moto:
                moto = Server("moto", lambda port: [given.moto, "-p", str(port)], scratch)
                servers.append(moto)
                ask(moto, "trial")
                with_store(right, "moto", "s3://trial/store", moto.environment())
                right.run("moto: without credentials it refuses", "--store-remote", "s3://trial/store", env=anonymous(moto.environment()), executed=JOBS,
                          says=["refused to be read"])
                open_to_readers(moto, "trial")
                right.run("moto: without credentials it is read", "--store-remote", "s3://trial/store", env=anonymous(moto.environment()), executed=0)
                faults(right, moto, "trial")
            else:
                print("skipped: moto_server is not here")
            if given.s3s_fs:
                root = scratch / "s3s"
                (root / "trial").mkdir(parents=True)
                weak = Server("s3s-fs", lambda port: [
                    given.s3s_fs, "--host", "127.0.0.1", "--port", str(port), "--access-key", "trial", "--secret-key", "trial-secret", str(root),
                ], scratch)
                servers.append(weak)
                with_store(right, "s3s-fs", "s3://trial/store", weak.environment())
            else:
                print("skipped: s3s-fs is not here")
        finally:
            for server in servers:
                server.end()


if __name__ == "__main__":
    main()
