"""Prints the goal: what is achieved and desired as the policy sees it, and as the names in rewards mean it.

Both are mapped to [-1, 1], clipped and rounded to float32, and mapped back: a reward that is recomputed from what was
seen is then the same reward. So is one with noise on what is achieved, since the noise is added before.
"""

from __future__ import annotations

from deepbots_cli.codegen.observation import print_noise
from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.text import block, docstring, targets_code
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.expressions.printer import operand


def compute_reward(space: Workspace) -> list[str]:
    """The method that hindsight replay asks for; nothing without a goal."""
    if space.scenario.goal is None:
        return []
    doc = docstring("The reward for other goals, as the policy sees them: arrays (n, k) or (k,).")
    head = "def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any = None) -> Any:"
    return block(head, [*doc, "return self.reward_for(achieved_goal, desired_goal)"])


def print_goal(space: Workspace, printer: Printer) -> None:
    """Set `achieved`, `desired` and `goal_reached`."""
    goal = space.scenario.goal
    if goal is None:
        return
    locals_, back = [], []
    noisy = [space.local(name.name, name.component) for name in goal.names("achieved")] if goal.achieved.noise else []
    for local, value in zip(noisy, goal.achieved.scalars, strict=False):
        printer.assign(local, value)
    print_noise(space, printer, "goal.achieved", noisy)
    for names, values in ((goal.names("achieved"), goal.achieved.scalars), (goal.names("desired"), goal.targets)):
        for name, value, low, high in zip(names, values, goal.low, goal.high, strict=True):
            half, middle = (high - low) / 2, (high + low) / 2
            local = space.local(name.name, name.component)
            code = local if local in noisy else operand(printer.value(value))
            printer.line(f"{local} = {f'({code} - {middle!r})' if middle else code} / {half!r}")
            printer.line(f"if not -1.0 <= {local} <= 1.0:")
            printer.line(f"    {local} = clipped({local})")
            locals_.append(local)
            back.append(f"{middle!r} + {half!r} * {local}")
    printer.line(f"self.pack_goal({', '.join(['self.goal', '0', *locals_])})")
    printer.line(f"{targets_code(locals_)} = self.goal.tolist()")
    printer.lines += [f"{local} = {code}" for local, code in zip(locals_, back, strict=True)]
    printer.assign(space.local("goal_reached"), goal.reached)
