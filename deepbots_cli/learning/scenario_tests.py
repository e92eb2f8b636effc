"""Runs the `tests` of scenarios: episodes of a script, of random or zero actions, or of a sequence of
actions, against expected results.

Episode k of a test starts as episode k of an evaluation with the seed of the test does, so `deepbots view
--seed S --episode K` shows it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import field, replace
from itertools import groupby, islice
from statistics import fmean
from typing import TYPE_CHECKING, Literal

from deepbots_cli import api
from deepbots_cli.analysis.ranges import with_unit
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.program import Program
from deepbots_cli.program.task import ExpectedKey, ExpectedResult, ScenarioTest
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode, Start, Step, result_of, steps
from deepbots_cli.rollout.drivers import AgentsDriver, named_driver, sequence_driver
from deepbots_cli.rollout.episode import Driver, OnEpisode, own_episode
from deepbots_cli.words import beside, number_text

if TYPE_CHECKING:
    from deepbots_cli.runtime import Supervisor


@dataclass(frozen=True)
class UnmetExpectation:
    """An expectation that is not met.

    `expected` is the key and its text, `where` its `file:line:column`, `measured` the result in words.
    `episode`, which counts from 0, is the first that fails. `step` is None if the expectation does not belong
    to a single step. `values` are those that a condition compares, by their texts, or the result under
    `measured`; `key` is empty for an error.
    """

    expected: str
    where: str
    measured: str
    episode: int
    step: int | None = None
    key: ExpectedKey | Literal[""] = ""
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class TestResult:
    """The result of a test; `steps` counts those of all episodes, `seconds` is wall time, and `unmet` are
    empty if it passed."""

    test: ScenarioTest
    episodes: int
    steps: int
    seconds: float
    unmet: tuple[UnmetExpectation, ...]

    @property
    def passed(self) -> bool:
        return not self.unmet


def run_tests(
    program: Program,
    tests: Sequence[ScenarioTest],
    *,
    engine: str | None = None,
    permissions: Permissions = Permissions(),
    on_episode: OnEpisode | None = None,
) -> Iterator[TestResult]:
    """Yield the result of each test. Tests in the same case or stage run together, and share an environment.

    Raises:
        UsageError: There is no such engine, or the scenario calls functions of Python without permission.
        MissingExtraError: The simulator is not installed.
        EngineError: The engine cannot build this world.
    """

    def setting(test: ScenarioTest) -> tuple[str, str]:
        return test.case or "", test.stage or ""

    for (case, stage), group in groupby(sorted(tests, key=setting), setting):
        together = tuple(group)
        variant = program.variant(case or None, stage or None)
        variant = variant if variant.others is None else variant.others.world
        with closing(
            api.make(replace(variant, tests=together), engine=engine, permissions=permissions)
        ) as environment:
            for test in together:
                yield _run(environment, test, on_episode)


def _run(environment: Supervisor, test: ScenarioTest, on_episode: OnEpisode | None) -> TestResult:
    began = time.perf_counter()
    episodes: list[Episode] = []
    unmet: list[UnmetExpectation] = []
    cut = 0
    try:
        for number in range(test.episodes):
            episodes.append(_episode(environment, test, number, unmet))
            if on_episode is not None:
                on_episode(number + 1, test.episodes)
    except DeepbotsError as error:
        cut = environment.step_count
        unmet.append(UnmetExpectation("no error", test.span.location, str(error), len(episodes), cut or None))
    else:
        unmet += _unmet_over_episodes(environment.scenario, test, episodes)
    steps = cut + sum(episode.length for episode in episodes)
    return TestResult(
        test,
        len(episodes),
        steps,
        time.perf_counter() - began,
        tuple(_first_unmet(unmet, test, environment.scenario.period)),
    )


def _first_unmet(
    unmet: Sequence[UnmetExpectation], test: ScenarioTest, period: float
) -> Iterator[UnmetExpectation]:
    """Yield each unmet expectation once, in the order in which they were first unmet, with the number of
    episodes that do not meet it, and its position in the first of them."""
    first_unmet: dict[str, UnmetExpectation] = {}
    for expectation in unmet:
        first_unmet.setdefault(expectation.where, expectation)
    for first in first_unmet.values():
        episodes = {expectation.episode for expectation in unmet if expectation.where == first.where}
        many = f"; in {len(episodes)} of {test.episodes} episodes" if len(episodes) > 1 else ""
        step = f", step {first.step:,} ({first.step * period:.4g} s)" if first.step is not None else ""
        yield replace(
            first, measured=f"{first.measured}{many}; seed {test.seed}, episode {first.episode}{step}"
        )


def _episode(
    environment: Supervisor, test: ScenarioTest, number: int, unmet: list[UnmetExpectation]
) -> Episode:
    """Run one episode, whose `ended_by` is None if the test stops it. Unmet expectations are added to
    `unmet`."""
    start = Start.of_evaluation(test.seed, number)
    monitors = [_ExpectationMonitor(agent, test, number) for agent in environment.agents.values()]
    if test.drivers:
        driver: Driver = AgentsDriver(environment, test.drivers)
    elif isinstance(test.driver, str):
        driver = named_driver(environment, test.driver)
    else:
        driver = sequence_driver(
            environment.make_action(action.choices, action.ranges) for action in test.driver
        )

    def observed_steps() -> Iterator[Step]:
        for step in islice(steps(environment, driver, start), test.steps + 1):
            if step.number:
                for monitor in monitors:
                    monitor.observe(step.number)
            yield step

    episode = result_of(observed_steps(), start.seed)
    after = f"after {episode.length:,} steps ({episode.length * environment.scenario.period:.4g} s)"
    for expected in test.expected:
        if expected.endings and episode.ended_by not in expected.endings:
            words = f"ended by `{episode.ended_by}` {after}" if episode.ended_by else f"has not ended {after}"
            unmet.append(_unmet_expectation(expected, words, number))
    for monitor in monitors:
        ending = f", when `{episode.ended_by}` ended it" if episode.ended_by else ""
        unmet += monitor.unmet(after.removeprefix("after ") + ending)
    return episode


def _unmet_expectation(
    expected: ExpectedResult,
    measured: str,
    episode: int,
    step: int | None = None,
    values: Mapping[str, str] | None = None,
) -> UnmetExpectation:
    return UnmetExpectation(
        f"{expected.key}: {expected.text}",
        expected.span.location,
        measured,
        episode,
        step,
        expected.key,
        {"measured": measured} if values is None else values,
    )


class _ExpectationMonitor:
    """Follows the conditions of a test in one episode, for one agent."""

    def __init__(self, agent: Supervisor, test: ScenarioTest, episode: int) -> None:
        self._agent = agent
        self._test = test
        self._episode = episode
        self._met: set[ExpectedResult] = set()
        self._broken: dict[ExpectedResult, UnmetExpectation] = {}

    def observe(self, step: int) -> None:
        """Note which conditions hold after a step."""
        if not self._test.conditions:
            return
        for expected, holds in zip(
            self._test.conditions, self._agent.tested(self._test.name, "holds"), strict=True
        ):
            if holds:
                self._met.add(expected)
            elif expected.key == "always" and expected not in self._broken:
                values = self._compared(expected)
                self._broken[expected] = _unmet_expectation(
                    expected, _in_words(values) or "false", self._episode, step, values
                )

    def unmet(self, length: str) -> Iterator[UnmetExpectation]:
        """Yield the expectations that the episode does not meet. Call this after its last step."""
        yield from self._broken.values()
        for expected in self._test.conditions:
            if expected.key == "eventually" and expected not in self._met:
                values = self._compared(expected)
                yield _unmet_expectation(
                    expected,
                    f"never in {length}" + (f"; at the end, {_in_words(values)}" if values else ""),
                    self._episode,
                    values=values,
                )

    def _compared(self, expectation: ExpectedResult) -> dict[str, str]:
        """Return the compared values of the condition, after the last step, by their texts."""
        values = iter(self._agent.tested(self._test.name, "compared"))
        compared = {
            expected: [(value, next(values)) for value in expected.compared]
            for expected in self._test.conditions
        }
        return {
            value.text: with_unit(number, value.typed.type.dimension)
            for value, number in compared[expectation]
        }


def _in_words(values: Mapping[str, str]) -> str:
    return ", ".join(f"{text} is {value}" for text, value in values.items())


def _unmet_over_episodes(
    program: Program, test: ScenarioTest, episodes: Sequence[Episode]
) -> Iterator[UnmetExpectation]:
    """Yield the expectations that the episodes together do not meet."""
    if test.agent is not None:
        member = program.members[test.agent]
        program = member.program
        episodes = [own_episode(member, episode) for episode in episodes]
    returns = [episode.total_return for episode in episodes]
    for expected in test.expected:
        match expected.key:
            case "success_rate" | "failure_rate":
                counted = [
                    episode.is_success
                    if expected.key == "success_rate"
                    else episode.ended_by in program.failures
                    for episode in episodes
                ]
                share = sum(counted) / len(episodes)
                if not expected.low <= share <= expected.high:
                    bar = min(max(share, expected.low), expected.high)
                    percent = beside(100 * share, 100 * bar, 3)[0]
                    words = f"{sum(counted)} of {len(episodes)} episodes ({percent} %)"
                    yield _unmet_expectation(expected, words, counted.index(share > expected.high))
            case "mean_return":
                mean = fmean(returns)
                if not expected.low <= mean <= expected.high:
                    extreme, worst = (
                        ("highest", max(returns)) if mean > expected.high else ("lowest", min(returns))
                    )
                    words = beside(mean, min(max(mean, expected.low), expected.high), 6)[0]
                    if len(episodes) > 1:
                        words += f" over {len(episodes)} episodes, the {extreme} is {number_text(worst, 6)}"
                    yield _unmet_expectation(expected, words, returns.index(worst))
