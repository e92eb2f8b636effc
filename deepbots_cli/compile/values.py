"""Texts of the scenario to typed trees: each parsed and checked in its scope, each finding at its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from deepbots_cli.diagnostics import Findings, Span
from deepbots_cli.lang import agree, check, parser, syntax
from deepbots_cli.lang.dimensions import Dimension
from deepbots_cli.lang.expect import expect
from deepbots_cli.lang.lower import constant
from deepbots_cli.lang.typed import Typed, TypedRange
from deepbots_cli.lang.types import Components, NoNames, Report, Scope, Stage
from deepbots_cli.source.nodes import Mapping, Path, Scalar, descend


@dataclass(frozen=True)
class Text:
    """A text of the scenario: what it says, and where each part of it stands."""

    text: str
    part: Callable[[int, int], Span]

    @property
    def span(self) -> Span:
        return self.part(0, len(self.text))


class Values:
    """Reads the values of one scenario."""

    def __init__(self, root: Mapping, findings: Findings) -> None:
        self.root = root
        self.findings = findings

    def span(self, path: Path) -> Span:
        """Where the value at `path` stands, or the nearest thing around it."""
        return descend(self.root, path)[0].span

    def key_span(self, path: Path) -> Span:
        """Where the key at the end of `path` stands; the value where there is none."""
        node, key, _ = descend(self.root, path)
        return key.span if key else node.span

    def text(self, path: Path, default: object = None) -> Text:
        """The text at `path`; one that the file leaves out is placed at what surrounds it."""
        node, _, steps = descend(self.root, path)
        if steps == len(path) and isinstance(node, Scalar):
            return Text(node.text, node.part)
        span = node.span
        return Text(str(default), lambda _start, _end: span)

    def report(self, text: Text) -> Report:
        """Takes findings at offsets of `text`."""

        def report(code: str, start: int, end: int, headline: str, help: str | None = None, notes: tuple[str, ...] = ()) -> None:
            self.findings.add(code, text.part(start, end), headline, help=help, notes=notes)

        return report

    def parsed(self, text: Text) -> syntax.Node | None:
        return parser.parse(text.text, self.report(text))

    def expression(self, text: Text, scope: Scope, *, boolean: bool | None = None) -> Typed | None:
        """The typed tree of an expression; `boolean` demands a truth value (True) or a number (False)."""
        tree = self.parsed(text)
        typed = check.check(tree, scope, self.report(text)) if tree else None
        if typed is None or boolean is None:
            return typed
        agrees = agree.truths if boolean else agree.numbers
        return typed if agrees([typed], self.report(text)) else None

    def drawn(self, text: Text, scope: Scope) -> check.Checked | None:
        """The same, where draws may be repeated (`every 5 s`)."""
        tree = self.parsed(text)
        return check.check_drawn(tree, scope, self.report(text)) if tree else None

    def range(self, text: Text, scope: Scope) -> TypedRange | None:
        tree = self.parsed(text)
        return check.check_range(tree, scope, self.report(text)) if tree else None

    def quantity(
        self,
        text: Text,
        what: str,
        scope: Scope,
        dimension: Dimension | None,
        components: Components | None = None,
        stage: Stage = Stage.FIXED,
    ) -> Typed | None:
        """A value of the dimension (None: any) and components that a field declares, settled by `stage`.

        `what` is how findings call the field, such as "the timestep".
        """
        typed = self.expression(text, scope, boolean=False)
        if typed is None:
            return None
        return expect(typed, self.report(text), what, dimension=dimension, components=components, stage=stage)

    def number(self, path: Path, default: object, dimension: Dimension, scope: Scope | None = None) -> float | None:
        """A fixed single value in SI units; None after a finding."""
        values = self.numbers(path, default, dimension, None, scope)
        return values[0] if values else None

    def numbers(
        self, path: Path, default: object, dimension: Dimension, components: Components | None, scope: Scope | None = None
    ) -> tuple[float, ...] | None:
        """The fixed SI values of a vector with `components`; None after a finding."""
        typed = self.quantity(self.text(path, default), f"`{path[-1]}`", scope or NoNames(), dimension, components)
        values = constant(typed) if typed else None
        if not values:
            return None
        count = len(components) if components else 1
        return tuple(float(value) for value in (values * count if len(values) == 1 else values))
