"""Prints `_begin`: what an episode varies, and the world as it begins; language reference, "Reset".

Where everything has its place, the bodies are simply put there. Where something looks for a place, where
the start is required to be some way, or where copies come and go, `_arrange` is one attempt at it.
"""

from __future__ import annotations

from deepbots_cli.codegen.driving import Driving
from deepbots_cli.codegen.observation import print_deviations
from deepbots_cli.codegen.placing import is_sought, place_lines
from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.pushes import print_first_pushes
from deepbots_cli.codegen.redraws import print_first_draws
from deepbots_cli.codegen.text import block, quoted, tuple_code
from deepbots_cli.codegen.variations import setting
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.expressions.scalar import Const, Name, Scalar, World
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement, Reset


def begin(space: Workspace) -> list[str]:
    """Draws in order of dependency, then variations, places, joints; the actuators hold until their first commands."""
    scenario, reset = space.scenario, space.scenario.reset
    printer = _printer(space)
    printer.line('"""Draw what this episode varies, and put the world where it begins."""')
    print_first_draws(space, printer)
    print_deviations(space, printer)
    if is_arranged(scenario):
        for index, variation in enumerate(reset.variations):
            for number, value in enumerate(variation.scalars):
                printer.assign(_varied(space, index, number), value)
        printer.line(f"self.bodies.arrange(self._arrange, {reset.attempts}, self.streams)")
    else:
        printer.line("self.engine.reset()")
        for variation in reset.variations:
            printer.line(setting(variation, [printer.value(value) for value in variation.scalars]))
        printer.lines += _releasing(scenario)
        for place in reset.placements:
            printer.line(_placing(place, printer))
        _print_joints(reset, printer)
        printer.lines += _forgetting(space)
    print_first_pushes(space, printer)
    printer.lines += [f"self.robot_{robot.name}.hold()" for robot in scenario.robots if Driving(scenario, robot).has_any]
    ticks = round(reset.settle / scenario.world.timestep)
    if ticks:
        printer.line(f"self.physics({ticks * scenario.world.substeps})")
    method = block("def _begin(self) -> None:", printer.lines)
    return [*method, *_arrange(space)] if is_arranged(scenario) else method


def is_arranged(scenario: Program) -> bool:
    """Whether the places of an episode have to be found."""
    reset = scenario.reset
    drawn = reset.groups or reset.layouts or reset.require is not None
    pooled = any(thing.pooled for thing in scenario.world.objects)
    return bool(drawn) or pooled or scenario.world.terrain is not None or any(is_sought(place) for place in reset.placements)


def _arrange(space: Workspace) -> list[str]:
    """The method that is one attempt at a start."""
    reset = space.scenario.reset
    printer = _printer(space)
    printer.line('"""One attempt at a start: a place for each body; whether it is as required."""')
    printer.line("bodies = self.bodies")
    printer.lines += place_lines(reset.placements, space, printer)
    shares = ", ".join(f"({quoted(layout.name)}, {layout.share!r})" for layout in reset.layouts)
    if len(reset.layouts) > 1:
        printer.line(f'layout = bodies.layout("reset.layout", {shares})')
    for index, layout in enumerate(reset.layouts):
        lines = place_lines(layout.placements, space, printer) or ["pass"]
        if len(reset.layouts) > 1:
            printer.line(f"{'elif' if index else 'if'} layout == {quoted(layout.name)}:")
            lines = [f"    {line}" for line in lines]
        printer.lines += lines
    printer.lines += [f"{space.present(group.name)} = bodies.present[{quoted(group.name)}]" for group in reset.groups]
    printer.line("self.engine.reset()")
    if any(thing.variants for thing in space.scenario.world.objects):
        printer.line("bodies.choose()")
    for index, variation in enumerate(reset.variations):
        printer.line(setting(variation, [_varied(space, index, number) for number in range(len(variation.scalars))]))
    printer.lines += _releasing(space.scenario)
    printer.line("bodies.put()")
    _print_joints(reset, printer)
    printer.lines += _forgetting(space)
    if reset.require is None:
        printer.line("return True")
    else:
        printer.lines += space.reads.call_lines([reset.require.scalar])
        printer.line(f"return bool({printer.value(reset.require.scalar)})")
    return block("def _arrange(self) -> bool:", printer.lines)


def _releasing(scenario: Program) -> list[str]:
    """Statements after which no actuator remembers the episode before."""
    return [f"self.robot_{robot.name}.release()" for robot in scenario.robots if Driving(scenario, robot).has_devices]


def _forgetting(space: Workspace) -> list[str]:
    """Statements after which no chart shows the episode before."""
    return ["self.ways.reset()"] if space.reads.charts else []


def _printer(space: Workspace) -> Printer:
    return Printer(lambda leaf: _at_reset(space, leaf), space.names, space.scenario.world.timestep, settable=space.settable)


def _at_reset(space: Workspace, leaf: Name | World) -> str:
    return space.fact(leaf) if isinstance(leaf, World) else space.parameter(leaf.name, leaf.component)


def _varied(space: Workspace, index: int, number: int) -> str:
    """The attribute that holds a varied figure while places are looked for."""
    return f"self.{space.names(f'varied {index}.{number}')}"


def _placing(place: Placement, printer: Printer) -> str:
    """The statement that places a body whose place is known."""
    xyz, rpy = (tuple_code([printer.value(value) for value in values]) for values in (place.xyz, place.rpy))
    turn = "(0.0, 0.0, 0.0, 1.0)" if _all_zero(place.rpy) else f"quaternion{rpy}"
    moving = "".join(f", {name}={tuple_code([printer.value(value) for value in values])}" for name, values in place.velocities)
    return f"self.engine.place({quoted(place.body)}, {xyz}, {turn}{moving})"


def _print_joints(reset: Reset, printer: Printer) -> None:
    for start in reset.joint_starts:
        for joint, position, velocity in start.states:
            where = f"{quoted(start.robot)}, {quoted(joint)}"
            printer.line(f"self.engine.set_joint({where}, {printer.value(position)}, {printer.value(velocity)})")


def _all_zero(values: tuple[Scalar, ...]) -> bool:
    return all(isinstance(value, Const) and value.value == 0.0 for value in values)
