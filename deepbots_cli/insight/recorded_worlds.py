"""The values of episodes in two worlds, what differs between them, and changes of a world which may explain
that.

A world is recorded while the policy acts, or while it repeats the starts and actions of another one. The
values are those of the observation, in SI units, and the reward terms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from functools import partial
from itertools import combinations, islice
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import api
from deepbots_cli.document import MappingNode, Permissions
from deepbots_cli.document.nodes import entries_at
from deepbots_cli.errors import EvaluationError
from deepbots_cli.insight.trace import (
    Comparison,
    InstrumentedProgram,
    TraceRecorder,
    inner_comparisons,
    instrument_program,
    measure,
)
from deepbots_cli.learning.robustness import (
    DELAY,
    Change,
    Plan,
    delayed,
    friction,
    joined,
    movable_objects,
    scaled,
    written,
)
from deepbots_cli.learning.runs.run import ModelName, Run
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Thrust
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Start, steps
from deepbots_cli.rollout.drivers import sequence_driver
from deepbots_cli.rollout.policies import PolicyDriver
from deepbots_cli.words import counted, sentence_list, unit_text

_LONGEST = 0.35
"""The longest time that is tried, in s. Three times are always tried: those of 1, 2 and 4 timesteps. Further
ones are twice as long as the one before."""
_MAX_SINGLE = 12
"""The largest number of actuators, or of numbers of an action, that are changed one by one."""
Array = NDArray[np.float64]
Act = Callable[[Any], Any]
"""A function that changes an action."""


def doubled_times(timestep: float) -> tuple[float, ...]:
    """Return times in ms, from one timestep on; each is twice the previous one."""
    count = max(3, 1 + int(np.log2(_LONGEST / timestep)))
    return tuple(1000 * timestep * 2**power for power in range(count))


def friction_plans(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Yield, for each object that can move, a plan that multiplies its friction."""
    for name in movable_objects(root, program):
        yield Plan("friction", partial(_friction_of, root, name), subject=name)


def _friction_of(root: MappingNode, name: str, factor: float) -> Change:
    return {"objects": {name: friction(root, ("objects", name), factor)}}


