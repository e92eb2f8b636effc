"""Robustness: a policy under conditions that it was not trained for, one changed at a time and by several amounts.

Each condition is a change of the scenario, laid upon it as a file upon the one that it `extends`, and compiled anew. The changes
therefore apply to any scenario that has such values. All levels have the same starts.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import Findings
from deepbots_cli.diagnostics import Source as SourceText
from deepbots_cli.document import Document, MappingNode, Node, Permissions, ScalarNode, SequenceNode
from deepbots_cli.document.load import TESTS, merge, with_settings_at
from deepbots_cli.document.nodes import NodePath, entries_at, node_at, without_paths
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import DeepbotsError, ScenarioError, UsageError
from deepbots_cli.learning.evaluation import EvaluationResult, evaluate
from deepbots_cli.learning.run import ModelName, ModelRef, Run
from deepbots_cli.learning.spread import ONE_BY_ONE, Attempt, Counter, Spread, results
from deepbots_cli.program import Program
from deepbots_cli.rollout.source import RECORD_NAME, Source, SourceKind

EPISODES_PER_LEVEL = 50
"""Episodes of a level, unless the scenario asks for fewer."""
LATENCY_STEPS, LOSS_RATES, NOISE_SHARES = (1, 2, 4, 8), (0.05, 0.1, 0.2, 0.4), (0.01, 0.02, 0.05, 0.1)
MASS_FACTORS = (0.5, 0.75, 1.25, 1.5, 2.0)
STRENGTH_FACTORS = (0.9, 0.75, 0.5, 0.25)
SHARE_OF_NOMINAL = 0.8
"""Required score if neither the caller nor the scenario sets one: 80 % of the success rate or mean return without any change."""

Metric = Literal["success_rate", "mean_return"]
Change = dict[str, Any]
"""Keys of a scenario that replace or add to those of the scenario that it extends."""


@dataclass(frozen=True)
class RobustnessLevel:
    """One amount of a condition: its label, such as `+64 ms`, and the evaluation.

    `holds` is true if the score reaches the required one, `certain` if its 95 % interval excludes the required one.
    """

    level: str
    evaluation: EvaluationResult
    holds: bool
    certain: bool


@dataclass(frozen=True)
class Condition:
    """One changed condition at all of its levels, from the smallest change on.

    `skipped` is the reason why this scenario cannot be changed in this way; `levels` is empty then.
    """

    name: str
    levels: tuple[RobustnessLevel, ...]
    skipped: str | None = None

    @property
    def threshold(self) -> str:
        """In words: the levels between which the score falls below the required one, and the levels at which this is not significant."""
        if self.skipped is not None:
            return f"not measured: {self.skipped}"
        uncertain = [entry.level for entry in self.levels if not entry.certain]
        if not uncertain:
            return self._fall
        return f"{self._fall}; not significant at {'all levels' if len(uncertain) == len(self.levels) else ', '.join(uncertain)}"

    @property
    def _fall(self) -> str:
        failed = [entry.level for entry in self.levels if not entry.holds]
        held = [entry.level for entry in self.levels if entry.holds]
        if not failed:
            return "meets the requirement at all levels"
        if not held:
            return "misses the requirement at all levels"
        if failed == [entry.level for entry in self.levels[len(held) :]]:
            return f"meets the requirement up to {held[-1]}, misses it from {failed[0]} on"
        return f"meets the requirement at {', '.join(held)}; misses it at {', '.join(failed)}"


@dataclass(frozen=True)
class Robustness:
    """A policy under changed conditions.

    `metric` is what is compared with `bar`: the success rate where the scenario defines success, else the mean return. `nominal` is the
    evaluation without any change.
    """

    run: Path
    scenario: str
    metric: Metric
    bar: float
    bar_source: str
    nominal: EvaluationResult
    conditions: tuple[Condition, ...]

    @property
    def nominal_holds(self) -> bool:
        """Whether the score reaches the required one without any change."""
        return _level("", self.nominal, self.metric, self.bar).holds

    @property
    def nominal_certain(self) -> bool:
        """Whether the 95 % interval of the score without any change excludes the required score."""
        return _level("", self.nominal, self.metric, self.bar).certain


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
    spread: Spread = ONE_BY_ONE,
    **options: Any,
) -> Robustness:
    """Evaluate a policy with latency and loss of messages, noise of the observation, another mass, other friction, and weaker motors.

    Latencies are added to those of the scenario, one way at a time, in timesteps. Losses hold for both ways, and replace those of the
    scenario. Noise is Gaussian, its standard deviation a share of the range of each entry of the observation; it replaces that of the
    scenario. The mass of one link or object that can move, the friction of the ground and the strength of all actuators are multiplied by
    a factor.

    Args:
        run: The run, its directory, or the file of a model in it.
        episodes: Episodes of each level; by default those of the scenario, at most 50.
        scenario: Another scenario to change, by its path or name.
        overrides: Assignments `path=value` for all levels.
        case: Name of a case of the evaluation, whose settings all levels have; `stage` is the same for the curriculum.
        min_success: The required success rate; by default that of `solved`, or 80 % of the rate in the unchanged scenario.
        min_return: The required mean return, in place of the success rate.
        mass_of: The link (`ROBOT.LINK`) or object whose mass is changed; by default the heaviest link that can move.
        on_level: Is called after each evaluation with the number of those done and of all.
        spread: Where the evaluations run; the result does not depend on it.
        options: Further arguments of `evaluate`; `seed`, `model` and `permissions` are as there.

    Raises:
        RunError: The folder is not a run, is damaged, or does not match `scenario`.
        UsageError: The scenario does not exist, or nothing with the name `mass_of` has a mass.
    """
    ref = ModelRef.open(run, model=model)
    known = ref.run
    base = Source.kept(known.path, permissions) if scenario is None else Source.open(scenario, permissions, SourceKind.SCENARIO)
    plain = api.compile(base.checked(overrides=overrides))
    program = plain.program.variant(case, stage)
    document = base_document(base, overrides, case, stage)
    usual = plain.program.evaluation.episodes if case is None else plain.program.case(case).episodes
    given: dict[str, Any] = {"episodes": min(EPISODES_PER_LEVEL, usual) if episodes is None else episodes, "case": case, "stage": stage}
    given |= {"seed": seed, "model": ref.name, "permissions": permissions, **options}
    planned = list(plans(document.root, program, mass_of)) if document.root is not None else []
    counter = Counter(on_level, 1 + sum(len(levels) for _, levels in planned))
    skipped: dict[str, str] = {}

    def levels() -> Iterator[_Level]:
        """The unchanged scenario, and each change of it, which is compiled when its turn comes."""
        yield _Level(known, None, "", plain, given)
        for name, changes in planned:
            try:
                compiled = [(label, changed_scenario(document, change)) for label, change in changes]
            except ScenarioError as error:
                counter.total -= len(changes)
                skipped[name] = f"the changed scenario does not compile ({error})"
                continue
            for label, level in compiled:
                yield _Level(known, name, label, level, given)

    found = results(spread.map(_evaluate_level, levels(), watcher=counter, files=[known.path / RECORD_NAME]))
    _, _, nominal = next(found)
    metric, bar, source = _bar(program, nominal, min_success, min_return)
    measured: dict[str | None, list[RobustnessLevel]] = defaultdict(list)
    for name, label, result in found:
        measured[name].append(_level(label, result, metric, bar))
    conditions = [Condition(name, tuple(measured[name]), skipped.get(name)) for name, _ in planned]
    return Robustness(known.path, program.name, metric, bar, source, nominal, tuple(conditions))


class _Level(NamedTuple):
    """A level of a condition, which is None for the unchanged scenario, and how to evaluate it."""

    run: Run
    condition: str | None
    label: str
    compiled: Compiled
    options: dict[str, Any]


def _evaluate_level(level: _Level, attempt: Attempt) -> tuple[str | None, str, EvaluationResult]:
    try:
        return level.condition, level.label, evaluate(level.run, scenario=level.compiled, **level.options)
    except DeepbotsError as error:
        if level.condition is None:
            raise
        raise type(error)(f"{level.condition}: {error}") from error


def base_document(base: Source, overrides: Sequence[str] = (), case: str | None = None, stage: str | None = None) -> Document:
    """What all levels share: a scenario that compiles, with the settings of the case or stage applied, and without tests.

    Of the cases and stages, only the name of this one is left: a setting of it may replace what a level changes, such as the ground by a
    terrain.
    """
    document = base.document(overrides=overrides)
    root = document.root
    assert root is not None
    variants: dict[NodePath, bool] = {("evaluation", "cases", name): name == case for name in entries_at(root, "evaluation", "cases")}
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
    """The scenario with the keys of `change`, compiled.

    Raises:
        ScenarioError: The changed scenario has errors.
    """
    findings = Findings(document.findings.limit)
    over = parse(SourceText("the change", json.dumps(change)), findings)
    assert document.root is not None
    assert isinstance(over, MappingNode)
    return api.compile(check(replace(document, root=merge(document.root, over), findings=findings)))


def _level(label: str, result: EvaluationResult, metric: Metric, bar: float) -> RobustnessLevel:
    is_rate = metric == "success_rate"
    score, interval = (result.success_rate, result.success_interval) if is_rate else (result.mean_return, result.return_interval)
    certain = interval is not None and not interval[0] <= bar <= interval[1]
    return RobustnessLevel(label, result, score >= bar, certain)


def _bar(program: Program, nominal: EvaluationResult, min_success: float | None, min_return: float | None) -> tuple[Metric, float, str]:
    """The metric, the required score, and its source."""
    solved = program.agent.solved
    if min_return is not None:
        return "mean_return", min_return, "given"
    if min_success is not None:
        return "success_rate", min_success, "given"
    if solved is not None and solved.success_rate is not None:
        return "success_rate", solved.success_rate, "`solved` of the scenario"
    if solved is not None and solved.mean_return is not None and not nominal.success_defined:
        return "mean_return", solved.mean_return, "`solved` of the scenario"
    source = f"{SHARE_OF_NOMINAL:.0%} of the value without any change"
    if nominal.success_defined:
        return "success_rate", SHARE_OF_NOMINAL * nominal.success_rate, source
    return "mean_return", nominal.mean_return - (1 - SHARE_OF_NOMINAL) * abs(nominal.mean_return), source


# The conditions

Plan = tuple[str, list[tuple[str, Change]]]
"""A condition, and its levels: label and change."""


def plans(root: MappingNode, program: Program, mass_of: str | None = None) -> Iterator[Plan]:
    """The conditions that a scenario has; `mass_of` as for `evaluate_robustness`."""
    if program.format != "none":
        ways = [("to_robot", "latency to the robot")]
        if any(robot.emitted for robot in program.robots):
            ways.append(("from_robot", "latency from the robot"))
        for way, words in ways:
            own = written(root, "messages", way, "latency")
            delays = [1000 * program.world.timestep * steps for steps in LATENCY_STEPS]
            levels = [(f"+{delay:g} ms", f"{delay:g} ms" + (f" + {own}" if own else "")) for delay in delays]
            yield words, [(label, {"messages": {way: {"latency": latency}}}) for label, latency in levels]
        yield (
            "message loss",
            [(f"{loss:.0%}", {"messages": {way: {"loss": loss} for way in ("to_robot", "from_robot")}}) for loss in LOSS_RATES],
        )
    noisy = [(f"{share:.0%} of the range", _noise(root, program, share)) for share in NOISE_SHARES]
    if all(change for _, change in noisy):
        yield "observation noise", [(label, {"observation": change}) for label, change in noisy]
    if mass := _mass(root, program, mass_of):
        yield _mass_plan(root, mass)
    ground = "terrain" if program.world.terrain is not None else "ground"
    if program.world.terrain is not None or program.world.ground is not None:
        own = written(root, "world", ground, "friction") or "1"
        yield (
            "friction of the ground",
            [(f"x {factor:g}", {"world": {ground: {"friction": f"{factor:g} * ({own})"}}}) for factor in MASS_FACTORS],
        )
    if any(entries_at(root, "robots", robot, "actuators") for robot in entries_at(root, "robots")):
        yield "motor strength", [(f"x {factor:g}", {"robots": _strengths(root, factor)}) for factor in STRENGTH_FACTORS]


def written(root: Node | None, *path: str) -> str | None:
    """The single value that is written at a path; None where nothing is."""
    found = node_at(root, *path)
    return found.text if isinstance(found, ScalarNode) else None


def _noise(root: MappingNode, program: Program, share: float) -> Change:
    """Noise on each entry of the observation with a finite range, that of its narrowest component."""
    widths: dict[str, tuple[float, str]] = {}
    for number in program.agent.numbers:
        width = number.high - number.low
        if number.is_truth or not 0 < width < 1e9:
            continue
        widths[number.name] = min((width, number.unit), widths.get(number.name, (width, number.unit)))
    change: Change = {}
    for name, (width, unit) in widths.items():
        noise = f"{share * width:.6g}" + (f" {unit}" if unit != "1" else "")
        text = written(root, "observation", name)
        if text is not None:
            change[name] = {"range": text, "noise": noise}
        elif isinstance(node_at(root, "observation", name), MappingNode):
            change[name] = {"noise": noise}
    return change


def masses(root: MappingNode, program: Program, largest: int) -> Iterator[Plan]:
    """The masses of the heaviest links that can move, at most `largest`, and of the objects that can move."""
    links, objects, _ = _movable(root, program)
    heaviest = sorted(links, key=lambda link: -links[link])[:largest]
    yield from (_mass_plan(root, name) for name in (*heaviest, *objects))


def _movable(root: MappingNode, program: Program) -> tuple[dict[str, float], list[str], list[str]]:
    """The links that can move, with their masses in kg; the objects that can; and what is fixed to the world."""
    heavy = {
        f"{body.name}.{link.name}": (link.inertial.mass, link.name in still)
        for body in program.world.robots
        for still in [body.model.links_below(body.model.root, rigid=True) if body.fixed_base else []]
        for link in body.model.links
        if link.inertial is not None and link.inertial.mass > 0
    }
    links = {link: mass for link, (mass, is_fixed) in heavy.items() if not is_fixed}
    fixed = {body.name for body in program.world.objects if body.fixed}
    weighed = [key for key in entries_at(root, "objects") if written(root, "objects", key, "mass") is not None]
    objects = [key for key in weighed if key not in fixed]
    return links, objects, [*(link for link in heavy if link not in links), *(key for key in weighed if key in fixed)]


def _mass_plan(root: MappingNode, name: str) -> Plan:
    path = ("objects", name) if name in entries_at(root, "objects") else ("robots", name.partition(".")[0], "links", name.partition(".")[2])
    own = written(root, *path, "mass") or "urdf"
    return f"mass of {name}", [(f"x {factor:g}", _nested(path, {"mass": f"{factor:g} * ({own})"})) for factor in MASS_FACTORS]


def _mass(root: MappingNode, program: Program, name: str | None) -> str | None:
    """The link or object whose mass is changed; None where nothing has a mass.

    By default it is the heaviest link of all robots, as if it carried a load. All masses by one factor would often change nothing: the
    accelerations of a robot that follows commands of speed stay as they are. The mass of what is fixed to the world changes no motion.

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


def _nested(path: Sequence[str], value: Change) -> Change:
    return {path[0]: _nested(path[1:], value)} if path else value


def _strengths(root: MappingNode, factor: float) -> Change:
    """The strength of every actuator times a factor."""
    return {
        robot: {
            "actuators": {
                name: {"strength": f"{factor:g} * ({written(root, 'robots', robot, 'actuators', name, 'strength') or '1'})"}
                for name in entries_at(root, "robots", robot, "actuators")
            }
        }
        for robot in entries_at(root, "robots")
    }
