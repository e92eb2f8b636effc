"""The server of a policy: messages that it accepts, messages that it refuses, and its commands when the robot
is silent.

Floods at a server: other connections neither get commands nor take memory.

Other ends that mean harm or are of something else: they neither end the server, nor take memory, nor keep
a robot out.
"""

from __future__ import annotations

import base64
import itertools
import json
import math
import os
import random
import re
import resource
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("zmq")
pytest.importorskip("websockets")
pytest.importorskip("onnxruntime")

import zmq
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from deepbots_robot import link as links
from deepbots_robot import serving, websocket, zeromq
from deepbots_robot.__main__ import main
from deepbots_robot.link import About, Array, Arrival, Link, Remark
from deepbots_robot.log import LogWriter, read_log
from deepbots_robot.server import Input, Intake, Output, Server, report_lines
from deepbots_robot.serving import Notes, Transport
from deepbots_robot.topics import Field
from tests.bundle.untrained import write_bundle
from tests.commands import until

RATE, AGE = 50.0, 0.06
ANGLE = Field("cart.angle", "cart", "joint_position", "rad", (1,), ("pole",))
GYRO = Field("cart.gyro", "cart", "gyro", "rad/s", (3,), components=("x", "y", "z"))
DRIVE = Field("cart.drive", "cart", "velocity", "rad/s", (2,), ("left", "right"))
INPUTS = (
    Input(ANGLE, "float64", np.array([-1.0]), np.array([1.0]), AGE),
    Input(GYRO, "float32", np.full(3, -np.inf), np.full(3, np.inf), AGE),
)
SAFE = [0.0, 0.0]


class Doubles:
    """A policy: both wheels turn with ten times the angle. It keeps the angles that it was given."""

    def __init__(self) -> None:
        self.seen: list[float] = []
        self.begun = 0

    def step(self, values: Mapping[str, Any]) -> Mapping[str, Array]:
        self.seen.append(float(values["cart.angle"][0]))
        return {"cart.drive": np.full(2, 10.0 * self.seen[-1]), "action": np.zeros(1)}

    def reset(self) -> None:
        self.begun += 1


class Line:
    """A link whose time is that of the test: messages arrive when they are put into it, and waiting lets time
    pass."""

    name = "a line"

    def __init__(self) -> None:
        self.now = 100.0
        self.coming: list[tuple[float, Arrival]] = []
        self.sent: list[tuple[float, list[float]]] = []
        self.waits = 0

    def wait(self, timeout: float) -> None:
        self.waits += 1
        until = min([self.now + max(timeout, 1e-4), *(at for at, _ in self.coming)])
        self.now = max(self.now, until)

    def take(self) -> Sequence[Arrival]:
        here = [arrival for at, arrival in self.coming if at <= self.now]
        self.coming = [(at, arrival) for at, arrival in self.coming if at > self.now]
        return here

    def send(self, values: Mapping[str, Array], stamp: float) -> None:
        self.sent.append((self.now, values["cart.drive"].tolist()))

    def reset(self, number: int, stamp: float) -> None: ...

    def connected(self) -> bool:
        return True

    def remarks(self) -> Sequence[Remark]:
        return []

    def others(self) -> Sequence[About]:
        return []

    def close(self) -> None: ...

    def put(self, at: float, angle: float, stamp: float | None = None) -> None:
        """The two messages of one moment."""
        stamp = at if stamp is None else stamp
        self.coming += [
            (at, Arrival("a", {"cart.angle": np.array([angle])}, stamp)),
            (at, Arrival("g", {"cart.gyro": np.zeros(3)}, stamp)),
        ]


class World:
    """A server on a line, on which messages are put."""

    def __init__(self, *messages: tuple[float, ...], output: Output | None = None, **settings: Any) -> None:
        free = np.full(2, np.inf)
        self.events: list[tuple[str, str]] = []
        self.logged: list[tuple[str, float]] = []
        self.line = Line()
        for message in messages:
            self.line.put(*message)
        self.policy = Doubles()
        output = output or Output(DRIVE, np.full(2, -5.0), np.full(2, 5.0), free, np.array(SAFE))
        self.server = Server(
            self.policy, INPUTS, [output], self.line, RATE, clock=lambda: self.line.now, log=self, **settings
        )

    def step(
        self,
        stamp: float,
        values: object,
        commands: object,
        answer: float,
        posture: str,
        ages: Mapping[str, float] = {},
    ) -> None:
        self.logged.append((posture, answer))

    def event(self, stamp: float, kind: str, text: str) -> None:
        self.events.append((kind, text))

    def run(self, until: float) -> list[tuple[float, list[float]]]:
        """Let time pass; the commands of this time."""
        sent_before = len(self.line.sent)
        while self.line.now < until:
            self.line.wait(min(self.server._patience(), until - self.line.now))
            self.server.turn()
        return self.line.sent[sent_before:]


