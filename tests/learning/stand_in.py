"""A small world to learn in: a cart-pole by its equations, and the compiled scenario that describes it.

It stands in for the generated supervisor, with the same observation, action, info and endings, at a few microseconds a step.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from deepbots_cli import canonical
from deepbots_cli.expressions.scalar import Const, Name
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Reset
from deepbots_cli.program.robots import MessageField, MessageLayout, Robot
from deepbots_cli.program.task import ActionRange, Choices, Ending, ObservedNumber, Option, Truncation
from deepbots_cli.program.training import Evaluation, Solved, Training
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import WorldModel

FALL = math.radians(15)
TRACK = 0.39


def scenario(
    *,
    training: Training | None = None,
    solved: Solved | None = None,
    continuous: bool = False,
    speed_range: float = 0.8,
    name: str = "Stand In",
    max_steps: int = 200,
) -> Program:
    """The task; `speed_range` is the range of the observed speed in m/s."""
    fields = (MessageField("pole_angle", "rad"),)
    robot = Robot(
        name="cart",
        sensors=(),
        actuators=(),
        receive=(),
        emit=(),
        apply=(),
        to_robot=MessageLayout("cart", "to_robot", (MessageField("drive", ""),), 1),
        from_robot=MessageLayout("cart", "from_robot", fields, 2),
    )
    drive = (
        ActionRange("drive", (), -1.0, 1.0, "")
        if continuous
        else Choices("drive", ("drive",), (Option("forward", (1.0,)), Option("backward", (-1.0,))))
    )
    return Program(
        name=name,
        summary="Keep a pole upright.",
        language=1,
        world=WorldModel(timestep=0.032, substeps=4),
        robots=(robot,),
        format="csv",
        timing="immediate",
        parameters=(),
        action=(drive,),
        signals=(),
        observation=(
            ObservedNumber("x", None, Name("x"), -0.4, 0.4, "m"),
            ObservedNumber("speed", None, Name("speed"), -speed_range, speed_range, "m/s"),
            ObservedNumber("cart.pole_angle", None, Name("cart.pole_angle"), -0.35, 0.35, "rad"),
            ObservedNumber("tip_speed", None, Name("tip_speed"), -2.0, 2.0, "m/s"),
        ),
        reward=(Expression("alive", Const(1.0)), Expression("centre", Const(0.0))),
        endings=(Ending("fallen", "failure", Const(False)), Ending("off_track", "failure", Const(False))),
        truncation=Truncation(max_steps=max_steps),
        reset=Reset(),
        solved=solved,
        training=training or Training("PPO", 1_000, environments=2),
        evaluation=Evaluation(20),
    )


@dataclass(frozen=True)
class CompiledStandIn:
    """What compiling would have given."""

    ir: Program
    code: str = "# generated\n"
    inputs: Mapping[str, bytes] = field(default_factory=lambda: {"stand_in.yaml": b"deepbots: 1\n", "../robots/cart.urdf": b"<robot/>\n"})
    resolved: str = "deepbots: 1\n"
    source: Path = Path("stand_in.yaml")
    allow_code: bool = False

    @property
    def digest(self) -> str:
        return canonical.digest(self.ir)


def compiled(**settings: Any) -> CompiledStandIn:
    return CompiledStandIn(scenario(**settings))


class CartPole(gym.Env[Any, Any]):
    """The cart follows its speed command within a tick; the pole is a uniform rod of 1 m on a moving hinge."""

    def __init__(self, ir: Program, render_mode: str | None = None) -> None:
        self.ir = ir
        self.render_mode = render_mode
        self.observation_space = gym.spaces.Box(-1, 1, (4,), np.float32)
        self.discrete = isinstance(ir.action[0], Choices)
        self.action_space = gym.spaces.Discrete(2) if self.discrete else gym.spaces.Box(-1, 1, (1,), np.float32)
        self.closed = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
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
        truncated = self.steps >= (self.ir.truncation.max_steps or 200)
        return self._observation(), 1.0, ended_by is not None, truncated, self._info(ended_by or ("max_steps" if truncated else None))

    def _observation(self) -> Any:
        tip = self.v + self.w
        raw = (self.x / 0.4, self.v / self.ir.observation[1].high, self.angle / 0.35, tip / 2.0)
        return np.clip(np.array(raw, np.float32), -1, 1)

    def _info(self, ended_by: str | None) -> dict[str, Any]:
        return {"is_success": ended_by == "max_steps", "ended_by": ended_by, "reward_terms": {"alive": 1.0, "centre": 0.0}}

    def render(self) -> Any:
        picture = np.zeros((62, 98, 3), np.uint8)
        picture[:, int(48 + 100 * self.x)] = 255
        return picture

    def close(self) -> None:
        self.closed += 1


def build(ir: Program, *, render_mode: str | None = None) -> CartPole:
    return CartPole(ir, render_mode)


class Failing(CartPole):
    """Gives rewards that are no numbers after a while."""

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, _, terminated, truncated, info = super().step(action)
        if self.steps < 5:
            return observation, 1.0, terminated, truncated, info
        return observation, math.nan, terminated, truncated, {**info, "reward_terms": {"alive": 1.0, "centre": math.nan}}


def altered(base: CompiledStandIn, **changes: Any) -> CompiledStandIn:
    return replace(base, ir=replace(base.ir, **changes))


def tree_digest(folder: Path) -> str:
    """Over the names and bytes of all files in a folder."""
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        total.update(str(path.relative_to(folder)).encode() + (path.read_bytes() if path.is_file() else b""))
    return total.hexdigest()
