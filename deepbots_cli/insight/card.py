"""The bundle of an exported policy: its graphs, a card that describes their inputs and outputs, and whether it fits a scenario.

policy.onnx       the observation of the environment in, its action out
policy_si.onnx    the same observation in SI units in, commands in SI units out
card.json         names, units, ranges and rates, the result with its interval, versions
README.md         the same for people
scenario.yaml     the scenario, which defines the names; its robot files are in the folder inputs
"""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

import deepbots_cli
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME
from deepbots_cli.errors import MissingExtraError, RunError
from deepbots_cli.learning.run import EvaluationRecord, ModelName, RecordFormat, Run, read_json
from deepbots_cli.learning.verdict import RunVerdict, run_verdict
from deepbots_cli.program import Program, identity
from deepbots_cli.program.task import ActionRange, ObservedValue

FORMAT = 4
CARD_NAME = "card.json"
GRAPH_FILES = ("policy.onnx", "policy_si.onnx")
_MAX_CARD_BYTES = 10_000_000
_MAX_GRAPH_BYTES = 1 << 31  # bytes, that of a protobuf message
_LICENSE = re.compile(r"SPDX-License-Identifier:\s*([A-Za-z0-9][\w.+() -]*)")


class CardImage(BaseModel):
    """A picture: uint8 of `shape` (rows, columns, channels)."""

    name: str
    shape: tuple[int, ...]


class CardAction(BaseModel):
    """A part of the action: a choice, with the values that each option sets by variable, or a number, of which -1 and 1 mean a range."""

    name: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    options: Mapping[str, Mapping[str, float]] = {}


class Card(BaseModel):
    """The content of `card.json`. Digests are SHA-256; `interface` is what `deepbots export --check` compares; rates are simulated time."""

    model_config = ConfigDict(frozen=True)

    format: int
    deepbots: str
    scenario: str
    summary: str
    scenario_digest: str
    task_digest: str
    licenses: Mapping[str, str]
    algorithm: str
    model: str
    training_seed: int
    training_steps: int | None
    engine: str
    control_period_s: float = Field(gt=0, allow_inf_nan=False)
    control_rate_hz: float
    observation: tuple[ObservedValue, ...]
    achieved_and_desired_goal: tuple[ObservedValue, ...]
    pictures: tuple[CardImage, ...]
    action: tuple[CardAction, ...]
    action_mask: tuple[str, ...] | None
    memory: tuple[int, int] | None
    """Layers and units of a recurrent policy."""
    result: EvaluationRecord | None
    solved: bool | None = None
    interface: Mapping[str, Mapping[str, str]]
    files: Mapping[str, str]
    versions: Mapping[str, str]

    @property
    def result_text(self) -> str:
        """The result in a sentence."""
        return RunVerdict(self.solved, self.result).text


def bundle_files(run: Run, name: ModelName) -> dict[PurePosixPath, bytes]:
    """The files of the bundle of a run.

    Raises:
        MissingExtraError: onnx or what learns is not installed.
        RunError: There is no such model, or it is damaged.
        UsageError: The policy cannot be exported.
    """
    try:
        from deepbots_cli.insight import export
        from deepbots_cli.learning import policy
        from deepbots_cli.learning.learner import steps_of
        from deepbots_cli.runtime.spaces import observation_space
    except ModuleNotFoundError as error:
        raise MissingExtraError("export", "exporting a policy") from error
    learner = policy.loaded(run, name)
    graphs = export.networks(learner, run.program)
    verdict = run_verdict(run.path, run.record) if name == "best" else RunVerdict(None, None)
    program, record, lstm = run.program, run.record, learner.network().memory
    space: Any = observation_space(program.agent)
    masks = [f"{part.name}: {option.name}" for part in program.agent.choices for option in part.options]
    card = Card(
        format=FORMAT,
        deepbots=deepbots_cli.__version__,
        scenario=program.name,
        summary=program.summary,
        scenario_digest=run.digest,
        task_digest=identity.task_digest(program),
        licenses=_licenses(run.path / INPUTS_FOLDER),
        algorithm=program.agent.training.algorithm if program.agent.training else "",
        model=name,
        training_seed=record.seed,
        training_steps=steps_of(run.model(name)),
        engine=record.engine,
        control_period_s=program.period,
        control_rate_hz=round(1 / program.period, 6),
        observation=program.agent.inputs,
        achieved_and_desired_goal=program.agent.goal.values if program.agent.goal else (),
        pictures=tuple(CardImage(name=each.key, shape=space[each.key].shape) for each in program.agent.images),
        action=tuple(_card_actions(program)),
        action_mask=tuple(masks) if export.takes_masks(learner, program) else None,
        memory=(lstm.num_layers, lstm.hidden_size) if lstm is not None else None,
        result=verdict.evaluation,
        solved=verdict.solved,
        interface=identity.interface(program),
        files={name: hashlib.sha256(content).hexdigest() for name, content in graphs.items()},
        versions=record.versions,
    )
    goal = card.achieved_and_desired_goal
    vectors = {"observation": card.observation, "achieved_goal": goal, "desired_goal": goal}
    readme = render_template("bundle.md.j2", card=card, vectors={name: numbers for name, numbers in vectors.items() if numbers})
    # The scenario names the copies of its robot files; the YAML files that it was put together from are in it.
    robots = [name for name in record.inputs if not name.endswith((".yaml", ".yml"))]
    files = {
        **graphs,
        CARD_NAME: (card.model_dump_json(indent=2) + "\n").encode(),
        "README.md": readme.encode(),
        "scenario.yaml": (run.path / RESOLVED_NAME).read_bytes(),
        **{f"{INPUTS_FOLDER}/{name}": (run.path / INPUTS_FOLDER / name).read_bytes() for name in robots},
    }
    return {PurePosixPath(name): content for name, content in files.items()}


