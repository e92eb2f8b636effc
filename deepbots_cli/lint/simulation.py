"""`lint --deep`: what is simulated, the process that simulates, and its report.

The scenario is simulated by `rollouts` in a process of its own, with limits on time and memory, so that a
scenario that hangs or crashes the engine ends that process and no other. The plan counts steps and follows
from the scenario alone: findings are the same on every machine. The process writes a line for each entry,
and the report is read from these lines.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, field, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

from pydantic import TypeAdapter

from deepbots_cli.compiler.inputs import Inputs
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.frames import rotate
from deepbots_cli.processes import Process, ending
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Motor, Robot, Sensor
from deepbots_cli.program.task import idle_action
from deepbots_cli.records import dataclass
from deepbots_cli.robots.kinematics import link_frames
from deepbots_cli.robots.model import RobotModel

End = Literal["success", "failure", "limit", "left"]
"""How an episode ended: by the task, by truncation, or left after enough steps."""
ARENA = "arena walls"
"""The name contains a blank, so no object can have it."""
TOPPLING_S = 2.0
"""s after a reset in which a robot that topples does so: a published arm, an xArm 6, has tilted by 40 deg
after 1 s."""
MAX_SINK = 0.001
"""m; engines let bodies sink in by less, and round what rays meet."""


class SimulationPosition(NamedTuple):
    """A policy (or `build`, `reset`), a seed, and the number of a step, from 1."""

    activity: str
    seed: int
    step: int


@dataclass(frozen=True)
class Halt:
    """The process ended early: a crash of the engine, a step without end, lack of memory, or the end of the
    whole time."""

    kind: Literal["crash", "hang", "memory", "slow", "killed"]
    description: str


@dataclass(frozen=True)
class Activity:
    """The process begins to build, to reset, or to run an episode of a policy, in a version of the scenario
    (`Program.versions`)."""

    name: str
    seed: int
    version: str = ""


@dataclass(frozen=True)
class FastestBody:
    """A body is much faster than all bodies before it in its episode; the speed is in m/s."""

    body: str
    speed: float


@dataclass(frozen=True)
class EarlyEnding:
    """An ending holds at the start of the episode with this seed."""

    name: str
    seed: int


@dataclass(frozen=True)
class Stop:
    """Something makes the rest of the plan impossible.

    Attributes:
        kind: `build` if the world cannot be built, `speed` if a body is implausibly fast, `lost` if its pose
        is
            not finite, `engine` if the engine raises an error, `value` if an expression has no value, `space`
            if an observation is outside of its space, and `shortened` if a search plays only the beginning of
            each episode.
        text: The message of the error.
        body: The body that is too fast or lost.
        joint: Its joint, if the joint is too fast.
        motion: The quantity that is too large, or `nan`.
        value: Its size, in m/s or rad/s.
        lines: The lines of generated code in which an expression had no value, the innermost first.
        terms: The terms of the reward that are not finite.
        numbers: The numbers of the observation that are outside of its space.
    """

    kind: Literal["build", "speed", "lost", "engine", "value", "space", "shortened"]
    text: str = ""
    body: str = ""
    joint: str | None = None
    motion: Literal["velocity", "spin", "joint", "nan"] | None = None
    value: float = 0.0
    lines: Sequence[str] = ()
    terms: Sequence[str] = ()
    numbers: Sequence[str] = ()


@dataclass(frozen=True)
class Fault:
    """An exception of deepbots ended the process."""

    description: str
    traceback: str


@dataclass(frozen=True)
class Done:
    """The process has done everything that it could."""


@dataclass(frozen=True)
class MeasuredOverlap:
    """Two bodies that penetrate each other right after a reset: names of body and link, depth in m."""

    one: tuple[str, str]
    other: tuple[str, str]
    depth: float
    seed: int


DriverKind = Literal["idle", "constant", "alternating", "random", "script", "detour", "interrupted"]
"""Who drives, the simplest first; a script is left for an action before its success (`detour`), or
`interrupted` there again and again."""


@dataclass(frozen=True)
class DrivenEpisode:
    """An episode of the search for exploits (`lint --exploits`).

    `driver` is what `--driver` takes, `number` that of the episode from seed 0. `terms` maps each term of the
    reward to its sums over the four quarters of the episode. `path` (m) is the way of the robot's base,
    `distance` (m) how far from its start it ends, and `turns` how often it has turned; `stopped` is the share
    of the steps in which all of its joints with limits are at a limit.
    """

    driver: str
    kind: DriverKind
    number: int
    steps: int
    total_return: float
    discounted_return: float
    end: End
    ended_by: str | None
    terms: Mapping[str, Sequence[float]]
    path: float = 0.0
    distance: float = 0.0
    turns: float = 0.0
    stopped: float = 0.0

    def sum_of(self, term: str) -> float:
        """Return the sum of a term over the episode."""
        return sum(self.terms[term])


@dataclass(frozen=True)
class UnreachedPose:
    """The first command of an episode to a `cartesian` actuator that the inverse kinematics does not reach.

    `unreached_commands` counts such commands. `distance` (m) and `angle` (rad) are the errors; `at_limit`
    maps joints that end at a limit to that limit (rad or m). With `turn` (rad) it is instead a first command
    that the arm reaches by turning its link in place; `start` (roll, pitch, yaw in rad) is the attitude of
    the link before.
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
    """The lowest point of any ray of a sensor within its range, m, and the top (m) and the name of the
    tallest solid body."""

    lowest: float
    top: float
    tallest: str


