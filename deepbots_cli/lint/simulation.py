"""`lint --deep`: what is simulated, the process that simulates, and its report, from which rules make findings.

The scenario is simulated by `rollouts` in a process of its own, with limits on time and memory, so that a scenario that hangs or
crashes the engine ends that process and no other. The plan counts steps and follows from the scenario alone: findings are the same on
every machine.
"""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, NamedTuple

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.compiler.inputs import Inputs
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.diagnostics import Span
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.expressions.scalar import Name, walk
from deepbots_cli.lint.analysis import RuleContext
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Sensor
from deepbots_cli.program.task import Choices, Observation
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import ARENA_WALLS, GROUND

# What is simulated

HOLD_STEPS = 8
"""Steps for which a random action is held. Actions that are new in every step cancel each other, and move little."""
RANDOM, HELD_RANDOM, IDLE = "random actions", f"random actions that each last {HOLD_STEPS} steps", "doing nothing"

_RESETS = 24
_RANDOM_EPISODES, _RANDOM_STEPS, _ENOUGH_STEPS = 24, 250, 1500
_OTHER_EPISODES, _OTHER_STEPS = 2, 500
_VARIANT_STEPS = 100
_MAX_WORK = 200_000.0
_MAX_SETTLING = 50_000
_PIXELS = 250.0
_MIN_STEPS = 10


@dataclass(frozen=True)
class Rollout:
    """An episode: its policy, its seed, and the step after which it is left.

    `policy` is `RANDOM`, `HELD_RANDOM`, `IDLE`, or the words for a script.
    """

    policy: str
    seed: int
    steps: int
    script: str | None = None


@dataclass(frozen=True)
class Plan:
    """Resets with the seeds from 0 on, then the episodes; those with random actions until they have `min_random_steps` steps together."""

    resets: int
    rollouts: tuple[Rollout, ...]
    min_random_steps: int


def simulation_plan(program: Program) -> Plan:
    """The plan for the scenario itself."""
    last = program.truncation.max_episode_steps(program.period)
    drawn = [Rollout(HELD_RANDOM if seed % 2 else RANDOM, seed, min(last, _RANDOM_STEPS)) for seed in range(_RANDOM_EPISODES)]
    others = [Rollout(by, seed, min(last, _OTHER_STEPS), script) for by, script in _others(program) for seed in range(_OTHER_EPISODES)]
    share = min(1.0, _MAX_WORK / (_work(program) * (_ENOUGH_STEPS + sum(rollout.steps for rollout in others))))
    rollouts = tuple(Rollout(each.policy, each.seed, max(_MIN_STEPS, int(each.steps * share)), each.script) for each in (*drawn, *others))
    settling = program.reset.settle / program.world.timestep * program.world.substeps
    resets = max(2, min(_RESETS, int(_MAX_SETTLING / max(settling, 1.0))))
    return Plan(resets, rollouts, max(_MIN_STEPS, int(_ENOUGH_STEPS * share)))


def variant_plan(program: Program) -> tuple[Rollout, ...]:
    """The episodes in a case or a stage, where something has been constant so far."""
    steps = max(_MIN_STEPS, min(_VARIANT_STEPS, int(_MAX_WORK / 20 / _work(program))))
    return (Rollout(HELD_RANDOM, 1, steps), *(Rollout(by, 0, steps, script) for by, script in _others(program) if script))


def _others(program: Program) -> Iterator[tuple[str, str | None]]:
    if idle_action(program) is not None:
        yield IDLE, None
    for script in program.policy.scripts:
        yield f"the script `{script.name}`", script.name


def _work(program: Program) -> float:
    """The cost of a step of the agent, in physics steps of one robot (about 15 us): ten of them are overhead."""
    copies = program.policy.copies.count if program.policy.copies else 1
    pixels = sum(entry.shape[0] * entry.shape[1] for entry in program.policy.images)
    return (len(program.robots) * (program.world.substeps * program.action_repeat + 10) + pixels / _PIXELS) * copies


