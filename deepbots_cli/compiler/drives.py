"""The figures of one actuator: its limits beside those of the robot file, its strength, how promptly it answers."""

from __future__ import annotations

import math
from dataclasses import replace

from deepbots_cli.compiler.joints import effort_of, joint_dimension
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.compiler.variations import figure, figures
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import NUMBER, TIME, Dimension
from deepbots_cli.expressions.intervals import Interval, exact
from deepbots_cli.expressions.types import Context
from deepbots_cli.program.robots import Response
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.actuators import Actuator

Limits = tuple[float | None, ...]


class Figures:
    """Reads figures of the actuator called `name`; what an episode draws anew becomes a variation `actuator_...` of it."""

    def __init__(self, robot: str, name: str, namespace: Namespace) -> None:
        self.place: Path = ("robots", robot, "actuators", name)
        self._of = (robot, name)
        self._namespace = namespace
        self._values = namespace.values
        self.scope = ParameterScope(namespace, Context.FIELD)

    def response(self, spec: Actuator, parts: tuple[str, ...]) -> Response:
        """Strength is drawn for each of the parts, delay and lag for all of them together."""
        strength = self.each("strength", spec.strength, NUMBER, parts)
        delay, lag = (self._single(key, getattr(spec, key), TIME) for key in ("delay", "lag"))
        return Response(1.0 if strength is None else strength, delay or 0.0, lag or 0.0)

    def max_torque(self, given: object, joints: tuple[Joint, ...]) -> Limits:
        """The largest torque or force of each joint: the tighter of the scenario's and that of the robot file."""
        own, known, effort = tuple(joint.limit.effort for joint in joints), len(self._namespace.variations), effort_of(joints[0])
        found = self.each("max_torque", given, effort, tuple(joint.name for joint in joints))
        if found is None:
            return own
        drawn = self._namespace.variations[known:]
        self._compare("max_torque", drawn[0].value.typed.type.interval.high if drawn else found, effort, own)
        self._namespace.variations[known:] = [replace(varied, max=own) for varied in drawn]
        return _tighter(own, found)

    def max_velocity(self, given: object, joints: tuple[Joint, ...]) -> Limits:
        """The same for velocities, which are not drawn."""
        own = tuple(joint.limit.velocity for joint in joints)
        if given is None:
            return own
        rate = joint_dimension(joints[0]) / TIME
        found = self._values.number((*self.place, "max_velocity"), given, rate, self.scope)
        if found is None:
            return own
        self._compare("max_velocity", found, rate, own)
        return _tighter(own, found)

    def number(self, key: str, given: object, dimension: Dimension) -> float | None:
        """A fixed figure; None where none is given, and after a finding."""
        return None if given is None else self._values.number((*self.place, key), given, dimension, self.scope)

    def each(self, key: str, given: object, dimension: Dimension, parts: tuple[str, ...]) -> float | None:
        """A figure of all parts alike, or one that every episode draws anew for each of them."""
        place = (*self.place, key)
        found = figures(self._namespace, place, given, dimension, self.scope, f"actuator_{key}", self._of, None, parts)
        return found[0] if found else None

    def _single(self, key: str, given: object, dimension: Dimension) -> float | None:
        return figure(self._namespace, (*self.place, key), given, dimension, self.scope, f"actuator_{key}", self._of)

    def _compare(self, key: str, limit: float, dimension: Dimension, own: Limits) -> None:
        """DB304 for a limit that the robot file undercuts for every joint."""
        known = [most for most in own if most is not None]
        if len(known) == len(own) and limit > max(known) * (1 + 1e-9):
            from deepbots_cli.compiler.confines import Confines  # only on the way to a finding

            place = (*self.place, key)
            confines = Confines(self._values, self._values.text(place), dimension, Interval(-math.inf, max(known)))
            help = f"that of the robot file holds: lower this one, or raise `{key}` under `joints` if the motor can do more"
            confines.report("a limit of", exact(limit), help)


def _tighter(own: Limits, found: float) -> Limits:
    return tuple(found if most is None else min(found, most) for most in own)