class Rolling(NamedTuple):
    """The motion of a robot since the start of an episode: the largest distance (m), change of heading (rad),
    and turn of a driven wheel (rad)."""

    distance: float
    turn: float
    wheel: float


class NumberStatistics(NamedTuple):
    """A number of the observation under one policy: its range, within -1 to 1, and the steps in which it was
    at either end."""

    low: float
    high: float
    at_low: int
    at_high: int


class TermStatistics(NamedTuple):
    """A term of the reward under one policy: its sum, the sum of its sizes, and its range."""

    total: float
    absolute_total: float
    low: float
    high: float


class PolicyStatistics(NamedTuple):
    """All episodes of one policy. `rows` is `steps` times the copies of a team."""

    steps: int
    episodes: int
    rows: int
    numbers: Sequence[NumberStatistics]
    terms: Sequence[TermStatistics]


@dataclass(frozen=True)
class Summary:
    """Measurements over all episodes of a completed plan.

    Attributes:
        measured: The statistics of each policy.
        constant_numbers: The places of the numbers of the observation that never changed; pictures after
            them.
        zero_terms: The places of the terms of the reward that were always 0.
        clearances: Robot, sensor, and how high its rays passed over all bodies, if they met nothing.
        depths: Robot, sensor, and how far below the ground (m) its rays began, if they met nothing.
        rolling: The motion of robots on driven wheels.
        tilts: How far (rad) robots with a free base tilt at least within `TOPPLING_S` of doing nothing.
    """

    measured: Mapping[str, PolicyStatistics] = field(default_factory=dict)
    constant_numbers: Sequence[int] = ()
    zero_terms: Sequence[int] = ()
    clearances: Sequence[tuple[str, str, Clearance]] = ()
    depths: Sequence[tuple[str, str, float]] = ()
    rolling: Mapping[str, Rolling] = field(default_factory=dict)
    tilts: Mapping[str, float] = field(default_factory=dict)


Entry: TypeAlias = (
    Activity
    | FastestBody
    | EarlyEnding
    | MeasuredOverlap
    | UnreachedPose
    | DrivenEpisode
    | Summary
    | Stop
    | Fault
    | Done
)
_KINDS: dict[str, Any] = {kind.__name__: kind for kind in get_args(Entry)}


def encode(entry: Entry) -> bytes:
    """Return the line of an entry, without its end."""
    return json.dumps([type(entry).__name__, asdict(entry)]).encode()


