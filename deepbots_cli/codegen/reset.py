"""Prints the methods of a reset: the draws and variations of an episode, and the start of the world; language
reference, "Reset".

If every body has a fixed place, the bodies are simply put there. If a body needs a free place, if the start
must meet a condition, or if copies come and go, the method `_arrange` is one attempt.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from deepbots_cli.codegen.names import Constants, block, indent, quoted, quoted_tuple, tuple_code
from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.robot import ActuatorBindings
from deepbots_cli.codegen.workspace import SupervisorPrinter
from deepbots_cli.expressions.scalar import Const, Scalar, names_in
from deepbots_cli.program import Program, generated
from deepbots_cli.program.resets import (
    Cells,
    Disturbance,
    JointStart,
    ObjectGroup,
    OfActuator,
    OfSensor,
    OfWalls,
    Placement,
    RandomizedParameter,
    Region,
    Top,
)
from deepbots_cli.program.robots import Direction, Route
from deepbots_cli.program.values import Expression, Noise


def begin_method(supervisor: SupervisorPrinter) -> list[str]:
    """Return the method that draws in order of dependency, then sets variations, places, joints; the
    actuators hold until their first commands."""
    scenario = supervisor.scenario
    reset = supervisor.scenario.reset
    printer = supervisor.printer()
    _print_first_draws(supervisor, printer)
    _print_stds(supervisor, printer)
    if needs_arrangement(scenario):
        # An attempt resets the engine to nominal parameters, so the values are drawn before the first one.
        for index, variation in enumerate(reset.variations):
            printer.assign(_varied(supervisor, index), printer.vector(variation.scalars))
        printer.line(f"self.bodies.arrange(self._arrange, {reset.attempts}, self.streams)")
    else:
        printer.line("self.engine.reset()")
        for variation in reset.variations:
            vector = printer.vector(variation.scalars) if _is_vector(variation) else ""
            printer.line(
                _setting(
                    variation, vector, [] if vector else [printer.value(value) for value in variation.scalars]
                )
            )
        printer.lines += _releasing(scenario)
        for place in reset.placements:
            printer.line(_placing(place, printer))
        for start in reset.joint_starts:
            _print_joints(start, printer)
        printer.lines += _reset_paths_lines(supervisor)
    _print_first_pushes(supervisor, printer)
    printer.lines += [
        f"self.{generated.robot(robot.name)}.hold()"
        for robot in scenario.robots
        if ActuatorBindings(scenario, robot, supervisor.constants).actuators
    ]
    ticks = round(reset.settle / scenario.world.timestep)
    if ticks:
        printer.line(f"self.physics({ticks * scenario.world.substeps})")
    doc = '"""Draw what this episode varies, and put the world where it begins."""'
    method = block("def _begin(self) -> None:", printer.method_lines([doc]))
    return [*method, *_arrange(supervisor)] if needs_arrangement(scenario) else method


def needs_arrangement(scenario: Program) -> bool:
    """Return whether the places of an episode have to be found."""
    reset = scenario.reset
    drawn_parts = reset.groups or reset.layouts or reset.require is not None
    pooled = any(body.pooled for body in scenario.world.objects)
    return (
        bool(drawn_parts)
        or pooled
        or scenario.world.terrain is not None
        or any(p.seeks_height or p.spot is not None for p in reset.placements)
    )


def _arrange(supervisor: SupervisorPrinter) -> list[str]:
    """Return the method `_arrange`, which is one attempt at a start."""
    reset = supervisor.scenario.reset
    printer = supervisor.printer()
    printer.line("bodies = self.bodies")
    printer.lines += _place_lines(reset.placements, supervisor, printer)
    shares = ", ".join(f"({quoted(layout.name)}, {layout.share!r})" for layout in reset.layouts)
    if len(reset.layouts) > 1:
        printer.line(f'layout = bodies.layout("reset.layout", {shares})')
    for index, layout in enumerate(reset.layouts):
        lines = _place_lines(layout.placements, supervisor, printer) or ["pass"]
        if len(reset.layouts) > 1:
            printer.line(f"{'elif' if index else 'if'} layout == {quoted(layout.name)}:")
            lines = [f"    {line}" for line in lines]
        printer.lines += lines
    printer.lines += [
        f"{supervisor.present_count(group.name)} = bodies.present[{quoted(group.name)}]"
        for group in reset.groups
    ]
    printer.line("self.engine.reset()")
    if any(body.variants for body in supervisor.scenario.world.objects):
        printer.line("bodies.choose()")
    for index, variation in enumerate(reset.variations):
        varied = _varied(supervisor, index)
        printer.line(
            _setting(variation, varied, [f"{varied}[{number}]" for number in range(len(variation.scalars))])
        )
    printer.lines += _releasing(supervisor.scenario)
    printer.line("bodies.put()")
    for start in reset.joint_starts:
        _print_joints(start, printer)
    printer.lines += _reset_paths_lines(supervisor)
    if reset.require is None:
        printer.line("return True")
    else:
        printer.insert_readers_here()
        printer.line(f"return bool({printer.value(reset.require.scalar)})")
    doc = '"""One attempt at a start: a place for each body; whether it is as required."""'
    return block("def _arrange(self) -> bool:", printer.method_lines([doc]))


def _releasing(scenario: Program) -> list[str]:
    """Return statements after which no actuator remembers the episode before."""
    return [
        f"self.{generated.robot(robot.name)}.release()"
        for robot in scenario.robots
        if ActuatorBindings(scenario, robot, Constants()).has_devices
    ]


def _reset_paths_lines(supervisor: SupervisorPrinter) -> list[str]:
    """Return statements after which no map of paths remembers the episode before."""
    return ["self.ways.reset()"] if supervisor.readers.needs_paths else []


def _varied(supervisor: SupervisorPrinter, index: int) -> str:
    """Return the attribute that has the values of a randomized parameter while places are looked for."""
    return f"self.{supervisor.names(f'varied {index}')}"


def _placing(place: Placement, printer: Printer) -> str:
    """Return the statement that places a body whose place is known."""
    xyz, rpy = printer.tuple(place.xyz), printer.tuple(place.rpy)
    turn = "(0.0, 0.0, 0.0, 1.0)" if _all_zero(place.rpy) else f"quaternion{rpy}"
    moving = "".join(f", {name}={printer.tuple(values)}" for name, values in place.velocities)
    return f"self.engine.place({quoted(place.body)}, {xyz}, {turn}{moving})"


def _print_joints(start: JointStart, printer: Printer) -> None:
    robot = quoted(start.robot)
    joints, positions, velocities = zip(*start.states, strict=True)
    if len(joints) > 2:
        moving = "" if _all_zero(velocities) else f", {printer.vector(velocities)}"
        printer.line(
            f"self.set_joints({robot}, {printer.context.constants.strings(joints)},"
            f" {printer.vector(positions)}{moving})"
        )
        return
    for joint, position, velocity in start.states:
        printer.line(
            f"self.engine.set_joint({robot}, {quoted(joint)}, {printer.value(position)},"
            f" {printer.value(velocity)})"
        )


def _all_zero(values: tuple[Scalar, ...]) -> bool:
    return all(isinstance(value, Const) and value.value == 0.0 for value in values)


# Places


def _place_lines(places: Sequence[Placement], supervisor: SupervisorPrinter, printer: Printer) -> list[str]:
    """Return the statements of one layout: bodies with coordinates, then bodies in cells, then bodies at free
    positions."""
    groups = {group.name: group for group in supervisor.scenario.reset.groups}
    return [line for place in _ordered(places) for line in _place(place, groups.get(place.body), printer)]


def _ordered(places: Sequence[Placement]) -> list[Placement]:
    """Return places by how they are found, then in file order; a body that stands on another comes after
    it."""
    ranks = {Region: 2, Top: 2, Cells: 1}
    # `sorted` is stable: places of one rank stay in file order.
    waiting = sorted(places, key=lambda place: ranks.get(type(place.spot), 0))
    ordered: list[Placement] = []
    while waiting:
        bodies = {place.body for place in waiting}
        ready = (
            index
            for index, place in enumerate(waiting)
            if not (isinstance(place.spot, Top) and place.spot.of in bodies)
        )
        ordered.append(waiting.pop(next(ready, 0)))
    return ordered


def _place(place: Placement, group: ObjectGroup | None, printer: Printer) -> list[str]:
    count = printer.value(group.count.scalar) if group else "1"
    body, pad = ("body", "    ") if group else (quoted(place.body), "")
    at_most = "" if place.at_most is None else f", {place.at_most}"
    # A call in the head of a loop could not be cut into lines.
    head = (
        [f"copies = bodies.copies({quoted(place.body)}, {count}{at_most})", "for body in copies:"]
        if group
        else []
    )
    match place.spot:
        case Region() | Top() as spot:
            pose = f"lambda: ({printer.tuple(place.xyz)}, {printer.tuple(place.rpy)})"
            region = spot if isinstance(spot, Region) else spot.region
            area = tuple_code([repr(end) for end in (*region.low, *region.high)]) if region else "None"
            options = _options(place, printer) + (f", mesh={spot.mesh!r}" if spot.mesh else "")
            options += f", on={quoted(spot.of)}" if isinstance(spot, Top) else ""
            return [*head, f"{pad}bodies.find({body}, {area}, {quoted(place.stream)}, {pose}{options})"]
        case Cells(spots):
            table = tuple_code([tuple_code([repr(x), repr(y)]) for x, y in spots])
            xyz = tuple_code(["spot[0]", "spot[1]", printer.value(place.xyz[2])])
            return [
                f"spots = {table}",
                f"cells = bodies.cells({quoted(place.body)}, {count}, spots, {quoted(place.stream)})",
                "for body, spot in cells:",
                f"    bodies.stand(body, {xyz}, {printer.tuple(place.rpy)}{_options(place, printer)})",
            ]
        case _:
            spacing = f", spacing={place.spacing!r}" if group and any(place.spacing) else ""
            xyz, rpy = printer.tuple(place.xyz), printer.tuple(place.rpy)
            return [*head, f"{pad}bodies.stand({body}, {xyz}, {rpy}{_options(place, printer)}{spacing})"]


def _options(place: Placement, printer: Printer) -> str:
    parts = [f", {name}={printer.tuple(values)}" for name, values in place.velocities]
    parts += [", rests=True"] if place.seeks_height else []
    parts += [f", clearance={place.clearance!r}"] if place.clearance else []
    return "".join(parts)


# What varies

_OF_RESPONSE = ("actuator_delay", "actuator_time_constant")


def _is_vector(variation: RandomizedParameter) -> bool:
    """Return whether its values are set together, one for each part of an actuator or each component of a
    sensor."""
    return isinstance(variation.of, OfSensor) or (
        isinstance(variation.of, OfActuator) and variation.what not in _OF_RESPONSE
    )


def _setting(variation: RandomizedParameter, vector: str, values: Sequence[str]) -> str:
    """Return the statement that sets a randomized parameter to a vector or to values."""
    subject = variation.of
    match subject:
        case OfActuator():
            name = variation.what.removeprefix("actuator_")
            drive = f"self.{generated.robot(subject.robot)}.{generated.drive(subject.actuator)}"
            return (
                f"{drive}.response.{name} = {values[0]}"
                if variation.what in _OF_RESPONSE
                else f"{drive}.{name} = {vector}"
            )
        case OfSensor():
            return f"self.vary_sensor({', '.join(map(quoted, subject))}, {vector})"
        case OfWalls():
            return f"self.set_walls({quoted_tuple(subject)}, {values[0]})"
    owner = quoted_tuple(subject)
    if variation.what == "color":
        index, *shares = values
        colors = tuple_code([tuple_code([*shares[at : at + 3], "1.0"]) for at in range(0, len(shares), 3)])
        return f"self.engine.set_parameter({quoted(variation.what)}, {owner}, *{colors}[int({index})])"
    return f"self.engine.set_parameter({quoted(variation.what)}, {owner}, {', '.join(values)})"


# Draws

_PERIOD_ROUNDING = 1e-9
"""The tolerance in s with which a period of a whole number of steps does not become one more by rounding."""


def _print_first_draws(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Print the parameters and values of routes, as they are at the beginning of an episode."""
    for entry in supervisor.scenario.parameters:
        _print_first_period(supervisor, printer, entry, entry.name)
        printer.assign(
            supervisor.parameter(entry.name),
            printer.vector_or_number(entry.components, entry.scalars),
            entry.text,
        )
    for name, value in _settings(supervisor):
        if not isinstance(value.scalar, Const) and not _is_drawn_per_message(value):
            _print_first_period(supervisor, printer, value, name)
            printer.assign(f"self.{name}", printer.value(value.scalar))


