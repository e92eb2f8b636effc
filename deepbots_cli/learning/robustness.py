"""Robustness: a policy under conditions that it was not trained for, one changed at a time and by several
amounts.

Each condition is a change of the scenario, laid upon it as a file upon the one that it `extends`, and
compiled anew. The changes therefore apply to any scenario that has such values. All levels have the same
starts.

A condition has one side or two: a latency only grows, and a mass may be smaller or larger. The levels of a
side are ordered by their distance from the unchanged scenario.
"""

from __future__ import annotations

import glob
import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.compiler import CheckedScenario, check
from deepbots_cli.compiler.agents import sections_of_agents
from deepbots_cli.diagnostics import Findings
from deepbots_cli.diagnostics import Source as SourceText
from deepbots_cli.document import Document, MappingNode, Node, Permissions, ScalarNode, SequenceNode
from deepbots_cli.document.load import TESTS, merge, with_settings_at
from deepbots_cli.document.nodes import NodePath, entries_at, node_at, to_data, without_paths
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import DeepbotsError, ScenarioError, UsageError
from deepbots_cli.expressions.lower import constant_values
from deepbots_cli.expressions.parser import parse as parse_expression
from deepbots_cli.expressions.syntax import Binary, Redrawn
from deepbots_cli.expressions.types import walk
from deepbots_cli.learning.evaluation import evaluate
from deepbots_cli.learning.executor import SERIAL, Attempt, Counter, Executor, results
from deepbots_cli.learning.runs.episodes import check_common_measure, check_defines_success
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.order import Measure, measure_of
from deepbots_cli.learning.runs.run import ModelName, ModelRef, Run
from deepbots_cli.learning.runs.statistics import Interval
from deepbots_cli.program import Program
from deepbots_cli.program.resets import OfLink
from deepbots_cli.program.task import Agent
from deepbots_cli.program.world import ObjectBody
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import RECORD_NAME, Source, SourceKind
from deepbots_cli.words import sentence_list

EPISODES_PER_LEVEL = 50
"""The number of episodes of a level, unless the scenario has fewer."""
LATENCY_STEPS = (1, 2, 4, 8)
LOSS_RATES = (0.05, 0.1, 0.2, 0.4)
NOISE_SHARES = (0.01, 0.02, 0.05, 0.1)
FACTORS: dict[str, tuple[float, ...]] = {"smaller": (0.75, 0.5), "larger": (1.25, 1.5, 2.0)}
"""Factors on a mass or a friction by side, from the smallest change on."""
STRENGTH_FACTORS = (0.9, 0.75, 0.5, 0.25)
FACTOR = "x {:g}"
"""The format of a factor."""
DELAY = "+{:g} ms"
"""The format of a longer time in ms."""
_MAX_NAMED = 4
"""The number of bodies that the condition of the friction names; more are counted."""
SHARE_OF_NOMINAL = 0.8
"""The required score if neither the caller nor the scenario sets one: 80 % of the success rate or mean return
without any change."""

Change = dict[str, Any]
"""The keys of a scenario that replace or add to those of the scenario that it extends."""


@dataclass(frozen=True)
class RobustnessLevel:
    """One amount of a condition: its label, such as `+64 ms`, and the evaluation.

    `holds` is true if the score reaches the required one, `certain` if its 95 % interval excludes the
    required one. `interval` is that of the score; None for a single episode.
    """

    level: str
    evaluation: EvaluationResult
    holds: bool
    certain: bool
    interval: Interval | None


