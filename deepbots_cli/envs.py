"""The environments of Gymnasium by name: the shipped scenarios, and any other by its path.

    gymnasium.make("deepbots/CartPole-v1")
    gymnasium.make("deepbots/Scenario-v1", scenario="my.yaml", overrides=["fall_angle=10deg"])
    gymnasium.make_vec("deepbots/CartPole-v1", num_envs=256)

Importing this module registers them, and so does `import deepbots_cli`, once Gymnasium is imported. A scenario
limits its own episodes, so Gymnasium adds no time limit; the `spec` of an environment has the number of steps.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium

from deepbots_cli.errors import BatchError, UsageError

if TYPE_CHECKING:
    from deepbots_cli.runtime import Supervisor
    from deepbots_cli.runtime.batch import BatchEnvironment

NAMES = {
    "A1Rough": "quadruped_rough",
    "A1Velocity": "quadruped",
    "Balancer": "balancer",
    "BipedVelocity": "biped",
    "Carry": "carry",
    "CartPole": "cartpole",
    "CartPoleContinuous": "cartpole_continuous",
    "CartPoleLong": "cartpole_long",
    "CartPoleWireless": "cartpole_wireless",
    "FindAndAvoid": "find_and_avoid",
    "FindAndAvoidUnmasked": "find_and_avoid_unmasked",
    "FindBall": "find_ball",
    "FindBallAsPrinted": "find_ball_as_printed",
    "FindBallRandom": "find_ball_random",
    "Hover": "quadrotor",
    "LineFollower": "line_follower",
    "MultiCartPole": "multi_cartpole",
    "PandaPush": "panda_push",
    "PandaReach": "panda_reach",
    "PitEscape": "pit_escape",
    "PitEscapeAsPrinted": "pit_escape_as_printed",
    "SeeBall": "see_ball",
    "Sumo": "sumo",
    "Tag": "tag",
    "TagScripted": "tag_scripted",
}
"""The shipped scenarios by the names that they have in their files: these are not read when a program imports
Gymnasium."""


def make_scenario(scenario: str | Path | None = None, **options: Any) -> Supervisor:
    """Return the environment of `scenario`, a path or the name of a shipped scenario; `options` are the other
    arguments of `deepbots_cli.make`.

    Raises:
        UsageError: `scenario` is None; also the errors of `deepbots_cli.make`.
    """
    from deepbots_cli.api import make

    return make(_given(scenario), **options)


def make_batch(
    num_envs: int,
    scenario: str | Path | None = None,
    max_episode_steps: int | None = None,
    **options: Any,
) -> BatchEnvironment:
    """Return many worlds of `scenario` as one vector environment; `options` are the other arguments of
    `deepbots_cli.make_vec`.

    Args:
        max_episode_steps: The limit of a `spec`, which the scenario has already.

    Raises:
        UsageError: `scenario` is None, or `max_episode_steps` is not its limit; also the errors of
            `deepbots_cli.make_vec`.
    """
    from deepbots_cli.api import make_vec

    try:
        batch = make_vec(_given(scenario), num_envs, **options)
    except BatchError as error:
        raise BatchError(f'{error}; or write vectorization_mode="sync", for single worlds') from error
    if max_episode_steps not in (None, batch.max_episode_steps):
        batch.close()
        raise UsageError(
            "the worlds of a batch have the limit of their scenario; write"
            f' overrides=["truncation.max_steps={max_episode_steps}"], or vectorization_mode="sync"'
        )
    return batch


def _given(scenario: str | Path | None) -> str | Path:
    if scenario is None:
        raise UsageError(
            'deepbots/Scenario-v1 needs a scenario: gymnasium.make("deepbots/Scenario-v1", scenario="my.yaml")'
        )
    return scenario


for _name, _scenario in {"Scenario": None, **NAMES}.items():
    gymnasium.register(
        f"deepbots/{_name}-v1",
        entry_point="deepbots_cli.envs:make_scenario",
        vector_entry_point="deepbots_cli.envs:make_batch",
        kwargs={"scenario": _scenario},
    )
