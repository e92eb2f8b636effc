"""The draws of an episode: random numbers with one stream per purpose, and values that `reset` is given in
place of draws.

Each stream is named by its place in the scenario (`parameters.fall_angle#0`), and its seed depends on the
root and that name alone. A new draw in a scenario therefore changes no other draw. A new name would be a new
seed, and so other episodes than those of all results so far: streams of `reset.joints` are therefore still
called `reset.set`, those of `color` `colour` (`expressions.lower.stream_name`).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any, Self, TypeVar

import numpy as np

from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.functions import interval_of
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.scalar import Const, Draw, Name, Scalar
from deepbots_cli.program import Program
from deepbots_cli.program.resets import EpisodeDraw, key_of_member

T = TypeVar("T")
Drawn = dict[str, float | str]
NOTHING_CHOSEN: Mapping[str, Any] = MappingProxyType({})

_FLOAT32_ROUNDING = 1e-6
"""The share of the size of a limit by which a value may lie beyond it and is then the limit: 0.6 as a float32
is 0.60000002."""

_MAX_NAMES = 24
"""The number of names that a message lists; find_and_avoid draws 94 values."""


def derive_seed(root: int, *names: str | int) -> int:
    """Return a 32-bit seed for the purpose `names` under the root seed; any whole number is a root, 0 too."""
    # Python's own hash of a text differs between processes.
    text = "/".join(str(name) for name in (root, *names))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


class Streams:
    """The random generators of one environment, made on first use."""

    def __init__(self, root: int | None, copy: str = "") -> None:
        """Create the streams; `root` None takes a seed from the operating system.

        The streams of a `copy` of a robot, such as `cart#2`, are its own, apart from those of parameters.
        """
        self.copy = copy
        self.root = int(np.random.SeedSequence().generate_state(1)[0]) if root is None else int(root)
        self._generators: dict[str, np.random.Generator] = {}
        self.drawn: Drawn = {}
        """The last value of each draw, by the keys of `program.draws`; noise is left out."""
        self.chosen = NOTHING_CHOSEN
        """The values that replace draws, by the same keys."""
        self.member = ""
        """The member of a group whose draws are made now, such as `crate#2`."""
        self.is_follower = False
        """Whether this is a later copy of a robot, for which the first copy drew and placed the other
        bodies."""

    def begin(self, values: Mapping[str, Any]) -> None:
        """Begin an episode, whose draws give these `values`."""
        self.drawn = {}
        self.chosen = values
        self.member = ""

    def key(self, name: str) -> str:
        """Return the key of a draw."""
        return key_of_member(self.member, name) if self.member else name

    def take(self, name: str, value: T) -> T:
        """Note a draw, and return what was chosen in its place, or else the random value."""
        return self.note(self.key(name) if self.member else name, value)

    def note(self, key: str, value: T) -> T:
        """Take a draw by its key; see `take`."""
        value = self.drawn[key] = self.chosen.get(key, value)
        return value

    def __getitem__(self, name: str) -> np.random.Generator:
        generator = self._generators.get(name)
        if generator is None:
            prefix = f"{self.copy}/" if self.copy and not name.startswith("parameters.") else ""
            # By the name and not in the order of use, so that a new draw does not shift the others.
            digest = hashlib.sha256(f"{self.root}/{prefix}{name}".encode()).digest()
            seed = np.random.SeedSequence(
                [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
            )
            # PCG64 by its name: numpy may give `default_rng` another generator, which changes all draws.
            generator = self._generators[name] = np.random.Generator(np.random.PCG64(seed))
        return generator

    def state(self) -> dict[str, Any]:
        """Return the root and the state of each generator, as values for JSON."""
        return {
            "root": self.root,
            "generators": {
                name: generator.bit_generator.state for name, generator in self._generators.items()
            },
        }

    @classmethod
    def restored(cls, state: Mapping[str, Any], copy: str = "") -> Self:
        """Return streams that continue from the result of `state`."""
        streams = cls(state["root"], copy)
        for name, inner in state["generators"].items():
            streams[name].bit_generator.state = inner
        return streams

    def uniform(self, name: str, low: float, high: float) -> float:
        # Drawn also where a value is chosen, so that the later draws of the stream stay the same.
        return self.take(name, float(self[name].uniform(low, high)))

    def integer(self, name: str, low: float, high: float) -> float:
        """Return a whole number from `low` to `high`, both included."""
        # The ends are results of expressions, which rounding may have moved.
        lowest, highest = math.ceil(low - 1e-9), math.floor(high + 1e-9)
        return self.take(name, float(self[name].integers(lowest, highest, endpoint=True)))

    def normal(self, name: str, mean: float, deviation: float) -> float:
        return self.take(name, float(self[name].normal(mean, deviation)))

    def normals(self, name: str, count: int) -> list[float]:
        """Return standard normal numbers."""
        numbers: list[float] = self[name].standard_normal(count).tolist()
        return numbers

    def choice(self, name: str, *options: float) -> float:
        return self.take(name, options[int(self[name].integers(len(options)))])


class SupervisedDraws:
    """The draws of a supervisor in an episode, or values from `options` of `reset` in place of them.

    Attributes:
        streams: The random numbers.
        fixed: The names of parameters that no episode draws.
        copy_names: The names of the copies of a robot; none without copies.
        episode_values: The present values, in SI units, that `options` of `reset` can set, by their names.
    """

    def __init__(self, scenario: Program) -> None:
        self.scenario = scenario
        self.streams = Streams(None)
        self.fixed: tuple[str, ...] = ()
        self.copy_names: tuple[str, ...] = ()
        self.episode_values: dict[str, float] = {}
        self._drawn: Drawn = {}

    def choose_values(self, values: Mapping[str, Mapping[str, Any]] | None) -> None:
        """Begin the streams of an episode, with the values that `options` of `reset` chose."""
        self.streams.begin(values[""] if values else NOTHING_CHOSEN)

    def episode_value(self, name: str, drawn_value: float) -> float:
        """Return the value of this episode: the one that `options` of `reset` set, or else the one drawn."""
        value = self.episode_values[name] = self.streams.take(name, drawn_value)
        return value

    def note_draws(self) -> None:
        """Keep the draws of the streams since the episode began, for `drawn`."""
        draws = self.streams.drawn
        self._drawn = {
            entry.name: draws[entry.key] for entry in self.scenario.draws.noted if entry.key in draws
        }

    def drawn(self) -> Drawn:
        """Return the draws of the last reset, by name; see `reset`."""
        return dict(self._drawn)

    def present_values(self) -> Drawn:
        """Return the draws of the last reset, and the present values of parameters that change within the
        episode."""
        return self._drawn | self.episode_values

    def require_drawable(self, options: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """Return the values of `options` of `reset`, for each copy of a robot.

        Raises:
            UsageError: They hold an unknown name, or a value that an episode could not have drawn.
        """
        return chosen_values(self.scenario, options, self.fixed, self.copy_names)

    def random_state(self) -> dict[str, Any]:
        """Return the states of all random streams, as values for JSON.

        The same states and the same actions give the same episode.
        """
        return self.streams.state()

    def set_random_state(self, state: Mapping[str, Any]) -> None:
        """Restore the result of `random_state`; the next reset begins from it."""
        self.streams = Streams.restored(state)


def chosen_values(
    scenario: Program, options: Mapping[str, Any], fixed: Collection[str] = (), copies: Collection[str] = ()
) -> dict[str, dict[str, Any]]:
    """Return the values that an episode takes in place of draws, for each of the `copies` of a robot, by the
    keys of `program.draws`.

    A name is the name of a draw, such as `mark.x`, or of a vector, such as `mark`. The name of a copy before
    it, as in `cart#2.reset.joints.cart.pole_hinge`, sets the value of this copy alone. Setting a value
    changes no other draw: its stream is drawn from all the same, and every other draw has a stream of its
    own.

    Args:
        options: A number or a word for a single value, a sequence with a number per component for a vector.
        fixed: The parameters that no episode draws.
        copies: The names of the copies, such as `cart#1`; none without copies, where the result has the one
            name "".

    Raises:
        UsageError: A name is unknown or given twice, or a value has the wrong type or shape, is not finite or
            outside its range.
    """
    if not isinstance(options, Mapping):
        raise UsageError(
            f"options of reset must be a mapping from names to values, not {type(options).__name__}"
        )
    values_by_copy: dict[str, dict[str, Any]] = {name: {} for name in copies or ("",)}
    of_one: dict[tuple[str, str], Any] = {}
    for option, value in options.items():
        copy, name = _split(str(option), copies)
        for full, part in _numbers(name, value, scenario, fixed):
            entry = scenario.draws.by_name.get(full)
            if entry is None:  # a component that is not drawn
                continue
            if copy and not entry.is_of_copy:
                raise UsageError(f"reset cannot set {option!r}: all copies share this draw; write {name!r}")
            if (copy, entry.key) in of_one or (
                not copy and any(entry.key in values for values in values_by_copy.values())
            ):
                raise UsageError(f"reset cannot set {full!r} twice: by {option!r} and by another name")
            if copy:
                of_one[copy, entry.key] = part
                continue
            for values in values_by_copy.values():
                values[entry.key] = part
    # After the values of all copies, in place of which these come.
    for (copy, key), part in of_one.items():
        values_by_copy[copy][key] = part
    return values_by_copy


def _split(name: str, copies: Collection[str]) -> tuple[str, str]:
    """Return the copy of a robot that a name begins with, if any, and the rest."""
    copy = next((copy for copy in copies if name.startswith(f"{copy}.")), "")
    return copy, (name.removeprefix(f"{copy}.") if copy else name).removeprefix("parameters.")


def _numbers(name: str, value: Any, scenario: Program, fixed: Collection[str]) -> list[tuple[str, Any]]:
    """Return the checked value of each number or word that a name covers, by its full name."""
    draws = scenario.draws
    entry = draws.by_name.get(name)
    if entry is not None and entry.words:
        if not isinstance(value, str) or value not in entry.words:
            raise UsageError(
                f"reset cannot set {name!r} to {str(value)[:80]!r}; use one of"
                f" {', '.join(map(repr, entry.words))}"
            )
        return [(name, value)]
    if entry is not None:
        (number,) = _array(name, value, ())
        return [(name, _checked(entry, number, scenario))]
    vector = draws.vectors.get(name)
    if vector is None:
        raise UsageError(f"reset cannot set {name!r}: {_why_not(name, scenario, fixed)}")
    parts = zip(vector.numbers, _array(name, value, vector.components), strict=True)
    return [
        (full, _checked(EpisodeDraw(full, full, tree), number, scenario)) for (full, tree), number in parts
    ]


def _why_not(name: str, scenario: Program, fixed: Collection[str]) -> str:
    if name in fixed:
        return (
            "it is a fixed parameter, the same in all episodes; change it when the environment is made,"
            f" by overrides=['{name}=...']"
        )
    if any(name == entry.name for entry in scenario.parameters):
        return "it is computed from other parameters; set those"
    of_component = {
        full: vector.name for vector in scenario.draws.vectors.values() for full, _ in vector.numbers
    }
    drawn_names = [
        *dict.fromkeys(
            part for full in scenario.draws.by_name for part in (of_component.get(full, full), full)
        )
    ]
    suggestion = nearest_word(name, drawn_names)
    hint = f"did you mean {suggestion!r}? " if suggestion else ""
    left = len(drawn_names) - _MAX_NAMES
    more = f" and {left} more, which `drawn` in the info of a reset lists" if left > 0 else ""
    copies = scenario.agent.copies
    of_copy = (
        f"; `{copies.robot}#1.` to `{copies.robot}#{copies.count}.` before a name sets one copy"
        if copies
        else ""
    )
    return (
        f"{hint}{scenario.name} draws"
        f" {', '.join(map(repr, drawn_names[:_MAX_NAMES])) or 'nothing that has a name'}{more}{of_copy}"
    )


def _array(name: str, value: Any, components: tuple[str, ...]) -> list[float]:
    expected = f"{len(components)} numbers ({', '.join(components)})" if components else "a single number"
    try:
        array = np.asarray(value)
    except ValueError:  # sequences of different lengths
        # An array of objects, which the next check refuses.
        array = np.asarray(None)
    if array.dtype.kind not in "biuf" or array.shape != ((len(components),) if components else ()):
        raise UsageError(f"reset cannot set {name!r} to {str(value)[:80]}: it is {expected}, in SI units")
    return list(array.ravel().tolist())


def _checked(entry: EpisodeDraw, number: float, scenario: Program) -> float:
    """Return the number, moved to the limit that it lies beyond by rounding."""
    full = entry.name
    options = _options(entry.tree)
    if isinstance(number, bool) and not any(isinstance(option, bool) for option in options):
        raise UsageError(f"reset cannot set {full!r} to {number}: it is a single number, in SI units")
    if not math.isfinite(number):
        raise UsageError(f"reset cannot set {full!r} to {number}: it is not finite")
    if options:
        nearest = min(options, key=lambda option: abs(option - number))
        if abs(nearest - number) > _FLOAT32_ROUNDING * abs(nearest):
            raise UsageError(
                f"reset cannot set {full!r} to {number:g}; use one of"
                f" {', '.join(f'{option:g}' for option in options)}"
            )
        return nearest
    low, high = (entry.low, entry.high) if entry.tree is None else _interval(entry.tree, scenario)
    # Values often come back from float32 arrays, whose rounding may lie outside the range.
    nearest = min(max(float(number), low), high)
    if abs(nearest - number) > _FLOAT32_ROUNDING * abs(nearest):
        raise UsageError(
            f"reset cannot set {full!r} to {number:g}: it is drawn from {low:g} to {high:g} (SI units)"
        )
    if isinstance(entry.tree, Draw) and entry.tree.distribution == "integer" and not nearest.is_integer():
        raise UsageError(
            f"reset cannot set {full!r} to {number:g}: it is a whole number from {low:g} to {high:g}"
        )
    return nearest


def _options(expression: Scalar | None) -> list[float]:
    """Return the values of a choice among numbers or truth values."""
    if isinstance(expression, Draw) and expression.distribution == "choice":
        return [option.value for option in expression.args if isinstance(option, Const)]
    return []


def _interval(node: Scalar, scenario: Program) -> Interval:
    """Return the interval of an expression over all draws."""
    if not isinstance(node, Name):
        return interval_of(node, lambda arg: _interval(arg, scenario))
    numbers = (pair for entry in scenario.parameters if entry.name == node.name for pair in entry.numbers)
    return next((_interval(value, scenario) for full, value in numbers if full == node.full_name), EVERYTHING)