def decode(line: bytes) -> Entry | None:
    """Return the entry of a line; None if the line is cut off or is not an entry."""
    try:
        kind, fields = _adapter(tuple[str, dict[str, Any]]).validate_json(line)
        return _adapter(_KINDS[kind]).validate_python(fields) if kind in _KINDS else None
    except ValueError:
        return None


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


@dataclass
class SimulationReport:
    """The entries that the simulating process has written. Names in it are only looked up in the scenario.

    `where` is the present step, in this `version` of the scenario. `endings_at_reset` maps endings to the
    seeds with which they hold at the start. `done` is true if the process completed its plan or was stopped
    by a `stop`; otherwise `halt` or `fault` is the reason for its end.
    """

    where: SimulationPosition = SimulationPosition("build", 0, 0)
    version: str = ""
    fastest: FastestBody | None = None
    overlaps: list[MeasuredOverlap] = field(default_factory=list)
    endings_at_reset: dict[str, list[int]] = field(default_factory=dict)
    misses: list[UnreachedPose] = field(default_factory=list)
    driven: list[DrivenEpisode] = field(default_factory=list)
    summary: Summary = Summary()
    stop: Stop | None = None
    halt: Halt | None = None
    fault: Fault | None = None
    done: bool = False

    @property
    def ended_in(self) -> str:
        """The version in which the simulation ended early; empty for the scenario itself, and if none did."""
        return "" if self.stop is None and self.halt is None else self.version

    def of(self, version: str) -> SimulationReport:
        """Return the part about a version: the measurements concern the scenario itself, an early end the
        version in which it came."""
        if not self.ended_in:
            return self
        if version:
            return SimulationReport(self.where, self.version, self.fastest, stop=self.stop, halt=self.halt)
        return replace(self, stop=None, halt=None, done=False)

    def add(self, entry: Entry) -> None:
        """Add an entry of the process."""
        match entry:
            case Activity():
                self.where = SimulationPosition(entry.name, entry.seed, 0)
                self.version = entry.version
                self.fastest = None
            case FastestBody():
                self.fastest = entry
            case EarlyEnding():
                self.endings_at_reset.setdefault(entry.name, []).append(entry.seed)
            case MeasuredOverlap():
                self.overlaps.append(entry)
            case UnreachedPose():
                self.misses.append(entry)
            case DrivenEpisode():
                self.driven.append(entry)
            case Summary():
                self.summary = entry
            case Stop():
                self.stop = entry
            case Fault():
                self.fault = entry
            case Done():
                self.done = True


# What is simulated

HOLD_STEPS = 8
"""Steps for which a random action is held. Actions that are new in every step cancel each other, and move
little."""
RANDOM = "random actions"
HELD_RANDOM = f"random actions held for {HOLD_STEPS} steps each"
IDLE = "doing nothing"

_RESETS = 24
"""Resets with different seeds: an overlap in one of eight starts is found with a probability of 96 %."""
_RANDOM_EPISODES = 24
"""Episodes of random actions."""
_RANDOM_STEPS = 250
"""The steps of each of them."""
_ENOUGH_STEPS = 1500
"""The steps of all of them after which no further one begins."""
_OTHER_EPISODES = 2
"""Episodes without action, and of each script."""
_OTHER_STEPS = 500
"""The steps of each of them."""
_VARIANT_STEPS = 100
"""Steps of an episode in a case or a stage."""
_MAX_WORK = 200_000.0
"""The work of a plan, as in `work_per_step`. The plans of the shipped scenarios take 21 000 to 189 000."""
_MAX_VARIANT_WORK = _MAX_WORK / 20
"""The work of an episode in a case or a stage."""
_MAX_SETTLING_STEPS = 50_000
"""Physics steps in which the world settles, over all resets."""
_PIXELS_PER_PHYSICS_STEP = 250.0
"""Pixels of a camera that count as one physics step of a robot."""
_MIN_STEPS = 10
"""Steps of an episode at least, however much work a step takes."""
_MAX_AXIS_RISE = 0.3
"""The largest z component of the unit vector of a wheel's axis."""


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
    """Resets with the seeds from 0 on, then the episodes; those with random actions until they have
    `min_random_steps` steps together."""

    resets: int
    rollouts: tuple[Rollout, ...]
    min_random_steps: int


