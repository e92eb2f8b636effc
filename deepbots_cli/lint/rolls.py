"""Resets and episodes, and what is measured in them. Runs in a process of its own (`child`), and tells it line by line.

Whatever may go wrong in an engine goes wrong here. The last line says how far it had got.
"""

from __future__ import annotations

import functools
import math
import traceback
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api
from deepbots_cli.errors import DeepbotsError, EngineError, EvaluationError
from deepbots_cli.lint.arms import Reaches
from deepbots_cli.lint.measured_rays import Overlooking
from deepbots_cli.lint.plan import HELD, HOLD, IDLE, RANDOM, Roll, idle, planned, planned_for_variant
from deepbots_cli.lint.speeds import Speeds
from deepbots_cli.program import CurriculumStage, EvaluationCase, Program
from deepbots_cli.program.task import Choices, viewed
from deepbots_cli.runtime import Supervisor

Say = Callable[[dict[str, Any]], None]
Step = Callable[[int], None]

DEFAULT_DISCOUNT = 0.99
_ROUNDING = 1e-6
"""Of a number of the observation, which goes from -1 to 1: what differs by less does not differ."""
_NOTHING = 1e-9
"""The same for a term of the reward."""


_FIRST_COMMANDS = 2
"""Episodes in which the first command of each arm is looked at, and for how many steps that may be on its way."""
_LATEST = 10


class StoppedError(Exception):
    """The rest of the plan cannot be done; what stopped it has been told."""


