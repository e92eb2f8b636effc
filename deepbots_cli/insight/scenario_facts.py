"""What the scenario of a run has already, the findings of `deepbots lint` about it, and the command that
trains it again."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from shlex import join

from deepbots_cli import api, engine_kinds
from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.conditions import comparisons
from deepbots_cli.analysis.ranges import Terms, measured_subjects, total_range, uses_earlier_values
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.findings import Source as Text
from deepbots_cli.document import Node, Permissions, shipped
from deepbots_cli.document.files import MAX_BYTES
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar
from deepbots_cli.expressions.types import Known
from deepbots_cli.files import read_at_most
from deepbots_cli.insight.statements import quantity_text
from deepbots_cli.learning.runs.run import Run, changed_settings
from deepbots_cli.program import Program
from deepbots_cli.program.task import ObservedNumber
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import Source, SourceKind


class ScenarioFacts:
    """What a scenario already contains, and the units of its file.

    Args:
        program: The scenario.
        units: The units of its file.
    """

    def __init__(self, program: Program, units: ShownUnits | None = None) -> None:
        self.program = program
        self.units = units or ShownUnits()

    @cached_property
    def _analysis(self) -> Analysis:
        return Analysis(self.program)

    # Observation

    @property
    def history(self) -> int:
        """The longest history of a value of the observation, in steps; 1 if the policy observes the newest
        values only."""
        return max((entry.history for entry in self.program.agent.observation), default=1)

    def is_measured(self, number: ObservedNumber) -> bool:
        """Return whether a number of the observation may differ in each step: it is not a parameter, and no
        value that depends on parameters alone."""
        entry = next(entry for entry in self.program.agent.observation if entry.name == number.name)
        known_when = entry.value.typed.type.known
        return entry.value.foreign is not None or known_when is Known.STEP or entry.noise is not None

    def observes(self, name: str) -> bool:
        """Return whether the observation depends on a value, such as a drawn parameter. The effect of the
        value in the world is ignored."""
        trees = [tree for entry in self.program.agent.observation for tree in entry.value.scalars]
        return any(name in self._analysis.dependencies(tree) for tree in trees)

    # Reward

    @cached_property
    def terms_towards_success(self) -> tuple[str, ...]:
        """The terms that can pay in ordinary steps, and depend on what the success measures; progress
        first."""
        running = self._analysis.reward.ranges_while_running()
        terms = sorted(
            self._terms_of_success, key=lambda entry: not uses_earlier_values(self._analysis, entry[1])
        )
        return tuple(term.name for term, node in terms if running.of(node).high > 0.0)

    @property
    def _terms_of_success(self) -> Terms:
        """The terms of ordinary steps that depend on what the success measures."""
        goal, (ordinary, _) = self.program.agent.goal, self._analysis.reward.split_by_end()
        successes = (success for success in self.program.successes if success.foreign is None)
        trees = [tree for success in successes for tree in self._analysis.scalars(success)]
        trees += goal.achieved.scalars if goal is not None else ()
        aims = {subject for tree in trees for subject in measured_subjects(self._analysis, tree)}
        return [
            (term, node)
            for term, node in ordinary
            if aims.intersection(measured_subjects(self._analysis, node))
        ]

    @property
    def unpaid_quantity(self) -> tuple[str, str] | None:
        """The quantity that a success compares if no term of ordinary steps depends on what the successes
        measure, and a term that pays for its change; None if there is none, or if it is unknown."""
        agent = self.program.agent
        if agent.goal or any(term.foreign for term in agent.reward) or self._terms_of_success:
            return None
        compared = (pair for end in self.program.successes for pair in comparisons(self._analysis, end))
        for value, node in compared:
            signs = ("-", "") if node.operator.startswith("less") else ("", "-")
            for side, sign in zip(node.args, signs, strict=True):
                trees, unit = self._analysis.lowered(side, value.owner), str(side.type.dimension or NUMBER)
                if (
                    len(trees) == 1
                    and unit != "s"
                    and next(measured_subjects(self._analysis, trees[0]), None)
                ):
                    text = value.text[side.start : side.end]
                    per = {"1": ""}.get(unit, f" / {unit}" if unit.isidentifier() else f" / ({unit})")
                    return text, f"{sign}10 * delta({text}){per}"
        return None

    @cached_property
    def pays_in_ordinary_steps_only(self) -> bool:
        """Whether ordinary steps can pay, and a success itself does not, so that no reward comes late."""
        reward = self._analysis.reward
        running, (ordinary, final) = reward.ranges_while_running(), reward.split_by_end()
        at_success = [
            total_range(final, reward.ranges_at(success)).high for success in self.program.successes
        ]
        return any(running.of(node).high > 0.0 for _, node in ordinary) and not any(
            paid > 0.0 for paid in at_success
        )

    def terms_about(self, comparison: str) -> tuple[str, ...]:
        """Return the terms of ordinary steps that depend on the values of a comparison of the success, given
        by its text."""
        aims = {
            reading
            for ending in self.program.successes
            for compared in comparisons(self._analysis, ending)
            if compared.value.text[compared.node.start : compared.node.end] == comparison
            for tree in self._analysis.lowered(compared.node, compared.value.owner)
            for reading in self._readings(tree)
        }
        ordinary, _ = self._analysis.reward.split_by_end()
        return tuple(term.name for term, node in ordinary if aims.intersection(self._readings(node)))

    def uses_earlier_values(self, term: str) -> bool:
        """Return whether a term depends on earlier values, as with `delta`."""
        nodes = [node for entry, node in self._analysis.reward.terms if entry.name == term]
        return any(uses_earlier_values(self._analysis, node) for node in nodes)

    def price_of(self, failure: str) -> float | None:
        """Return the reward of a failure by terms that pay only at an end: negative for a cost, None if it is
        unknown."""
        reward = self._analysis.reward
        ending = next((ending for ending in self.program.endings if ending.name == failure), None)
        _, final = reward.split_by_end()
        if ending is None or not reward.is_complete:
            return None
        price = total_range(final, reward.ranges_at(ending))
        return price.low if price.is_single else None

    def _readings(self, tree: Scalar) -> Iterator[int]:
        """Yield the values of the world and of sensors that a value is computed from, as numbers of
        `Analysis.identity`."""
        for node in self._analysis.walk_definitions(tree):
            if isinstance(node, EngineRead) or (
                isinstance(node, Name) and self._analysis.sensor(node) is not None
            ):
                yield self._analysis.identity(node)

    # Units

    def seen_text(self, number: ObservedNumber, value: float) -> str:
        """Return a number of the observation, from -1 to 1, as the value that it represents, in the unit of
        its range in the file."""
        if number.is_truth:
            return "true" if value else "false"
        shown = number.low + (value + 1) / 2 * (number.high - number.low)
        return quantity_text(shown, self.units.of_entry(number.full_name, number.unit))


@dataclass(frozen=True, eq=False)
class LintedScenario:
    """The scenario of a run as `deepbots lint` reads it.

    Attributes:
        arguments: The arguments of `deepbots lint`, quoted for a shell.
        findings: The findings of lint.
        text: The file that the arguments name.
        is_whole: Whether this file alone is the scenario, without other files and without `--set`.
        changed_source: The file that the training read, if it is another one now.
        root: The scenario as nodes with their positions in the file.
    """

    arguments: str
    findings: Sequence[Finding]
    text: Text | None
    is_whole: bool
    changed_source: str = ""
    root: Node | None = None


def linted_scenario(run: Run) -> LintedScenario:
    """Return the scenario of a run and its findings.

    It is the file that the training read, while that gives the same scenario, else the copy in the run. Both
    have the comments that ignore findings, and show which part comes from an included robot. `resolved.yaml`
    takes their place if they give another scenario, as after a change in Python.
    """
    record, folder = run.record, run.path / INPUTS_FOLDER
    overrides = changed_settings(record.command)
    further = [f"--set={text}" for text in overrides]
    name = next(iter(record.inputs), RESOLVED_NAME)
    original, copy, source = Path(record.source), folder / name, named_source(record.source)
    code = Permissions(code=True)  # Making a world checks again whether Python functions may run.
    is_same = _digest(original) == record.inputs.get(name)
    places = [
        (Source(SourceKind.SCENARIO, str(copy), copy, copy, code), [str(copy), *further]),
        (replace(Source.kept(folder), scenario=copy), [str(copy), "--allow-path", str(folder), *further]),
    ]
    if is_same:
        own = Source(SourceKind.SCENARIO, source, original, original, code)
        places.insert(0, (own, [source, *further]))
    compiled, arguments = run.compiled, [str(run.path / RESOLVED_NAME)]
    for place, words in places:
        with suppress(DeepbotsError):
            candidate = api.compile(place, overrides=with_engine(overrides, record.engine))
            if candidate.digest == run.digest:
                compiled, arguments = candidate, words
                break
    document = compiled.document
    return LintedScenario(
        join(arguments),
        compiled.findings,
        None if document is None else document.source,
        is_whole=document is not None and len(document.files) < 2 and len(arguments) == 1,
        changed_source=source if original.is_file() and not is_same else "",
        root=None if document is None else document.root,
    )


def _digest(path: Path) -> str | None:
    """Return the digest of a file as in a record; None if it is not a file, or too large for a scenario."""
    try:
        return hashlib.sha256(read_at_most(path, MAX_BYTES + 1)).hexdigest() if path.is_file() else None
    except OSError:
        return None


def named_source(source: str) -> str:
    """Return the scenario of a record as an argument of a command: the name of a shipped one, else its
    path."""
    path = Path(source)
    is_shipped = path.name == f"{path.stem}.yaml" and shipped.scenario_path(path.stem) == path
    return path.stem if is_shipped else source


_KEPT_OPTIONS = (
    *("--agent", "--against", "--initialize-from", "--keep-checkpoints"),
    *("--callback", "--logger", "--allow-path"),
)
"""The options of `train` whose values only the command line of a run has as they were written."""


def training_command(run: Run, assignments: Sequence[str]) -> list[str]:
    """Return the command that trains the scenario of a run again, with its seed, options and `--set`, and
    further assignments."""
    record, settings = run.record, dict[str, str]()
    for text in (*changed_settings(record.command), *assignments):
        path, _, value = text.partition("=")
        settings.pop(path, None)
        settings[path] = value
    options = {word.partition("=")[0] for word in record.command}
    words = ["deepbots", "train", named_source(record.source), "--seed", str(record.seed)]
    training = run.program.agent.training
    if (
        training is not None
        and record.total_timesteps != training.total_timesteps
        and "train.total_timesteps" not in settings
    ):
        words += ["--timesteps", str(record.total_timesteps)]
    teacher = training.teacher if training is not None and "--teacher" in options else None
    if teacher is not None and "train.teacher" not in settings:
        words += ["--teacher", teacher.script]
    if run.demonstrations.exists():
        words += ["--teacher", str(run.demonstrations)]
    if run.teacher.exists():
        words += ["--teacher", str(run.teacher)]
    for path, value in settings.items():
        words += ["--set", f"{path}={value}"]
    if "--engine" in options or record.engine != engine_kinds.chosen(run.program.engine):
        words += ["--engine", record.engine]
    if training is not None and "--shards" in options:
        words += ["--shards", str(training.shards)]  # `auto` of earlier versions chose them
    if record.first_stage is not None:
        words += ["--stage", record.first_stage]
    if not record.stop_when_solved:
        words.append("--full")
    words += _kept_options(record.command)
    if "--allow-code" in options:
        words.append("--allow-code")
    return words


def _kept_options(command: Sequence[str]) -> Iterator[str]:
    """Yield the options of a command line that are kept as they are, with their values."""
    for word, following in pairwise((*command, "")):
        name, has_value, value = word.partition("=")
        if name in _KEPT_OPTIONS:
            yield from (name, value if has_value else following)
