"""Who may use a studio: what other pages, other users of the machine and files from elsewhere try.

The open files of the studio: text from the editor, from the studio and from other programs is merged,
saved and kept.

Test the axes of the learning curves on the page.
"""

from __future__ import annotations

import ast
import asyncio
import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("nicegui")

import uvicorn
from hypothesis import given
from hypothesis import strategies as st
from nicegui import Client, ui
from nicegui.page import page

from deepbots_cli import studio
from deepbots_cli.cli import main
from deepbots_cli.cli.terminal import ProgressBar
from deepbots_cli.document import Permissions
from deepbots_cli.document.files import MAX_BYTES
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.campaigns.listing import ListedRun
from deepbots_cli.learning.report import Activity, ProgressReporter, TrainingProgress
from deepbots_cli.learning.runs.episodes import Episode
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.studio.commands import (
    EXIT_NAME,
    LOG_NAME,
    TASK_NAME,
    VERDICT_NAME,
    Commands,
    Task,
    TaskRecord,
    Tasks,
    result_of,
)
from deepbots_cli.studio.files import OpenFile, TextEdit, difference, edited
from deepbots_cli.studio.layout import Notices
from deepbots_cli.studio.server import Guarded
from deepbots_cli.studio.session import Session
from deepbots_cli.studio.trainings import WatchedTraining, comparison_chart, result_text, training_chart
from deepbots_cli.view.server import LOOPBACK, Gate, listening_socket
from deepbots_cli.view.training_logs import TrainingLog
from tests.files import written

TOKEN = "a-token-of-22-letters-"
SCENARIO = "deepbots: 1\nname: Mine\n"


async def _inner(scope, receive, send) -> None:
    """An application that answers everything; `/output` has a policy of its own."""
    if scope["type"] == "lifespan":
        while True:
            message = await receive()
            await send({"type": f"{message['type']}.complete"})
            if message["type"] == "lifespan.shutdown":
                return
    elif scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        await send({"type": "websocket.close", "code": 1000})
    else:
        own = [(b"content-security-policy", b"sandbox")] if scope["path"] == "/output" else []
        await send({"type": "http.response.start", "status": 200, "headers": own})
        await send({"type": "http.response.body", "body": b"secret"})


@contextmanager
def _serving(robot_address: str = "") -> Iterator[int]:
    """A server in a thread; yields its port."""
    listener = listening_socket(LOOPBACK, 0)
    port = listener.getsockname()[1]
    application = Guarded(_inner, Gate(LOOPBACK, port, TOKEN), lambda: robot_address)
    server = uvicorn.Server(uvicorn.Config(application, log_level="critical", lifespan="on"))
    thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
    thread.start()
    try:
        yield port
    finally:
        server.should_exit = True
        thread.join(10)


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with _serving() as number:
        yield number


def _ask(port: int, line: str = "GET / HTTP/1.1", **headers: str | None) -> tuple[int, dict[str, str], str]:
    """Send a request as it is written. Returns status, headers and body; a status of 0 is a closed line."""
    values = {"Host": f"127.0.0.1:{port}", "Connection": "close"}
    values |= {name.replace("_", "-"): value for name, value in headers.items()}
    lines = [line, *(f"{name}: {value}" for name, value in values.items() if value is not None), "", ""]
    with closing(socket.create_connection(("127.0.0.1", port), 10)) as wire:
        wire.sendall("\r\n".join(lines).replace("PORT", str(port)).encode("latin-1"))
        content = b""
        while part := wire.recv(1 << 16):
            content += part
            if b"HTTP/1.1 101" in content:
                break
    head, _, body = content.decode("latin-1").partition("\r\n\r\n")
    if not head:
        return 0, {}, ""
    status, *fields = head.split("\r\n")
    pairs = (field.partition(": ") for field in fields)
    answer = {name.lower(): value for name, _, value in pairs}
    if answer.get("transfer-encoding") == "chunked":
        body = "".join(body.split("\r\n")[1::2])
    return int(status.split()[1]), answer, body


OPENS_SOCKET = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec_WebSocket_Version": "13",
    "Sec_WebSocket_Key": "AAAAAAAAAAAAAAAAAAAAAA==",
}
COOKIE = {"Cookie": f"deepbots-PORT={TOKEN}"}
OWN = {"Origin": "http://127.0.0.1:PORT"}