def test_it_answers_values_at_once_and_at_the_rate_of_the_bundle() -> None:
    world = World()
    for step in range(100):  # twice as often as the policy acts
        world.line.put(100.0 + 0.01 * step, 0.001 * step)
    answers = world.run(101.0)
    assert 49 <= len(answers) <= 51
    assert answers[0] == (100.0, [0.0, 0.0])
    for at, command in answers[1:]:
        assert command == pytest.approx(
            [round((at - 100.0) * 100) * 0.01] * 2, abs=0.0101
        )  # at most one message old


def test_uneven_messages_are_used_once_each() -> None:
    world = World()
    rng = random.Random(0)
    for step in range(200):
        world.line.put(100.0 + step / RATE + rng.uniform(0.0, 0.004), 0.001 * step, 100.0 + step / RATE)
    world.run(104.0)
    assert world.policy.seen == [0.001 * step for step in range(200)]


def test_a_silent_robot_costs_a_wait_for_each_period() -> None:
    world = World((100.0, 0.1))
    world.run(101.0)
    before = world.line.waits
    assert len(world.run(103.0)) == pytest.approx(2 * RATE, abs=2)
    assert world.line.waits - before <= 2.2 * RATE


def test_a_missing_value_is_bridged_and_silence_ends_in_the_safe_posture_within_one_period() -> None:
    world = World((100.0, 0.1))
    answers = world.run(101.0)
    acted = [at for at, command in answers if command != SAFE]
    safe = [at for at, command in answers if command == SAFE]
    assert max(acted) <= 100.0 + AGE
    assert 100.0 + AGE <= min(safe) <= 100.0 + AGE + 1 / RATE
    assert len(safe) == pytest.approx((1.0 - AGE) * RATE, abs=15)  # again and again
    world.line.coming.append((101.05, Arrival("e", stamp=101.05, kind="reset", number=1)))
    world.line.put(101.1, 0.2)
    assert (world.run(101.11)[-1], [kind for kind, _ in world.events]) == (
        (101.1, [2.0, 2.0]),
        ["safe", "episode", "resumed"],
    )
    assert world.server.report()["safe_because"] == {"silence": 1}


@pytest.mark.parametrize(
    ("name", "value", "kind"),
    [
        ("cart.angle", [math.nan], "not finite"),
        ("cart.gyro", [0.0, math.inf, 0.0], "not finite"),
        ("cart.angle", [1.5], "out of range"),
        ("cart.angle", [0.1, 0.1], "layout"),
        ("cart.gyro", [[0.0, 0.0, 0.0]], "layout"),
        ("cart.spare", [0.1], "unknown field"),
    ],
)
def test_a_wrong_message_is_answered_with_the_safe_posture(name: str, value: list[float], kind: str) -> None:
    world = World()
    for step in range(3):
        world.line.put(100.0 + step / RATE, 0.1)
    world.line.coming.append((100.06, Arrival("x", {name: np.array(value)}, 100.06)))
    world.line.put(100.08, 0.2)
    answers = world.run(100.09)
    assert next(at for at, command in answers if command == SAFE) <= 100.06 + 1 / RATE
    assert answers[-1][1] == [2.0, 2.0]  # it goes on with the next good values
    assert world.server.report()["refused"][kind]["count"] == 1
    assert math.nan not in world.policy.seen


@pytest.mark.parametrize(("stamp", "kind"), [(100.02, "twice"), (100.01, "out of order")])
def test_what_a_network_does_to_messages_is_ignored(stamp: float, kind: str) -> None:
    world = World((100.0, 0.1), (100.02, 0.2), (100.03, 0.9, stamp), (100.04, 0.3))
    world.run(100.045)
    assert (world.policy.seen, world.server.report()["refused"][kind]["count"]) == ([0.1, 0.2, 0.3], 2)
    assert not world.server.safe_steps


