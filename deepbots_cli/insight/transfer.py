"""What differs between two worlds of a scenario, such as two engines, or a simulation and one with another mass: first, and why.

The policy plays some episodes in the world of its training, and the other world repeats their starts and actions. The difference of each
number of the observation and of each reward term then comes from the world, not from other actions. `causes` are changes of the first
world that make it more like the second one: another order, sign, unit or age of a number, or another latency, mass, friction, strength,
gain, lag or order of motors. Changes of the physics are simulated, each with the same starts and actions.

Of about a hundred such worlds most explain nothing. One change of each kind is therefore simulated first, in two episodes, and until the
differences have grown; then all amounts of the kinds that explain most, and in the end the best of these in all episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from itertools import combinations, islice
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import Document, MappingNode, Permissions
from deepbots_cli.document.nodes import entries_at
from deepbots_cli.errors import DeepbotsError, EvaluationError, UsageError
from deepbots_cli.insight.conditions import InstrumentedProgram, instrument_program
from deepbots_cli.learning.episodes import meets_solved
from deepbots_cli.learning.evaluation import EvaluationResult, evaluate
from deepbots_cli.learning.robustness import (
    Change,
    Plan,
    Robustness,
    base_document,
    changed_scenario,
    evaluate_robustness,
    friction,
    listed,
    masses,
    plans,
    written,
)
from deepbots_cli.learning.run import ModelName, Run
from deepbots_cli.learning.spread import ONE_BY_ONE, Spread
from deepbots_cli.program import Program
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout import Start, steps
from deepbots_cli.rollout.drivers import sequence_driver
from deepbots_cli.rollout.episode import Episode
from deepbots_cli.rollout.policies import FORWARD_BATCH_SIZE, PolicyDriver
from deepbots_cli.rollout.source import Source

EPISODES, MAX_STEPS = 6, 100
"""How many episodes are compared, and how many steps of each: small differences grow, and in the end only show that they have grown."""
_THRESHOLD = 0.01
"""A number differs if it is off by more than this share of the width that it spans in the first world."""
_LATEST = 8
"""The largest age of a number, in steps, that is tried."""
_EXACT = 0.05
"""A number is explained by its order, sign, unit or age if this share of the squared difference is left at most."""
_LEAST_EXPLAINED = 0.3
"""Share of the squared differences that a cause must explain."""
_GROWN, _FEW = 0.1, 5
"""A difference has grown from this share of the width on; so many moments more are counted as early ones."""
_PROBED_EPISODES, _PROBED_STEPS = 2, 50
"""Episodes in which one change of each kind is simulated, those with the largest differences, and steps of each at most."""
_REFINED = 12
"""Kinds of changes that are simulated with all amounts in these episodes."""
_FINAL = 8
"""Changes that are simulated in all episodes."""
_GAINS = {"smaller": (0.75, 0.5, 0.25), "larger": (1.25, 1.5, 2.0)}
"""Factors on an action or a command, by side."""
MIN_EPISODES = FORWARD_BATCH_SIZE
"""Episodes of an evaluation that a number of steps does not leave out: deepbots plays as many at a time."""
QUICK_EPISODES = 4
"""Episodes that a quick comparison compares."""
_MAX_LINKS = 12
"""The largest number of links whose mass is changed."""
_REWARD = "reward."
"""How the name of a reward term begins."""
_MAX_MOTORS = 12
"""The largest number of motors whose order is tried."""
_UNITS = {
    57.29577951308232: "in degrees instead of radians",
    0.017453292519943295: "in radians instead of degrees",
    1000.0: "in thousandths of its unit",
    100.0: "in hundredths of its unit",
    0.001: "in thousands of its unit",
    0.01: "in hundreds of its unit",
}

Array = NDArray[np.float64]
Act = Callable[[Any], Any]
"""Changes an action."""


class Difference(NamedTuple):
    """A number of the observation, or a reward term, that differs.

    Attributes:
        name: Its name; that of a reward term begins with `reward.`.
        unit: Its unit; empty for a number without one.
        episode: The episode in which it differs first.
        step: The first step of this episode in which it differs; 0 is the reset.
        here: The value in the first world, in SI units.
        there: The value in the other one.
        share: The root mean square of its differences, as a share of the width that it spans in the first world.
    """

    name: str
    unit: str
    episode: int
    step: int
    here: float
    there: float
    share: float


class Cause(NamedTuple):
    """A change of the first world that makes it more like the other one; `explained` is the share of the squared differences that goes."""

    text: str
    explained: float


@dataclass(frozen=True)
class WorldComparison:
    """`differences` in the order in which they begin, and `causes` from the one that explains most.

    A cause explains numbers of the observation, so there is none if only reward terms differ.
    """

    episodes: int
    steps: int
    differences: tuple[Difference, ...]
    causes: tuple[Cause, ...]

    @property
    def observation_differs(self) -> bool:
        return any(not each.name.startswith(_REWARD) for each in self.differences)


class World(NamedTuple):
    """A scenario and the engine in which it runs."""

    program: Program
    engine: str | None


class _Recorded(NamedTuple):
    """An episode: how it began, its actions, and its values, an array of the shape (moments, columns)."""

    start: Start
    actions: Sequence[Any]
    values: Array


def compare_worlds(
    run: Run,
    here: World,
    there: World,
    document: Document,
    *,
    seed: int,
    model: ModelName = "best",
    episodes: int = EPISODES,
    permissions: Permissions = Permissions(),
    on_world: Callable[[int, int], object] = lambda done, planned: None,
) -> WorldComparison:
    """Compare two worlds by the actions of a policy.

    Args:
        run: The run of the policy.
        here: The world in which the policy acts, and which is changed to find causes.
        there: The world that repeats its actions.
        document: The scenario of `here`, from `robustness.base_document`.
        seed: Root seed of the starts.
        on_world: Called with the number of worlds that were compared, and of all.

    Raises:
        UsageError: The scenario has copies of a robot.
    """
    if here.program.agent.copies is not None:
        raise UsageError(f"{here.program.name} has copies of a robot, whose worlds cannot be compared step by step")
    columns = _columns(instrument_program(here.program, include_observation=True))
    recorded = _recorded(run, here, model, seed, episodes, permissions)
    comparison = _Comparison(columns, recorded, _repeated(there, recorded, permissions))
    result = WorldComparison(len(recorded), max(len(each.actions) for each in recorded), tuple(comparison.differences()), ())
    if not result.observation_differs:
        return result
    causes = [*comparison.measured_causes()]
    with closing(_Recorder(here, permissions)) as unchanged:
        causes += _simulated_causes(comparison, [*_changes(here, unchanged, document, permissions)], on_world)
    likely = sorted((cause for cause in causes if cause.explained >= _LEAST_EXPLAINED), key=lambda cause: -cause.explained)  # stable
    return replace(result, causes=tuple(likely))


def _simulated_causes(comparison: _Comparison, kinds: Sequence[list[_Change]], on_world: Callable[[int, int], object]) -> Iterator[Cause]:
    """The changes that explain most of a few short episodes, and how much they explain of all."""
    probe = comparison.part(_PROBED_EPISODES, _PROBED_STEPS)
    scores: dict[_Change, float] = {}

    def score(changes: Sequence[_Change]) -> None:
        for number, change in enumerate(changes):
            scores[change] = max((cause.explained for cause in probe.tried(change)), default=-inf)
            on_world(number + 1, len(changes))

    probed = {kind[(len(kind) - 1) // 2]: kind for kind in kinds}
    score(list(probed))
    best = sorted((change for change in probed if scores[change] > 0.0), key=lambda change: -scores[change])[:_REFINED]
    score([change for chosen in best for change in probed[chosen] if change not in scores])
    last = sorted((change for change in scores if scores[change] > 0.0), key=lambda change: -scores[change])[:_FINAL]
    for number, change in enumerate(last):
        yield from comparison.tried(change)
        on_world(number + 1, len(last))


class _Column(NamedTuple):
    name: str
    unit: str


def _columns(watch: InstrumentedProgram) -> list[_Column]:
    kept = _kept(watch)
    return [
        *(_Column(each.full_name, each.unit.removeprefix("1")) for each in watch.program.agent.numbers if each.name in kept),
        *(_Column(f"{_REWARD}{term.name}", "") for term in watch.program.agent.reward),
    ]


def _kept(watch: InstrumentedProgram) -> dict[str, str]:
    """The kept value of each entry of the observation; without the previous action, which says nothing about a world."""
    return {name: kept for name, kept in watch.observed_signals.items() if name != "previous_action"}


class _Recorder(gym.Wrapper[Any, Any, Any, Any]):
    """A world that notes the actions of an episode, and its values: those of the observation in SI units, and the reward terms."""

    def __init__(self, world: World, permissions: Permissions) -> None:
        self._watch = instrument_program(world.program, include_observation=True)
        self._made = api.build(self._watch.program, engine=world.engine, permissions=permissions)
        super().__init__(self._made)
        self.actions: list[Any] = []
        self._rows: list[list[float]] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self.actions, self._rows = [], []
        try:
            return self.env.reset(seed=seed, options=options)
        finally:  # also where an ending is true already, such as by a wrong sensor
            self._note()

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        outcome = self.env.step(action)
        self.actions.append(action)
        self._note()
        return outcome

    def _note(self) -> None:
        values = self._watch.read(self._made)
        terms = self._made.get_info()["reward_terms"] if self.actions else dict.fromkeys(self._terms, 0.0)
        self._rows.append([*(number for name in _kept(self._watch).values() for number in values[name]), *terms.values()])

    @property
    def _terms(self) -> list[str]:
        return [term.name for term in self._watch.program.agent.reward]

    @property
    def values(self) -> Array:
        """Of shape (moments, columns)."""
        return np.array(self._rows, float)


def _recorded(run: Run, here: World, model: ModelName, seed: int, episodes: int, permissions: Permissions) -> list[_Recorded]:
    from deepbots_cli.learning.evaluation import load_model
    from deepbots_cli.learning.sb3.algorithms import torch_settings

    found = []
    with torch_settings(), closing(_Recorder(here, permissions)) as world:
        driver = PolicyDriver(load_model(run, model, world), world, deterministic=True)
        for number in range(episodes):
            start = Start.of_evaluation(seed, number)
            for _ in islice(steps(world, driver, start), MAX_STEPS + 1):
                pass
            found.append(_Recorded(start, world.actions, world.values))
    return found


def _repeated(world: World, recorded: Sequence[_Recorded], permissions: Permissions) -> list[Array]:
    """The values of each episode with its start and actions in a world."""
    with closing(_Recorder(world, permissions)) as made:
        return _repeated_in(made, recorded)


def _repeated_in(made: _Recorder, recorded: Sequence[_Recorded], act: Act = lambda action: action) -> list[Array]:
    """The same in a world that exists; `act` changes the actions."""
    values = []
    for episode in recorded:
        driver = sequence_driver([act(action) for action in episode.actions])
        with suppress(EvaluationError):  # an ending is true at the reset
            for _ in islice(steps(made, driver, episode.start), len(episode.actions) + 1):
                pass
        values.append(made.values)
    return values


class _Comparison:
    """The values of episodes in two worlds, up to the end of the shorter one of each pair.

    `width` is the width that each column spans; by default that in these episodes of the first world.
    """

    def __init__(
        self, columns: Sequence[_Column], recorded: Sequence[_Recorded], found: Sequence[Array], width: Array | None = None
    ) -> None:
        self._columns, self._recorded = columns, recorded
        self._here = [episode.values for episode in recorded]
        self._there = [*found]
        self._width = np.maximum(np.ptp(np.vstack(self._here), axis=0), 1e-9) if width is None else width
        self._numbers = [place for place, column in enumerate(columns) if not column.name.startswith(_REWARD)]
        self._base = self._errors(self._here)
        self._early = [self._small_until(*pair) for pair in zip(self._here, self._there, strict=True)]

    def _small_until(self, mine: Array, other: Array) -> int:
        """The moments before the differences have grown, and a few more."""
        length = min(len(mine), len(other))
        large = (np.abs(mine[:length] - other[:length]) > _GROWN * self._width).any(axis=1)
        return min(length, (int(np.argmax(large)) if large.any() else length) + _FEW)

    def _errors(self, values: Sequence[Array], until: Sequence[int] | None = None) -> Array:
        """The mean squared difference of each column from the other world, in squared widths; 1 at most, since errors grow without end.

        `until` is the number of moments of each episode; by default all that both worlds have.
        """
        squares = []
        for mine, other, usual, most in zip(values, self._there, self._here, until or [MAX_STEPS + 1] * len(self._here), strict=True):
            length = min(len(usual), len(other), most)
            both = min(length, len(mine))
            squares.append(np.minimum(((mine[:both] - other[:both]) / self._width) ** 2, 1.0))
            squares.append(np.ones((length - both, len(self._width))))  # an episode that ended too early
        return np.asarray(np.mean(np.vstack(squares), axis=0), float)

    def explained(self, values: Sequence[Array]) -> float:
        """The share of the squared differences of the observation that another world does not have; below 0 if it has larger ones.

        It is the mean of two shares: of all moments, and of those before the differences have grown. In these, the difference is nearly
        linear in the change, so a mass that is too small shows as well as the right one.
        """
        shares = []
        for until in (None, self._early):
            base, left = (self._errors(each, until)[self._numbers].sum() for each in (self._here, values))
            shares.append(1.0 - left / base if base else 0.0)
        return float(np.mean(shares))

    def part(self, episodes: int, steps: int) -> _Comparison:
        """The comparison of a few episodes, those with the largest differences, until these have grown, and of a few steps."""
        apart = [np.square((mine[:early] - other[:early]) / self._width)[:, self._numbers].mean() for mine, other, early in self._pairs()]
        chosen = sorted(sorted(range(len(apart)), key=lambda number: -apart[number])[:episodes])
        recorded, found = [], []
        for number in chosen:
            length = min(self._early[number], steps + 1)
            start, actions, values = self._recorded[number]
            recorded.append(_Recorded(start, actions[: length - 1], values[:length]))
            found.append(self._there[number][:length])
        return _Comparison(self._columns, recorded, found, self._width)

    def _pairs(self) -> Iterator[tuple[Array, Array, int]]:
        """The values of each episode in both worlds, and the moments before the differences have grown."""
        yield from zip(self._here, self._there, self._early, strict=True)

    def tried(self, change: _Change) -> list[Cause]:
        """How much a change explains; nothing if it is none of this scenario."""
        try:
            return [Cause(change.text, self.explained(change.simulate(self._recorded)))]
        except DeepbotsError:
            return []

    def differences(self) -> list[Difference]:
        found = []
        for place, column in enumerate(self._columns):
            first: tuple[int, int] | None = None
            for number, (mine, other) in enumerate(zip(self._here, self._there, strict=True)):
                length = min(len(mine), len(other))
                off = np.flatnonzero(np.abs(mine[:length, place] - other[:length, place]) > _THRESHOLD * self._width[place])
                if len(off) and (first is None or off[0] < first[1]):
                    first = number, int(off[0])
            if first is not None:
                here, there = (float(values[first[0]][first[1], place]) for values in (self._here, self._there))
                found.append(Difference(column.name, column.unit, *first, here, there, float(np.sqrt(self._base[place]))))
        return sorted(found, key=lambda each: (each.step, -each.share))

    def measured_causes(self) -> Iterator[Cause]:
        """Errors of measured numbers: all that are exact, together, since each explains only its own number."""
        texts: list[str] = []
        late: dict[int, list[str]] = {}
        fixed = [values.copy() for values in self._here]
        for place in self._numbers:
            best = self._exact(place) if self._base[place] > _THRESHOLD**2 else None
            if best is None:
                continue
            text, age, replaced = best
            for values, column in zip(fixed, replaced, strict=True):
                values[:, place] = column
            if age:
                late.setdefault(age, []).append(self._columns[place].name)
            else:
                texts.append(text)
        texts += [
            f"{listed(names)} {'is' if len(names) == 1 else 'are'} {age} step{'s' if age > 1 else ''} late" for age, names in late.items()
        ]
        if texts:
            yield Cause("; ".join(texts), self.explained(fixed))

    def _exact(self, place: int) -> tuple[str, int, list[Array]] | None:
        """The change of a number after which hardly a difference is left: in words, its age in steps, and the number."""
        column, mine = self._columns[place], [values[:, place] for values in self._here]
        pairs = [(a[: min(len(a), len(b))], b[: min(len(a), len(b)), place]) for a, b in zip(mine, self._there, strict=True)]
        x, y = np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])
        tried: list[tuple[str, int, list[Array]]] = []
        if x @ x > 0.0:
            factor = float(x @ y / (x @ x))
            known = next((words for value, words in _UNITS.items() if abs(factor / value - 1.0) < 0.02), None)
            words = "has the other sign" if abs(factor + 1.0) < 0.02 else f"is {known}" if known else f"is multiplied by {factor:.3g}"
            tried.append((f"{column.name} {words}", 0, [factor * values for values in mine]))
            offset = float(np.mean(y - x))
            tried.append(
                (f"{column.name} is larger by {offset:.3g}{column.unit and ' ' + column.unit}", 0, [values + offset for values in mine])
            )
        for other in self._numbers:
            if other != place and self._columns[other].unit == column.unit:
                tried.append(
                    (f"{column.name} has the value of {self._columns[other].name}", 0, [values[:, other] for values in self._here])
                )
        for age in range(1, _LATEST + 1):
            tried.append(("", age, [np.concatenate([values[:1].repeat(age), values[:-age]])[: len(values)] for values in mine]))
        scored = [(self._left(place, replaced), number) for number, (_, _, replaced) in enumerate(tried)]
        left, number = min(scored, default=(inf, 0))
        return tried[number] if left <= _EXACT * self._base[place] else None

    def _left(self, place: int, replaced: Sequence[Array]) -> float:
        squares = []
        for mine, other in zip(replaced, self._there, strict=True):
            length = min(len(mine), len(other))
            squares.append(np.minimum(((mine[:length] - other[:length, place]) / self._width[place]) ** 2, 1.0))
        return float(np.mean(np.concatenate(squares)))


# Changes of the first world

Simulation = Callable[[Sequence[_Recorded]], list[Array]]


class _Change(NamedTuple):
    """A change of the first world: in words, and what simulates episodes with it."""

    text: str
    simulate: Simulation


def _changes(here: World, unchanged: _Recorder, document: Document, permissions: Permissions) -> Iterator[list[_Change]]:
    """What may be different in a world: kinds of changes, each by the amount of the change. `unchanged` is `here`, for other actions."""

    def of(change: Change) -> Simulation:
        return lambda recorded: _repeated(World(changed_scenario(document, change).program, here.engine), recorded, permissions)

    def with_actions(act: Act) -> Simulation:
        return lambda recorded: _repeated_in(unchanged, recorded, act)

    for kind in _actions(here.program):
        yield [_Change(text, with_actions(act)) for text, act in kind]
    root, program = document.root, here.program
    assert isinstance(root, MappingNode)
    for plan in (
        *(plan for plan in plans(root, program) if not plan.name.startswith("mass of ")),
        *masses(root, program, _MAX_LINKS),
        *_frictions(root, program),
        *_latencies(root, program),
        *_commands(root, program),
    ):
        if plan.name not in ("message loss", "observation noise"):
            for levels in plan.sides.values():
                yield [_Change(f"{plan.name} {label}", of(change)) for label, change in levels]


def _frictions(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Another friction of each object that can move."""

    def of(name: str) -> Callable[[float], Change]:
        return lambda factor: {"objects": {name: friction(root, ("objects", name), factor)}}

    for name in (body.name for body in program.world.objects if not body.fixed and body.name in entries_at(root, "objects")):
        yield Plan.of_factors(f"friction of {name}", of(name))


