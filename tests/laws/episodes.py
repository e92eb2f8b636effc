"""Laws of episodes: what adds nothing changes nothing; one world is one of many; a reset world is a fresh one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from hypothesis import strategies as st

from deepbots_cli.runtime import Supervisor
from tests.laws.law import Case, law, same

STEPS = 12


def actions(environment: Any, seed: int) -> Iterator[Any]:
    """Yield random actions, the same for the same seed."""
    environment.action_space.seed(seed)
    while True:
        yield environment.action_space.sample()


def played(environment: Supervisor, seed: int, steps: int = STEPS) -> list[Any]:
    """Return what an episode with random actions shows: observations, rewards, ends, terms."""
    observation, info = environment.reset(seed=seed)
    shown: list[Any] = [observation, info["drawn"]]
    for _, action in zip(range(steps), actions(environment, seed), strict=False):
        observation, reward, terminated, truncated, info = environment.step(action)
        shown.append((observation, reward, terminated, truncated, info["reward_terms"], info["ended_by"]))
        if terminated or truncated:
            break
    return shown


@law(cost=60)
def nothing_raises(case: Case) -> None:
    """A scenario without findings at error level runs: nothing raises, and nothing is NaN."""
    with case.environment() as environment:
        for transition in played(environment, 0)[2:]:
            observation, reward, *_ = transition
            parts = observation.values() if isinstance(observation, dict) else [observation]
            assert all(np.isfinite(part).all() for part in parts)
            assert math.isfinite(reward)


@law(cost=90)
def a_reset_world_is_a_fresh_one(case: Case) -> None:
    """A reset clears everything that an episode leaves behind, so an episode does not depend on those before."""
    compiled = case.compile()
    with case.environment(compiled) as fresh, case.environment(compiled) as used:
        before = case.draw(st.integers(0, STEPS))
        played(used, 1, before)
        same(played(used, 4), played(fresh, 4))
