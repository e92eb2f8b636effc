"""Prints hand-written policies: a method for each, which tells its next action from what the last tick left.

It is called between two steps, by who asks for it; a step computes nothing for it. What robots sent and what signals came to
is gone by then, so a tick keeps of these what scripts read (0.02 us per number).
"""

from __future__ import annotations

from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.text import action_variables, block, docstring, tuple_code
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.expressions.lower import op
from deepbots_cli.expressions.scalar import Const, Scalar
from deepbots_cli.program.task import ActionRange, Choices, Script, ScriptedChoice, ScriptedRange


def scripts(space: Workspace) -> list[list[str]]:
    return [_method(space, script) for script in space.scenario.scripts]


def _method(space: Workspace, script: Script) -> list[str]:
    printer = space.printer(between=True)
    printer.line(docstring(f"The next action of the script {script.name}.")[0])
    used = space.named(script.scalars)
    printer.lines += [f"{space.local(*name)} = self.told_{space.local(*name)}" for name in space.kept() if name in used]
    printer.lines += space.reads.call_lines(script.scalars)
    choices, ranges = [], []
    for part, decided in zip(space.scenario.action, script.parts, strict=True):
        if isinstance(part, Choices) and isinstance(decided, ScriptedChoice):
            choices.append(_print_pick(space, printer, part, decided))
        elif isinstance(part, ActionRange) and isinstance(decided, ScriptedRange):
            ranges += _print_aim(space, printer, part, decided)
    printer.line(f"return self.acting({tuple_code(choices) if choices else '()'}, {tuple_code(ranges) if ranges else '()'})")
    return block(f"def script_{script.name}(self) -> Any:", printer.lines)


def _print_pick(space: Workspace, printer: Printer, part: Choices, pick: ScriptedChoice) -> str:
    """The local that holds the number of the option."""
    target, names = space.names(f"{part.name} pick"), [option.name for option in part.options]
    for index, option in enumerate(pick.options):
        setting = f"{target} = {names.index(option)}  # {option}"
        if len(pick.options) == 1:
            printer.line(setting)
            break
        last = index == len(pick.scalars)
        head = "else:" if last else f"{'elif' if index else 'if'} {printer.value(pick.scalars[index])}:"
        printer.lines += [head, f"    {setting}"]
    return target


def _print_aim(space: Workspace, printer: Printer, part: ActionRange, aim: ScriptedRange) -> list[str]:
    """The locals that hold what the agent gives for it, from -1 to 1."""
    half, middle = (part.high - part.low) / 2, (part.high + part.low) / 2
    targets = []
    for (name, component), value in zip(action_variables(part), aim.scalars, strict=True):
        target = space.names(f"{name} share", component)
        share = _share(value, middle, half)
        printer.assign(target, share)
        if not isinstance(share, Const):
            printer.line(f"if not -1.0 <= {target} <= 1.0:")
            printer.line(f"    {target} = clipped({target})")
        targets.append(target)
    return targets


def _share(value: Scalar, middle: float, half: float) -> Scalar:
    """Where in [-1, 1] the agent's number stands for the value; a constant is clamped here."""
    share = op("div", op("sub", value, Const(middle)), Const(half))
    return Const(min(max(float(share.value), -1.0), 1.0)) if isinstance(share, Const) else share
