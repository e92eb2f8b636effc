"""A client of the language server protocol, as small as the tests need: it speaks to a server over its standard input and output."""

from __future__ import annotations

import json
import queue
import subprocess
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

ANSWER = 60.0
"""Seconds until a server that says nothing is given up."""

Json = dict[str, Any]


class Place(NamedTuple):
    """A position in a text: both count from 0."""

    line: int
    character: int


class Client:
    """A server that runs, with its settings under `settings`; a context manager, at whose end it is told to leave."""

    def __init__(self, command: Sequence[str], root: Path, settings: Mapping[str, Any]) -> None:
        self._settings = dict(settings)
        self._process = subprocess.Popen(command, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        self._answers: queue.Queue[Json | None] = queue.Queue()
        self._published: dict[str, Json] = {}
        self._count = 0
        threading.Thread(target=self._read, daemon=True).start()
        capabilities = {
            "textDocument": {
                "hover": {"contentFormat": ["markdown"]},
                "completion": {"completionItem": {"snippetSupport": True, "documentationFormat": ["markdown"]}},
                "publishDiagnostics": {"versionSupport": True},
            },
            "workspace": {"configuration": True, "didChangeConfiguration": {"dynamicRegistration": False}},
        }
        self.ask("initialize", {"processId": None, "rootUri": root.as_uri(), "capabilities": capabilities})
        self.tell("initialized", {})
        self.tell("workspace/didChangeConfiguration", {"settings": self._settings})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.ask("shutdown", None)
        self.tell("exit", None)
        self._process.wait(ANSWER)

    def open(self, path: Path, text: str) -> list[Json]:
        """Show the text to the server as that of the file, which need not exist; its diagnostics."""
        uri = path.as_uri()
        self._published.pop(uri, None)
        self.tell("textDocument/didOpen", {"textDocument": {"uri": uri, "languageId": "yaml", "version": 1, "text": text}})
        while uri not in self._published:
            self._next()
        return list(self._published[uri]["diagnostics"])

    def close(self, path: Path) -> None:
        self.tell("textDocument/didClose", {"textDocument": {"uri": path.as_uri()}})

    def hover(self, path: Path, place: Place) -> str:
        found = self.ask("textDocument/hover", _at(path, place))
        return "" if found is None else str(found["contents"]["value"])

    def complete(self, path: Path, place: Place) -> list[Json]:
        found = self.ask("textDocument/completion", _at(path, place))
        return list(found["items"] if isinstance(found, dict) else found or [])

    def ask(self, method: str, params: object) -> Any:
        """The result of a request."""
        self._count += 1
        number = self._count
        self._send({"id": number, "method": method, "params": params})
        while True:
            message = self._next()
            if message.get("id") == number and "method" not in message:
                assert "error" not in message, message["error"]
                return message.get("result")

    def tell(self, method: str, params: object) -> None:
        self._send({"method": method, "params": params})

    def _next(self) -> Json:
        """The next message; what the server asks is answered, and what it publishes is kept."""
        message = self._answers.get(timeout=ANSWER)
        assert message is not None, "the server has ended"
        if message.get("method") == "textDocument/publishDiagnostics":
            self._published[message["params"]["uri"]] = message["params"]
        elif message.get("method") == "workspace/configuration":
            asked = message["params"]["items"]
            self._send({"id": message["id"], "result": [self._settings.get(item.get("section", "")) for item in asked]})
        elif "id" in message and "method" in message:
            self._send({"id": message["id"], "result": None})
        return message

    def _send(self, message: Json) -> None:
        assert self._process.stdin is not None
        body = json.dumps({"jsonrpc": "2.0", **message}).encode()
        self._process.stdin.write(b"Content-Length: %d\r\n\r\n%s" % (len(body), body))
        self._process.stdin.flush()

    def _read(self) -> None:
        """Runs in a thread: every message into the queue, and None at the end."""
        out = self._process.stdout
        assert out is not None
        length = 0
        while line := out.readline():
            if line.lower().startswith(b"content-length:"):
                length = int(line.split(b":")[1])
            elif not line.strip():
                self._answers.put(json.loads(out.read(length)))
        self._answers.put(None)


def _at(path: Path, place: Place) -> Json:
    return {"textDocument": {"uri": path.as_uri()}, "position": place._asdict()}
