"""`lint --deep`: the plan of a simulation, the process that simulates, and its report, from which rules make
findings.

The scenario is simulated by `rollouts` in a process of its own, with limits on time and memory, so that a
scenario that hangs or crashes the engine ends that process and no other. The plan counts steps and follows
from the scenario alone: findings are the same on every machine.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, NamedTuple

from deepbots_cli.compiler.inputs import Inputs
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.footprint import link_frames
from deepbots_cli.frames import rotate
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Motor, Robot, Sensor
from deepbots_cli.program.task import idle_action
from deepbots_cli.robots.model import RobotModel

# The plan

HOLD_STEPS = 8
"""The number of steps for which a random action is held. Actions that are new in every step cancel each
other, and move little."""
RANDOM = "random actions"
HELD_RANDOM = f"random actions held for {HOLD_STEPS} steps each"
IDLE = "doing nothing"

_RESETS = 24
"""The maximum number of resets; a fault of one start in eight is found with 96 %."""
_RANDOM_EPISODES, _RANDOM_STEPS, _ENOUGH_STEPS = 24, 250, 1500
"""The maximum number of random episodes, the steps of each, and the steps of all after which no other begins."""
_OTHER_EPISODES, _OTHER_STEPS = 2, 500
"""The number of episodes of doing nothing and of each script, and the steps of each."""
_VARIANT_STEPS = 100
"""The steps of an episode in a case or a stage."""
_MAX_WORK = 200_000.0
"""The physics steps of one robot in all episodes, in the unit of `work_per_step`: about 3 s at 15 us each."""
_MAX_SETTLING = 50_000
"""The physics steps in which the world settles, in all resets."""
_PIXELS = 250.0
"""The number of pixels that cost as much as a physics step."""
_MIN_STEPS = 10
"""The least number of steps of an episode, whatever they cost."""
_MAX_AXIS_RISE = 0.3
"""The largest rise of an axis of a wheel, per length."""


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
    """The plan of a simulation: resets with the seeds from 0 on, then the episodes; those with random actions
    until they have `min_random_steps` steps together."""

    resets: int
    rollouts: tuple[Rollout, ...]
    min_random_steps: int


def simulation_plan(program: Program) -> Plan:
    """Return the plan for the scenario itself."""
    last = program.truncation.max_episode_steps(program.period)
    drawn = [
        Rollout(HELD_RANDOM if seed % 2 else RANDOM, seed, min(last, _RANDOM_STEPS))
        for seed in range(_RANDOM_EPISODES)
    ]
    others = [
        Rollout(by, seed, min(last, _OTHER_STEPS), script)
        for by, script in _others(program)
        for seed in range(_OTHER_EPISODES)
    ]
    share = min(
        1.0, _MAX_WORK / (work_per_step(program) * (_ENOUGH_STEPS + sum(rollout.steps for rollout in others)))
    )
    rollouts = tuple(
        Rollout(each.policy, each.seed, max(_MIN_STEPS, int(each.steps * share)), each.script)
        for each in (*drawn, *others)
    )
    settling = program.reset.settle / program.world.timestep * program.world.substeps
    resets = max(2, min(_RESETS, int(_MAX_SETTLING / max(settling, 1.0))))
    return Plan(resets, rollouts, max(_MIN_STEPS, int(_ENOUGH_STEPS * share)))


def variant_plan(program: Program) -> tuple[Rollout, ...]:
    """Return the episodes in a case or a stage, where something has been constant so far."""
    steps = max(_MIN_STEPS, min(_VARIANT_STEPS, int(_MAX_WORK / 20 / work_per_step(program))))
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
    """Return the cost of a step of the agent, in physics steps of one robot (about 15 us): ten of them are
    overhead."""
    copies = program.agent.copies.count if program.agent.copies else 1
    pixels = sum(entry.shape[0] * entry.shape[1] for entry in program.agent.images)
    return (
        len(program.robots) * (program.world.substeps * program.action_repeat + 10) + pixels / _PIXELS
    ) * copies


# The report

End = Literal["success", "failure", "limit", "left"]
"""The end of an episode: by the task, by truncation, or left after enough steps."""
ARENA = "arena walls"
"""The name of the walls of the arena, with a blank, which no name of an object has."""
TOPPLING_S = 2.0
"""The time (s) after a reset within which a robot that topples does so: a published arm, an xArm 6, has
tilted by 40 deg after 1 s."""
MAX_SINK = 0.001
"""The depth (m) above which bodies have sunk in; engines let bodies sink in by less, and round the hits of
rays."""


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
class MeasuredOverlap:
    """Two bodies that penetrate each other right after a reset: names of body and link, depth in m."""

    one: tuple[str, str]
    other: tuple[str, str]
    depth: float
    seed: int


@dataclass(frozen=True)
class SimulatedEpisode:
    """A simulated episode."""

    policy: str
    seed: int
    steps: int
    discounted_return: float
    end: End


DriverKind = Literal[
    "idle", "constant", "alternating", "random", "script", "interrupted", "detour", "sequence"
]
"""The kinds of drivers, the simplest first; a script is `interrupted` before its success; the search finds
detours and sequences of actions."""


@dataclass(frozen=True)
class DrivenEpisode:
    """An episode of the search for exploits (`lint --exploits`).

    `driver` is the text for `--driver`, `number` is that of the episode from seed 0. `terms` maps each term
    of the reward to its sums over the four quarters of the episode. `path` (m) is the length of the way of
    the robot's base, `distance` (m) that from its start to its end, and `turns` the number of turns;
    `stopped` is the share of the steps in which all of its joints with limits are at a limit.
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
        """Return the sum of a term in the whole episode."""
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


