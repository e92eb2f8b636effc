"""The compiler: from the nodes of a document to a checked program.

    nodes ─▶ Scenario (models) ─▶ names ─▶ typed expressions ─▶ Program

texts.py        texts of the scenario with their places, findings at offsets of them, fixes of syntax errors
values.py       the values of fields, read by their annotations; values that every episode draws anew
namespace.py    one flat namespace, each name typed on first use; the names that an expression may use
world.py        timestep, ground, arena, terrain, painted lines, walls and objects, with their files
robots.py       robot files and their changes, patterns and groups, quantities of joints, limits of the file
controllers.py  poses, commands, actuators and messages of a robot
sensing.py      its sensors: kinds, frames on links, rays, cameras, errors; ROS 2 topics
policy.py       action, observation, goal, scripts, copies of a robot
agents.py       several agents: a scenario for each of them
multi_agent.py  their programs as one, and their tests
places.py       placements, layouts, maps
episodes.py     draws (parameters, channels, disturbances), start, signals, reward, endings, limits
learner.py      the learner that deepbots chooses for a scenario that names none; the search of `tune`
evaluation.py   training; cases of the evaluation and stages of the curriculum; tests of the scenario
training.py     a curriculum with levels, and the mirror symmetry of a training
inputs.py       the files that the scenario was made from, as a run keeps copies of them
inventory.py    the names of a scenario by kind, for editors and its JSON Schema
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import partial

from deepbots_cli.compiler.agents import (
    ROLE,
    divide,
    findings_of_other_agents,
    has_several_agents,
    joined_findings,
    models_of_others,
    played_agent,
    program_among_others,
    report_foreign_values,
    report_keys_of_several,
    report_own_names,
    with_sections,
)
from deepbots_cli.compiler.controllers import RobotBuilder, commanded
from deepbots_cli.compiler.episodes import (
    Parameters,
    Signals,
    compile_reset,
    disturbances,
    joint_starts,
    reward_terms,
    route,
    settling_time,
    solved,
    truncation,
    with_reading_ages,
)
from deepbots_cli.compiler.evaluation import compile_variants, scenario_tests, training
from deepbots_cli.compiler.inputs import Inputs
from deepbots_cli.compiler.learner import choose, compile_search, with_learner
from deepbots_cli.compiler.multi_agent import combined_program
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.policy import Actions, Goals, Observations, copies, scripts
from deepbots_cli.compiler.robots import ResolvedRobot, load_robot
from deepbots_cli.compiler.sensing import report_topics_of_no_agent, topics
from deepbots_cli.compiler.texts import verify_fix
from deepbots_cli.compiler.training import levels, symmetry
from deepbots_cli.compiler.values import ValueReader, invalid_names
from deepbots_cli.compiler.world import define_bodies, lines, world
from deepbots_cli.diagnostics import Finding, Findings, TooManyFindings
from deepbots_cli.document import Document
from deepbots_cli.document.value_hints import number_fix
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement, Reset
from deepbots_cli.program.robots import Link
from deepbots_cli.program.task import (
    ONLY_AGENT,
    ActionPart,
    Agent,
    Evaluation,
    RobotCopies,
    ScenarioTest,
    Truncation,
)
from deepbots_cli.program.values import Expression
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.base import visit_values
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.search import SearchSpace
from deepbots_cli.scenario.training import Auto
from deepbots_cli.scenario.validate import validate

__all__ = ["CheckedScenario", "check"]


@dataclass(frozen=True, eq=False)
class CheckedScenario:
    """The result of checking a document; `program` is None if findings at error level left nothing to
    compile.

    `variants` are the results for the scenario under the settings of each case and stage. `tests` are the
    tests of the file, each compiled under its own case or stage. `search` is the search space of each key
    under `tune`. `learner` are the reasons for the learner that deepbots chose where the scenario names no
    algorithm; the document has it under `train`. `agents` are the results for each of several agents, which
    `spec` and `namespace` have no results for; they are those of the first one.
    """

    document: Document
    findings: Findings
    spec: Scenario | None = None
    program: Program | None = None
    robots: Mapping[str, ResolvedRobot] | None = None
    namespace: Namespace | None = None
    variants: tuple[CheckedScenario, ...] = ()
    tests: tuple[ScenarioTest, ...] = ()
    search: Mapping[str, SearchSpace] = field(default_factory=dict)
    learner: tuple[str, ...] = ()
    agents: Mapping[str, CheckedScenario] = field(default_factory=dict)

    @property
    def inputs(self) -> Inputs:
        """Every file that was read."""
        files = self.namespace.files if self.namespace else {}
        return Inputs(
            self.document, self.robots or {}, files, tuple(variant.inputs for variant in self.variants)
        )

    def release_names(self) -> None:
        """Release the definitions of names; call this last.

        Names and definitions refer to each other. Otherwise Python's garbage collector frees them, which took
        a fifth of the time of linting a folder.
        """
        checked = [self, *self.variants, *(inner for variant in self.variants for inner in variant.variants)]
        for namespace in {id(scenario.namespace): scenario.namespace for scenario in checked}.values():
            if namespace is not None:
                namespace.release()


def check(document: Document, *, to_train: bool = False, is_alone: bool = True) -> CheckedScenario:
    """Run all passes that can run; every problem ends up in `findings`, unless they are too many.

    `to_train` chooses the learner of a scenario without `train` too. `is_alone` is False for the scenario of
    one of several agents.
    """
    # Other texts of the document are not corrected in turn.
    passes = partial(_all_passes, to_train=to_train, is_alone=is_alone)
    verify_fix(document, lambda other: len(passes(other).findings.errors))
    return passes(document)


def _all_passes(document: Document, *, to_train: bool, is_alone: bool) -> CheckedScenario:
    try:
        if has_several_agents(document):
            return _check_agents(document, to_train=to_train)
        if is_alone:
            report_keys_of_several(document)
        checked = _check(document)
        train = checked.spec.train if checked.spec is not None else None
        if checked.program is not None and (isinstance(train, Auto) or (to_train and train is None)):
            choice = choose(checked.program, has_teacher=train is not None and train.teacher is not None)
            document, learner = with_learner(document, choice)
            checked = replace(_check(document), learner=learner)
        if checked.program is not None and checked.spec is not None and checked.spec.tune is not None:
            search = compile_search(document, checked.program, checked.findings, _check)
            checked = replace(
                checked, search=search, program=None if checked.findings.errors else checked.program
            )
        if (
            checked.program is None
            or checked.spec is None
            or not (checked.spec.evaluation.cases or checked.spec.stages)
        ):
            return checked
        sent = frozenset(
            f"{robot.name}.{field.name}" for robot in checked.program.robots for field in robot.emit
        )
        check_variant = partial(_check, sent=sent)
        variants, program = compile_variants(
            checked.document, checked.spec, checked.program, checked.findings, check_variant
        )
        by_name = {test.name: test for version in (checked, *variants) for test in version.tests}
        tests = tuple(by_name[name] for name in checked.spec.tests if name in by_name)
        return replace(
            checked, program=None if checked.findings.errors else program, variants=variants, tests=tests
        )
    except TooManyFindings as too_many:
        document.findings.report_limit(too_many)
        return CheckedScenario(document, document.findings)


def _check_agents(document: Document, *, to_train: bool) -> CheckedScenario:
    """Check the scenario of each agent, and join their programs.

    The result is that of all agents, or with a `role` that of this agent beside the others.
    """
    divided = divide(document)
    if divided is None:
        return CheckedScenario(document, document.findings)
    agents = {
        name: check(agent_document, to_train=to_train, is_alone=False)
        for name, agent_document in divided.documents.items()
    }
    joined_findings(
        document.findings,
        (
            findings_of_other_agents(checked_agent.findings, name, divided.drivers)
            for name, checked_agent in agents.items()
        ),
    )
    programs = {name: checked.program for name, checked in agents.items() if checked.program is not None}
    report_topics_of_no_agent(document, programs.values())
    report_own_names(document, programs, divided.sections)
    report_foreign_values(document, programs, divided.drivers)
    is_sound = not document.findings.errors and len(programs) == len(agents)
    program = (
        combined_program(programs, divided.sections, divided.drivers, divided.mirrors) if is_sound else None
    )
    tests: tuple[ScenarioTest, ...] = ()
    if program is not None:
        of_agents = {
            name: {test.name: test for test in checked_agent.tests} for name, checked_agent in agents.items()
        }
        tests = tuple(divided.tests.combined(program, of_agents))
    agents = {
        name: replace(checked_agent, tests=divided.tests.tests_of(name, checked_agent.tests))
        for name, checked_agent in agents.items()
    }
    played = played_agent(document)
    main_agent = agents[played] if played in agents else next(iter(agents.values()))
    if program is not None and played is not None and main_agent.namespace is not None:
        models = models_of_others(document)
        main_agent.namespace.files.update({(ROLE, "others", name): file for name, file in models.items()})
        program = program_among_others(document, program, played, models)
    return CheckedScenario(
        with_sections(document, {name: checked.document for name, checked in agents.items()}),
        document.findings,
        main_agent.spec,
        program,
        {name: robot for checked in agents.values() for name, robot in (checked.robots or {}).items()},
        main_agent.namespace,
        variants=tuple(agents.values()),
        tests=tests,
        learner=main_agent.learner if played is not None else _reasons_of(agents),
        agents={} if played is not None else agents,
    )


def _reasons_of(agents: Mapping[str, CheckedScenario]) -> tuple[str, ...]:
    """Return the reasons for the learners of all agents, once where they are the same for all."""
    reasons = {checked.learner for checked in agents.values()}
    if len(reasons) == 1:
        return reasons.pop()
    return tuple(f"for {name}: {reason}" for name, checked in agents.items() for reason in checked.learner)


def _check(document: Document, sent: frozenset[str] = frozenset()) -> CheckedScenario:
    """Like `check`, but without cases and stages. Robots send the fields `sent`, whether the supervisor uses
    them or not."""
    findings = document.findings
    spec = validate(document.root, findings) if document.root is not None else None
    if document.root is None or spec is None:
        return CheckedScenario(document, findings)
    invalid = invalid_names(document.root, spec.pruned, (finding.span for finding in findings.errors))
    namespace = Namespace(
        ValueReader(
            document.root,
            findings,
            {path: kind for path, kind, _ in visit_values(spec)},
            invalid,
            spec.pruned,
        ),
        document,
        spec,
        sent,
    )
    program = _program(namespace)
    tests = scenario_tests(namespace, program)
    robots = {name: robot for name, robot in namespace.robots.items() if robot is not None}
    return CheckedScenario(
        document,
        _joined(findings),
        spec,
        None if findings.errors else program,
        robots,
        namespace,
        tests=tests,
    )


def _program(namespace: Namespace) -> Program:
    """Define all names, then read everything once. A name is typed on its first use, independent of its order
    in the file."""
    spec = namespace.scenario
    parameters = Parameters(namespace)
    define_bodies(namespace)
    painted = lines(namespace)
    for name, robot in spec.robots.items():
        namespace.robots[name] = load_robot(name, robot, namespace)
    actions = Actions(namespace)
    goals = Goals(namespace)
    builders = [RobotBuilder(robot, namespace) for robot in namespace.resolved_robots]
    # A robot may hear the fields of any other robot, so all of these are defined before.
    for builder in builders:
        builder.define_heard()
    signals = Signals(namespace)

    for name in namespace.names_of(Origin.PARAMETER, Origin.FIELD):
        namespace.resolve(name)
    bare = world(namespace, namespace.resolved_robots, painted)
    timestep = bare.timestep
    reset, walls = compile_reset(namespace, bare)
    limits = truncation(namespace)
    action = actions.parts()
    rewards = reward_terms(namespace)
    robot_copies = copies(namespace)
    routes = route("to_robot", namespace), route("from_robot", namespace)
    links = _links(namespace, builders, has_copies=robot_copies is not None)
    robots = tuple(builder.finish(timestep, action, routes) for builder in builders)
    agent = _agent(namespace, goals, limits, timestep, action, rewards, robot_copies)
    ordered = signals.ordered()  # in the order in which observation, reward and goal use them
    program = Program(
        name=spec.name,
        summary=spec.summary,
        language=spec.deepbots,
        world=replace(bare, objects=(*bare.objects, *walls)),
        robots=robots,
        format=spec.messages.format,
        timing=spec.messages.timing,
        parameters=parameters.drawn(),
        signals=ordered,
        agent=replace(
            agent,
            robots=tuple(commanded(robots, action, ordered)),
            action=actions.with_conditions(action),
        ),
        endings=signals.endings(),
        truncation=limits,
        reset=_complete_reset(reset, namespace, builders, timestep),
        action_repeat=spec.agent.action_repeat,
        evaluation=Evaluation(spec.evaluation.episodes),
        disturbances=disturbances(namespace),
        engine=spec.world.engine,
        supplied_by=tuple(spec.deploy.supplied_by.items()) if spec.deploy else (),
        links=links,
    )
    sending = tuple(
        replace(robot, emit=builder.sent()) for robot, builder in zip(robots, builders, strict=True)
    )
    return with_reading_ages(
        replace(program, robots=sending, ros=topics(namespace, program), levels=levels(namespace, program))
    )


def _links(namespace: Namespace, builders: Sequence[RobotBuilder], *, has_copies: bool) -> tuple[Link, ...]:
    """Return the channels between robots."""
    between = route("between_robots", namespace)
    links = tuple(link for builder in builders for link in builder.links(between))
    if links and has_copies:
        namespace.values.add_at_key(
            "DB108",
            ("robots", links[0].receiver, "hear"),
            "`hear` together with copies of a robot is not supported yet",
            "remove it",
        )
    return links


def _complete_reset(
    reset: Reset, namespace: Namespace, builders: Sequence[RobotBuilder], timestep: float
) -> Reset:
    """Return the reset with what is known once all values of the file have been read."""
    starts = joint_starts(namespace, {builder.robot.name: builder.poses for builder in builders})
    positions = replace(reset, joint_starts=starts).joint_positions

    def posed(places: tuple[Placement, ...]) -> tuple[Placement, ...]:
        return tuple(replace(place, joints=positions.get(place.body, {})) for place in places)

    return replace(
        reset,
        placements=posed(reset.placements),
        layouts=tuple(replace(layout, placements=posed(layout.placements)) for layout in reset.layouts),
        joint_starts=starts,
        settle=settling_time(namespace, timestep),
        variations=(*namespace.fields.variations, *namespace.fields.colors),
        groups=tuple(namespace.groups.values()),
    )


def _agent(
    namespace: Namespace,
    goals: Goals,
    limits: Truncation,
    timestep: float,
    action: tuple[ActionPart, ...],
    rewards: tuple[Expression, ...],
    robot_copies: RobotCopies | None,
) -> Agent:
    """Return the observation, action and reward of the agent, without its robots and the conditions on its
    action."""
    spec = namespace.scenario
    period = timestep * spec.agent.action_repeat
    observations = Observations(namespace)
    observation = observations.entries()
    agent = Agent(
        name=ONLY_AGENT,
        robots=(),
        action=action,
        observation=observation,
        critic=observations.of_critic(observation),
        reward=rewards,
        success=(*spec.termination.success, *(spec.truncation.success if spec.truncation else ())),
        goal=goals.goal(rewards),
        solved=solved(namespace, limits, period),
        frame_stack=spec.agent.frame_stack,
        copies=robot_copies,
        scripts=scripts(namespace, action),
        training=training(
            namespace,
            action,
            robot_copies,
            limits.max_episode_steps(period) if limits != Truncation() else None,
        ),
    )
    mirrored = symmetry(namespace, agent.with_critic)
    if agent.training is None or mirrored is None:
        return agent
    return replace(agent, training=replace(agent.training, symmetry=mirrored))


def _joined(findings: Findings) -> Findings:
    """Return the findings with each warning about a value that is in error anyway, or about its spelling, as
    a note of the error."""
    errors = findings.errors
    remaining: list[Finding] = []
    absorbed: dict[int, list[Finding]] = {}
    for finding in findings:
        error = (
            next((error for error in errors if _absorbs(error, finding)), None)
            if finding.severity == "warning"
            else None
        )
        (remaining if error is None else absorbed.setdefault(id(error), [])).append(finding)
    joined = Findings()
    for finding in remaining:
        warnings = absorbed.get(id(finding), [])
        fixes = [fix for warning in warnings if warning.code == "DB004" and (fix := number_fix(warning.span))]
        notes = (*finding.notes, *(warning.headline for warning in warnings))
        joined.append(
            replace(finding, notes=notes, fix=finding.fix or next(iter(fixes), None)) if warnings else finding
        )
    return joined


def _absorbs(error: Finding, warning: Finding) -> bool:
    """Return whether both have the same place. A warning about spelling also absorbs an error inside its
    place."""
    inner, outer = error.span, warning.span
    if inner.source.name != outer.source.name:
        return False
    # Warnings about how a value is spelled.
    within = warning.code in {"DB003", "DB004"} and outer.start <= inner.start and inner.end <= outer.end
    return within or (inner.start, inner.end) == (outer.start, outer.end)
