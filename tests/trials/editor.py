#!/usr/bin/env python3
"""An editor that speaks to the YAML language server accepts our pipelines, marks mistakes, completes and explains.

    npm install --prefix v yaml-language-server
    cargo build && python3 tests/trials/editor.py target/debug/pipeline v/node_modules

Speaks the Language Server Protocol to the server as editors do, with the schema that `pipeline schema` prints. Prints one
line per check; exit 1 at the first that fails. Python 3.11, standard library only.
"""
import json
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]

# A piece of the starter, what it becomes, and what the server must say of it.
MISTAKES = [
    ("count: $n", "cuont: $n", "cuont"),
    ("estimator: exact", "estimator: exakt", "Value "),
    ("save: png", "save: gif", "Value "),
    ("version: 1", "version: 2", "Value must be"),
    ("size: 128 }", "size: [128] }", "Incorrect type"),
    ("run: { range: [1, 8, 1] }", "run: { raneg: [1, 8, 1] }", "Incorrect type"),
    ("params:", "parms:", "parms"),
]


class Server:
    """The language server, and the documents that are open in it."""

    def __init__(self, modules, schema):
        program = pathlib.Path(modules) / "yaml-language-server" / "bin" / "yaml-language-server"
        self.process = subprocess.Popen(
            ["node", program, "--stdio"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self.settings = {"yaml": {"schemas": {schema.as_uri(): "*.yaml"}, "hover": True, "completion": True, "validate": True}}
        self.request_count = 0
        capabilities = {"textDocument": {"publishDiagnostics": {}, "hover": {"contentFormat": ["markdown"]}}}
        self.ask("initialize", {"processId": None, "rootUri": None, "capabilities": capabilities})
        self.tell("initialized", {})
        self.tell("workspace/didChangeConfiguration", {"settings": self.settings})

    def tell(self, method, parameters):
        self.send({"jsonrpc": "2.0", "method": method, "params": parameters})

    def ask(self, method, parameters):
        self.request_count += 1
        number = self.request_count
        self.send({"jsonrpc": "2.0", "id": number, "method": method, "params": parameters})
        return self.wait(lambda message: message.get("id") == number and "method" not in message)["result"]

    def send(self, message):
        body = json.dumps(message).encode()
        self.process.stdin.write(b"Content-Length: %d\r\n\r\n" % len(body) + body)
        self.process.stdin.flush()

    def wait(self, is_wanted):
        """The next message of that kind; what the server asks of us meanwhile is answered."""
        while True:
            message = self.receive()
            if is_wanted(message):
                return message
            if "method" in message and "id" in message:
                self.answer(message)

    def receive(self):
        length = 0
        while (line := self.process.stdout.readline().strip()) != b"":
            name, value = line.split(b":", 1)
            if name.lower() == b"content-length":
                length = int(value)
        if length == 0:
            sys.exit("the language server ended")
        return json.loads(self.process.stdout.read(length))

    def answer(self, message):
        result = None
        if message["method"] == "workspace/configuration":
            result = [self.settings.get(item.get("section")) for item in message["params"]["items"]]
        self.send({"jsonrpc": "2.0", "id": message["id"], "result": result})

    def open(self, uri, text):
        """What the server finds wrong in a document."""
        document = {"uri": uri, "languageId": "yaml", "version": 1, "text": text}
        self.tell("textDocument/didOpen", {"textDocument": document})
        published = self.wait(
            lambda message: message.get("method") == "textDocument/publishDiagnostics" and message["params"]["uri"] == uri
        )
        return [f"line {d['range']['start']['line'] + 1}: {d['message']}" for d in published["params"]["diagnostics"]]

    def at(self, method, uri, text, piece):
        """An answer about the place at the end of a piece of the text."""
        before = text[: text.index(piece) + len(piece)]
        position = {"line": before.count("\n"), "character": len(before) - before.rfind("\n") - 1}
        return self.ask(method, {"textDocument": {"uri": uri}, "position": position})


def expect(what, is_right, found):
    print(f"{what}: {'right' if is_right else f'WRONG: {found}'}", flush=True)
    if not is_right:
        sys.exit(1)


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    pipeline = str(pathlib.Path(sys.argv[1]).resolve())
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        printed = subprocess.run([pipeline, "schema"], check=True, capture_output=True).stdout
        (folder / "schema.json").write_bytes(printed)
        subprocess.run([pipeline, "init", "first"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        starter = (folder / "first.yaml").read_text()
        server = Server(sys.argv[2], folder / "schema.json")

        documents = {path.name: path.read_text() for path in sorted((ROOT / "pipelines").glob("*.yaml"))}
        for name, text in {**documents, "first.yaml": starter}.items():
            found = server.open((folder / name).as_uri(), text)
            expect(f"{name} is accepted", found == [], found)
        for index, (right, wrong, words) in enumerate(MISTAKES):
            expect(f"the starter has `{right}`", right in starter, starter)
            found = server.open((folder / f"wrong{index}.yaml").as_uri(), starter.replace(right, wrong, 1))
            expect(f"`{wrong}` is marked", any(words in message for message in found), found)

        uri = (folder / "first.yaml").as_uri()
        hover = server.at("textDocument/hover", uri, starter, "relight: { env: env, with: samples, siz")
        about = (hover or {}).get("contents", {}).get("value", "")
        expect("a parameter is explained", "pixel" in about.lower(), about)
        hover = server.at("textDocument/hover", uri, starter, "dist: { distri")
        about = (hover or {}).get("contents", {}).get("value", "")
        expect("a kind is explained", "likely" in about.lower() or "distribution" in about.lower(), about)

        unfinished = starter + "  more: { relight: { env: env, e } }\n"
        uri = (folder / "unfinished.yaml").as_uri()
        server.open(uri, unfinished)
        labels = {item["label"] for item in server.at("textDocument/completion", uri, unfinished, "more: { relight: { env: env, e")["items"]}
        expect("parameters are completed", {"estimator", "with", "size"} <= labels, labels)
        server.process.terminate()


if __name__ == "__main__":
    main()
