"""Laws of episodes: what adds nothing changes nothing; one world is one of many; a reset world is a fresh one."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

import deepbots_cli
from deepbots_cli.codegen import batch_obstacles
from deepbots_cli.runtime import Supervisor
from tests.laws.expressions import chance
from tests.laws.law import Case, law, same
from tests.laws.scenarios import BODIES, Profile

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


@law(cost=150, profile=Profile(engines=("mujoco",), bodies=BODIES[:4]))
def one_world_is_one_of_many(case: Case) -> None:
    """A batch is a faster way to step single worlds, so each world has the episode of its seed."""
    compiled = case.compile()
    if batch_obstacles(compiled.program):
        reject()
    seeds = [7, 8, 9]
    with closing(deepbots_cli.make_vec(compiled, len(seeds))) as batch, ExitStack() as opened:
        singles = [opened.enter_context(case.environment(compiled, engine="mujoco")) for _ in seeds]
        together, _ = batch.reset(seed=seeds)
        for world, single in enumerate(singles):
            same(part_of(together, world), single.reset(seed=seeds[world])[0], f"world {world}, reset")
        for step in range(STEPS):
            chosen = [next(actions(single, 10 * step + world)) for world, single in enumerate(singles)]
            together, rewards, terminated, truncated, _ = batch.step(stacked(chosen))
            if terminated.any() or truncated.any():
                return
            for world, single in enumerate(singles):
                observation, reward, *ends, _ = single.step(chosen[world])
                place = f"world {world}, step {step}"
                same(part_of(together, world), observation, place)
                same(float(rewards[world]), float(np.asarray(reward, rewards.dtype)), f"{place}, reward")
                assert not any(ends), place


def stacked(actions: list[Any]) -> Any:
    """Return the actions of all worlds as one."""
    if isinstance(actions[0], dict):
        return {key: np.asarray([action[key] for action in actions]) for key in actions[0]}
    return np.asarray(actions)


def part_of(observation: Any, world: int) -> Any:
    if isinstance(observation, dict):
        return {key: value[world] for key, value in observation.items()}
    return observation[world]


@law(cost=90)
def what_adds_nothing_changes_nothing(case: Case) -> None:
    """A bias of 0, a latency of 0, a strength of 1 and a signal that nothing uses are what their absence is."""
    compiled = case.compile()
    data = copy.deepcopy(case.drawn.data)
    robots = data["robots"].values()
    additions = []
    for robot in robots:
        for sensor in robot.get("sensors", {}).values():
            if sensor["type"] not in ("camera", "touch"):
                additions += [(sensor, "bias", 0), (sensor, "noise", 0), (sensor, "resolution", 0)]
            additions += [(sensor, "latency", "0 ms"), (sensor, "period", data["world"]["timestep"])]
        for actuator in robot.get("actuators", {}).values():
            additions += [
                (actuator, "strength", 1),
                (actuator, "delay", "0 s"),
                (actuator, "time_constant", 0),
            ]
    messages = data.setdefault("messages", {})
    additions += [(data.setdefault("signals", {}), "unused", "time"), (messages, "timing", "immediate")]
    for section, key, value in additions:
        if key not in section and chance(case.draw, 50):
            section[key] = value
    changed = case.compile(case.write(data, "changed.yaml"))
    with case.environment(compiled) as before, case.environment(changed) as after:
        same(played(after, 3), played(before, 3))
