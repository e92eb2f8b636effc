"""The training section, cases of the evaluation, stages of the curriculum, and tests of the scenario.

Each case and stage is the same file with its `set` made, as `--set` would make it, and checked as a whole. A
policy has to fit all of them, so its observation, action and messages must be the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

from deepbots_cli.compiler.episodes import NO_SUCCESS_DEFINED, success_help
from deepbots_cli.compiler.namespace import Namespace, NamespaceReader, SupervisorScope
from deepbots_cli.compiler.policy import Decisions
from deepbots_cli.compiler.values import ValueReader
from deepbots_cli.diagnostics import Findings, Fix, Label, Span
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.document import Document, Entry, MappingNode
from deepbots_cli.document.load import apply_setting, setting_path
from deepbots_cli.document.nodes import (
    NodePath,
    ScalarNode,
    count_and_depth,
    entries_at,
    without_paths,
)
from deepbots_cli.document.nodes import walk as walk_nodes
from deepbots_cli.expressions.check import COMPARISONS
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.lower import constant_values
from deepbots_cli.expressions.types import Constant, Context, Operation, TypedNode, walk
from deepbots_cli.expressions.unification import expect_range
from deepbots_cli.program import CurriculumStage, EvaluationCase, Program, identity
from deepbots_cli.program.task import (
    ActionNoise,
    ActionRange,
    AdaptiveRate,
    Choices,
    Criterion,
    ExpectedKey,
    ExpectedResult,
    FixedAction,
    Hindsight,
    Hyperparameter,
    Network,
    RobotCopies,
    ScenarioTest,
    Schedule,
    ScriptedChoice,
    ScriptedRange,
    SelfPlay,
    Teacher,
    Training,
    Truncation,
)
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.fields import REFERENCE_KINDS
from deepbots_cli.scenario.keys import listed
from deepbots_cli.scenario.quantities import read_schedule, read_until
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import DiscreteAction, Expectation
from deepbots_cli.scenario.task import ScenarioTest as TestSpec
from deepbots_cli.scenario.training import ALGORITHMS, MAX_LAYERS, MAX_WEIGHTS, Auto
from deepbots_cli.scenario.training import ActionNoise as ActionNoiseSpec
from deepbots_cli.scenario.training import AdaptiveRate as AdaptiveRateSpec
from deepbots_cli.scenario.training import Hindsight as HindsightSpec
from deepbots_cli.scenario.training import Teacher as TeacherSpec
from deepbots_cli.scenario.training import Training as TrainingSpec

if TYPE_CHECKING:
    from deepbots_cli.compiler import CheckedScenario

_MAX_LEARNING_RATE = 0.05
"""Largest usual learning rate. The highest default is 3e-3, and Adam moves every weight by about the rate in
each update."""

Action = tuple[Choices | ActionRange, ...]

MAX_VARIANTS = 64
"""The maximum number of cases and stages of one scenario; each is compiled."""
MAX_VALUES = 40_000
"""The maximum number of values of all of them together. The largest scenario that comes with deepbots has
500, of which all 64 would take 32 000."""

_FIXED_SECTIONS = frozenset(
    (
        "deepbots",
        "name",
        "summary",
        "agent",
        "action",
        "observation",
        "critic",
        "goal",
        "curriculum",
        "evaluation",
        "solved",
        "train",
        "role",
        "tune",
    )
)
_SECTIONS_OF_AGENTS = frozenset(("agents", "endings"))
"""Sections that the scenario of each of several agents has in another form."""
_VARIANT_SECTIONS: tuple[NodePath, ...] = (("curriculum",), ("evaluation", "cases"))


def training(
    namespace: Namespace, action: Action, copies: RobotCopies | None, longest_episode: int | None
) -> Training | None:
    """Return the training section; no episode has more than `longest_episode` steps. None where it names no
    algorithm.

    An algorithm that cannot act in this action space is a finding, and so is hindsight without a goal, or
    before an episode can have ended.
    """
    spec, values = namespace.scenario, namespace.values
    if spec.train is None or isinstance(spec.train, Auto):
        return None
    _check_algorithm(spec.train, action, namespace)
    settings = spec.train.hyperparameters
    hyperparameters = _hyperparameters(settings, values)
    replay = _hindsight(settings.get("replay"), namespace)
    starts = settings.get("learning_starts")
    if replay is not None and starts is not None and longest_episode is not None:
        longest = longest_episode * spec.train.environments * (copies.count if copies else 1)
        if starts < longest:
            values.add(
                "DB105",
                ("train", "learning_starts"),
                f"learning begins after {starts:,} steps, but the first episode may not be complete by then,"
                " and hindsight replay samples "
                "goals from complete episodes",
                f"set `learning_starts` to at least {longest:_}",
            )
    _check_shards(spec.train, values)
    _check_network(spec.train.network.hidden, values)
    # A robot with a finding has no copies here, but each copy that the file asks for gives samples.
    has_copies = spec.agent.each is not None or values.is_invalid("each")
    _check_samples(spec.train, values, has_copies=has_copies)
    return Training(
        spec.train.algorithm,
        spec.train.total_timesteps,
        spec.train.environments,
        hyperparameters,
        Network(tuple(spec.train.network.hidden), spec.train.network.activation),
        _action_noise(settings.get("action_noise")),
        replay,
        spec.train.normalize,
        spec.train.device,
        spec.train.shards,
        _teacher(namespace, copies),
        spec.train.staleness,
        spec.train.patience,
        self_play=_self_play(spec.train),
        turns=spec.train.turns,
    )


def _self_play(train: TrainingSpec) -> SelfPlay | None:
    spec = train.self_play
    if spec is None:
        return None
    interval = spec.every or SelfPlay.default_interval(train.total_timesteps)
    return SelfPlay(interval, spec.pool, float(spec.newest), float(spec.scripts), spec.every is None)


def _hyperparameters(settings: Mapping[str, Any], values: ValueReader) -> tuple[Hyperparameter, ...]:
    """Return the hyperparameters with a single value, a schedule or an adaptive rate; an unusual learning
    rate is a finding."""
    parameters = []
    for name, value in settings.items():
        if isinstance(value, AdaptiveRateSpec):
            parameters.append(Hyperparameter(name, AdaptiveRate(value.kl, value.start)))
            continue
        if name == "replay" or not (isinstance(value, (bool, int, float, str)) or value is None):
            continue
        ramp = read_schedule(value) if isinstance(value, str) else None
        parameters.append(Hyperparameter(name, Schedule(*ramp) if ramp else value))
        rate = max(ramp) if ramp else value
        if name == "learning_rate" and isinstance(rate, int | float) and rate > _MAX_LEARNING_RATE:
            values.add(
                "DB505",
                ("train", name),
                f"a learning rate of {rate:g} is unusually high",
                "write a rate from 1e-5 to 1e-2, such as `3e-4`",
            )
    return tuple(parameters)


def _check_shards(train: TrainingSpec, values: ValueReader) -> None:
    if train.shards > train.environments:
        values.add(
            "DB105",
            ("train", "shards"),
            f"`shards` is {train.shards}, but `environments` is only {train.environments}",
            "use at most one shard for each environment",
        )
    path = ("train", "staleness")
    if train.staleness and train.shards == 1:
        values.add(
            "DB105",
            path,
            "only shards may act with older weights",
            "set `shards` to at least 2, or leave out `staleness`",
        )
    if train.staleness and train.teacher is not None:
        values.add(
            "DB105",
            path,
            "with a teacher, shards cannot act with older weights",
            "leave out `staleness` or `teacher`",
        )


def _check_network(hidden: Sequence[int], values: ValueReader) -> None:
    """Report layers that no training accepts."""
    path = ("train", "network", "hidden")
    weights = sum(width * next_width for width, next_width in pairwise(hidden))
    if len(hidden) > MAX_LAYERS:
        headline = f"a policy has at most {MAX_LAYERS} hidden layers, not {len(hidden)}"
        values.add("DB105", path, headline, "leave out some layers")
    elif weights > MAX_WEIGHTS:
        headline = f"the hidden layers have {weights:,} weights, and the limit is {MAX_WEIGHTS:,}"
        values.add("DB105", path, headline, "use fewer units")


def _check_samples(train: TrainingSpec, values: ValueReader, *, has_copies: bool) -> None:
    """Report settings of an update that Stable-Baselines3 refuses."""
    settings = train.hyperparameters
    if settings.get("clip_range_vf") == 0.0:
        headline = "with a `clip_range_vf` of 0, the value function learns nothing"
        values.add("DB105", ("train", "clip_range_vf"), headline, "write a number above 0, or leave it out")
    is_one_sample = settings.get("n_steps") == train.environments == 1 and not has_copies
    # PPO and its kin normalize advantages by their standard deviation, which a single sample lacks.
    normalizes = settings.get(
        "normalize_advantage", train.on_policy and "batch_size" in train.hyperparameter_names()
    )
    if is_one_sample and normalizes:
        headline = "an update has a single sample, and normalized advantages need two"
        values.add("DB105", ("train", "n_steps"), headline, "set `n_steps` to at least 2")


def _teacher(namespace: Namespace, copies: RobotCopies | None) -> Teacher | None:
    assert namespace.scenario.train is not None
    teacher = namespace.scenario.train.teacher
    values = namespace.values
    if teacher is None:
        return None
    spec = teacher if isinstance(teacher, TeacherSpec) else TeacherSpec(script=str(teacher))
    path = ("train", "teacher") if isinstance(teacher, str) else ("train", "teacher", "script")
    if spec.script not in namespace.scenario.scripts and not values.is_invalid("scripts"):
        suggestion = nearest_word(spec.script, namespace.scenario.scripts)
        help = f"did you mean `{suggestion}`?" if suggestion else "name a script from `scripts`"
        fix = Fix.replacing(values.span(path), spec.script, suggestion, safe=False) if suggestion else None
        values.add("DB201", path, f"there is no script `{spec.script}`", help, fix=fix)
    elif copies is not None:
        values.add("DB102", path, "a teacher cannot teach copies of a robot", "leave out `teacher`")
    return Teacher(spec.script, float(spec.share))


def _action_noise(noise: ActionNoiseSpec | None) -> ActionNoise | None:
    if noise is None:
        return None
    start, end = read_schedule(noise.sigma) or (0.0, 0.0)  # the schema has read it before
    return ActionNoise(noise.type, Schedule(start, end), noise.theta)


def _hindsight(hindsight: HindsightSpec | str | None, namespace: Namespace) -> Hindsight | None:
    if hindsight is None or hindsight == "uniform":
        return None
    values = namespace.values
    if namespace.scenario.goal is None and not values.is_invalid("goal"):
        values.add(
            "DB102",
            ("train", "replay"),
            "hindsight replay without a `goal`",
            "add a `goal` with `achieved` and `desired`, or remove `replay`",
        )
    return (
        Hindsight(hindsight.n_sampled_goal, hindsight.goal_selection_strategy)
        if isinstance(hindsight, HindsightSpec)
        else Hindsight()
    )


def _check_algorithm(train: TrainingSpec, action: Action, namespace: Namespace) -> None:
    if (refusal := _refusal(type(train), train, action, namespace)) is None:
        return
    headline, help = refusal
    accepted = next(
        (
            name
            for name in ("PPO", "MaskablePPO")
            if _refusal(ALGORITHMS[name], train, action, namespace) is None
        ),
        None,
    )
    if accepted is not None and train.acts_by == {"ranges"} and isinstance(action[0], Choices):
        keys = [
            key
            for key in entries_at(namespace.values.root, "train")
            if key not in type(train).model_fields and key in ALGORITHMS[accepted].model_fields
        ]
        also = f", which uses {listed(keys)}" if keys else ""
        help = f"to keep the choices, write `algorithm: {accepted}`{also}; to keep {train.algorithm}, {help}"
    elif accepted is not None:
        help = f"use {accepted}, or {help}"
    namespace.values.add("DB612", ("train", "algorithm"), headline, help)


def _refusal(
    kind: type[TrainingSpec], train: TrainingSpec, action: Action, namespace: Namespace
) -> tuple[str, str] | None:
    """Return why an algorithm with the settings of `train` cannot learn, and the change of the scenario with
    which it can; None if it can."""
    name, acts_by = train.algorithm, kind.acts_by
    intervals = [part for part in action if isinstance(part, ActionRange)]
    if intervals and len(intervals) < len(action):
        choice = next(part.name for part in action if isinstance(part, Choices))
        return (
            "no algorithm supports choices and ranges in the same agent",
            f"make every action a range: write `{choice}: -1 .. 1` instead of its choices, and where it is"
            f" used, for example `1 if {choice} > 0 else 0`",
        )
    if acts_by == {"choice"} and (intervals or len(action) > 1):
        return f"{name} supports only a single discrete action", "define one action with `choices`"
    if "ranges" not in acts_by and intervals:
        return f"`{name}` supports only discrete actions", "define one action with `choices`"
    if acts_by == {"ranges"} and len(intervals) < len(action):
        return (
            f"{name} supports only continuous actions",
            f"make every action a range: `{action[0].name}: -1 .. 1`",
        )
    if getattr(train, "use_sde", None) and len(intervals) < len(action):
        return "`use_sde` explores ranges, and no choices", "remove `use_sde`"
    if not kind.uses_masks and any(
        isinstance(part, DiscreteAction) and part.forbid for part in namespace.scenario.action.values()
    ):
        return f"{name} ignores `forbid`", "remove `forbid`"
    if train.teacher is not None and kind.is_recurrent:
        return f"`{name}` cannot learn from a teacher", "remove `teacher`"
    if train.symmetry is not None and not (kind.mirrors and train.teacher is None):
        learner = "a training with a teacher" if kind.mirrors else name
        return f"{learner} cannot learn from mirror images", "remove `symmetry`"
    if namespace.scenario.critic and not kind.has_critic:
        return f"{name} has no critic beside its policy, so it cannot use `critic`", "remove `critic`"
    return None


Check = Callable[[Document], "CheckedScenario"]
VariantKind = Literal["case", "stage"]


def compile_variants(
    document: Document, spec: Scenario, program: Program, findings: Findings, check: Check
) -> tuple[tuple[CheckedScenario, ...], Program]:
    """Check every case and stage of a scenario that has no errors itself. Returns the results, and the task
    with the cases and stages that have no errors."""
    if document.root is None:
        return (), program
    values = ValueReader(document.root, findings, {})
    compiler = _VariantCompiler(document, values, program, check)
    count = len(spec.evaluation.cases) + len(spec.stages)
    size = count_and_depth(document.root)[0]
    if count > MAX_VARIANTS or count * size > MAX_VALUES:
        many = f"more than {MAX_VARIANTS}" if count > MAX_VARIANTS else str(count)
        scenario = "" if count > MAX_VARIANTS else f" of a scenario with {size:,} values"
        values.add_at_key(
            "DB005",
            ("curriculum",) if spec.stages else ("evaluation", "cases"),
            f"{many} cases and stages{scenario} are too many",
            "use fewer cases and stages",
        )
        return (), program
    compiler.check_order(spec)
    cases = [
        (
            name,
            case.episodes or spec.evaluation.episodes,
            compiler.program("case", name, ("evaluation", "cases", name)),
        )
        for name, case in spec.evaluation.cases.items()
    ]
    stages = [
        (stage, compiler.program("stage", stage.name, ("curriculum", index)))
        for index, stage in enumerate(spec.stages)
    ]
    return tuple(compiler.checked), replace(
        program,
        cases=tuple(
            EvaluationCase(name, episodes, variant)
            for name, episodes, variant in cases
            if variant is not None
        ),
        curriculum=tuple(
            CurriculumStage(stage.name, _criterion(stage.until), variant)
            for stage, variant in stages
            if variant is not None
        ),
    )


def _criterion(text: str | None) -> Criterion | None:
    criterion = read_until(text)
    if criterion is None:
        return None
    if criterion.metric == "steps":
        return Criterion("steps", criterion.threshold)
    return Criterion(criterion.metric, criterion.threshold, criterion.episodes)


class _VariantCompiler:
    """Checks the scenario under one group of settings after the other."""

    def __init__(self, document: Document, values: ValueReader, program: Program, check: Check) -> None:
        self.checked: list[CheckedScenario] = []
        self._document = document
        self._values = values
        self._base = program
        self._known = {finding.sort_key for finding in values.findings}
        self._check = check

    def check_order(self, spec: Scenario) -> None:
        """Check that every stage but the last has an end, and that no two have the same name."""
        values = self._values
        first: dict[str, NodePath] = {}
        for index, stage in enumerate(spec.stages):
            path: NodePath = ("curriculum", index)
            name_path: NodePath = (*path, "name")
            if stage.name in first:
                also = (Label(values.span(first[stage.name]), "first defined here"),)
                values.add(
                    "DB202",
                    name_path,
                    f"`{stage.name}` is already a stage",
                    "choose another name",
                    labels=also,
                )
            first.setdefault(stage.name, name_path)
            last = index == len(spec.stages) - 1
            criterion = read_until(stage.until)
            if criterion and criterion.metric == "success_rate" and not spec.defines_success:
                until = f"until: mean_return >= 100 over {criterion.episodes} episodes"
                help = success_help(
                    self._base.truncation,
                    self._base.period,
                    until,
                    bool(spec.termination.failure),
                    self._document.agent,
                )
                values.add_at_key("DB407", (*path, "until"), NO_SUCCESS_DEFINED, help)
            if stage.until is None and not last:
                help = "add `until: success_rate >= 0.7 over 40 episodes`"
                values.add(
                    "DB102",
                    name_path,
                    f"the stage `{stage.name}` never ends, so the next stage never begins",
                    help,
                )
            elif stage.until is not None and last:
                help = "remove it; `solved` determines when the training ends"
                values.add_at_key("DB407", (*path, "until"), "the last stage has an `until`", help)

    def program(self, word: VariantKind, name: str, path: NodePath) -> Program | None:
        """Return the task under the `set` at `path`; None after a finding."""
        entries = entries_at(self._values.root, *path, "set").values()
        if [entry for entry in entries if self._is_fixed(entry, word)]:
            return None
        findings = Findings(self._document.findings.limit)
        root = without_paths(self._values.root, (*_VARIANT_SECTIONS, *self._tests(word, name)))
        assert isinstance(root, MappingNode)  # the root stays a mapping
        for entry in entries:
            root = apply_setting(root, entry, findings)
        checked = self._check(replace(self._document, root=root, findings=findings))
        named: dict[str, Any] = {word: name}
        checked = replace(checked, tests=tuple(replace(test, **named) for test in checked.tests))
        self.checked.append(checked)
        name_span = self._values.key_span(path) if word == "case" else self._values.span((*path, "name"))
        entry_spans = [
            Span(entry.key.span.source, entry.key.span.start, entry.value.span.end) for entry in entries
        ]
        for finding in checked.findings:
            # A variant is checked as a whole, so it repeats the findings of the scenario itself.
            if finding.sort_key not in self._known:
                inside = any(
                    span.source is finding.span.source and span.start <= finding.span.start <= span.end
                    for span in entry_spans
                )
                also, help, fix = finding.labels, finding.help, finding.fix
                if not inside:
                    fix = None  # it could make the scenario itself wrong
                    also = (*also, Label(name_span, f"with the settings of the {word} `{name}`"))
                    if name_span.source is not self._document.source:
                        removed = ".".join(map(str, path))
                        help = f"{help or 'change it'}; or leave this {word} out: `remove: [{removed}]`"
                self._values.findings.append(replace(finding, labels=also, help=help, fix=fix))
        return (
            checked.program
            if checked.program is not None
            and self._admits_same_policy(checked.program, word, name, name_span)
            else None
        )

    def _tests(self, word: VariantKind, name: str) -> Iterator[NodePath]:
        """Yield the paths that a variant leaves out of `tests`: all other tests, and the keys that name the
        variant."""
        tests = self._values.root.get("tests")
        if isinstance(tests, MappingNode):
            for test, entry in tests.entries.items():
                node = entry.value.get(word) if isinstance(entry.value, MappingNode) else None
                yield (
                    ("tests", test, word)
                    if isinstance(node, ScalarNode) and node.text == name
                    else ("tests", test)
                )

    def _is_fixed(self, entry: Entry, word: VariantKind) -> bool:
        """Return whether a setting changes a property that a policy is made for, after a finding about it."""
        setting = entry.key.text.strip()
        path = setting_path(self._values.root, setting)
        head = str(path[0]) if path else ""
        help = (
            f"remove this change; a {word} can change the world, the reset, the reward, the endings and"
            " the parameters"
        )
        # The run has one copy of the robot, with the arguments of the scenario.
        places = [place for place, _ in walk_nodes(entry.value, path)]
        if any(place[:1] + place[2:3] == ("robots", "xacro") for place in places):
            head = "xacro"
        elif self._document.agent is not None and (
            head in _SECTIONS_OF_AGENTS or (head == "truncation" and max(map(len, places)) > 2)
        ):
            head = setting
            help = f"use a parameter there, and change the parameter in the {word}"
        elif head not in _FIXED_SECTIONS:
            return False
        self._values.add("DB407", entry.key.span, f"a {word} cannot change `{head}`", help)
        return True

    def _admits_same_policy(self, program: Program, word: VariantKind, name: str, name_span: Span) -> bool:
        """Return whether a policy for the scenario itself can act in this one, else after a finding."""
        lines = identity.differences(self._base, program, words=("in the scenario", f"in this {word}"))
        if word == "stage" and program.world.timestep != self._base.world.timestep:
            lines.append(
                f"timestep: in the scenario {self._base.world.timestep:g} s, in this {word}"
                f" {program.world.timestep:g} s"
            )
        if program.engine != self._base.engine:
            help = (
                "remove the change; to evaluate a policy in both engines, use `deepbots eval RUN --engine"
                " mujoco,pybullet`"
            )
            self._values.add("DB407", name_span, f"the {word} `{name}` cannot change `world.engine`", help)
            return False
        if lines:
            timestep = "the timestep, " if word == "stage" else ""
            help = f"keep {timestep}the observation, the action and the messages as in the scenario"
            if any(line.startswith("observation.") for line in lines):
                help += f"; if a range uses a parameter that the {word} changes, write the range as numbers"
            sent = {robot.name: len(robot.emit) for robot in self._base.robots}
            for robot in program.robots:
                if len(robot.emit) > sent.get(
                    robot.name, math.inf
                ):  # without an `emit`, which would be equal
                    listed = ", ".join(field.name for field in robot.emit)
                    help = (
                        f"`{robot.name}` sends only what the scenario itself uses; let it always send"
                        f" all: `emit: [{listed}]`"
                    )
            self._values.add(
                "DB613",
                name_span,
                f"the {word} `{name}` changes the interface of the policy",
                help,
                notes=tuple(lines[:5]),
            )
        return not lines


# Tests of the scenario: who acts, for how long, and the expected result

MAX_TESTS = 200
MAX_STEPS = 1_000_000
"""The maximum number of timesteps of a test: a few minutes in a light world."""
_RATE_KEYS: tuple[ExpectedKey, ...] = ("success_rate", "failure_rate", "mean_return")
_CONDITIONS: tuple[ExpectedKey, ...] = ("always", "eventually")
_MAX_SHOWN_VALUES = 4
"""The number of values that a failed condition shows."""


def scenario_tests(namespace: Namespace, program: Program) -> tuple[ScenarioTest, ...]:
    """Return the tests without findings, compiled in the namespace of `program`. A test that names a case or
    a stage is compiled in that variant, which has neither name."""
    specs = namespace.scenario.tests
    values = namespace.values
    if len(specs) > MAX_TESTS:
        values.add_at_key(
            "DB005", ("tests",), f"more than {MAX_TESTS} tests", "join tests, or write another file"
        )
        return ()
    reader = _Reader(namespace, program)
    tests = [reader.test(name, spec) for name, spec in specs.items()]
    return tuple(test for test in tests if test is not None)


class _Reader(NamespaceReader):
    def __init__(self, namespace: Namespace, program: Program) -> None:
        super().__init__(namespace)
        self._program = program
        self._decisions = Decisions(namespace, program.agent.action, namespace.scope(Context.FIXED))
        self._scope = SupervisorScope(namespace, Context.TEST)

    def test(self, name: str, spec: TestSpec) -> ScenarioTest | None:
        """Return the test; None after an error, or if it names a case or a stage."""
        if self._names_variant(spec):
            return None
        errors_before = len(self._values.findings.errors)
        driver = self._actions(spec) if spec.actions is not None else self._driver(spec)
        if spec.agent is not None:
            self._values.add_at_key(
                "DB101",
                (*spec.path, "agent"),
                "`agent` of a test belongs to a scenario with several `agents`",
                "remove it",
            )
        expected = tuple(self._expected(spec.expect))
        steps = self._steps(spec, driver)
        if len(self._values.findings.errors) > errors_before or driver is None:
            return None
        span = self._values.key_span(("tests", name))
        return ScenarioTest(name, span, driver, spec.episodes, spec.seed, steps, expected)

    def _names_variant(self, spec: TestSpec) -> bool:
        """Return whether the test names a case or a stage, after a finding if there is none of this name."""
        cases, stages = list(self._spec.evaluation.cases), [stage.name for stage in self._spec.stages]
        for word, section, variant, names in (
            ("case", "cases", spec.case, cases),
            ("stage", "curriculum", spec.stage, stages),
        ):
            if variant is not None and variant not in names and not self._values.is_invalid(section):
                self._values.report_unknown(self._values.field(spec, word).span, word, variant, names)
        return spec.case is not None or spec.stage is not None

    # Who acts, for how long

    def _driver(self, spec: TestSpec) -> str | None:
        if isinstance(spec.driver, dict):
            self._values.add(
                "DB103",
                (*spec.path, "driver"),
                "a driver of each agent belongs to a scenario with several `agents`",
                "write one driver",
            )
            return None
        name = spec.driver or ""
        drivers = [*self._spec.scripts, *REFERENCE_KINDS["driver"].words]
        if name not in drivers and not (self._values.is_invalid("scripts") or self._values.is_invalid(name)):
            self._values.report_unknown(self._values.field(spec, "driver").span, "script", name, drivers)
        return name

    def _actions(self, spec: TestSpec) -> tuple[FixedAction, ...] | None:
        fixed_actions = [
            self._action((*spec.path, "actions", index), value)
            for index, value in enumerate(spec.actions or ())
        ]
        actions = tuple(action for action in fixed_actions if action is not None)
        return actions if len(actions) == len(fixed_actions) else None

    def _action(self, path: NodePath, value: object) -> FixedAction | None:
        names = list(self._spec.action)
        if not isinstance(value, dict):
            if len(names) > 1:
                self._values.add(
                    "DB103",
                    path,
                    f"one value for an action of {len(names)} parts",
                    f"write `{{{': ..., '.join(names)}: ...}}`",
                )
                return None
            value = dict.fromkeys(names, value)
        return self._fixed(path, self._decisions.read(path, value, "the action"))

    def _fixed(
        self, path: NodePath, decided: tuple[ScriptedChoice | ScriptedRange, ...] | None
    ) -> FixedAction | None:
        choices: list[int] = []
        ranges: list[float] = []
        words: list[str] = []
        for part, decision in zip(self._program.agent.action, decided or (), strict=False):
            if isinstance(part, Choices) and isinstance(decision, ScriptedChoice):
                choices.append([option.name for option in part.options].index(decision.otherwise))
                words.append(decision.otherwise)
            elif isinstance(part, ActionRange) and isinstance(decision, ScriptedRange):
                numbers = [
                    number
                    for value in decision.values
                    for number in constant_values(value.typed) or (math.nan,)
                ]
                if not all(map(math.isfinite, numbers)):
                    self._values.add(
                        "DB407",
                        path,
                        f"the value of `{part.name}` must be the same in every episode",
                        "write fixed values, or use a script from `scripts`",
                    )
                    return None
                middle, half = (part.high + part.low) / 2, (part.high - part.low) / 2
                shares = [min(max((number - middle) / half, -1.0), 1.0) for number in numbers]
                shares *= decision.size if len(shares) == 1 else 1
                ranges += shares
                words += [f"{share:g}" for share in shares]
        return None if decided is None else FixedAction(tuple(choices), tuple(ranges), ":".join(words))

    def _steps(self, spec: TestSpec, driver: str | tuple[FixedAction, ...] | None) -> int:
        """Return the largest number of steps of an episode; a finding if all episodes of the test may take
        too many."""
        period = self._program.period
        longest = Truncation(spec.max_steps, self._fields.fixed(spec, "max_time")).max_episode_steps(period)
        steps = min(
            longest,
            self._program.truncation.max_episode_steps(period),
            len(driver) if isinstance(driver, tuple) else longest,
        )
        total = steps * self._program.action_repeat * spec.episodes
        # An episode without a time limit has 2**63 steps here, and DB803 reports it.
        if total > MAX_STEPS and self._program.truncation != Truncation():
            self._values.add_at_key(
                "DB105",
                spec.path,
                f"the test takes {total:_} timesteps; the limit is {MAX_STEPS:_}",
                "lower `episodes`, `max_steps` or `max_time`",
            )
        return steps

    # Expected results

    def _expected(self, spec: Expectation) -> Iterator[ExpectedResult]:
        ends = self._spec.termination
        endings = {"success_rate": self._spec.defines_success, "failure_rate": ends.failure}
        for key in _RATE_KEYS:
            if getattr(spec, key) is not None:
                text = self._values.field(spec, key)
                bounds = self._bounds(spec, key)
                if not endings.get(key, True) and not any(
                    map(self._values.is_invalid, ("success", "failure", "termination", "goal"))
                ):
                    headline = (
                        NO_SUCCESS_DEFINED
                        if key == "success_rate"
                        else "a failure rate needs a failure, but the scenario does not define one"
                    )
                    agent, outcome = self._namespace.document.agent, key.removesuffix("_rate")
                    help = (
                        f"add a condition under `termination.{outcome}`"
                        if agent is None
                        else f"name `{agent}` under `{outcome}` in `endings`"
                    )
                    help += ", or expect something else, such as `ends_by`"
                    self._values.add("DB407", text.span, headline, help)
                if bounds is not None:
                    yield ExpectedResult(key, text.span, text.text, *bounds)
        if spec.ends_by is not None:
            yield from self._ends_by(spec)
        for key in _CONDITIONS:
            conditions = getattr(spec, key)
            if isinstance(conditions, tuple):
                for index in range(len(conditions)):
                    yield from self._condition(key, (*spec.path, key, index))
            elif conditions is not None:
                yield from self._condition(key, (*spec.path, key))

    def _bounds(self, spec: Expectation, key: str) -> tuple[float, float] | None:
        """Return the smallest and the largest expected value; None after a finding."""
        text = self._values.field(spec, key)
        scope = self._namespace.scope(Context.FIXED)
        report = self._values.reporter(text)
        called = f"`{key}`"
        if ".." in text.text:
            interval = self._values.range(text, scope)
            ends = interval and expect_range(interval, report, called, dimension=NUMBER)
            trees = [ends.low, ends.high] if ends else []
        else:
            typed = self._values.quantity(text, called, scope, NUMBER)
            trees = [typed] if typed else []
        numbers = [self._values.fixed(tree, text, called) for tree in trees]
        bounds = [float(number[0]) for number in numbers if number is not None]
        if not bounds or len(bounds) < len(trees):
            return None
        low, high = (*bounds, math.inf)[:2]
        if key != "mean_return" and not (0 <= low <= 1 and (high == math.inf or 0 <= high <= 1)):
            self._values.add(
                "DB105",
                text.span,
                f"{called} is {text.text}, but a rate is between 0 and 1",
                "write a number from 0 to 1, or a percentage such as `90 %`",
            )
            return None
        return low, high

    def _ends_by(self, spec: Expectation) -> Iterator[ExpectedResult]:
        termination, limits = self._spec.termination, self._spec.truncation
        cuts = [name for name in ("max_steps", "max_time") if getattr(limits, name, None) is not None]
        endings = [*termination.success, *termination.failure, *cuts]
        several = isinstance(spec.ends_by, tuple)
        names = spec.ends_by if isinstance(spec.ends_by, tuple) else (spec.ends_by or "",)
        for index, name in enumerate(names):
            self._namespace.mark_used(name)
            if name not in endings and not self._values.is_invalid(
                "truncation" if name.startswith("max_") else "termination"
            ):
                path: NodePath = (*spec.path, "ends_by", index) if several else (*spec.path, "ends_by")
                self._values.report_unknown(self._values.span(path), "ending", name, endings)
        yield ExpectedResult(
            "ends_by", self._values.span((*spec.path, "ends_by")), " or ".join(names), endings=tuple(names)
        )

    def _condition(self, key: ExpectedKey, path: NodePath) -> Iterator[ExpectedResult]:
        text = self._values.text(path)
        typed = self._values.condition(text, self._scope)
        if typed is not None:
            compared = tuple(
                Expression(
                    text.text[part.start : part.end],
                    text.span,
                    text.text[part.start : part.end],
                    part,
                    text.owner,
                )
                for part in _compared(typed)
            )
            yield ExpectedResult(
                key,
                text.span,
                text.text,
                condition=text.expression(typed),
                compared=compared[:_MAX_SHOWN_VALUES],
            )


def _compared(tree: TypedNode) -> Iterator[TypedNode]:
    """Yield the single values that comparisons of a condition compare, except constants."""
    spans: set[tuple[int, int]] = set()
    for node in walk(tree):
        if isinstance(node, Operation) and node.operator in COMPARISONS.values():
            for part in node.args:
                single = part.type.components is None and not part.type.boolean
                if (
                    single
                    and constant_values(part) is None
                    and not isinstance(part, Constant)
                    and (part.start, part.end) not in spans
                ):
                    spans.add((part.start, part.end))
                    yield part
