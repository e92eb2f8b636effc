"""The compiled scenario as canonical JSON, and its digest.

Canonical means: keys sorted, no spaces, floats by their shortest exact form. Every record is an
object whose key `is` holds the class name. It is written and never read back: what is loaded is a scenario, which is compiled.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import PurePath

from deepbots_cli import ir
from deepbots_cli.ir.records import members, with_members
from deepbots_cli.robots import model


def to_json(scenario: ir.CompiledScenario) -> str:
    """Canonical JSON; equal scenarios give equal text."""
    return json.dumps(_plain(scenario), sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(scenario: ir.CompiledScenario) -> str:
    """SHA-256 of the canonical JSON, in hexadecimal; a file counts for what it holds, not for where it lies."""
    placeless = with_files(scenario, lambda file: replace(file, path=PurePath(file.path).suffix))
    return hashlib.sha256(to_json(placeless).encode()).hexdigest()


def task_digest(scenario: ir.CompiledScenario) -> str:
    """The digest of what makes an episode: the same for scenarios that differ in their names, training, evaluation or scripts alone."""
    nameless = replace(scenario, name="", summary="", scripts=())
    return digest(replace(nameless, training=None, curriculum=(), evaluation=ir.Evaluation(), cases=(), solved=None))


Filed = model.Mesh | ir.Picture
"""What has the path and the digest of a file."""


def with_files(scenario: ir.CompiledScenario, change: Callable[[Filed], Filed]) -> ir.CompiledScenario:
    """The scenario with each mesh and picture of its world changed."""
    world = _with_files(scenario.world, change)
    assert isinstance(world, ir.WorldModel)  # as it was
    if not (scenario.cases or scenario.curriculum):
        return replace(scenario, world=world)
    cases = tuple(replace(case, scenario=with_files(case.scenario, change)) for case in scenario.cases)
    curriculum = tuple(replace(stage, scenario=with_files(stage.scenario, change)) for stage in scenario.curriculum)
    return replace(scenario, world=world, cases=cases, curriculum=curriculum)


def _with_files(value: object, change: Callable[[Filed], Filed]) -> object:
    if isinstance(value, Filed):
        return change(value)
    inside = members(value)
    if inside is not None:
        return with_members(value, {name: _with_files(member, change) for name, member in inside.items()})
    return tuple(_with_files(item, change) for item in value) if isinstance(value, tuple) else value


def _plain(value: object) -> object:
    inside = members(value)
    if inside is not None:
        return {"is": type(value).__name__, **{name: _plain(member) for name, member in inside.items()}}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return {"is": "float", "value": repr(value)}
    return value
