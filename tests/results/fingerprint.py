"""Digests of what a scenario asks for: a figure counts for as long as its digest is that of the scenario as it stands.

They leave out what no figure depends on: the summary, where files lie, and whatever is as it would be by default, so that a new
feature of the language leaves the figures of scenarios without it alone. The digest of a training knows nothing of the evaluation,
so that a new case does not ask for a new training; that of an evaluation knows nothing of the training.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, fields, replace
from functools import cache
from pathlib import PurePath
from typing import Any

from deepbots_cli import api
from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.program import Program, identity
from deepbots_cli.program.identity import members
from deepbots_cli.program.task import Evaluation
from tests.results.experiment import Baseline, Training
from tests.results.experiment import Evaluation as HeldOut
from tests.results.places import ROOT


@cache
def compiled(scenario: str, sets: tuple[str, ...] = ()) -> Program:
    """A shipped scenario by name, or one by its path from the root of the repository."""
    file = ROOT / scenario
    return api.compile(str(file) if file.suffix == ".yaml" and file.is_file() else scenario, sets=sets).program


def of_training(scenario: str, training: Training) -> str:
    program = _with(compiled(scenario, training.sets), {"scripts": ()})
    # To evaluate in cases that came after a training is to name the scenario, which takes no settings.
    return digest(program if training.sets else _with(program, {}, cases=(), evaluation=Evaluation()))


def of_evaluation(scenario: str, training: Training, evaluation: HeldOut) -> str:
    program = compiled(evaluation.scenario) if evaluation.scenario else compiled(scenario, training.sets)
    chosen = program if evaluation.case is None else program.case(evaluation.case).program
    return digest(_with(chosen, {"scripts": (), "training": None}, curriculum=()))


def of_baseline(scenario: str, baseline: Baseline) -> str:
    program = compiled(scenario)
    chosen = program if baseline.case is None else program.case(baseline.case).program
    scripts = program.policy.scripts if "--script" in baseline.options else ()
    return digest(_with(chosen, {"scripts": scripts, "training": None}, curriculum=(), cases=(), evaluation=Evaluation()))


def _with(program: Program, policy: Mapping[str, Any], **changes: Any) -> Program:
    """The scenario with other fields, also of its policies, in its cases and stages too."""
    cases = tuple(replace(case, program=_with(case.program, policy, **changes)) for case in program.cases)
    curriculum = tuple(replace(stage, program=_with(stage.program, policy, **changes)) for stage in program.curriculum)
    return replace(program.with_policies(**policy), **{"cases": cases, "curriculum": curriculum, **changes})


def digest(program: Program) -> str:
    """SHA-256, in hexadecimal, of all that differs from a default."""
    placeless = identity.with_files(_with(program, {}, summary=""), lambda file: replace(file, path=PurePath(file.path).suffix))
    return hashlib.sha256(json.dumps(_told(placeless), sort_keys=True).encode()).hexdigest()


def _told(value: object) -> Any:
    inside = members(value)
    if inside is not None:
        defaults = _defaults(type(value))
        return {"is": type(value).__name__} | {name: _told(given) for name, given in inside.items() if given != defaults.get(name, MISSING)}
    if isinstance(value, Mapping):
        return {name: _told(item) for name, item in value.items()}
    return [_told(item) for item in value] if isinstance(value, tuple) else value


@cache
def _defaults(kind: type) -> dict[str, Any]:
    if issubclass(kind, Scalar):
        return kind._field_defaults
    return {field.name: field.default if field.default_factory is MISSING else field.default_factory() for field in fields(kind)}
