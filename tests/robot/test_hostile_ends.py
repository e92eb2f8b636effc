"""Other ends that mean harm or are of something else: they neither end the server, nor take memory, nor keep
a robot out."""

from __future__ import annotations

import base64
import itertools
import json
import os
import re
import resource
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnxruntime")
pytest.importorskip("mcap")
pytest.importorskip("zmq")
pytest.importorskip("websockets")

import zmq

from deepbots_robot import zeromq
from deepbots_robot.link import Arrival
from deepbots_robot.log import LogWriter, read_log
from deepbots_robot.server import Output
from tests.bundle.untrained import write_bundle
from tests.robot.test_flood import LINKS, PORT, opened, until
from tests.robot.test_server import DRIVE, RATE, SAFE, World

ESCAPE = "\x1b]0;owned\x07"
VALUES = {
    "position(cart)": [0, 0, 0],
    "velocity(cart)": [0, 0, 0],
    "cart.pole_angle": [0.01],
    "velocity(cart.tip)": [0, 0, 0],
}


def message(stamp: float, **changes: Any) -> bytes:
    return json.dumps({"robot": "cart", "stamp": stamp, "fields": VALUES, **changes}).encode()


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bundle(tmp_path_factory.mktemp("hostile") / "bundle", "cartpole")


@contextmanager
def serving(
    bundle: Path, folder: Path, *words: object, **settings: Any
) -> Iterator[tuple[Any, subprocess.Popen[str]]]:
    """A socket of ZeroMQ to a server in a process of its own."""
    address = f"ipc://{folder}/link"
    command = [sys.executable, "-m", "deepbots_robot", "serve", bundle, "--zmq", address, *words]
    process = subprocess.Popen(
        list(map(str, command)),
        cwd=Path(__file__).parents[2],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **settings,
    )
    try:
        with closing(zmq.Context.instance().socket(zmq.DEALER)) as end:
            end.setsockopt(zmq.LINGER, 0)
            end.connect(address)
            yield end, process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def output_of(process: subprocess.Popen[str]) -> str:
    """End the server and return all that it printed."""
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=20)
    assert process.returncode == 0, err
    return out + err


def await_answer(end: Any) -> None:
    assert end.poll(20_000), "no answer"
    end.recv()


@pytest.mark.parametrize(
    "changes",
    [
        {"fields": {ESCAPE: [1.0]}},
        {"robot": ESCAPE, "fields": {"x": [1.0]}},
        {"about": {"role": "robot", "scenario": ESCAPE, "digest": "", "pace": ""}},
    ],
)
def test_a_message_writes_no_control_characters_to_the_terminal(
    bundle: Path, tmp_path: Path, changes: dict[str, Any]
) -> None:
    with serving(bundle, tmp_path) as (end, process):
        end.send(message(1.0))
        await_answer(end)
        end.send(message(1.04, **changes))
        time.sleep(0.2)
        text = output_of(process)
    assert "refused" in text
    assert text.replace("\n", "").isprintable()


def test_a_time_of_the_robot_beyond_the_range_of_logs_does_not_end_the_server(
    bundle: Path, tmp_path: Path
) -> None:
    log = tmp_path / "a.mcap"
    with serving(bundle, tmp_path, "--lockstep", "--log", log) as (end, process):
        for stamp in (1.0, 1e300, 1.7e308):
            end.send(message(stamp))
            await_answer(end)
        assert "Traceback" not in output_of(process)
    assert sum(topic == "/step" for topic, _, _ in read_log(log)) >= 3


@pytest.mark.skipif(sys.platform == "win32", reason="a limit of the size of files")
def test_a_full_disk_ends_the_log_and_not_the_policy(bundle: Path, tmp_path: Path) -> None:
    limits = {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))}
    with serving(bundle, tmp_path, "--lockstep", "--log", tmp_path / "a.mcap", **limits) as (end, process):
        for number in range(150):
            end.send(message(number / 30.0))
            await_answer(end)
        text = output_of(process)
    assert text.count("nothing more is written to the log") == 1
    assert "Traceback" not in text


