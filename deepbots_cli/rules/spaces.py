"""Rules about what the policy sees and does."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.namespace import Origin
from deepbots_cli.diagnostics import Finding


def privileged_observation(checked: Checked) -> Iterator[Finding]:
    """DB609: the policy is shown a signal or a parameter that `augment` does not grant.

    Both are the supervisor's alone: on a real robot nothing would measure them. Granting them says that this is meant.
    """
    if checked.task is None or checked.namespace is None:
        return
    for observed in checked.task.observation:
        head = observed.value.name.partition(".")[0]
        origin = checked.namespace.origin(head)
        if origin in (Origin.SIGNAL, Origin.PARAMETER) and head not in checked.task.augmented:
            helps = "move it to `augment`" if origin is Origin.SIGNAL else f"grant it: `augment: [{head}]`"
            headline = f"the policy sees `{observed.value.name}`, {origin.value} that it is not granted"
            yield Finding("DB609", observed.value.span, headline, help=helps)
