"""Every shipped scenario lints clean and runs, however it is driven."""

from contextlib import closing

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.document import shipped
from tests.few import few


def drive(name: str, steps: int) -> None:
    """Random steps, with a reset at each ending; all that comes back is finite."""
    with closing(api.make(name)) as environment:
        environment.action_space.seed(0)
        environment.reset(seed=0)
        for _ in range(steps):
            observation, reward, terminated, truncated, _ = environment.step(
                environment.action_space.sample()
            )
            parts = observation.values() if isinstance(observation, dict) else [observation]
            assert all(np.isfinite(part).all() for part in parts)
            assert np.isfinite(reward)
            if terminated or truncated:
                environment.reset()


@pytest.mark.parametrize("name", shipped.scenario_names())
def test_a_shipped_scenario_has_no_findings(name: str) -> None:
    assert [f"{finding.span.location}: {finding.headline}" for finding in api.lint(name, preview=True)] == []


@pytest.mark.parametrize("name", few(shipped.scenario_names()))
def test_a_shipped_scenario_runs_under_random_actions(name: str) -> None:
    drive(name, 100)


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped.scenario_names())
def test_a_shipped_scenario_runs_for_long_under_random_actions(name: str) -> None:
    drive(name, 10_000)
