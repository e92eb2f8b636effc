"""Episodes as a stream of steps."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli.errors import UsageError
from deepbots_cli.rollout import Driver, Start, play, result_of, steps
from deepbots_cli.rollout.drivers import named_driver, random_driver, sequence_driver
from deepbots_cli.rollout.episode import Step, random_state

PACKAGE = Path(deepbots_cli.__file__).parent
STEPPING = {
    *("rollout/episode.py", "rollout/worlds.py", "rollout/batch_worlds.py"),
    "insight/speed.py",  # a benchmark
}


def _stepping(path: Path) -> Iterator[int]:
    """Lines that step an environment: calls of `step` with an action, or of `advance`, which a wrapper does
    not pass on."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            wrapped = ast.unparse(node.func.value) in ("self.env", "super()")
            arguments = len(node.args) + any(keyword.arg == "action" for keyword in node.keywords)
            if (node.func.attr == "step" and arguments == 1 and not wrapped) or node.func.attr == "advance":
                yield node.lineno


@pytest.mark.slow
def test_an_environment_is_stepped_in_few_places() -> None:
    """Each place that steps an environment needs its own rules for the start and end of an episode and for
    the driver."""
    modules = {
        name
        for path in PACKAGE.rglob("*.py")
        if (name := path.relative_to(PACKAGE).as_posix()).partition("/")[0]
        not in ("runtime", "engines", "codegen")
        and any(_stepping(path))
    }
    assert modules == STEPPING


def test_steps_are_those_of_gymnasium() -> None:
    with closing(deepbots_cli.make("cartpole")) as plain, closing(deepbots_cli.make("cartpole")) as driven:
        observation, _ = plain.reset(seed=3)
        returned = 0.0
        for step in steps(driven, random_driver(driven), Start(3)):
            if step.number:
                observation, reward, terminated, truncated, _ = plain.step(plain.action_space.sample())
                returned += float(reward)
                assert (step.reward, step.is_last) == (reward, terminated or truncated)
            assert np.array_equal(step.observation, observation)
        episode = play(driven, random_driver(driven), Start(3))
        assert (episode.length, episode.total_return, episode.seed) == (step.number, returned, 3)


def test_an_episode_may_be_cut_and_begin_from_the_state_of_its_generators() -> None:
    with closing(deepbots_cli.make("cartpole")) as world:
        world.reset(seed=1)
        state = random_state(world)

        def cut() -> Iterator[Step]:
            return islice(steps(world, named_driver(world, "zero"), Start(state=state)), 4)

        episode = result_of(cut())
        assert episode.length == 3
        assert episode.ended_by is None
        assert episode.seed is None
        observations = [[step.observation.tolist() for step in cut()] for _ in range(2)]
        assert observations[0] == observations[1]


def test_a_driver_receives_the_number_of_the_episode_that_begins() -> None:
    begun = []

    class Noting(Driver):
        def begin(self, start: Start) -> None:
            begun.append(start)

    with closing(deepbots_cli.make("cartpole")) as world:
        start = Start.of_evaluation(5, 2)
        play(world, Noting(lambda _: 0), start)
    assert begun == [start]
    assert start.number == 2


def test_repeated_actions_begin_with_the_first_in_each_episode() -> None:
    with closing(deepbots_cli.make("cartpole")) as world:
        driver = named_driver(world, "forward * 3, backward*40")
        for _ in range(2):
            cut = islice(steps(world, driver, Start(0)), 1, 5)
            assert [step.action for step in cut] == [0, 0, 0, 1]


def test_an_episode_that_goes_on_after_the_last_action_is_an_error() -> None:
    with (
        closing(deepbots_cli.make("cartpole")) as world,
        pytest.raises(UsageError, match="did not end with the last of the given actions"),
    ):
        play(world, sequence_driver([0, 1]), Start(0))
