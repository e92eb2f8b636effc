"""The worlds of the contract: each shipped scenario and some of tests/data.

`make test` tries the whole contract on the few worlds of `FULL`, which differ most, and `make nightly` on all
of them. The environment checkers take every sixth shipped scenario, and all of them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.program import Program
from deepbots_cli.runtime import Supervisor
from tests.few import few
from tests.worlds import SCENARIOS

MADE_FOR_TESTS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("rail", ()),
    ("rail", ("messages.format=none",)),
    ("rail", ("messages.timing=delayed",)),
    ("drawn", ()),
    ("drawn", ("messages.timing=delayed",)),
    ("pair", ()),
    ("pair", ("agent={action_repeat: 3}",)),
    ("../../channel/radio", ()),
    ("../../world/hills", ()),
    ("drone", ()),
    ("sensed", ()),
    ("pushed", ()),
)

FULL = ("multi_cartpole", "see_ball", "panda_reach", "pushed", "rail-delayed", "radio")
"""`pushed` stands for the quadruped: it has pushes, latency, histories, strengths and touch sensors too."""


@dataclass(frozen=True)
class Case:
    """One scenario, with settings."""

    source: str
    overrides: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "-".join([Path(self.source).stem, *(text.split("=")[1] for text in self.overrides)])

    @cached_property
    def program(self) -> Program:
        return api.compile(self.source, overrides=self.overrides).program

    def make(self, render_mode: str | None = None) -> Supervisor:
        return api.build(self.program, render_mode=render_mode)


CASES = [
    *(Case(name) for name in shipped.scenario_names()),
    *(Case(str(SCENARIOS / f"{name}.yaml"), overrides) for name, overrides in MADE_FOR_TESTS),
]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "case" in metafunc.fixturenames:
        shipped_too = metafunc.definition.get_closest_marker("every_scenario") is not None
        chosen = {*FULL, *shipped.scenario_names()[::6]} if shipped_too else FULL
        metafunc.parametrize("case", few(CASES, chosen), indirect=True, scope="session")
    if "cases" in metafunc.fixturenames:
        full = [case for case in CASES if str(case) in FULL]
        metafunc.parametrize(
            "cases", [pytest.param(full, id="full"), pytest.param(CASES, id="all", marks=pytest.mark.slow)]
        )


@pytest.fixture(scope="session")
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


@pytest.fixture(scope="session")
def environment(case: Case) -> Iterator[Supervisor]:
    """One that earlier tests have used: nothing may be left of that after a reset."""
    used = case.make()
    yield used
    used.close()


@pytest.fixture
def make(case: Case) -> Iterator[Callable[..., Supervisor]]:
    """Makes further environments of the case, and closes them after the test: each may hold 29 MB."""
    opened: list[Supervisor] = []

    def make_one(render_mode: str | None = None) -> Supervisor:
        opened.append(case.make(render_mode))
        return opened[-1]

    yield make_one
    for environment in opened:
        environment.close()
