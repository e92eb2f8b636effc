"""The report of the process that simulates a scenario, from which rules make findings.

The process writes a line for each entry, and the report is read from these lines.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

from pydantic import TypeAdapter

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


@dataclass(frozen=True)
class SimulatedEpisode:
    """One episode; `discounted_return` is the discounted return."""

    policy: str
    seed: int
    steps: int
    discounted_return: float
    end: End


DriverKind = Literal[
    "idle", "constant", "alternating", "random", "script", "interrupted", "detour", "sequence"
]
"""Who drives, the simplest first; a script is `interrupted` before its success; the search finds detours and
sequences of actions."""


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
    | SimulatedEpisode
    | DrivenEpisode
    | Summary
    | Stop
    | Fault
    | Done
)
_KINDS: dict[str, type[Entry]] = {kind.__name__: kind for kind in get_args(Entry)}
_LINE: TypeAdapter[tuple[str, dict[str, Any]]] = TypeAdapter(tuple[str, dict[str, Any]])


def encode(entry: Entry) -> bytes:
    """Return the line of an entry, without its end."""
    return json.dumps([type(entry).__name__, asdict(entry)]).encode()


def decode(line: bytes) -> Entry | None:
    """Return the entry of a line; None if the line is cut off or is not an entry."""
    try:
        kind, fields = _LINE.validate_json(line)
        return _adapter(kind).validate_python(fields) if kind in _KINDS else None
    except ValueError:
        return None


@cache
def _adapter(kind: str) -> TypeAdapter[Entry]:
    return TypeAdapter(_KINDS[kind])


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
    episodes: list[SimulatedEpisode] = field(default_factory=list)
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
            case SimulatedEpisode():
                self.episodes.append(entry)
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