def _paths() -> Iterator[tuple[str, dict[str, str | None]]]:
    for path in (
        "/",
        "//",
        "/.",
        "/x/../",
        "/%2e%2e/",
        "/%2f",
        "/?",
        "/?token",
        "/?token=",
        "/?token=wrong",
        f"/?TOKEN={TOKEN}",
        f"/?key={TOKEN}",
        f"/?token={TOKEN}x",
        f"/?token={TOKEN[:-1]}",
        f"/?token[]={TOKEN}",
        f"/{TOKEN}",
        f"/?x=1;token={TOKEN}",
        "/robot",
        "/robot/",
        "//robot/",
        "/robot//",
        "/robot/drive",
        "/robot/../studio/output/0001",
        "/studio/output/0001",
        "/studio/output/../../../etc/passwd",
        "/studio/output/%2e%2e%2f%2e%2e%2fetc%2fpasswd",
        "/_nicegui_ws/socket.io/?EIO=4&transport=polling",
        "/_nicegui/3.0.0/static/nicegui.js",
        "/_nicegui/client/x/upload/1",
        "/favicon.ico",
        "http://127.0.0.1:PORT/",
    ):
        yield f"GET {path} HTTP/1.1", {}
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "HEAD", "PATCH", "TRACE", "get"):
        yield f"{method} /studio/complete HTTP/1.1", {}


def _headers() -> Iterator[tuple[str, dict[str, str | None]]]:
    for headers in (
        {"Cookie": "deepbots-PORT=wrong"},
        {"Cookie": "deepbots-PORT="},
        {"Cookie": f"deepbots-1={TOKEN}"},
        {"Cookie": f"deepbots={TOKEN}"},
        {"Cookie": f"x=deepbots-PORT={TOKEN}"},
        {"Cookie": f'deepbots-PORT="{TOKEN}"'},
        {"Cookie": f"deepbots-PORT={TOKEN}, x=1"},
        {"Cookie": "é=\xff"},
        {"Authorization": f"Bearer {TOKEN}"},
        {"X_Token": TOKEN},
    ):
        yield "GET / HTTP/1.1", headers
    # With the cookie, by another name or from another page.
    for headers in (
        {"Host": "evil.example"},
        {"Host": "evil.example:PORT"},
        {"Host": "127.0.0.1"},
        {"Host": "127.0.0.1:1"},
        {"Host": "127.0.0.1:PORT.evil.example"},
        {"Host": "127.0.0.1:PORT@evil.example"},
        {"Host": "0.0.0.0:PORT"},
        {"Host": "2130706433:PORT"},
        {"Host": ""},
        {"Host": "evil.example", "X_Forwarded_Host": "127.0.0.1:PORT"},
        {"Origin": "null"},
        {"Origin": "http://evil.example"},
        {"Origin": "https://127.0.0.1:PORT"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "http://localhost:PORT"},
        {"Origin": "http://127.0.0.1:PORT.evil.example"},
        {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "no-cors"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "cors"},
    ):
        yield "GET / HTTP/1.1", COOKIE | headers
    # Web sockets.
    for path in (
        "/",
        "/robot",
        "/robot/",
        "/robot/drive",
        "/_nicegui_ws/socket.io/?EIO=4&transport=websocket",
    ):
        for headers in ({}, OWN, COOKIE, COOKIE | {"Origin": "http://evil.example"}):
            yield f"GET {path} HTTP/1.1", OPENS_SOCKET | headers
    yield f"GET /?token={TOKEN} HTTP/1.1", OPENS_SOCKET | OWN


REFUSED = [*_paths(), *_headers()]


def test_nothing_passes_without_the_token(port):
    assert len(REFUSED) >= 40
    for line, headers in REFUSED:
        status, answer, body = _ask(port, line, **headers)
        assert status in (0, 400, 403, 405), (line, headers, status)
        assert "secret" not in body, (line, headers)
        assert "set-cookie" not in answer, (line, headers)
        if status == 403 and "Upgrade" not in headers:
            assert "frame-ancestors 'none'" in answer["content-security-policy"]


