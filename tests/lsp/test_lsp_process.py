"""The server as a process that runs all day: its end, its memory, and the order of its answers.

Whatever a document holds and a client asks: there is an answer, without a word in the log, and nothing
heavy is imported.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import random
import shutil
import socket
import subprocess
import sys
import time
from concurrent.futures import Future
from typing import Any

import pytest

from deepbots_cli.installation import install_hint
from deepbots_cli.lsp.server import Checker, Server
from deepbots_cli.lsp.workspace import (
    Document,
    DocumentAnalysis,
    Workspace,
    analyze,
    path_of,
)
from tests.fuzz.mutations import SEEDS
from tests.lsp.client import ROOT, Client
from tools.benchmarks.lsp_cost import heavy_imports

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


ASKED_OF_A_PLACE = ("completion", "hover", "definition")


HOSTILE = {
    "an alias bomb": "deepbots: 1\na: &a [x, x]\n"
    + "".join(f"a{n}: &a{n} [*a{'' if n == 0 else n - 1}, *a]\n" for n in range(60)),
    "deep nesting": "deepbots: 1\nworld: " + "{a: " * 5000,
    "a long line": "deepbots: 1\nsummary: " + "x" * 900_000,
    "a long expression": "deepbots: 1\nreward: {x: " + "1 + " * 2400 + "1}",
    "lone surrogates": "deepbots: 1\nname: \ud800\nsummary: \udfff",
    "control characters": "deepbots: 1\nname: \0\x1b[31m\x85\u2028\r a: {",
    "paths outside of the project": "deepbots: 1\nextends: /etc/passwd\nrobots: {a: {include:"
    " ../../../../etc/passwd, urdf: /dev/zero}}",
    "nothing": "",
    "a mark of byte order": "\ufeffdeepbots: 1\nworld: {timestop: 1}",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_document_is_answered_for(client, project, name):
    uri = client.open(project / "scenarios" / "hostile.yaml", HOSTILE[name])
    client.findings(uri)
    for line, character in [(0, 0), (1, 9), (2, 30), (10**6, 10**6)]:
        for method in ASKED_OF_A_PLACE:
            client.request(
                f"textDocument/{method}",
                {"textDocument": {"uri": uri}, "position": {"line": line, "character": character}},
            )
    client.request(
        "textDocument/formatting",
        {"textDocument": {"uri": uri}, "options": {"tabSize": 2, "insertSpaces": True}},
    )
    everything = {"start": {"line": 0, "character": 0}, "end": {"line": 10**6, "character": 0}}
    client.request(
        "textDocument/codeAction",
        {"textDocument": {"uri": uri}, "range": everything, "context": {"diagnostics": []}},
    )


def test_a_file_outside_of_the_project_is_reported_and_not_opened(client, project):
    uri = client.open(project / "scenarios" / "curious.yaml", HOSTILE["paths outside of the project"])
    findings = client.findings(uri)
    assert all(
        "lies outside the project" in finding["message"] for finding in findings if finding["code"] == "DB204"
    )
    assert (
        [finding["code"] for finding in findings][:1],
        client.definition(uri, "extends: /etc/pas¦swd"),
    ) == (["DB204"], [])


@pytest.mark.parametrize(
    "uri",
    [
        "file:///%00",
        "file://",
        "http://example.org/a.yaml",
        "file:///" + "a" * 5000,
        "nonsense",
        "file:///proc/self/mem",
    ],
)
def test_a_document_with_an_unusual_address_is_handled_like_any_other(client, uri):
    client.notify(
        "textDocument/didOpen",
        {"textDocument": {"uri": uri, "languageId": "yaml", "version": 1, "text": "deepbots: 1\nworld: {"}},
    )
    client.versions[uri] = 1
    client.findings(uri)
    answer = client.request(
        "textDocument/completion", {"textDocument": {"uri": uri}, "position": {"line": 1, "character": 8}}
    )
    assert "timestep" in {item["label"] for item in answer["items"]}
    client.notify("textDocument/didClose", {"textDocument": {"uri": uri}})


def test_a_document_that_is_not_open_has_no_answers(client, project):
    where = {
        "textDocument": {"uri": (project / "scenarios" / "cartpole.yaml").as_uri()},
        "position": {"line": 3, "character": 3},
    }
    assert [client.request(f"textDocument/{method}", where) for method in ASKED_OF_A_PLACE] == [
        None,
        None,
        None,
    ]


def test_neither_simulator_nor_learner_is_imported(client, pit):
    client.labels(pit, "delta(¦metric)")
    client.hover(pit, "rea¦ch > radius")
    assert heavy_imports(client.process.pid) == 0


def test_the_server_leaves_when_its_input_ends(project):
    client = Client(project)
    with client:
        client.process.stdin.close()
        assert client.process.wait(20) == 0
    assert client.errors == ""


def test_over_a_port_it_serves_this_machine_and_answers_the_same(project):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "deepbots_cli", "lsp", "--tcp", str(port)]
    server = subprocess.Popen(command, cwd=project, env=environment, stderr=subprocess.PIPE)
    body = json.dumps(
        {
            "jsonrpc": "2.0",
            "id": 1,
            "method": "initialize",
            "params": {"processId": None, "rootUri": None, "capabilities": {}},
        }
    )
    with connected(port) as line:
        line.sendall(f"Content-Length: {len(body)}\r\n\r\n{body}".encode())
        assert b"hoverProvider" in line.recv(100_000)
    assert (server.wait(20), server.stderr.read()) == (0, b"")


@pytest.mark.slow
def test_a_port_in_use_and_a_missing_folder_are_errors_of_one_line(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        calls = [["lsp", "--tcp", str(port)], ["lsp", "--allow-path", "missing"]]
        program = (
            "from deepbots_cli.cli import main; import sys; sys.exit([main(words) for words in"
            f" {calls}] != [2, 2])"
        )
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", program]
        ran = subprocess.run(
            command, cwd=tmp_path, env=environment, input="", capture_output=True, text=True, check=False
        )
    assert (ran.returncode, ran.stdout) == (0, "")
    busy, missing = ran.stderr.splitlines()
    assert busy == f"error: cannot listen on port {port}: address already in use"
    assert missing.startswith("error: missing is not a folder; --allow-path needs an existing folder")


def connected(port: int) -> socket.socket:
    """A connection to a server that is about to start."""
    for _ in range(200):
        try:
            return socket.create_connection(("127.0.0.1", port))
        except ConnectionRefusedError:
            time.sleep(0.1)
    raise TimeoutError


def test_without_the_extra_one_line_says_what_to_install():
    program = (
        "import sys; sys.modules['pygls'] = None; from deepbots_cli.cli import main; sys.exit(main(['lsp']))"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert (ran.returncode, ran.stdout) == (2, "")
    assert f"the language server needs the 'editor' extra; {install_hint('editor')}" in ran.stderr
    assert "Traceback" not in ran.stderr
