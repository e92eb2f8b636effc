"""A compiled scenario from elsewhere: whatever stands in it, none of its text becomes code."""

from __future__ import annotations

import copy
import io
import json
import random
import tokenize
from collections.abc import Iterator
from contextlib import closing, suppress
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from deepbots_cli import api
from deepbots_cli.canonical import CanonicalError, from_json, to_json
from deepbots_cli.compiler.emit import emit
from deepbots_cli.errors import DeepbotsError

DATA = Path(__file__).parents[1] / "data" / "scenarios"
SOURCES = [
    "cartpole",
    *(str(DATA / f"{name}.yaml") for name in ("drawn", "pair", "placed")),
    *(str(DATA.parents[1] / "channel" / f"{name}.yaml") for name in ("radio", "team")),
    str(DATA.parents[1] / "channel" / "radio.yaml"),
    str(DATA.parents[1] / "placement" / "few.yaml"),
    str(DATA.parents[1] / "world" / "hills.yaml"),
]
MARK = "intruder"
TEXTS = (
    f'"""\n{MARK}()\n"""',
    f"x\n{MARK} = 1",
    f'"; {MARK}(); "',
    f"'; {MARK}(); '",
    f"\\'; {MARK}() #",
    f"__import__('{MARK}')",
    f"x): {MARK}(",
    f"{{{MARK}}}",
    f"a\r{MARK}()",
    f"a\u2028{MARK}()\x0c",
    "\\",
    "",
)
CONSTANT = {"is": "Const", "value": 1.0}
OTHERS: tuple[Any, ...] = (None, True, -1, 0, 10**30, 1e308, [], ["x"], {}, {"is": "float", "value": "nan"})


@cache
def canonical(source: str) -> str:
    return to_json(api.compile(source).ir)


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the numbers and texts of a JSON document stand."""
    if isinstance(data, dict | list):
        for key, item in data.items() if isinstance(data, dict) else enumerate(data):
            yield from places(item, (*path, key))
    else:
        yield path


def replaced(text: str, path: tuple[Any, ...], value: Any) -> str:
    data = json.loads(text)
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = copy.deepcopy(value)
    return json.dumps(data)


def code_of(text: str) -> str | None:
    """What is printed for such a scenario, or None where it is refused in words."""
    try:
        return emit(from_json(text))
    except DeepbotsError:
        return None


def words(code: str) -> set[str]:
    """Everything in the code that is neither quoted nor a comment."""
    return {token.string for token in tokenize.generate_tokens(io.StringIO(code).readline) if token.type in (tokenize.NAME, tokenize.OP)}


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: Path(source).stem)
def test_text_in_any_place_is_quoted_or_refused(source: str) -> None:
    text = canonical(source)
    rng = random.Random(1)
    for path in places(json.loads(text)):
        code = code_of(replaced(text, path, rng.choice(TEXTS)))
        if code is not None:
            compile(code, "printed", "exec")
            assert MARK not in words(code), path


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: Path(source).stem)
def test_odd_values_in_any_place_give_code_or_are_refused(source: str) -> None:
    text = canonical(source)
    rng = random.Random(2)
    for path in places(json.loads(text)):
        code = code_of(replaced(text, path, rng.choice(OTHERS)))
        if code is not None:
            compile(code, "printed", "exec")


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: Path(source).stem)
def test_lists_of_another_length_give_a_world_that_runs_or_are_refused(source: str) -> None:
    text = canonical(source)
    lists = {path[:end] for path in places(json.loads(text)) for end, key in enumerate(path) if isinstance(key, int)}
    for path in sorted((path for path in lists if path[0] != "world"), key=str):  # bodies are looked at when a run is opened
        items = json.loads(text)
        for key in path:
            items = items[key]
        for others in ([], items[:-1], items * 2):
            with suppress(DeepbotsError), closing(api.build(from_json(replaced(text, path, others)))) as world:
                world.reset(seed=0)
                world.step(world.action_space.sample())


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("endings", 0, "name"), "near"),  # which its own condition names
        (("world", "timestep"), 1e-320),
        (("robots", 0, "to_robot", "stamp"), -1),
        (("robots", 0, "from_robot", "stamp"), 10**30),
        (("reset", "joints", 0, "position"), {"is": "Name", "name": "cart.place", "component": None}),  # not sent yet
        (("robots", 0, "name"), "rail"),  # which the world has not
        (("reward",), []),
        (("reward", 0, "value"), {"is": "Op", "op": "min", "args": [{"is": "Const", "value": 1.0}]}),
        (("scripts", 0, "parts"), []),
        (("scripts", 0, "parts", 0, "values"), []),
        (("scripts", 0, "parts", 0), {"is": "Pick", "options": ["forward"], "conditions": []}),  # the action is a range
        (("scripts", 0, "parts", 0, "values", 0), {"is": "Name", "name": "done", "component": None}),  # an ending
        (("scripts", 0, "parts", 0, "values", 0), {"is": "Name", "name": "ended", "component": None}),
        (("scripts", 0, "parts", 0, "values", 0), {"is": "State", "function": "delta", "args": [CONSTANT], "slot": "scripts.approach#0"}),
        (("scripts", 0, "parts", 0, "values", 0), {"is": "Draw", "distribution": "uniform", "args": [CONSTANT] * 2, "stream": "s"}),
        (("scripts", 0, "name"), "Approach"),
    ],
    ids=str,
)
def test_what_would_fail_while_the_code_is_printed_or_run_is_refused_before(path: tuple[Any, ...], value: Any) -> None:
    text = canonical(str(DATA / "drawn.yaml"))
    with pytest.raises(CanonicalError):
        emit(from_json(replaced(text, path, value)))


@pytest.mark.parametrize(
    "text", ["", "null", "[]", "{}", "{" * 100_000, "[" * 100_000, '{"version": 1}', '{"version": 99}', "\x00", "1" * 6000]
)
def test_what_is_no_compiled_scenario_is_refused(text: str) -> None:
    with pytest.raises(DeepbotsError):
        from_json(text)