def test_the_token_opens_the_page_and_leaves_its_address(port):
    status, answer, body = _ask(port, f"GET /?token={TOKEN}&x=1 HTTP/1.1")
    assert (status, answer["location"], body) == (302, "/", "")
    assert answer["set-cookie"] == f"deepbots-{port}={TOKEN}; Path=/; HttpOnly; SameSite=Strict"
    status, answer, body = _ask(port, **COOKIE, Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="navigate")
    assert (status, body, answer["x-content-type-options"], answer["referrer-policy"]) == (
        200,
        "secret",
        "nosniff",
        "no-referrer",
    )
    assert "frame-ancestors 'none'" in answer["content-security-policy"]
    assert _ask(port, **OPENS_SOCKET, **COOKIE, **OWN)[0] == 101


@pytest.mark.parametrize(
    "path", ["//evil.example/", "/\\evil.example", "/%2fevil.example", "/%0d%0aX-Y:%20z"]
)
def test_the_token_leads_to_no_other_place(port, path):
    status, answer, _ = _ask(port, f"GET {path}?token={TOKEN} HTTP/1.1")
    assert status in (302, 400)
    assert not re.match(r"[/\\]{2}|\w+:", answer.get("location", "/"))
    assert "x-y" not in answer


def test_a_file_keeps_its_stricter_policy(port):
    assert _ask(port, "GET /output HTTP/1.1", **COOKIE)[1]["content-security-policy"] == "sandbox"


def test_only_the_page_and_the_two_sockets_of_the_robot_are_passed_on():
    # A robot that takes every connection, and notes what it is asked.
    asked: list[bytes] = []
    with closing(socket.create_server(("127.0.0.1", 0))) as robot:

        def take() -> None:
            while True:
                try:
                    wire, _ = robot.accept()
                except OSError:
                    return
                asked.append(wire.recv(1 << 16))
                wire.close()

        threading.Thread(target=take, daemon=True).start()
        with _serving(f"http://127.0.0.1:{robot.getsockname()[1]}/?token=of-the-robot") as port:
            for path in ("/robot", "/robot/drive"):
                _ask(port, f"GET {path} HTTP/1.1", **OPENS_SOCKET, **COOKIE, **OWN)
            allowed = list(asked)
            asked[:] = []
            for path in ("/robot/x%0d%0aX-Y:%20z", "/robot/../", "/robot//", "/robot/drive/..", "/robot/%2e"):
                _ask(port, f"GET {path} HTTP/1.1", **OPENS_SOCKET, **COOKIE, **OWN)
                assert _ask(port, f"GET {path} HTTP/1.1", **COOKIE)[0] == 404
    assert [content.split()[1] for content in allowed] == [b"/", b"/drive"]
    assert not asked


# Files


async def test_no_file_outside_of_the_folder_is_opened(tmp_path):
    folder = tmp_path / "mine"
    (folder / "within").mkdir(parents=True)
    for path in (
        tmp_path / "other.yaml",
        folder / "a.yaml",
        folder / "within" / "b.yaml",
        folder / "key.txt",
    ):
        path.write_text(SCENARIO, encoding="utf-8")
    (tmp_path / "mine-too").mkdir()
    (tmp_path / "mine-too" / "c.yaml").write_text(SCENARIO, encoding="utf-8")
    (folder / "link.yaml").symlink_to(tmp_path / "other.yaml")
    (folder / "out").symlink_to(tmp_path)
    (folder / "loop.yaml").symlink_to(folder / "loop.yaml")
    (folder / "text.yaml").symlink_to("/etc/passwd")
    os.mkfifo(folder / "pipe.yaml")

    session = Session(folder)
    for name in (
        tmp_path / "other.yaml",
        "../other.yaml",
        "within/../../other.yaml",
        "../mine-too/c.yaml",
        "link.yaml",
        "out/other.yaml",
        "loop.yaml",
        "text.yaml",
        "pipe.yaml",
        "key.txt",
        "/etc/passwd",
        "/dev/zero",
        "none.yaml",
        "within",
        "a.yaml\0",
    ):
        with pytest.raises(UsageError):
            session.open(Path(name))
    assert {path.name for path in session.scenarios()} >= {"a.yaml", "b.yaml"}
    assert not {path.name for path in session.scenarios()} & {"link.yaml", "other.yaml", "text.yaml"}
    assert session.open(Path("within/b.yaml")).path == folder / "within" / "b.yaml"
    await session.close()


