"""Scenarios by way of Gymnasium: `make`, `make_vec` and the `spec` of an environment."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.rollout.source import Source

ANY = "deepbots_cli.envs:deepbots/Scenario-v1"


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A scenario that does not come with deepbots."""
    text = (
        Source.open("cartpole")
        .path.read_text(encoding="utf-8")
        .replace("../robots/urdf/cartpole.urdf", "cartpole")
    )
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace("name: CartPole", "name: Mine"))
    return path


@pytest.fixture(autouse=True)
def _strict() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def first(env: Any) -> list[float]:
    """The observation that an episode of seed 1 begins with, after which the environment is closed."""
    observation, _ = env.reset(seed=1)
    env.close()
    return np.ravel(observation).tolist()


def test_a_scenario_of_ones_own_is_made_by_its_path(mine: Path) -> None:
    env = gymnasium.make(ANY, scenario=str(mine), overrides=["track=0.2m"], render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape[2] == 3
    assert env.unwrapped.scenario.name == "Mine"
    env.close()


def test_a_scenario_of_ones_own_begins_as_by_make(mine: Path) -> None:
    assert first(gymnasium.make(ANY, scenario=mine)) == first(api.make(mine))


def test_several_environments_of_a_scenario_of_ones_own_are_made_by_its_path(mine: Path) -> None:
    vector = gymnasium.make_vec(ANY, 2, vectorization_mode="sync", scenario=str(mine))
    assert vector.reset(seed=0)[0].shape[0] == 2
    vector.close()


def test_a_missing_scenario_is_an_error_that_shows_how() -> None:
    with pytest.raises(UsageError, match=r"needs a scenario: gymnasium\.make"):
        gymnasium.make(ANY)


@pytest.mark.parametrize("way", ["registered", "path", "compiled", "intermediate"])
def test_the_spec_of_an_environment_is_short_and_makes_it_again(mine: Path, way: str) -> None:
    compiled = api.compile(mine)
    env: Any = {
        "registered": lambda: gymnasium.make(ANY, scenario=str(mine)),
        "path": lambda: api.make(mine),
        "compiled": lambda: api.make(compiled),
        "intermediate": lambda: api.make(compiled.program),
    }[way]()
    assert len(repr(env.spec)) < 600
    again = gymnasium.make(env.spec)
    several = gymnasium.make_vec(env.spec, 1, vectorization_mode="sync")
    assert first(again) == first(several) == first(env)


def test_a_copy_in_another_process_has_the_fixed_parameters(mine: Path) -> None:
    env = api.make(mine)
    copy = pickle.loads(pickle.dumps(env))
    env.close()
    with pytest.raises(UsageError, match="'track': it is a fixed parameter"):
        copy.reset(options={"track": 0.2})
    copy.close()