def idle_action(program: Program) -> tuple[tuple[int, ...], tuple[float, ...]] | None:
    """The action that does nothing: the number of an option for each choice, and a value from -1 to 1 for each component of a range.

    It is the option of zeros, and the value of a range that is nearest to 0. None where a choice has no option of zeros.
    """
    choices: list[int] = []
    values: list[float] = []
    for part in program.policy.action:
        if isinstance(part, Choices):
            still = next((number for number, option in enumerate(part.options) if not any(option.values)), None)
            if still is None:
                return None
            choices.append(still)
        else:
            wanted = min(max(0.0, part.low), part.high)
            values += [2.0 * (wanted - part.low) / (part.high - part.low) - 1.0] * max(1, len(part.components))
    return tuple(choices), tuple(values)


# The report

End = Literal["success", "failure", "limit", "left"]
"""How an episode ended: by the task, by truncation, or left after enough steps."""
ARENA = "arena walls"
"""Holds a blank, which no name of an object does."""
MAX_SINK = 0.001
"""m; engines let bodies sink in by less, and round what rays meet."""


class SimulationPosition(NamedTuple):
    """A policy (or `build`, `reset`), a seed, and the number of a step, from 1."""

    activity: str
    seed: int
    step: int


@dataclass(frozen=True)
class Halt:
    """The process ended early: a crash of the engine, a step without end, lack of memory, or the end of the whole time."""

    kind: Literal["crash", "hang", "memory", "slow", "killed"]
    description: str


@dataclass(frozen=True)
class Overlap:
    """Two bodies that penetrate each other right after a reset: names of body and link, depth in m."""

    one: tuple[str, str]
    other: tuple[str, str]
    depth: float
    seed: int


@dataclass(frozen=True)
class Episode:
    """One episode; `discounted_return` is the discounted return."""

    policy: str
    seed: int
    steps: int
    discounted_return: float
    end: End


@dataclass(frozen=True)
class UnreachedPose:
    """The first command of an episode to a `cartesian` actuator that the inverse kinematics does not reach.

    `unreached_commands` counts such commands. `distance` (m) and `angle` (rad) are the errors; `at_limit` maps
    joints that end at a limit to that limit (rad or m). With `turn` (rad) it is instead a first command that the arm reaches by turning
    its link in place; `start` (roll, pitch, yaw in rad) is the attitude of the link before.
    """

    robot: str
    actuator: str
    distance: float
    angle: float
    at_limit: Mapping[str, float]
    turn: float = 0.0
    start: Sequence[float] = ()
    policy: str = ""
    seed: int = 0
    step: int = 0
    unreached_commands: int = 0
    commands: int = 0


class Clearance(NamedTuple):
    """The lowest point of any ray of a sensor within its range, m, and the top (m) and the name of the tallest solid body."""

    lowest: float
    top: float
    tallest: str


def casts_rays(sensor: Sensor) -> bool:
    return sensor.beams is not None and sensor.beams.reach > 0.0


class NumberStatistics(NamedTuple):
    """A number of the observation under one policy: its range, within -1 to 1, and the steps in which it was at either end."""

    low: float
    high: float
    at_low: int
    at_high: int


class TermStatistics(NamedTuple):
    """A term of the reward under one policy: its sum, the sum of its sizes, the steps in which it was not 0, and its range."""

    total: float
    absolute_total: float
    nonzero_steps: int
    low: float
    high: float


class Statistics(NamedTuple):
    """All episodes of one policy. `rows` is `steps` times the copies of a team."""

    steps: int
    rows: int
    numbers: Sequence[NumberStatistics]
    terms: Sequence[TermStatistics]


