"""Prints `_begin`: what an episode varies, and the world as it begins; language reference, "Reset"."""

from __future__ import annotations

from deepbots_cli.compiler.emit.driving import Driving
from deepbots_cli.compiler.emit.observation import deviation
from deepbots_cli.compiler.emit.printer import Printer
from deepbots_cli.compiler.emit.redraws import print_first_draws
from deepbots_cli.compiler.emit.text import block, quoted, tuple_code
from deepbots_cli.compiler.emit.variations import setting
from deepbots_cli.compiler.emit.workspace import Workspace
from deepbots_cli.lang.scalar import Const, Name, Scalar, World


def begin(space: Workspace) -> list[str]:
    """Draws in order of dependency, then variations, places, joints; the actuators hold while the world settles."""
    scenario, reset = space.scenario, space.scenario.reset
    printer = Printer(lambda leaf: _at_reset(space, leaf), space.names, scenario.world.timestep)
    printer.line('"""Draw what this episode varies, and put the world where it begins."""')
    print_first_draws(space, printer)
    for observed in scenario.observation:
        if observed.noise is not None and not isinstance(observed.noise.deviation, Const):
            printer.assign(deviation(space, observed), observed.noise.deviation)
    printer.line("self.engine.reset()")
    for variation in reset.variations:
        printer.line(setting(variation, [printer.value(value) for value in variation.values]))
    printer.lines += [f"self.robot_{robot.name}.release()" for robot in scenario.robots if Driving(scenario, robot).has_devices]
    for place in reset.places:
        xyz, rpy = (tuple_code([printer.value(value) for value in values]) for values in (place.xyz, place.rpy))
        turn = "(0.0, 0.0, 0.0, 1.0)" if _all_zero(place.rpy) else f"quaternion{rpy}"
        printer.line(f"self.engine.place({quoted(place.body)}, {xyz}, {turn})")
    for joint in reset.joints:
        where = f"{quoted(joint.robot)}, {quoted(joint.joint)}"
        printer.line(f"self.engine.set_joint({where}, {printer.value(joint.position)}, {printer.value(joint.velocity)})")
    ticks = round(reset.settle / scenario.world.timestep)
    if ticks:
        printer.lines += [f"self.robot_{robot.name}.hold()" for robot in scenario.robots if Driving(scenario, robot).has_any]
        printer.line(f"self.physics({ticks * scenario.world.substeps})")
    return block("def _begin(self) -> None:", printer.lines)


def _at_reset(space: Workspace, leaf: Name | World) -> str:
    if isinstance(leaf, World):
        raise TypeError(f"{leaf.function} cannot be read while a reset is under way")
    return space.parameter(leaf.name, leaf.component)


def _all_zero(values: tuple[Scalar, ...]) -> bool:
    return all(isinstance(value, Const) and value.value == 0.0 for value in values)
