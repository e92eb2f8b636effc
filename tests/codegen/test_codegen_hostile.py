"""Hostile texts and values in any place of a scenario: refused in words, or quoted in code that runs."""

from __future__ import annotations

import copy
import io
import json
import random
import re
import tokenize
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from deepbots_cli import api
from deepbots_cli.codegen import generate_module
from deepbots_cli.compiler import check
from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.document.load import loads
from deepbots_cli.errors import DeepbotsError
from tests.few import every

TESTS = Path(__file__).parents[1]
SOURCES = [
    "cartpole",
    *(
        str(TESTS / "data" / "scenarios" / f"{name}.yaml")
        for name in ("drawn", "pair", "placed", "sensed", "drone")
    ),
    *(str(TESTS / "channel" / f"{name}.yaml") for name in ("radio", "team")),
    str(TESTS / "placement" / "few.yaml"),
    str(TESTS / "world" / "hills.yaml"),
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
OTHERS: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    10**30,
    1e308,
    1e-320,
    -1e300,
    [],
    ["x"],
    {},
    "1e-320 s",
    "1e300 m",
    "-1 .. -2",
    "0 .. 1e-320",
)
NUMBERS = ("0", "-1", "1e-320", "1e300", "1e-9", "1000")

Place = tuple[Any, ...]


@pytest.fixture(scope="module", params=every(6, SOURCES, lambda source: Path(source).stem))
def opened(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """A scenario as data, and the folder that its files lie in."""
    checked = api.load(request.param)
    folder = tmp_path_factory.mktemp("copies")
    checked.inputs.write(folder)
    return yaml.load((folder / RESOLVED_NAME).read_text(), Words), folder


class Words(yaml.SafeLoader):
    """YAML 1.1 takes `5e-3` for a text, which JSON would then quote."""


Words.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"-?\d+(\.\d*)?e-?\d+"), list("-0123456789")
)


def places(data: Any, path: Place = ()) -> Iterator[Place]:
    """Where the scalars and keys of a document stand."""
    if isinstance(data, dict | list):
        for key, item in data.items() if isinstance(data, dict) else enumerate(data):
            yield from places(item, (*path, key))
    else:
        yield path


def replaced(data: Any, path: Place, value: Any, *, key: bool = False) -> str:
    """The document as text, with another value at a path, or another key."""
    data = copy.deepcopy(data)
    inner = data
    for step in path[:-1]:
        inner = inner[step]
    if key and isinstance(inner, dict):
        inner[value] = inner.pop(path[-1])
    else:
        inner[path[-1]] = value
    return json.dumps(data)


def at(data: Any, path: Place) -> Any:
    """The value at a path."""
    for step in path:
        data = data[step]
    return data


def with_other_number(value: Any, rng: random.Random) -> Any:
    """The value with another number and the same unit."""
    number = rng.choice(NUMBERS)
    return re.sub(r"-?\d+(\.\d+)?", number, value, count=1) if isinstance(value, str) else float(number)


def compiled(text: str, folder: Path) -> api.Compiled | None:
    """The scenario of a text, or None where it is refused in words."""
    try:
        return api.compile(check(loads(text, "hostile.yaml", folder)))
    except DeepbotsError:
        return None


def words(code: str) -> set[str]:
    """Everything in the code that is neither quoted nor a comment."""
    return {
        token.string
        for token in tokenize.generate_tokens(io.StringIO(code).readline)
        if token.type in (tokenize.NAME, tokenize.OP)
    }


def some(data: Any, seed: int, count: int = 40) -> list[Place]:
    everywhere = sorted(places(data), key=str)
    return random.Random(seed).sample(everywhere, min(count, len(everywhere)))


def test_text_in_any_place_is_quoted_or_refused(opened: tuple[Any, Path]) -> None:
    data, folder = opened
    assert compiled(json.dumps(data), folder) is not None
    rng = random.Random(1)
    for path in some(data, 1):
        hostile = compiled(replaced(data, path, rng.choice(TEXTS), key=rng.random() < 0.3), folder)
        if hostile is not None:
            compile(hostile.code, "printed", "exec")
            assert MARK not in words(hostile.code), path


def test_unusual_values_in_any_place_give_a_world_that_runs_or_are_refused(opened: tuple[Any, Path]) -> None:
    data, folder = opened
    rng = random.Random(2)
    running = 0
    for path in some(data, 2, count=24):
        value = with_other_number(at(data, path), rng) if rng.random() < 0.7 else rng.choice(OTHERS)
        hostile = compiled(replaced(data, path, value), folder)
        if hostile is not None:
            with suppress(DeepbotsError), closing(api.build(hostile.program)) as world:
                world.reset(seed=0)
                world.step(world.action_space.sample())
                running += 1
    assert running > 3


@pytest.mark.parametrize(
    "name", ['x"', "a\nimport os", '"""', "os.system", "A", "", "naïve", "a b", "1a", "a;b"]
)
def test_a_name_that_is_not_an_identifier_is_never_printed(name: str) -> None:
    """The compiler lets none through; should it do so by mistake, nothing is printed."""
    program = api.compile("cartpole").program
    with pytest.raises(ValueError, match="name"):
        generate_module(program.with_agent(reward=(replace(program.agent.reward[0], name=name),)))