def print_redraws(supervisor: SupervisorPrinter, printer: Printer) -> list[tuple[str, str]]:
    """Print the values that a step draws or computes anew before it sends messages; the step is not counted
    yet.

    Returns: For each value the attribute with the time of its next draw, or "" where every step has one, and
    the attribute that has it.
    """
    changing: set[str] = set()
    redrawn = []
    for entry in supervisor.scenario.parameters:
        if entry.redraw is not None or _reads(entry.scalars, changing):
            changing.add(entry.name)
            assignment = (
                f"{supervisor.parameter(entry.name)} ="
                f" {printer.vector_or_number(entry.components, entry.scalars)}"
            )
            redrawn.append(
                (
                    _print_when_due(supervisor, printer, entry, entry.name, assignment),
                    supervisor.parameter(entry.name),
                )
            )
    for name, value in _settings(supervisor):
        if value.period is not None if value.redraw else _reads(value.scalars, changing):
            redrawn.append(
                (
                    _print_when_due(
                        supervisor, printer, value, name, f"self.{name} = {printer.value(value.scalar)}"
                    ),
                    "",
                )
            )
    return redrawn


def print_draws_of_message(printer: Printer, channel: str, route: Route) -> None:
    """Print the values of a route that are drawn for each message, before one is sent."""
    for name, value in route.settings:
        if _is_drawn_per_message(value):
            printer.assign(f"{channel}.{name}", printer.value(value.scalar))


