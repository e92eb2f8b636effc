"""What may stand at a place of an expression that is being written: names, parts of the world, functions, units, words."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from lsprotocol.types import CompletionItemKind

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.inventory import definition
from deepbots_cli.compiler.namespace import ParameterScope, RobotScope, SupervisorScope
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.check import check
from deepbots_cli.expressions.dimensions import UNITS, Unit
from deepbots_cli.expressions.functions import ALLOWED, FUNCTIONS, Family, Form, Param
from deepbots_cli.expressions.types import Context, Kind, Scope, Type
from deepbots_cli.lsp.analysing import Analysis
from deepbots_cli.lsp.describing import of_function, of_symbol
from deepbots_cli.lsp.pointing import ignored
from deepbots_cli.scenario.fields import MEASURES, Column, Expression, FieldType, Quantity, Range

_WORD = re.compile(r"[A-Za-z_][\w.]*$")
_BEHIND_NUMBER = re.compile(r"(?<![A-Za-z_\d])(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?:\s+|\s*(?:[A-Za-z%]+(?:\^-?\d)?[*/])+)?$")
_GRAMMAR = {
    "when": "`a when c`: a where the condition holds, else 0",
    "and": "both conditions hold",
    "or": "one of the conditions holds",
    "not": "the condition does not hold",
    "true": "always holds",
    "false": "never holds",
}
_REPEATS = {"every": "draws anew each so often: `uniform(0 .. 1) every 5 s`", "each step": "draws anew in every step"}
_CONTEXTS = {"field": Context.FIXED, "require": Context.REQUIRE, "parameter": Context.PARAMETER}
_ON_BOARD = ("emit", "apply")
BODY = "body or link"
_MOST = 1000
_FURTHEST = 2000
"""So many characters before the place brackets are looked for."""


class Choice(NamedTuple):
    """Something to write: what it is in a few words (`detail`), and at length."""

    text: str
    kind: CompletionItemKind
    detail: str
    doc: str = ""


def is_expression(leaf: FieldType) -> bool:
    return isinstance(leaf, (Expression, Quantity, Range, Column))


def scope_of(analysis: Analysis, leaf: FieldType, path: Path) -> Scope | None:
    """What an expression at `path`, of a field of this kind, may see."""
    checked = analysis.checked
    if checked is None or checked.namespace is None:
        return None
    if not isinstance(leaf, Expression):
        drawn = isinstance(leaf, Quantity) and leaf.stage != "fixed"
        return ParameterScope(checked.namespace, Context.FIELD if drawn else Context.FIXED)
    if leaf.context in _CONTEXTS:
        return ParameterScope(checked.namespace, _CONTEXTS[leaf.context])
    context = Context[leaf.context.upper()]
    if leaf.context not in _ON_BOARD:
        return SupervisorScope(checked.namespace, context)
    robot = str(path[1]) if len(path) > 1 else ""
    known = [reading.scope for reading in analysis.readings if isinstance(reading.scope, RobotScope) and reading.scope.robot == robot]
    same = next((scope for scope in known if scope.context is context), known[0] if known else None)
    return RobotScope(checked.namespace, context, robot, dict(same.own) if same else {})


def begun(text: str) -> str:
    """The name that is being written at the end of `text`."""
    found = _WORD.search(text)
    return found.group() if found else ""


def awaits_unit(text: str) -> bool:
    """Whether a number ends there, or a unit that a `*` or `/` goes on."""
    word = begun(text)
    return "." not in word and _BEHIND_NUMBER.search(text[: len(text) - len(word)]) is not None


def awaited(text: str, leaf: FieldType) -> str:
    """What kind of name may come at the end of `text`, in the words of `written`."""
    word = begun(text)
    if _subjects(text[: len(text) - len(word)]) is not None:
        return BODY
    if not isinstance(leaf, Expression) or leaf.context in _CONTEXTS:
        return "setting"
    return "value on board" if leaf.context in _ON_BOARD else "value"


def choices(text: str, scope: Scope, checked: Checked) -> Iterator[Choice]:
    """What may come at the end of `text`, in the place of the name that is begun there; units apart."""
    word = begun(text)
    before = text[: len(text) - len(word)]
    kinds = _subjects(before)
    if kinds is not None:
        yield from _parts(scope, kinds)
        return
    if before.endswith(")."):
        yield from _components_of_call(before[:-1], scope)
        return
    if "." in word:
        yield from _components(word.rpartition(".")[0], scope)
    yield from _names(scope, checked)
    yield from functions(ALLOWED[scope.context])
    for said, doc in {**_GRAMMAR, **(_REPEATS if scope.context is Context.PARAMETER else {})}.items():
        yield Choice(said, CompletionItemKind.Keyword, "", doc)


def units(text: str, leaf: FieldType) -> Iterator[Choice]:
    """All of them, those in which a field of this kind is measured first, and what may follow a plain number.

    What goes on behind a `*` or `/` is a single one, and no `N*m`.
    """
    goes_on = text[: len(text) - len(begun(text))].endswith(("*", "/"))
    wanted = [unit for measure in _measures(leaf) if (unit := _unit(measure)) is not None]
    if not goes_on:
        yield from (Choice(unit.text, CompletionItemKind.Unit, unit.dimension.words) for unit in wanted if unit.text not in UNITS)
    dimensions = [unit.dimension for unit in wanted]
    for unit in sorted(UNITS.values(), key=lambda unit: unit.dimension not in dimensions):
        yield Choice(unit.text, CompletionItemKind.Unit, unit.dimension.words)
    if isinstance(leaf, Expression) and not goes_on:
        yield from (Choice(word, CompletionItemKind.Keyword, "", _GRAMMAR[word]) for word in ("when", "and", "or"))


def _measures(leaf: FieldType) -> list[str]:
    if not isinstance(leaf, (Quantity, Range, Column)):
        return []
    return [measure for measure in (leaf.dimension, *leaf.dimension.split(" or ")) if measure in MEASURES and measure != "any"]


def _unit(measure: str) -> Unit | None:
    """That of the example of a measure."""
    tree = parser.parse(MEASURES[measure][1], ignored)
    return tree.unit if isinstance(tree, syntax.Number) else None


def functions(families: frozenset[Family]) -> Iterator[Choice]:
    """The functions of these families."""
    for function in FUNCTIONS.values():
        if function.family in families:
            yield Choice(f"{function.name}(", CompletionItemKind.Function, function.signature, of_function(function))


def _names(scope: Scope, checked: Checked) -> Iterator[Choice]:
    robot = scope.robot if isinstance(scope, RobotScope) else None
    for name in list(dict.fromkeys(scope.names()))[:_MOST]:
        symbol = scope.lookup(name)
        if symbol is not None and symbol.refused is None:
            found = definition(checked, name, robot)
            yield Choice(name, CompletionItemKind.Variable, of_symbol(symbol), found.what if found else "built in")


def _components(name: str, scope: Scope) -> Iterator[Choice]:
    """`name.x` and the like, where the name is that of a vector."""
    symbol = scope.lookup(name)
    return _picked(symbol.type if symbol else None, f"{name}.")


def _components_of_call(text: str, scope: Scope) -> Iterator[Choice]:
    """`x` and the like, where the function that is called at the end of the text gives a vector."""
    depth = 0
    for index in range(len(text) - 1, max(-1, len(text) - _FURTHEST), -1):
        depth += {")": 1, "(": -1}.get(text[index], 0)
        if depth == 0:
            break
    begin = index - len(begun(text[:index]))
    tree = parser.parse(text[begin:], ignored)
    known = check(tree, scope, ignored) if tree is not None else None
    return _picked(known.type if known else None, "")


def _picked(vector: Type | None, before: str) -> Iterator[Choice]:
    """What can be picked out of a vector: each component, and what lies in the plane."""
    components = (vector and vector.components) or ()
    for picked in (*components, *(("xy",) if components == ("x", "y", "z") else ())):
        words = vector._replace(components=None).words if vector else ""
        yield Choice(f"{before}{picked}", CompletionItemKind.Field, words)


def _parts(scope: Scope, kinds: frozenset[Kind]) -> Iterator[Choice]:
    for name in list(dict.fromkeys((*scope.subjects(), "ground")))[:_MOST]:
        subject = scope.subject(name, kinds)
        if subject is not None and subject.kind in kinds:
            yield Choice(name, CompletionItemKind.Reference, subject.kind.words)


def _subjects(before: str) -> frozenset[Kind] | None:
    """Which parts of the world the argument that begins here may name; None where it is a value, or no argument at all."""
    called = _call(before)
    if called is None:
        return None
    name, index = called
    function = FUNCTIONS.get(name)
    params: tuple[Param, ...] = function.params if function is not None else ()
    if not params or (function is not None and function.family is Family.DRAW):
        return None
    param = params[min(index, len(params) - 1)]
    return param.kinds if param.form is Form.SUBJECT and not before.rstrip().endswith(("+", "-", "*", "/")) else None


def _call(before: str) -> tuple[str, int] | None:
    """The function whose brackets are open at the end of the text, and which of its arguments that is."""
    depth = commas = 0
    for index in range(len(before) - 1, max(-1, len(before) - _FURTHEST), -1):
        sign = before[index]
        if sign == ")":
            depth += 1
        elif sign == "," and depth == 0:
            commas += 1
        elif sign == "(" and depth:
            depth -= 1
        elif sign == "(":
            found = _WORD.search(before[:index])
            return (found.group(), commas) if found else None
    return None