async def test_what_a_scenario_may_not_read_is_not_opened(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "pyproject.toml").touch()
    (tmp_path / "other.yaml").write_text(SCENARIO, encoding="utf-8")
    (folder / "a.yaml").write_text("deepbots: 1\nextends: ../other.yaml\n", encoding="utf-8")

    session = Session(folder)
    file = session.open(Path("a.yaml"))
    await _until(lambda: session.language.checked_revision(file.path) == file.revision)
    assert session.language.has_errors(file.path)
    with pytest.raises(UsageError, match="opens no other files"):
        session.open(Path("../other.yaml"))
    await session.close()


async def _until(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        await asyncio.sleep(0.02)


# Commands


@pytest.mark.parametrize("code", [False, True])
async def test_functions_of_packages_are_called_only_if_the_server_was_started_so(tmp_path, code):
    (tmp_path / "a.yaml").write_text(SCENARIO, encoding="utf-8")
    allowed = tmp_path / "other"

    session = Session(tmp_path, Permissions((allowed,), code=code))
    task = session.commands.run(["try", "none.yaml"])
    assert ("--allow-code" in task.record.words) == code
    assert f"--allow-path={allowed}" in task.record.words
    await _until(lambda: not task.is_running)
    await session.close()


@pytest.mark.parametrize(
    "verb",
    [
        *("train", "resume", "try", "test", "eval", "report", "render", "diagnose", "compare", "new"),
        *("lint", "diff", "runs", "explain"),
    ],
)
def test_a_command_gets_the_permissions_of_the_server_that_it_has_options_for(
    tmp_path, verb: str, capsys: pytest.CaptureFixture[str]
):
    assert main([verb, "--help"]) == 0
    options = set(re.findall(r"--allow-(?:path|code)", capsys.readouterr().out))
    commands = Session(tmp_path, Permissions((tmp_path / "other",), code=True)).commands
    assert {option.partition("=")[0] for option in commands.permission_options(verb)} == options


async def test_commands_that_start_at_once_write_into_different_places(tmp_path):
    session = Session(tmp_path)
    first, second = (session.commands.train("none.yaml") for _ in range(2))
    assert first.record.run != second.record.run
    videos = [
        session.commands.run_with_output(["render", "none"], Path("runs", "a-1"), "video.mp4")
        for _ in range(2)
    ]
    assert videos[0].record.output != videos[1].record.output
    for task in (first, second, *videos):  # each would import deepbots, to find no scenario
        task.stop()
    await _until(lambda: not any(task.is_running for task in (first, second, *videos)))
    await session.close()


async def test_the_name_of_a_file_is_no_option(tmp_path):
    (tmp_path / "--allow-code.yaml").write_text(SCENARIO, encoding="utf-8")
    (tmp_path / "runs" / "a_b-1").mkdir(parents=True)

    session = Session(tmp_path)
    session.current = session.open(Path("--allow-code.yaml")).path
    assert session.saved_name() == "./--allow-code.yaml"
    await session.close()


def test_stop_ends_no_process_of_a_record_from_elsewhere(tmp_path):
    sleeping = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        path = tmp_path / "0001"
        path.mkdir()
        record = TaskRecord(words=("train",), folder="/", started=1e12, pid=sleeping.pid)
        (path / TASK_NAME).write_text(record.model_dump_json())
        (task,) = Tasks(tmp_path).all
        assert not task.is_running
        task.stop()
        time.sleep(0.1)
        assert sleeping.poll() is None
        (path / "task.json").write_text(json.dumps(record.model_dump() | {"pid": -1}), encoding="utf-8")
        assert not Tasks(tmp_path).all
        Task(path, record).stop()
        assert sleeping.poll() is None
    finally:
        sleeping.send_signal(signal.SIGKILL)
        sleeping.wait()


def test_a_task_says_what_its_training_does_beside_learning(tmp_path):
    task = Task(tmp_path, TaskRecord(words=("train",), folder="/"))
    assert task.activity == ""
    with (tmp_path / LOG_NAME).open("w", encoding="utf-8") as log:
        reporter, progress = ProgressReporter(log), TrainingProgress(8_000, 10_000, 40, 12.5, None)
        reporter.start(progress)
        confirms = Activity(
            "confirming on 200 new starts", "40 played, at most 8 s to go, needs 90 % of them"
        )
        reporter.update(replace(progress, activity=confirms))
        log.flush()
        assert task.activity == "confirming on 200 new starts: 40 played, at most 8 s to go"
        reporter.update(replace(progress, steps=9_000))
        log.flush()
        assert task.activity == ""
        ProgressBar(100, "episodes", stream=log).update(20)
        log.flush()
        assert task.activity == "evaluating, 20 of 100 episodes"


def test_the_usual_time_to_go_is_that_of_the_runs_whose_solution_was_confirmed(tmp_path):
    training = WatchedTraining(tmp_path / "now")
    training.listed = ListedRun(training.path, "training", scenario="A", total_timesteps=100_000)
    training._steps = ((0.0, 0), (10.0, 10_000))
    solved = [
        ListedRun(tmp_path / str(steps), "finished", scenario="A", solved=True, solved_after=steps)
        for steps in (None, 40_000)
    ]
    group = replace(solved[0], path=tmp_path / "group", runs=(solved[1],))
    for others in (solved, [solved[0], group]):
        assert training.time_left(others) == "usually solved after 40,000 steps, in 30 s"
    assert training.time_left(solved[:1]) == "up to 2 min if it is not solved earlier"
    for seconds, left in (
        (10.0, "usually solved after 40,000 steps; up to 10 s if it is not solved earlier"),
        (5.0, ""),
    ):
        training._steps = ((0.0, 0), (seconds, 50_000))
        assert training.time_left(solved) == left


# The studio itself


@pytest.mark.slow
def test_a_running_studio_refuses_the_same(tmp_path):
    from tests.studio.served import served

    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")
    with served(tmp_path, "mine.yaml") as studio:
        for line, headers in REFUSED:
            headers = {name: value and value.replace(TOKEN, "wrong") for name, value in headers.items()}
            status, answer, _ = _ask(studio.port, line.replace(TOKEN, "wrong"), **headers)
            assert status in (0, 400, 403, 405), (line, headers, status)
            assert "set-cookie" not in answer
        cookie = {"Cookie": f"deepbots-{studio.port}={studio.token}"}
        status, answer, body = _ask(studio.port, "GET / HTTP/1.1", **cookie)
        assert status == 200
        assert "frame-ancestors 'none'" in answer["content-security-policy"]
        assert studio.token not in body
        for path in (
            "/studio/output/0001",
            "/studio/output/../../mine.yaml",
            "/studio/output/..%2f..%2fmine.yaml",
            "/openapi.json",
            "/docs",
            "/_nicegui/3.18.0/static/../../../../../etc/passwd",
            "/_nicegui/3.18.0/static/%2e%2e/%2e%2e/%2e%2e/main.py",
            "/_nicegui/3.18.0/resources/x/..%2f..%2fetc%2fpasswd",
            "/_nicegui/3.18.0/esm/nicegui-codemirror/..%2f..%2f..%2f..%2fnicegui.py",
        ):
            # Other paths than those of files show the page.
            body = _ask(studio.port, f"GET {path} HTTP/1.1", **cookie)[2]
            assert not any(part in body for part in ("deepbots: 1", "root:", "swagger", "import asyncio")), (
                path
            )


TEXTS = st.text(alphabet="ab \n:#é\U0001f600", max_size=40)


@given(TEXTS, TEXTS)
def test_an_edit_turns_one_text_into_another(before, after):
    assert edited(before, [difference(before, after)]) == after


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("newline", [b"\n", b"\r\n"])
def test_line_ends_and_the_byte_order_mark_are_kept(tmp_path, mark, newline):
    path = written(tmp_path / "mine.yaml", mark + newline.join([b"a: 1", b"b: 2", b""]))
    file = OpenFile.open(path)
    assert file.text == "a: 1\nb: 2\n"
    file.change(file.revision, "a: 1\r\nb: 3\nc: \ud83d\n")  # half of a character
    file.save()
    assert path.read_bytes() == mark + newline.join([b"a: 1", b"b: 3", "c: \ufffd".encode(), b""])
    assert OpenFile.open(path).text == file.text
    assert not OpenFile.open(path).is_modified


@pytest.fixture
def file(tmp_path):
    (tmp_path / "mine.yaml").write_text("a: 1\n", encoding="utf-8")
    return OpenFile.open(tmp_path / "mine.yaml")


def test_a_text_is_taken_only_if_it_is_based_on_the_present_one(file):
    assert file.change(file.revision, "a: 2\n")
    assert not file.change(file.revision - 1, "a: 3\n")
    assert file.change(file.revision - 1, "a: 2\n")
    assert file.text == "a: 2\n"


def test_a_save_does_not_overwrite_what_another_program_wrote(file):
    file.change(file.revision, "a: 2\n")
    file.path.write_text("a: 33\n", encoding="utf-8")  # since the studio last looked
    with pytest.raises(UsageError, match=r"another program has changed mine\.yaml"):
        file.save()
    assert (file.path.read_text("utf-8"), file.text, file.outside) == ("a: 33\n", "a: 2\n", "a: 33\n")
    file.keep_own()
    file.save()
    assert file.path.read_text("utf-8") == "a: 2\n"


def test_a_save_does_not_overwrite_what_another_program_wrote_in_another_encoding(file):
    file.change(file.revision, "a: 2\n")
    file.path.write_bytes(b"b: \xe4  # an hour of work\n")
    file.read_outside()
    with pytest.raises(UsageError, match=r"has changed mine\.yaml: mine\.yaml is not text in UTF-8; move"):
        file.save()
    assert file.path.read_bytes() == b"b: \xe4  # an hour of work\n"
    file.path.rename(file.path.with_suffix(".txt"))
    file.save()
    assert file.path.read_text("utf-8") == "a: 2\n"


def test_a_file_that_returns_to_its_text_is_no_change(file):
    file.change(file.revision, "a: 2\n")
    for number, text in enumerate(("a: 33\n", "a: 1\n")):
        file.path.write_text(text, encoding="utf-8")
        os.utime(file.path, ns=(number, number))
        assert file.read_outside()
    assert file.outside is None
    assert file.text == "a: 2\n"


def test_a_file_that_was_removed_can_be_saved_again(file):
    file.path.unlink()
    assert file.read_outside()
    assert not file.read_outside()
    assert file.is_modified
    file.save()
    assert file.path.read_text("utf-8") == "a: 1\n"
    assert file.is_modified is False
    file.path.unlink()
    file.read_outside()
    file.path.write_text("a: 1\n", encoding="utf-8")
    assert file.read_outside()
    assert not file.is_modified


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"x" * (5 << 20), "mine.yaml has more than 1,048,576 bytes, the limit of a scenario"),
        (bytes(range(256)), "mine.yaml is not text in UTF-8"),
    ],
)
def test_a_file_that_is_no_scenario_is_one_sentence(tmp_path, content, sentence):
    path = written(tmp_path / "mine.yaml", content)
    with pytest.raises(UsageError) as refusal:
        OpenFile.open(path)
    assert str(refusal.value) == sentence


