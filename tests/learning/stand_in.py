"""A small world to learn in: a cart-pole by its equations, and the scenario that describes it.

It stands in for the generated supervisor, with the same observation, action, info and endings, at a few
microseconds a step.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.document.load import loads
from deepbots_cli.program import Program
from deepbots_cli.program.task import AdaptiveRate, Choices, Hyperparameter, Schedule, Solved, Training

FALL = math.radians(15)
TRACK = 0.39
TEXT = """\
deepbots: 1
name: {name}
summary: Keep a pole upright.
world: {{timestep: 32 ms, substeps: 4}}
robots:
  cart:
    urdf: cartpole
    sensors: {{pole_angle: {{type: joint_position, joint: pole_hinge}}}}
    actuators: {{wheels: {{type: velocity_motor, joints: [wheel_*], max_torque: 10 N*m}}}}
    emit: [pole_angle]
    apply: {{wheels: {apply}}}
messages: {{format: csv}}
action: {{drive: {action}}}
augment:
  x: position(cart).x
  speed: velocity(cart).x
  tip_speed: velocity(cart.tip).x
observation:
  x: -0.4 .. 0.4 m
  speed: {{range: -{speed_range} .. {speed_range} m/s}}
  cart.pole_angle: -0.35 .. 0.35 rad
  tip_speed: -2 .. 2 m/s