def _settings(supervisor: SupervisorPrinter) -> Iterator[tuple[str, Expression]]:
    """Yield every value of every route, with its attribute."""
    for robot in supervisor.scenario.robots:
        routes: dict[Direction, Route] = {"to_robot": robot.to_route, "from_robot": robot.from_route}
        for direction, route in routes.items():
            channel = generated.channel(robot.name, direction)
            yield from ((f"{channel}.{name}", value) for name, value in route.settings)
    for link in supervisor.scenario.links:
        path = generated.link(link.sender, link.receiver)
        yield from ((f"{path}.{name}", value) for name, value in link.route.settings)


def _is_drawn_per_message(value: Expression) -> bool:
    return value.redraw is not None and value.period is None


def _due(supervisor: SupervisorPrinter, name: str) -> str:
    """Return the attribute with the time (s) from which a value is drawn again."""
    return supervisor.attribute(supervisor.names("due", name))


def _print_first_period(
    supervisor: SupervisorPrinter, printer: Printer, value: Expression, name: str
) -> None:
    if value.period is not None:
        printer.line(f"{_due(supervisor, name)} = {printer.value(value.period)} - {_PERIOD_ROUNDING!r}")


def _print_when_due(
    supervisor: SupervisorPrinter, printer: Printer, value: Expression, name: str, line: str
) -> str:
    """Return the attribute with the time of the next draw, if there is one."""
    if value.period is None:
        printer.line(line)
        return ""
    due = _due(supervisor, name)
    printer.line(f"if {supervisor.tick} * {supervisor.scenario.world.timestep!r} >= {due}:")
    printer.lines += indent([f"{due} += {printer.value(value.period)}", line])
    return due


