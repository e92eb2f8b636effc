"""Terms that are functions of an installed package: reported always, refused unless the user allows code.

Their modules are imported when an environment is made, and never to compile or to lint.
"""

from __future__ import annotations

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.intervals import TRUTH, Interval
from deepbots_cli.expressions.types import Constant, Stage, Type
from deepbots_cli.program.values import Expression, Foreign
from deepbots_cli.scenario.task import PythonTerm


def foreign(name: str, given: PythonTerm, path: Path, namespace: Namespace, *, boolean: bool) -> Expression:
    """The term at `path`, of which nothing is known but whether it is a truth value."""
    values = namespace.values
    text = values.text((*path, "python"), given.python)
    if namespace.document.allow_code:
        headline = f"`{name}` runs Python code: {given.python}"
        values.findings.add("DB410", text.span, headline, help="say what it computes as an expression, if the language can")
    else:
        help = "write an expression, or allow it with --allow-code if you trust the package"
        values.findings.add("DB409", text.span, f"`{name}` would run Python code: {given.python}", help=help)
    module, _, function = given.python.partition(":")
    kind = Type(boolean=boolean, interval=TRUTH if boolean else Interval(float("-inf"), float("inf")), stage=Stage.STEP)
    nothing = Constant(kind, 0, len(text.text), (False if boolean else 0.0,))
    return Expression(name, text.span, text.text, nothing, ".".join(map(str, path)), foreign=Foreign(module, function))