def simulation_plan(program: Program) -> Plan:
    """The plan for the scenario itself."""
    last = program.truncation.max_episode_steps(program.period)
    random_rollouts = [
        Rollout(HELD_RANDOM if seed % 2 else RANDOM, seed, min(last, _RANDOM_STEPS))
        for seed in range(_RANDOM_EPISODES)
    ]
    other_rollouts = [
        Rollout(by, seed, min(last, _OTHER_STEPS), script)
        for by, script in _others(program)
        for seed in range(_OTHER_EPISODES)
    ]
    share = min(
        1.0,
        _MAX_WORK
        / (work_per_step(program) * (_ENOUGH_STEPS + sum(rollout.steps for rollout in other_rollouts))),
    )
    rollouts = tuple(
        Rollout(rollout.policy, rollout.seed, max(_MIN_STEPS, int(rollout.steps * share)), rollout.script)
        for rollout in (*random_rollouts, *other_rollouts)
    )
    settling = program.reset.settle / program.world.timestep * program.world.substeps
    resets = max(2, min(_RESETS, int(_MAX_SETTLING_STEPS / max(settling, 1.0))))
    return Plan(resets, rollouts, max(_MIN_STEPS, int(_ENOUGH_STEPS * share)))


def variant_plan(program: Program) -> tuple[Rollout, ...]:
    """The episodes in a case or a stage, where something has been constant so far."""
    steps = max(_MIN_STEPS, min(_VARIANT_STEPS, int(_MAX_VARIANT_WORK / work_per_step(program))))
    return (
        Rollout(HELD_RANDOM, 1, steps),
        *(Rollout(by, 0, steps, script) for by, script in _others(program) if script),
    )


def _others(program: Program) -> Iterator[tuple[str, str | None]]:
    if idle_action(program.agent.action) is not None:
        yield IDLE, None
    for script in program.agent.scripts:
        yield f"the script `{script.name}`", script.name


def work_per_step(program: Program) -> float:
    """The cost of a step of the agent, in physics steps of one robot (about 15 us): ten of them are
    overhead."""
    copies = program.agent.copies.count if program.agent.copies else 1
    pixels = sum(entry.shape[0] * entry.shape[1] for entry in program.agent.images)
    return (
        len(program.robots) * (program.world.substeps * program.action_repeat + 10)
        + pixels / _PIXELS_PER_PHYSICS_STEP
    ) * copies


def casts_rays(sensor: Sensor) -> bool:
    return sensor.beams is not None and sensor.beams.reach > 0.0


def driven_wheels(robot: Robot, model: RobotModel) -> tuple[str, ...]:
    """The continuous joints on level axes that have a velocity or torque motor, if there are two or more.

    A robot with motors of another kind, or with rotors, has none: it moves by other means.
    """
    motors = [command.actuator for command in robot.commands]
    if not all(isinstance(motor, Motor) and motor.kind != "position_motor" for motor in motors):
        return ()
    driven = dict.fromkeys(joint for motor in motors if isinstance(motor, Motor) for joint in motor.joints)
    where = link_frames(model)
    joints = [joint for joint in map(model.joint, driven) if joint.type == "continuous"]
    wheels = tuple(
        joint.name for joint in joints if abs(rotate(where[joint.child][1], joint.axis)[2]) < _MAX_AXIS_RISE
    )
    return wheels if len(wheels) > 1 else ()


# The process

OUT_OF_MEMORY = 77
"""The exit code of a process that asked for more memory than it may have."""
_REQUIRED = ("gymnasium", "msgspec", "numpy")


