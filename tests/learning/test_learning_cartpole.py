"""The shipped scenarios are learned as the results page says; minutes, so run by `make results`."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.learning import evaluate, train
from deepbots_cli.rollout.source import Source


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cartpole", "cartpole_continuous"])
def test_a_shipped_cartpole_is_solved_in_half_a_simulated_hour_and_balances_from_unseen_starts(
    name: str, tmp_path: Path
) -> None:
    result = train(api.compile(name), run=tmp_path / "run", seed=106)
    assert result.solved_at is not None
    assert result.solved_at.simulated_hours <= 0.5
    evaluation = evaluate(result.run, episodes=100)
    assert evaluation.solved
    assert evaluation.mean_return >= 199.0


@pytest.mark.slow
def test_a_pole_of_another_length_is_learned_from_a_copy_that_changes_one_line(tmp_path: Path) -> None:
    longer = tmp_path / "longer.yaml"
    shipped = Source.open("cartpole").path
    longer.write_text(
        f"deepbots: 1\nextends: {shipped}\nname: LongPole\nrobots: {{cart: {{links: {{pole: {{scale: 1 1"
        f" 1.5}}}}}}}}\n"
    )
    result = train(api.compile(longer), run=tmp_path / "run", seed=106)
    assert result.solved_at is not None
    assert evaluate(result.run, episodes=100).solved
