"""What an episode draws: random numbers with one stream per purpose, and values that `reset` is given in place of draws.

Each stream is named by its place in the scenario (`reset.set.cart.pole_hinge#0`), and its seed depends on the root and
that name alone. A new draw in a scenario therefore changes no other draw.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping
from typing import Any, Self

import numpy as np

from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.functions import interval_of
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.scalar import Const, Draw, Name, Scalar
from deepbots_cli.program import Program
from deepbots_cli.program.values import NamedScalars

_ROUNDING = 1e-6
"""Of the size of a limit, by which a value may lie beyond it and is then the limit: 0.6 as a float32 is 0.60000002."""


def derive_seed(root: int, *names: str | int) -> int:
    """A 32-bit seed for the purpose `names` under the root seed; any whole number is a root, 0 too."""
    text = "/".join(str(name) for name in (root, *names))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


class Streams:
    """The random generators of one environment, made when first asked for."""

    def __init__(self, root: int | None, copy: str = "") -> None:
        """`root` None takes a seed from the operating system.

        The streams of a `copy` of a robot, such as `cart#2`, are its own, apart from those of parameters.
        """
        self.copy = copy
        self.root = int(np.random.SeedSequence().generate_state(1)[0]) if root is None else int(root)
        self._generators: dict[str, np.random.Generator] = {}
        self.drawn: dict[str, float | str] = {}
        """The last number of each draw by `uniform`, `integer`, `normal` or `choice`, and the last drawn layout."""

    def __getitem__(self, name: str) -> np.random.Generator:
        generator = self._generators.get(name)
        if generator is None:
            own = f"{self.copy}/" if self.copy and not name.startswith("parameters.") else ""
            seed = np.random.SeedSequence(_seed_integers(f"{self.root}/{own}{name}"))
            generator = self._generators[name] = np.random.Generator(np.random.PCG64(seed))
        return generator

    def state(self) -> dict[str, Any]:
        """The root and the state of each generator, as JSON can hold them."""
        return {"root": self.root, "generators": {name: made.bit_generator.state for name, made in self._generators.items()}}

    @classmethod
    def restored(cls, state: Mapping[str, Any], copy: str = "") -> Self:
        """Streams that continue from the result of `state`."""
        streams = cls(state["root"], copy)
        for name, inner in state["generators"].items():
            streams[name].bit_generator.state = inner
        return streams

    def uniform(self, name: str, low: float, high: float) -> float:
        value = self.drawn[name] = float(self[name].uniform(low, high))
        return value

    def integer(self, name: str, low: float, high: float) -> float:
        """A whole number from `low` to `high`, both included."""
        value = self.drawn[name] = float(self[name].integers(int(low), int(high), endpoint=True))
        return value

    def normal(self, name: str, mean: float, deviation: float) -> float:
        value = self.drawn[name] = float(self[name].normal(mean, deviation))
        return value

    def normals(self, name: str, count: int) -> list[float]:
        """Standard normal numbers."""
        numbers: list[float] = self[name].standard_normal(count).tolist()
        return numbers

    def choice(self, name: str, *options: float) -> float:
        value = self.drawn[name] = options[int(self[name].integers(len(options)))]
        return value


def _seed_integers(text: str) -> list[int]:
    digest = hashlib.sha256(text.encode()).digest()
    return [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]


def episode_values(scenario: Program, options: Mapping[str, Any], fixed: Collection[str] = ()) -> dict[str, float]:
    """The numbers (SI units) that an episode takes in place of draws, by full names such as `mark.x`.

    A name is that of a drawn parameter, or the path of a drawn place or joint, such as `reset.place.block.x`. Setting a value
    changes no other draw: its stream is drawn from all the same, and every other draw has a stream of its own.

    Args:
        options: A number for a single value, a sequence with a number per component for a vector.
        fixed: The parameters that no episode draws.

    Raises:
        UsageError: A name is unknown, or a value has the wrong type or shape, is not finite or outside its range.
    """
    if not isinstance(options, Mapping):
        raise UsageError(f"options of reset must be a mapping from names to values, not {type(options).__name__}")
    known = {entry.name: entry for entry in scenario.settable_draws}
    found: dict[str, float] = {}
    for given, value in options.items():
        name = str(given).removeprefix("parameters.")
        entry = known.get(name)
        if entry is None:
            raise UsageError(f"reset cannot set {name!r}: {_why_not(name, scenario, list(known), fixed)}")
        for (full, expression), number in zip(entry.numbers, _numbers(entry, value), strict=True):
            found[full] = _checked(full, number, expression, scenario)
    return found


def _why_not(name: str, scenario: Program, known: list[str], fixed: Collection[str]) -> str:
    if name in fixed:
        return f"it is a fixed parameter, the same in all episodes; change it when the environment is made, by overrides=['{name}=...']"
    if any(name == entry.name for entry in scenario.parameters):
        return "it is computed from other parameters; set those"
    near = nearest_word(name, known)
    hint = f"did you mean {near!r}? " if near else ""
    return f"{hint}{scenario.name} draws {', '.join(map(repr, known)) or 'nothing that has a name'}"


def _numbers(entry: NamedScalars, value: Any) -> list[float]:
    wanted = f"{len(entry.components)} numbers ({', '.join(entry.components)})" if entry.components else "a single number"
    try:
        array = np.asarray(value)
    except ValueError:  # sequences of different lengths
        array = np.asarray(None)
    if array.dtype.kind not in "iuf" or array.shape != ((len(entry.components),) if entry.components else ()):
        raise UsageError(f"reset cannot set {entry.name!r} to {str(value)[:80]}: it is {wanted}, in SI units")
    return [float(number) for number in array.ravel()]


def _checked(full: str, number: float, expression: Scalar, scenario: Program) -> float:
    """The number, moved to the limit that it lies beyond by rounding."""
    if not math.isfinite(number):
        raise UsageError(f"reset cannot set {full!r} to {number}: it is not finite")
    options = _options(expression)
    if options:
        near = min(options, key=lambda option: abs(option - number))
        if abs(near - number) > _ROUNDING * abs(near):
            raise UsageError(f"reset cannot set {full!r} to {number:g}: it is one of {', '.join(f'{option:g}' for option in options)}")
        return near
    low, high = _interval(expression, scenario)
    near = min(max(number, low), high)
    if abs(near - number) > _ROUNDING * abs(near):
        raise UsageError(f"reset cannot set {full!r} to {number:g}: it is drawn from {low:g} to {high:g} (SI units)")
    if isinstance(expression, Draw) and expression.distribution == "integer" and not near.is_integer():
        raise UsageError(f"reset cannot set {full!r} to {number:g}: it is a whole number from {low:g} to {high:g}")
    return near


def _options(expression: Scalar) -> list[float]:
    """The values of a choice among numbers."""
    if isinstance(expression, Draw) and expression.distribution == "choice":
        return [float(option.value) for option in expression.args if isinstance(option, Const)]
    return []


def _interval(node: Scalar, scenario: Program) -> Interval:
    """The interval of an expression over all draws."""
    if not isinstance(node, Name):
        return interval_of(node, lambda arg: _interval(arg, scenario))
    full = node.name if node.component is None else f"{node.name}.{node.component}"
    numbers = (pair for entry in scenario.parameters if entry.name == node.name for pair in entry.numbers)
    return next((_interval(value, scenario) for other, value in numbers if other == full), EVERYTHING)