class Rolls:
    """The plan of one scenario. `say` takes what is found out, `step` the number of the step that comes next."""

    def __init__(self, ir: Program, say: Say, step: Step, *, allow_code: bool) -> None:
        self._ir = ir
        self._say = say
        self._step = step
        self._allow_code = allow_code
        self._plan = planned(ir)
        self._discount = _discount(ir)
        self.measures: dict[str, Measure] = {}
        self._overlooking = Overlooking(ir)

    def run(self) -> None:
        """All of it, until something stops it."""
        try:
            self._look_at_starts()
            with closing(self._made(self._ir)) as environment:
                self._look_at_resets(environment)
                reaches = Reaches(environment)
                if reaches.arms:
                    self._look_at_first_commands(environment, reaches)
                self._roll_out(environment, self._plan.rolls, reaches)
            self._try_variants()
        except StoppedError:
            return
        self._say({"measured": {by: measure.told() for by, measure in self.measures.items() if by != _VARIANTS}})
        self._say({"still": self._still(), "silent": self._silent()})
        self._say({"over": [[*both, *aim] for both, aim in self._overlooking.aims.items()]})

    def _made(self, ir: Program) -> Supervisor:
        self._say({"at": ["build", 0]})
        try:
            return api.build(ir, allow_code=self._allow_code)
        except DeepbotsError as error:
            self._say({"stop": {"kind": "build", "text": str(error)}})
            raise StoppedError from None

    # Starts

    def _look_at_starts(self) -> None:
        """What lies within something else before anything moves, so also before the world settles."""
        deepest: dict[tuple[str, str], dict[str, Any]] = {}
        ir = replace(self._ir, reset=replace(self._ir.reset, settle=0.0))
        with closing(self._made(ir)) as environment:
            for seed in range(self._plan.resets):
                if not self._begins(environment, seed, tell=not self._ir.reset.settle):
                    continue
                for found in environment.engine.overlaps():
                    known = deepest.setdefault((found.one[0], found.other[0]), {"depth": 0.0})
                    if found.depth > known["depth"]:
                        known |= {"one": list(found.one), "other": list(found.other), "depth": found.depth, "seed": seed}
        for overlap in deepest.values():
            self._say({"overlap": overlap})

    def _look_at_resets(self, environment: Supervisor) -> None:
        for seed in range(self._plan.resets if self._ir.reset.settle else 0):
            self._begins(environment, seed, tell=True)

    def _look_at_first_commands(self, environment: Supervisor, reaches: Reaches) -> None:
        """Whether arms reach the first pose that they are commanded to. Every choice should lead to one; the end of a range need not."""
        by = IDLE if idle(self._ir) is not None else RANDOM
        if by == RANDOM and not all(isinstance(part, Choices) for part in self._ir.action):
            return
        for seed in range(_FIRST_COMMANDS):
            reaches.watching = True
            self._say({"at": [by, seed]})
            actions = _actions(environment, Roll(by, seed, _LATEST))
            try:
                environment.reset(seed=seed)
                for number in range(1, _LATEST + 1):
                    self._step(number)
                    _, _, terminated, truncated, _ = environment.step(next(actions))
                    if reaches.commands or terminated or truncated:
                        break
            except DeepbotsError:  # the episodes to come tell of it
                pass
            self._tell_missed(reaches, by, seed)

    def _tell_missed(self, reaches: Reaches, by: str, seed: int) -> None:
        reaches.watching = False
        for missed in reaches.missed(by, seed):
            self._say({"missed": asdict(missed)})

    def _begins(self, environment: Supervisor, seed: int, *, tell: bool) -> bool:
        """Whether a world was put together; `tell` says if an ending held in it already."""
        self._say({"at": ["reset", seed]})
        try:
            environment.reset(seed=seed)
        except EvaluationError as error:
            if environment.terminated:
                if tell:
                    self._say({"early": {"ending": environment.ended_by, "seed": seed}})
                return True
            raise self._stopped(environment, error) from None
        except DeepbotsError as error:
            raise self._stopped(environment, error) from None
        return True

    # Episodes

    def _roll_out(
        self, environment: Supervisor, rolls: tuple[Roll, ...], reaches: Reaches | None = None, measured_as: str | None = None
    ) -> None:
        for roll in rolls:
            if measured_as is None and roll.drawn and self._drawn_steps() >= self._plan.enough:
                continue
            measure = self.measures.setdefault(measured_as or roll.by, Measure(self._ir))
            self._say({"at": [roll.by, roll.seed]})
            if reaches is not None:
                reaches.watching = roll.script is not None
            try:
                self._episode(environment, roll, measure, tell=measured_as is None)
            except DeepbotsError as error:
                if isinstance(error, EvaluationError) and environment.step_count == 0 and environment.terminated:
                    continue  # told of its reset
                raise self._stopped(environment, error) from None
            finally:
                if reaches is not None:
                    self._tell_missed(reaches, roll.by, roll.seed)

    def _drawn_steps(self) -> int:
        return sum(self.measures[by].steps for by in (RANDOM, HELD) if by in self.measures)

    def _episode(self, environment: Supervisor, roll: Roll, measure: Measure, *, tell: bool) -> None:
        environment.reset(seed=roll.seed)
        chosen, speeds, look = _actions(environment, roll), Speeds(environment), self._overlooking.watch(environment.engine)
        rewards: list[float] = []
        for number in range(1, roll.steps + 1):
            self._step(number)
            observation, reward, terminated, truncated, info = environment.step(next(chosen))
            rewards.append(reward)
            measure.take(observation, info["reward_terms"])
            look()
            violent = speeds.look(number * environment.scenario.period)
            if speeds.news:
                self._say({"fast": speeds.news})
            if violent:
                self._say({"stop": {"kind": "speed", **violent}})
                raise StoppedError
            if not environment.observation_space.contains(observation):
                self._say({"stop": {"kind": "space", "entries": _outside(environment, observation)}})
                raise StoppedError
            if terminated or truncated:
                break
        if tell:
            self._tell_end(environment, roll, rewards)

    def _tell_end(self, environment: Supervisor, roll: Roll, rewards: list[float]) -> None:
        worth = float(np.dot(rewards, self._discount ** np.arange(len(rewards))))
        end = "success" if environment.is_success else "failure" if environment.terminated else "limit" if environment.truncated else "left"
        row = {"by": roll.by, "seed": roll.seed, "steps": len(rewards), "total": math.fsum(rewards), "worth": worth}
        self._say({"episode": {**row, "end": end, "ended_by": environment.ended_by}})

    # What has not moved so far

    def _still(self) -> list[int]:
        """Numbers of the observation, by place, that were the same in every step of every episode; pictures after them."""
        whole = functools.reduce(Measure.joined, self.measures.values(), Measure(self._ir))
        return [place for place in range(len(self._ir.numbers) + len(self._ir.images)) if not whole.moves(place)]

    def _silent(self) -> list[int]:
        """Terms of the reward, by place, that were 0 in all of them."""
        return [place for place in range(len(self._ir.reward)) if not any(measure.fired[place] for measure in self.measures.values())]

    def _try_variants(self) -> None:
        """Cases and stages may show what the scenario itself does not."""
        variants: tuple[EvaluationCase | CurriculumStage, ...] = (*self._ir.cases, *self._ir.curriculum)
        for variant in variants:
            if not self._still() and not self._silent():
                return
            ir = variant.program
            if len(ir.numbers) + len(ir.images) == len(self._ir.numbers) + len(self._ir.images) and len(ir.reward) == len(self._ir.reward):
                with closing(self._made(ir)) as environment:
                    self._roll_out(environment, planned_for_variant(ir), measured_as=_VARIANTS)

    # What went wrong

    def _stopped(self, environment: Supervisor, error: DeepbotsError) -> StoppedError:
        """Tell what stopped an episode; to be raised."""
        told: dict[str, Any] = {"text": str(error), "step": environment.step_count}
        lost = Speeds(environment).lost()
        if lost:
            told |= {"kind": "lost", "body": lost[0]}
        elif isinstance(error, EngineError):
            told |= {"kind": "engine"}
        else:
            told |= {"kind": "value", "lines": _lines(error), "terms": _infinite(environment), "seed": environment.streams.root}
        self._say({"stop": told})
        return StoppedError()


