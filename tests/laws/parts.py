"""Laws of what a step shows: each value is its function of its parts, by a second implementation.

Probes of the supervisor (`claims.py`) give the leaves: readings of the world, and values of names. What
expressions make of them is computed here from the typed trees and the text, with plain numbers.
"""

from __future__ import annotations

import copy
import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from deepbots_cli import api
from deepbots_cli.analysis import Analysis
from deepbots_cli.expressions.functions import FUNCTIONS, Family, contains_draw
from deepbots_cli.expressions.scalar import Name, Scalar
from deepbots_cli.expressions.types import (
    SPACE,
    ComponentSelection,
    Constant,
    Invocation,
    Operation,
    Reference,
    RowComponents,
    TypedNode,
    ValueType,
    Vector,
    walk,
)
from deepbots_cli.program import Program
from deepbots_cli.program.task import Agent
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.sensors import SENSORS
from tests.laws import readings
from tests.laws.claims import Moment, Probe, moments, with_every_value, with_probes
from tests.laws.episodes import DRAWS, actions
from tests.laws.expressions import GROUPS, SCALARS, Expressions, pick
from tests.laws.law import Case, law, reference
from tests.laws.readings import Reader
from tests.laws.scenarios import ALONE, PLAIN

STEPS = 25
_CLOSE = 1e-6
"""The difference that rounding may cause, absolute and relative: sums are rounded in another order, and
observations to float32."""

# Literals

