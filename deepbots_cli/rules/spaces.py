"""Rules about what the policy sees and does."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.namespace import Origin
from deepbots_cli.diagnostics import Finding
from deepbots_cli.lang.functions import Family
from deepbots_cli.lang.table import FUNCTIONS
from deepbots_cli.lang.typed import Invocation, Reference, Typed, children
from deepbots_cli.task import Task


def privileged_observation(checked: Checked) -> Iterator[Finding]:
    """DB609: the policy is shown a signal or a parameter that `augment` does not grant, and that is not made of what arrives anyway.

    The supervisor alone knows the world and what was drawn: on a real robot nothing would measure them. Granting them says
    that this is meant. What robots send, when it came, what the agent did and the time need no grant.
    """
    if checked.task is None or checked.namespace is None:
        return
    privileged = _privileged(checked.task)
    for observed in checked.task.observation:
        head = observed.value.name.partition(".")[0]
        if head in privileged:
            origin = checked.namespace.origin(head)
            helps = "move it to `augment`" if origin is Origin.SIGNAL else f"grant it: `augment: [{head}]`"
            what = Origin.SIGNAL.value if origin is Origin.SIGNAL else Origin.PARAMETER.value
            headline = f"the policy sees `{observed.value.name}`, {what} that it is not granted"
            yield Finding("DB609", observed.value.span, headline, help=helps)


def _privileged(task: Task) -> set[str]:
    """Drawn parameters, and signals that are made of them or of the world, without those that `augment` grants."""
    found = {value.name for value in task.parameters} - task.augmented
    for value in task.order:
        if value.name not in task.augmented and _tells(value.typed, found):
            found.add(value.name)
    return found


def _tells(value: Typed, privileged: set[str]) -> bool:
    if isinstance(value, Reference):
        return value.symbol.name in privileged
    if isinstance(value, Invocation) and FUNCTIONS[value.function].family is Family.WORLD:
        return True
    return any(_tells(part, privileged) for part in children(value))