@pytest.mark.parametrize("jump", [-50.0, 3.0])
def test_a_clock_that_jumps_is_a_fault_until_the_robot_was_silent(jump: float) -> None:
    world = World((100.0, 0.1), (100.02, 0.2, 100.02 + jump))
    assert world.run(100.03)[-1][1] == SAFE
    assert "jumped" in world.server.report()["refused"]["clock"]["first"]
    world.line.put(101.5, 0.3, 101.5 + jump)
    assert world.run(101.51)[-1][1] == [3.0, 3.0]


def test_messages_that_were_long_under_way_are_ignored() -> None:
    world = World()
    for step in range(10):
        world.line.put(100.0 + step / RATE, 0.1, 500.0 + step / RATE)  # the clock of the robot is another one
    world.line.put(100.5, 0.9, 500.2)
    assert world.run(100.51)[-1][1] == SAFE
    assert world.server.report()["refused"]["late"]["count"] == 2
    for late in range(20):  # a network that was held up delivers all at once
        world.line.put(100.6, 0.9, 500.2 + 0.02 * late)
    world.line.put(100.6, 0.3, 500.6)
    assert world.run(100.61)[-1][1] == [3.0, 3.0]
    assert 0.9 not in world.policy.seen


def test_commands_stay_within_value_and_rate() -> None:
    output = Output(
        DRIVE, np.array([-5.0, -2.0]), np.array([5.0, 2.0]), np.array([20.0, np.inf]), np.array(SAFE)
    )
    world = World(output=output)
    for step, angle in enumerate([0.0, 1.0, 1.0, 1.0, -1.0]):
        world.line.put(100.0 + step / RATE, angle)
    commands = [command for _, command in world.run(100.085)]
    np.testing.assert_allclose(commands, [[0.0, 0.0], [0.4, 2.0], [0.8, 2.0], [1.2, 2.0], [0.8, -2.0]])
    assert world.server.commands.limited == 4


def test_a_policy_that_computes_no_number_is_not_obeyed() -> None:
    world = World()
    world.policy.step = lambda values: {"cart.drive": np.array([math.nan, 0.0])}  # type: ignore[method-assign]
    world.line.put(100.0, 0.1)
    assert world.run(100.01) == [(100.0, SAFE)]
    world.policy.step = lambda values: 1 / 0  # type: ignore[method-assign]
    world.line.put(100.02, 0.1)
    assert world.run(100.03)[-1] == (100.02, SAFE)


def test_the_safe_posture_holds_what_has_no_safe_value() -> None:
    output = Output(DRIVE, np.full(2, -5.0), np.full(2, 5.0), np.full(2, np.inf), np.array([np.nan, 0.0]))
    world = World((100.0, 0.3), output=output)
    assert world.run(100.5)[-1][1] == [3.0, 0.0]


def test_an_episode_begins_with_a_new_memory_and_without_old_values() -> None:
    world = World((100.0, 0.1), lockstep=True)
    world.run(100.01)
    world.line.coming.append((100.1, Arrival("e", stamp=100.1, kind="reset", number=1)))
    world.line.put(100.1, 0.9, 100.05)  # from before
    world.line.put(100.2, 0.2)
    world.run(100.25)
    assert (world.policy.seen, world.policy.begun, world.server.episodes) == ([0.1, 0.2], 1, 1)


def test_a_robot_that_is_silent_after_a_reset_gets_the_safe_posture() -> None:
    world = World((100.0, 0.3))
    world.run(100.01)
    world.line.coming.append((100.02, Arrival("e", stamp=100.02, kind="reset", number=1)))
    answers = world.run(101.5)
    assert {tuple(command) for _, command in answers} == {(0.0, 0.0)}
    assert answers[0][0] <= 101.2


def test_a_policy_whose_goal_nobody_has_set_does_not_act_after_a_reset() -> None:
    world = World()
    goal = Input(Field("target", "", "value", "m", (1,)), "float64", *np.array([[0.0], [1.0]]), np.inf, False)
    world.server.intake = Intake((*INPUTS, goal))
    world.line.coming.append((100.0, Arrival("e", stamp=100.0, kind="reset", number=1)))
    world.line.put(101.0, 0.3)
    assert {tuple(command) for _, command in world.run(101.01)} == {(0.0, 0.0)}
    assert world.events[-1] == ("safe", "no new value of target")


