"""Sensors of a compiled scenario from elsewhere: refused, or built and run; never code, never a traceback."""

from __future__ import annotations

import json
import random
from contextlib import closing, suppress
from functools import cache
from typing import Any

import pytest
from tests.emit.test_emit_hostile import DATA, MARK, OTHERS, TEXTS, canonical, code_of, places, replaced, words

from deepbots_cli import api
from deepbots_cli.canonical import CanonicalError, from_json
from deepbots_cli.compiler.emit import emit
from deepbots_cli.errors import DeepbotsError

SOURCE = str(DATA / "sensed.yaml")
Place = tuple[Any, ...]


@cache
def of_sensors(number: int, seed: int) -> list[Place]:
    """Some places in the sensors and in what varies of them."""
    found = [path for path in places(json.loads(canonical(SOURCE))) if "sensors" in path or "variations" in path]
    return random.Random(seed).sample(found, number)


def test_text_in_a_sensor_is_quoted_or_refused() -> None:
    rng = random.Random(1)
    for path in of_sensors(150, 1):
        code = code_of(replaced(canonical(SOURCE), path, rng.choice(TEXTS)))
        if code is not None:
            compile(code, "printed", "exec")
            assert MARK not in words(code), path


def test_odd_values_in_a_sensor_give_a_world_that_runs_or_are_refused() -> None:
    rng = random.Random(2)
    for path in of_sensors(60, 2):
        text = replaced(canonical(SOURCE), path, rng.choice((*OTHERS, -1.0, 0.0, 1e9, 1e-9)))
        with suppress(DeepbotsError), closing(api.build(from_json(text))) as world:
            world.reset(seed=0)
            world.step(world.action_space.sample())


def test_lists_of_another_length_in_a_sensor_give_a_world_that_runs_or_are_refused() -> None:
    text = canonical(SOURCE)
    lists = {path[:end] for path in of_sensors(120, 3) for end, key in enumerate(path) if isinstance(key, int) and end > 2}
    for path in random.Random(4).sample(sorted(lists, key=str), 25):
        items = json.loads(text)
        for key in path:
            items = items[key]
        for others in ([], items[:-1], items * 2):
            with suppress(DeepbotsError), closing(api.build(from_json(replaced(text, path, others)))) as world:
                world.reset(seed=0)
                world.step(world.action_space.sample())


def sensor(name: str) -> Place:
    sensors = json.loads(canonical(SOURCE))["robots"][0]["sensors"]
    return ("robots", 0, "sensors", next(index for index, entry in enumerate(sensors) if entry["name"] == name))


@pytest.mark.parametrize(
    ("name", "path", "value"),
    [
        ("gyro", ("kind",), "telepathy"),
        ("gyro", ("faults", "noise"), [0.1]),
        ("gps", ("faults", "latency"), 1e9),
        ("speed", ("faults", "period"), 0),
        ("angle", ("faults", "quantise"), [0.0, 0.0]),
        ("angle", ("components",), ["left_wheel"]),
        ("near", ("beams", "lookup", "distance"), [0.02, 0.01, 0.03]),
        ("near", ("beams", "lookup", "noise"), [0.1]),
        ("near", ("beams", "reach"), 0.0),
        ("scan", ("beams", "rays"), []),
        ("camera", ("optics", "width"), 100_000),
        ("camera", ("optics", "fov"), 4.0),
        ("camera", ("optics",), None),
    ],
)
def test_a_sensor_that_cannot_be_is_refused_before_anything_is_built(name: str, path: Place, value: Any) -> None:
    with pytest.raises(CanonicalError):
        emit(from_json(replaced(canonical(SOURCE), (*sensor(name), *path), value)))
