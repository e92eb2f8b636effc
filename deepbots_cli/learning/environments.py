"""Creates the worlds of a training or an evaluation: one by one, or as a batch."""

from __future__ import annotations

from functools import partial
from typing import Any, Protocol

import gymnasium as gym

from deepbots_cli import api, engines
from deepbots_cli.codegen import batch_obstacles
from deepbots_cli.document import Permissions
from deepbots_cli.program import Program

MIN_WORLDS = 8
"""The number of worlds, or of copies of a robot in all worlds, from which a batch is faster.

The array operations of a batch take as long per step as 5 single worlds.
"""


class WorldFactory(Protocol):
    """Makes the world of a compiled scenario; `render_mode` as in Gymnasium."""

    def __call__(self, program: Program, *, render_mode: str | None = None) -> gym.Env[Any, Any]: ...


def supervisor_factory(engine: str, *, permissions: Permissions = Permissions()) -> WorldFactory:
    """Build the generated supervisor on `engine`. Terms in Python run with the permission `code`."""
    return partial(api.build, engine=engine, permissions=permissions)


def reasons_against_batch(program: Program, worlds: int, engine: str, build: WorldFactory) -> list[str]:
    """Return the reasons why a training steps its worlds one by one; empty if it steps them as a batch."""
    if engine not in engines.BATCHES:
        return [f"the engine '{engine}' has no batches"]
    if _rows(program, worlds) < MIN_WORLDS:
        return [f"there are fewer than {MIN_WORLDS} worlds"]
    training = program.agent.training
    if training is not None and training.teacher is not None:
        return ["a script reads what only a single world computes"]
    reasons = [] if getattr(build, "func", None) is api.build else ["the argument `build` makes its worlds"]
    variants = [program, *(stage.program for stage in program.curriculum)]
    return list(
        dict.fromkeys(
            [*reasons, *(reason for variant in variants for reason in batch_obstacles(variant.with_critic))]
        )
    )


def _rows(program: Program, worlds: int) -> int:
    copies = program.agent.copies
    return worlds * (copies.count if copies else 1)


def stepping_text(program: Program, worlds: int, engine: str, build: WorldFactory) -> str:
    """Return a note on whether a training steps its worlds as a batch, and why not; empty if no batch is to
    be expected."""
    if engine not in engines.BATCHES or _rows(program, worlds) < MIN_WORLDS:
        return ""
    reasons = reasons_against_batch(program, worlds, engine, build)
    how = f"one by one: {'; '.join(reasons)}" if reasons else "together, as a batch"
    return f"{program.name} steps its {worlds} worlds {how}"
