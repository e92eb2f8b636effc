"""What keys, functions, types and findings are, in a few lines of Markdown."""

from __future__ import annotations

from collections.abc import Iterable

from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.expressions.functions import Function
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.types import Shape as PictureShape
from deepbots_cli.expressions.types import Symbol, Type, shown
from deepbots_cli.lint.pages import pages_of
from deepbots_cli.scenario.base import Section, Shape, fields, noun_of

_LONGEST = 120


def brief(part: type[Section], key: str) -> str:
    """The same in a few words, behind the key in a list."""
    noun = noun_of(fields(part)[key])
    return noun if len(noun) <= _LONGEST else f"{noun[:_LONGEST]}…"


def of_kind(spec: Shape) -> str:
    """What a value of a spec is, with an example where there is one."""
    example = getattr(spec, "example", None)
    return f"{noun_of(spec)}, such as `{example}`" if example else noun_of(spec)


def of_function(function: Function) -> str:
    lines = ["```text", function.signature, "```", function.doc]
    return "\n".join(lines + (["", f"For example `{function.example}`."] if function.example else []))


def of_type(known: Type) -> str:
    """Dimension, components, interval and stage: `a length (m), from 0 to 2.7 m, fixed`."""
    if known.picture is not None:
        return _picture(known.picture)
    words = [known.words]
    if known.components is not None:
        words.append(f"with the components {shown(known.components)}")
    if not known.boolean and known.interval != EVERYTHING:
        words.append(_reach(known.interval, str(known.dimension)))
    return ", ".join([*words, known.stage.words])


def _picture(shape: PictureShape) -> str:
    rows, columns, channels = shape
    return f"a picture of {columns} x {rows} pixels with {channels} channel{'s' if channels > 1 else ''}"


def _reach(interval: Interval, dimension: str) -> str:
    unit = "" if dimension == "1" else f" {dimension}"
    if interval.single:
        return f"{interval.low:.6g}{unit}"
    if not interval.finite:
        low, high = interval.low > -float("inf"), interval.high < float("inf")
        return f"at least {interval.low:.6g}{unit}" if low else f"at most {interval.high:.6g}{unit}" if high else ""
    return f"from {interval.low:.6g} to {interval.high:.6g}{unit}"


def of_symbol(symbol: Symbol) -> str:
    """What is known of a name; why it has no value here, if it has none."""
    if symbol.refused is not None:
        return f"no value here: {symbol.refused}"
    if symbol.type is None:
        return "its definition has a finding"
    text = of_type(symbol.type)
    is_vector = symbol.value is not None and len(symbol.value) > 1
    return f"{text}: {_figures(symbol.value)}" if is_vector and symbol.value else text


def _figures(values: Iterable[float | bool]) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def of_finding(code: str) -> str | None:
    """The page of a finding by its code; None where there is no such code."""
    rule = RULES.get(code)
    if rule is None:
        return None
    head = f"**{code}** {rule.name} ({rule.severity}{', in preview' if rule.preview else ''}): {rule.summary}"
    return "\n\n".join([head, *(page.markdown() for page in pages_of(code))])