@dataclass(frozen=True)
class Side:
    """The levels of a condition in one direction, from the smallest change on.

    `name` is `smaller` or `larger`, or empty if the condition has only one direction.
    """

    derived: ClassVar = ("verdict", "holds_up_to", "fails_from")

    name: str
    levels: tuple[RobustnessLevel, ...]

    @property
    def holds_up_to(self) -> str | None:
        """The last level up to which every score reaches the required one."""
        return next((entry.level for entry in reversed(self._held)), None)

    @property
    def fails_from(self) -> str | None:
        """The first level from which on every score is below the required one."""
        return next((entry.level for entry in self._failed), None)

    @property
    def verdict(self) -> str:
        """The verdict in words: `holds up to` a level, `fails from` a level, and the levels between them
        whose scores do not follow this order."""
        parts = []
        if self._held:
            *easier, last = self._held
            parts.append(f"holds up to {last.level}{_surely('up to', last, easier[::-1])}")
        if self._failed:
            first, *harder = self._failed
            parts.append(f"fails from {first.level}{_surely('from', first, harder)}")
        between = self.levels[len(self._held) : len(self.levels) - len(self._failed)]
        if not between:
            return ", ".join(parts)
        if _may_be_ordered(between):
            remark = (
                f"not decided at {sentence_list([entry.level for entry in between])}, which do not differ"
                " within their intervals"
            )
        else:
            failing, holding = (
                sentence_list([entry.level for entry in between if entry.holds is holds])
                for holds in (False, True)
            )
            remark = f"fails at {failing} but holds at {holding}: here, a larger change is not always harder"
        return "; ".join([*([", ".join(parts)] if parts else []), remark])

    @property
    def _held(self) -> list[RobustnessLevel]:
        return list(takewhile(lambda entry: entry.holds, self.levels))

    @property
    def _failed(self) -> list[RobustnessLevel]:
        return list(takewhile(lambda entry: not entry.holds, reversed(self.levels)))[::-1]


def _surely(words: str, boundary: RobustnessLevel, levels: Sequence[RobustnessLevel]) -> str:
    """Return a remark on a boundary that is not significant: the nearest level on its side of the boundary
    that is."""
    if boundary.certain:
        return ""
    sure = next((entry.level for entry in levels if entry.certain), None)
    return f" ({words} {sure} with 95 % confidence)" if sure else " (not significant)"


def _may_be_ordered(levels: Sequence[RobustnessLevel]) -> bool:
    """Return whether scores within the intervals can fall from level to level. An unknown interval allows all
    scores."""
    intervals = [entry.interval for entry in levels if entry.interval is not None]
    return all(after[0] <= before[1] for index, after in enumerate(intervals) for before in intervals[:index])


@dataclass(frozen=True)
class Condition:
    """A changed condition at all of its levels.

    `skipped` is the reason why this scenario cannot be changed in this way; `sides` is empty then.
    """

    name: str
    sides: tuple[Side, ...]
    skipped: str | None = None

    @property
    def levels(self) -> tuple[RobustnessLevel, ...]:
        """The levels of all sides."""
        return tuple(entry for side in self.sides for entry in side.levels)

    @property
    def verdicts(self) -> dict[str, str]:
        """The verdict of each side, by the name of condition and side."""
        if self.skipped is not None:
            return {self.name: f"not measured: {self.skipped}"}
        return {f"{self.name}, {side.name}" if side.name else self.name: side.verdict for side in self.sides}


@dataclass(frozen=True)
class Robustness:
    """A policy under changed conditions.

    `metric` is the measure that is compared with `bar`: that of the required score, else the measure of the
    task. `nominal` is the evaluation without any change. `bar` is None if no score is
    required, and the policy never succeeds without any change. `conditions` are then empty.
    """

    derived: ClassVar = ("nominal_holds", "nominal_certain")

    run: Path
    scenario: str
    metric: Measure
    bar: float | None
    bar_source: str
    nominal: EvaluationResult
    conditions: tuple[Condition, ...]

    @property
    def nominal_holds(self) -> bool:
        """Whether the score reaches the required one without any change."""
        return self.bar is not None and _level("", self.nominal, self.metric, self.bar).holds

    @property
    def nominal_certain(self) -> bool:
        """Whether the 95 % interval of the score without any change excludes the required score."""
        return self.bar is not None and _level("", self.nominal, self.metric, self.bar).certain