_VARIANTS = "cases and stages"


class Measure:
    """What the episodes of one policy came to, per number of the observation and per term of the reward."""

    def __init__(self, ir: Program) -> None:
        self._ir = ir
        ages = viewed(ir.numbers, ir.agent.stack)
        self._columns = [ages.index((place, 0)) for place in range(len(ir.numbers))]
        self._pictures = [entry.key for entry in ir.images]
        self._first: dict[str, NDArray[np.uint8]] = {}
        self._changed: set[str] = set()
        numbers, terms = len(ir.numbers), len(ir.reward)
        self.steps = 0
        self.rows = 0
        self.low, self.high = np.full(numbers, np.inf), np.full(numbers, -np.inf)
        self.at_low, self.at_high = np.zeros(numbers, int), np.zeros(numbers, int)
        self.sums, self.sizes, self.fired = np.zeros(terms), np.zeros(terms), np.zeros(terms, int)
        self.least, self.most = np.full(terms, np.inf), np.full(terms, -np.inf)

    def take(self, observation: Any, terms: dict[str, float]) -> None:
        """Count one step; of a team there is a row for each copy."""
        self.steps += 1
        self._take_terms(np.array(list(terms.values())))
        if isinstance(observation, dict):
            self._take_pictures(observation)
            observation = observation.get("observation", np.zeros((1, 0)))
        for row in np.atleast_2d(observation)[:, self._columns]:
            self.rows += 1
            np.minimum(self.low, row, out=self.low)
            np.maximum(self.high, row, out=self.high)
            self.at_low += row <= -1.0
            self.at_high += row >= 1.0

    def _take_terms(self, values: NDArray[np.float64]) -> None:
        self.sums += values
        self.sizes += np.abs(values)
        self.fired += np.abs(values) > _NOTHING
        np.minimum(self.least, values, out=self.least)
        np.maximum(self.most, values, out=self.most)

    def _take_pictures(self, observation: dict[str, Any]) -> None:
        for key in self._pictures:
            if key not in self._changed and (observation[key] != self._first.setdefault(key, observation[key])).any():
                self._changed.add(key)

    def joined(self, other: Measure) -> Measure:
        """What the observation was over both: it moved, too, if it was not the same in one as in the other."""
        both = Measure(self._ir)
        both.low, both.high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        both._changed = self._changed | other._changed
        return both

    def moves(self, place: int) -> bool:
        """Whether an entry was not the same throughout."""
        numbers = len(self._columns)
        return bool(self.high[place] - self.low[place] > _ROUNDING) if place < numbers else self._pictures[place - numbers] in self._changed

    def told(self) -> dict[str, Any]:
        """As data; what was never looked at is left out."""
        if not self.steps:
            return {"steps": 0, "rows": 0, "seen": [], "terms": []}
        seen = zip(self.low.tolist(), self.high.tolist(), self.at_low.tolist(), self.at_high.tolist(), strict=True)
        paid = zip(*(part.tolist() for part in (self.sums, self.sizes, self.fired, self.least, self.most)), strict=True)
        return {"steps": self.steps, "rows": self.rows, "seen": [list(row) for row in seen], "terms": [list(row) for row in paid]}


