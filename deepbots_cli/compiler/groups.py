"""Groups: objects of which an episode has several copies, or as many as it draws."""

from __future__ import annotations

import math

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.types import Context, Stage
from deepbots_cli.program.resets import Group
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import MAX_BODIES
from deepbots_cli.scenario.world import Placed


def group(name: str, thing: Placed, namespace: Namespace) -> Group | None:
    """The group that an object with a `count` is; None after a finding.

    There are as many bodies as the greatest count asks for, and one at least; an episode without copies leaves them absent.
    """
    values = namespace.values
    path: Path = ("objects", name, "count")
    text = values.text(path, thing.count)
    typed = values.quantity(text, "`count`", ParameterScope(namespace, Context.FIELD), NUMBER, None, Stage.EPISODE)
    if typed is None:
        return None
    reach = typed.type.interval
    if not math.isfinite(reach.high):
        values.findings.add("DB105", text.span, "a count without a greatest value", help="draw it from a range: `integer(1 .. 10)`")
        return None
    if reach.high > MAX_BODIES:
        help = "an engine would take minutes to build it"
        values.findings.add("DB005", text.span, f"{reach.high:_.0f} copies, more than {MAX_BODIES}", help=help)
        return None
    return Group(name, max(1, int(reach.high)), Expression("count", text.span, text.text, typed, ".".join(map(str, path))))
