"""What a law is, and how it is tried: on scenarios that chance draws, from a seed.

A law takes a `Case`: a scenario, and further draws. It fails by an assertion, or by any exception. Hypothesis
shrinks the scenario of a failure, and the message ends with the command that shows it again.
"""

from __future__ import annotations

import copy
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import hypothesis
import numpy as np
from hypothesis import HealthCheck, Phase, given, reject
from hypothesis import strategies as st
from hypothesis.internal.conjecture import engine

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.errors import EngineError, EvaluationError, RunError, ScenarioError
from deepbots_cli.runtime import Supervisor
from tests.laws.expressions import Draw
from tests.laws.pairs import Pair, pairs_of
from tests.laws.reduce import reduced
from tests.laws.scenarios import EVERY, Drawn, Profile, as_text, scenarios

# A scenario has 200 draws: by default, Hypothesis shrinks a failure for five minutes. There is no setting.
engine.MAX_SHRINKING_SECONDS = 60
SHOW = "python -m tests.laws {name} --seed {seed}"


OUTCOMES: Counter[str] = Counter()
"""How many scenarios an attempt has drawn, and for how many of them the law holds. The law says nothing of
the others: `lint` refuses them, or they cannot be played."""


@dataclass
class Case:
    """One scenario that was drawn, in a folder of its own.

    Attributes:
        drawn: The scenario.
        draw: Draws what the law needs beside it.
        folder: An empty folder, a project of its own.
    """

    drawn: Drawn
    draw: Draw
    folder: Path

    def write(self, source: str | dict[str, Any], name: str = "scenario.yaml") -> Path:
        """Write a text, or the data of a scenario, to a file of the folder."""
        text = source if isinstance(source, str) else as_text(source)
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    @property
    def path(self) -> Path:
        """The file of the scenario."""
        path = self.folder / "scenario.yaml"
        return path if path.exists() else self.write(self.drawn.text)

    @property
    def overrides(self) -> tuple[str, ...]:
        """What an environment of one agent needs: of several agents, the one whose role it is."""
        data = self.drawn.data
        return ("role.agent=one",) if "agents" in data and "role" not in data else ()

    def compile(self, source: Any = None) -> Compiled:
        """Compile the scenario, or another source, which must be valid if the scenario is."""
        if source is not None:
            return api.compile(source, overrides=self.overrides)
        try:
            return api.compile(self.path, overrides=self.overrides)
        except ScenarioError as error:
            if not any(finding.severity == "error" for finding in error.findings):
                raise
            reject()

    @contextmanager
    def environment(self, source: Any = None, **options: Any) -> Iterator[Supervisor]:
        """Open an environment of the scenario, or of another source."""
        compiled = self.compile() if source is None else source
        with closing(api.make(compiled, **options)) as environment:
            yield environment


@dataclass(frozen=True)
class Law:
    """A law: `check` raises where it does not hold.

    Attributes:
        cost: The CPU time of one scenario, in ms, by which `make test` shares its time.
        profile: Which scenarios are drawn.
    """

    name: str
    check: Callable[[Case], None]
    cost: int
    profile: Profile

    def try_on(self, seed: int, examples: int, drawn: Drawn | None = None) -> set[Pair]:
        """Try the law on scenarios of a seed, or on one scenario with several draws of the rest.

        Returns the pairs of the scenarios for which it holds.

        Raises:
            Exception: That of the smallest scenario that breaks the law.
        """

        met: set[Pair] = set()
        failing: list[Drawn] = []
        draws: list[Any] = []

        @hypothesis.seed(seed)
        @hypothesis.settings(
            max_examples=examples,
            database=None,
            deadline=None,
            report_multiple_bugs=False,
            phases=(Phase.generate, Phase.shrink),
            suppress_health_check=list(HealthCheck),
            print_blob=False,
        )
        @given(st.data())
        def try_all(data: st.DataObject) -> None:
            scenario = drawn or data.draw(scenarios(self.profile), label=self.name)
            OUTCOMES["drawn"] += 1
            with tempfile.TemporaryDirectory() as folder:
                draws.clear()
                failing[:] = [scenario]
                self.check(Case(scenario, recording(data.draw, draws), Path(folder)))
                failing.clear()
            OUTCOMES["held"] += 1
            met.update(pairs_of(scenario.data))

        try:
            try_all()
        except Exception as error:
            if failing and (smallest := self._smallest(failing[0], draws)):
                error.add_note(f"the smallest scenario, with the draws {draws}:\n\n{smallest}")
            error.add_note(f"show it: {SHOW.format(name=self.name, seed=seed)} --examples {examples}")
            raise
        return met

    def _smallest(self, drawn: Drawn, draws: list[Any]) -> str | None:
        """Return the text of the smallest scenario that fails as this one does, with the same draws."""

        def check(data: dict[str, Any], folder: Path) -> None:
            again = iter(copy.deepcopy(draws))
            self.check(Case(Drawn(data), lambda *_, **__: next(again), folder))

        return reduced(drawn.data, check)


