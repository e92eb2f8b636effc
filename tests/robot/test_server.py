"""The server of a policy: messages that it accepts, messages that it refuses, and its commands when the robot
is silent."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("zmq")

from deepbots_robot import messages
from deepbots_robot.about import About, Remark
from deepbots_robot.intake import Input
from deepbots_robot.link import Array, Arrival
from deepbots_robot.log import LogWriter, read_log
from deepbots_robot.server import Output, Server, report_lines
from deepbots_robot.topics import Field

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
    """A server on a line."""

    def __init__(self, *, output: Output | None = None, **settings: Any) -> None:
        free = np.full(2, np.inf)
        self.events: list[tuple[str, str]] = []
        self.logged: list[tuple[str, float]] = []
        self.line = Line()
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
    world = World()
    world.line.put(100.0, 0.1)
    world.run(101.0)
    before = world.line.waits
    assert len(world.run(103.0)) == pytest.approx(2 * RATE, abs=2)
    assert world.line.waits - before <= 2.2 * RATE


def test_a_missing_value_is_bridged_and_silence_ends_in_the_safe_posture_within_one_period() -> None:
    world = World()
    world.line.put(100.0, 0.1)
    answers = world.run(101.0)
    acted = [at for at, command in answers if command != SAFE]
    safe = [at for at, command in answers if command == SAFE]
    assert max(acted) <= 100.0 + AGE
    assert 100.0 + AGE <= min(safe) <= 100.0 + AGE + 1 / RATE
    assert len(safe) == pytest.approx((1.0 - AGE) * RATE, abs=15)  # again and again
    world.line.coming.append((101.05, Arrival("e", stamp=101.05, kind="reset", number=1)))
    world.line.put(101.1, 0.2)
    assert world.run(101.11)[-1] == (101.1, [2.0, 2.0])
    assert [kind for kind, _ in world.events] == ["safe", "episode", "resumed"]
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
    world = World()
    world.line.put(100.0, 0.1)
    world.line.put(100.02, 0.2)
    world.line.put(100.03, 0.9, stamp)
    world.line.put(100.04, 0.3)
    world.run(100.045)
    assert world.policy.seen == [0.1, 0.2, 0.3]
    assert world.server.report()["refused"][kind]["count"] == 2
    assert not world.server.safe_steps


@pytest.mark.parametrize("jump", [-50.0, 3.0])
def test_a_clock_that_jumps_is_a_fault_until_the_robot_was_silent(jump: float) -> None:
    world = World()
    world.line.put(100.0, 0.1)
    world.line.put(100.02, 0.2, 100.02 + jump)
    assert world.run(100.03)[-1][1] == SAFE
    assert "jumped" in world.server.report()["refused"]["clock"]["first"]
    world.line.put(101.5, 0.3, 101.5 + jump)
    assert world.run(101.51)[-1][1] == [3.0, 3.0]


def test_messages_that_were_long_under_way_are_ignored() -> None:
    world = World()
    for step in range(10):
        world.line.put(100.0 + step / RATE, 0.1, 500.0 + step / RATE)  # the clock of the robot is another one
    world.line.put(100.5, 0.9, 500.2)
    answers = world.run(100.51)
    assert answers[-1][1] == SAFE
    assert 0.9 not in world.policy.seen
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
    world = World(output=output)
    world.line.put(100.0, 0.3)
    assert world.run(100.5)[-1][1] == [3.0, 0.0]


def test_an_episode_begins_with_a_new_memory_and_without_old_values() -> None:
    world = World(lockstep=True)
    world.line.put(100.0, 0.1)
    world.run(100.01)
    world.line.coming.append((100.1, Arrival("e", stamp=100.1, kind="reset", number=1)))
    world.line.put(100.1, 0.9, 100.05)  # from before
    world.line.put(100.2, 0.2)
    world.run(100.25)
    assert world.policy.seen == [0.1, 0.2]
    assert world.policy.begun == world.server.episodes == 1


def test_a_robot_that_is_silent_after_a_reset_gets_the_safe_posture() -> None:
    world = World()
    world.line.put(100.0, 0.3)
    world.run(100.01)
    world.line.coming.append((100.02, Arrival("e", stamp=100.02, kind="reset", number=1)))
    answers = world.run(101.5)
    assert {tuple(command) for _, command in answers} == {(0.0, 0.0)}
    assert answers[0][0] <= 101.2


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
        world.line.coming.append((at, messages.read(content, fields)))
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
    from deepbots_robot import dds, idl, ros
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
            message = idl.TYPES[codec.type].deserialize(bytes(spoiled))
        except Exception as error:  # noqa: BLE001  as the reader gets it
            message = error
        arrival = dds._arrival("/s", codec, message)
        world.line.coming.append((100.0 + number / RATE, arrival))
        world.run(100.0 + number / RATE)
    assert all(math.isfinite(value) and abs(value) <= 1.02 for value in world.policy.seen)


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
    assert len(answer_times) == report["steps"]
    assert answer_times.count(0.0) == report["held_steps"]
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
    assert world.events == [("quiet", "no values for 5 s: does the robot still run?")] * 2
    assert len(world.line.sent) == 2


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
    content = (tmp_path / "a.mcap").read_bytes()  # as a killed process leaves it
    (tmp_path / "b.mcap").write_bytes(content[:-3])
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
