"""Laws of episodes: a reset world is a fresh one, one world is one of many, and what adds nothing changes
nothing."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.codegen import batch_obstacles
from deepbots_cli.errors import ScenarioError
from deepbots_cli.program import generated
from deepbots_cli.runtime import Supervisor
from tests.laws.expressions import chance
from tests.laws.law import Case, law, reference, same
from tests.laws.scenarios import ALONE, Profile

STEPS = 12
SEEDS = (7, 8, 9)
ROUNDED = ("contact_force_vector", "angular_momentum", "reaction_force", "reaction_torque")
"""Readings of a batch that are equal but for the last digits."""


def actions(environment: Any, seed: int) -> Iterator[Any]:
    """Yield random actions, the same for the same seed."""
    environment.action_space.seed(seed)
    while True:
        yield environment.action_space.sample()


def played(environment: Supervisor, seed: int, steps: int = STEPS, options: Any = None) -> list[Any]:
    """Return what an episode with random actions shows: observations, rewards, ends, terms."""
    observation, info = environment.reset(seed=seed, options=options)
    shown: list[Any] = [observation, info["drawn"]]
    for _, action in zip(range(steps), actions(environment, seed), strict=False):
        observation, reward, terminated, truncated, info = environment.step(action)
        shown.append((observation, reward, terminated, truncated, info["reward_terms"], info["ended_by"]))
        if terminated or truncated:
            break
    return shown


@law(cost=60)
def nothing_raises(case: Case) -> None:
    """A scenario without findings at error level runs: nothing is NaN, and nothing raises but what only a
    simulation shows (`reference`). `lint` raises nothing, whatever it finds."""
    if any(finding.severity == "error" for finding in api.lint(case.path, overrides=case.overrides)):
        reject()
    with case.environment() as environment:
        with reference():
            shown = played(environment, 0)
        for observation, reward, *_ in shown[2:]:
            parts = observation.values() if isinstance(observation, dict) else [observation]
            assert all(np.isfinite(part).all() for part in parts)
            assert math.isfinite(reward)


@law(cost=90)
def a_reset_world_is_a_fresh_one(case: Case) -> None:
    """A reset clears everything that an episode leaves, so an episode does not depend on those before."""
    compiled = case.compile()
    with case.environment(compiled) as fresh, case.environment(compiled) as used:
        with reference():
            expected = played(fresh, 4)
            played(used, case.draw(st.sampled_from((1, 4))), case.draw(st.integers(0, STEPS)))
        same(played(used, 4), expected)


@law(cost=120)
def a_start_is_set_by_its_draws(case: Case) -> None:
    """`info["drawn"]` has what a start drew, and `options` of a reset set these values, whatever the seed. With
    the same seed, too, the whole episode is the same."""
    with case.environment() as environment:
        with reference():
            expected = played(environment, 3)
        drawn = expected[1] or reject()
        with reference():
            assert environment.reset(seed=5, options=drawn)[1]["drawn"] == drawn
        same(played(environment, 3, options=drawn), expected)


@law(cost=110)
def a_push_changes_nothing_before_it(case: Case) -> None:
    """A push acts from its time on, which counts from the first observation: the episode up to then is that
    without it, also where bodies settle at the start."""
    data = copy.deepcopy(case.drawn.data)
    data.pop("disturbances", None)
    if chance(case.draw, 70):
        data.setdefault("reset", {})["settle"] = f"4 * ({data['world']['timestep']})"
    data["world"]["substeps"] = case.draw(st.integers(1, 4))
    steps = case.draw(st.integers(1, 5))
    movable = [name for name, robot in data["robots"].items() if robot.get("base") != "fixed"]
    body, kind = (movable or reject())[0], case.draw(st.sampled_from(("force", "torque")))
    push = {kind: f"0.3 0.2 0.1 {'N' if kind == 'force' else 'N*m'}", "duration": "1 s"}
    try:
        before = case.compile(case.write(data, "before.yaml"))
        period = before.program.world.timestep * before.program.action_repeat
        push |= {"body": body, "at": f"{steps * period:.9g} s"}
        after = case.compile(case.write(data | {"disturbances": {"late": push}}, "after.yaml"))
    except ScenarioError:
        reject()
    with case.environment(before) as without, case.environment(after) as pushed:
        with reference():
            expected = played(without, 3, steps)
        same(played(pushed, 3, steps), expected)


@law(cost=300, profile=Profile(engines=("mujoco",)))
def one_world_is_one_of_many(case: Case) -> None:
    """A batch is a faster way to step single worlds, so each world has the episodes of its seed, to the bit.

    docs/engines.md names the readings that are equal but for the last digits, and the number of contacts
    whose forces a batch can read.
    """
    case.compile()
    compiled = case.compile(case.write(with_ages(case.drawn.data), "ages.yaml"))
    if batch_obstacles(compiled.program) or any(name in case.drawn.text for name in ROUNDED):
        reject()
    episodes = []
    for seed in SEEDS:
        with case.environment(compiled, engine="mujoco") as single, reference():
            # A single world looks for impossible speeds in every 15th step, a batch in every step.
            episodes.append(steps_of(single, seed, STEPS + 15))
    with closing(deepbots_cli.make_vec(compiled, len(SEEDS))) as batch, warnings.catch_warnings():
        # A batch resets a world that cannot go on, and warns; no single world met a problem.
        warnings.simplefilter("error", RuntimeWarning)
        together, _ = batch.reset(seed=list(SEEDS))
        for world, steps in enumerate(episodes):
            same(part_of(together, world), steps[0].observation, f"world {world}, reset")
        for number in range(1, STEPS + 1):
            expected = [steps[number] for steps in episodes]
            # The speed of a joint may be impossible between two checks of a single world.
            with reference("but a batch supports at most", "which no motor and no fall"):
                together, rewards, *ends, info = batch.step(stacked([step.action for step in expected]))
            for world, step in enumerate(expected):
                place = f"world {world}, step {number}"
                same([bool(end[world]) for end in ends], list(step.ends), f"{place}, ends")
                same(float(rewards[world]), float(np.asarray(step.reward, rewards.dtype)), f"{place}, reward")
                same(part_of(together, world), step.shown, place)
                if any(step.ends):
                    same(part_of(info["final_obs"], world), step.observation, f"{place}, last observation")


def with_ages(data: dict[str, Any]) -> dict[str, Any]:
    """Return a scenario of one agent whose policy sees the ages of all readings that robots send."""
    data = copy.deepcopy(data)
    sent = [
        f"{name}.{sensor}"
        for name, robot in data["robots"].items()
        for sensor in robot.get("sensors", {})
        if sensor in robot.get("emit", ()) and "count" not in robot
    ]
    augment = data.get("augment", {})
    is_sending = data.get("messages", {}).get("format") != "none"
    if sent and is_sending and isinstance(augment, dict) and "agents" not in data:
        ages = {f"age{number}": f"age({name})" for number, name in enumerate(sent)}
        data["augment"] = augment | ages
        data["observation"] |= dict.fromkeys(ages, "0 .. 1 s")
    return data


class Played(NamedTuple):
    """One step, or the reset with the action None; `shown` is the observation, or the first one of the next
    episode."""

    action: Any
    observation: Any
    reward: float
    ends: tuple[bool, bool]
    shown: Any


def steps_of(environment: Supervisor, seed: int, count: int) -> list[Played]:
    """Return the reset and `count` steps with random actions, in one episode after the other."""
    first, _ = environment.reset(seed=seed)
    steps = [Played(None, first, 0.0, (False, False), first)]
    for _, action in zip(range(count), actions(environment, seed), strict=False):
        observation, reward, *ends, _ = environment.step(action)
        shown = environment.reset()[0] if any(ends) else observation
        steps.append(Played(action, observation, reward, (ends[0], ends[1]), shown))
    return steps


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
    """A bias of 0, a latency of 0, a strength of 1, and a signal that nothing uses, are as good as absent."""
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
        with reference():
            expected = played(before, 3)
        same(played(after, 3), expected)


@law(cost=120, profile=replace(ALONE, agents=1))
def a_name_has_the_value_of_its_definition(case: Case) -> None:
    """A name stands for its definition, so both have one value in every step; each draw is another one."""
    case.compile()
    data = copy.deepcopy(case.drawn.data)
    again = case.draw(st.sampled_from(("each step", "every 0.1 s")))
    redrawn = {"lasting": f"uniform(1 .. 2) {again}", "double": "lasting * 2", "both": "double + lasting"}
    data["parameters"] = data.get("parameters", {}) | redrawn
    program = case.compile(case.write(data, "redrawn.yaml")).program
    types = {value.name: value.typed.type for value in (*program.parameters, *program.signals)}
    signals = data.setdefault("signals", {})
    names: list[str] = []
    for section in ("parameters", "signals"):
        for name, text in [*data.get(section, {}).items()]:
            if isinstance(text, str) and not any(word in text for word in DRAWS) and name in types:
                names.append(f"gap{len(names)}")
                condition = types[name].boolean
                signals[names[-1]] = f"({name}) != ({text})" if condition else f"({name}) - ({text})"
    changed = case.compile(case.write(data, "changed.yaml"))
    watched = replace(changed.program, stored_signals=frozenset(names))
    with closing(api.make(watched)) as environment, reference():
        environment.reset(seed=3)
        for _, action in zip(range(STEPS), actions(environment, 3), strict=False):
            for name in names:
                gap = np.asarray(getattr(environment, generated.last(name)), float)
                # Infinite values have no difference.
                assert not np.nan_to_num(gap).any(), (name, signals[name], gap)
            _, _, terminated, truncated, _ = environment.step(action)
            if terminated or truncated:
                break


DRAWS = ("uniform(", "normal(", "choice(", "integer(")