def latency_plans(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Yield, for each sensor, a plan that adds to its latency."""
    for robot in program.robots:
        for sensor in entries_at(root, "robots", robot.name, "sensors"):
            path = ("robots", robot.name, "sensors", sensor, "latency")
            subject = f"the sensor {robot.name}.{sensor}"
            yield Plan("latency", partial(_later, root, [path]), form=DELAY, subject=subject)


def command_plans(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Yield, for each actuator and for all together, another gain of the command, a delay, and a larger time
    constant."""
    motors = [
        (robot.name, name)
        for robot in program.robots
        for name in entries_at(root, "robots", robot.name, "actuators")
    ]
    groups = {f"{robot}.{name}": [(robot, name)] for robot, name in motors[:_MAX_SINGLE]}
    if len(motors) > 1:
        groups["all actuators"] = motors
    for words, actuators in groups.items():
        apply_paths = [("robots", robot, "apply", name) for robot, name in actuators]
        if commands := [path for path in apply_paths if written(root, *path)]:
            yield Plan("command", partial(_scaled_texts, root, commands), subject=words)
        for key in ("time_constant", "delay"):
            paths = [("robots", robot, "actuators", name, key) for robot, name in actuators]
            yield Plan(key.replace("_", " "), partial(_later, root, paths), form=DELAY, subject=words)


def torque_limits(program: Program) -> Iterator[tuple[Plan, float]]:
    """Yield, for each motor, a plan that sets its limit of torque or force, and its largest present limit in
    N m or N."""
    models = {robot.name: robot.model for robot in program.world.robots}
    for robot in program.robots:
        for motor in robot.actuators:
            if isinstance(motor, Thrust) or not (limits := [limit for limit in motor.max_torque if limit]):
                continue
            path = ("robots", robot.name, "actuators", motor.name, "max_torque")
            form = "{:g} N" if models[robot.name].joint(motor.joints[0]).type == "prismatic" else "{:g} N*m"
            subject = f"{robot.name}.{motor.name}"
            plan = Plan("torque limit", partial(_limit, path, form), form=form, subject=subject)
            yield plan, max(limits)


def _limit(path: tuple[str, ...], form: str, limit: float) -> Change:
    return joined({path: form.format(limit)})


def _later(root: MappingNode, paths: Sequence[tuple[str, ...]], delay: float) -> Change:
    return joined({path: delayed(delay, written(root, *path)) for path in paths})


def _scaled_texts(root: MappingNode, paths: Sequence[tuple[str, ...]], factor: float) -> Change:
    """Return written values times a factor."""
    return joined({path: scaled(factor, written(root, *path) or "") for path in paths})


def changed_actions(program: Program) -> Iterator[tuple[str, Act]]:
    """Yield ranges with another sign or order, or options of one choice: the change in words, and
    a function that changes an action."""
    names, choices = program.agent.range_names, program.agent.choices
    if len(choices) == 1 and not names:
        options = choices[0].options
        for first, second in combinations(range(len(options)), 2):
            text = f"the options {options[first].name} and {options[second].name} are swapped"
            yield text, _swapped_options(first, second)
    if choices:
        return
    for name, is_part in _parts(program).items():
        yield (
            f"the action {name} has the other sign",
            _negated(np.where(is_part, -1.0, 1.0)),
        )
    for first, second in combinations(range(len(names)), 2) if len(names) <= _MAX_SINGLE else ():
        order = np.arange(len(names))
        order[[first, second]] = second, first
        yield (
            f"the actions {names[first]} and {names[second]} are swapped",
            _ordered(order),
        )


def action_gains(program: Program) -> Iterator[tuple[str, Callable[[float], Act]]]:
    """Yield, for each part of an action of ranges, its name and a function that returns the change of the
    action by a gain."""
    if program.agent.choices:
        return
    # The value of an action is its middle plus a share of its half width, so a gain also moves the share
    # where the middle is not 0.
    middles = np.array(
        [
            (interval.high + interval.low) / (interval.high - interval.low)
            for interval in program.agent.ranges
            for _ in interval.names
        ]
    )
    for name, is_part in _parts(program).items():
        yield f"the action {name}", partial(_scaled, is_part, middles)


def _parts(program: Program) -> dict[str, NDArray[np.bool_]]:
    """Return, by name, each range, and each component of a vector unless there are many, as a mask over the
    numbers of an action."""
    names = program.agent.range_names
    parts = {
        interval.name: np.array([name in interval.names for name in names])
        for interval in program.agent.ranges
    }
    components = {name: np.array([name == other for other in names]) for name in names}
    return parts | components if len(names) <= _MAX_SINGLE else parts


def without_amount(act: Act, _: float) -> Act:
    """Return the change of an action for any amount."""
    return act


def _swapped_options(first: int, second: int) -> Act:
    return lambda action: {first: second, second: first}.get(int(action), action)


def _negated(signs: Array) -> Act:
    return lambda action: np.asarray(action * signs, action.dtype)


def _scaled(is_part: NDArray[np.bool_], middles: Array, factor: float) -> Act:
    factors = np.where(is_part, factor, 1.0)
    return lambda action: np.asarray(
        np.clip(factors * action + (factors - 1.0) * middles, -1.0, 1.0), action.dtype
    )


def _ordered(order: Any) -> Act:
    return lambda action: action[order]


EPISODES, MAX_STEPS = 6, 100
"""The number of compared episodes, and the largest number of steps of each if all end alike. A small
difference grows, so later steps say nothing more about its cause."""
_THRESHOLD = 0.01
"""Two values of a number differ if they are further apart than this share of the width that the number spans
in the first world."""
_MAX_AGE = 8
"""The largest age of a number, in steps, that is tried."""
_MAX_UNEXPLAINED = 0.05
"""Another order, sign, unit or age explains the difference of a number if at most this share of its square
remains."""
_PROBED_EPISODES, _PROBED_STEPS, _LEAST_STEPS = 2, 50, 15
"""Most changes are simulated only in this number of episodes, those with the largest differences. Each has at
most the second and at least the third number of steps."""
_GROWN, _FEW = 0.1, 5
"""The share of the width from which a difference has grown, and the number of further moments that are
counted as early ones."""
_MAX_SAME_SHARE = 1e-3
"""The share of the squared difference of an effect, and of the two worlds, below which two changes have the
same effect."""
REWARD = "reward."
"""The prefix of the name of a reward term."""
CONDITION = "share of steps with "
"""The prefix of the name of a condition of a success."""
_UNITS = {
    57.29577951308232: "in degrees instead of radians",
    0.017453292519943295: "in radians instead of degrees",
    1000.0: "in thousandths of its unit",
    100.0: "in hundredths of its unit",
    0.001: "in thousands of its unit",
    0.01: "in hundreds of its unit",
}


class EngineWorld(NamedTuple):
    """A scenario and the engine in which it runs. `columns` are the values that are kept of it; by default
    all. `recorder` is the world itself if it is built already."""

    program: Program
    engine: str | None
    permissions: Permissions = Permissions()
    columns: Sequence[ValueColumn] | None = None
    recorder: TraceRecorder | None = None

    def build(self) -> TraceRecorder:
        watch = instrument_program(self.program, include_observation=True)
        world = api.build(watch.program, engine=self.engine, permissions=self.permissions)
        return TraceRecorder(world, watch)


@dataclass(frozen=True)
class Difference:
    """A number of the observation, or a reward term, that differs.

    Attributes:
        name: Its name; that of a reward term begins with `reward.`.
        unit: Its unit; empty for a number without one.
        episode: The episode in which it differs first.
        step: The first step of this episode in which it differs; 0 is the reset.
        here: The value in the first world, in SI units.
        there: The value in the other one.
        share: The root mean square of its differences, as a share of the width that it spans in the first
            world.
    """

    name: str
    unit: str
    episode: int
    step: int
    here: float
    there: float
    share: float


class RecordedEpisode(NamedTuple):
    """An episode: its start, its actions, and its values, an array of the shape (moments, columns)."""

    start: Start
    actions: Sequence[Any]
    values: Array
    is_success: bool = False


class ValueColumn(NamedTuple):
    """A number of the observation, or a reward term, with its unit."""

    name: str
    unit: str


def columns_of(watch: InstrumentedProgram) -> list[ValueColumn]:
    """Return the columns of the values of a world that keeps its endings and observations."""
    signals = _kept_signals(watch)
    return [
        *(
            ValueColumn(number.full_name, unit_text(number.unit))
            for number in watch.program.agent.numbers
            if number.name in signals
        ),
        *(ValueColumn(f"{REWARD}{term.name}", "") for term in watch.program.agent.reward),
        *(ValueColumn(f"{CONDITION}{leaf.text}", "") for leaf in _success_conditions(watch)),
    ]


def _success_conditions(watch: InstrumentedProgram) -> list[Comparison]:
    """Return the comparisons of the successes, each text once."""
    conditions = (watch.conditions.get(name) for name in (*watch.program.agent.success, "goal_reached"))
    leaves = [
        leaf for condition in conditions if condition is not None for leaf in inner_comparisons(condition)
    ]
    return [*{leaf.text: leaf for leaf in leaves}.values()]


def _kept_signals(watch: InstrumentedProgram) -> dict[str, str]:
    """Return the kept value of each entry of the observation, without the previous action, which does not
    describe a world."""
    return {name: signal for name, signal in watch.observed_signals.items() if name != "previous_action"}


def _values(recorder: TraceRecorder, columns: Sequence[ValueColumn] | None) -> Array:
    """Return columns of an episode that was recorded: the observation in SI units, the reward terms, and the
    conditions of the successes (1 or 0), of shape (moments, columns)."""
    watch = recorder.instrumented
    own, signals, conditions = columns_of(watch), _kept_signals(watch).values(), _success_conditions(watch)
    rows = [
        [
            *(number for name in signals for number in values[name]),
            *terms.values(),
            *(float(measure(leaf, values).holds) for leaf in conditions),
        ]
        for values, terms in recorder.moments()
    ]
    return np.array(rows, float)[:, [own.index(column) for column in columns or own]]


@dataclass
class ChangeEffect:
    """Changes with the same effect, the values of all episodes with one of them, and the world with it and
    the change of the actions in it; None for a change of measured numbers only."""

    texts: list[str]
    values: list[Array]
    world: Callable[[], tuple[EngineWorld, Act | None]] | None = None


@contextmanager
def _opened(world: EngineWorld, act: Act | None) -> Iterator[TraceRecorder]:
    """Yield the recorder of a world, in which `act` changes the actions, and close it if it is built here."""
    with nullcontext(world.recorder) if world.recorder else closing(world.build()) as recorder:
        recorder.act = act or (lambda action: action)
        yield recorder


def record_episodes(
    run: Run,
    world: EngineWorld,
    model: ModelName,
    starts: Iterable[Start],
    *,
    act: Act | None = None,
    max_steps: int | None = None,
) -> list[RecordedEpisode]:
    """Return episodes of the policy of a run in a world, of at most `max_steps` steps."""
    from deepbots_cli.learning.policy import load_model
    from deepbots_cli.learning.sb3.algorithms import torch_settings

    recorded = []
    with torch_settings(), _opened(world, act) as recorder:
        driver = PolicyDriver(load_model(run, model, recorder), recorder, deterministic=True)
        for start in starts:
            *_, step = islice(steps(recorder, driver, start), None if max_steps is None else max_steps + 1)
            is_success = bool(step.info.get("is_success"))
            values = _values(recorder, world.columns)
            recorded.append(RecordedEpisode(start, recorder.actions, values, is_success))
    return recorded


def repeat_episodes(
    world: EngineWorld, recorded: Sequence[RecordedEpisode], act: Act | None = None
) -> list[Array]:
    """Return the values of each episode with its start and actions in a world; `act` changes the actions."""
    values = []
    with _opened(world, act) as recorder:
        for episode in recorded:
            again = steps(recorder, sequence_driver(episode.actions), episode.start)
            with suppress(EvaluationError):  # an ending is true at the reset
                for _ in islice(again, len(episode.actions) + 1):
                    pass
            values.append(_values(recorder, world.columns))
    return values


class ValueComparison:
    """The values of episodes in two worlds, up to the end of the shorter one of each pair.

    Attributes:
        recorded: The episodes of the first world.

    Args:
        width: The width that each column spans; by default that in these episodes of the first world.
    """

    def __init__(
        self,
        columns: Sequence[ValueColumn],
        recorded: Sequence[RecordedEpisode],
        repeated: Sequence[Array],
        width: Array | None = None,
    ) -> None:
        self._columns, self.recorded = columns, recorded
        self._first = [episode.values for episode in recorded]
        self._second = [*repeated]
        # A number that never changes has no width to divide by.
        self._width = np.maximum(np.ptp(np.vstack(self._first), axis=0), 1e-9) if width is None else width
        self._numbers = [
            index for index, column in enumerate(columns) if not column.name.startswith((REWARD, CONDITION))
        ]
        self._base = self._errors(self._first)
        self._early = [self._small_until(*pair) for pair in zip(self._first, self._second, strict=True)]

    def _small_until(self, first: Array, second: Array) -> int:
        """Return the number of moments before the differences have grown, and a few more."""
        length = min(len(first), len(second))
        large = (np.abs(first[:length] - second[:length]) > _GROWN * self._width).any(axis=1)
        return min(length, (int(np.argmax(large)) if large.any() else length) + _FEW)

    def _errors(self, values: Sequence[Array], until: Sequence[int] | None = None) -> Array:
        """Return the mean squared difference of each column from the other world, as `_squares` has it.

        `until` is the number of moments of each episode; by default all that both worlds have.
        """
        squares = []
        for candidate, second, usual, most in zip(
            values, self._second, self._first, until or map(len, self._first), strict=True
        ):
            length = min(len(usual), len(second), most)
            count = min(length, len(candidate))
            squares.append(self._squares(candidate[:length], second[:length]))
            squares.append(np.ones((length - count, len(self._width))))  # an episode that ended too early
        return np.asarray(np.mean(np.vstack(squares), axis=0), float)

    def explained(self, values: Sequence[Array]) -> float:
        """Return the share of the squared differences of the observation that another world does not have;
        below 0 if it has larger ones.

        It is the mean of two shares: of all moments, and of those before the differences have grown. In
        these, the difference is nearly linear in the change, so a mass that is too small shows as well as the
        right one.
        """
        shares = []
        for until in (None, self._early):
            base, left = (
                self._errors(world_values, until)[self._numbers].sum()
                for world_values in (self._first, values)
            )
            shares.append(1.0 - left / base if base else 0.0)
        return float(np.mean(shares))

    def likeness(self, values: Sequence[Array]) -> float:
        """Return the share of the difference that the change would explain with another amount if its effect
        grew in proportion: the squared cosine.

        It is 0 if the effect has the other direction.
        """
        effect, difference = (
            np.vstack([*map(self._clipped_difference, self._first, world)])
            for world in (values, self._second)
        )
        along = float((effect * difference).sum())
        size = float((effect**2).sum() * (difference**2).sum())
        return along**2 / size if along > 0.0 else 0.0

    def all_same(self, effects: Sequence[Sequence[Array]], others: Sequence[Sequence[Array]]) -> bool:
        """Return whether worlds have the same values, apart from differences that are small beside their
        effects and beside the difference."""
        if len(effects) != len(others):
            return False
        size = sum(
            min(
                self._squared_distance(self._first, values), self._squared_distance(self._first, self._second)
            )
            for values in effects
        )
        return sum(map(self._squared_distance, effects, others)) <= _MAX_SAME_SHARE * size

    def _squared_distance(self, first: Sequence[Array], second: Sequence[Array]) -> float:
        return sum(float(np.square(off).sum()) for off in map(self._clipped_difference, first, second))

    def _clipped_difference(self, first: Array, second: Array) -> Array:
        """Return the difference of the numbers of an episode in widths, 1 at most, and 0 where one of both
        worlds has ended."""
        count = min(len(first), len(second))
        off = np.clip((second[:count] - first[:count]) / self._width, -1.0, 1.0)[:, self._numbers]
        return np.pad(off, ((0, max(len(first), len(second)) - count), (0, 0)))

    def probed(self) -> ValueComparison:
        """Return the comparison of a few episodes, those with the largest differences, until these have
        grown, and of a few steps."""
        apart = [
            self._squares(first[:early], second[:early])[:, self._numbers].mean()
            for first, second, early in self._pairs()
        ]
        numbers = sorted(sorted(range(len(apart)), key=lambda number: -apart[number])[:_PROBED_EPISODES])
        recorded, repeated = [], []
        for number in numbers:
            start, actions, values, _ = self.recorded[number]
            repeated_values = self._second[number]
            length = min(len(values), len(repeated_values))
            apart_numbers = np.abs(values[:length] - repeated_values[:length])[:, self._numbers]
            begin = np.argmax((apart_numbers > _THRESHOLD * self._width[self._numbers]).any(axis=1))
            length = min(max(self._early[number], _LEAST_STEPS + 1), int(begin) + _PROBED_STEPS + 1)
            recorded.append(RecordedEpisode(start, actions[: length - 1], values[:length]))
            repeated.append(self._second[number][:length])
        return ValueComparison(self._columns, recorded, repeated, self._width)

    def _pairs(self) -> Iterator[tuple[Array, Array, int]]:
        """Yield the values of each episode in both worlds, and the moments before the differences have
        grown."""
        yield from zip(self._first, self._second, self._early, strict=True)

    def differences(self) -> list[Difference]:
        """Return the columns that differ, in the order in which they begin to."""
        rows = []
        for index, column in enumerate(self._columns):
            if column.name.startswith(CONDITION):
                continue
            first: tuple[int, int] | None = None
            for number, (first_values, second_values) in enumerate(
                zip(self._first, self._second, strict=True)
            ):
                length = min(len(first_values), len(second_values))
                moments = np.flatnonzero(
                    np.abs(first_values[:length, index] - second_values[:length, index])
                    > _THRESHOLD * self._width[index]
                )
                if len(moments) and (first is None or moments[0] < first[1]):
                    first = number, int(moments[0])
            if first is not None:
                first_value, second_value = (
                    float(values[first[0]][first[1], index]) for values in (self._first, self._second)
                )
                rows.append(
                    Difference(
                        column.name,
                        column.unit,
                        *first,
                        first_value,
                        second_value,
                        float(np.sqrt(self._base[index])),
                    )
                )
        return sorted(rows, key=lambda row: (row.step, -row.share))

    def measured_causes(self) -> Iterator[ChangeEffect]:
        """Yield errors of measured numbers: all that are exact, together, since each explains only its own
        number."""
        texts: list[str] = []
        late: dict[int, list[str]] = {}
        fixed = [values.copy() for values in self._first]
        for index in self._numbers:
            best = self._exact(index) if self._base[index] > _THRESHOLD**2 else None
            if best is None:
                continue
            text, age, replaced = best
            for values, column in zip(fixed, replaced, strict=True):
                values[:, index] = column
            if age:
                late.setdefault(age, []).append(self._columns[index].name)
            else:
                texts.append(text)
        texts += [
            f"{sentence_list(names)} {'is' if len(names) == 1 else 'are'} {counted(age, 'step')} late"
            for age, names in late.items()
        ]
        if texts:
            yield ChangeEffect(["; ".join(texts)], fixed)

    def _exact(self, index: int) -> tuple[str, int, list[Array]] | None:
        """Return the change of a number that removes nearly all of its difference: the change in words, the
        age of the number in steps, and its changed values."""
        column, series = self._columns[index], [values[:, index] for values in self._first]
        pairs = [
            (a[: min(len(a), len(b))], b[: min(len(a), len(b)), index])
            for a, b in zip(series, self._second, strict=True)
        ]
        x, y = np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])
        tried: list[tuple[str, int, list[Array]]] = []
        if x @ x > 0.0:
            factor = float(x @ y / (x @ x))
            exact = next((words for value, words in _UNITS.items() if abs(factor / value - 1.0) < 0.02), None)
            if abs(factor + 1.0) < 0.02:
                words = "has the other sign"
            elif exact:
                words = f"is {exact}"
            else:
                words = f"is multiplied by {factor:.3g}"
            tried.append((f"{column.name} {words}", 0, [factor * values for values in series]))
        offset = float(np.mean(y - x))
        tried.append(
            (
                f"{column.name} is larger by {offset:.3g}{column.unit and ' ' + column.unit}",
                0,
                [values + offset for values in series],
            )
        )
        for other in self._numbers:
            if other != index and self._columns[other].unit == column.unit:
                tried.append(
                    (
                        f"{column.name} has the value of {self._columns[other].name}",
                        0,
                        [values[:, other] for values in self._first],
                    )
                )
        for age in range(1, _MAX_AGE + 1):
            tried.append(
                (
                    "",
                    age,
                    [
                        np.concatenate([values[:1].repeat(age), values[:-age]])[: len(values)]
                        for values in series
                    ],
                )
            )
        scored = [
            (self._remaining_error(index, replaced), number) for number, (_, _, replaced) in enumerate(tried)
        ]
        left, number = min(scored, default=(inf, 0))
        return tried[number] if left <= _MAX_UNEXPLAINED * self._base[index] else None

    def _remaining_error(self, index: int, replaced: Sequence[Array]) -> float:
        pairs = zip(replaced, self._second, strict=True)
        return float(
            np.mean(np.concatenate([self._squares(one, other[:, index], index) for one, other in pairs]))
        )

    def _squares(self, one: Array, other: Array, columns: int | slice = slice(None)) -> Array:
        """Return the squared differences of columns in the moments that both have, in squared widths; 1 at
        most, since errors grow without end."""
        count = min(len(one), len(other))
        squares: Array = ((one[:count] - other[:count]) / self._width[columns]) ** 2
        return np.minimum(squares, 1.0)