@dataclass
class SimulationReport:
    """The lines that the simulating process has written. Names in it are only ever looked up in the scenario.

    `endings_at_reset` maps endings to the seeds with which they hold at the start; `constant_numbers` and `zero_terms` are the places
    of the numbers that never changed and of the terms that were always 0. `clearances` and `depths` are about sensors whose rays met
    nothing: how high they passed over all bodies, and how far below the ground (m) they began. `done` says whether the plan was completed,
    `fault` which exception of deepbots ended it.
    """

    where: SimulationPosition = SimulationPosition("build", 0, 0)
    fastest: tuple[str, float] | None = None
    overlaps: list[Overlap] = field(default_factory=list)
    endings_at_reset: dict[str, list[int]] = field(default_factory=dict)
    misses: list[UnreachedPose] = field(default_factory=list)
    episodes: list[Episode] = field(default_factory=list)
    measured: dict[str, Statistics] = field(default_factory=dict)
    constant_numbers: Sequence[int] = ()
    zero_terms: Sequence[int] = ()
    clearances: dict[tuple[str, str], Clearance] = field(default_factory=dict)
    depths: dict[tuple[str, str], float] = field(default_factory=dict)
    stop: Mapping[str, Any] | None = None
    halt: Halt | None = None
    fault: str | None = None
    done: bool = False

    def add_line(self, line: Mapping[str, Any]) -> None:  # one case per kind of line  # noqa: C901
        """Add one line of the process."""
        match line:
            case {"at": [str(doing), int(seed)]}:
                self.where, self.fastest = SimulationPosition(doing, seed, 0), None
            case {"fast": [str(body), int() | float() as speed]}:
                self.fastest = (body, speed)
            case {"overlap": {"one": [str(a), str(b)], "other": [str(c), str(d)], "depth": float(depth), "seed": int(seed)}}:
                self.overlaps.append(Overlap((a, b), (c, d), depth, seed))
            case {"early": [str(ending), int(seed)]}:
                self.endings_at_reset.setdefault(ending, []).append(seed)
            case {"miss": Mapping() as row}:
                self.misses.append(UnreachedPose(**row))
            case {"episode": Mapping() as row}:
                self.episodes.append(Episode(**row))
            case {"measured": Mapping() as policies}:
                for by, (steps, rows, numbers, terms) in policies.items():
                    numbers, terms = [NumberStatistics(*row) for row in numbers], [TermStatistics(*row) for row in terms]
                    self.measured[by] = Statistics(steps, rows, numbers, terms)
            case {"still": still, "silent": silent}:
                self.constant_numbers, self.zero_terms = still, silent
            case {"clearances": rows, "depths": depths}:
                self.clearances = {(robot, sensor): Clearance(*clearance) for robot, sensor, *clearance in rows}
                self.depths = {(robot, sensor): depth for robot, sensor, depth in depths}
            case {"stop": Mapping() as stop}:
                self.stop = stop
            case {"fault": str(fault)}:
                self.fault = fault
            case {"done": True}:
                self.done = True


# The process

OUT_OF_MEMORY = 77
"""The exit code of a process that asked for more memory than it may have."""
_REQUIRED = ("gymnasium", "msgspec", "numpy")
_CRASHES = {"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGABRT"}


class Limits(NamedTuple):
    """Limits of the process.

    Ordinary scenarios take 1 to 8 s of CPU time; reaching `cpu` or `wall` is no finding. A single step, reset or construction of the
    world that takes longer than `step_seconds` is taken for an endless loop. A world of 500 bodies takes 0.6 GB of address space, most
    of it for libraries.
    """

    cpu: int = 120
    """s of CPU time in all."""
    step_seconds: float = 30.0
    """s of CPU time for a step."""
    memory: int = 4096
    """MiB of address space."""
    wall: float = 900.0
    """s by the clock in all, on a machine that may be busy."""


def require_simulator() -> None:
    """Check for the simulator without importing it.

    Raises:
        MissingExtraError: A package that simulating needs is not installed.
    """
    if any(find_spec(name) is None for name in _REQUIRED) or not any(kind.is_installed for kind in ENGINES.own.values()):
        raise MissingExtraError("sim", "lint --deep")


def measure(inputs: Inputs, limits: Limits, *, allow_code: bool = False) -> SimulationReport:
    """Simulate a scenario in a process of its own, which compiles it from copies of its files.

    Raises:
        UsageError: The copies cannot be written.
        RuntimeError: The process failed by a fault of deepbots, and DEEPBOTS_DEBUG is 1; holds its traceback.
    """
    import subprocess  # with tempfile 10 ms of CPU, which static linting does not need
    import tempfile

    command = python_command("deepbots_cli.lint.simulation_process", *map(str, limits))
    environment = python_environment({"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"})
    with tempfile.TemporaryDirectory(prefix="deepbots-") as folder:
        inputs.write(Path(folder))
        request = json.dumps({"folder": folder, "allow_code": allow_code}).encode()
        pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=nowhere, env=environment) as process:
            try:
                out, _ = process.communicate(request, limits.wall)
                is_late = False
            except subprocess.TimeoutExpired:
                process.kill()
                out, _ = process.communicate()
                is_late = True
            except BaseException:
                process.kill()
                raise
    report = _read(out)
    if not report.done and report.halt is None:
        report.halt = Halt("slow", f"{limits.wall:g} s") if is_late else _halt(process.returncode, limits)
    return report


