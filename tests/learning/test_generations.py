"""Windows over the episodes of worlds in lock step: what ends first does not count more."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from statistics import fmean

import numpy as np
import pytest

from deepbots_cli import compile
from deepbots_cli.learning.runs.curriculum import Curriculum, CurriculumState
from deepbots_cli.learning.runs.episodes import Statistics, StatisticsState
from deepbots_cli.learning.runs.generations import Generations
from deepbots_cli.program import Program
from deepbots_cli.rollout import Episode

WORLDS, FALL, SURVIVAL, TRUTH = 256, 20, 500, 0.74


def _endings(seed: int, worlds: int = WORLDS, steps: int = 4_000) -> Iterator[tuple[int, int, bool]]:
    """Step, world and success of episodes in lock step: 26 % fall after 20 steps, 74 % survive for 500
    steps."""
    generator = np.random.default_rng(seed)
    running: list[tuple[int, int, bool]] = []

    def begin(step: int, world: int) -> None:
        survives = bool(generator.random() < TRUTH)
        heapq.heappush(running, (step + (SURVIVAL if survives else FALL), world, survives))

    for world in range(worlds):
        begin(0, world)
    while running[0][0] <= steps:
        step, world, survives = heapq.heappop(running)
        yield step, world, survives
        begin(step, world)


def _staged(threshold: float, episodes: int) -> Program:
    until = f"success_rate >= {threshold:g} over {episodes} episodes"
    stages = f"[{{name: a, until: {until}}}, {{name: b}}]"
    return compile("pit_escape", overrides=[f"curriculum={stages}"]).program


def _episode(success: bool) -> Episode:
    return Episode(float(success), SURVIVAL if success else FALL, success, "end")


def test_falls_that_end_first_and_survivors_that_end_last_do_not_move_a_stage_on() -> None:
    newest: deque[bool] = deque(maxlen=100)
    rates = {}
    for step, _, survives in _endings(seed=0):
        newest.append(survives)
        if len(newest) == 100:
            rates.setdefault(fmean(newest), step)
    # The newest 100 episodes of all worlds pass every threshold at one step, while 74 % is true.
    assert rates[0.5] == rates[0.9] == rates[1.0] == SURVIVAL

    curriculum = Curriculum(_staged(0.9, 100), worlds=WORLDS)
    assert not any(
        curriculum.add(_episode(survives), step, 0, world) for step, world, survives in _endings(seed=0)
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_first_value_of_a_stage_is_that_of_a_whole_generation(seed: int) -> None:
    curriculum = Curriculum(_staged(1.0, 100), worlds=WORLDS)
    values = []
    for step, world, survives in _endings(seed):
        curriculum.add(_episode(survives), step, 0, world)
        values.append((step, curriculum.value(step)))
    first = next(step for step, value in values if value is not None)
    rates = {step: value for step, value in values if value is not None and step >= first}
    assert first >= SURVIVAL
    assert rates[first] == pytest.approx(TRUTH, abs=0.1)  # 3.6 standard errors
    assert fmean(rates.values()) == pytest.approx(TRUTH, abs=0.03)
    assert max(abs(value - TRUTH) for value in rates.values()) < 0.12


def test_the_recent_success_rate_of_a_training_does_not_depend_on_what_ends_first() -> None:
    statistics = Statistics(0.1, None, worlds=WORLDS)
    before = set()
    after = []
    for step, world, survives in _endings(seed=1):
        statistics.add(_episode(survives), world)
        if step < SURVIVAL:
            before.add(statistics.success_rate)
        else:
            after.append(statistics.success_rate)
    assert before == {None}  # only falls have ended
    rates = [rate for rate in after if rate is not None]
    assert min(rates) > 0.6
    assert fmean(rates) == pytest.approx(TRUTH, abs=0.03)


def test_with_one_world_a_window_has_the_newest_episodes() -> None:
    window = Generations[int](3)
    states = []
    for number in range(5):
        window.add(number)
        states.append((window.whole, window.is_full, window.newest(2)))
    assert states == [
        ([0], False, None),
        ([0, 1], False, [0, 1]),
        ([0, 1, 2], True, [1, 2]),
        ([1, 2, 3], True, [2, 3]),
        ([2, 3, 4], True, [3, 4]),
    ]


def test_a_window_has_as_many_episodes_of_each_world_and_at_least_so_many_in_all() -> None:
    window = Generations[str](5, worlds=3)
    for name in ("a1", "a2", "b1", "a3", "b2"):
        window.add(name, "abc".index(name[0]))
    assert window.whole == []
    assert window.is_full is False
    assert len(window.finished) == 4
    window.add("c1", 2)
    assert (sorted(window.whole), window.newest(1)) == (["a3", "b2", "c1"], ["a3", "b2", "c1"])
    assert window.newest(4) is None
    window.add("c2", 2)
    assert window.is_full
    assert sorted(window.whole) == ["a2", "a3", "b1", "b2", "c1", "c2"]


def test_the_copies_of_a_robot_end_together_and_belong_to_one_generation() -> None:
    window = Generations[int](3, worlds=2, copies=2)
    for world in (0, 0, 1):
        window.add(world, world)
    assert window.whole == []
    window.add(1, 1)
    assert sorted(window.whole) == [0, 0, 1, 1]
    assert window.is_full is True


def test_a_checkpoint_keeps_which_world_an_episode_was_in() -> None:
    program = _staged(0.9, 4)
    whole, again = (Curriculum(program, worlds=2) for _ in range(2))
    original, restored = (Statistics(0.1, None, worlds=2) for _ in range(2))
    first = [(0, False), (0, True), (1, True), (0, True)]
    for step, (world, success) in enumerate(first):
        whole.add(_episode(success), step, 0, world)
        original.add(_episode(success), world)
    again.restore(CurriculumState.model_validate_json(whole.state().model_dump_json()))
    restored.restore(StatisticsState.model_validate_json(original.state().model_dump_json()))
    assert (again.value(4), restored.success_rate) == (whole.value(4), original.success_rate) == (None, 1.0)
    assert again.add(_episode(True), 5, 0, 1) is whole.add(_episode(True), 5, 0, 1) is True
    assert restored.has_episodes(4)


def test_a_checkpoint_of_an_earlier_version_is_read() -> None:
    recent = [{"total_return": 3.0, "length": 5, "is_success": True, "ended_by": None}] * 2
    old = StatisticsState.model_validate(
        {
            "steps": 10,
            "episodes": 2,
            "cpu_seconds": 1.0,
            "solved_at": None,
            "recent": [Episode(**each) for each in recent],
        }
    )
    single, several = Statistics(0.1, None), Statistics(0.1, None, worlds=2)
    single.restore(old)
    several.restore(old)
    assert single.mean_return == 3.0
    assert several.mean_return is None  # it is not known which worlds they were in
    curriculum = Curriculum(_staged(0.9, 2))
    curriculum.restore(CurriculumState.model_validate({"ends": [], "first_step": 0, "recent": [1.0]}))
    assert curriculum.add(_episode(True), 20, 3)


def test_a_checkpoint_with_worlds_that_the_training_lacks_is_damaged() -> None:
    state = {"ends": [], "first_step": 0, "recent": [1.0], "worlds": [7]}
    with pytest.raises(ValueError, match="do not fit a training with 2 worlds"):
        Curriculum(_staged(0.9, 2), worlds=2).restore(CurriculumState.model_validate(state))