def evaluate_robustness(
    run: ModelRef | Run | str | Path,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    model: ModelName = "best",
    scenario: str | Path | None = None,
    overrides: Sequence[str] = (),
    case: str | None = None,
    stage: str | None = None,
    min_success: float | None = None,
    min_return: float | None = None,
    mass_of: str | None = None,
    permissions: Permissions = Permissions(),
    on_level: Callable[[int, int], object] | None = None,
    executor: Executor = SERIAL,
    **options: Any,
) -> Robustness:
    """Evaluate a policy with latency and loss of messages, noise of the observation, another mass, other
    friction, and weaker motors.

    Latencies are added to those of the scenario, one way at a time, in timesteps. Losses hold for both ways,
    and replace those of the scenario. Noise is Gaussian, its standard deviation a share of the range of each
    entry of the observation; it replaces that of the scenario. The mass of one link or object that can move,
    the friction of the ground and of fixed objects, and the strength of all actuators are multiplied by a
    factor.

    A policy that never succeeds without any change is not evaluated under changed conditions, unless a score
    is required.

    Args:
        run: The run, its directory, or the file of a model in it.
        episodes: Episodes of each level; by default those of the scenario, at most 50.
        scenario: Another scenario to change, by its path or name.
        overrides: Assignments `path=value` for all levels.
        case: Name of a case of the evaluation, whose settings all levels have; `stage` is the same for the
            curriculum.
        min_success: The required success rate; by default that of `solved`, or 80 % of the rate in the
            unchanged scenario.
        min_return: The required mean return, in place of the success rate.
        mass_of: The link (`ROBOT.LINK`) or object whose mass is changed; by default the heaviest link that
            can move.
        on_level: Is called after each evaluation with the number of those done and of all.
        executor: Where the evaluations run; the result does not depend on it.
        options: Further arguments of `evaluate`; `seed`, `model` and `permissions` are as there.

    Raises:
        RunError: The folder is not a run, is damaged, or does not match `scenario`.
        UsageError: The scenario does not exist, defines no success for `min_success`, or nothing with the
            name `mass_of` has a mass.
    """
    ref = ModelRef.open(run, model=model)
    trained = ref.run
    base = (
        Source.kept(trained.path, permissions)
        if scenario is None
        else Source.open(scenario, permissions, SourceKind.SCENARIO)
    )
    plain = api.compile(base.checked(overrides=overrides))
    program = plain.program.variant(case, stage)
    check_common_measure(program, "name one of them: deepbots robustness RUN --agent NAME")
    if min_success is not None:
        check_defines_success(program)
    document = base_document(base, overrides, case, stage)
    usual = plain.program.evaluation.episodes if case is None else plain.program.case(case).episodes
    evaluation_options: dict[str, Any] = {
        "episodes": min(EPISODES_PER_LEVEL, usual) if episodes is None else episodes,
        "case": case,
        "stage": stage,
    }
    evaluation_options |= {"seed": seed, "model": ref.name, "permissions": permissions, **options}
    planned = list(plans(document.root, program, mass_of)) if document.root is not None else []
    counter = Counter(on_level, 1 + sum(len(plan.levels) for plan in planned))
    skipped: dict[str, str] = {}

    def levels() -> Iterator[_Level]:
        """Yield the unchanged scenario, and each change of it, which is compiled when it is needed."""
        yield _Level(trained, None, "", "", plain, evaluation_options)
        for plan in planned:
            try:
                compiled = [
                    (side, label, changed_scenario(document, change))
                    for side, amounts in plan.sides.items()
                    for label, change in map(plan.level, amounts)
                ]
            except ScenarioError as error:
                counter.total -= len(plan.levels)
                skipped[plan.name] = f"the changed scenario does not compile ({error})"
                continue
            for side, label, level in compiled:
                yield _Level(trained, plan.name, side, label, level, evaluation_options)

    measured: dict[tuple[str | None, str], list[RobustnessLevel]] = defaultdict(list)
    with closing(
        results(executor.map(_evaluate_level, levels(), watcher=counter, files=[trained.path / RECORD_NAME]))
    ) as evaluated:
        _, _, _, nominal = next(evaluated)
        metric, bar, source = _bar(program, nominal, min_success, min_return)
        if bar is None:
            return Robustness(trained.path, program.name, metric, bar, source, nominal, ())
        for condition, side, label, result in evaluated:
            measured[condition, side].append(_level(label, result, metric, bar))
    conditions = []
    for plan in planned:
        sides = [
            Side(side, tuple(measured[plan.name, side])) for side in plan.sides if plan.name not in skipped
        ]
        conditions.append(Condition(plan.name, tuple(sides), skipped.get(plan.name)))
    return Robustness(trained.path, program.name, metric, bar, source, nominal, tuple(conditions))


class _Level(NamedTuple):
    """A level of one side of a condition, which is None for the unchanged scenario, and how to evaluate
    it."""

    run: Run
    condition: str | None
    side: str
    label: str
    compiled: Compiled
    options: dict[str, Any]


def _evaluate_level(level: _Level, attempt: Attempt) -> tuple[str | None, str, str, EvaluationResult]:
    try:
        return (
            level.condition,
            level.side,
            level.label,
            evaluate(level.run, scenario=level.compiled, **level.options),
        )
    except DeepbotsError as error:
        if level.condition is None:
            raise
        raise type(error)(f"{level.condition}: {error}") from error


