"""The episodes of `lint --exploits`: fixed drivers, scripts, and scripts that are left or interrupted before
their success. Runs in a process of its own.

Every driver is a text that `--driver` takes, so that each episode can be repeated by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from itertools import combinations, islice, product, repeat
from math import dist, pi, prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.lint.exploits import is_better_than_success
from deepbots_cli.lint.rollouts import Player, StoppedError
from deepbots_cli.lint.simulation import Activity, DrivenEpisode, DriverKind, End, Entry, Stop, work_per_step
from deepbots_cli.program import RANDOM, ZERO, Program
from deepbots_cli.program.task import Agent, Choices, idle_action
from deepbots_cli.rollout import Start, Step
from deepbots_cli.rollout.drivers import named_driver
from deepbots_cli.runtime import Supervisor

_STARTS = 3
"""The number of episodes with different starts, from number 0 on."""
_MAX_WORK = 800_000.0
"""The work of a search in the unit of `work_per_step`; 15 to 60 s of CPU."""
_SHARE_OF_FIXED = 0.6
"""The share of the steps for the drivers of the first start; the others confirm and interrupt them."""
_MAX_CONSTANTS = 27
_MAX_PAIRS = 12
_HOLDS = (2, 10)
"""The numbers of steps for which alternating actions are held."""
_CONFIRMED = 3
"""The number of best drivers of the first start that are tried on the others, for each kind of end."""
# Steps for which a script is interrupted, and by how many actions. A success in fewer steps after that does
# not last.
_INTERRUPTIONS = (1, 3)
_MAX_INTERRUPTIONS = 5
_MIN_BETWEEN = 2
_SHARE_OF_INTERRUPTIONS = 0.1
"""The share of the steps that are left for the interruptions from each start."""
_AT_LIMIT = 0.02
"""The share of the range of a joint within which it is at a limit."""

_MAX_SHOWN = 80


class ExploitSearch(Player):
    """Plays the episodes of a scenario."""

    def __init__(
        self,
        program: Program,
        write: Callable[[Entry], None],
        begin_step: Callable[[int], None],
        permissions: Permissions,
    ) -> None:
        super().__init__(program, write, begin_step, permissions)
        self._left = int(_MAX_WORK / work_per_step(program))
        self._longest = max(10, min(program.truncation.max_episode_steps(program.period), self._left // 4))
        self._played: dict[tuple[str, int], DrivenEpisode | None] = {}
        self._peaks: dict[tuple[str, int], int] = {}
        """The step before the last that earns most in each episode."""
        self._slots = action_slots(program.agent)

    def run(self) -> None:
        """Play fixed drivers and scripts, and interrupt scripts if these earn no more than a success."""
        try:
            self._environment = self._build(self._program)
        except StoppedError:
            return
        last = self._program.truncation.max_episode_steps(self._program.period)
        if self._longest < last:
            text = f"only the first {self._longest:,} of {last:,} steps of an episode are played"
            self._write(Stop("shortened", text))
        with closing(self._environment):
            fixed = list(fixed_drivers(self._program))
            everywhere = [(driver, kind) for driver, kind in fixed if kind in ("idle", "script")]
            for number, simple in product(range(_STARTS), everywhere):
                self._play(*simple, number)
            enough = self._left * (1.0 - _SHARE_OF_FIXED)
            for count, (driver, kind) in enumerate(fixed):
                if self._left <= enough:
                    text = f"only {count} of {len(fixed)} fixed drivers are played: the others take too long"
                    self._write(Stop("shortened", text))
                    break
                self._play(driver, kind, 0)
            self._confirm()
            if self._program.defines_success and not is_better_than_success(self._episodes):
                for number in range(_STARTS):
                    self._interrupt(number)

    @property
    def _episodes(self) -> list[DrivenEpisode]:
        return [episode for episode in self._played.values() if episode is not None]

    def _confirm(self) -> None:
        """Play the best drivers of the first start from the others too."""
        first = [episode for episode in self._episodes if episode.number == 0]
        for end in ("failure", "limit"):
            ended = [episode for episode in first if episode.end == end]
            best = sorted(ended, key=lambda episode: -episode.total_return)[:_CONFIRMED]
            best += sorted(ended, key=lambda episode: -episode.discounted_return)[:1]
            for episode, number in product(best, range(1, _STARTS)):
                self._play(episode.driver, episode.kind, number)

    def _interrupt(self, number: int) -> None:
        """Leave the best script in the step before its success; go to and fro from the step that it earns
        most in, such as a bonus; or interrupt it before its success again and again, which may have to last
        for a time."""
        reached = [
            episode
            for episode in self._episodes
            if episode.number == number and episode.end == "success" and episode.kind == "script"
        ]
        if not reached:
            return
        best = max(reached, key=lambda episode: episode.total_return)
        before = best.steps - 1
        actions = [
            driver_text(self._slots, [values]) for values in _constants(self._slots)[:_MAX_INTERRUPTIONS]
        ]
        for action in actions:
            self._play(f"{best.driver}*{max(1, before)},{action}*{self._longest}", "detour", number)
        enough = self._left * (1.0 - _SHARE_OF_INTERRUPTIONS)
        peak = self._peaks[best.driver, number]
        for pair, hold in product(_opposites(self._slots), _HOLDS):
            for order in (pair, pair[::-1]):
                if self._left >= enough:
                    cycle = f",{driver_text(self._slots, order, [hold, hold])}"
                    turns = (self._longest - peak) // (2 * hold) + 1
                    self._play(f"{best.driver}*{peak}{cycle * turns}", "interrupted", number)
        enough = self._left * (1.0 - _SHARE_OF_INTERRUPTIONS)
        for action, lasting in product(actions, _INTERRUPTIONS):
            if self._left < enough:
                return
            again = self._play(
                f"{best.driver}*{max(1, before)},{action}*{lasting},{best.driver}*{self._longest}",
                "interrupted",
                number,
            )
            between = (
                again.steps - before - lasting - 1 if again is not None and again.end == "success" else 0
            )
            if between < _MIN_BETWEEN:
                continue
            turns = (self._longest - before) // (lasting + between) + 1
            self._play(
                f"{best.driver}*{max(1, before)}" + f",{action}*{lasting},{best.driver}*{between}" * turns,
                "interrupted",
                number,
            )

    # Episodes

    def _play(self, driver: str, kind: DriverKind, number: int) -> DrivenEpisode | None:
        """Play one episode; None if the steps of the plan are used up, or if it cannot go on."""
        key = driver, number
        if key not in self._played and self._left > 0:
            self._write(Activity(driver[:_MAX_SHOWN], number))
            try:
                self._played[key] = self._episode(driver, kind, number)
            except DeepbotsError:  # `lint --deep` reports it
                self._played[key] = None
        return self._played.get(key)

    def _episode(self, driver: str, kind: DriverKind, number: int) -> DrivenEpisode:
        environment = self._environment
        acting = named_driver(self._environment, driver)
        watch: MotionWatch | None = None
        rows: list[list[float]] = []
        start = Start.of_evaluation(0, number)
        step: Step | None = None
        for step in self._steps(environment, acting.act, start, self._longest):
            self._left -= 1
            if watch is None:
                watch = MotionWatch(environment)
            else:
                watch.add()
                rows.append([*step.info["reward_terms"].values(), step.reward])
        assert step is not None
        assert watch is not None
        values: NDArray[np.float64] = np.array(rows)
        quarters = [part.sum(axis=0) for part in np.array_split(values[:, :-1], 4)]
        rewards = values[:, -1]
        self._peaks[driver, number] = 1 + int(np.argmax(rewards[:-1])) if len(rewards) > 1 else 1
        episode = DrivenEpisode(
            driver=driver,
            kind=kind,
            number=number,
            total_return=float(rewards.sum()),
            ended_by=step.info["ended_by"],
            terms={
                name: [float(part[at]) for part in quarters]
                for at, name in enumerate(step.info["reward_terms"])
            },
            steps=len(rewards),
            discounted_return=float(rewards @ self._program.agent.discount ** np.arange(len(rewards))),
            end=_end(step),
            **watch.summary(),
        )
        self._write(episode)
        return episode


def _end(last: Step) -> End:
    """Return how an episode ended, from its last step."""
    if last.terminated or last.info["is_success"]:
        return "success" if last.info["is_success"] else "failure"
    return "limit" if last.truncated else "left"


# Fixed drivers


class Slot(NamedTuple):
    """A number of the action: the texts of the options of a choice, or none for a value from -1 to 1; `idle`
    is the value that does nothing."""

    options: tuple[str, ...]
    idle: float

    def text(self, value: float) -> str:
        return self.options[int(value)] if self.options else f"{value:.6g}"

    @property
    def extremes(self) -> list[float]:
        """The options, or both ends and the middle; the idle one first."""
        extremes = list(range(len(self.options))) if self.options else [-1.0, 1.0]
        return [self.idle, *(value for value in extremes if value != self.idle)]


def action_slots(agent: Agent) -> list[Slot]:
    """Return the numbers of an action, in their order in the text of a driver. An option with the name of
    another driver is written by its index."""
    drivers = {RANDOM, ZERO, *(script.name for script in agent.scripts)}
    idle = idle_action(agent.action)
    choices, values = (iter(idle[0]), iter(idle[1])) if idle is not None else (repeat(0), repeat(0.0))
    slots = []
    for part in agent.action:
        if isinstance(part, Choices):
            names = [option.name for option in part.options]
            texts = (str(at) if name in drivers else name for at, name in enumerate(names))
            slots.append(Slot(tuple(texts), float(next(choices))))
        else:
            slots += [Slot((), float(next(values))) for _ in part.names]
    return slots


def fixed_drivers(program: Program) -> Iterator[tuple[str, DriverKind]]:
    """Yield scripts, doing nothing, constant, alternating and random actions."""
    for script in program.agent.scripts:
        yield script.name, "script"
    slots = action_slots(program.agent)
    constants = _constants(slots)
    has_idle = idle_action(program.agent.action) is not None
    for number, values in enumerate(constants):
        yield driver_text(slots, [values]), "idle" if has_idle and not number else "constant"
    for pair, hold in product(_opposites(slots), _HOLDS):
        yield driver_text(slots, pair, [hold, hold]), "alternating"
    yield RANDOM, "random"


def _constants(slots: Sequence[Slot]) -> list[tuple[float, ...]]:
    """Return combinations of the extremes; if these are many, each extreme alone, and all at the same end.
    The first does nothing."""
    idle = tuple(slot.idle for slot in slots)
    if prod(len(slot.extremes) for slot in slots) <= _MAX_CONSTANTS:
        return list(product(*(slot.extremes for slot in slots)))
    ends = [tuple(value if not slot.options else slot.idle for slot in slots) for value in (-1.0, 1.0)]
    alone = [
        (*idle[:at], value, *idle[at + 1 :]) for at, slot in enumerate(slots) for value in slot.extremes[1:]
    ]
    return list(dict.fromkeys([idle, *ends, *alone]))[:_MAX_CONSTANTS]


def _opposites(slots: Sequence[Slot]) -> list[tuple[Sequence[float], Sequence[float]]]:
    """Return the first pairs of opposite actions."""
    pairs = (pair for pair in combinations(_constants(slots), 2) if _are_opposite(slots, *pair))
    return list(islice(pairs, _MAX_PAIRS))


def _are_opposite(slots: Sequence[Slot], first: Sequence[float], second: Sequence[float]) -> bool:
    """Return whether every range has the opposite value, and at least one number differs."""
    pairs = list(zip(slots, first, second, strict=True))
    return first != second and all(slot.options or a == -b or (a == b == slot.idle) for slot, a, b in pairs)


def driver_text(
    slots: Sequence[Slot], actions: Sequence[Sequence[float]], holds: Sequence[int] | None = None
) -> str:
    """Return actions as `--driver` takes them, each for so many steps."""
    texts = [
        ":".join(slot.text(value) for slot, value in zip(slots, action, strict=True)) for action in actions
    ]
    return ",".join(
        text if hold == 1 else f"{text}*{hold}"
        for text, hold in zip(texts, holds or [1] * len(texts), strict=True)
    )


# Motion


class MotionWatch:
    """Measures the motion of the first robot of the agent in an episode, from its reset on."""

    def __init__(self, environment: Supervisor) -> None:
        name = environment.scenario.agent.robots[0]
        robot = next(robot for robot in environment.world.robots if robot.name.partition("#")[0] == name)
        limited = [
            joint
            for joint in robot.model.moving_joints
            if joint.limit.lower is not None and joint.limit.upper is not None
        ]
        self._motion = environment.engine.motion(robot.name)
        self._joints = (
            environment.engine.joint_states(robot.name, [joint.name for joint in limited])
            if limited
            else None
        )
        self._limits = [
            (float(joint.limit.lower or 0.0), float(joint.limit.upper or 0.0)) for joint in limited
        ]
        self._period = environment.scenario.period
        self._start = self._position = self._motion()[0][0]
        self._path = self._turned = 0.0
        self._steps = self._stopped = 0

    def add(self) -> None:
        """Count one step."""
        (position, _), (_, spin) = self._motion()
        self._path += dist(position, self._position)
        self._position = position
        self._turned += spin[2] * self._period
        self._steps += 1
        if self._joints is not None:
            states = zip(self._joints(), self._limits, strict=True)
            self._stopped += all(
                min(state[0] - low, high - state[0]) < _AT_LIMIT * (high - low)
                for state, (low, high) in states
            )

    def summary(self) -> dict[str, Any]:
        """Return the fields of a `DrivenEpisode` about motion."""
        turns, stopped = abs(self._turned) / (2 * pi), self._stopped / max(1, self._steps)
        return {
            "path": self._path,
            "distance": dist(self._position, self._start),
            "turns": turns,
            "stopped": stopped,
        }
