"""Messages from robot to robot."""

from __future__ import annotations

import json
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.runtime.agents import combined_action, seats_of
from tests.agents.carts import CARTS

HEARING = (
    CARTS.replace(
        "  left:\n    urdf: cartpole\n", "  left:\n    urdf: cartpole\n    hear: {mate: right.angle}\n"
    )
    .replace("  right:\n    urdf: cartpole\n", "  right:\n    urdf: cartpole\n    hear: {mate: left.angle}\n")
    .replace("speed: -1 .. 1 m/s}", "speed: -1 .. 1 m/s, left.mate: -1 .. 1 rad}")
)
PUSH = {"left": np.ones(1, np.float32), "right": np.zeros(1, np.float32)}


@pytest.fixture
def carts(tmp_path: Path) -> Path:
    file = tmp_path / "carts.yaml"
    file.write_text(HEARING)
    return file


def _observed(file: Path, steps: int = 12, engine: str | None = None) -> list[dict[str, list[float]]]:
    """Return what each agent sees after the reset and after each step."""
    with closing(api.make(file, engine=engine)) as world:
        seats = seats_of(world)
        seen = [world.reset(seed=3)[0]]
        seen += [world.step(combined_action(world, seats, PUSH))[0] for _ in range(steps)]
        return [{name: seat.observation(each).tolist() for name, seat in seats.items()} for each in seen]


@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
def test_an_agent_sees_what_its_robot_heard_a_timestep_ago(carts: Path, engine: str) -> None:
    pytest.importorskip("mujoco")
    seen = _observed(carts, engine="mujoco" if engine == "mujoco" else None)
    for name, other in (("left", "right"), ("right", "left")):
        heard = [each[name][2] for each in seen]
        measured = [each[other][0] for each in seen]
        assert heard[0] == measured[0]  # the first message arrives with the reset
        assert heard[1:] == measured[:-1]
        assert len(set(heard)) > 5


def test_a_latency_delays_and_a_range_cuts_the_messages(carts: Path) -> None:
    carts.write_text(HEARING + "messages: {between_robots: {latency: 64 ms}}\n")
    seen = _observed(carts)
    assert [each["left"][2] for each in seen[3:]] == [each["right"][0] for each in seen[:-3]]
    carts.write_text(HEARING + "messages: {between_robots: {range: 50 cm}}\n")  # the carts are 1 m apart
    seen = _observed(carts)
    assert {each["left"][2] for each in seen} == {seen[0]["right"][0]}
    carts.write_text(HEARING + "messages: {between_robots: {range: 50 cm, on_loss: zero}}\n")
    assert {each["left"][2] for each in _observed(carts)[2:]} == {0.0}


def test_losses_are_drawn_for_each_pair_and_repeat_with_the_seed(carts: Path) -> None:
    carts.write_text(
        HEARING + "messages: {between_robots: {loss: 50 %, latency: uniform(0 .. 50 ms) each step}}\n"
    )
    first, second = _observed(carts, 40), _observed(carts, 40)
    assert first == second
    repeated = [a["left"][2] == b["left"][2] for a, b in pairwise(first)]
    of_the_other_robot = [a["right"][2] == b["right"][2] for a, b in pairwise(first)]
    assert 5 < sum(repeated) < 36
    assert repeated != of_the_other_robot


def test_a_batch_delivers_the_messages_of_single_worlds(carts: Path) -> None:
    pytest.importorskip("mujoco")
    carts.write_text(
        "parameters: {slow: uniform(20 .. 90 ms)}\n"
        + HEARING
        + "messages: {between_robots: {loss: 30 %, latency: slow + uniform(0 .. 20 ms) each step}}\n"
    )
    with closing(api.make_vec(carts, 3)) as batch, closing(api.make(carts, engine="mujoco")) as single:
        batch.reset(seed=[4, 5, 6])
        single.reset(seed=5)
        generator = np.random.default_rng(0)
        for _ in range(12):
            actions = generator.uniform(-1, 1, (3, 2)).astype(np.float32)
            assert batch.step(actions)[0][1].tolist() == single.step(actions[1])[0].tolist()


def test_a_robot_of_the_same_agent_is_heard_too(tmp_path: Path) -> None:
    file = tmp_path / "one.yaml"
    file.write_text(
        "deepbots: 1\nextends: cartpole\nname: Pair\nmessages: {format: struct}\n"
        "robots:\n  cart: {hear: {other_angle: other.lean}}\n"
        "  other:\n    urdf: cartpole\n    pose: {y: 30 cm}\n"
        "    sensors: {lean: {type: joint_position, joint: pole_hinge}}\n"
        "observation: {cart.other_angle: -20 .. 20 deg}\n"
        "reset: {joints: {other.pole_hinge: 3 deg}}\n"
    )
    with closing(api.make(file)) as world:
        observed, _ = world.reset(seed=0)
        assert observed[-1] == pytest.approx(3 / 20, rel=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "headline"),
    [
        ("mate: right.angle", "mate: middle.angle", "there is no value of another robot `middle.angle`"),
        ("mate: right.angle", "mate: right.angel", "there is no value of another robot `right.angel`"),
        ("mate: right.angle", "mate: left.angle", "`left` cannot hear itself"),
        ("mate: right.angle", "mate: right.mate", "`right` hears `right.mate`, and does not send it"),
        ("left.mate: -1 .. 1 rad", "right.mate: -1 .. 1 rad", "`right` sends `mate` to its agent `right`"),
        ("left.mate: -1 .. 1 rad", "right.angle: -1 .. 1 rad", "`right` sends `angle` to its agent `right`"),
    ],
)
def test_a_mistake_in_what_a_robot_hears_is_one_finding(
    carts: Path, old: str, new: str, headline: str
) -> None:
    carts.write_text(HEARING.replace(old, new, 1))
    errors = [finding for finding in api.lint(carts) if finding.severity == "error"]
    assert headline in errors[0].headline
    assert len(errors) == 1


def test_an_agent_learns_and_lint_has_no_doubts(carts: Path, tmp_path: Path) -> None:
    codes = {finding.code for finding in api.lint(carts)}
    assert codes <= {"DB708"}  # that falling ends the payments, which is the point here
    carts.write_text(
        HEARING + "train: {algorithm: PPO, total_timesteps: 128, n_steps: 64, n_epochs: 1, batch_size: 32}\n"
    )
    assert deepbots_cli.train(carts, run=tmp_path / "run", seed=0).steps == 128
    pytest.importorskip("onnx")
    folder = tmp_path / "bundle"
    assert main(["export", str(tmp_path / "run"), "--agent", "left", "-o", str(folder)]) == 0
    inputs = {entry["name"]: entry for entry in json.loads((folder / "bundle.json").read_text())["inputs"]}
    assert inputs["left.mate"]["supplied_by"] == "messages of right"
    assert inputs["left.mate"]["latency_s"] == 0.032
    assert "left.mate: another robot sends this" in (folder / "README.md").read_text()