def test_a_text_that_grows_too_large_is_refused(tmp_path):
    file = OpenFile(tmp_path / "mine.yaml", "a: 1\n")
    with pytest.raises(UsageError, match="more than 1,048,576 bytes"):
        file.change(file.revision, "é" * (MAX_BYTES // 2 + 1))
    assert file.text == "a: 1\n"
    (tmp_path / "lines.yaml").write_bytes(b"a: 1\r\n")  # each line end counts as the two bytes of the file
    file = OpenFile.open(tmp_path / "lines.yaml")
    with pytest.raises(UsageError, match="more than 1,048,576 bytes"):
        file.change(file.revision, "#\n" * (MAX_BYTES // 3 + 1))


def test_a_full_disk_is_one_sentence_and_leaves_the_file(file):
    file.change(file.revision, "a: 1\n" * 100)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        with pytest.raises(UsageError, match=r"mine\.yaml cannot be written: file too large"):
            file.save()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert file.path.read_text("utf-8") == "a: 1\n"
    assert file.is_modified is True
    file.save()
    assert file.path.read_text("utf-8") == "a: 1\n" * 100


def test_a_file_of_another_project_is_not_written(tmp_path):
    path = written(tmp_path / "mine.yaml", "a: 1\n")
    file = OpenFile.open(path, read_only=True)
    file.edit([TextEdit(3, 4, "2")])
    with pytest.raises(UsageError, match="belongs to deepbots or another project"):
        file.save()
    assert path.read_text("utf-8") == "a: 1\n"


@pytest.mark.parametrize(("stopped", "reason"), [(True, ", so it stopped"), (False, "")])
def test_a_run_stopped_as_solved_only_if_its_record_says_so_and_not_each_episode_succeeded(stopped, reason):
    run = ListedRun(
        Path("run"),
        "interrupted",
        steps=600,
        total_timesteps=1_000,
        solved=True,
        solved_after=500,
        mean_return=5.0,
        success_rate=0.996,
        score="evaluation",
        stopped_as_solved=stopped,
    )
    text = f"solved after 500 steps{reason}, mean return 5 and success more than 99% in evaluation"
    assert result_text(run) == text


def _log(*returns: float, **fields: Any) -> TrainingLog:
    """A training with these returns, 100 timesteps apart."""
    steps = 100.0 * np.arange(len(returns))
    return TrainingLog(Path("run"), "", returns=(steps, np.array(returns)), **fields)


def _chart(log: TrainingLog) -> dict[str, Any]:
    return training_chart(log, dark=False)


def test_a_dot_above_the_goal_is_not_cut_off_by_the_range_of_the_points_before():
    dot = np.array([100.0]), np.array([70.0])
    below, above = _log(10, 20, solved_return=50.0), _log(10, 20, solved_return=50.0, evaluations=dot)
    # The page merges the second options into the first ones.
    merged = _chart(below)["yAxis"][0] | _chart(above)["yAxis"][0]
    assert merged.get("max") is None
    assert merged.get("min") is None
    assert merged["boundaryGap"][1] != 0


def test_the_axes_reach_to_the_last_step_and_up_to_the_goal_which_a_comparison_has_once():
    planned, log = _log(10, 20, planned_steps=1000.0), _log(10, 20, solved_return=50.0)
    assert [_chart(each)["xAxis"]["max"] for each in (planned, log)] == [1000.0, 100.0]
    options = _chart(log)
    assert max([value for line in options["series"] for _, value in line["data"]]) == 50.0
    assert [entry["name"] for entry in options["legend"]["data"]] == ["return in training", "solved: 50"]
    options = comparison_chart({"a": log, "b": log}, has_returns=True, dark=True)
    assert [entry["name"] for entry in options["legend"]["data"]] == ["a", "b", "solved: 50"]


def test_returns_of_different_rewards_share_no_axis():
    log = _log(10, 20, solved_return=50.0, successes=(np.array([0.0, 100.0]), np.array([0.0, 1.0])))
    options = comparison_chart({"a": log, "b": log}, has_returns=False, dark=False)
    assert [line["name"] for line in options["series"]] == ["a success", "b success"]
    assert not options["yAxis"][0]["show"]
    # Without successes, there would be an empty chart.
    assert comparison_chart({"a": _log(10, 20)}, has_returns=False, dark=False) is None


MAX_NOTICE_WORDS = 12


def _notices() -> Iterator[tuple[str, str]]:
    """The place and the text of each notice in the code of the studio, with a word for each value in it."""
    for path in sorted(Path(studio.__file__).parent.glob("*.py")):
        for call in ast.walk(ast.parse(path.read_text("utf-8"))):
            name = ast.unparse(call.func).rpartition(".")[2] if isinstance(call, ast.Call) else ""
            # Those of the server are on the terminal.
            if name != "say" and (name != "UsageError" or path.name == "server.py"):
                continue
            match call.args:
                case [ast.Constant(value=text)]:
                    yield f"{path.name}:{call.lineno}", text
                case [ast.JoinedStr(values=parts)]:
                    words = (part.value if isinstance(part, ast.Constant) else "X" for part in parts)
                    yield f"{path.name}:{call.lineno}", "".join(words)


def test_a_notice_with_an_emoji_reaches_the_browser(monkeypatch):
    monkeypatch.setattr(ui, "timer", lambda *_, **__: None)  # needs a running server
    with Client(page("/notices")) as client:
        Notices().show("saved 🤖.yaml", is_warning=False)
    assert "saved 🤖.yaml" in [element.props.get("title") for element in client.elements.values()]


def test_a_notice_has_at_most_twelve_words():
    notices = list(_notices())
    assert len(notices) > 12
    assert [notice for notice in notices if len(notice[1].split()) > MAX_NOTICE_WORDS] == []


@pytest.mark.parametrize(
    ("words", "code", "verdict", "notice"),
    [
        (("eval", "runs/mine-1"), 0, "solved: 200", "Evaluation of mine-1: finished"),
        (("try", "mine.yaml"), 0, "3 episodes, mean return 3", "A few episodes of mine.yaml: finished"),
        (("lint", "mine.yaml"), 1, "2 errors", "Check of mine.yaml: finished"),
        (("eval", "runs/mine-1"), 2, "", "Evaluation of mine-1: failed; the tab Commands shows why"),
        (("diff", "runs/mine-1", "runs/mine-2"), 1, "", "Differences of mine-1: finished"),
        (("compare", "runs/mine-1", "runs/mine-2"), 130, "", "Comparison of mine-1: stopped"),
    ],
)
def test_a_notice_about_a_command_that_ended_is_short_and_its_verdict_is_in_the_result(
    tmp_path, words, code, verdict, notice
):
    task = Task(tmp_path, TaskRecord(words=words, folder="/"))
    (tmp_path / LOG_NAME).touch()
    (tmp_path / VERDICT_NAME).write_text(verdict)
    (tmp_path / EXIT_NAME).write_text(str(code))
    assert Commands(tmp_path, Permissions(), print).end_of(task) == notice
    result = verdict or {1: "", 2: "failed; the last lines say why", 130: "stopped"}[code]
    assert result_of(task).removeprefix("Random actions: ") == result


def test_episodes_that_all_ended_at_one_step_are_drawn_as_dots_beside_the_evaluation():
    returns = np.full(8, 7_504.0), np.full(8, -3.0)
    episodes = [Episode(-2.0, 9, False, None)]
    result = EvaluationResult.of_episodes(
        episodes, outcomes=episodes, model="last", seed=0, success_defined=False, solved=None
    )
    options = _chart(TrainingLog(Path("run"), "", returns=returns, evaluation=result, planned_steps=12_288.0))
    assert options["xAxis"]["max"] == 12_288.0
    assert [line["data"][-1] for line in options["series"]] == [(7_504.0, -3.0), (12_288.0, -2.0)]
    assert all(line["showSymbol"] for line in options["series"])
    assert options["yAxis"][0]["minInterval"] > 0.1
    assert not options["yAxis"][1]["show"]


def test_a_line_keeps_its_color_when_the_ones_before_it_get_points():
    dot = np.array([100.0]), np.array([0.6])
    few, all_ = (
        _log(10, 20, successes=dot),
        _log(10, 20, successes=dot, evaluations=dot, evaluated_successes=dot),
    )
    colors = ({line["name"]: line["itemStyle"] for line in _chart(log)["series"]} for log in (few, all_))
    assert next(colors).items() < next(colors).items()
    listed = ListedRun(
        Path("run"), "interrupted", steps=200, mean_return=20.0, success_rate=1.0, score="training"
    )
    assert result_text(listed, all_).endswith(", mean return 0.6 and success 60% in its last evaluation")


@pytest.mark.parametrize(("lowest", "begins_at_zero"), [(10.0, True), (0.0, True), (-10.0, False)])
def test_the_axis_begins_at_zero_without_negative_values(lowest, begins_at_zero):
    axis = _chart(_log(lowest, 200))["yAxis"][0]
    assert axis["scale"] is not begins_at_zero
    assert (axis["boundaryGap"][0] == 0) is begins_at_zero


def test_a_curve_of_more_points_than_the_page_shows_has_its_breaks():
    returns = np.zeros(1_001)
    returns[601] = np.nan
    (line,) = _chart(_log(*returns))["series"]
    assert [at for at, value in line["data"] if value is None] == [60_100.0]
    assert len(line["data"]) <= 401
