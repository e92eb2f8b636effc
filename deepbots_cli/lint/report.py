"""The report of the process that simulates a scenario, from which rules make findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

End = Literal["success", "failure", "limit", "left"]
"""How an episode ended: by the task, by truncation, or left after enough steps."""
ARENA = "arena walls"
"""Holds a blank, which no name of an object does."""
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
        """What a term gave in the whole episode."""
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
    """Of a robot since the start of an episode: the largest distance (m), change of heading (rad), and turn
    of a driven wheel (rad)."""

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


@dataclass
class SimulationReport:
    """The lines that the simulating process has written. Names in it are only ever looked up in the scenario.

    `endings_at_reset` maps endings to the seeds with which they hold at the start; `constant_numbers` and
    `zero_terms` are the places of the numbers that never changed and of the terms that were always 0.
    `clearances` and `depths` are about sensors whose rays met nothing: how high they passed over all bodies,
    and how far below the ground (m) they began. `rolling` is about robots on driven wheels, and `tilts` (rad)
    about robots with a free base: how far each tilts at least within `TOPPLING_S` of doing nothing. `done`
    says whether the plan was completed, `fault` which exception of deepbots ended it.
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
        """Add one line of the process."""
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
