"""What an expression may see from its place in the scenario.

The split is the paper's: the supervisor sees the world and what robots sent; a robot sees its own
sensors, what it received, its poses, and parameters that never change.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.expressions.dimensions import NUMBER, TIME
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.types import Context, Kind, Stage, Subject, Symbol, Type

_ENDLESS = Interval(0.0, float("inf"))
_NO_POSES: Mapping[str, Symbol] = MappingProxyType({})
_FLAGS = ("terminated", "truncated", "ended")
_ACCOUNTS = ("previous_reward", "episode_return")
GOAL_IS_LATE = "the goal is settled after the signals, and seen by endings and rewards only"
_BUILT_IN = ("time", "step", "previous_action", "goal_reached", *_ACCOUNTS, *_FLAGS)


class ParameterScope(NamedTuple):
    """Parameters only: for figures of the world, resets, ranges. `poses` are those of the robot whose joints are set."""

    namespace: Namespace
    context: Context
    poses: Mapping[str, Symbol] = _NO_POSES

    def lookup(self, name: str) -> Symbol | None:
        if name in self.poses:
            return self.poses[name]
        origin = self.namespace.origin(name)
        if origin in (None, Origin.PARAMETER, Origin.ROBOT, Origin.OBJECT, Origin.WALL, Origin.LINE):
            return self.namespace.symbol(name)
        return Symbol(name, None, refused=f"{origin.value} has a value only while an episode runs; use a parameter")

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return self.namespace.subject(name, kinds)

    def names(self) -> Iterable[str]:
        return [*self.poses, *self.namespace.named(Origin.PARAMETER)]

    def subjects(self) -> Iterable[str]:
        return self.namespace.subjects()


class SupervisorScope(NamedTuple):
    """Everything that has a value in a step; endings only where they are known already."""

    namespace: Namespace
    context: Context

    def lookup(self, name: str) -> Symbol | None:
        if (built_in := self._built_in(name)) is not None:
            return built_in
        origin = self.namespace.origin(name)
        if origin is Origin.ENDING and self.context not in (Context.REWARD, Context.ENDING):
            return Symbol(name, None, refused="endings are settled after the signals; use the condition itself")
        if origin is Origin.GOAL and self.context not in (Context.REWARD, Context.ENDING):
            return Symbol(name, None, refused=GOAL_IS_LATE)
        robot, _, rest = name.partition(".")
        scene = self.namespace.robots.get(robot)
        if origin is None and scene is not None and rest in scene.spec.sensors and not self.namespace.is_broken(name):
            return Symbol(name, None, refused=f"robot `{robot}` does not send it; add `{rest}` to its `emit`")
        return self.namespace.symbol(name)

    def _built_in(self, name: str) -> Symbol | None:
        if name == "time":
            return Symbol(name, Type(TIME, interval=_ENDLESS, stage=Stage.STEP))
        if name == "step":
            return Symbol(name, Type(NUMBER, interval=_ENDLESS, stage=Stage.STEP))
        if name in _ACCOUNTS:
            return Symbol(name, Type(NUMBER, stage=Stage.STEP))
        if name in self.namespace.built_in:
            return self.namespace.built_in[name](self.context)
        if name in _FLAGS:
            refused = None if self.context is Context.REWARD else "it is settled after the endings, and seen by rewards only"
            return Symbol(name, Type(boolean=True, stage=Stage.STEP) if refused is None else None, refused=refused)
        if name == "goal_reached":
            return Symbol(name, None, refused=None if self.namespace.is_broken("goal") else "this scenario has no `goal`")
        return None

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return self.namespace.subject(name, kinds)

    def names(self) -> Iterable[str]:
        known = (Origin.PARAMETER, Origin.ACTION, Origin.FIELD, Origin.AUGMENT, Origin.SIGNAL)
        endings = [Origin.ENDING] if self.context in (Context.REWARD, Context.ENDING) else []
        return [*self.namespace.named(*known, *endings), "time", "step", *_ACCOUNTS, *self.namespace.built_in]

    def subjects(self) -> Iterable[str]:
        return self.namespace.subjects()


class RobotScope(NamedTuple):
    """What one robot knows on board. `own` holds its sensors, received fields and poses by name."""

    namespace: Namespace
    context: Context
    robot: str
    own: dict[str, Symbol]

    def lookup(self, name: str) -> Symbol | None:
        if name in self.own:
            self.namespace.touch(name)
            return self.own[name]
        origin = self.namespace.origin(name)
        scene = self.namespace.robots.get(self.robot)
        arrives = origin is Origin.ACTION or (scene is not None and name in (scene.spec.receive or {}))
        if origin is Origin.PARAMETER:
            symbol = self.namespace.symbol(name)
            if symbol is None or symbol.type is None or symbol.type.stage is Stage.FIXED:
                return symbol
            if not arrives:
                return Symbol(name, None, refused=f"the robot cannot know a drawn parameter; send it: `receive: {{{name}: {name}}}`")
        if arrives:
            return Symbol(name, None, refused="it arrives with a message; use it in `apply`")
        if name in _BUILT_IN or origin in (Origin.AUGMENT, Origin.SIGNAL, Origin.ENDING, Origin.FIELD):
            return Symbol(name, None, refused=f"robot `{self.robot}` sees only its own sensors; send it under `receive` if it must know")
        return self.namespace.symbol(name)

    def subject(self, name: str, kinds: frozenset[Kind] | None = None) -> Subject | None:
        return self.namespace.subject(name, kinds)

    def names(self) -> Iterable[str]:
        return [*self.own, *self.namespace.named(Origin.PARAMETER)]

    def subjects(self) -> Iterable[str]:
        return self.namespace.subjects()