def _actions(environment: Supervisor, roll: Roll) -> Iterator[Any]:
    """An endless row of actions, among those that are not forbidden."""
    if roll.script is not None:
        return (environment.script(roll.script) for _ in count())
    if roll.by == IDLE:
        return _idle(environment)
    return _random(environment, {RANDOM: 1, HELD: HOLD}[roll.by])


def _random(environment: Supervisor, hold: int) -> Iterator[Any]:
    scenario = environment.scenario
    masked = scenario.agent.each is None and any(option.forbidden for part in scenario.action for option in getattr(part, "options", ()))
    for number in count():
        if number % hold == 0 or masked:
            action = environment.action_space.sample(environment.action_mask()) if masked else environment.action_space.sample()
        yield action


def _idle(environment: Supervisor) -> Iterator[Any]:
    wanted = idle(environment.scenario)
    assert wanted is not None  # or it would not be in the plan
    copies = environment.scenario.agent.each
    one = getattr(environment, "members", [environment])[0].acting(*wanted)
    if copies is not None:
        one = (
            {key: np.stack([part] * copies.count) for key, part in one.items()} if isinstance(one, dict) else np.array([one] * copies.count)
        )
    while True:
        yield one


def _discount(ir: Program) -> float:
    found = [entry.value for entry in ir.training.hyperparameters if entry.name == "gamma"] if ir.training else []
    return found[0] if found and isinstance(found[0], float) else DEFAULT_DISCOUNT


def _outside(environment: Supervisor, observation: Any) -> list[str]:
    """The numbers of an observation that are outside of its space, by name."""
    numbers = np.atleast_2d(observation["observation"] if isinstance(observation, dict) else observation)
    entries = [environment.scenario.numbers[place] for place, _ in viewed(environment.scenario.numbers, environment.scenario.agent.stack)]
    return [
        entry.full_name
        for entry, column in zip(entries, numbers.T, strict=True)
        if not np.isfinite(column).all() or (entry.clip and (np.abs(column) > 1.0).any())
    ]


def _infinite(environment: Supervisor) -> list[str]:
    """The terms of the reward that are no finite number."""
    if not environment.step_count:
        return []
    return [name for name, value in environment.get_info()["reward_terms"].items() if not math.isfinite(value)]


def _lines(error: BaseException) -> list[str]:
    """The lines of the generated module in which an expression had no value, the innermost first."""
    raised = [error.__cause__, error] if error.__cause__ else [error]
    frames = [frame for each in raised for frame in reversed(traceback.extract_tb(each.__traceback__))]
    return [frame.line or "" for frame in frames if frame.filename.startswith("<deepbots")]