def test_in_lockstep_there_is_one_answer_for_each_moment_however_long_it_takes() -> None:
    world = World(lockstep=True)
    for step in range(20):
        world.line.put(100.0 + 7.0 * step, 0.01 * step, 5.0 + step)
        world.line.put(100.001 + 7.0 * step, 0.01 * step, 5.0 + step)  # sent again
    world.run(240.0)
    assert world.policy.seen == [0.01 * step for step in range(20)]
    assert not world.server.safe_steps
    answers = [command for _, command in world.line.sent]
    assert answers == [pytest.approx([0.1 * step, 0.1 * step]) for step in range(20) for _ in range(2)]


# Damage


def _damages(rng: random.Random) -> list[Callable[[dict[str, Any]], Any]]:
    """Each turns a message into one that must not be used."""
    missing = rng.choice(["robot", "stamp", "fields"])
    bad_numbers = [math.nan, math.inf, -math.inf, 1e300, -7.0]

    def into(value: Any) -> Callable[[dict[str, Any]], Any]:
        return lambda message: {**message, "fields": {**message["fields"], "cart.angle": value}}

    return [
        into([rng.choice(bad_numbers)]),
        into([0.1] * rng.choice([0, 2, 3, 1000])),
        into(rng.choice(["0.1", None, {"x": 1}, [[0.1]], b"\x00" * 8, True])),
        lambda message: {**message, "fields": {f"cart.{rng.randrange(9)}": [0.9]}},
        lambda message: {**message, "fields": {}},
        lambda message: {**message, "fields": rng.choice([[], None, 3, "x"])},
        lambda message: {
            **message,
            "stamp": rng.choice([math.nan, math.inf, -math.inf, "now", None, message["stamp"] + 40, -1.0]),
        },
        lambda message: {**message, "extra": 1},
        lambda message: {name: value for name, value in message.items() if name != missing},
        lambda message: {**message, "robot": "x" * 10_000},
        lambda message: {**message, "reset": rng.choice([-1, 2**60, "1", 0.5])},
        lambda message: rng.choice([[], [message], 5, None, "x" * 100, [[[]] * 50] * 50]),
    ]


def test_json_that_begins_with_a_blank_line_is_read() -> None:
    assert links.read(b'\n {"robot": "cart", "stamp": 1.0, "reset": 3}', {}).number == 3


def test_ten_thousand_damaged_messages_are_not_obeyed_and_crash_nothing() -> None:
    world = World()
    rng = random.Random(36)
    fields = {each.field.name: each.field for each in INPUTS}
    moment = 0
    for number in range(10_000):
        at = 100.0 + moment / RATE
        message = {
            "robot": "cart",
            "stamp": at,
            "fields": {"cart.angle": [0.5], "cart.gyro": [0.0, 0.0, 0.0]},
        }
        spoiled = rng.choice(_damages(rng))(message)
        packed = rng.random() < 0.5
        content = msgspec.msgpack.encode(spoiled) if packed else msgspec.json.encode(spoiled)
        if rng.random() < 0.3:
            content = content[: rng.randrange(len(content))] + bytes(
                rng.randrange(256) for _ in range(rng.randrange(4))
            )
        world.line.coming.append((at, links.read(content, fields)))
        if number % 10 == 9:
            moment += 1
            world.line.put(at + 0.5 / RATE, 0.125)
        world.run(at + 0.6 / RATE)
    assert set(world.policy.seen) == {0.125}
    assert {tuple(command) for _, command in world.line.sent} <= {(0.0, 0.0), (1.25, 1.25)}
    report = world.server.report()
    assert sum(entry["count"] for entry in report["refused"].values()) >= 9_900
    assert len(report_lines(report)) < 40