reward: {reward}
termination: {{failure: {{fallen: abs(cart.pole_angle) > 15 deg, off_track: abs(x) > 0.39 m}}{success}}}
truncation: {{max_steps: {max_steps}}}
evaluation: {{episodes: 20{cases}}}
"""


def hyper(**settings: Any) -> tuple[Hyperparameter, ...]:
    """Hyperparameters of a training by their names."""
    return tuple(Hyperparameter(name, value) for name, value in settings.items())


def compiled(
    *,
    training: Training | None = None,
    solved: Solved | None = None,
    continuous: bool = False,
    speed_range: float = 0.8,
    name: str = "stand_in",
    max_steps: int = 200,
    success: bool = False,
    cases: str = "",
    apply: str = "drive * 5 rad/s",
    reward: str = "{alive: 1, center: 0}",
    more: str = "",
) -> api.Compiled:
    """The task; `speed_range` is the range of the observed speed in m/s; an episode may end in success,
    if `success`; `cases` of the evaluation and `more` sections are YAML."""
    action = "-1 .. 1" if continuous else "{choices: {forward: 1, backward: -1}}"
    text = TEXT.format(
        name=name,
        action=action,
        apply=apply,
        reward=reward,
        speed_range=speed_range,
        max_steps=max_steps,
        success=", success: {balanced: time > 1 h}" if success else "",
        cases=f", cases: {{{cases}}}" if cases else "",
    )
    text += f"train: {_train(training or Training('PPO', 512, environments=2))}\n"
    if solved is not None:
        metric = "mean_return" if solved.success_rate is None else "success_rate"
        text += f"solved: {metric} >= {getattr(solved, metric)} over {solved.episodes} episodes\n"
    return _compiled(text + more)


@cache
def _compiled(text: str) -> api.Compiled:
    return api.compile(check(loads(text, "stand_in.yaml", Path(__file__).parent)))


def _train(training: Training) -> str:
    """The section in YAML."""
    section: dict[str, Any] = {
        name: getattr(training, name) for name in ("algorithm", "total_timesteps", "environments")
    }
    section |= {"shards": training.shards, "staleness": training.staleness}
    section |= {} if training.patience is None else {"patience": training.patience}
    section |= {entry.name: _figure(entry.value) for entry in training.hyperparameters}
    section["network"] = {"hidden": list(training.network.hidden), "activation": training.network.activation}
    if training.action_noise is not None:
        noise = training.action_noise
        section["action_noise"] = {"type": noise.type, "sigma": _figure(noise.sigma)}
    if training.replay is not None:
        section["replay"] = "her"
    if training.normalize is not None:
        section["normalize"] = training.normalize
    return json.dumps(section)


def _figure(value: object) -> object:
    if isinstance(value, AdaptiveRate):
        return {"kl": value.kl, "start": value.start}
    return f"{value.start!r} -> {value.end!r}" if isinstance(value, Schedule) else value


def scenario(**settings: Any) -> Program:
    """The program of the same scenario."""
    return compiled(**settings).program


class CartPole(gym.Env[Any, Any]):
    """The cart follows its speed command within a tick; the pole is a uniform rod of 1 m on a moving
    hinge."""

    def __init__(self, program: Program, render_mode: str | None = None) -> None:
        self.program = program
        self.render_mode = render_mode
        self.observation_space = gym.spaces.Box(-1, 1, (4,), np.float32)
        self.discrete = isinstance(program.agent.action[0], Choices)
        self.action_space = (
            gym.spaces.Discrete(2) if self.discrete else gym.spaces.Box(-1, 1, (1,), np.float32)
        )
        self.closed = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.x = self.v = self.w = 0.0
        self.angle = float(self.np_random.uniform(-1, 1)) * math.radians(1)
        self.steps = 0
        return self._observation(), self._info(None)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        command = 0.2 * ((1 if action == 0 else -1) if self.discrete else float(action[0]))
        acceleration = max(-10.0, min(10.0, (command - self.v) / 0.032))
        for _ in range(4):
            self.v += acceleration * 0.008
            self.x += self.v * 0.008
            self.w += 1.5 * (9.81 * math.sin(self.angle) - acceleration * math.cos(self.angle)) * 0.008
            self.angle += self.w * 0.008
        self.steps += 1
        ended_by = "fallen" if abs(self.angle) > FALL else "off_track" if abs(self.x) > TRACK else None
        truncated = self.steps >= (self.program.truncation.max_steps or 200)
        return (
            self._observation(),
            1.0,
            ended_by is not None,
            truncated,
            self._info(ended_by or ("max_steps" if truncated else None)),
        )

    def _observation(self) -> Any:
        tip = self.v + self.w
        raw = (self.x / 0.4, self.v / self.program.agent.numbers[1].high, self.angle / 0.35, tip / 2.0)
        return np.clip(np.array(raw, np.float32), -1, 1)

    def _info(self, ended_by: str | None) -> dict[str, Any]:
        return {
            "is_success": ended_by == "max_steps",
            "ended_by": ended_by,
            "reward_terms": {"alive": 1.0, "center": 0.0},
        }

    def render(self) -> Any:
        picture = np.zeros((62, 98, 3), np.uint8)
        picture[:, int(48 + 100 * self.x)] = 255
        return picture

    def close(self) -> None:
        self.closed += 1


class Reach(CartPole):
    """A point on a line that has to get to another; its reward follows from the two."""

    def __init__(self, program: Program, render_mode: str | None = None) -> None:
        super().__init__(program, render_mode)
        one = gym.spaces.Box(-1, 1, (1,), np.float32)
        self.observation_space = gym.spaces.Dict(
            {"observation": one, "achieved_goal": one, "desired_goal": one}
        )
        self.action_space = gym.spaces.Box(-1, 1, (1,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place = 0.0
        self.goal = float(self.np_random.uniform(-1, 1))
        return self._seen(), self._info(None)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place = float(np.clip(self.place + 0.2 * action[0], -1, 1))
        self.steps += 1
        seen = self._seen()
        reward = float(self.compute_reward(seen["achieved_goal"], seen["desired_goal"], {}))
        cut = self.steps >= 10
        return (
            seen,
            reward,
            False,
            cut,
            self._info("max_steps" if cut else None) | {"is_success": reward == 0.0},
        )

    def _seen(self) -> dict[str, Any]:
        place = np.array([self.place], np.float32)
        return {
            "observation": place,
            "achieved_goal": place,
            "desired_goal": np.array([self.goal], np.float32),
        }

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        return -(np.abs(achieved - desired)[..., 0] > 0.1).astype(np.float32)


def build(program: Program, *, render_mode: str | None = None) -> CartPole:
    return CartPole(program, render_mode)


class Failing(CartPole):
    """Gives rewards that are not numbers after a while."""

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, _, terminated, truncated, info = super().step(action)
        if self.steps < 5:
            return observation, 1.0, terminated, truncated, info
        return (
            observation,
            math.nan,
            terminated,
            truncated,
            {**info, "reward_terms": {"alive": 1.0, "center": math.nan}},
        )


def altered(base: api.Compiled, policy: Mapping[str, Any] | None = None, **changes: Any) -> api.Compiled:
    """The task with changes, also of its `policy`, that no file says; a run of it would be loaded without
    them."""
    return replace(base, program=replace(base.program.with_agent(**policy or {}), **changes))


def tree_digest(folder: Path) -> str:
    """Over the names and bytes of all files in a folder."""
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        total.update(str(path.relative_to(folder)).encode() + (path.read_bytes() if path.is_file() else b""))
    return total.hexdigest()
