"""Floods at a server: other connections neither get commands nor take memory; `python -m tests.robot.flood`
measures them."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("zmq")
pytest.importorskip("websockets")

from deepbots_robot import messages, serving, websocket
from deepbots_robot.link import Link
from deepbots_robot.log import LogWriter, read_log
from deepbots_robot.serving import Notes, Transport
from deepbots_robot.topics import Field

ANGLE = Field("cart.angle", "cart", "joint_position", "rad", (1,), ("pole",))
DRIVE = Field("cart.drive", "cart", "velocity", "rad/s", (2,), ("left", "right"))
# Two ports for each worker of pytest-xdist, so that tests side by side do not meet.
PORT = 58_771 + 2 * int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
LINKS = {"zmq": Transport(zmq=f"tcp://127.0.0.1:{PORT}"), "websocket": Transport(websocket=str(PORT + 1))}


def opened(transport: Transport, *, robot: bool) -> Any:
    ends = [(ANGLE, None)], [(DRIVE, None)]
    receives, sends = ends[::-1] if robot else ends
    return transport.open(receives, sends, robot=robot)  # type: ignore[arg-type]


@contextmanager
def connected(transport: Transport) -> Iterator[tuple[Link, Callable[[], Link]]]:
    """A policy, and what opens a robot that is connected to it."""
    with ExitStack() as stack:
        policy = stack.enter_context(closing(opened(transport, robot=False)))

        def robot() -> Link:
            link: Link = stack.enter_context(closing(opened(transport, robot=True)))
            until(link.connected)
            return link

        yield policy, robot


def until(holds: Callable[[], object], seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)


def angles_taken(policy: Link, seconds: float = 0.3) -> list[float]:
    """The angles that arrive in a time."""
    angles = list[float]()
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        policy.wait(0.02)
        angles += [float(arrival.fields["cart.angle"][0]) for arrival in policy.take() if arrival.fields]
    return angles


@pytest.mark.parametrize("kind", LINKS)
def test_a_second_sender_neither_changes_what_the_policy_takes_nor_gets_its_commands(kind: str) -> None:
    """The one that came last got the commands, and its values and its damaged messages were those of the
    robot."""
    with connected(LINKS[kind]) as (policy, robot):
        first = robot()
        first.send({"cart.angle": np.array([0.1])}, 1.0)
        assert angles_taken(policy) == [0.1]
        second = robot()
        for _ in range(20):
            second.send({"cart.angle": np.array([0.9])}, 1.0)
        first.send({"cart.angle": np.array([0.2])}, 1.1)
        assert angles_taken(policy) == [0.2]
        assert [remark.text for remark in policy.remarks()] == [
            "another program sends to this policy, which takes only what the first one sends; start a policy"
            " for each robot"
        ]
        policy.send({"cart.drive": np.array([5.0, 5.0])}, 1.2)
        first.wait(2.0)
        assert [arrival.fields["cart.drive"].tolist() for arrival in first.take() if arrival.fields] == [
            [5.0, 5.0]
        ]
        assert [arrival for arrival in second.take() if arrival.fields] == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", LINKS)
def test_after_a_silence_another_robot_is_taken(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(messages, "HELD", 0.3)
    with connected(LINKS[kind]) as (policy, robot):
        robot().send({"cart.angle": np.array([0.1])}, 1.0)
        assert angles_taken(policy) == [0.1]
        second = robot()
        time.sleep(0.4)
        second.send({"cart.angle": np.array([0.5])}, 1.0)
        assert angles_taken(policy) == [0.5]


def test_messages_that_wait_have_a_limit_in_bytes(tmp_path: Path) -> None:
    """Messages of 16 MB times queues of thousands took 5 GB."""
    picture = Field("cart.camera", "cart", "camera", "1", (1000, 1000, 3))
    for fields, most in (((ANGLE,), 256), ((picture,), 4)):
        link: Any = Transport(zmq=f"ipc://{tmp_path}/{len(fields[0].shape)}").open(
            [(field, None) for field in fields], [], robot=False
        )  # type: ignore[misc]
        with closing(link):
            waiting, longest = link._most_waiting, link._longest
            assert waiting <= most
            assert waiting == 4 or waiting * longest <= messages._WAITING_BYTES
            assert longest <= 20_000 + sum(2 * field.count for field in fields)


@pytest.mark.slow
def test_connections_that_say_nothing_are_few_and_do_not_keep_a_robot_out() -> None:
    with connected(LINKS["websocket"]) as (policy, robot):
        silent = []
        try:
            for _ in range(40):
                silent.append(socket.create_connection(("127.0.0.1", PORT + 1), timeout=5))
            link: Any = policy
            assert len(link._open) <= websocket.MOST_CONNECTIONS
            first = robot()
            first.send({"cart.angle": np.array([0.1])}, 1.0)
            assert angles_taken(policy, 1.0) == [0.1]
            for _ in range(40):  # the one that is answered stays
                silent.append(socket.create_connection(("127.0.0.1", PORT + 1), timeout=5))
            first.send({"cart.angle": np.array([0.2])}, 1.1)
            assert angles_taken(policy, 1.0) == [0.2]
            assert len(link._open) <= websocket.MOST_CONNECTIONS
        finally:
            for each in silent:
                each.close()


def test_a_flood_of_refused_messages_does_not_fill_the_log(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.mcap", {"scenario": "CartPole"})
    lines: list[str] = []
    notes = Notes(writer, lines.append)
    for number in range(5_000):
        notes.event(float(number), "refused", "a message: it cannot be read")
    writer.close()
    assert len(list(read_log(tmp_path / "a.mcap"))) <= 3 * serving._MAX_EVENTS
    assert len(lines) <= 3