def base_document(
    base: Source, overrides: Sequence[str] = (), case: str | None = None, stage: str | None = None
) -> Document:
    """Return the document that all levels share: a scenario that compiles, with the settings of the case or
    stage applied, and without tests.

    Of the cases and stages, only the name of this one is left: a setting of it may replace what a level
    changes, such as the ground by a terrain.
    """
    document = base.document(overrides=overrides)
    root = document.root
    assert root is not None
    variants: dict[NodePath, bool] = {
        ("evaluation", "cases", name): name == case for name in entries_at(root, "evaluation", "cases")
    }
    stages = node_at(root, "curriculum")
    for index, item in enumerate(stages.items if isinstance(stages, SequenceNode) else ()):
        variants["curriculum", index] = written(item, "name") == stage
    removed: list[NodePath] = [(TESTS,), *([("curriculum",)] if stage is None else [])]
    for path, is_chosen in variants.items():
        if is_chosen:
            root = with_settings_at(root, path)
        removed += [(*path, "set"), (*path, "until")] if is_chosen else [path]
    bare = without_paths(root, removed)
    assert isinstance(bare, MappingNode)
    return replace(document, root=bare)


def changed_scenario(document: Document, change: Change) -> Compiled:
    """Compile the scenario with the keys of `change`.

    Raises:
        ScenarioError: The changed scenario has errors.
    """
    return api.compile(_checked(document, change))


def changed_program(document: Document, change: Change) -> Program:
    """Compile the changed scenario without linting, which takes a fifth of the time in which a short episode
    is compiled, built and simulated.

    Raises:
        ScenarioError: The changed scenario does not compile.
    """
    checked = _checked(document, change)
    if checked.program is None:
        raise ScenarioError([*checked.findings])
    return checked.program


def _checked(document: Document, change: Change) -> CheckedScenario:
    findings = Findings(document.findings.limit)
    over = parse(SourceText("the change", json.dumps(change)), findings)
    assert document.root is not None
    assert isinstance(over, MappingNode)
    return check(replace(document, root=merge(document.root, over), findings=findings))


def _level(label: str, result: EvaluationResult, metric: Measure, bar: float) -> RobustnessLevel:
    score, interval = (
        (result.success_rate, result.success_interval)
        if metric == "success_rate"
        else (result.mean_return, result.return_interval)
    )
    certain = interval is not None and not interval[0] <= bar <= interval[1]
    return RobustnessLevel(label, result, score >= bar, certain, interval)


def _bar(
    program: Program, nominal: EvaluationResult, min_success: float | None, min_return: float | None
) -> tuple[Measure, float | None, str]:
    """Return the metric, the required score, and its source. The score is None if the unchanged success rate
    is 0 % and no score is required."""
    solved = program.agent.solved
    if min_return is not None:
        return "mean_return", min_return, "given"
    if min_success is not None:
        return "success_rate", min_success, "given"
    if solved is not None:
        measure = measure_of(solved, defines_success=nominal.success_defined)
        return measure, getattr(solved, measure), "`solved` of the scenario"
    source = f"{SHARE_OF_NOMINAL:.0%} of the value without any change"
    if nominal.success_defined:
        return "success_rate", SHARE_OF_NOMINAL * nominal.success_rate or None, source
    return "mean_return", nominal.mean_return - (1 - SHARE_OF_NOMINAL) * abs(nominal.mean_return), source


# The conditions


MASS = "mass"


class Plan(NamedTuple):
    """A condition that can be changed by any amount.

    Attributes:
        family: The changed property, such as `friction`; `subject` is its owner, and may be empty.
        change: The change of the scenario by an amount.
        sides: The amounts of a robustness evaluation by side, from the smallest change on; a condition with
            one side has the side "".
        form: The format of an amount: `FACTOR`, `DELAY` in ms, or that of a share.
    """

    family: str
    change: Callable[[float], Change]
    sides: dict[str, tuple[float, ...]] = FACTORS
    form: str = FACTOR
    subject: str = ""

    @property
    def name(self) -> str:
        return f"{self.family} of {self.subject}" if self.subject else self.family

    def level(self, amount: float) -> tuple[str, Change]:
        """Return the label of an amount, and the change by it."""
        return self.form.format(amount), self.change(amount)

    @property
    def levels(self) -> list[tuple[str, Change]]:
        """The levels of all sides."""
        return [self.level(amount) for side in self.sides.values() for amount in side]


