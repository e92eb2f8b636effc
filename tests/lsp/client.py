"""A client of a language server: starts it as an editor would, and speaks JSON-RPC with it over its standard
streams."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from queue import Queue
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
TABLES = yaml.safe_load(Path(__file__).with_name("tables.yaml").read_text(encoding="utf-8"))
"""Places, and what a server has to say of each."""
PATIENCE = 30.0
"""Seconds that an answer may take on a busy machine."""

Message = dict[str, Any]

OURS = (sys.executable, "-m", "deepbots_cli", "lsp")


class Client:
    """One server and the documents that are open in it; use it as a context, at the end of which the server
    has to leave.

    `settings` are those of the user, by section, for servers that ask for them.
    """

    def __init__(
        self,
        folder: Path,
        *,
        capabilities: Message | None = None,
        command: Sequence[str] = OURS,
        settings: Message | None = None,
    ) -> None:
        self.folder = folder
        self.command = command
        self.capabilities = capabilities or {}
        self.settings = settings or {}
        self.logged: list[str] = []
        self.registered: list[Message] = []
        self.diagnostics: dict[str, Message] = {}
        self.texts: dict[str, str] = {}
        self.versions: dict[str, int] = {}
        self._published: Queue[str] = Queue()
        self._answers: Queue[Message] = Queue()
        self._number = 0

    def __enter__(self) -> Client:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        environment.pop("DEEPBOTS_DEBUG", None)
        self.process = subprocess.Popen(
            self.command,
            cwd=self.folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        threading.Thread(target=self._listen, daemon=True).start()
        self.server = self.request(
            "initialize", {"processId": None, "rootUri": None, "capabilities": self.capabilities}
        )
        self.notify("initialized", {})
        if self.settings:
            self.notify("workspace/didChangeConfiguration", {"settings": self.settings})
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.request("shutdown", None)
            self.notify("exit", None)
        self.process.stdin.close()
        self.code = self.process.wait(PATIENCE)
        self.errors = self.process.stderr.read().decode()

    # Documents

    def open(self, path: Path, text: str | None = None) -> str:
        """Open a file, by default as it is on the disk, and return its address."""
        uri = path.as_uri()
        self.texts[uri] = path.read_text(encoding="utf-8") if text is None else text
        self.versions[uri] = (
            self.versions.get(uri, 0) + 1
        )  # what was published before it was closed is of another version
        document = {"uri": uri, "languageId": "yaml", "version": self.versions[uri], "text": self.texts[uri]}
        self.notify("textDocument/didOpen", {"textDocument": document})
        return uri

    def change(self, uri: str, text: str) -> None:
        self.texts[uri] = text
        self.versions[uri] += 1
        document = {"uri": uri, "version": self.versions[uri]}
        self.notify("textDocument/didChange", {"textDocument": document, "contentChanges": [{"text": text}]})

    def restore(self, path: Path) -> None:
        """Have an open document as it is on the disk, and looked at."""
        uri = path.as_uri()
        text = path.read_text(encoding="utf-8")
        if self.texts[uri] != text:
            self.change(uri, text)
        self.findings(uri)

    def close(self, uri: str) -> None:
        del self.texts[uri]
        self.notify("textDocument/didClose", {"textDocument": {"uri": uri}})

    def findings(self, uri: str, version: int | None = None) -> list[Message]:
        """The published findings of a document in its present version, or in the given one."""
        wanted = self.versions[uri] if version is None else version
        while self.diagnostics.get(uri, {}).get("version") != wanted:
            self._published.get(timeout=PATIENCE)
        return self.diagnostics[uri]["diagnostics"]

    def published(self, uri: str) -> list[Message]:
        """The next published findings of a file, which need not be open."""
        while self._published.get(timeout=PATIENCE) != uri:
            pass
        return self.diagnostics[uri]["diagnostics"]

    # Requests

    def at(self, uri: str, around: str, mark: str = "¦") -> Message:
        """The position of the mark in a piece of the document, in UTF-16."""
        text = self.texts[uri]
        piece = around.replace(mark, "")
        assert text.count(piece) == 1, f"{piece!r} stands there {text.count(piece)} times"
        return position(text, text.index(piece) + around.index(mark))

    def ask(self, method: str, uri: str, around: str, **more: Any) -> Any:
        """The answer to a request about a place."""
        return self.request(
            f"textDocument/{method}", {"textDocument": {"uri": uri}, "position": self.at(uri, around), **more}
        )

    def labels(self, uri: str, around: str) -> list[str]:
        return [item["label"] for item in self.ask("completion", uri, around)["items"]]

    def labels_at(self, uri: str, offset: int) -> list[str]:
        params = {"textDocument": {"uri": uri}, "position": position(self.texts[uri], offset)}
        return [item["label"] for item in self.request("textDocument/completion", params)["items"]]

    def hover(self, uri: str, around: str) -> str:
        answer = self.ask("hover", uri, around)
        return answer["contents"]["value"] if answer else ""

    def definition(self, uri: str, around: str) -> list[tuple[str, int, int]]:
        """The names of the files, with lines and columns."""
        places = self.ask("definition", uri, around) or []
        return [(Path(place["uri"]).name, *place["range"]["start"].values()) for place in places]

    def actions(self, uri: str, start: str, end: str | None = None, **context: Any) -> list[Message]:
        where = {"start": self.at(uri, start), "end": self.at(uri, end or start)}
        params = {"textDocument": {"uri": uri}, "range": where, "context": {"diagnostics": [], **context}}
        return self.request("textDocument/codeAction", params)

    def request(self, method: str, params: Any) -> Any:
        self._number += 1
        self._send({"jsonrpc": "2.0", "id": self._number, "method": method, "params": params})
        answer = self._answers.get(timeout=PATIENCE)
        assert answer["id"] == self._number
        assert "error" not in answer, answer["error"]
        return answer["result"]

    def notify(self, method: str, params: Any) -> None:
        self._send({"jsonrpc": "2.0", "method": method, "params": params})

    def _send(self, message: Message) -> None:
        body = json.dumps(message).encode()
        self.process.stdin.write(b"Content-Length: %d\r\n\r\n%b" % (len(body), body))
        self.process.stdin.flush()

    def _listen(self) -> None:
        stream = self.process.stdout
        while header := stream.readline():
            length = 0
            while header.strip():
                name, _, value = header.partition(b":")
                length = int(value) if name.lower() == b"content-length" else length
                header = stream.readline()
            self._take(json.loads(stream.read(length)))

    def _take(self, message: Message) -> None:
        match message.get("method"):
            case None:
                self._answers.put(message)
            case "textDocument/publishDiagnostics":
                self.diagnostics[message["params"]["uri"]] = message["params"]
                self._published.put(message["params"]["uri"])
            case "workspace/configuration":
                wanted = [self.settings.get(item["section"]) for item in message["params"]["items"]]
                self._send({"jsonrpc": "2.0", "id": message["id"], "result": wanted})
            case "client/registerCapability":
                self.registered += message["params"]["registrations"]
                self._send({"jsonrpc": "2.0", "id": message["id"], "result": None})
            case _ if "id" in message:
                self._send({"jsonrpc": "2.0", "id": message["id"], "result": None})
            case _:
                self.logged.append(message["params"]["message"])


def position(text: str, offset: int) -> Message:
    """Line and column of an offset, both from 0, columns in units of UTF-16."""
    line_start = text.rfind("\n", 0, offset) + 1
    return {
        "line": text.count("\n", 0, offset),
        "character": len(text[line_start:offset].encode("utf-16-le")) // 2,
    }


def offset(text: str, place: Message) -> int:
    """The offset of a position."""
    start = sum(len(line) + 1 for line in text.split("\n")[: place["line"]])
    line = text.split("\n")[place["line"]]
    return start + len(line.encode("utf-16-le")[: 2 * place["character"]].decode("utf-16-le"))


def place_of(file: str, marked: str) -> tuple[str, int, int]:
    """The name of a shipped file, with the line and the column of the mark `¦` in its text."""
    before, after = marked.split("¦")
    text = next(path for top in ("scenarios", "robots") for path in (ROOT / top).rglob(file)).read_text(
        encoding="utf-8"
    )
    assert text.count(before + after) == 1, marked
    lines = text[: text.index(before + after) + len(before)].split("\n")
    return file, len(lines) - 1, len(lines[-1])


def edited(text: str, edits: list[Message]) -> str:
    """The text with edits made."""
    for edit in sorted(edits, key=lambda edit: offset(text, edit["range"]["start"]), reverse=True):
        text = (
            text[: offset(text, edit["range"]["start"])]
            + edit["newText"]
            + text[offset(text, edit["range"]["end"]) :]
        )
    return text