def test_damaged_bytes_of_ros_messages_crash_nothing() -> None:
    pytest.importorskip("cyclonedds")
    from deepbots_robot import dds, ros
    from deepbots_robot.topics import Topic

    rng = random.Random(1)
    codec = ros.Codec("sensor_msgs/JointState", [(ANGLE, Topic("/s", "sensor_msgs/JointState"))])
    good = bytearray(codec.encode({"cart.angle": [0.5]}, 5.0).serialize(use_version_2=False))
    world = World()
    for number in range(500):
        spoiled = bytearray(good[: rng.randrange(4, len(good) + 1)])
        for _ in range(rng.randrange(1, 4)):
            spoiled[rng.randrange(len(spoiled))] = rng.randrange(256)
        try:
            message = ros.TYPES[codec.type].deserialize(bytes(spoiled))
        except Exception as error:  # noqa: BLE001  as the reader gets it
            message = error
        arrival = dds._arrival("/s", codec, message)
        world.line.coming.append((100.0 + number / RATE, arrival))
        world.run(100.0 + number / RATE)
    assert all(math.isfinite(value) and abs(value) <= 1.02 for value in world.policy.seen)


def test_a_report_counts_one_episode_and_one_command_in_the_singular() -> None:
    lines = report_lines({**World().server.report(), "episodes": 1, "safe_steps": 1})
    assert "in 1 episode;" in lines[1]
    assert "  safe posture 1 command" in lines


def test_the_log_has_the_answer_times_of_the_report() -> None:
    """A step that bridges a missing value answers nothing, however old the last value is."""
    world = World()
    answered = world.policy.step

    def slowly(values: Mapping[str, Any]) -> Mapping[str, Array]:
        world.line.now += 0.002
        return answered(values)

    world.policy.step = slowly  # type: ignore[method-assign]
    for step in range(50):
        if step % 10:
            world.line.put(100.0 + step / RATE, 0.001)
    world.run(101.0)
    report = world.server.report()
    assert report["held_steps"] > 1
    answer_times = [answer for posture, answer in world.logged if posture == "policy"]
    assert (len(answer_times), answer_times.count(0.0)) == (report["steps"], report["held_steps"])
    assert max(answer_times) == report["answer_max"]


def test_in_lockstep_a_robot_that_is_quiet_is_remarked_on_once_each_time() -> None:
    world = World(lockstep=True)
    world.run(120.0)
    assert world.events == []  # nobody has begun
    for begun in (120.0, 140.0):
        world.line.put(begun, 0.1)
        world.run(begun + 4.9)
        assert len(world.events) == (begun == 140.0)
        world.run(begun + 19.0)
    assert (world.events, len(world.line.sent)) == (
        [("quiet", "no values for 5 s: does the robot still run?")] * 2,
        2,
    )


# The log


def test_a_log_without_an_end_can_be_read(tmp_path: Path) -> None:
    now = [0.0]
    writer = LogWriter(tmp_path / "a.mcap", {"scenario": "CartPole"}, lambda: now[0])
    for step in range(200):
        now[0] = step / RATE
        writer.step(
            step / RATE,
            {"cart.angle": np.array([0.1])},
            {"cart.drive": np.array([1.0, 1.0])},
            0.001,
            "policy",
        )
    # as a killed process leaves it
    (tmp_path / "b.mcap").write_bytes((tmp_path / "a.mcap").read_bytes()[:-3])
    entries = list(read_log(tmp_path / "b.mcap"))
    assert entries[-1][1] >= 3.98 - 1.0
    assert entries[5][2] == {
        "inputs": {"cart.angle": [0.1]},
        "commands": {"cart.drive": [1.0, 1.0]},
        "answer": 0.001,
        "posture": "policy",
    }
    writer.close()
    assert len(list(read_log(tmp_path / "a.mcap"))) == 200
    (tmp_path / "c.mcap").write_bytes(b"no log")
    with pytest.raises(ValueError, match="is not a log of a robot"):
        list(read_log(tmp_path / "c.mcap"))


# Each test has ports of its own: ZeroMQ releases an address a little after the link is closed. They are below
# those that systems give to outgoing connections.
PORTS = itertools.count(
    20_001 + 1_000 * int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")), 2
)
LINKS = {"zmq": Transport(), "websocket": Transport()}


@pytest.fixture(autouse=True)
def port() -> int:
    """The port of ZeroMQ; that of WebSocket is the next one."""
    port = next(PORTS)
    LINKS["zmq"] = Transport(zmq=f"tcp://127.0.0.1:{port}")
    LINKS["websocket"] = Transport(websocket=str(port + 1))
    return port


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
    monkeypatch.setattr(links, "HELD", 0.3)
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
            assert waiting == 4 or waiting * longest <= links._WAITING_BYTES
            assert longest <= 20_000 + sum(2 * field.count for field in fields)


