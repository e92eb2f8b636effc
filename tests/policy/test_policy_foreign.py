"""Terms in Python: refused unless allowed, run when an environment is made, and never before."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.document import Permissions
from deepbots_cli.errors import EvaluationError, ScenarioError, UsageError
from tests.worlds import CART, Maker

MODULE = """\
calls = []
def height(supervisor):
    return supervisor.engine.pose("cart", "cart")()[0][0] + 2
def late(supervisor):
    calls.append(supervisor.step_count)
    return supervisor.step_count >= 3
def word(supervisor):
    return "much"
def truth(supervisor):
    return True
def broken(supervisor):
    return 1 / 0
thing = 3
"""
TERMS = (
    "reward: {pay: drive, tall: {python: 'students.terms:height'}}\ntermination: {success: {late:"
    " {python: 'students.terms:late'}}}\n"
)


@pytest.fixture(autouse=True)
def package(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("installed")
    (folder / "students").mkdir()
    (folder / "students" / "terms.py").write_text(MODULE)
    (folder / "students" / "bad.py").write_text("raise SystemError('no')\n")
    monkeypatch.syspath_prepend(str(folder))
    yield
    for name in [name for name in sys.modules if name.startswith("students")]:
        del sys.modules[name]


@pytest.fixture
def write_scenario(make: Maker) -> Callable[[str], Path]:
    return lambda sections: make.written(CART + sections)


def test_a_term_in_python_is_refused_at_its_place(write_scenario: Callable[[str], Path]) -> None:
    file = write_scenario(TERMS)
    findings = [finding for finding in api.lint(file) if finding.code == "DB409"]
    assert [finding.span.text for finding in findings] == ["students.terms:height", "students.terms:late"]
    with pytest.raises(ScenarioError, match="DB409"):
        api.compile(file)


def test_with_permission_it_is_a_warning_and_nothing_is_imported_to_compile(
    write_scenario: Callable[[str], Path],
) -> None:
    compiled = api.compile(write_scenario(TERMS), permissions=Permissions(code=True))
    assert {finding.code for finding in compiled.findings} >= {"DB410"}
    assert not [name for name in sys.modules if name.startswith("students")]


def test_terms_in_python_are_called_with_the_supervisor(write_scenario: Callable[[str], Path]) -> None:
    environment = api.make(write_scenario(TERMS), permissions=Permissions(code=True), engine="exact")
    environment.reset(seed=0)
    _, reward, terminated, _, info = environment.step(np.array([0.5], np.float32))
    truth = environment.engine.pose("cart", "cart")()[0][0]
    assert info["reward_terms"] == {"pay": 0.5, "tall": pytest.approx(truth + 2)}
    assert reward == pytest.approx(2.5 + truth)
    assert not terminated
    environment.step(np.zeros(1, np.float32))
    assert environment.step(np.zeros(1, np.float32))[4]["ended_by"] == "late"
    environment.close()


def test_a_compiled_scenario_runs_no_code_unless_allowed(write_scenario: Callable[[str], Path]) -> None:
    program = api.compile(write_scenario(TERMS), permissions=Permissions(code=True)).program
    with pytest.raises(UsageError, match="--allow-code"):
        api.build(program, engine="exact")
    assert not [name for name in sys.modules if name.startswith("students")]
    api.build(program, engine="exact", permissions=Permissions(code=True)).close()


@pytest.mark.parametrize(
    "place", ["students.none:height", "students.terms:none", "students.terms:thing", "students.bad:x"]
)
def test_the_error_of_a_missing_function_names_it(write_scenario: Callable[[str], Path], place: str) -> None:
    compiled = api.compile(
        write_scenario(f"reward: {{tall: {{python: '{place}'}}}}\n"), permissions=Permissions(code=True)
    )
    with pytest.raises(UsageError, match=f"reward term 'tall' in Python .{place}"):
        api.make(compiled, engine="exact")


@pytest.mark.parametrize("function", ["word", "truth", "broken"])
def test_what_goes_wrong_in_a_function_names_the_term(
    write_scenario: Callable[[str], Path], function: str
) -> None:
    environment = api.make(
        write_scenario(f"reward: {{tall: {{python: 'students.terms:{function}'}}}}\n"),
        permissions=Permissions(code=True),
        engine="exact",
    )
    environment.reset(seed=0)
    with pytest.raises(
        EvaluationError, match=f"step 1: the reward term 'tall' in Python .students.terms:{function}."
    ):
        environment.step(np.zeros(1, np.float32))
    environment.close()


@pytest.mark.parametrize("place", ["os.system", "os:system(1)", "../x:y", "a.b:c.d", ":f", "a:", "a b:c"])
def test_only_dotted_names_are_places_of_functions(write_scenario: Callable[[str], Path], place: str) -> None:
    with pytest.raises(ScenarioError):
        api.compile(
            write_scenario(f"reward: {{tall: {{python: '{place}'}}}}\n"), permissions=Permissions(code=True)
        )
