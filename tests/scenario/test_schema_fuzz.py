"""Whatever is written, the schema answers with findings that have a place."""

import copy
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
from hypothesis import assume, given
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Finding
from deepbots_cli.document import load, to_data
from deepbots_cli.scenario import Scenario
from deepbots_cli.scenario.json_schema import json_schema

Check = Callable[[str], tuple[Scenario | None, list[Finding]]]
Place = tuple[str | int, ...]

ROOT = Path(__file__).parents[2]
FILES = sorted(ROOT.glob("scenarios/*.yaml"))
SAMPLES: list[Any] = [to_data(root) for path in FILES if (root := load(path).root) is not None]
VALIDATOR = jsonschema.Draft202012Validator(json_schema())

ODD_SCALARS = st.sampled_from(
    [0, -1, 3, 1.5, True, "", "x", "1 m", "1 2 3 m", "0 .. 1", "[key]", "type", "list", "a when b"]
) | st.text(max_size=8)
ODD_KEYS = st.sampled_from(
    ["type", "shape", "map", "[key]", "list", "0", "include", "range", "choices", "one_of", "joint"]
) | st.text(max_size=6)
ODD = st.recursive(
    ODD_SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(ODD_KEYS, inner, max_size=3),
    max_leaves=6,
)


def places(data: Any, path: Place = ()) -> Iterator[Place]:
    yield path
    if isinstance(data, dict):
        for key, value in data.items():
            yield from places(value, (*path, key))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from places(value, (*path, index))


PLACES = [[place for place in places(sample) if place] for sample in SAMPLES]


def at(data: Any, path: Place) -> Any:
    for step in path:
        data = data[step]
    return data


@st.composite
def mutated(
    draw: st.DrawFn, values: st.SearchStrategy[Any], changes: int = 3, insert: bool = True
) -> tuple[Any, list[Place]]:
    number = draw(st.integers(0, len(SAMPLES) - 1))
    data = copy.deepcopy(SAMPLES[number])
    changed = []
    for _ in range(draw(st.integers(1, changes))):
        place = draw(st.sampled_from(PLACES[number]))
        try:
            holder = at(data, place[:-1])
            holder[place[-1]]
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took it away
        if not isinstance(holder, (dict, list)):
            continue
        what = draw(st.sampled_from(["delete", "replace", "insert"])) if insert else "replace"
        if what == "delete":
            del holder[place[-1]]
        elif what == "insert" and isinstance(holder, dict):
            holder[draw(ODD_KEYS)] = draw(values)
        else:
            holder[place[-1]] = draw(values)
        changed.append(place)
    return data, changed


@given(case=mutated(ODD))
def test_no_change_of_a_scenario_raises_and_every_finding_has_a_place(
    check: Check, case: tuple[Any, list[Place]]
) -> None:
    data, _ = case
    text = json.dumps(data, ensure_ascii=False)
    scenario, findings = check(text)
    for finding in findings:
        assert 0 <= finding.span.start <= finding.span.end <= len(finding.span.source.text)
        assert finding.headline
        assert "input should" not in finding.headline.lower()
    if scenario is not None and not findings:
        assert scenario.pruned == frozenset()


@given(case=mutated(st.sampled_from([True, [[]], {"odd": 3}, 0, "x"]), changes=1, insert=False))
def test_one_wrong_value_is_one_finding(check: Check, case: tuple[Any, list[Place]]) -> None:
    data, _ = case
    _, findings = check(json.dumps(data))
    # Beside an unknown key, all that is required there is missing as well.
    assert len([finding for finding in findings if finding.code != "DB102"]) <= 1, [
        finding.headline for finding in findings
    ]


@given(case=mutated(ODD, changes=1))
def test_what_an_editor_marks_is_a_finding_too(check: Check, case: tuple[Any, list[Place]]) -> None:
    data, _ = case
    assume(not VALIDATOR.is_valid(data))
    _, findings = check(json.dumps(data))
    assert findings


@given(data=ODD)
def test_a_file_of_something_else_altogether_is_answered(check: Check, data: Any) -> None:
    _, findings = check(json.dumps(data))
    assert findings
