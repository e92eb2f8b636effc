"""Robots as controllers: sensors, actuators, what they receive, emit and apply."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from deepbots_cli.compiler.actuators import Actuators, Driven
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.poses import poses
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.scopes import RobotScope, SupervisorScope
from deepbots_cli.compiler.sensing import Sensing
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.types import Context, Reference, Stage, Symbol, walk
from deepbots_cli.program.robots import Command, MessageField, Robot, Route
from deepbots_cli.program.task import ActionPart, ActionRange
from deepbots_cli.program.values import Expression


@dataclass(eq=False)
class Controller:
    """The controller of one robot, while it is being compiled."""

    scene: RobotScene
    namespace: Namespace

    def __post_init__(self) -> None:
        self.values: Values = self.namespace.values
        self.path: Path = ("robots", self.scene.name)
        self.sensing = Sensing(self.scene, self.namespace)
        self.poses = poses(self.scene, self.namespace)
        self.own: dict[str, Symbol] = {**self.poses, **self.sensing.symbols}
        self.fields: dict[str, Expression] = {}
        self.received: dict[str, Expression] = {}
        self._check_names()
        self._define_fields()

    # What it knows

    def _check_names(self) -> None:
        """No name on board may mean two things, also not one here and another in the scenario."""
        spec = self.scene.spec
        taken: dict[str, tuple[str, Path]] = {}
        for name in self.namespace.named(Origin.PARAMETER, Origin.ACTION):
            definition = self.namespace.definitions[name]
            taken[name] = (definition.origin.value, definition.path)
        for what, section, names in (("a pose", "poses", spec.poses), ("a sensor", "sensors", spec.sensors)):
            for name in names:
                place = (*self.path, section, name)
                if name in taken:
                    self.values.taken(place, name, *taken[name])
                taken[name] = (what, place)
        for name in spec.receive or {}:
            if name in spec.poses or name in spec.sensors:
                self.values.taken((*self.path, "receive", name), name, *taken[name])

    # What it sends

    def _define_fields(self) -> None:
        emit = self.scene.spec.emit
        entries = (
            [(name, (*self.path, "emit", name)) for name in emit]
            if isinstance(emit, dict)
            else [(name, (*self.path, "emit", i)) for i, name in enumerate(emit)]
        )
        for name, place in entries:
            self.namespace.define(f"{self.scene.name}.{name}", Origin.FIELD, place, partial(self._field, name, place))

    def _field(self, name: str, place: Path) -> Symbol:
        full = f"{self.scene.name}.{name}"
        emit = self.scene.spec.emit
        text = self.values.text(place, emit[name] if isinstance(emit, dict) else name)
        if not isinstance(emit, dict) and name not in self.own:
            sensors = list(self.scene.spec.sensors)
            self.values.unknown(text.span, "sensor", name, sensors)
            if meant := nearest(name, sensors):
                self.values.lose(f"{self.scene.name}.{meant}")
            return Symbol(full, None)
        typed = self.values.expression(text, RobotScope(self.namespace, Context.EMIT, self.scene.name, self.own))
        if typed is None:
            return Symbol(full, None)
        self.fields[name] = Expression(name, text.span, text.text, typed, f"{self.scene.name}.emit.{name}")
        return Symbol(full, typed.type._replace(stage=Stage.STEP))

    # What it receives and does

    def _receive(self) -> dict[str, Symbol]:
        """Action variables, and what `receive` adds to them."""
        spec = self.scene.spec
        symbols = {name: self.namespace.settle(name) or Symbol(name, None) for name in self.namespace.named(Origin.ACTION)}
        for name, given in (spec.receive or {}).items():
            place = (*self.path, "receive", name)
            text = self.values.text(place, given)
            typed = self.values.expression(text, SupervisorScope(self.namespace, Context.RECEIVE))
            symbols[name] = Symbol(name, None)
            if typed is not None:
                self.received[name] = Expression(name, text.span, text.text, typed, f"{self.scene.name}.receive.{name}")
                symbols[name] = Symbol(name, typed.type._replace(stage=Stage.STEP))
        return symbols

    def finish(self, tick: float, action: Sequence[ActionPart], routes: tuple[Route, Route]) -> Robot:
        """Type everything that is left; the world's timestep is `tick` s, `routes` are those to and from robots."""
        received = self._receive()
        scope = RobotScope(self.namespace, Context.APPLY, self.scene.name, {**self.own, **received})
        actuators = Actuators(self.scene, self.namespace)
        driven = {name: found for name in self.scene.spec.actuators if (found := actuators.read(name)) is not None}
        commands = []
        for name, given in self.scene.spec.apply.items():
            place = (*self.path, "apply", name)
            if name not in self.scene.spec.actuators:
                self.values.unknown(self.values.key_span(place), "actuator", name, list(self.scene.spec.actuators))
                continue
            command = self._command(name, given, place, driven.get(name), scope)
            if command:
                commands.append(command)
        name, (to_robot, from_robot) = self.scene.name, routes
        return Robot(
            name,
            self.sensing.finished(tick),
            tuple(found.actuator for found in driven.values()),
            tuple(self.received.values()),
            tuple(self.fields.values()),
            tuple(commands),
            tuple(_used_variables(action, commands, self.received)),
            to_robot.of(name, "to_robot"),
            from_robot.of(name, "from_robot"),
        )

    def _command(self, name: str, given: object, place: Path, driven: Driven | None, scope: RobotScope) -> Command | None:
        text = self.values.text(place, given)
        if driven is None:
            self.values.expression(text, scope, boolean=False)
            return None
        typed = self.values.quantity(text, f"the target of `{name}`", scope, driven.dimension, driven.components, Stage.STEP)
        if typed is None:
            return None
        return Command(driven.actuator, Expression(name, text.span, text.text, typed, f"{self.scene.name}.apply.{name}"), driven.opening)


def _used_variables(action: Sequence[ActionPart], commands: Iterable[Command], received: Container[str]) -> Iterator[MessageField]:
    """The action variables that commands use, in the order of the action; `received` names of the robot hide them."""
    used = {node.symbol.name for command in commands for node in walk(command.target.typed) if isinstance(node, Reference)}
    for part in action:
        if isinstance(part, ActionRange):
            fields = [MessageField(part.name, part.unit, part.components)]
        else:
            fields = [MessageField(variable, "1") for variable in part.variables]
        yield from (field for field in fields if field.name in used and field.name not in received)