def casts_rays(sensor: Sensor) -> bool:
    return sensor.beams is not None and sensor.beams.reach > 0.0


def driven_wheels(robot: Robot, model: RobotModel) -> tuple[str, ...]:
    """Return the continuous joints on level axes that have a velocity or torque motor, if there are two or
    more.

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
    rows: int
    numbers: Sequence[NumberStatistics]
    terms: Sequence[TermStatistics]


@dataclass
class SimulationReport:
    """The lines that the simulating process has written. Names in it are only looked up in the scenario.

    `endings_at_reset` maps endings to the seeds with which they hold at the start; `constant_numbers` and
    `zero_terms` are the places of the numbers that never changed and of the terms that were always 0.
    `clearances` and `depths` have for sensors whose rays met nothing the height (m) above all bodies, and the
    depth (m) of their beginning below the ground. `rolling` has the motion of robots on driven wheels, and
    `tilts` (rad) the least tilt of robots with a free base within `TOPPLING_S` of doing nothing. `done` is
    true if the plan was completed, `fault` is the exception of deepbots that ended it.
    """

    where: SimulationPosition = SimulationPosition("build", 0, 0)
    fastest: tuple[str, float] | None = None
    overlaps: list[MeasuredOverlap] = field(default_factory=list)
    endings_at_reset: dict[str, list[int]] = field(default_factory=dict)
    misses: list[UnreachedPose] = field(default_factory=list)
    episodes: list[SimulatedEpisode] = field(default_factory=list)
    driven: list[DrivenEpisode] = field(default_factory=list)
    measured: dict[str, PolicyStatistics] = field(default_factory=dict)
    constant_numbers: Sequence[int] = ()
    zero_terms: Sequence[int] = ()
    clearances: dict[tuple[str, str], Clearance] = field(default_factory=dict)
    depths: dict[tuple[str, str], float] = field(default_factory=dict)
    rolling: dict[str, Rolling] = field(default_factory=dict)
    tilts: Mapping[str, float] = field(default_factory=dict)
    stop: Mapping[str, Any] | None = None
    halt: Halt | None = None
    fault: str | None = None
    done: bool = False

    def add_line(self, line: Mapping[str, Any]) -> None:  # one case per kind of line  # noqa: C901
        """Add a line that the process wrote; lines of an unknown kind are ignored."""
        match line:
            case {"at": [str(doing), int(seed)]}:
                self.where, self.fastest = SimulationPosition(doing, seed, 0), None
            case {"fast": [str(body), int() | float() as speed]}:
                self.fastest = (body, speed)
            case {
                "overlap": {
                    "one": [str(a), str(b)],
                    "other": [str(c), str(d)],
                    "depth": float(depth),
                    "seed": int(seed),
                }
            }:
                self.overlaps.append(MeasuredOverlap((a, b), (c, d), depth, seed))
            case {"early": [str(ending), int(seed)]}:
                self.endings_at_reset.setdefault(ending, []).append(seed)
            case {"miss": Mapping() as row}:
                self.misses.append(UnreachedPose(**row))
            case {"episode": Mapping() as row}:
                self.episodes.append(SimulatedEpisode(**row))
            case {"driven": Mapping() as row}:
                self.driven.append(DrivenEpisode(**row))
            case {"measured": Mapping() as policies}:
                for by, (steps, rows, numbers, terms) in policies.items():
                    numbers = [NumberStatistics(*row) for row in numbers]
                    terms = [TermStatistics(*row) for row in terms]
                    self.measured[by] = PolicyStatistics(steps, rows, numbers, terms)
            case {"still": still, "silent": silent}:
                self.constant_numbers, self.zero_terms = still, silent
            case {"clearances": rows, "depths": depths}:
                self.clearances = {
                    (robot, sensor): Clearance(*clearance) for robot, sensor, *clearance in rows
                }
                self.depths = {(robot, sensor): depth for robot, sensor, depth in depths}
            case {"rolling": Mapping() as robots}:
                self.rolling = {robot: Rolling(*counts) for robot, counts in robots.items()}
            case {"tilts": Mapping() as tilts}:
                self.tilts = tilts
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

    Ordinary scenarios take 1 to 8 s of CPU time; reaching `cpu` or `wall` is no finding. A single step, reset
    or construction of the world that takes longer than `step_seconds` is taken for an endless loop. A world
    of 500 bodies takes 0.6 GB of address space, most of it for libraries.
    """

    cpu: int = 120
    """The CPU time in all, in s."""
    step_seconds: float = 30.0
    """The CPU time for a step, in s."""
    memory: int = 4096
    """The address space, in MiB."""
    wall: float = 900.0
    """The time by the clock in all, in s, on a machine that may be busy."""