def plans(root: MappingNode, program: Program, mass_of: str | None = None) -> Iterator[Plan]:
    """Yield the conditions that a scenario has; `mass_of` as for `evaluate_robustness`."""
    if program.format != "none":
        ways = [("to_robot", "latency to the robot")]
        if any(robot.emitted for robot in program.robots):
            ways.append(("from_robot", "latency from the robot"))
        steps = tuple(1000 * program.world.timestep * count for count in LATENCY_STEPS)
        for direction, words in ways:
            latency = written(root, "messages", direction, "latency")
            yield Plan(words, partial(_latency, direction, latency), {"": steps}, DELAY)
        yield Plan("message loss", _loss, {"": LOSS_RATES}, "{:.0%}")
    if _noise(root, program, 1.0):
        noise = partial(_noise, root, program)
        yield Plan("observation noise", noise, {"": NOISE_SHARES}, "{:.0%} of the range")
    if mass := _mass(root, program, mass_of):
        yield _mass_plan(root, program, mass)
    if surfaces := _surfaces(root, program):
        yield Plan(
            "friction",
            lambda factor: _frictions(root, surfaces.values(), factor),
            subject=_named(surfaces),
        )
    if any(entries_at(root, "robots", robot, "actuators") for robot in entries_at(root, "robots")):
        yield Plan("motor strength", partial(_strengths, root), {"": STRENGTH_FACTORS})


def delayed(delay: float, base: str | None) -> str:
    """Return a time of the scenario, or 0, plus `delay` ms."""
    time = f"{float(delay)!r} ms"
    return _combined(f"{time} +", base) if base else time


def scaled(factor: float, text: str) -> str:
    """Return a value of the scenario times a factor."""
    return _combined(f"{float(factor)!r} *", text)


def _combined(before: str, text: str) -> str:
    """Return an operation, without its right side, upon a written value: `a when c` and `a each step` are
    allowed only as a whole text."""
    tree = parse_expression(text, lambda *_: None)
    assert tree is not None  # the scenario compiles
    value = tree.value if isinstance(tree, Redrawn) else tree
    operand = text[value.start : value.end]
    if isinstance(value, Binary) and value.operator == "when":
        amount, condition = (text[part.start : part.end] for part in (value.left, value.right))
        operand = f"{amount} if {condition} else 0"
    return f"{before} ({operand}){text[value.end : tree.end]}"


def _latency(direction: str, latency: str | None, delay: float) -> Change:
    return {"messages": {direction: {"latency": delayed(delay, latency)}}}


def _loss(rate: float) -> Change:
    return {"messages": {direction: {"loss": rate} for direction in ("to_robot", "from_robot")}}


Surface = tuple[str, str]
"""The section and the name of a body, such as `objects`, `stair`."""


def _surfaces(root: MappingNode, program: Program) -> dict[str, Surface]:
    """Return the surfaces on which robots stand, by their names in words: the ground, and fixed objects such
    as stairs.

    In both engines the friction of a contact is the product of both coefficients, so walls, which robots
    should not touch, are left out.
    """
    surfaces: dict[str, Surface] = {}
    if program.world.terrain is not None or program.world.ground is not None:
        surfaces["the ground"] = ("world", "terrain" if program.world.terrain is not None else "ground")
    return surfaces | {
        name: ("objects", name)
        for name, body in _objects(root, program).items()
        if body.solid and not _can_move(body)
    }


def _objects(root: MappingNode, program: Program) -> dict[str, ObjectBody]:
    """Return the body of each written object; of a group, that of a copy."""
    written_names = _written_names(program)
    bodies = {written_names.get(body.name, body.name): body for body in program.world.objects}
    return {name: body for name, body in bodies.items() if name in entries_at(root, "objects")}


def _written_names(program: Program) -> dict[str, str]:
    """Return the name of the group of each copy."""
    return {copy: group.name for group in program.reset.groups for copy in group.copies}


def _can_move(body: ObjectBody) -> bool:
    return body.solid and not all(form.fixed for form in body.variants or (body,))


def movable_objects(root: MappingNode, program: Program) -> list[str]:
    """Return the names of the objects and groups that can move."""
    return [name for name, body in _objects(root, program).items() if _can_move(body)]


