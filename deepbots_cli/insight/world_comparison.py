"""The differences between two worlds of a scenario, such as two engines, or a simulation and one with another
mass, and their causes.

The policy plays some episodes in the world of its training, and the other world repeats their starts and
actions. The difference of each number of the observation and of each reward term then comes from the world,
not from other actions. `causes` are changes of the first world that make it more like the second one: another
order, sign, unit or age of a number, or another latency, mass, friction, strength, gain, lag or order of
motors. Changes of the physics are simulated, each with the same starts and actions.

Most kinds of changes explain nothing. Therefore the first round simulates a small, a medium and a large
amount of each kind, in two episodes, until the differences have grown. The second round simulates all amounts
of the likely kinds. The third round searches between the amounts of the best kinds. Finally, the best amount
of each kind is simulated in all episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from math import ceil, exp, floor, inf, log
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from scipy.optimize import minimize_scalar

from deepbots_cli import api
from deepbots_cli.document import Document, MappingNode, Permissions
from deepbots_cli.errors import DeepbotsError, EvaluationError, UsageError, counted
from deepbots_cli.insight.conditions import InstrumentedProgram, instrument_program
from deepbots_cli.insight.world_changes import (
    Act,
    Array,
    action_gains,
    always,
    changed_actions,
    command_plans,
    doubled_times,
    friction_plans,
    latency_plans,
    torque_limits,
)
from deepbots_cli.learning.robustness import (
    DELAY,
    FACTOR,
    MASS,
    Plan,
    changed_program,
    listed,
    masses,
    plans,
)
from deepbots_cli.learning.run import ModelName, Run
from deepbots_cli.program import Program
from deepbots_cli.rollout import Start, steps
from deepbots_cli.rollout.drivers import sequence_driver
from deepbots_cli.rollout.policies import PolicyDriver

EPISODES, MAX_STEPS = 6, 100
"""The number of compared episodes, and the largest number of steps of each: small differences grow, and late
steps only show that they have grown."""
_THRESHOLD = 0.01
"""The share of the width that a number spans in the first world by which it must be off to differ."""
_MEASURED = "order, sign, unit, offset and age of numbers"
"""The changes that are tried without a simulation."""
_LATEST = 8
"""The largest age of a number, in steps, that is tried."""
_EXACT = 0.05
"""The largest remaining share of the squared difference of a number that its order, sign, unit or age
explains."""
_LEAST_EXPLAINED = 0.3
"""The smallest share of the squared differences that a cause must explain."""
_PROBED_EPISODES, _PROBED_STEPS, _LEAST_STEPS = 2, 50, 15
"""The number of episodes in which most changes are simulated, those with the largest differences, and the
largest and smallest number of steps of each."""
_REFINED = 8
"""The number of kinds of changes that are simulated with all amounts in these episodes, and with the best one
in all episodes."""
_GROWN, _FEW = 0.1, 5
"""The share of the width from which a difference has grown, and the number of further moments that are
counted as early ones."""
_SEARCHED, _SEARCH_STEPS = 6, 7
"""The number of kinds whose amount is searched between the amounts beside the best one, and the number of
simulations of such a search."""
_EXPLAINS_ALL = 0.9995
"""The share from which no better amount is searched."""
_SAME = 1e-3
"""The share of the squared difference of an effect, and of the two worlds, below which two changes have the
same effect."""
_MAX_LINKS = 12
"""The largest number of links whose mass is changed."""
_REWARD = "reward."
"""The prefix of the name of a reward term."""
_MAX_JOINED = 3
"""The number of changes with the same effect that are named; more are counted."""
_UNITS = {
    57.29577951308232: "in degrees instead of radians",
    0.017453292519943295: "in radians instead of degrees",
    1000.0: "in thousandths of its unit",
    100.0: "in hundredths of its unit",
    0.001: "in thousands of its unit",
    0.01: "in hundreds of its unit",
}


class Difference(NamedTuple):
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


class Cause(NamedTuple):
    """A change of the first world that makes it more like the other one. `explained` is the share of the
    squared differences that it removes."""

    text: str
    explained: float


@dataclass(frozen=True)
class WorldComparison:
    """The result of a comparison: `differences` in the order in which they begin, `causes` from the one that
    explains most, and in words the kinds of changes `tried`.

    A cause explains numbers of the observation, so there is none if only reward terms differ.
    """

    episodes: int
    steps: int
    differences: tuple[Difference, ...]
    causes: tuple[Cause, ...]
    tried: tuple[str, ...] = ()

    @property
    def observation_differs(self) -> bool:
        return any(not each.name.startswith(_REWARD) for each in self.differences)


class World(NamedTuple):
    """A scenario and the engine in which it runs."""

    program: Program
    engine: str | None


class _Recorded(NamedTuple):
    """An episode: its start, its actions, and its values, an array of the shape (moments, columns)."""

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
        raise UsageError(
            f"{here.program.name} has copies of a robot, whose worlds cannot be compared step by step"
        )
    columns = _columns(instrument_program(here.program, include_observation=True))
    recorded = _recorded(run, here, model, seed, episodes, permissions)
    comparison = _Comparison(columns, recorded, _repeated(there, recorded, permissions))
    result = WorldComparison(
        len(recorded), max(len(each.actions) for each in recorded), tuple(comparison.differences()), ()
    )
    if not result.observation_differs:
        return result
    rows = [*comparison.measured_causes()]
    with closing(_Recorder(here, permissions)) as unchanged:
        kinds = [*_kinds(here, unchanged, document, permissions)]
        for row in _simulated_causes(comparison, kinds, on_world):
            same = next((other for other in rows if comparison.all_same([other.values], [row.values])), None)
            if same is None:
                rows.append(row)
            else:
                same.texts.extend(row.texts)
    causes = [Cause(_either(row.texts), comparison.explained(row.values)) for row in rows]
    likely = sorted(
        (cause for cause in causes if cause.explained >= _LEAST_EXPLAINED), key=lambda cause: -cause.explained
    )  # stable
    families = {kind.family: kind.tried for kind in reversed(kinds)}
    return replace(result, causes=tuple(likely), tried=(_MEASURED, *reversed(families.values())))


def _either(texts: Sequence[str]) -> str:
    more = len(texts) - _MAX_JOINED
    return " or ".join([*texts[:_MAX_JOINED], *([f"{more} more"] if more > 0 else [])])


class _Row(NamedTuple):
    """Changes with the same effect, and the values of all episodes with one of them."""

    texts: list[str]
    values: list[Array]


def _simulated_causes(
    comparison: _Comparison, kinds: Sequence[_Kind], on_world: Callable[[int, int], object]
) -> list[_Row]:
    """Return the changes that explain most of a few short episodes, with the share that they explain of
    all."""
    probe = comparison.part()
    scores: dict[tuple[_Kind, float], float] = {}

    def score(kind: _Kind, amount: float) -> float:
        if (kind, amount) not in scores:
            values = probe.simulated(kind, amount)
            scores[kind, amount] = -1.0 if values is None else max(probe.explained(values), -1.0)
        return scores[kind, amount]

    def best(kind: _Kind) -> float:
        return max(
            (amount for scored_kind, amount in scores if scored_kind is kind),
            key=lambda amount: (round(scores[kind, amount], 9), amount),
        )

    groups: list[_Group] = []
    for number, kind in enumerate(kinds):
        effects = [values for amount in kind.probes if (values := probe.simulated(kind, amount)) is not None]
        on_world(number + 1, len(kinds))
        likeness = max(
            (probe.likeness(values) if kind.form else probe.explained(values) for values in effects),
            default=0.0,
        )
        if likeness <= 0.0:
            continue
        same = next(
            (
                group
                for group in groups
                if group.kinds[0].probes == kind.probes and probe.all_same(group.effects, effects)
            ),
            None,
        )
        if same is None:
            groups.append(_Group([kind], effects, likeness))
        else:
            same.kinds.append(kind)
    likely = sorted(groups, key=lambda group: -group.likeness)[:_REFINED]
    for number, group in enumerate(likely):
        for amount in group.kinds[0].amounts:
            score(group.kinds[0], amount)
        on_world(number + 1, len(likely))
    likely.sort(key=lambda group: -scores[group.kinds[0], best(group.kinds[0])])
    for number, group in enumerate(likely[:_SEARCHED]):
        _search(group.kinds[0], best(group.kinds[0]), score)
        on_world(number + 1, len(likely[:_SEARCHED]))
    rows = []
    for number, group in enumerate(likely):
        amount = best(group.kinds[0])
        values = comparison.simulated(group.kinds[0], amount)
        if values is not None:
            rows.append(_Row([kind.text(amount) for kind in group.kinds], values))
        on_world(number + 1, len(likely))
    return rows


def _search(kind: _Kind, amount: float, score: Callable[[_Kind, float], float]) -> None:
    """Score amounts between the neighbors of an amount: on a logarithmic scale with two digits, and then one
    digit up and down.

    A latency of a part of a timestep has the effect of a whole one, so for a time, the next number of
    timesteps is scored too.
    """
    if len(kind.amounts) < 2 or score(kind, amount) >= _EXPLAINS_ALL:
        return
    scale = [kind.amounts[0] ** 2 / kind.amounts[1], *kind.amounts, kind.amounts[-1] ** 2 / kind.amounts[-2]]
    place = scale.index(amount)
    best = minimize_scalar(
        lambda x: -score(kind, float(f"{exp(x):.2g}")),
        bounds=(log(scale[place - 1]), log(scale[place + 1])),
        method="bounded",
        options={"maxiter": _SEARCH_STEPS, "xatol": 0.01},
    )
    digit = 10.0 ** (floor(best.x / log(10.0)) - 1)
    amount = float(f"{exp(best.x):.2g}")
    for step in (-digit, digit):
        while scale[place - 1] < (beside := float(f"{amount + step:.2g}")) < scale[place + 1] and score(
            kind, beside
        ) > score(kind, amount):
            amount = beside
    if kind.form == DELAY:
        timestep = kind.amounts[0]
        score(kind, timestep * ceil(exp(best.x) / timestep))


@dataclass
class _Group:
    """Kinds whose changes have the same effect, and the likeness of this effect to the difference, regardless
    of its amount."""

    kinds: list[_Kind]
    effects: list[list[Array]]
    likeness: float


class _Column(NamedTuple):
    name: str
    unit: str


def _columns(watch: InstrumentedProgram) -> list[_Column]:
    kept = _kept(watch)
    return [
        *(
            _Column(each.full_name, each.unit.removeprefix("1"))
            for each in watch.program.agent.numbers
            if each.name in kept
        ),
        *(_Column(f"{_REWARD}{term.name}", "") for term in watch.program.agent.reward),
    ]


def _kept(watch: InstrumentedProgram) -> dict[str, str]:
    """Return the kept value of each entry of the observation, without the previous action, which does not
    describe a world."""
    return {name: kept for name, kept in watch.observed_signals.items() if name != "previous_action"}


class _Recorder(gym.Wrapper[Any, Any, Any, Any]):
    """A world that records the actions of an episode, and its values: those of the observation in SI units,
    and the reward terms."""

    def __init__(self, world: World, permissions: Permissions) -> None:
        self._watch = instrument_program(world.program, include_observation=True)
        self._made = api.build(self._watch.program, engine=world.engine, permissions=permissions)
        super().__init__(self._made)
        self.actions: list[Any] = []
        self._rows: list[list[float]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        self.actions, self._rows = [], []
        try:
            outcome = self.env.reset(seed=seed, options=options)
        except EvaluationError:  # an ending is true already, such as by a wrong sensor
            self._note()
            raise
        self._note()
        return outcome

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        outcome = self.env.step(action)
        self.actions.append(action)
        self._note()
        return outcome

    def _note(self) -> None:
        values = self._watch.read(self._made)
        terms = self._made.get_info()["reward_terms"] if self.actions else dict.fromkeys(self._terms, 0.0)
        self._rows.append(
            [*(number for name in _kept(self._watch).values() for number in values[name]), *terms.values()]
        )

    @property
    def _terms(self) -> list[str]:
        return [term.name for term in self._watch.program.agent.reward]

    @property
    def values(self) -> Array:
        """The values, of shape (moments, columns)."""
        return np.array(self._rows, float)


def _recorded(
    run: Run, here: World, model: ModelName, seed: int, episodes: int, permissions: Permissions
) -> list[_Recorded]:
    from deepbots_cli.learning.evaluation import load_model
    from deepbots_cli.learning.sb3.algorithms import torch_settings

    episodes_recorded = []
    with torch_settings(), closing(_Recorder(here, permissions)) as world:
        driver = PolicyDriver(load_model(run, model, world), world, deterministic=True)
        for number in range(episodes):
            start = Start.of_evaluation(seed, number)
            for _ in islice(steps(world, driver, start), MAX_STEPS + 1):
                pass
            episodes_recorded.append(_Recorded(start, world.actions, world.values))
    return episodes_recorded


def _repeated(world: World, recorded: Sequence[_Recorded], permissions: Permissions) -> list[Array]:
    """Return the values of each episode with its start and actions in a world."""
    with closing(_Recorder(world, permissions)) as recorder:
        return _repeated_in(recorder, recorded)


def _repeated_in(
    recorder: _Recorder, recorded: Sequence[_Recorded], act: Act = lambda action: action
) -> list[Array]:
    """Return the values of each episode with its start and actions in a world that exists; `act` changes the
    actions."""
    values = []
    for episode in recorded:
        driver = sequence_driver([act(action) for action in episode.actions])
        with suppress(EvaluationError):  # an ending is true at the reset
            for _ in islice(steps(recorder, driver, episode.start), len(episode.actions) + 1):
                pass
        values.append(recorder.values)
    return values


class _Comparison:
    """The values of episodes in two worlds, up to the end of the shorter one of each pair.

    `width` is the width that each column spans; by default that in these episodes of the first world.
    """

    def __init__(
        self,
        columns: Sequence[_Column],
        recorded: Sequence[_Recorded],
        found: Sequence[Array],
        width: Array | None = None,
    ) -> None:
        self._columns, self._recorded = columns, recorded
        self._here = [episode.values for episode in recorded]
        self._there = [*found]
        self._width = np.maximum(np.ptp(np.vstack(self._here), axis=0), 1e-9) if width is None else width
        self._numbers = [place for place, column in enumerate(columns) if not column.name.startswith(_REWARD)]
        self._base = self._errors(self._here)
        self._early = [self._small_until(*pair) for pair in zip(self._here, self._there, strict=True)]

    def _small_until(self, mine: Array, other: Array) -> int:
        """Return the moments before the differences have grown, and a few more."""
        length = min(len(mine), len(other))
        large = (np.abs(mine[:length] - other[:length]) > _GROWN * self._width).any(axis=1)
        return min(length, (int(np.argmax(large)) if large.any() else length) + _FEW)

    def _errors(self, values: Sequence[Array], until: Sequence[int] | None = None) -> Array:
        """Return the mean squared difference of each column from the other world, in squared widths; 1 at
        most, since errors grow without end.

        `until` is the number of moments of each episode; by default all that both worlds have.
        """
        squares = []
        for mine, other, usual, most in zip(
            values, self._there, self._here, until or [MAX_STEPS + 1] * len(self._here), strict=True
        ):
            length = min(len(usual), len(other), most)
            both = min(length, len(mine))
            squares.append(np.minimum(((mine[:both] - other[:both]) / self._width) ** 2, 1.0))
            squares.append(np.ones((length - both, len(self._width))))  # an episode that ended too early
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
            base, left = (self._errors(each, until)[self._numbers].sum() for each in (self._here, values))
            shares.append(1.0 - left / base if base else 0.0)
        return float(np.mean(shares))

    def likeness(self, values: Sequence[Array]) -> float:
        """Return the share of the difference that the change would explain with another amount if its effect
        grew in proportion: the squared cosine.

        It is 0 if the effect has the other direction.
        """
        effect, difference = (
            np.vstack([*map(self._off, self._here, world)]) for world in (values, self._there)
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
            min(self._apart(self._here, values), self._apart(self._here, self._there)) for values in effects
        )
        return sum(map(self._apart, effects, others)) <= _SAME * size

    def _apart(self, one: Sequence[Array], other: Sequence[Array]) -> float:
        return sum(float(np.square(off).sum()) for off in map(self._off, one, other))

    def _off(self, mine: Array, other: Array) -> Array:
        """Return the difference of the numbers of an episode in widths, 1 at most, and 0 where one of both
        worlds has ended."""
        both = min(len(mine), len(other))
        off = np.clip((other[:both] - mine[:both]) / self._width, -1.0, 1.0)[:, self._numbers]
        return np.pad(off, ((0, max(len(mine), len(other)) - both), (0, 0)))

    def part(self) -> _Comparison:
        """Return the comparison of a few episodes, those with the largest differences, until these have
        grown, and of a few steps."""
        apart = [
            np.square((mine[:early] - other[:early]) / self._width)[:, self._numbers].mean()
            for mine, other, early in self._pairs()
        ]
        chosen = sorted(sorted(range(len(apart)), key=lambda number: -apart[number])[:_PROBED_EPISODES])
        recorded, repeated = [], []
        for number in chosen:
            length = min(max(self._early[number], _LEAST_STEPS + 1), _PROBED_STEPS + 1)
            start, actions, values = self._recorded[number]
            recorded.append(_Recorded(start, actions[: length - 1], values[:length]))
            repeated.append(self._there[number][:length])
        return _Comparison(self._columns, recorded, repeated, self._width)

    def _pairs(self) -> Iterator[tuple[Array, Array, int]]:
        """Yield the values of each episode in both worlds, and the moments before the differences have
        grown."""
        yield from zip(self._here, self._there, self._early, strict=True)

    def simulated(self, kind: _Kind, amount: float) -> list[Array] | None:
        """Return the values with a change; None if the change does not fit this scenario."""
        try:
            values = kind.simulate(amount, self._recorded)
        except DeepbotsError:
            return None
        return values if all(np.isfinite(each).all() for each in values) else None

    def differences(self) -> list[Difference]:
        rows = []
        for place, column in enumerate(self._columns):
            first: tuple[int, int] | None = None
            for number, (mine, other) in enumerate(zip(self._here, self._there, strict=True)):
                length = min(len(mine), len(other))
                off = np.flatnonzero(
                    np.abs(mine[:length, place] - other[:length, place]) > _THRESHOLD * self._width[place]
                )
                if len(off) and (first is None or off[0] < first[1]):
                    first = number, int(off[0])
            if first is not None:
                here, there = (
                    float(values[first[0]][first[1], place]) for values in (self._here, self._there)
                )
                rows.append(
                    Difference(
                        column.name, column.unit, *first, here, there, float(np.sqrt(self._base[place]))
                    )
                )
        return sorted(rows, key=lambda each: (each.step, -each.share))

    def measured_causes(self) -> Iterator[_Row]:
        """Yield errors of measured numbers: all that are exact, together, since each explains only its own
        number."""
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
            f"{listed(names)} {'is' if len(names) == 1 else 'are'} {counted(age, 'step')} late"
            for age, names in late.items()
        ]
        if texts:
            yield _Row(["; ".join(texts)], fixed)

    def _exact(self, place: int) -> tuple[str, int, list[Array]] | None:
        """Return the change of a number after which hardly a difference is left: in words, its age in steps,
        and the number."""
        column, mine = self._columns[place], [values[:, place] for values in self._here]
        pairs = [
            (a[: min(len(a), len(b))], b[: min(len(a), len(b)), place])
            for a, b in zip(mine, self._there, strict=True)
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
            tried.append((f"{column.name} {words}", 0, [factor * values for values in mine]))
            offset = float(np.mean(y - x))
            tried.append(
                (
                    f"{column.name} is larger by {offset:.3g}{column.unit and ' ' + column.unit}",
                    0,
                    [values + offset for values in mine],
                )
            )
        for other in self._numbers:
            if other != place and self._columns[other].unit == column.unit:
                tried.append(
                    (
                        f"{column.name} has the value of {self._columns[other].name}",
                        0,
                        [values[:, other] for values in self._here],
                    )
                )
        for age in range(1, _LATEST + 1):
            tried.append(
                (
                    "",
                    age,
                    [
                        np.concatenate([values[:1].repeat(age), values[:-age]])[: len(values)]
                        for values in mine
                    ],
                )
            )
        scored = [(self._left(place, replaced), number) for number, (_, _, replaced) in enumerate(tried)]
        left, number = min(scored, default=(inf, 0))
        return tried[number] if left <= _EXACT * self._base[place] else None

    def _left(self, place: int, replaced: Sequence[Array]) -> float:
        squares = []
        for mine, other in zip(replaced, self._there, strict=True):
            length = min(len(mine), len(other))
            squares.append(
                np.minimum(((mine[:length] - other[:length, place]) / self._width[place]) ** 2, 1.0)
            )
        return float(np.mean(np.concatenate(squares)))


# Changes of the first world

_FACTORS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.25, 0.5, 0.8, 1.25, 2.0, 4.0, 8.0)
"""Factors on a value. Motors are often much stronger than needed, so only a small share of their strength has
an effect."""
_PROBED_FACTORS = (0.003, 0.5, 2.0)
_MASS_FACTORS = tuple(factor for factor in _FACTORS if factor >= 0.1)
_PROBED_MASSES = (0.5, 2.0)


@dataclass(frozen=True, eq=False)
class _Kind:
    """A kind of change of the first world.

    Attributes:
        family: The kind in words without names.
        name: Its name, which an amount follows.
        simulate: Simulates episodes with an amount of it.
        amounts: The amounts that are tried, sorted.
        probes: The amounts that are simulated first.
        form: The format of an amount; empty if the change has none.
    """

    family: str
    name: str
    simulate: Callable[[float, Sequence[_Recorded]], list[Array]]
    amounts: tuple[float, ...] = (1.0,)
    probes: tuple[float, ...] = (1.0,)
    form: str = ""

    def text(self, amount: float) -> str:
        return f"{self.name} {self.form.format(amount)}".rstrip()

    @property
    def tried(self) -> str:
        """The family, and its amounts in words."""
        smallest, largest = self.form.format(self.amounts[0]), self.form.format(self.amounts[-1])
        return f"{self.family} ({smallest} .. {largest})" if self.form else self.family


def _kinds(
    here: World, unchanged: _Recorder, document: Document, permissions: Permissions
) -> Iterator[_Kind]:
    """Yield the kinds of changes that are possible in a world. `unchanged` is `here`, for other actions."""

    def with_actions(act: Callable[[float], Act]) -> Callable[[float, Sequence[_Recorded]], list[Array]]:
        return lambda amount, recorded: _repeated_in(unchanged, recorded, act(amount))

    def with_plan(plan: Plan) -> Callable[[float, Sequence[_Recorded]], list[Array]]:
        return lambda amount, recorded: _repeated(
            World(changed_program(document, plan.change(amount)), here.engine), recorded, permissions
        )

    for family, name, act in changed_actions(here.program):
        yield _Kind(family, name, with_actions(partial(always, act)))
    for name, scaled in action_gains(here.program):
        yield _Kind("gain of actions", name, with_actions(scaled), _MASS_FACTORS, _PROBED_MASSES, FACTOR)
    root, program = document.root, here.program
    assert isinstance(root, MappingNode)
    times = doubled_times(program.world.timestep)
    for plan in (
        *(plan for plan in plans(root, program) if plan.kind != MASS),
        *masses(root, program, _MAX_LINKS),
        *friction_plans(root, program),
        *latency_plans(root, program),
        *command_plans(root, program),
    ):
        if plan.form == DELAY:
            yield _Kind(
                plan.kind, plan.name, with_plan(plan), times, (times[len(times) // 3], times[-1]), DELAY
            )
        elif plan.form == FACTOR:
            amounts, probes = (
                (_MASS_FACTORS, _PROBED_MASSES) if plan.kind == MASS else (_FACTORS, _PROBED_FACTORS)
            )
            yield _Kind(plan.kind, plan.name, with_plan(plan), amounts, probes, FACTOR)
    for plan, largest in torque_limits(program):
        limits, first = (
            tuple(factor * largest for factor in each if factor < 1.0) for each in (_FACTORS, _PROBED_FACTORS)
        )
        yield _Kind(plan.kind, plan.name, with_plan(plan), limits, first, plan.form)
