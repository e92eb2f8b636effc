"""An exported policy commands what the robots of the simulation apply, to 1e-5 of each command's range, in
every scenario that exports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from deepbots_cli.analysis.deployment import Deployment
from deepbots_cli.document import shipped
from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export.network import numbers_read
from deepbots_robot import Bundle
from tests.bundle.untrained import compare_with_simulation, untrained_bundle
from tests.few import few

DATA = Path(__file__).parents[1] / "data" / "scenarios"
FURTHER: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("rail", ()),
    ("rail", ("messages.format=none",)),
    ("rail", ("messages.timing=delayed",)),
    ("drawn", ()),
    ("pair", ()),
    ("pair", ("agent={action_repeat: 3}",)),
    ("../../world/hills", ()),
    ("drone", ()),
    ("sensed", ()),
    ("pushed", ()),
    ("../../bundle/readings", ()),
)
FAST = ("quadruped", "multi_cartpole", "see_ball", "find_and_avoid")
"""The law `a_bundle_commands_what_the_simulation_applies` has small worlds, without pictures and copies."""


@pytest.mark.parametrize("scenario", few(shipped.scenario_names(), FAST))
def test_a_bundle_commands_what_the_robots_of_the_simulation_apply(scenario):
    comparison = compare_with_simulation(scenario, steps=60)
    assert comparison.steps == 60
    assert comparison.worst <= 1e-5


@pytest.mark.parametrize("scenario", few(shipped.scenario_names(), FAST))
def test_lint_names_the_readings_that_nothing_on_a_robot_measures(scenario):
    """`DB617` asks for a supplier of each."""
    step, _, loaded = untrained_bundle(scenario)
    of_source = {
        source: {entry.name for entry in loaded.info.inputs if entry.source == source}
        for source in ("sensor", "supervisor", "goal")
    }
    deployment = Deployment(step.program)
    assert of_source["supervisor"] == {*deployment.unmeasured}
    assert of_source["goal"] == {*deployment.goals}


@pytest.mark.slow
@pytest.mark.parametrize("scenario", shipped.scenario_names())
def test_over_a_thousand_steps_too(scenario):
    comparison = compare_with_simulation(scenario, steps=1000)
    assert comparison.steps >= 900  # an episode is left where two options are equally good
    assert comparison.worst <= 1e-5


@pytest.mark.parametrize(
    ("scenario", "overrides"),
    [
        ("find_and_avoid", ["agent={action_repeat: 3, frame_stack: 2}"]),
        (
            "line_follower",
            [
                "agent={action_repeat: 4}",
                "observation.time=0 .. 60 s",
                "observation.step=0 .. 100",
                "train.algorithm=RecurrentPPO",
            ],
        ),
    ],
)
def test_what_advances_between_two_actions_does_so_in_a_bundle(scenario, overrides):
    """The bundle is called in every timestep. Between two actions it repeats its last commands."""
    step, _, loaded = untrained_bundle(scenario, *overrides)
    assert loaded.info.timestep_s == step.program.world.timestep
    comparison = compare_with_simulation(scenario, *overrides, steps=100)
    assert comparison.steps == 100
    assert comparison.worst <= 1e-5


def test_what_robots_and_messages_remember_advances_when_they_act():
    comparison = compare_with_simulation(str(Path(__file__).parent / "messages.yaml"), steps=60)
    assert comparison.steps == 60
    assert comparison.worst <= 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(("name", "overrides"), FURTHER)
def test_scenarios_of_other_tests_too(name, overrides):
    assert compare_with_simulation(str(DATA / f"{name}.yaml"), *overrides, steps=100).worst <= 1e-5


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        (
            ["messages.timing=delayed"],
            "`apply` of rover reads sensors or keeps values, and messages to it arrive late",
        ),
        (
            ["observation={previous_reward: -1 .. 1}"],
            "the policy sees 'previous_reward', but the reward is known only during training",
        ),
    ],
)
def test_a_scenario_that_cannot_be_exported_is_refused_by_name(overrides, named):
    with pytest.raises(UsageError) as caught:
        untrained_bundle("find_and_avoid", *overrides)
    assert named in str(caught.value)


@pytest.mark.parametrize(
    ("scenario", "unused"),
    [
        ("cartpole", {"position(cart)": {1, 2}, "velocity(cart)": {1, 2}, "velocity(cart.tip)": {1, 2}}),
        ("balancer", {"bot.accel": {1}, "bot.gyro": {0, 2}}),
    ],
)
def test_numbers_that_the_graph_does_not_read_change_nothing_and_all_others_do(
    scenario: str, unused: dict[str, set[int]]
) -> None:
    step, _, loaded = untrained_bundle(scenario)
    read = numbers_read(step.model({}))
    unread = {entry.name: {*range(entry.shape[0])} - read[entry.name] for entry in loaded.info.inputs}
    assert {name: places for name, places in unread.items() if places} == unused
    rng = np.random.default_rng(0)
    changed = {(entry.name, place): 0 for entry in loaded.info.inputs for place in range(entry.shape[0])}
    for _ in range(20):
        values = {entry.name: rng.normal(0.0, 0.1, entry.shape) for entry in loaded.info.inputs}
        wanted = results(loaded, values)
        for name, place in changed:
            moved = {key: value.copy() for key, value in values.items()}
            moved[name][place] += 0.05
            changed[name, place] += results(loaded, moved) != wanted
    assert {key for key, count in changed.items() if not count} == {
        (name, place) for name, places in unused.items() for place in places
    }


def results(loaded: Bundle, values: dict[str, Any]) -> list[bytes]:
    """All outputs of two steps with these values."""
    policy = loaded.start()
    return [value.tobytes() for _ in range(2) for value in policy.step(values).values()]
