"""The page for those who come from Isaac Lab: each of its lines compiles in a scenario that extends the
quadruped, ten of its lines have the value of a formula over readings of the engine, and its numbers are
right.
"""

from __future__ import annotations

import itertools
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.scenario.documentation import TERMS_FILE

PAGE = Path(__file__).parents[2] / "docs" / "isaac-lab.md"
TEXT = PAGE.read_text(encoding="utf-8")
AUGMENTED = ("vx", "vy", "wz", "v", "clock")


class Line(NamedTuple):
    """A line of a scenario, and the keys of the mapping in which it stands."""

    place: tuple[str, ...]
    text: str

    @property
    def name(self) -> str:
        return self.text.split(":", 1)[0]


class Row(NamedTuple):
    """The terms of a row and of the rows that continue it: their names, their lines, or why there is none."""

    names: tuple[str, ...]
    lines: tuple[Line, ...]
    reason: str

    @property
    def kind(self) -> str:
        """`line`, or the words with which the reason begins."""
        return "line" if self.lines else re.split("[:.]", self.reason)[0]


def _row(entry: dict[str, Any]) -> Row:
    lines = (Line(tuple(section.split(".")) if section else (), text) for section, text in entry["lines"])
    return Row(tuple(entry["names"]), tuple(lines), entry["reason"])


SECTIONS = {
    title: [_row(entry) for entry in entries]
    for title, entries in json.loads(TERMS_FILE.read_text(encoding="utf-8")).items()
}
ROWS = [row for rows in SECTIONS.values() for row in rows]
WITH_LINES = [row for row in ROWS if row.lines]


def base() -> str:
    block = re.search(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
    assert block is not None
    return block[1]


def written(tree: dict[str, Any], indent: int = 0) -> Iterator[str]:
    for key, part in tree.items():
        if isinstance(part, dict):
            yield f"{' ' * indent}{key}:"
            yield from written(part, indent + 2)
        else:
            yield f"{' ' * indent}{part}"


def scenario(folder: Path, lines: tuple[Line, ...], more: str = "") -> Path:
    """A scenario with these lines, which extends that of the page. Sensors are sent and values of the world
    are augmented if a line observes them.
    """
    observes = any(line.place == ("observation",) for line in lines)
    tree: dict[str, Any] = {}
    for line in lines:
        mapping = tree
        for key in line.place:
            mapping = mapping.setdefault(key, {})
        mapping[line.text] = line.text
        if observes and line.place == ("robots", "dog", "sensors"):
            tree["robots"]["dog"].setdefault("emit", {})[line.name] = f"{line.name}: {line.name}"
    observed = [line.name for line in lines if observes and line.place == ("signals",)]
    if observed:
        tree["augment"] = f"augment: [{', '.join([*AUGMENTED, *observed])}]"
    (folder / "base.yaml").write_text(base(), encoding="utf-8")
    path = folder / "row.yaml"
    text = "\n".join(["deepbots: 1", "extends: base.yaml", "name: Row", *written(tree), more, ""])
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("row", WITH_LINES, ids=lambda row: row.names[0])
def test_an_episode_begins_with_a_line(row: Row, tmp_path: Path) -> None:
    # PyBullet renders images on any machine.
    engine = "mujoco" if any(line.text == "engine: mujoco" for line in row.lines) else "pybullet"
    pytest.importorskip(engine)
    with closing(api.make(scenario(tmp_path, row.lines), engine=engine)) as environment:
        environment.reset(seed=1)
        assert np.isfinite(environment.step(environment.action_space.sample())[1])


def test_each_section_with_terms_has_a_place_for_them_on_the_page() -> None:
    assert [row.names for row in WITH_LINES if row.reason] == []
    assert re.findall(r"^## (.+)\n(?:(?!## ).*\n)*?<!-- terms -->", TEXT, re.MULTILINE) == list(SECTIONS)


def test_the_numbers_of_the_page_are_those_of_its_tables() -> None:
    counts = Counter(row.kind for row in ROWS for _ in row.names)
    assert set(counts) == {"line", "Not needed", "Not yet", "Left out"}
    assert (
        f"Of {sum(counts.values())} terms and settings, {counts['line']} have a line, "
        f"{counts['Not needed']} need none, {counts['Not yet']} have none yet, "
        f"and {counts['Left out']} are left out."
    ) in TEXT


def test_the_terms_of_isaac_lab_alone_are_counted_without_base_classes_and_planners() -> None:
    own = itertools.takewhile(lambda title: title != "Entries of velocity_env_cfg", SECTIONS)
    counts = Counter(
        row.kind
        for title in own
        for row in SECTIONS[title]
        for _ in row.names
        if row.kind != "Left out" and "base classes" not in row.reason
    )
    assert (
        f"Of the {sum(counts.values())} terms of `isaaclab.envs.mdp` and of its velocity task alone, without "
        f"base classes and planners of manipulation, {counts['line']} have a line, "
        f"{counts['Not needed']} need none, and {counts['Not yet']} have none yet."
    ) in TEXT


JOINTS = [f"{leg}_{joint}_joint" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "upper", "lower")]
LOW = np.tile([-0.72, -0.79, -2.61], 4)
HIGH = np.tile([0.72, 3.93, -1.01], 4)
TIMESTEP = 0.02
VX, VY = 0.4, -0.2
FIXED = f"""
parameters: {{vx: {VX} m/s, vy: {VY} m/s, wz: 0 rad/s}}
termination: {{failure: {{fell: position(dog).z < -1 m}}}}
truncation: {{max_time: 3 s}}
"""


