"""Prints what a step and a tick do, and the moment after a reset.

A step of the agent decodes its action, sends one message to each robot, and goes on for `repeat` ticks
or until the episode ends. With one tick per step both are one method, as a call costs 0.1 us.
"""

from __future__ import annotations

from deepbots_cli.codegen.action import print_decoding
from deepbots_cli.codegen.evaluation import print_evaluation
from deepbots_cli.codegen.messages import print_delivering, print_first_telling, print_keeping, print_receiving, print_sending
from deepbots_cli.codegen.observation import print_next_frame
from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.redraws import print_redraws
from deepbots_cli.codegen.text import block
from deepbots_cli.codegen.workspace import Workspace


def start(space: Workspace) -> list[str]:
    """The method that runs right after a reset."""
    printer = space.printer(starting=True)
    printer.line('"""Receive the first messages and compute what the first observation needs."""')
    zeros = _acting(space)
    printer.lines += space.reads.start_lines()
    if zeros:
        printer.line(" = ".join([*zeros, "0.0"]))
    for robot in space.scenario.robots:
        print_receiving(space, printer, robot, first=True)
    print_evaluation(space, printer)
    print_first_telling(space, printer)
    return block("def _start(self) -> None:", printer.lines)


def advance(space: Workspace) -> list[str]:
    """The method of a step, and that of a tick where a step has several."""
    printer = space.printer()
    if not space.repeats:
        printer.line('"""One tick: act, let the world go on, receive, and compute all that is read afterwards."""')
        _print_acting(space, printer)
        _print_tick(space, printer)
        return block(f"def _advance(self, action: Any) -> {_result(space)}:", printer.lines)
    repeat, acting = space.scenario.agent.repeat, _acting(space)
    printer.line(f'"""Hold an action for {repeat} ticks; the reward is the sum over them."""')
    _print_acting(space, printer)
    if space.uses("previous_reward"):
        printer.line("self.previous_reward = self.reward")
    printer.line(f"self.reward = {' = '.join(f'self.term_{term.name}' for term in space.scenario.reward)} = 0.0")
    printer.line(f"for _ in range({repeat}):")
    printer.line(f"    {'yield from ' if space.shares else ''}self._tick({', '.join(acting)})")
    printer.line("    if self.terminated or self.truncated:")
    printer.line("        break")
    ticking = space.printer()
    ticking.line('"""One tick: let the world go on, receive, and compute all that is read afterwards."""')
    ticking.line("self.tick_count += 1")
    _print_tick(space, ticking)
    arguments = ", ".join(["self", *(f"{name}: float" for name in acting)])
    return [
        *block(f"def _advance(self, action: Any) -> {_result(space)}:", printer.lines),
        *block(f"def _tick({arguments}) -> {_result(space)}:", ticking.lines),
    ]


def _result(space: Workspace) -> str:
    return "Iterator[None]" if space.shares else "None"


def _acting(space: Workspace) -> list[str]:
    """What the expressions of a tick read of the action: variables, and what the agent itself gave."""
    return [space.local(*variable) for variable in [*(v for v in space.variables if space.uses(v[0])), *space.taken]]


def _print_acting(space: Workspace, printer: Printer) -> None:
    """What happens once per step: the action, and the messages that carry it."""
    print_decoding(space, printer)
    print_redraws(space, printer)
    printer.line("self.step_count += 1")
    print_next_frame(space, printer)
    printer.lines += [f"{local} = self.told_{local}" for local in space.told()]
    printer.lines += space.reads.call_lines(space.sent)
    for robot in space.scenario.robots:
        print_sending(space, printer, robot)


def _print_tick(space: Workspace, printer: Printer) -> None:
    for robot in space.scenario.robots:
        print_delivering(space, printer, robot)
    if space.shares:
        printer.line("yield  # the world goes on when every copy has acted")
    else:
        printer.line(f"self.physics({space.scenario.world.substeps})")
    for robot in space.scenario.robots:
        print_receiving(space, printer, robot, first=False)
    print_evaluation(space, printer)
    print_keeping(space, printer)
