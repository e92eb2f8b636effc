"""What every environment promises, whatever its scenario."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import closing
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasium_check
from rollout import actions, as_bytes, digest, episode, record
from stable_baselines3.common.env_checker import check_env as sb3_check

from deepbots_cli import api
from deepbots_cli.codegen import batch_obstacles, generate_module
from deepbots_cli.document import load, shipped
from deepbots_cli.envs import NAMES
from deepbots_cli.errors import BatchError, UsageError
from deepbots_cli.program import Program
from deepbots_cli.runtime import Supervisor
from tests.contract.conftest import Case
from tests.worlds import SCENARIOS

Make = Callable[..., Supervisor]
EXACT_FORMATS = ("struct", "json", "msgpack", "csv", "none")


@pytest.fixture(scope="session")
def rollouts(environment: Supervisor) -> list[list[Any]]:
    """Transitions of four random episodes, long enough that most come to their end."""
    return [list(episode(environment, seed, 250)) for seed in range(4)]


def parts(observation: Any) -> list[Any]:
    """The arrays of an observation. An observation with a goal or pictures has several."""
    return list(observation.values()) if isinstance(observation, dict) else [observation]


def numbers(observation: Any) -> Any:
    """The numbers that the scenario lists under `observation`; of a team, those of the first copy."""
    listed = observation["observation"] if isinstance(observation, dict) else observation
    return listed[0] if listed.ndim > 1 else listed


def agents(environment: Supervisor) -> list[Supervisor]:
    """The supervisors that score and send: the environment itself, of a team one for each copy."""
    return list(environment.agents.values())


def flat_bytes(observation: Any) -> bytes:
    return b"".join(part.tobytes() for part in parts(observation))


# What is printed for a batch of worlds


def test_a_batch_is_printed_or_refused_with_reasons(case: Case) -> None:
    if batch_obstacles(case.program):
        with pytest.raises(BatchError, match=f"{case.program.name} does not fit a batch: it "):
            generate_module(case.program, "batch")
    else:
        compile(generate_module(case.program, "batch"), "<batch>", "exec")


# The same seed gives the same bytes


@pytest.mark.parametrize(
    "lengths",
    [
        pytest.param((0, 1, 3, 53), id="few"),
        pytest.param((0, 1, 2, 3, 7, 19, 53), id="all", marks=pytest.mark.slow),
    ],
)
def test_a_reset_world_equals_a_fresh_one_whatever_came_before(
    environment: Supervisor, make: Make, lengths: tuple[int, ...]
) -> None:
    expected = record(make(), 2**31)
    for length in lengths:
        record(environment, length, length)
        assert record(environment, 2**31) == expected, f"after an episode of {length} steps"


def test_episodes_without_a_seed_follow_from_the_last_seed(environment: Supervisor, make: Make) -> None:
    assert digest(environment, 11) == digest(make(), 11)


def test_zero_is_a_seed_and_differs_from_others(environment: Supervisor) -> None:
    first = record(environment, 0, steps=10)
    assert first == record(environment, 0, steps=10) != record(environment, 1, steps=10)


def test_a_fresh_process_gives_the_same_bytes(cases: list[Any]) -> None:
    """One process for all cases, since a start costs half a second."""
    request = json.dumps([[case.source, case.overrides] for case in cases])
    program = [sys.executable, str(Path(__file__).with_name("rollout.py"))]
    answer = subprocess.run(program, input=request, capture_output=True, text=True, check=True, timeout=600)
    for case, elsewhere in zip(cases, json.loads(answer.stdout), strict=True):
        here = case.make()
        assert [digest(here, 0)] == elsewhere, str(case)
        here.close()


@pytest.mark.slow
@pytest.mark.parametrize("timing", ["immediate", "delayed"])
@pytest.mark.parametrize("name", ["cartpole", "rail", "drawn", "pair"])
def test_every_message_format_gives_the_same_bytes(name: str, timing: str) -> None:
    """`none` has no delay, so it takes part in immediate timing only."""
    data = SCENARIOS / f"{name}.yaml"
    engine, source = ("exact", str(data)) if data.exists() else ("pybullet", name)
    digests = {}
    for format in EXACT_FORMATS if timing == "immediate" else EXACT_FORMATS[:-1]:
        environment = api.make(
            source, overrides=[f"messages.format={format}", f"messages.timing={timing}"], engine=engine
        )
        digests[format] = digest(environment, 3)
        environment.close()
    assert len(set(digests.values())) == 1, digests


# Observations


def test_observations_stay_in_their_space(environment: Supervisor, rollouts: list[list[Any]]) -> None:
    for observation, *_ in (transition for transitions in rollouts for transition in transitions):
        assert all(part.dtype in (np.float32, np.uint8) for part in parts(observation))
        assert environment.observation_space.contains(observation)


def test_observations_share_no_memory(environment: Supervisor) -> None:
    kept = [part for observation, *_ in episode(environment, 1, 10) for part in parts(observation)]
    copies = [observation.copy() for observation in kept]
    assert not any(np.shares_memory(a, b) for index, a in enumerate(kept) for b in kept[:index])
    kept[-1][:] = 99
    assert all((part != 99).all() for part in parts(environment.get_observations())[-1:])
    for index in range(len(kept) - 1):
        np.testing.assert_array_equal(kept[index], copies[index])


def constant(scenario: Program, rollouts: list[list[Any]]) -> set[str]:
    """The numbers of the observation that never change; a bumper may well touch nothing in so short a
    time."""
    rows = np.array([numbers(observation) for transitions in rollouts for observation, *_ in transitions])
    entries = scenario.agent.inputs
    spreads = np.ptp(rows, axis=0).reshape(-1, len(entries)).max(axis=0)
    return {
        entry.name
        for entry, spread in zip(entries, spreads, strict=True)
        if spread == 0.0 and not entry.truth
    }


def test_no_observation_is_constant(environment: Supervisor, rollouts: list[list[Any]]) -> None:
    """Under random actions, or under a script of the scenario: one whose world shows itself to skill alone
    has to name such a script."""
    scenario = environment.scenario
    still = constant(environment.scenario, rollouts)
    for script in scenario.agent.scripts if still else ():
        still &= constant(scenario, [list(episode(environment, seed, 250, script.name)) for seed in range(2)])
    assert still == set()


def test_scripts_give_actions_of_the_space_and_the_same_bytes_again(
    environment: Supervisor, make: Make
) -> None:
    fresh = make()
    for script in environment.scenario.agent.scripts:
        transitions = [
            [as_bytes(step) for step in episode(world, 5, 60, script.name)] for world in (environment, fresh)
        ]
        assert transitions[0] == transitions[1]
        assert environment.action_space.contains(environment.script(script.name))


def test_episodes_begin_differently(environment: Supervisor) -> None:
    """The first steps show it. The reset alone does not: an inertial sensor, for example, does not depend on
    the place."""

    def next_episode() -> bytes:
        environment.reset()
        return b"".join(
            as_bytes(environment.step(action))
            for _, action in zip(range(4), actions(environment, 0), strict=False)
        )

    assert len({b"".join(record(environment, seed, steps=4)) for seed in range(8)}) == 8
    assert len({next_episode() for _ in range(8)}) == 8


# Steps


def test_an_episode_ends_for_one_reason(environment: Supervisor, rollouts: list[list[Any]]) -> None:
    reasons = {ending.name for ending in environment.scenario.endings} | {"max_steps", "max_time"}
    for _, reward, terminated, truncated, info in (
        transition for transitions in rollouts for transition in transitions
    ):
        assert type(reward) is float
        assert type(terminated) is bool
        assert type(truncated) is bool
        assert not (terminated and truncated)
        assert set(info) - {"action_mask"} - ({"each"} if environment.scenario.agent.copies else set()) == {
            "is_success",
            "ended_by",
            "endings",
            "reward_terms",
        }
        assert (info["ended_by"] in reasons) if terminated or truncated else (info["ended_by"] is None)
        assert (
            not info["is_success"]
            or terminated
            or (truncated and environment.scenario.agent.goal is not None)
        )
        assert list(info["reward_terms"]) == [term.name for term in environment.scenario.agent.reward]


def test_the_reward_is_the_sum_of_its_terms(rollouts: list[list[Any]]) -> None:
    for _, reward, _, _, info in (transition for transitions in rollouts for transition in transitions):
        assert reward == pytest.approx(sum(info["reward_terms"].values()), abs=1e-12)


def test_the_papers_methods_only_read(environment: Supervisor, make: Make) -> None:
    expected = record(make(), 6, steps=20)
    transitions = []
    for transition in episode(environment, 6, 20):
        for _ in range(2):
            for agent, robot in product(agents(environment), environment.scenario.robots):
                agent.controllers[robot.name].create_message()
            again = (
                environment.get_observations(),
                environment.get_reward(),
                *environment.is_done(),
                environment.get_info(),
            )
            assert str(again) == str(transition)
        transitions.append(transition)
    assert len(transitions) == len(expected)
    assert record(environment, 6, steps=20) == expected


def test_channels_never_fill_up(environment: Supervisor) -> None:
    """At most those that were sent within the latency, of at most 110 ms in these scenarios, are under
    way."""
    list(episode(environment, 2, 60))
    for agent, robot in product(agents(environment), environment.scenario.robots):
        for route, way in ((robot.to_route, f"to_{robot.name}"), (robot.from_route, f"from_{robot.name}")):
            assert len(getattr(agent, way)) <= (1 if route.perfect else 6)


# Wrong use


def test_a_step_before_the_first_reset_is_refused(make: Make) -> None:
    environment = make()
    with pytest.raises(UsageError, match=r"call reset\(\)"):
        environment.step(environment.action_space.sample())


def test_a_closed_environment_refuses_to_go_on(make: Make) -> None:
    environment = make()
    environment.reset(seed=0)
    environment.close()
    environment.close()
    for use in (lambda: environment.step(environment.action_space.sample()), environment.reset):
        with pytest.raises(UsageError, match="closed"):
            use()


BAD_FOR_ALL = [
    None,
    float("nan"),
    "forward",
    [],
    {},
    np.zeros((2, 2, 2)),
    np.full(11, 0),
    object(),
    [[1], [1, 2]],
    1 + 2j,
]
BAD_FOR_DISCRETE = [-1, 98, 99, 1.5, np.int64(-1), np.array(98), np.array([0])]
BAD_FOR_BOX = [
    np.array([np.nan], np.float32),
    np.array([[0.5]]),
    np.full(99, 0.5),
    0.5,
    np.array(0.5),
    [float("inf")],
    np.array([1j]),
]
BAD_FOR_MULTI_DISCRETE = [
    np.array([0]),
    np.array([0, 0, 0]),
    [0, 2],
    [-1, 0],
    [0.5, 0],
    np.array(0),
    0,
    [0, [1]],
]


def test_a_bad_action_is_refused_in_words_and_changes_nothing(environment: Supervisor) -> None:
    extra = {"Discrete": BAD_FOR_DISCRETE, "Box": BAD_FOR_BOX, "MultiDiscrete": BAD_FOR_MULTI_DISCRETE}[
        type(environment.action_space).__name__
    ]
    expected = record(environment, 8, steps=10)
    environment.reset(seed=8)
    for bad in (*BAD_FOR_ALL, *extra):
        with pytest.raises(UsageError, match=r"^action .* does not fit "):
            environment.step(bad)
    transitions = [
        as_bytes(environment.step(action))
        for _, action in zip(expected[1:], actions(environment, 8), strict=False)
    ]
    assert transitions == expected[1:]


def test_an_action_may_come_in_every_usual_form(environment: Supervisor) -> None:
    """As a number of numpy or Python, as an array, as a list: Stable-Baselines3 predicts a choice as an array
    without axes."""
    action = next(actions(environment, 3))
    observations = set()
    for form in (action, np.asarray(action), np.asarray(action).tolist()):
        environment.reset(seed=3)
        observations.add(flat_bytes(environment.step(form)[0]))
    assert len(observations) == 1


# Gymnasium and Stable-Baselines3


@pytest.mark.every_scenario
def test_gymnasiums_checker_has_nothing_to_say(make: Make) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium_check(make(), skip_render_check=True)


def test_gymnasiums_checker_has_nothing_to_say_of_pictures() -> None:
    with warnings.catch_warnings(), closing(api.make("cartpole", render_mode="rgb_array")) as environment:
        warnings.simplefilter("error")
        gymnasium_check(environment)


@pytest.mark.every_scenario
def test_stable_baselines_checker_has_nothing_to_say(make: Make) -> None:
    environment = make()
    if environment.scenario.agent.copies:
        pytest.skip("a policy sees each copy of a team by itself, never the team")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sb3_check(environment, warn=True)


def test_an_environment_can_be_pickled(environment: Supervisor) -> None:
    copy = pickle.loads(pickle.dumps(environment))
    assert copy.metadata == environment.metadata
    assert digest(copy, 1) == digest(environment, 1)
    copy.close()


def test_a_picture_is_taken_and_changes_nothing(make: Make) -> None:
    environment = make("rgb_array")
    first = record(environment, 1, steps=3)
    picture = environment.render()
    assert picture.dtype == np.uint8
    assert picture.ndim == 3
    assert picture.shape[2] == 3
    assert picture.std() > 1.0
    assert record(environment, 1, steps=3) == first


def test_an_unknown_render_mode_is_refused(case: Any) -> None:
    with pytest.raises(UsageError, match="for a window, wrap the environment"):
        case.make("human")


def test_every_shipped_scenario_is_registered_with_gymnasium() -> None:
    names = {
        short: load(shipped.SCENARIOS.path(short)).root.get("name").text for short in shipped.scenario_names()
    }
    assert names == {short: name for name, short in NAMES.items()}
    assert {f"deepbots/{name}-v1" for name in NAMES} <= set(gymnasium.registry)


@pytest.mark.parametrize("name", ["CartPole", "PandaReach", "SeeBall"])
def test_a_registered_scenario_is_made_and_steps(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        environment = gymnasium.make(f"deepbots/{name}-v1")
        assert environment.spec is not None
        assert environment.spec.max_episode_steps == gymnasium.make(environment.spec).spec.max_episode_steps
        environment.reset(seed=0)
        environment.step(environment.action_space.sample())
        environment.close()


def test_a_step_after_the_end_needs_a_reset() -> None:
    environment = gymnasium.make("deepbots/CartPole-v1")
    environment.reset(seed=0)
    while not any(environment.step(0)[2:4]):
        pass
    with pytest.raises(gymnasium.error.ResetNeeded, match="the episode has ended"):
        environment.step(0)
    environment.close()


def test_gymnasium_makes_a_batch_that_knows_the_limit_of_its_episodes() -> None:
    with pytest.raises(UsageError, match=r"truncation\.max_steps=5"):
        gymnasium.make_vec("deepbots/CartPole-v1", 3, "vector_entry_point", max_episode_steps=5)
    vector = gymnasium.make_vec("deepbots/CartPole-v1", 3, "vector_entry_point", max_episode_steps=200)
    assert (
        vector.reset(seed=0)[0].shape,
        vector.spec and vector.spec.max_episode_steps,
    ) == ((3, 4), 200)
    vector.close()


@pytest.mark.parametrize("order", ["deepbots_cli, gymnasium", "gymnasium, deepbots_cli"])
def test_importing_deepbots_registers_its_scenarios_in_either_order(order: str) -> None:
    subprocess.run(
        [sys.executable, "-c", f"import {order}; gymnasium.spec('deepbots/CartPole-v1')"], check=True
    )
