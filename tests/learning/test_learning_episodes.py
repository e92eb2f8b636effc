"""What is counted of episodes, and the intervals that are reported."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest

from deepbots_cli.errors import DeepbotsError
from deepbots_cli.learning.runs.episodes import EpisodeLog, Statistics, meets_solved
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout import Episode, EpisodeAccumulator


def test_a_solved_task_is_noted_with_the_time_of_the_training() -> None:
    statistics = Statistics(period=0.5, solved=Solved(3, mean_return=10.0))
    for total in (30.0, 40.0, 50.0):
        statistics.steps += 7_200
        statistics.add(Episode(total, 1, False, "end"))
    assert statistics.solved_at is None  # however high the returns of the training are
    statistics.note_solved(12.0, 0.0)
    assert statistics.solved_at is not None
    assert (statistics.solved_at.episode, statistics.solved_at.simulated_hours) == (3, 3.0)


def test_both_values_of_solved_must_be_reached() -> None:
    solved = Solved(1, mean_return=10.0, success_rate=1.0)
    assert not meets_solved(solved, 10.0, 0.0)
    assert not meets_solved(solved, 9.0, 1.0)
    assert meets_solved(solved, 10.0, 1.0)


def test_a_tally_sums_rewards_and_terms_and_starts_anew() -> None:
    tally = EpisodeAccumulator()
    for _ in range(3):
        tally.add(1.5, {"reward_terms": {"alive": 2.0, "cost": -0.5}})
    episode = tally.close({"is_success": True, "ended_by": "goal"})
    assert episode == Episode(4.5, 3, True, "goal", {"alive": 6.0, "cost": -1.5})
    tally.add(1.0, {})
    assert tally.close({}).total_return == 1.0


def test_a_reward_that_is_not_a_number_is_refused_with_the_term_at_fault() -> None:
    with pytest.raises(DeepbotsError, match=r"step 1 .*\(cost\)"):
        EpisodeAccumulator().add(math.nan, {"reward_terms": {"alive": 1.0, "cost": math.nan}})


def test_the_episode_file_is_appended_to_and_keeps_one_header(tmp_path: Path) -> None:
    path = tmp_path / "monitor.csv"
    statistics = Statistics(0.1, None)
    for _ in range(2):
        file = EpisodeLog(path, "Pole, long")
        file.open()
        statistics.add(Episode(1.0, 5, False, 'an "odd", name'))
        file.write(Episode(1.0, 5, False, 'an "odd", name'), statistics)
        file.close()
    lines = path.read_text().splitlines()
    assert lines[0].startswith("#{")
    rows = list(csv.DictReader(lines[1:]))
    assert [row["episode"] for row in rows] == ["1", "2"]
    assert rows[0]["ended_by"] == 'an "odd", name'