def _latencies(root: MappingNode, program: Program) -> Iterator[Plan]:
    """A larger latency of each sensor."""
    for robot in program.robots:
        for sensor in entries_at(root, "robots", robot.name, "sensors"):
            path = ("robots", robot.name, "sensors", sensor, "latency")
            yield _later(root, program, f"latency of the sensor {robot.name}.{sensor}", [path])


def _commands(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Another gain of the command of each actuator, and a larger time constant; also of all together."""
    places = [(robot.name, name) for robot in program.robots for name in entries_at(root, "robots", robot.name, "actuators")]
    chosen = {f"{robot}.{name}": [(robot, name)] for robot, name in places[:_MAX_MOTORS]}
    if len(places) > 1:
        chosen["all actuators"] = places
    for words, actuators in chosen.items():
        written_commands = {("robots", robot, "apply", name): written(root, "robots", robot, "apply", name) for robot, name in actuators}
        commands = {path: command for path, command in written_commands.items() if command}
        if commands:
            sides = {
                side: [
                    (f"x {factor:g}", _together({path: f"{factor:g} * ({command})" for path, command in commands.items()}))
                    for factor in factors
                ]
                for side, factors in _GAINS.items()
            }
            yield Plan(f"command of {words}", sides)
        paths = [("robots", robot, "actuators", name, "time_constant") for robot, name in actuators]
        yield _later(root, program, f"time constant of {words}", paths)


def _later(root: MappingNode, program: Program, name: str, paths: Sequence[tuple[str, ...]]) -> Plan:
    """Times that are longer by 1, 2 and 4 timesteps."""
    owns = {path: written(root, *path) for path in paths}
    levels = []
    for count in (1, 2, 4):
        delay = f"{1000 * program.world.timestep * count:g} ms"
        levels.append((f"+{delay}", _together({path: delay + (f" + {own}" if own else "") for path, own in owns.items()})))
    return Plan.one_way(name, levels)


def _together(values: Mapping[tuple[str, ...], str]) -> Change:
    """A change of the values at several paths."""
    change: Change = {}
    for path, value in values.items():
        section = change
        for key in path[:-1]:
            section = section.setdefault(key, {})
        section[path[-1]] = value
    return change


def _actions(program: Program) -> Iterator[list[tuple[str, Act]]]:
    """Actions with another sign, order or gain: of ranges, or of the options of one choice."""
    names, choices = program.agent.range_names, program.agent.choices
    if len(choices) == 1 and not names:
        options = choices[0].options
        for one, other in combinations(range(len(options)), 2):
            yield [(f"the options {options[one].name} and {options[other].name} are swapped", _swapped_options(one, other))]
    if choices or not names:
        return
    for place, name in enumerate(names):
        yield [(f"the action {name} has the other sign", _negated(np.where(np.arange(len(names)) == place, -1.0, 1.0)))]
    is_few = len(names) <= _MAX_MOTORS
    for one, other in combinations(range(len(names)), 2) if is_few else ():
        places = np.arange(len(names))
        places[[one, other]] = other, one
        yield [(f"the actions {names[one]} and {names[other]} are swapped", _ordered(places))]
    # The value of an action is its middle plus a share of its half width, so a gain also moves the share where the middle is not 0.
    middles = np.array([(part.high + part.low) / (part.high - part.low) for part in program.agent.ranges for _ in part.names])
    scaled = {part.name: [name in part.names for name in names] for part in program.agent.ranges}
    if is_few:
        scaled |= {name: [name == other for other in names] for name in names}
    for name, chosen in scaled.items():
        for factors in _GAINS.values():
            yield [(f"the action {name} x {factor:g}", _scaled(np.where(chosen, factor, 1.0), middles)) for factor in factors]


def _swapped_options(one: int, other: int) -> Callable[[Any], Any]:
    return lambda action: {one: other, other: one}.get(int(action), action)


def _negated(signs: Array) -> Callable[[Any], Any]:
    return lambda action: np.asarray(action * signs, action.dtype)


def _scaled(factors: Array, middles: Array) -> Callable[[Any], Any]:
    return lambda action: np.asarray(np.clip(factors * action + (factors - 1.0) * middles, -1.0, 1.0), action.dtype)


def _ordered(places: Any) -> Callable[[Any], Any]:
    return lambda action: action[places]


# The gate


class Gate(NamedTuple):
    """A requirement, and whether it is met."""

    text: str
    met: bool


@dataclass(frozen=True)
class Transfer:
    """A policy in two worlds.

    Attributes:
        run: The run directory.
        names: The names of the two worlds.
        here: The evaluation in the world of the training.
        there: The evaluation in the other one, with the same starts.
        comparison: What differs between the worlds.
        robustness: The policy under changed conditions; None if they were left out.
        gates: The requirements; empty if no success rate is required.
        works: Whether the policy works in each of the two worlds: it meets the requirements, or else `solved` of the scenario. None where
            neither is given.
        required: What working means, in words; empty where nothing is given.
    """

    run: Path
    names: tuple[str, str]
    here: EvaluationResult
    there: EvaluationResult
    comparison: WorldComparison
    robustness: Robustness | None
    gates: tuple[Gate, ...]
    works: tuple[bool | None, bool | None]
    required: str

    @property
    def passed(self) -> bool:
        return all(gate.met for gate in self.gates)


def transfer(
    run: Run,
    *,
    engine: str,
    model: ModelName = "best",
    scenario: Compiled | None = None,
    min_success: float | None = None,
    min_return: float | None = None,
    episodes: int = 50,
    max_steps: float = inf,
    with_conditions: bool = True,
    seed: int | None = None,
    permissions: Permissions = Permissions(),
    spread: Spread = ONE_BY_ONE,
    on_world: Callable[[int, int], object] | None = None,
) -> Transfer:
    """Evaluate a policy in the world of its training and in another one, and compare the worlds.

    Args:
        run: The run.
        engine: The engine of the other world.
        model: The name of the model.
        scenario: The scenario of the other world; by default that of the run.
        min_success: The success rate that the policy must reach in both worlds, and at the first level of each side of each condition.
        min_return: The same for the mean return.
        episodes: Episodes of each evaluation.
        max_steps: The evaluation in the world of the training ends after this number of steps, but not before 8 episodes, and the other
            one has as many episodes. Fewer episodes are compared, too.
        with_conditions: Whether the policy is also evaluated under changed conditions.
        seed: Root seed of the starts; by default that of the training.
        spread: Where the evaluations under changed conditions run.
        on_world: Called with the number of worlds done, and of all.

    Raises:
        RunError: The run holds no model, or does not fit the scenario.
        UsageError: The scenario has copies of a robot.
    """
    base = Source.kept(run.path, permissions)
    known = api.compile(base.checked())
    root = run.record.seed if seed is None else seed
    given: dict[str, Any] = {"seed": root, "model": model, "permissions": permissions}

    def is_enough(done: Sequence[Episode]) -> bool:
        return len(done) >= MIN_EPISODES and sum(episode.length for episode in done) >= max_steps

    here = evaluate(run, episodes=episodes, until=is_enough, **given)
    given["episodes"] = here.episodes
    there = evaluate(run, scenario=scenario, engine=engine, **given)
    program = known.program if scenario is None else scenario.program
    worlds = World(known.program, run.record.engine), World(program, engine)
    watch = on_world or (lambda done, planned: None)
    comparison = compare_worlds(
        run,
        *worlds,
        base_document(base),
        seed=root,
        model=model,
        episodes=EPISODES if max_steps == inf else QUICK_EPISODES,
        permissions=permissions,
        on_world=watch,
    )
    robustness = None
    if with_conditions:
        robustness = evaluate_robustness(run, min_success=min_success, min_return=min_return, on_level=on_world, spread=spread, **given)
    names = run.record.engine, engine
    if scenario is not None:
        names = run.program.name, f"{program.name}{', changed' if scenario.overrides else ''} ({engine})"
    conditions = robustness.conditions if robustness is not None else ()
    judged = [*zip(names, (here, there), strict=True)]
    easiest = ((each.name, side.levels[0]) for each in conditions for side in each.sides if side.levels)
    judged += [(f"{name} {level.level}", level.evaluation) for name, level in easiest]
    gates = []
    for name, result in judged:
        if min_success is not None:
            met = result.success_rate >= min_success
            gates.append(Gate(f"{name}: success rate {result.success_rate:.0%} of at least {min_success:.0%}", met))
        if min_return is not None:
            met = result.mean_return >= min_return
            gates.append(Gate(f"{name}: mean return {result.mean_return:.4g} of at least {min_return:g}", met))
    works, required = _works(names, (here, there), gates, known.program.agent.solved)
    return Transfer(run.path, names, here, there, comparison, robustness, tuple(gates), works, required)


def _works(
    names: tuple[str, str], results: tuple[EvaluationResult, EvaluationResult], gates: Sequence[Gate], solved: Solved | None
) -> tuple[tuple[bool | None, bool | None], str]:
    """Whether the policy works in each of two worlds, and what that means."""
    if gates:
        one, other = (all(gate.met for gate in gates if gate.text.startswith(f"{name}: ")) for name in names)
        return (one, other), "the given requirements"
    if solved is None:
        return (None, None), ""
    one, other = (meets_solved(solved, result.mean_return, result.success_rate) for result in results)
    return (one, other), f"`solved` of the scenario ({solved.description})"
