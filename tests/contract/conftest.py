"""Every world that the contract is tried on: each shipped scenario and those of tests/data, on each engine that can hold it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from deepbots_cli import api, engines
from deepbots_cli.document import shipped
from deepbots_cli.errors import EngineError
from deepbots_cli.program import Program
from deepbots_cli.runtime import Supervisor

DATA = Path(__file__).parents[1] / "data" / "scenarios"
MADE_FOR_TESTS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("rail", ()),
    ("rail", ("messages.format=none",)),
    ("rail", ("messages.timing=paper",)),
    ("drawn", ()),
    ("drawn", ("messages.timing=paper",)),
    ("pair", ()),
    ("pair", ("agent={repeat: 3}",)),
    ("../../channel/radio", ()),
    ("../../world/hills", ()),
    ("drone", ()),
    ("sensed", ()),
)


@dataclass(frozen=True)
class Case:
    """One scenario on one engine."""

    source: str
    sets: tuple[str, ...]
    engine: str
    ir: Program = field(repr=False)

    def __str__(self) -> str:
        return "-".join([Path(self.source).stem, *(text.split("=")[1] for text in self.sets), self.engine])

    def make(self, render_mode: str | None = None) -> Supervisor:
        return api.build(self.ir, engine=self.engine, render_mode=render_mode)


def can_hold(engine: str, ir: Program) -> bool:
    try:
        engines.create(engine, ir.world).close()
    except EngineError:
        return False
    return True


def _cases() -> list[Case]:
    sources = [(name, ()) for name in shipped.scenario_names()] + [(str(DATA / f"{name}.yaml"), sets) for name, sets in MADE_FOR_TESTS]
    found = []
    for source, sets in sources:
        ir = api.compile(source, sets=sets).ir
        found += [Case(source, sets, engine, ir) for engine in engines.ENGINES if can_hold(engine, ir)]
    return found


CASES = _cases()


@pytest.fixture(scope="session", params=CASES, ids=str)
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


@pytest.fixture(scope="session")
def environment(case: Case) -> Iterator[Supervisor]:
    """One that earlier tests have used: nothing may be left of that after a reset."""
    made = case.make()
    yield made
    made.close()


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


@pytest.fixture(scope="session")
def cases() -> list[Case]:
    return CASES