_UNITS = {
    **dict.fromkeys(("m", "s", "kg", "rad", "Hz", "N", "J", "W", "Pa"), 1.0),
    **dict.fromkeys(("km", "kHz", "kN", "kPa"), 1e3),
    **dict.fromkeys(("mm", "ms", "g", "mN"), 1e-3),
    **dict.fromkeys(("cm", "%"), 1e-2),
    "us": 1e-6,
    "min": 60.0,
    "h": 3600.0,
    "deg": math.pi / 180,
    "rpm": 2 * math.pi / 60,
}
_NUMBER = re.compile(r"(?<![\w.^])[-+]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def numbers_of(text: str, count: int, unit: str) -> list[float]:
    """Return the first numbers of a text, which has this unit such as `cm/s^2`, in SI units."""
    numbers = list(_NUMBER.finditer(text))[:count]
    factor = (-1.0) ** text[: numbers[0].start()].count("-")
    for sign, name, power in re.findall(r"([*/]?)([a-zA-Z%]+)(?:\^(-?\d+))?", unit.replace(" ", "")):
        factor *= _UNITS[name] ** (int(power or 1) * (-1 if sign == "/" else 1))
    return [float(number[0].replace("_", "")) * factor for number in numbers]


# Functions


class DoubtError(Exception):
    """A value that rounding may change: at the limit of a comparison, or beside a place without a value."""


def sure(value: float, distance: float) -> float:
    """Return a value that has a distance to where rounding changes it."""
    if distance <= _CLOSE:
        raise DoubtError
    return value


def apart(left: float, right: float) -> float:
    """Return the difference of two numbers of which rounding does not change the order."""
    is_exact = left == right and not left % 1 > 0
    return 0.0 if is_exact else sure(left - right, abs(left - right) / max(1.0, min(abs(left), abs(right))))


def angle_of(y: float, x: float) -> float:
    """Return the angle of a point, which jumps behind the origin."""
    return sure(np.arctan2(y, x), max(abs(y), x) / max(1.0, abs(x)))


COMPUTED: Mapping[str, Callable[..., Any]] = {
    "neg": lambda a: 0.0 - a,
    "add": lambda *terms: sum(reversed(terms)),
    "sub": lambda a, b: a + -1.0 * b,
    "mul": lambda a, b: np.multiply(b, a),
    "div": lambda a, b: a / sure(b, abs(b) / 100),
    "pow": lambda a, b: np.float_power(sure(a, 1.0 if b >= 0 else abs(a) / 100), b),
    "less": lambda a, b: apart(a, b) < 0,
    "less_equal": lambda a, b: apart(a, b) <= 0,
    "greater": lambda a, b: apart(a, b) > 0,
    "greater_equal": lambda a, b: apart(a, b) >= 0,
    "equal": lambda a, b: apart(a, b) == 0,
    "not_equal": lambda a, b: apart(a, b) != 0,
    "not": lambda a: not a,
    "and": lambda *truths: all(truths),
    "or": lambda *truths: any(truths),
    "where": lambda condition, a, b: a if condition else b,
    "abs": lambda x: max(x, -x),
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": lambda angle: np.sin(angle) / sure(np.cos(angle), abs(np.cos(angle)) / 100),
    "atan2": angle_of,
    "hypot": lambda *parts: np.linalg.norm(parts),
    "clamp": lambda x, low, high: sorted((x, low, high))[1] if low <= high else high,
    "wrap": lambda angle: angle_of(np.sin(angle), np.cos(angle)),
    "min": lambda *parts: np.min(parts),
    "max": lambda *parts: np.max(parts),
}
"""The operators, and the functions without memory, of single numbers."""
REDUCED: Mapping[str, Callable[..., Any]] = {
    "min": np.min,
    "max": np.max,
    "sum": np.sum,
    "mean": np.mean,
    "norm": np.linalg.norm,
    "count": np.sum,
    "any": np.any,
    "all": np.all,
}
"""The functions of one vector."""
_clamp = COMPUTED["clamp"]


def _previous(series: Sequence[Sequence[float]]) -> float:
    """Return the argument of the step before; in the first step, the start that the call names."""
    return series[-2][0] if len(series) > 2 else series[0][-1]


REMEMBERED: Mapping[str, Callable[[Sequence[Sequence[float]], float], float]] = {
    "delta": lambda s, _: s[-1][0] - _previous(s) if len(s) > 1 else 0.0,
    "previous": lambda s, _: _previous(s),
    "running_max": lambda s, _: max(x for (x,) in s),
    "running_min": lambda s, _: min(x for (x,) in s),
    "hold": lambda s, _: [s[0][0], *(x for x, holds in s[1:] if holds)][-1],
    "low_pass": lambda s, dt: reduce(
        lambda y, one: (one[1] * y + dt * one[0]) / (one[1] + dt), s[1:], s[0][0]
    ),
    "integral": lambda s, dt: sum(x for (x,) in s[1:]) * dt,
    "accumulate": lambda s, _: reduce(
        lambda y, one: _clamp(y + one[0], one[1], one[2]), s[1:], _clamp(s[0][3], s[0][1], s[0][2])
    ),
    "duration": lambda s, dt: dt * (len(s) - 1 - [i for i, (x,) in enumerate(s) if not (x and i)][-1]),
    "rising_edge": lambda s, _: len(s) > 1 and s[-1][0] > s[-2][0],
}
"""The functions with memory, of their arguments since the reset, and the timestep in s."""
WITHOUT_SECOND = {
    "vector": "a node of the typed tree of its own",
    "length": "a number of the file, read as it is",
    "age": "a value of a channel",
    "message_received": "a value of a channel",
    "uniform": "chance",
    "integer": "chance",
    "normal": "chance",
    "choice": "chance",
}
"""Functions that are read as they are. Those of the world have a second implementation in `sensors.py`."""


# Values


class Values:
    """The values of expressions in one episode, from those of their leaves in each step.

    Attributes:
        leaves: The values of readings and of names in this step.
        named: Values that no probe has: of endings, and of the state of the episode; None in doubt.
    """

    def __init__(self, analysis: Analysis, expressions: Sequence[Expression]) -> None:
        self._analysis = analysis
        self._texts = {id(node): one.text for one in expressions for node in walk(one.typed)}
        self._fixed = {value.name: value.typed for value in analysis.program.signals}
        self._series: dict[int, list[list[Sequence[float]]]] = defaultdict(list)
        self._doubtful: set[str] = set()
        self.leaves: dict[Scalar, float] = {}
        self.named: dict[str, Sequence[float] | None] = {}

    def of(self, expression: Expression, actual: Any = None) -> list[float] | None:
        """Return the values in this step, and require them to be the actual ones; None after a doubt. Each
        step asks once for each expression."""
        try:
            for node in reversed(list(walk(expression.typed))):
                if isinstance(node, Invocation) and node.function in REMEMBERED:
                    self._series[id(node)].append(self._columns(node))
            expected = None if expression.owner in self._doubtful else list(self._of(expression.typed))
        except DoubtError:
            self._doubtful.add(expression.owner)
            return None
        if expected is not None and actual is not None:
            require_close(actual, expected, expression)
        return expected

    def _columns(self, node: Operation | Invocation) -> list[Sequence[float]]:
        rows = [list(self._of(arg)) for arg in node.args]
        count = len(node.type.components or ("",))
        return [[row[index if len(row) > 1 else 0] for row in rows] for index in range(count)]

    def _of(self, node: TypedNode) -> Iterable[float]:
        match node:
            case Constant(values=values, unit=unit):
                text = self._texts[id(node)][node.start : node.end].strip()
                if node.type.boolean or not text:  # `a when c` has a 0 without a text
                    return [text == "true"]
                return numbers_of(text, len(values), unit.text if unit else "")
            case Reference(symbol=symbol) if symbol.name in self.named:
                return self.named[symbol.name] or [sure(0.0, 0.0)]
            case Reference(symbol=symbol) if symbol.value is not None:
                return self._of(self._fixed[f"{FIXED}{symbol.name}"])
            case ComponentSelection(value=whole, indices=indices):
                return map(list(self._of(whole)).__getitem__, indices)
            case Vector(items=items):
                return [value for item in items for value in self._of(item)]
            case Invocation(function=name) if name in REMEMBERED:
                memories = zip(*self._series[id(node)], strict=True)
                return [REMEMBERED[name](one, self._analysis.program.world.timestep) for one in memories]
            case Invocation(function=name, args=(vector,)) if name in REDUCED and vector.type.components:
                components = vector.type.components
                rows = components.rows if isinstance(components, RowComponents) else components
                table = np.reshape(list(self._of(vector)), (len(rows), -1))
                return list(REDUCED[name](table, axis=int(name == "norm" and rows is not components)))
            case Operation(operator=name) | Invocation(function=name) if name in COMPUTED:
                return [COMPUTED[name](*column) for column in self._columns(node)]
        if not is_leaf(node):  # its arguments have memories, which a probe would share
            raise DoubtError
        return [self.leaves[tree] for tree in trees_of(self._analysis, node)]


def trees_of(analysis: Analysis, node: Any) -> Sequence[Scalar]:
    """Return the trees of a leaf, one for each component."""
    is_name = isinstance(node, Reference)
    return names_of(node.symbol.name, node.type.components) if is_name else analysis.lowered(node, "leaf")


def names_of(name: str, components: Any) -> list[Scalar]:
    return [Name(name, component) for component in components or (None,)]


LATER = ("terminated", "truncated", "ended", "previous_reward", "episode_return")
GOAL = ("achieved", "desired", "goal_reached")
"""Names that no probe can read, since they are known after the signals."""


def is_leaf(node: TypedNode) -> bool:
    """Return whether a node is a reading without memory, or a name whose value changes."""
    if not isinstance(node, Invocation):
        return isinstance(node, Reference) and node.symbol.value is None
    calls = [part.function for part in walk(node) if isinstance(part, Invocation)]
    is_world = FUNCTIONS[calls[0]].family in (Family.WORLD, Family.MESSAGE) or calls[0] == "length"
    return is_world and REMEMBERED.keys().isdisjoint(calls)


FURTHER = 6
"""The number of further signals of a scenario, beside those of `SAME`."""
PAIRS = {"epuck": ["left_wheel", "right_wheel"], "panda": ["panda_joint1", "panda_joint2"]}
"""Joints of robots that an action has a number for each of."""
SAME = {"a": "0 - ({})", "b": "({}) - 0", "c": "1 * ({})", "d": "({}) / 1", "e": "({}) ^ 1", "f": "0 + ({})"}
"""Operations of which a compiler may leave out the half."""
FIXED = "fixed_"
"""The beginning of the name of a signal that has the text of a parameter: a program has no fixed ones."""


def in_single_timesteps(case: Case) -> Program:
    """Compile the scenario with a step for each timestep, further signals, a signal for each parameter that
    draws nothing, and a parameter from each that is drawn again."""
    program = case.compile().program
    data = copy.deepcopy(case.drawn.data)
    data.get("agent", {}).pop("action_repeat", None)
    signals, parameters = data.setdefault("signals", {}), data.setdefault("parameters", {})
    again = [name for name, text in parameters.items() if str(text).endswith((" each step", " every 0.1 s"))]
    parameters |= {f"twice_{name}": f"{name} * 2" for name in again}
    fixed = [name for name, text in parameters.items() if not any(word in str(text) for word in DRAWS)]
    signals |= {f"{FIXED}{name}": parameters[name] for name in fixed}
    if "agents" in data:
        data["role"] = {"agent": [*data["agents"]][-1]}  # the columns of the first begin at 0
        for name, robot in data["robots"].items():
            pair, agent = PAIRS.get(robot["urdf"], []), data["agents"][name]
            robot["groups"] = robot.get("groups", {}) | ({"pair": pair} if pair else {})
            if pair and "action" in agent and not ("choices" in str(agent["action"]) or "scripts" in agent):
                agent["action"][f"{name}_pair"] = {"range": "-1 .. 1", "each": f"{name}.pair"}
    else:
        for word in ("failure", "success"):
            endings = data.setdefault("termination", {}).setdefault(word, {})
            endings[f"{word}9"] = f"step >= {pick(case.draw, (99, 8, 9))}"
        names = readings.names_of(case, data)
        values = {one.name: one.typed.type for one in (*program.parameters, *program.signals)}
        subjects = {kind: names.subjects[kind] for kind in names.subjects if kind not in GROUPS}
        author = Expressions(case.draw, replace(names, values=values, subjects=subjects))
        kinds = [ValueType(pick(case.draw, SCALARS), pick(case.draw, (None, SPACE))) for _ in range(FURTHER)]
        signals |= {f"same{word}": form.format(author.changing()[0]) for word, form in SAME.items()}
        signals |= {f"more{number}": author.text(kind) for number, kind in enumerate(kinds)}
    return api.compile(case.write({key: data[key] for key in data if data[key]}, "single.yaml")).program


def watched_moments(program: Program, trees: Iterable[Scalar]) -> list[tuple[Moment, dict[Scalar, float]]]:
    """Return the moments of an episode with random actions, with the values of trees."""
    probes = [Probe(f"leaf{number}", "", tree, []) for number, tree in enumerate(dict.fromkeys(trees))]
    with closing(api.build(with_probes(program, probes))) as world, with_every_value(program):
        episode = moments(world, probes, 1, STEPS)
    names = [probe.tree for probe in probes]
    return [(moment, dict(zip(names, moment.values, strict=True))) for moment in episode]


def require_close(actual: Any, expected: Any, place: object, slack: float = 0.0) -> None:
    """Require equal numbers, but for rounding; NaN equals NaN."""
    is_close = np.allclose(actual, expected, rtol=_CLOSE, atol=_CLOSE + slack, equal_nan=True)
    assert is_close, (place, actual, expected)


@law(cost=250, profile=ALONE)
def every_value_is_that_of_its_parts(case: Case) -> None:
    """An expression means what its functions do with its parts, by the documentation of each: so a second
    implementation computes the same parameters, signals, endings and terms in every step of an episode. The
    reward is the sum of the terms."""
    program = in_single_timesteps(case)
    analysis, agent, names = Analysis(program), program.agent, [ending.name for ending in program.endings]
    stored = [one for one in program.parameters if one.typed.type.known and not contains_draw(one.typed)]
    stored += [one for one in program.signals if one.noise is None]
    expressions = [*stored, *program.endings, *agent.reward]
    nodes = [node for one in expressions for node in walk(one.typed)]
    trees = [tree for node in nodes if is_leaf(node) for tree in trees_of(analysis, node)]
    trees = [tree for tree in trees if not (isinstance(tree, Name) and tree.name in (*LATER, *GOAL, *names))]
    trees += [name for value in stored for name in names_of(value.name, value.components)]
    values, reward, total = Values(analysis, expressions), 0.0, 0.0
    for moment, values.leaves in watched_moments(program, trees):
        values.named = {**dict.fromkeys(names), "previous_reward": [reward], "episode_return": [total]}
        values.named |= goal_of(agent, moment)
        for value in stored:
            values.of(value, [values.leaves[name] for name in names_of(value.name, value.components)])
        held = {ending.name: values.of(ending) for ending in program.endings}
        reached = values.named.get("goal_reached", [False])
        if None not in (*held.values(), reached):
            require_end(program, moment, [name for name in names if held[name] != [False]], reached == [True])
        values.named |= {**held, "terminated": [moment.terminated], "truncated": [moment.truncated]}
        values.named["ended"] = [moment.is_last]
        for term in agent.reward:  # their memories begin at the reset
            values.of(term, [moment.terms[term.name]] if moment.step else None)
        require_close(moment.reward, math.fsum(moment.terms.values()), "reward")
        reward = moment.reward
        total += reward


def goal_of(agent: Agent, moment: Moment) -> dict[str, Any]:
    """Return the goal as the policy sees it: in rewards, its names mean the rounded and clipped values."""
    goal = agent.goal
    if goal is None:
        return {}
    low, high = np.array(goal.low), np.array(goal.high)
    shown = [np.asarray(moment.observation[f"{name}_goal"], float) for name in GOAL[:2]]
    ways = [low + (high - low) * (part + 1.0) / 2 for part in shown]
    more = np.linalg.norm(ways[0] - ways[1]) - goal.tolerance
    return dict(zip(GOAL, [*map(list, ways), [more <= 0] if abs(more) > _CLOSE else None], strict=True))


def require_end(program: Program, moment: Moment, names: list[str], is_reached: bool) -> None:
    """Require an episode to end by the endings that hold, failures before successes, else by its limit."""
    info, successes, limits = moment.info, program.agent.success, program.truncation
    names.sort(key=lambda name: name in successes)
    counts = {"max_steps": limits.max_steps}
    if limits.max_time is not None:
        counts["max_time"] = max(1, math.ceil(limits.max_time / program.world.timestep - 1e-9))
    present = [(count, name not in successes, name) for name, count in counts.items() if count is not None]
    count, _, limit = min(present)
    is_over = moment.step >= count and not names
    assert (moment.terminated, moment.truncated) == (bool(names), is_over), (names, present, info)
    if names:
        assert {*info["endings"]} == {*names}, (names, info)
        assert program.others is not None or [*info["endings"]] == names, (names, info)
        assert info["is_success"] == ({*names} <= {*successes}), (names, info)
    elif is_over:
        is_success = limit in successes or (is_reached and not {*successes} - {*counts})
        assert (info["ended_by"], info["is_success"]) == (limit, is_success), (present, info)
    assert info["ended_by"] == [*info["endings"], None][0], info


@law(cost=120, profile=ALONE)
def an_observation_shows_its_values(case: Case) -> None:
    """The policy sees each value in file order, mapped from its range to [-1, 1] and clipped, with its history
    and that of the stack, and what it chooses is mapped to the range of each variable. Float32 rounds."""
    program = in_single_timesteps(case)
    agent = program.agent
    for member in program.others.world.members.values() if program.others else ():
        columns = [last - first for first, last in (member.choices, member.ranges)]
        own = member.program.agent
        numbers = sum(len(part.components) or 1 for part in own.ranges)
        assert columns == [len(own.choices), numbers], (member.name, columns)
    entries = [entry for entry in agent.observation if not entry.value.typed.type.picture]
    trees = [name for entry in entries for name in names_of(entry.name, entry.value.components)]
    commands = [name for part in agent.ranges for name in names_of(part.name, part.components)]
    options = [
        name for part in agent.choices for variable in part.variables for name in names_of(variable, ())
    ]
    seen: list[list[list[float]]] = []
    for moment, leaves in watched_moments(program, [*trees, *commands, *options]):
        newest = [mapped(entry, leaves) for entry in entries]
        seen = [*seen, newest] if seen else [newest] * 100
        expected = [
            number
            for back in reversed(range(agent.frame_stack))
            for place, entry in enumerate(entries)
            for ago in reversed(range(entry.history))
            for number in seen[-1 - back - ago][place]
        ]
        shown = moment.observation
        shown = np.asarray(shown.get("observation", ()) if isinstance(shown, dict) else shown)
        assert shown.shape == np.shape(expected), (shown, expected)
        require_close(np.where(np.isnan(expected), np.nan, shown), expected, moment.step)
        if moment.step:
            action = moment.action
            action = action if isinstance(action, dict) else {"ranges": action, "choices": action}
            ends = [(part.low, part.high) for part in agent.ranges for _ in part.components or ("",)]
            numbers = np.ravel(action["ranges"]) if ends else ()
            wanted = [
                low + (a + 1.0) / 2 * (high - low) for (low, high), a in zip(ends, numbers, strict=True)
            ]
            picks = zip(agent.choices, np.ravel(action["choices"]) if agent.choices else (), strict=True)
            wanted += [value for part, number in picks for value in part.options[int(number)].values]
            require_close([leaves[name] for name in (*commands, *options)], wanted, moment.step)


def mapped(entry: Any, leaves: Mapping[Scalar, float]) -> list[float]:
    """Return the values of an entry as the policy sees them; NaN with noise."""
    values = np.array([leaves[name] for name in names_of(entry.name, entry.value.components)])
    if entry.value.typed.type.boolean:
        return values.tolist()
    low, high = np.array(entry.low), np.array(entry.high)
    numbers = (2.0 * values - low - high) / (high - low) * (1.0 if entry.noise is None else math.nan)
    return (np.clip(numbers, -1.0, 1.0) if entry.clip else numbers).tolist()


# Sensors

OPTIONS: Mapping[str, Sequence[Any]] = {
    "period": (1, 2, 3, 4),
    "latency": (0, 5, 20, 30, 45, 70),
    "bias": (0, 0.3, -0.02),
    "gain": (0, 20, -10),
    "drift": (0, 0.5),
    "range": (1000, 0.4),
    "resolution": (0, 0.05),
}
"""Options of sensors: periods in timesteps, latencies in ms, gains in %, others in the unit of the reading."""
NOTHING: Mapping[str, Any] = {"bias": 0, "gain": 0, "drift": 0, "range": math.inf, "resolution": 0}


@law(cost=140, profile=PLAIN)
def a_sensor_with_options_is_the_plain_one_changed(case: Case) -> None:
    """The options of a sensor say what becomes of a true value, and when: it is measured in each period, has
    errors, is clipped and rounded, and is there after the latency. So its readings follow from those of the
    same sensor without options. A sensor of a list of joints or links has a component for each."""
    case.compile()
    data, sources = readings.shown_world(case, [*(FUNCTIONS.keys() - SENSORS.keys())])
    program = case.compile(case.write(data, "plain.yaml")).program
    sensors = {(robot.name, sensor.name): sensor for robot in program.robots for sensor in robot.sensors}
    changed = {}
    sources = {key: source for key, source in sources.items() if isinstance(source, Reader)}
    for key, source in [*sources.items()]:
        section, sensor = data["robots"][source.robot], sensors[source.robot, source.sensor]
        spec = section["sensors"][source.sensor]
        if "joints" in spec or "links" in spec:
            assert sensor.components == sensor.subjects, (spec, sensor)
        options = {option: pick(case.draw, values) for option, values in OPTIONS.items()}
        if source.kind == "touch" or "range" in spec:  # true or false, or clipped by itself
            options |= NOTHING
        options["bias"] = 0 if options["gain"] else options["bias"]
        unit = "" if sensor.unit == "1" else sensor.unit
        texts = {
            "period": f"{1e3 * program.world.timestep * options['period']:.9g} ms",
            "latency": f"{options['latency']} ms",
            "bias": f"{options['gain']} %" if options["gain"] else f"{options['bias']} {unit}",
            "drift": f"{options['drift']} {unit}/s" if unit else f"{options['drift']} Hz",
            "range": f"-{options['range']} .. {options['range']} {unit}",
            "resolution": f"{options['resolution']} {unit}",
        }
        kept = [
            name
            for name in texts
            if options[name] != NOTHING.get(name) or (name == "bias" and options["gain"])
        ]
        changed[key] = options
        section["sensors"][f"{source.sensor}_changed"] = spec | {name: texts[name] for name in kept}
        section["emit"].append(f"{source.sensor}_changed")
        data["signals"][f"{key}_changed"] = f"{source.robot}.{source.sensor}_changed"
        sources[f"{key}_changed"] = source
    program = readings.watched(case.compile(case.write(data, "changed.yaml")).program, sources)
    series: list[Mapping[str, Any]] = []
    with readings.opened(program) as world, reference():
        world.reset(seed=1)
        for _, action in zip(range(STEPS), actions(world, 1), strict=False):
            series.append(readings.readings(world, sources))
            for key, options in changed.items():
                is_mean = getattr(sources[key], "kind", "") == "accelerometer"
                require_reading(series, key, options, program.world.timestep, is_mean=is_mean)
            world.step(action)


def require_reading(
    series: Sequence[Mapping[str, Any]],
    key: str,
    options: Mapping[str, Any],
    timestep: float,
    *,
    is_mean: bool,
) -> None:
    """Require the newest reading of a sensor with options to follow from those of the plain one.

    An accelerometer integrates between two readings (`is_mean`).
    """
    late, period = math.ceil(options["latency"] / 1e3 / timestep - 1e-9), options["period"]
    taken = [0, *range(period, len(series) - late, period)][-1]
    first = taken - period + 1 if taken and is_mean else taken
    true = np.mean([one[key] for one in series[first : taken + 1]], axis=0)
    wanted = true * (1 + options["gain"] / 100) + options["bias"] + options["drift"] * taken * timestep
    wanted = np.clip(wanted, -options["range"], options["range"])
    actual, step = series[-1][f"{key}_changed"], options["resolution"]
    place = (key, len(series), options)
    require_close(actual, wanted, place, step / 2)
    require_close(actual, step * np.round(actual / step) if step else actual, place)