class Readings(NamedTuple):
    """What the engine reads after a timestep, and the action. Velocities are in the frame of the trunk."""

    velocity: np.ndarray
    angular: np.ndarray
    down: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    torque: np.ndarray
    touch: np.ndarray
    thigh_force: np.ndarray
    action: np.ndarray
    air: np.ndarray
    """How long each toe was in the air before this timestep, s."""


Formula = Callable[[Readings, Readings], float]
FORMULAS: dict[str, Formula] = {
    "track_lin_vel_xy_exp": lambda now, _: np.exp(-np.sum((now.velocity[:2] - (VX, VY)) ** 2) / 0.25),
    "lin_vel_z_l2": lambda now, _: -2.0 * now.velocity[2] ** 2,
    "ang_vel_xy_l2": lambda now, _: -0.05 * np.sum(now.angular[:2] ** 2),
    "joint_torques_l2": lambda now, _: -1e-5 * np.sum(now.torque**2),
    "joint_acc_l2": lambda now, last: -2.5e-7 * np.sum(((now.dq - last.dq) / TIMESTEP) ** 2),
    "action_rate_l2": lambda now, last: -0.01 * np.sum((now.action - last.action) ** 2),
    "feet_air_time": lambda now, last: 0.125 * np.sum((now.air - 0.5) * (now.touch & ~last.touch)),
    "undesired_contacts": lambda now, _: -float(np.count_nonzero(now.thigh_force > 1.0)),
    "flat_orientation_l2": lambda now, _: -np.sum(now.down[:2] ** 2),
    "joint_pos_limits": lambda now, _: -np.sum(np.maximum(LOW - now.q, 0.0) + np.maximum(now.q - HIGH, 0.0)),
}
"""Rewards of `velocity_env_cfg` with its weights. The formulas follow the definitions of Isaac Lab."""


def seen_from(turned: tuple[float, float, float, float], vector: Any) -> np.ndarray:
    """A vector of the world in a frame that a quaternion (x, y, z, w) turns."""
    axis = np.array(turned[:3])
    w = turned[3]
    across = np.cross(axis, vector)
    return np.array(vector) - 2.0 * w * across + 2.0 * np.cross(axis, across)


class Reader:
    """Reads the engine after each timestep of an episode."""

    def __init__(self, engine: Any) -> None:
        legs = ("FR", "FL", "RR", "RL")
        self._motion = engine.motion("dog")
        self._joints = engine.joint_states("dog", JOINTS)
        self._torques = engine.joint_torques("dog", JOINTS)
        self._touches = [engine.contact(("dog", f"{leg}_toe"), [("ground", None)]) for leg in legs]
        self._forces = [engine.contact_force(("dog", f"{leg}_upper")) for leg in legs]
        self._air = np.zeros(len(legs))

    def read(self, action: np.ndarray) -> Readings:
        (_, turned), (velocity, angular) = self._motion()
        joints = np.array([state[:2] for state in self._joints()])
        touch = np.array([touches() for touches in self._touches], bool)
        before = self._air
        self._air = np.where(touch, 0.0, before + TIMESTEP)
        return Readings(
            seen_from(turned, velocity),
            seen_from(turned, angular),
            seen_from(turned, (0.0, 0.0, -1.0)),
            joints[:, 0],
            joints[:, 1],
            np.array(self._torques()),
            touch,
            np.array([force() for force in self._forces]),
            action,
            before,
        )


def test_ten_rewards_have_the_values_of_isaac_lab(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    by_name = {row.names[0]: row for row in ROWS}
    chosen = [by_name[name] for name in (*FORMULAS, "JointPositionToLimitsAction")]
    path = scenario(tmp_path, tuple(dict.fromkeys(line for row in chosen for line in row.lines)), FIXED)
    terms = {
        name: next(line.name for line in by_name[name].lines if line.place == ("reward",))
        for name in FORMULAS
    }
    steps = 120
    values = {name: np.zeros((2, steps)) for name in FORMULAS}
    with closing(api.make(path)) as environment:
        reader = Reader(environment.engine)
        environment.reset(seed=3)
        last = reader.read(np.zeros(12))
        actions = np.random.default_rng(0)
        for step in range(steps):
            if step % 10 == 0:
                action = actions.uniform(-1.0, 1.0, 12).astype(np.float32)
            info = environment.step(action)[-1]
            now = reader.read(action.astype(float))
            for name, formula in FORMULAS.items():
                values[name][:, step] = info["reward_terms"][terms[name]], formula(now, last)
            last = now
    for name, (ours, theirs) in values.items():
        assert np.count_nonzero(theirs) > 2, name
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-9, err_msg=name)
