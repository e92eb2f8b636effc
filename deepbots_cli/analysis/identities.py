"""Values that are the same quantity, whatever their names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar, State

if TYPE_CHECKING:
    from deepbots_cli.analysis.analysis import Analysis


class Identities:
    """Numbers the quantities of a program."""

    def __init__(self, analysis: Analysis) -> None:
        self._analysis = analysis
        self._identities: dict[int, tuple[Scalar, int]] = {}
        self._numbers: dict[tuple[object, ...], int] = {}

    def of(self, node: Scalar) -> int:
        """Return a number that two trees share if they mean the same quantity."""
        cached = self._identities.get(id(node))
        if cached is None:
            # The tree is kept, so that no other tree gets its id.
            cached = self._identities[id(node)] = (node, self._identity(node))
        return cached[1]

    def _identity(self, node: Scalar) -> int:
        match node:
            case Name():
                meaning = self._analysis.resolve_aliases(node)
                return (
                    self._number("name", meaning.name, meaning.component)
                    if isinstance(meaning, Name)
                    else self.of(meaning)
                )
            case Const(value):
                return self._number("const", value)
            case EngineRead(function, subjects, component):
                return self._number("world", function, subjects, component)
            case Op(op, args):
                return self._number(op, *map(self.of, args))
            # Two calls with the same arguments have the same value, so the slot is left out.
            case State(function, args, _):
                return self._number(function, *map(self.of, args))
            case Draw(_, _, stream):
                return self._number("draw", stream)

    def _number(self, *key: object) -> int:
        return self._numbers.setdefault(key, len(self._numbers))