EXPLOIT_LIMITS = Limits(cpu=60)
"""The limits of a search for exploits, which plans for about 20 s."""


def require_simulator(option: str = "lint --deep") -> None:
    """Check for the simulator without importing it; `option` needs it.

    Raises:
        MissingExtraError: A package that simulating needs is not installed.
    """
    if any(find_spec(name) is None for name in _REQUIRED) or not any(
        kind.is_installed for kind in ENGINES.own.values()
    ):
        raise MissingExtraError("sim", option)


def measure(
    inputs: Inputs, limits: Limits, *, permissions: Permissions = Permissions(), search: bool = False
) -> SimulationReport:
    """Simulate a scenario in a process of its own, which compiles it from copies of its files.

    With `search`, search for exploits of the reward instead of carrying out the plan of `lint --deep`.

    Raises:
        UsageError: The copies cannot be written.
        RuntimeError: The process failed by a fault of deepbots, and DEEPBOTS_DEBUG is 1; has its traceback.
    """
    import subprocess  # with tempfile 10 ms of CPU, which static linting does not need
    import tempfile

    command = python_command("deepbots_cli.lint.simulation_process", *map(str, limits))
    environment = python_environment(
        {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    )
    with tempfile.TemporaryDirectory(prefix="deepbots-") as folder:
        inputs.write(Path(folder))
        request = json.dumps({"folder": folder, "allow_code": permissions.code, "search": search}).encode()
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
    """Return why the process ended before it was done."""
    name = signal.Signals(-code).name if -code in signal.valid_signals() else ""
    if name == "SIGPROF":
        return Halt("hang", f"{limits.step_seconds:g} s of CPU time")
    if name == "SIGXCPU":
        return Halt("slow", f"{limits.cpu} s of CPU time")
    if code == OUT_OF_MEMORY:
        return Halt("memory", f"{limits.memory} MiB")
    return Halt("crash" if name in _CRASHES else "killed", name or f"exit code {code}")