def _read(out: bytes) -> SimulationReport:
    """Read lines of JSON, and `~17` before step 17; a last line that is cut off is ignored."""
    report = SimulationReport()
    for line in out.split(b"\n"):
        if line.startswith(b"~") and line[1:].isdigit():
            report.where = report.where._replace(step=int(line[1:]))
            continue
        try:
            entry: Any = json.loads(line)
        except ValueError:
            continue
        if isinstance(entry, dict):
            if "fault" in entry and os.environ.get("DEEPBOTS_DEBUG") == "1":
                raise RuntimeError(f"the simulation failed by a fault of deepbots\n{entry.get('traceback')}")
            report.add_line(entry)
    return report


def _halt(code: int, limits: Limits) -> Halt:
    """Why the process ended before it was done."""
    name = signal.Signals(-code).name if -code in signal.valid_signals() else ""
    if name == "SIGPROF":
        return Halt("hang", f"{limits.step_seconds:g} s of CPU time")
    if name == "SIGXCPU":
        return Halt("slow", f"{limits.cpu} s of CPU time")
    if code == OUT_OF_MEMORY:
        return Halt("memory", f"{limits.memory} MiB")
    return Halt("crash" if name in _CRASHES else "killed", name or f"exit code {code}")


# For the rules


@dataclass(frozen=True, eq=False)
class MeasuredNumber:
    """One number of the observation: its entry, its component, and its place among all numbers."""

    entry: Observation
    component: int
    place: int

    @property
    def name(self) -> str:
        """`pole.x`."""
        parts = self.entry.value.components
        return f"{self.entry.value.name}.{parts[self.component]}" if parts else self.entry.value.name

    @property
    def low(self) -> float:
        return self.entry.low[self.component]

    @property
    def high(self) -> float:
        return self.entry.high[self.component]


Section = Literal["observation", "reward", "other"]


class FailedExpression(NamedTuple):
    """The definition that had no value when an episode stopped, and the section that needs it."""

    name: str
    span: Span
    section: Section
    notes: tuple[str, ...]


