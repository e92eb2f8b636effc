"""The compiler: a document to a checked program, that to Python.

    check     nodes ─▶ spec (schema) ─▶ names ─▶ typed expressions ─▶ Program   this module
    emit      Program ─▶ Python                                                 emit/

values.py       texts to typed trees, findings at their places; values that every episode draws anew; colours
namespace.py    one flat namespace, each name typed when first asked for; what an expression may see from its place;
                fields of the scenario, resolved by their annotations
world.py        timestep, ground, arena, terrain, painted lines, walls and objects, with their files
robots.py       robot files and their changes, patterns and groups, what joints measure
controllers.py  actuators and their limits, poses, commands and messages of a robot
sensing.py      its sensors: kinds, frames on links, rays, cameras, errors
channels.py     latency, loss and range of messages, repeated draws, disturbances
policy.py       action, observation, goal, scripts, copies of a robot
scoring.py      signals, reward, endings, limits; the age of readings
places.py       placements, layouts, maps, and whether there is room
resets.py       how an episode begins: arrangements, groups, joints
variants.py     training; cases of the evaluation and stages of the curriculum
inputs.py       the files that the scenario was made from, as a run keeps copies of them
inventory.py    the names of a scenario by kind, for editors and its JSON Schema
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

from deepbots_cli.compiler.channels import disturbances, is_repeated_as_a_whole, route
from deepbots_cli.compiler.controllers import Controller
from deepbots_cli.compiler.inputs import Inputs
from deepbots_cli.compiler.namespace import Namespace, Origin, ParameterScope
from deepbots_cli.compiler.policy import Actions, Goals, Observations, copies, scripts
from deepbots_cli.compiler.resets import arrangement, group, joint_starts
from deepbots_cli.compiler.robots import RobotScene, load_robot
from deepbots_cli.compiler.scoring import Signals, reward_terms, solved, truncation, with_reading_ages
from deepbots_cli.compiler.values import Values, lost_names
from deepbots_cli.compiler.variants import training
from deepbots_cli.compiler.world import lines, pieces, world
from deepbots_cli.diagnostics import Finding, Findings, Fix, TooManyFindings
from deepbots_cli.document import Document
from deepbots_cli.document.hints import as_a_number
from deepbots_cli.document.nodes import Mapping as Tree
from deepbots_cli.document.nodes import descend
from deepbots_cli.expressions import unification
from deepbots_cli.expressions.types import Context, Stage, Symbol
from deepbots_cli.program import Program
from deepbots_cli.program.task import Agent
from deepbots_cli.program.training import Evaluation
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import ARENA_WALLS, MAX_SETTLING_STEPS
from deepbots_cli.scenario.base import visit
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.validate import validate

__all__ = ["Checked", "check"]

_SPELLING = frozenset({"DB003", "DB004"})  # warnings about how a value is spelt


@dataclass(frozen=True, eq=False)
class Checked:
    """A document that was checked; `program` is None where findings at error level left nothing to compile.

    `variants` are the same for the scenario under the settings of each case and stage.
    """

    document: Document
    findings: Findings
    spec: Scenario | None = None
    program: Program | None = None
    robots: Mapping[str, RobotScene] | None = None
    namespace: Namespace | None = None
    variants: tuple[Checked, ...] = ()

    @property
    def inputs(self) -> Inputs:
        """Every file that was read."""
        files = self.namespace.files if self.namespace else {}
        return Inputs(self.document, self.robots or {}, files, tuple(variant.inputs for variant in self.variants))

    def release(self) -> None:
        """Forget what names mean, once all is known that was asked. Names and their definitions hold each other, and would be left to
        Python's search for garbage, which took a fifth of the time of linting a folder.
        """
        for checked in (self, *self.variants):
            if checked.namespace is not None:
                checked.namespace.release()


def check(document: Document) -> Checked:
    """Run all passes that can run; every problem ends up in `findings`, unless they are too many."""
    try:
        return _with_cases(document)
    except TooManyFindings as too_many:
        document.findings.give_up(too_many)
        return Checked(document, document.findings)


def _with_cases(document: Document) -> Checked:
    checked = _check(document)
    if checked.program is None or checked.spec is None or not (checked.spec.evaluation.cases or checked.spec.curriculum):
        return checked
    from deepbots_cli.compiler.variants import with_cases  # brings the back end, which most linting does without

    variants, program = with_cases(document, checked.spec, checked.program, checked.findings, _check)
    return replace(checked, program=None if checked.findings.errors else program, variants=variants)


def _check(document: Document) -> Checked:
    findings = document.findings
    if document.root is None:
        return Checked(document, findings)
    spec = validate(document.root, findings)
    if spec is None:
        return Checked(document, findings)
    pass_ = _Pass(document, document.root, spec, findings)
    program = pass_.run()
    robots = {name: robot for name, robot in pass_.namespace.robots.items() if robot is not None}
    return Checked(document, _joined(findings), spec, None if findings.errors else program, robots, pass_.namespace)


def _joined(findings: Findings) -> Findings:
    """A warning about a value that is in error anyway, or about how such a value is spelt, becomes a note of the error."""
    everything = list(findings)
    warnings = [found for found in everything if found.severity == "warning"]
    if not warnings or len(warnings) == len(everything):
        return findings
    errors: dict[str, list[Finding]] = {}
    for found in everything:  # sorted by place, and so each list is
        if found.severity == "error":
            errors.setdefault(found.span.source.name, []).append(found)
    notes: dict[int, list[str]] = {}
    fixes: dict[int, Fix] = {}
    absorbed = set()
    for warning in warnings:
        error = _absorber(warning, errors.get(warning.span.source.name, []))
        if error is not None:
            notes.setdefault(id(error), []).append(warning.headline)
            absorbed.add(id(warning))
            if warning.code == "DB004" and (fix := as_a_number(warning.span)):
                fixes[id(error)] = fix
    joined = Findings()
    for found in everything:
        if id(found) not in absorbed:
            joined.append(replace(found, notes=(*found.notes, *notes.get(id(found), ())), fix=found.fix or fixes.get(id(found))))
    return joined


def _absorber(warning: Finding, errors: list[Finding]) -> Finding | None:
    """The first error at the place of a warning, or, for one about spelling, within it; `errors` are sorted by place."""
    outer, within = warning.span, warning.code in _SPELLING
    first = bisect_left(errors, outer.start, key=_start)
    last = bisect_right(errors, outer.end if within else outer.start, lo=first, key=_start)
    return next((found for found in errors[first:last] if found.span.end == outer.end or (within and found.span.end < outer.end)), None)


def _start(finding: Finding) -> int:
    return finding.span.start


class _Pass:
    """One scenario on its way from spec to program."""

    def __init__(self, document: Document, root: Tree, spec: Scenario, findings: Findings) -> None:
        self.document = document
        self.spec = spec
        kinds = {path: kind for path, kind, _ in visit(spec)}
        self.values = Values(root, findings, kinds, lost_names(root, spec.pruned, (found.span for found in findings.errors)))
        self.namespace = Namespace(self.values, document)
        self.parameters: dict[str, Expression] = {}

    def run(self) -> Program:
        spec, namespace = self.spec, self.namespace
        self._define_parameters()
        for name in spec.robots:
            namespace.define(name, Origin.ROBOT, ("robots", name))
        for name, thing in spec.objects.items():
            namespace.define(name, Origin.OBJECT, ("objects", name))
            if "count" in thing.model_fields_set:
                found = group(name, thing, namespace)
                namespace.groups |= {name: found} if found else {}
                if found is None:
                    self.values.lose(name)
        for name, wall in spec.world.walls.items():
            namespace.define(name, Origin.WALL, ("world", "walls", name))
            if namespace.origin(name) is Origin.WALL:
                namespace.walls[name] = pieces(name, wall)
        if spec.world.arena is not None:
            namespace.walls["arena"] = ARENA_WALLS
        for name in spec.world.lines:
            namespace.define(name, Origin.LINE, ("world", "lines", name))
        self.lines = lines(spec, namespace)
        for name, robot in spec.robots.items():
            namespace.robots[name] = load_robot(name, robot, namespace) if self._is_whole(name) else None
        actions, goals = Actions(spec, namespace), Goals(spec, namespace)
        scenes = [scene for scene in namespace.robots.values() if scene is not None]
        controllers = [Controller(scene, namespace) for scene in scenes]
        signals = Signals(spec, namespace)
        return self._assemble(actions, goals, controllers, signals, scenes)

    def _assemble(
        self, actions: Actions, goals: Goals, controllers: list[Controller], signals: Signals, scenes: list[RobotScene]
    ) -> Program:
        """Ask for everything once; names are typed as they are needed, whatever their order in the file."""
        spec, namespace, values = self.spec, self.namespace, self.values
        for name in namespace.named(Origin.PARAMETER, Origin.FIELD):
            namespace.settle(name)
        bare = world(spec, namespace, scenes, self.lines)
        arranged, walls = arrangement(spec, namespace, bare)
        whole = replace(bare, objects=(*bare.objects, *walls))
        limits = truncation(spec, namespace)
        action, rewards = actions.parts(), reward_terms(spec, namespace)
        agent = Agent(spec.agent.repeat, spec.agent.stack, copies(spec, namespace))
        drawn = tuple(self.parameters[name] for name in namespace.order if name in self.parameters and self._is_drawn(name))
        routes = route(spec, "to_robot", namespace), route(spec, "from_robot", namespace)
        robots = tuple(controller.finish(whole.timestep, action, routes) for controller in controllers)
        program = Program(
            spec.name,
            spec.summary,
            spec.deepbots,
            whole,
            robots,
            spec.messages.format,
            spec.messages.timing,
            drawn,
            action,
            signals.ordered(),
            Observations(spec, namespace).entries(),
            rewards,
            signals.endings(),
            limits,
            replace(
                arranged,
                joint_starts=joint_starts(spec, namespace, {controller.scene.name: controller.poses for controller in controllers}),
                settle=self._settle(whole.timestep),
                variations=(*namespace.variations, *namespace.colours),
                groups=tuple(namespace.groups.values()),
            ),
            solved(spec, namespace),
            training(spec, values, action, agent, limits, whole.timestep),
            Evaluation(spec.evaluation.episodes),
            agent,
            augmented=frozenset(spec.augment),
            disturbances=disturbances(spec, namespace),
            goal=goals.goal(rewards),
            scripts=scripts(spec, namespace, action),
        )
        return with_reading_ages(replace(program, action=actions.with_conditions(action)))

    def _define_parameters(self) -> None:
        for name, given in self.spec.parameters.items():
            self.namespace.define(name, Origin.PARAMETER, ("parameters", name), partial(self._parameter, name, given))

    def _parameter(self, name: str, given: object) -> Symbol:
        text = self.values.field(self.spec, "parameters", name)
        checked = self.values.drawn(text, ParameterScope(self.namespace, Context.PARAMETER))
        if checked is None:
            return Symbol(name, None)
        typed = checked.value
        if not is_repeated_as_a_whole(typed, checked.redraw, text, self.values):
            return Symbol(name, None)
        unification.warn_of_degrees(typed, self.values.report(text))
        fixed = self.values.fixed(typed, text, f"`{name}`") if typed.type.stage is Stage.FIXED else None
        if typed.type.stage is Stage.FIXED and fixed is None:
            return Symbol(name, None)
        self.parameters[name] = Expression(name, text.span, text.text, typed, f"parameters.{name}", redraw=checked.redraw)
        return Symbol(name, typed.type, fixed, text=text.text)

    def _is_drawn(self, name: str) -> bool:
        return self.parameters[name].typed.type.stage is not Stage.FIXED

    def _is_whole(self, robot: str) -> bool:
        """Whether no finding took away what the rest of the scenario may name: the robot's file, or keys of a file it includes."""
        node = descend(self.values.root, ("robots", robot))[0]
        return not (isinstance(node, Tree) and node.partial)

    def _settle(self, tick: float) -> float:
        """Seconds, in whole ticks."""
        settle, span = self.namespace.fixed(self.spec.reset, "settle") or 0.0, self.values.field(self.spec.reset, "settle").span
        if abs(settle - round(settle / tick) * tick) > 1e-9 * settle and not self.values.is_lost("world.timestep"):
            headline = f"a settling time of {settle:g} s, which is no multiple of the timestep of {tick:g} s"
            self.values.findings.add("DB308", span, headline, help="the world moves on in whole timesteps")
        steps = settle / tick * self.spec.world.substeps
        if steps > MAX_SETTLING_STEPS:
            headline = f"a settling time of {settle:g} s, which is more than {MAX_SETTLING_STEPS:_} physics steps in every reset"
            self.values.findings.add("DB105", span, headline, help="a few seconds are usual")
        return settle