def recording(draw: Draw, draws: list[Any]) -> Draw:
    """Return a function that draws, and keeps what it drew."""

    def drawn(strategy: Any) -> Any:
        draws.append(draw(strategy))
        return draws[-1]

    return drawn


OF_THE_WORLD = ("no start was found", "is not stable", "infinite or NaN", "is not finite", "no value for")
"""Problems that only a simulation shows: no room at the start, an unstable motor, no value of a function."""


@contextmanager
def reference(*problems: str) -> Iterator[None]:
    """Reject a scenario that cannot be played, for one of these reasons (default: `OF_THE_WORLD`).

    Only the episode with which a law compares others stands inside: the others must then go as it does.
    """
    try:
        yield
    except (EvaluationError, EngineError, RunError, RuntimeWarning) as error:
        if not any(text in str(error) for text in problems or OF_THE_WORLD):
            raise
        reject()


LAWS: dict[str, Law] = {}


def law(
    cost: int = 50, profile: Profile = EVERY
) -> Callable[[Callable[[Case], None]], Callable[[Case], None]]:
    """Enter a function into `LAWS`, under its name."""

    def enter(check: Callable[[Case], None]) -> Callable[[Case], None]:
        name = check.__name__
        assert name not in LAWS, name
        assert check.__doc__, f"{name} does not say why it holds"
        LAWS[name] = Law(name, check, cost, profile)
        return check

    return enter


class Attempt(NamedTuple):
    """One law on the scenarios of one seed, the pairs that these had, and their `OUTCOMES`; `failure` is
    empty where it holds."""

    law: str
    seed: int
    seconds: float
    failure: str
    met: list[Pair]
    outcomes: Counter[str]


def attempt(name: str, seed: int, examples: int) -> Attempt:
    """Try a law, and return what came of it, with the CPU time."""
    import tests.laws  # enters all laws, in a process of its own

    OUTCOMES.clear()
    begin = time.process_time()
    failure, met = "", set()
    try:
        met = tests.laws.LAWS[name].try_on(seed, examples)
    except Exception as error:  # noqa: BLE001 - whatever a law meets is its result
        failure = "".join(traceback.format_exception(error, limit=-8))
    return Attempt(name, seed, time.process_time() - begin, failure, sorted(met), Counter(OUTCOMES))


# Episodes


def same(actual: Any, expected: Any, place: str = "") -> None:
    """Require two values to be equal: arrays, numbers, and what is made of them. NaN equals NaN."""
    if isinstance(expected, dict):
        assert list(actual) == list(expected), place
        for key, value in expected.items():
            same(actual[key], value, f"{place}.{key}")
    elif isinstance(expected, np.ndarray | float | np.floating):
        np.testing.assert_array_equal(actual, expected, err_msg=place)
    elif isinstance(expected, list | tuple):
        assert len(actual) == len(expected), place
        for number, (one, other) in enumerate(zip(actual, expected, strict=True)):
            same(one, other, f"{place}[{number}]")
    else:
        assert actual == expected, place
