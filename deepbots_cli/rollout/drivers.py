"""Drivers that need no policy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from deepbots_cli.errors import UsageError
from deepbots_cli.program.task import Choices
from deepbots_cli.rollout.episode import Driver

if TYPE_CHECKING:
    import gymnasium as gym

    from deepbots_cli.runtime import Supervisor

RANDOM, ZERO, HAND, POLICY, RECORDED = "random", "zero", "you", "policy", "recording"
"""Names of drivers besides the scripts of a scenario. `zero` is the middle of each range and the first option of each choice."""


def named_driver(world: gym.Env[Any, Any], name: str) -> Driver:
    """`random`, `zero`, or a script of the scenario.

    Raises:
        UsageError: There is no such script.
    """
    if name == RANDOM:
        return random_driver(world)
    if name == ZERO:
        return constant_driver(zero_action(world.action_space))
    world.get_wrapper_attr("scenario").script(name)
    act = partial(world.get_wrapper_attr("script"), name)
    return Driver(lambda _: act())


def random_driver(world: gym.Env[Any, Any]) -> Driver:
    """Random actions; the reset seeds the action space."""
    sample = world.action_space.sample
    return Driver(lambda _: sample())


def constant_driver(action: Any) -> Driver:
    """The same action in every step."""
    return Driver(lambda _: action)


def sequence_driver(actions: Iterable[Any]) -> Driver:
    """Actions in their order, one in each step.

    Raises:
        UsageError: From `act`, when no action is left.
    """
    following = iter(actions)

    def act(_: Any) -> Any:
        for action in following:
            return action
        raise UsageError("the episode goes on after the last action")

    return Driver(act)


def zero_action(space: gym.Space[Any]) -> Any:
    """The middle of every range, and the first option of every choice."""
    import gymnasium as gym  # here, since the module of a command is imported without a simulator too
    import numpy as np

    if isinstance(space, gym.spaces.Dict):
        return {key: zero_action(part) for key, part in space.spaces.items()}
    return np.int64(0) if isinstance(space, gym.spaces.Discrete) else np.zeros(space.shape or (), space.dtype)


def action_from_values(env: Supervisor, values: Mapping[str, float]) -> Any:
    """The action with these values by the names of action fields: the index of an option, or a number from -1 to 1; others are 0."""
    choices, ranges = [], []
    for part in env.scenario.agent.action:
        if isinstance(part, Choices):
            choices.append(int(values.get(part.name, 0)))
        else:
            ranges += [float(values.get(name, 0.0)) for name in part.names]
    return env.make_action(choices, ranges)