@pytest.mark.slow
def test_connections_that_say_nothing_are_few_and_do_not_keep_a_robot_out(port: int) -> None:
    with connected(LINKS["websocket"]) as (policy, robot):
        silent = []
        try:
            for _ in range(40):
                silent.append(socket.create_connection(("127.0.0.1", port + 1), timeout=5))
            link: Any = policy
            assert len(link._open) <= websocket.MOST_CONNECTIONS
            first = robot()
            first.send({"cart.angle": np.array([0.1])}, 1.0)
            assert angles_taken(policy, 1.0) == [0.1]
            for _ in range(40):  # the one that is answered stays
                silent.append(socket.create_connection(("127.0.0.1", port + 1), timeout=5))
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
def served_process(
    bundle: Path, folder: Path, *words: object, **settings: Any
) -> Iterator[tuple[Any, subprocess.Popen[str]]]:
    """A socket of ZeroMQ to a server in a process of its own."""
    address = f"ipc://{folder}/link"
    link = [] if "--websocket" in words else ["--zmq", address]
    command = [sys.executable, "-m", "deepbots_robot", "serve", bundle, *link, *words]
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
        pytest.param({"robot": ESCAPE, "fields": {"x": [1.0]}}, marks=pytest.mark.slow),
        {"about": {"role": "robot", "scenario": ESCAPE, "digest": "", "pace": ""}},
    ],
)
def test_a_message_writes_no_control_characters_to_the_terminal(
    bundle: Path, tmp_path: Path, changes: dict[str, Any]
) -> None:
    with served_process(bundle, tmp_path) as (end, process):
        end.send(message(1.0))
        await_answer(end)
        end.send(message(1.04, **changes))
        time.sleep(0.2)
        text = output_of(process)
    assert "refused" in text
    assert text.replace("\n", "").isprintable()


def flood(address: str, content: bytes, ended: threading.Event) -> None:
    """Send a message as fast as possible until the test ends; a connection that is closed is opened again."""
    while not ended.is_set():
        with suppress(WebSocketException, OSError, zmq.Again), end_of(address) as (send, _):
            while not ended.is_set():
                send(content)


@contextmanager
def end_of(address: str) -> Iterator[tuple[Callable[[bytes], object], Callable[[], object]]]:
    """The functions that send and receive at an address."""
    if address.startswith("ws"):
        with connect(address, compression=None, max_size=None) as peer:
            yield lambda content: peer.send(content.decode()), lambda: peer.recv(timeout=20)
        return
    with closing(zmq.Context.instance().socket(zmq.DEALER)) as end:
        for option, value in ((zmq.LINGER, 0), (zmq.SNDTIMEO, 1000), (zmq.RCVTIMEO, 20_000)):
            end.setsockopt(option, value)
        end.connect(address)
        yield end.send, end.recv


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a process is known on Linux alone")
@pytest.mark.parametrize("kind", ["zmq", "websocket"])
def test_in_a_flood_a_server_takes_no_memory_and_goes_on_to_answer(
    bundle: Path, tmp_path: Path, port: int, kind: str
) -> None:
    """The longest legal message, the longest that is none, and a longer one than any, as fast as possible."""
    longest = 20_000
    contents = [message(1.0).ljust(longest), b"{" + b"[" * longest, b"{" + b" " * 8 * longest]
    address = f"ipc://{tmp_path}/link" if kind == "zmq" else f"ws://127.0.0.1:{port}"
    words = ["--json"] if kind == "zmq" else ["--json", "--websocket", str(port)]
    ended = threading.Event()
    clients = [threading.Thread(target=flood, args=(address, content, ended)) for content in contents]
    with served_process(bundle, tmp_path, *words) as (_, process):
        process.stderr.readline()  # it listens
        with end_of(address) as (send, receive):
            send(message(time.time()))
            receive()
            before = memory_of(process.pid)
            for client in clients:
                client.start()
            try:
                for _ in range(300):
                    send(message(time.time()))
                    receive()
                    time.sleep(1 / 60)
            finally:
                ended.set()
                for client in clients:
                    client.join()
            assert memory_of(process.pid) - before < 50


def memory_of(process: int) -> float:
    """The largest memory that a process had, MB."""
    status = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM:"))