def _reads(values: Iterable[Scalar], names: set[str]) -> bool:
    return any(leaf.name in names for value in values for leaf in names_in(value))


def _print_stds(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Draw the standard deviations of noise that differ between episodes."""
    scenario = supervisor.scenario
    noisy: list[tuple[str, Noise | None]] = [
        (f"observation.{entry.name}", entry.noise) for entry in scenario.agent.observation
    ]
    noisy += [(f"augment.{entry.name}", entry.noise) for entry in scenario.signals]
    noisy += [("goal.achieved", scenario.agent.goal.achieved.noise)] if scenario.agent.goal else []
    for stream, noise in noisy:
        if noise is not None and not all(isinstance(std, Const) for std in noise.std.scalars):
            printer.assign(
                std_attribute(supervisor, stream),
                printer.vector_or_number(noise.std.scalars[1:], noise.std.scalars),
            )


def std_attribute(supervisor: SupervisorPrinter, stream: str) -> str:
    """Return the attribute with the standard deviations of a noise that every episode draws."""
    return supervisor.attribute(supervisor.names.identifier(f"std {stream}", "std", stream.partition(".")[2]))


# Disturbances


def bind_pushes(supervisor: SupervisorPrinter) -> list[str]:
    """Return statements that bind the pushers of `engine`."""
    substep = supervisor.scenario.world.timestep / supervisor.scenario.world.substeps
    return [
        f"self.{generated.push(push.name)} = Push(engine, ({quoted(push.body)},"
        f" {quoted(push.link) if push.link else None}), "
        f"self._draw_{push.name}, {substep!r})"
        for push in supervisor.scenario.disturbances
    ]


def _print_first_pushes(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Print the statements of a reset that set when the first push of each disturbance begins."""
    settling = (
        round(supervisor.scenario.reset.settle / supervisor.scenario.world.timestep)
        * supervisor.scenario.world.substeps
    )
    for push in supervisor.scenario.disturbances:
        printer.line(f"self.{generated.push(push.name)}.reset({printer.value(push.begins)}, {settling})")


def push_methods(supervisor: SupervisorPrinter) -> list[str]:
    """Return the methods that draw a push."""
    return [line for push in supervisor.scenario.disturbances for line in _drawing(supervisor, push)]


def _drawing(supervisor: SupervisorPrinter, push: Disturbance) -> list[str]:
    printer = supervisor.printer()
    force, torque = (printer.tuple(vector) for vector in push.wrench)
    duration = printer.value(push.duration.scalar)
    interval = "inf" if push.every is None else printer.value(push.every.scalar)
    printer.line(f"return {force}, {torque}, {duration}, {interval}")
    doc = '"""Force, torque and duration of a push, and the time from its beginning to that of the next."""'
    return block(f"def _draw_{push.name}(self) -> Any:", printer.method_lines([doc]))