def _named(surfaces: Iterable[str]) -> str:
    names = list(surfaces)
    return (
        sentence_list(names) if len(names) <= _MAX_NAMED else f"{names[0]} and {len(names) - 1} fixed objects"
    )


def _frictions(root: MappingNode, surfaces: Iterable[Surface], factor: float) -> Change:
    """Return the friction of several bodies times a factor."""
    change: dict[str, Change] = defaultdict(dict)
    for section, name in surfaces:
        change[section][name] = friction(root, (section, name), factor)
    return change


def friction(root: MappingNode, surface: Surface, factor: float) -> Change:
    """Return the friction of a body, and of the variants that have one of their own, times a factor; 1 is the
    default."""
    change: Change = {"friction": scaled(factor, written(root, *surface, "friction") or "1")}
    for variant in entries_at(root, *surface, "one_of"):
        if text := written(root, *surface, "one_of", variant, "friction"):
            change.setdefault("one_of", {})[variant] = {"friction": scaled(factor, text)}
    return change


def written(root: Node | None, *path: str) -> str | None:
    """Return the single value at a path; None if there is none."""
    node = node_at(root, *path)
    return node.text if isinstance(node, ScalarNode) else None


def _noise(root: MappingNode, program: Program, share: float) -> Change:
    """Return noise on each entry of the observation with a finite range, in relation to its narrowest
    component; of several agents, on those of all that learn, and of those that share their policy."""
    if not program.members and program.others is None:
        return _nonempty("observation", _noisy(node_at(root, "observation"), program.agent, share))
    sections = sections_of_agents(root)
    learners = {name: member.program.agent for name, member in program.members.items()}
    names: dict[str, str] = {}
    if program.others is not None:
        played = program.others.agent
        owner = written(sections[played], "policy") or played
        learners = {owner: program.agent}
        observed = (entries_at(sections[name], "observation") for name in (played, owner))
        names = dict(zip(*observed, strict=True))
    change: Change = {}
    is_noisy = False
    for name, section in sections.items():
        observation = section.get("observation")
        if observation is None or written(section, "policy") is not None:
            continue
        added = _noisy(observation, learners[name], share, names) if name in learners else {}
        is_noisy = is_noisy or bool(added)
        # An agent that is like another one would have its noise, too.
        entries: Any = to_data(observation) if written(root, "agents", name, "like") else {}
        change |= _nonempty(name, {"observation": entries | added} if entries | added else {})
    return _nonempty("agents", change if is_noisy else {})


def _nonempty(key: str, change: Change) -> Change:
    return {key: change} if change else {}


def _noisy(
    observation: Node | None, agent: Agent, share: float, names: Mapping[str, str] = MappingProxyType({})
) -> Change:
    """Return the entries of the observation of an agent that have noise; `names` has their written names
    where these are those of another agent."""
    widths: dict[str, tuple[float, str]] = {}
    for number in agent.numbers:
        width = number.high - number.low
        if number.is_truth or not 0 < width < 1e9:
            continue
        name = names.get(number.name, number.name)
        widths[name] = min((width, number.unit), widths.get(name, (width, number.unit)))
    change: Change = {}
    for name, (width, unit) in widths.items():
        noise = f"{share * width:.6g}" + (f" {unit}" if unit != "1" else "")
        match node_at(observation, name):
            case ScalarNode(text=text):
                change[name] = {"range": text, "noise": noise}
            case MappingNode() as entry:
                written_entry: Any = to_data(entry)
                change[name] = written_entry | {"noise": noise}
    return change


def masses(root: MappingNode, program: Program, largest: int) -> Iterator[Plan]:
    """Yield the masses of the heaviest links that can move, at most `largest`, and of the objects that can
    move."""
    links, objects, _ = _movable(root, program)
    for name in (*sorted(links, key=lambda link: -links[link])[:largest], *objects):
        yield _mass_plan(root, program, name)