def test_a_time_of_the_robot_beyond_the_range_of_logs_does_not_end_the_server(
    bundle: Path, tmp_path: Path
) -> None:
    log = tmp_path / "a.mcap"
    with served_process(bundle, tmp_path, "--lockstep", "--log", log) as (end, process):
        for stamp in (1.0, 1e300, 1.7e308):
            end.send(message(stamp))
            await_answer(end)
        assert "Traceback" not in output_of(process)
    assert sum(topic == "/step" for topic, _, _ in read_log(log)) >= 3


@pytest.mark.skipif(sys.platform == "win32", reason="a limit of the size of files")
def test_a_full_disk_ends_the_log_and_not_the_policy(bundle: Path, tmp_path: Path) -> None:
    limits = {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))}
    with served_process(bundle, tmp_path, "--lockstep", "--log", tmp_path / "a.mcap", **limits) as (
        end,
        process,
    ):
        for number in range(150):
            end.send(message(number / 30.0))
            await_answer(end)
        text = output_of(process)
    assert text.count("nothing more is written to the log") == 1
    assert "Traceback" not in text


@pytest.mark.parametrize("seconds", ["nan", "inf", "-1", "0"])
def test_a_time_to_serve_that_never_passes_is_refused(
    bundle: Path, tmp_path: Path, seconds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    address = f"ipc://{tmp_path}/link"
    assert main(["serve", str(bundle), "--zmq", address, f"--seconds={seconds}"]) == 1
    assert re.fullmatch(r"error: .* is not a time to serve for; .*\n", capsys.readouterr().err)


@pytest.mark.slow
def test_a_robot_that_did_not_fit_does_not_keep_out_the_next_one(bundle: Path, tmp_path: Path) -> None:
    other_scenario = {"role": "robot", "scenario": "Other", "digest": "", "pace": ""}
    with served_process(bundle, tmp_path) as (end, process):
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


def test_a_step_in_the_same_tick_of_the_clock_as_the_last_one_commands_a_number() -> None:
    world = World((100.0, 0.3))
    world.line.now = 100.0
    world.server.turn()
    world.line.coming.append((100.0, Arrival("robot", kind="reset", stamp=100.0, number=1)))
    world.line.put(100.0, 0.2, stamp=100.001)
    world.server.turn()
    assert [command for _, command in world.line.sent] == [[3.0, 3.0], [2.0, 2.0]]


def test_a_websocket_message_of_endless_empty_parts_is_ended(port: int) -> None:
    with (
        closing(opened(LINKS["websocket"], robot=False)),
        closing(socket.create_connection(("127.0.0.1", port + 1), 5)) as raw,
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
def test_a_zeromq_message_without_an_end_takes_no_more_memory(
    monkeypatch: pytest.MonkeyPatch, port: int
) -> None:
    monkeypatch.setattr(zeromq, "_MOST_GROWTH", 30_000_000)
    part = b"\x03" + struct.pack(">Q", 15_000) + bytes(15_000)
    with (
        closing(opened(LINKS["zmq"], robot=False)) as policy,
        closing(socket.create_connection(("127.0.0.1", port), 5)) as raw,
    ):
        raw.settimeout(5)
        raw.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(16) + b"\x00" + bytes(31))
        raw.sendall(b"\x04\x1c\x05READY\x0bSocket-Type" + struct.pack(">I", 6) + b"DEALER")
        answer = b""
        while b"READY" not in answer:  # ZeroMQ refuses a message that comes before the handshake is done
            answer += raw.recv(64)
        unsent = b""

        def flooded() -> bool:
            nonlocal unsent
            unsent = unsent or part * 100
            with suppress(TimeoutError):  # of a busy machine
                unsent = unsent[raw.send(unsent) :]
            policy.take()
            return any("without an end" in remark.text for remark in policy.remarks())

        until(flooded)
        with pytest.raises(ConnectionError):
            raw.sendall(part * 1000)
        with closing(opened(LINKS["zmq"], robot=True)) as robot:
            until(robot.connected)


def test_a_log_takes_any_time(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.mcap", {})
    for stamp in (-1e300, 0.0, 1e300):
        writer.step(stamp, {}, {}, 0.0, "policy")
    writer.close()
    assert [round(stamp) for _, stamp, _ in read_log(tmp_path / "a.mcap")] == [0, 0, 18_000_000_000]
