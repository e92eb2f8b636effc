"""The server as a process that runs all day: how it ends, what it keeps, whom it serves first."""

from __future__ import annotations

import asyncio
import gc
from concurrent.futures import Future
from typing import Any

import pytest

from deepbots_cli.lsp.analysing import Analysis, analyse
from deepbots_cli.lsp.checking import Checker
from deepbots_cli.lsp.desk import Desk
from deepbots_cli.lsp.documents import Document, path_of
from deepbots_cli.lsp.server import Server
from tests.lsp.client import Client


@pytest.mark.parametrize(("farewell", "code"), [(["shutdown", "exit"], 0), (["exit"], 1)])
def test_the_exit_code_tells_whether_the_client_has_taken_its_leave(project, farewell, code):
    with Client(project) as own:
        own.findings(own.open(project / "scenarios" / "cartpole.yaml"))
        for word in farewell:
            if word == "shutdown":
                own.request(word, None)
            else:
                own.notify(word, None)
        assert own.process.wait(20) == code
    assert own.errors == ""


def test_nothing_is_kept_of_changes_that_came_and_went():
    uri = "untitled:a"
    written = {"version": 1, "languageId": "yaml", "text": "deepbots: 1\n"}

    def messages() -> Any:
        yield {"id": 0, "method": "initialize", "params": {"processId": None, "rootUri": None, "capabilities": {}}}
        yield {"method": "textDocument/didOpen", "params": {"textDocument": {"uri": uri, **written}}}
        for number in range(60):
            document = {"uri": uri, "version": number + 2}
            yield {
                "method": "textDocument/didChange",
                "params": {"textDocument": document, "contentChanges": [{"text": f"deepbots: {number}"}]},
            }

    async def serve() -> list[int]:
        server, counts = Server(), []
        server.protocol.set_writer(Sink())
        for message in messages():
            server.protocol.handle_message(server.protocol.structure_message({"jsonrpc": "2.0", **message}))
            counts.append(sum(isinstance(known, Future) for known in gc.get_objects()))
        server.checker.stop()
        return counts

    counts = asyncio.run(serve())
    assert max(counts[2:]) <= counts[2] + 1  # an analysis may be under way


class Sink:
    """Takes what a server says."""

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


def test_what_is_written_in_is_looked_at_before_what_waits_already():
    desk, looked = Desk(), []
    documents = [Document(f"untitled:{name}", 1, "deepbots: 1\n", path_of(f"untitled:{name}")) for name in "abc"]

    def noted(document: Document, drafts: Any) -> Analysis:
        looked.append(document.uri)
        return analyse(document, drafts)

    async def work() -> None:
        done = asyncio.Event()
        checker = Checker(desk, noted, lambda uri, *_: done.set() if uri == documents[1].uri else None, lambda _: None)
        for document in documents:
            desk.put(document)
        checker.want(*desk.documents)
        checker.want(documents[2].uri)
        await asyncio.wait_for(done.wait(), 30)
        checker.stop()

    asyncio.run(work())
    assert looked == ["untitled:c", "untitled:a", "untitled:b"]
