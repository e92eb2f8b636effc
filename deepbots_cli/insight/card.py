"""The bundle of an exported policy: its graphs, a card that says what they take and return, and whether it fits a scenario.

    policy.onnx       the observation of the environment in, its action out
    policy_si.onnx    the same observation in SI units in, commands in SI units out
    card.json         names, units, ranges and rates, the result with its interval, versions
    README.md         the same for people
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from pydantic import BaseModel, ConfigDict

import deepbots_cli
from deepbots_cli.errors import RunError
from deepbots_cli.learning.listing import last_evaluation
from deepbots_cli.learning.run import Format, KeptEvaluation, ModelName, Run, read_json
from deepbots_cli.program import Program, identity
from deepbots_cli.program.task import ActionRange, Choices, viewed

FORMAT = 1
NAME = "card.json"
_LIMIT = 10_000_000
_LICENCE = re.compile(r"SPDX-License-Identifier:\s*([A-Za-z0-9][\w.+() -]*)")


class Observed(BaseModel):
    """A number of an input: `low` and `high`, in `unit`, stand for -1 and 1; a truth value is 0 or 1. `steps_ago` is 0 for the present."""

    name: str
    unit: str
    low: float
    high: float
    truth: bool = False
    clipped: bool = True
    steps_ago: int = 0


class Picture(BaseModel):
    """A picture: uint8 of `shape` (rows, columns, channels)."""

    name: str
    shape: tuple[int, ...]


class Acted(BaseModel):
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
    licences: Mapping[str, str]
    algorithm: str
    model: str
    training_seed: int
    training_steps: int | None
    engine: str
    control_period_s: float
    control_rate_hz: float
    observation: tuple[Observed, ...]
    achieved_and_desired_goal: tuple[Observed, ...]
    pictures: tuple[Picture, ...]
    action: tuple[Acted, ...]
    action_mask: tuple[str, ...] | None
    memory: tuple[int, int] | None
    """Layers and units of a recurrent policy."""
    result: KeptEvaluation | None
    interface: Mapping[str, str]
    files: Mapping[str, str]
    versions: Mapping[str, str]

    @property
    def result_text(self) -> str:
        """The result in a sentence."""
        return result_text(self.result) if self.result else "not evaluated since the end of the training"


def result_text(found: KeptEvaluation) -> str:
    """Mean return and success rate with their intervals, and what they are of."""
    low, high = found.return_interval or (found.mean_return, found.mean_return)
    text = f"mean return {found.mean_return:.4g} (95 % interval {low:.4g} .. {high:.4g})"
    if found.success_defined:
        low, high = found.success_interval
        text += f", success rate {found.success_rate:.1%} (95 % interval {low:.1%} .. {high:.1%})"
    solved = {True: "; solved", False: "; not solved", None: ""}[found.solved]
    return f"{text}, over {found.episodes:,} held-out episodes from seed {found.seed}{solved}"


def bundle(run: Run, name: ModelName) -> dict[PurePosixPath, bytes]:
    """The files of the bundle of a run.

    Raises:
        MissingExtraError: onnx or Stable-Baselines3 is not installed.
        RunError: There is no such model, or it is damaged.
        UsageError: The policy cannot be exported.
    """
    from deepbots_cli.insight import export
    from deepbots_cli.learning import models, policy

    model = policy.loaded(run, name)
    graphs = export.networks(model, run.program)
    evaluated = last_evaluation(run.path, run.record) if name == "best" else None
    program, record, lstm = run.program, run.record, getattr(model.policy, "lstm_actor", None)
    masks = [f"{part.name}: {option.name}" for part in program.policy.action if isinstance(part, Choices) for option in part.options]
    card = Card(
        format=FORMAT,
        deepbots=deepbots_cli.__version__,
        scenario=program.name,
        summary=program.summary,
        scenario_digest=run.digest,
        licences=_licences(run.path / "inputs"),
        algorithm=program.policy.training.algorithm if program.policy.training else "",
        model=name,
        training_seed=record.seed,
        training_steps=models.steps_of(run.model(name)),
        engine=record.engine,
        control_period_s=program.period,
        control_rate_hz=round(1 / program.period, 6),
        observation=tuple(_observed(program)),
        achieved_and_desired_goal=_goal(program),
        pictures=tuple(
            Picture(name=each.key, shape=(*each.shape[:2], each.shape[2] * len(each.ages(program.policy.frame_stack))))
            for each in program.policy.images
        ),
        action=tuple(_acted(program)),
        action_mask=tuple(masks) if export.takes_masks(model, program) else None,
        memory=(lstm.num_layers, lstm.hidden_size) if lstm is not None else None,
        result=evaluated[1] if evaluated else None,
        interface=identity.interface(program),
        files={name: hashlib.sha256(content).hexdigest() for name, content in graphs.items()},
        versions=record.versions,
    )
    texts = {NAME: card.model_dump_json(indent=2) + "\n", "README.md": readme(card)}
    return {PurePosixPath(name): content for name, content in [*graphs.items(), *((name, text.encode()) for name, text in texts.items())]}


def _observed(program: Program) -> list[Observed]:
    numbers = program.policy.numbers
    seen = [(numbers[index], age) for index, age in viewed(numbers, program.policy.frame_stack)]
    return [
        Observed(name=n.full_name, unit=n.unit.removeprefix("1"), low=n.low, high=n.high, truth=n.truth, clipped=n.clip, steps_ago=age)
        for n, age in seen
    ]


def _goal(program: Program) -> tuple[Observed, ...]:
    goal = program.policy.goal
    if goal is None:
        return ()
    rows = zip(goal.components or ("goal",), goal.low, goal.high, strict=True)
    return tuple(Observed(name=name, unit=goal.unit, low=low, high=high) for name, low, high in rows)


def _acted(program: Program) -> list[Acted]:
    found = []
    for part in program.policy.action:
        if isinstance(part, ActionRange):
            names = [f"{part.name}.{component}" for component in part.components] or [part.name]
            found += [Acted(name=name, unit=part.unit.removeprefix("1"), low=part.low, high=part.high) for name in names]
        else:
            options = {option.name: dict(zip(part.variables, option.values, strict=True)) for option in part.options}
            found.append(Acted(name=part.name, options=options))
    return found


def _licences(inputs: Path) -> dict[str, str]:
    """The SPDX identifiers in the scenario and robot files of a run, by file."""
    found = {}
    for path in sorted(inputs.rglob("*")):
        if path.suffix in (".yaml", ".urdf", ".xacro") and (match := _LICENCE.search(path.read_text("utf-8", errors="replace"))):
            found[path.relative_to(inputs).as_posix()] = match[1].strip(" -")
    return found


# The card for people


def readme(card: Card) -> str:
    """The README of a bundle."""
    lines = [
        f"# Policy for {card.scenario}",
        "",
        card.summary or "(the scenario has no summary)",
        "",
        f"- result: {card.result_text}",
        f"- rate: an action every {card.control_period_s:g} s ({card.control_rate_hz:g} Hz)",
        f"- trained with {card.algorithm}, {card.training_steps:,} steps, seed {card.training_seed}, engine {card.engine}; {card.model} model",
        f"- scenario: {card.scenario_digest}",
        f"- licence: {', '.join(f'{name}: {licence}' for name, licence in card.licences.items()) or 'none is given in the scenario'}",
        f"- versions: deepbots {card.deepbots}, {', '.join(f'{name} {number}' for name, number in card.versions.items())}",
        "",
        "`policy.onnx` takes observations of the Gymnasium environment and returns its actions. `policy_si.onnx` takes the same values in SI",
        "units, and returns commands in SI units; it scales and clips inside. Both run with onnxruntime alone. The first axis of each input",
        "and output is the batch.",
        "",
    ]
    for name, numbers in _inputs(card):
        lines += _table(
            f"Input `{name}`: float32 (batch, {len(numbers)})",
            ("index", "name", "unit", "stands for -1 .. 1", "steps ago"),
            [
                (at, n.name, n.unit, "0 or 1" if n.truth else f"{n.low:g} .. {n.high:g}{'' if n.clipped else ', not clipped'}", n.steps_ago)
                for at, n in enumerate(numbers)
            ],
        )
    lines += _table("Pictures: uint8 (batch, rows, columns, channels)", ("input", "shape"), [(p.name, p.shape) for p in card.pictures])
    if card.action_mask is not None:
        options = ", ".join(card.action_mask)
        lines += [f"Input `action_mask`: bool (batch, {len(card.action_mask)}), whether each option is allowed: {options}", ""]
    if card.memory is not None:
        shape = f"float32 ({card.memory[0]}, batch, {card.memory[1]})"
        lines += [f"Inputs `hidden` and `cell`: {shape}, zeros at the start of an episode, then the outputs `next_hidden` and `next_cell`", ""]
    lines += _table(
        "Output: `action` of `policy.onnx`, or `command` of `policy_si.onnx`; float32, and int64 for the number of an option",
        ("part", "`action`", "`command`"),
        [(part.name, *_acting(part)) for part in card.action],
    )
    feeds = [f'"{name}": np.zeros((1, {len(numbers)}), np.float32)' for name, numbers in _inputs(card)]
    feeds += [f'"{p.name}": np.zeros({(1, *p.shape)}, np.uint8)' for p in card.pictures]
    feeds += [f'"action_mask": np.ones((1, {len(card.action_mask)}), bool)'] if card.action_mask else []
    feeds += [f'"{name}": np.zeros({(card.memory[0], 1, card.memory[1])}, np.float32)' for name in ("hidden", "cell") if card.memory]
    lines += [
        "```python",
        "import numpy as np",
        "import onnxruntime",
        "",
        'policy = onnxruntime.InferenceSession("policy_si.onnx")',
        f"inputs = {{{', '.join(feeds)}}}",
        'command = policy.run(["command"], inputs)[0]',
        "```",
        "",
        "`deepbots export --check SCENARIO FOLDER` tells whether the policy in this folder fits a scenario.",
    ]
    return "\n".join(lines) + "\n"


def _inputs(card: Card) -> list[tuple[str, tuple[Observed, ...]]]:
    """The vectors that the graphs take."""
    found = [("observation", card.observation)] if card.observation else []
    return found + [(f"{name}_goal", card.achieved_and_desired_goal) for name in ("achieved", "desired") if card.achieved_and_desired_goal]


def _acting(part: Acted) -> tuple[str, str]:
    """What the action and the command of a part mean."""
    if not part.options:
        return "-1 .. 1", f"{part.low:g} .. {part.high:g} {part.unit}".rstrip()
    settings = (", ".join(f"{name} = {value:g}" for name, value in values.items()) for values in part.options.values())
    return "; ".join(f"{at}: {name}" for at, name in enumerate(part.options)), "; ".join(settings)


def _table(title: str, head: tuple[str, ...], rows: list[tuple[Any, ...]]) -> list[str]:
    if not rows:
        return []
    cells = [head, ("---",) * len(head), *rows]
    return [title, "", *("| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in cells), ""]


# Whether it fits


def read(folder: Path) -> Card:
    """The card of a bundle whose graphs are as they were exported.

    Raises:
        RunError: The folder is no bundle, its card is damaged or of another format, or a graph has changed.
    """
    if not (folder / NAME).is_file():
        raise RunError(f"{folder} is not a bundle of `deepbots export`: it holds no {NAME}")
    found = read_json(folder / NAME, Format, _LIMIT).format
    if found != FORMAT:
        raise RunError(f"{folder} is a bundle of format {found}, this deepbots reads {FORMAT}; use the deepbots that wrote it")
    card = read_json(folder / NAME, Card, _LIMIT)
    for name, digest in card.files.items():
        path = folder / PurePosixPath(name).name
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            raise RunError(f"{path} is {'not the file that was exported' if path.is_file() else 'missing'}; export the run again")
    return card


def differences(card: Card, program: Program) -> list[str]:
    """A line for each item of the interface that bundle and scenario do not share; empty if the policy fits."""
    return identity.compare(card.interface, identity.interface(program), words=("bundle", "scenario"))


def remarks(card: Card, program: Program, digest: str) -> list[str]:
    """What differs although the policy fits, a sentence each."""
    found = []
    if not math.isclose(card.control_period_s, program.period):
        found.append(f"the policy was trained with an action every {card.control_period_s:g} s, the scenario takes one every {program.period:g} s")
    if card.scenario_digest != digest:
        found.append("the scenario differs from that of the training in something else than the interface; `deepbots diff` shows it")
    return found