class Simulation(RuleContext):
    """A scenario and the report of its simulation."""

    def __init__(self, checked: CheckedScenario, program: Program, namespace: Namespace, report: SimulationReport) -> None:
        super().__init__(checked, program, namespace)
        self.plan = simulation_plan(program)
        self.report = report
        self.measured = {by: found for by, found in report.measured.items() if found.steps}
        """By policy; only policies that made a step."""
        self.steps = sum(found.steps for found in self.measured.values())
        self.is_complete = report.done and report.stop is None
        """Whether nothing stopped the simulation, so that absence of an event means something."""
        self.robot_names = tuple(robot.name for robot in program.robots)
        self.walls = {piece: name for name, pieces in namespace.walls.items() if pieces != ARENA_WALLS for piece in pieces}
        """The name of the wall that each piece, such as `bay 1`, belongs to."""

    @cached_property
    def numbers(self) -> tuple[MeasuredNumber, ...]:
        """In the order of the report."""
        entries = [entry for entry in self.program.policy.observation if not entry.value.typed.type.picture]
        parts = [(entry, part) for entry in entries for part in range(len(entry.value.components) or 1)]
        return tuple(MeasuredNumber(entry, part, place) for place, (entry, part) in enumerate(parts))

    def terms(self) -> Iterator[tuple[Expression, dict[str, TermStatistics]]]:
        """Every term of the reward, with its statistics by policy."""
        for place, term in enumerate(self.program.policy.reward):
            yield term, {by: found.terms[place] for by, found in self.measured.items()}

    # Places in the scenario

    def body_span(self, name: str | None) -> Span:
        """The definition of a body; the whole world for an unknown one."""
        base = (name or "").partition("#")[0]
        spec = self.checked.spec
        if base in self.robot_names:
            path: tuple[str, ...] = ("robots", base)
        elif spec is not None and base in spec.objects:
            path = ("objects", base)
        elif base in ARENA_WALLS:
            path = ("world", "arena")
        elif base == GROUND:
            path = ("world", "terrain" if self.program.world.terrain else "ground")
        elif wall := self.walls.get(base):
            path = ("world", "walls", wall)
        else:
            path = ("world",) if name else ("robots", next(iter(self.robot_names), ""))
        return self.values.key_span(path)

    def placement(self, name: str) -> Span | None:
        """The span at which the scenario places a body; None if it does not."""
        base = name.partition("#")[0]
        place = next((place for place in self.analysis.placements if place.body == base), None)
        if place is None:
            return None
        return self.values.key_span(tuple((place.owner or f"reset.place.{place.body}").split(".")))

    # Words

    def called(self, body: str) -> str:
        """The name of a body in a sentence; a wall of one piece has the name that the scenario gives it."""
        wall = self.walls.get(body, body)
        return wall if list(self.walls.values()).count(wall) == 1 else body

    def when(self, where: SimulationPosition | None = None) -> str:
        """The progress of the simulation, for a note."""
        doing, seed, step = where or self.report.where
        if doing == "build":
            return "while the world was built"
        if doing == "reset":
            return f"in the reset with seed {seed}"
        time = f" ({step * self.program.period:.4g} s)" if step else ""
        return f"in step {step}{time} of the episode with seed {seed}, {doing}"

    @property
    def summary(self) -> str:
        """How much was simulated, for a note."""
        parts = [f"{found.steps} steps of {by}" for by, found in self.measured.items()]
        return f"simulated: {' and '.join(filter(None, (', '.join(parts[:-1]), parts[-1])))}" if parts else "nothing was simulated"

    # Expressions without a value

    @cached_property
    def failed(self) -> FailedExpression | None:
        """The expression that stopped an episode; None where none did, or where it is unknown."""
        stop = self.report.stop or {}
        if stop.get("kind") != "value":
            return None
        text = str(stop.get("text", ""))
        notes = (self.when(), text) if text else (self.when(),)
        terms = {term.name: term for term in self.program.policy.reward}
        for name in map(str, stop.get("terms", ())):
            if name in terms:
                return FailedExpression(name, terms[name].span, "reward", notes)
        known = dict(self._identifiers())
        for line in map(str, stop.get("lines", ())):  # an assignment names its target first, then what it reads
            for word in re.findall(r"(?:self\.)?([A-Za-z_]\w*)", line):
                if word in known:
                    value, section = known[word]
                    return FailedExpression(value.name, value.span, section, notes)
        return None

    def _identifiers(self) -> Iterator[tuple[str, tuple[Expression, Section]]]:
        """The identifiers of values in generated code, in the order of `codegen.text`, which appends a number to a taken one."""
        program = self.program
        for entry in program.policy.observation:
            for name in (_identifier("seen", entry.value.name), _identifier(entry.value.name)):
                yield name, (entry.value, "observation")
        for term in program.policy.reward:
            yield _identifier("term", term.name), (term, "reward")
            yield _identifier(term.name, "term"), (term, "reward")
        seen, paid = (
            _signals_in(program, (entry.value for entry in program.policy.observation)),
            _signals_in(program, program.policy.reward),
        )
        for value in program.signals:
            section: Section = "observation" if value.name in seen else "reward" if value.name in paid else "other"
            yield _identifier(value.name), (value, section)
        for ending in program.endings:
            yield _identifier(ending.value.name), (ending.value, "other")


def _identifier(*parts: str) -> str:
    return re.sub(r"\W", "_", "_".join(part for part in parts if part))


def _signals_in(program: Program, values: Iterable[Expression]) -> set[str]:
    """The signals that values depend on."""
    signals = {signal.name: signal.scalars for signal in program.signals}
    found: set[str] = set()
    waiting = [scalar for value in values for scalar in value.scalars]
    while waiting:
        for node in walk(waiting.pop()):
            if isinstance(node, Name) and node.name in signals and node.name not in found:
                found.add(node.name)
                waiting += signals[node.name]
    return found