def _movable(root: MappingNode, program: Program) -> tuple[dict[str, float], list[str], list[str]]:
    """Return the links that can move, with their masses in kg; the objects that can move; and the links and
    objects that are fixed to the world."""
    written_names = _written_names(program)
    heavy = {
        f"{written_names.get(body.name, body.name)}.{link.name}": (link.inertial.mass, link.name in still)
        for body in program.world.robots
        for still in [body.model.links_below(body.model.root, rigid=True) if body.fixed_base else []]
        for link in body.model.links
        if link.inertial is not None and link.inertial.mass > 0
    }
    links = {link: mass for link, (mass, is_fixed) in heavy.items() if not is_fixed}
    objects = movable_objects(root, program)
    still_objects = [name for name in _objects(root, program) if name not in objects]
    return links, objects, [*(link for link in heavy if link not in links), *still_objects]


def _mass_plan(root: MappingNode, program: Program, name: str) -> Plan:
    body = _objects(root, program).get(name)
    texts = (
        _mass_of_link(program, *name.split(".", 1)) if body is None else _masses_of_object(root, name, body)
    )
    return Plan(
        MASS,
        lambda factor: joined({path: scaled(factor, text) for path, text in texts.items()}),
        subject=name,
    )


def _mass_of_link(program: Program, robot: str, link: str) -> dict[tuple[str, ...], str]:
    """Return the text of the mass of a link by its path.

    Patterns and a density may set it, too. A further pattern, which only this link matches, is applied last:
    in it, `urdf` is the fixed mass that all others leave. A drawn mass is written anew.
    """
    links = ("robots", robot, "links")
    # Upper and lower case differ.
    last = (*links, f"[{link[0]}]{glob.escape(link[1:])}", "mass")
    written_names = _written_names(program)
    drawn = next(
        (
            variation.value
            for variation in program.reset.variations
            if variation.what == "mass"
            and isinstance(variation.of, OfLink)
            and written_names.get(variation.of.body, variation.of.body) == robot
            and variation.of.link == link
        ),
        None,
    )
    if drawn is None:
        return {last: "urdf"}
    own = (*links, link, "mass")
    if drawn.owner.partition(":")[0] == ".".join(own):
        return {own: drawn.text}  # with the draws of the same stream
    text = drawn.text
    for node in sorted(walk(drawn.typed), key=lambda node: -node.start):
        if text[node.start : node.end] == "urdf" and (values := constant_values(node)):
            text = f"{text[: node.start]}({float(values[0])!r} kg){text[node.end :]}"
    return {last: text}


def _masses_of_object(root: MappingNode, name: str, body: ObjectBody) -> dict[tuple[str, ...], str]:
    """Return the texts of the masses of an object, or of its kinds that can move, by their paths. Without
    one, the mass is that of water."""
    path = ("objects", name)
    own = written(root, *path, "mass")
    if not body.variants:
        return {(*path, "mass"): own or f"{body.mass!r} kg"}
    kinds = {kind.name: kind for kind in body.variants if not kind.fixed}
    return {
        (*path, "one_of", key, "mass"): written(root, *path, "one_of", key, "mass")
        or own
        or f"{kind.mass!r} kg"
        for key, kind in kinds.items()
    }


def _mass(root: MappingNode, program: Program, name: str | None) -> str | None:
    """Return the link or object whose mass is changed; None if nothing has a mass.

    By default it is the heaviest link of all robots, as if it carried a load. All masses by one factor would
    often change nothing: the accelerations of a robot that follows commands of speed stay as they are. The
    mass of a body that is fixed to the world has no effect.

    Raises:
        UsageError: Nothing of this name has a mass, or it is fixed to the world.
    """
    links, objects, fixed = _movable(root, program)
    if name is not None and name not in links and name not in objects:
        reason = (
            f"'{name}' is fixed to the world, so its mass has no effect"
            if name in fixed
            else f"there is no link or object '{name}' with a mass"
        )
        choices = ", ".join([*links, *objects])
        raise UsageError(f"{reason}; choose from: {choices}" if choices else reason)
    return name or max(links, key=lambda link: links[link], default=None)


def joined(values: Mapping[tuple[str, ...], str]) -> Change:
    """Return a change of the values at several paths."""
    change: Change = {}
    for path, value in values.items():
        section = change
        for key in path[:-1]:
            section = section.setdefault(key, {})
        section[path[-1]] = value
    return change


def _strengths(root: MappingNode, factor: float) -> Change:
    """Return the strength of every actuator times a factor."""
    paths = [
        ("robots", robot, "actuators", name, "strength")
        for robot in entries_at(root, "robots")
        for name in entries_at(root, "robots", robot, "actuators")
    ]
    return joined({path: scaled(factor, written(root, *path) or "1") for path in paths})
