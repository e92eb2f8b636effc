"""The server as a process that runs all day: its end, its memory, and the order of its answers."""

from __future__ import annotations

import asyncio
import gc
import json
import random
import shutil
from concurrent.futures import Future
from typing import Any

import pytest

from deepbots_cli.lsp.server import Checker, Server
from deepbots_cli.lsp.workspace import Document, DocumentAnalysis, Workspace, analyze, path_of
from tests.fuzz.mutations import SEEDS
from tests.lsp.client import Client

TOGETHER = ("arena.yaml", "maze.yaml", "rover_part.yaml", "wireless.yaml", "balance.yaml")
"""Scenarios of which two include the same piece, and one extends another."""


@pytest.fixture(autouse=True)
def _frozen() -> None:
    """As the command does: the server collects garbage between analyses, and a look at all that other tests
    have imported takes 0.5 s."""
    gc.freeze()


def test_the_exit_code_says_whether_the_client_asked_for_a_shutdown(project):
    """It is 0 after `shutdown` and `exit`, as the fixture `client` sees of each server."""
    with Client(project) as own:
        own.findings(own.open(project / "scenarios" / "cartpole.yaml"))
        own.notify("exit", None)
        assert own.process.wait(20) == 1
    assert own.errors == ""


class Process:
    """A server without a process around it, and what it publishes: versions and findings by address."""

    def __init__(self) -> None:
        self.server = Server()
        self.server.protocol.set_writer(self)
        self.shown: dict[str, tuple[int | None, set[str]]] = {}
        self.tell("initialize", id=0, processId=None, rootUri=None, capabilities={})

    def tell(self, method: str, id: int | None = None, **params: Any) -> None:
        message = {"jsonrpc": "2.0", "method": method, "params": params} | ({} if id is None else {"id": id})
        self.server.protocol.handle_message(self.server.protocol.structure_message(message))

    def open(self, uri: str, text: str) -> None:
        self.tell(
            "textDocument/didOpen",
            textDocument={"uri": uri, "languageId": "yaml", "version": 1, "text": text},
        )

    def change(self, uri: str, version: int, text: str) -> None:
        self.tell(
            "textDocument/didChange",
            textDocument={"uri": uri, "version": version},
            contentChanges=[{"text": text}],
        )

    async def rest(self) -> None:
        """Until everything has been looked at."""
        while others := asyncio.all_tasks() - {asyncio.current_task()}:
            await asyncio.wait(others)

    def write(self, data: bytes) -> None:
        message = json.loads(data.partition(b"\r\n\r\n")[2])
        if message.get("method") == "textDocument/publishDiagnostics":
            published = message["params"]
            self.shown[published["uri"]] = (
                published.get("version"),
                {json.dumps(diagnostic, sort_keys=True) for diagnostic in published["diagnostics"]},
            )

    def close(self) -> None: ...


def test_changes_leave_no_futures_behind():
    def count_of_futures() -> int:
        return sum(isinstance(entry, Future) for entry in gc.get_objects())

    async def counts() -> tuple[int, int]:
        process = Process()
        process.open("untitled:a", "deepbots: 1\n")
        before = count_of_futures()
        for number in range(60):
            process.change("untitled:a", number + 2, f"deepbots: {number}\n")
        after = count_of_futures()
        await process.rest()
        return before, after

    before, after = asyncio.run(counts())
    assert after <= before + 1  # an analysis may be under way


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_after_changes_in_any_order_each_file_shows_what_a_first_look_at_it_would(tmp_path, seed):
    folder = tmp_path / "project"
    shutil.copytree(SEEDS, folder)
    (folder / "deepbots.toml").touch()
    drawn = random.Random(seed)
    texts = {}
    versions = {}

    async def work() -> Process:
        process = Process()
        for _ in range(8):
            path = folder / drawn.choice(TOGETHER)
            uri = path.as_uri()
            text = damaged(path.read_text(encoding="utf-8"), drawn)
            if uri not in texts:
                texts[uri] = text
                versions[uri] = 1
                process.open(uri, text)
            elif drawn.random() < 0.8:
                texts[uri] = text
                versions[uri] = versions[uri] + 1
                process.change(uri, versions[uri], text)
            else:
                del texts[uri]
                process.tell("textDocument/didClose", textDocument={"uri": uri})
            await asyncio.sleep(drawn.choice((0, 0, 0.1)))
        await process.rest()
        return process

    async def look() -> Process:
        process = Process()
        for uri, text in texts.items():
            process.open(uri, text)
        await process.rest()
        return process

    after, first = asyncio.run(work()).shown, asyncio.run(look()).shown
    for uri in {*after, *first}:
        assert after.get(uri, (None, set()))[1] == first.get(uri, (None, set()))[1], uri
        assert uri not in texts or after[uri][0] == versions[uri]


def damaged(text: str, drawn: random.Random) -> str:
    place = drawn.randrange(len(text))
    signs = drawn.choice(("", "x", "{", "\n", "# 😀\n", "[", ":"))
    return text if drawn.random() < 0.3 else text[:place] + signs + text[place + drawn.randrange(2) :]


def test_what_is_written_in_is_looked_at_before_what_waits_already():
    workspace = Workspace()
    looked = []
    documents = [
        Document(f"untitled:{name}", 1, "deepbots: 1\n", path_of(f"untitled:{name}")) for name in "abc"
    ]

    def noted(document: Document, drafts: Any) -> DocumentAnalysis:
        looked.append(document.uri)
        return analyze(document, drafts)

    async def work() -> None:
        done = asyncio.Event()
        checker = Checker(
            workspace, noted, lambda uri, *_: done.set() if uri == documents[1].uri else None, lambda _: None
        )
        for document in documents:
            workspace.put(document)
        checker.schedule(*workspace.documents)
        checker.schedule(documents[2].uri)
        await asyncio.wait_for(done.wait(), 30)
        checker.stop()

    asyncio.run(work())
    assert looked == ["untitled:c", "untitled:a", "untitled:b"]
