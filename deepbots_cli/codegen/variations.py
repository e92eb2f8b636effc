"""The figures that an episode may vary, and the statement that sets each.

One entry per word of `RandomizedParameter`: the code, made of the names that say whose figure it is, and of the values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from deepbots_cli.codegen.text import quoted, quoted_tuple, tuple_code
from deepbots_cli.program.resets import RandomizedParameter

Code = Callable[[Sequence[str], Sequence[str]], str]


def _engine(method: str) -> Code:
    """A call of the engine with the names, quoted, and the values."""
    return lambda of, values: f"self.engine.{method}({', '.join([*map(quoted, of), *values])})"


def _body(of: str, link: str) -> str:
    return f"{quoted(of)}, {quoted(link) if link else None}"


def _actuator(figure: str, *, each: bool = True) -> Code:
    """Of a device that drives an actuator: a figure for each of its parts, or a single one."""
    return lambda of, values: f"self.robot_{of[0]}.drive_{of[1]}.{figure} = {tuple_code(values) if each else values[0]}"


def _walls(of: Sequence[str], values: Sequence[str]) -> str:
    """One figure for all of some fixed bodies."""
    return f"self.rub({quoted_tuple(of)}, {values[0]})"


def _colour(of: Sequence[str], values: Sequence[str]) -> str:
    """The first value says which of the colours behind it, three shares each."""
    which, *shares = values
    options = tuple_code([tuple_code([*shares[at : at + 3], "1.0"]) for at in range(0, len(shares), 3)])
    return f"self.engine.set_colour({_body(of[0], of[1])}, {options}[int({which})])"


def _friction(which: str) -> Code:
    return lambda of, values: f"self.engine.set_friction({_body(of[0], of[1])}, {which}={values[0]})"


_SETTERS: Mapping[str, Code] = {
    "mass": lambda of, values: f"self.engine.set_mass({_body(of[0], of[1])}, {values[0]})",
    **{f"{which}_friction": _friction(which) for which in ("lateral", "spinning", "rolling")},
    "restitution": _friction("restitution"),
    "joint_damping": lambda of, values: f"self.engine.set_joint_damping({quoted(of[0])}, {quoted(of[1])}, {values[0]})",
    "joint_friction": lambda of, values: f"self.engine.set_joint_friction({quoted(of[0])}, {quoted(of[1])}, {values[0]})",
    **{f"actuator_{figure}": _actuator(figure) for figure in ("strength", "max_torque", "stiffness", "damping")},
    **{f"actuator_{figure}": _actuator(f"response.{figure}", each=False) for figure in ("delay", "lag")},
    "gravity": lambda _of, values: f"self.engine.set_gravity(({', '.join(values)}))",
    "sensor": lambda of, values: f"self.vary_sensor({', '.join(map(quoted, of))}, {tuple_code(values)})",
    "light": _engine("set_light"),
    "walls_friction": _walls,
    "colour": _colour,
}
"""A link is named by body and link, the root link of an object by an empty link; a fault of a sensor by robot, sensor and fault."""


def setting(variation: RandomizedParameter, values: Sequence[str]) -> str:
    """The statement that sets the figure to `values`, which are code."""
    return _SETTERS[variation.what](variation.of, values)
