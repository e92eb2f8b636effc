"""The compiled scenario as canonical JSON: it comes back as it was, its digest means what it says, and junk is refused."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.canonical import CanonicalError, digest, from_json, to_json
from deepbots_cli.compiler.emit import emit
from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, State, World
from deepbots_cli.program import Program
from deepbots_cli.program.values import Expression

SCENARIOS = Path(__file__).parents[1] / "data" / "scenarios"
WORDS = st.text(max_size=8)
LEAVES = (
    st.builds(Const, st.floats(allow_nan=False) | st.booleans())
    | st.builds(Name, WORDS, st.none() | WORDS)
    | st.builds(World, WORDS, st.lists(WORDS, max_size=2).map(tuple), st.none() | WORDS)
)
TREES = st.recursive(
    LEAVES,
    lambda inner: (
        st.builds(Op, WORDS, st.lists(inner, max_size=3).map(tuple))
        | st.builds(State, WORDS, st.lists(inner, max_size=2).map(tuple), WORDS)
        | st.builds(Draw, WORDS, st.lists(inner, max_size=2).map(tuple), WORDS)
    ),
    max_leaves=12,
)


@cache
def compiled(name: str) -> Program:
    return api.compile(name if "/" not in name else SCENARIOS / name.removeprefix("data/")).ir


@pytest.mark.parametrize("name", ["cartpole", "data/drawn.yaml", "data/pair.yaml"])
def test_a_scenario_comes_back_as_it_was(name: str) -> None:
    scenario = compiled(name)
    text = to_json(scenario)
    assert from_json(text) == scenario
    assert to_json(from_json(text)) == text
    assert emit(from_json(text)) == emit(scenario)


@settings(max_examples=100, deadline=None)
@given(tree=TREES)
def test_any_expression_comes_back_as_it_was(tree: Any) -> None:
    scenario = replace(compiled("cartpole"), reward=(Expression("alive", tree),))
    again = from_json(to_json(scenario))
    assert again == scenario
    assert digest(again) == digest(scenario)


def test_minus_zero_and_infinity_survive() -> None:
    scenario = replace(compiled("cartpole"), reward=tuple(Expression("a", Const(value)) for value in (-0.0, float("inf"), float("-inf"))))
    assert [repr(term.value.value) for term in from_json(to_json(scenario)).reward] == ["-0.0", "inf", "-inf"]  # type: ignore[union-attr]


def places(data: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [path, *(place for key, item in inner for place in places(item, (*path, key)))]


DATA = json.loads(to_json(compiled("cartpole")))
PLACES = [place for place in places(DATA) if place]
ODD = st.sampled_from(
    [None, True, -1, 1.5, 10**400, "", 'x\n\'"""', [], [[]], {}, {"is": "Const"}, {"is": "float", "value": "nan"}, {"is": "os.system"}]
) | st.recursive(
    st.none() | st.floats() | st.text(max_size=5), lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner), max_leaves=4
)


@settings(max_examples=100, deadline=None)
@given(changes=st.lists(st.tuples(st.sampled_from(PLACES), ODD), min_size=1, max_size=3))
def test_altered_json_is_a_scenario_or_refused(changes: list[tuple[tuple[Any, ...], Any]]) -> None:
    data = json.loads(json.dumps(DATA))
    for place, value in changes:
        holder = data
        try:
            for step in place[:-1]:
                holder = holder[step]
            holder[place[-1]] = value
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took it away
    with suppress(CanonicalError):
        assert isinstance(from_json(json.dumps(data)), Program)


@settings(max_examples=100, deadline=None)
@given(text=st.text(max_size=60) | st.recursive(st.none() | st.integers(), st.lists, max_leaves=5).map(json.dumps))
def test_any_other_text_is_refused(text: str) -> None:
    with pytest.raises(CanonicalError):
        from_json(text)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"version":1,"a":' * 50_000, "1" * 10_000, "", "\x00", "NaN", '{"version": 2}'])
def test_hostile_json_is_refused(text: str) -> None:
    with pytest.raises(CanonicalError):
        from_json(text)


@pytest.mark.parametrize("name", ['x"', "a\nimport os", '"""', "os.system", "A", "", "naïve", "a b", "1a", "a;b"])
def test_a_name_that_is_no_identifier_is_never_printed(name: str) -> None:
    with pytest.raises(CanonicalError):
        emit(replace(compiled("cartpole"), reward=(Expression(name, Const(1.0)),)))


@pytest.mark.parametrize("text", ['"""\nimport os\n"""', "'''", "\\", "\\u0022", "a\r\nb", "{x}", "\x00", 'Ends with a quote"'])
def test_the_summary_stays_text_in_the_code(text: str) -> None:
    code = emit(replace(compiled("cartpole"), summary=text))
    plain = emit(compiled("cartpole"))
    assert len(code.splitlines()) == len(plain.splitlines())
    names = compile(code, "generated", "exec").co_names
    assert names == compile(plain, "generated", "exec").co_names


def digest_of(workshop, text: str) -> str:
    return workshop.compile(text).digest


def test_the_digest_depends_on_what_a_file_means_only(workshop, cartpole) -> None:
    plain = digest_of(workshop, cartpole())
    assert plain == digest_of(workshop, cartpole())
    assert plain == digest_of(workshop, cartpole(("substeps: 4", "substeps:   4   # of 8 ms")))
    assert plain == digest_of(workshop, cartpole(("  timestep:", '  "timestep":')))
    assert plain == digest_of(workshop, cartpole(("15 deg", "0.015e3 deg")))
    assert plain == digest_of(workshop, cartpole(("timestep: 32 ms", "timestep: 0.032 s")))
    assert plain == digest_of(workshop, cartpole(("{max_steps: 200}", "\n  max_steps: 200")))
    assert plain == digest_of(workshop, cartpole(("track:       0.39 m", "track:       0.39")).replace("> track", "> track * 1 m"))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("15 deg", "15.1 deg"),
        ("substeps: 4", "substeps: 5"),
        ("alive: 1", "alive: 2"),
        ("alive: 1", "alife: 1"),
        ("format: csv", "format: json"),
        ("max_torque: 10 N*m", "max_torque: 9 N*m"),
        ("gamma: 0.98", "gamma: 0.99"),
        ("{z: 0.04 m}", "{z: 0.05 m}"),
        ("uniform(-1 .. 1 deg)", "uniform(-1 .. 2 deg)"),
        ("abs(x) > track", "abs(x) >= track"),
    ],
)
def test_the_digest_tells_scenarios_apart(workshop, cartpole, old: str, new: str) -> None:
    assert digest_of(workshop, cartpole()) != digest_of(workshop, cartpole((old, new)))