class Limits(NamedTuple):
    """Limits of the process.

    Ordinary scenarios take 1 to 8 s of CPU time; reaching `cpu` or `wall` is not a finding. A single step,
    reset or construction of the world that takes longer than `step_seconds` is taken for an endless loop. A
    world of 500 bodies takes 0.6 GB of address space, most of it for libraries.
    """

    cpu: int = 120
    """s of CPU time in all."""
    step_seconds: float = 30.0
    """s of CPU time for a step."""
    memory: int = 4096
    """MiB of address space."""
    wall: float = 900.0
    """s by the clock in all, on a machine that may be busy."""


EXPLOIT_LIMITS = Limits(cpu=60)
"""The limits of a search for exploits, which plans about 20 s of work."""


def require_simulator(option: str = "lint --deep") -> None:
    """Check for the simulator without importing it; `option` needs it.

    Raises:
        MissingExtraError: A package that simulating needs is not installed.
    """
    if any(find_spec(name) is None for name in _REQUIRED) or not any(
        kind.is_installed for kind in ENGINES.built_in.values()
    ):
        raise MissingExtraError("sim", option)


def measure(
    inputs: Inputs, limits: Limits, *, permissions: Permissions = Permissions(), search: bool = False
) -> SimulationReport:
    """Simulate a scenario in a process of its own, which compiles it from copies of its files.

    With `search`, search for exploits of the reward instead of carrying out the plan of `lint --deep`.

    Raises:
        UsageError: The copies cannot be written.
        RuntimeError: The process failed by a fault of deepbots, and DEEPBOTS_DEBUG is 1; holds its traceback.
    """
    import tempfile  # 5 ms of CPU, which static linting does not need

    lines: list[bytes] = []
    codes: SimpleQueue[int] = SimpleQueue()
    with tempfile.TemporaryDirectory(prefix="deepbots-") as folder:
        inputs.write(Path(folder))
        process = Process(
            "deepbots_cli.lint.simulation_process",
            *map(str, limits),
            hear=lines.append,
            on_end=codes.put,
            # The limit of memory also counts the address space that each thread reserves for its stack.
            environment=dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
            quiet=True,
        )
        try:
            request = {"folder": folder, "allow_code": permissions.code, "search": search}
            process.send(json.dumps(request).encode() + b"\n")
            code = codes.get(timeout=limits.wall)
            is_late = False
        except Empty:
            process.end()
            code = codes.get()  # the lines that were written before the end are read, too
            is_late = True
        finally:
            process.end()  # also after Ctrl-C
    report = _read(b"".join(lines).splitlines(keepends=True))  # a long line comes in parts
    if not report.done and report.halt is None:
        report.halt = Halt("slow", f"{limits.wall:g} s") if is_late else _halt(code, limits)
    return report


def _read(lines: Iterable[bytes]) -> SimulationReport:
    """Read the lines of entries, and `~17` before step 17; a last line that is cut off is ignored."""
    report = SimulationReport()
    for line in lines:
        if line.startswith(b"~") and line[1:].strip().isdigit():
            report.where = report.where._replace(step=int(line[1:]))
            continue
        entry = decode(line)
        if isinstance(entry, Fault) and os.environ.get("DEEPBOTS_DEBUG") == "1":
            raise RuntimeError(f"the simulation failed by a fault of deepbots\n{entry.traceback}")
        if entry is not None:
            report.add(entry)
    return report


def _halt(code: int, limits: Limits) -> Halt:
    """Return the reason why the process ended early."""
    name = ending(code)
    # `lint.simulation_process` sets the timer of SIGPROF, and the limit of CPU time, which sends SIGXCPU.
    if name == "SIGPROF":
        return Halt("hang", f"{limits.step_seconds:g} s of CPU time")
    if name == "SIGXCPU":
        return Halt("slow", f"{limits.cpu} s of CPU time")
    if code == OUT_OF_MEMORY:
        return Halt("memory", f"{limits.memory} MiB")
    return Halt("crash" if name in {"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGABRT"} else "killed", name)