@pytest.mark.parametrize("seconds", ["nan", "inf", "-1", "0"])
def test_a_time_to_serve_that_never_passes_is_refused(bundle: Path, tmp_path: Path, seconds: str) -> None:
    with serving(bundle, tmp_path, f"--seconds={seconds}") as (_, process):
        _, err = process.communicate(timeout=20)
    assert process.returncode == 1
    assert re.fullmatch(r"error: .* is not a time to serve for; .*\n", err)


@pytest.mark.slow
def test_a_robot_that_did_not_fit_does_not_keep_out_the_next_one(bundle: Path, tmp_path: Path) -> None:
    other_scenario = {"role": "robot", "scenario": "Other", "digest": "", "pace": ""}
    with serving(bundle, tmp_path) as (end, process):
        with closing(zmq.Context.instance().socket(zmq.DEALER)) as wrong:
            wrong.connect(f"ipc://{tmp_path}/link")
            wrong.send(message(1.0, about=other_scenario))
            await_answer(wrong)  # the policy says what it is
        time.sleep(1.2)
        end.send(message(2.0))
        await_answer(end)
        assert "does not fit" in output_of(process)


def test_resets_do_not_make_commands_change_faster() -> None:
    rate = 20.0
    world = World(output=Output(DRIVE, np.full(2, -5.0), np.full(2, 5.0), np.full(2, rate), np.array(SAFE)))
    for number in range(100):
        at = 100.0 + 0.002 * number
        world.line.coming.append((at, Arrival("robot", kind="reset", stamp=at, number=number)))
        world.line.put(
            at, -0.4 if number < 50 else 0.4, stamp=at + 1e-6
        )  # a turn, because the first command has no limit of its rate
    commands = world.run(100.2)
    assert len(commands) > 50
    assert commands[-1][1][0] > commands[0][1][0]
    for (earlier, before), (later, after) in itertools.combinations(commands, 2):
        assert abs(after[0] - before[0]) <= rate * (later - earlier) + rate / RATE


def test_a_websocket_message_of_endless_empty_parts_is_ended() -> None:
    with (
        closing(opened(LINKS["websocket"], robot=False)),
        closing(socket.create_connection(("127.0.0.1", PORT + 1), 5)) as raw,
    ):
        key = base64.b64encode(os.urandom(16)).decode()
        raw.sendall(
            "GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key:"
            f" {key}\r\n"
            "Sec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        assert b"101" in raw.recv(4096)
        raw.sendall(b"\x01\x80" + bytes(4) + (b"\x00\x80" + bytes(4)) * 5_000)
        raw.settimeout(10)
        assert raw.recv(100)[:1] == b"\x88"  # the connection is closed


@pytest.mark.skipif(sys.platform != "linux", reason="the memory of the process is known on Linux alone")
def test_a_zeromq_message_without_an_end_takes_no_more_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zeromq, "_MOST_GROWTH", 30_000_000)
    part = b"\x03" + struct.pack(">Q", 15_000) + bytes(15_000)
    with (
        closing(opened(LINKS["zmq"], robot=False)) as policy,
        closing(socket.create_connection(("127.0.0.1", PORT), 5)) as raw,
    ):
        raw.settimeout(5)
        raw.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(16) + b"\x00" + bytes(31))
        raw.sendall(b"\x04\x1c\x05READY\x0bSocket-Type" + struct.pack(">I", 6) + b"DEALER")
        raw.recv(64)
        unsent = b""

        def flooded() -> bool:
            nonlocal unsent
            unsent = unsent or part * 100
            try:
                unsent = unsent[raw.send(unsent) :]
            except TimeoutError:  # of a busy machine
                pass
            except OSError:
                return True
            policy.take()
            return False

        until(flooded, 20.0)
        until(lambda: any("without an end" in remark.text for remark in policy.remarks()))
        with closing(opened(LINKS["zmq"], robot=True)) as robot:
            until(robot.connected)


def test_a_log_takes_any_time(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.mcap", {})
    for stamp in (-1e300, 0.0, 1e300):
        writer.step(stamp, {}, {}, 0.0, "policy")
    writer.close()
    assert [round(stamp) for _, stamp, _ in read_log(tmp_path / "a.mcap")] == [0, 0, 18_000_000_000]