def _card_actions(program: Program) -> list[CardAction]:
    found = []
    for part in program.agent.action:
        if isinstance(part, ActionRange):
            found += [CardAction(name=name, unit=part.unit.removeprefix("1"), low=part.low, high=part.high) for name in part.names]
        else:
            options = {option.name: dict(zip(part.variables, option.values, strict=True)) for option in part.options}
            found.append(CardAction(name=part.name, options=options))
    return found


def _licenses(inputs: Path) -> dict[str, str]:
    """The SPDX identifiers in the scenario and robot files of a run, by file."""
    found = {}
    for path in sorted(inputs.rglob("*")):
        if path.suffix in (".yaml", ".urdf", ".xacro") and (match := _LICENSE.search(path.read_text("utf-8", errors="replace"))):
            found[path.relative_to(inputs).as_posix()] = match[1].strip(" -")
    return found


def render_template(template: str, *, html: bool = False, **values: Any) -> str:
    """The text of a template of this package."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    known = Environment(
        loader=PackageLoader("deepbots_cli.insight", "."), undefined=StrictUndefined, autoescape=html,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    return known.get_template(template).render(**values)


# Whether it fits


def read_card(folder: Path) -> Card:
    """The card of a bundle whose graphs are as they were exported.

    Raises:
        RunError: The folder is no bundle, its card is damaged or of another format, or a graph has changed.
    """
    if not (folder / CARD_NAME).is_file() or (folder / CARD_NAME).is_symlink():
        raise RunError(f"{folder} is not a bundle of `deepbots export`: it contains no {CARD_NAME}")
    found = read_json(folder / CARD_NAME, RecordFormat, _MAX_CARD_BYTES).format
    if found != FORMAT:
        raise RunError(
            f"{folder} is a bundle of format {found}, but this version of deepbots reads {FORMAT}; use the version that wrote it"
        )
    card = read_json(folder / CARD_NAME, Card, _MAX_CARD_BYTES)
    for name in GRAPH_FILES:
        path = folder / name
        if path.is_symlink() or not path.is_file():
            raise RunError(f"{path} is {'missing' if not os.path.lexists(path) else 'no regular file'}; export the run again")
        with path.open("rb") as file:
            if path.stat().st_size > _MAX_GRAPH_BYTES or hashlib.file_digest(file, "sha256").hexdigest() != card.files.get(name):
                raise RunError(f"{path} is not the file that was exported; export the run again")
    return card


def remarks(card: Card, program: Program, diff: str) -> list[str]:
    """Differences of a scenario that the policy fits, one sentence each; `diff` is the command that shows all differences."""
    found = []
    if not math.isclose(card.control_period_s, program.period):
        found.append(
            f"the policy was trained with an action every {card.control_period_s:g} s, but the scenario has one every {program.period:g} s"
        )
    if card.task_digest != identity.task_digest(program):
        found.append(f"rewards, endings, starts or the world differ from the training; to see the differences, run: {diff}")
    return found
