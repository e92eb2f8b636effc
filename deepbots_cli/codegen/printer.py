"""Prints the statements of one method: expressions, with the memory of stateful functions before them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from deepbots_cli.codegen.names import Names
from deepbots_cli.codegen.text import quoted
from deepbots_cli.expressions.printer import advance_lines, python, reset_lines
from deepbots_cli.expressions.scalar import Draw, Name, Op, Scalar, State, World

Resolve = Callable[[Name | World], str]

NOTHING: Mapping[int, str] = MappingProxyType({})


class Printer:
    """Lines of Python for one method body.

    `starting` says that the method runs right after a reset: stateful functions then take their first
    value instead of advancing. `settable` has the names of draws that `options` of `reset` may set, by the identity of
    their expressions: to compare trees is to walk them.
    """

    def __init__(
        self, resolve: Resolve, names: Names, timestep: float, *, starting: bool = False, settable: Mapping[int, str] = NOTHING
    ) -> None:
        self.lines: list[str] = []
        self.names = names
        self._resolve = resolve
        self._timestep = repr(timestep)
        self.starting = starting
        self._settable = settable
        self._hoisted: dict[State, str] = {}

    def line(self, text: str) -> None:
        self.lines.append(text)

    def value(self, expression: Scalar) -> str:
        """The code of an expression; what must happen first has been printed."""
        code = python(expression, self._leaf)
        name = self._settable.get(id(expression))
        return code if name is None else f"self.given({quoted(name)}, {code})"

    def assign(self, target: str, expression: Scalar) -> None:
        self.line(f"{target} = {self.value(expression)}")

    def remember(self, expressions: Sequence[Scalar]) -> None:
        """Print only what keeps the memory of stateful functions, for values that are not needed here."""
        for expression in expressions:
            for state in outer_states(expression):
                self._state(state)

    def _leaf(self, leaf: Name | World | State | Draw) -> str:
        match leaf:
            case State():
                return self._state(leaf)
            case Draw():
                arguments = ", ".join([quoted(leaf.stream), *(self.value(argument) for argument in leaf.args)])
                return f"self.streams.{leaf.distribution}({arguments})"
            case _:
                return self._resolve(leaf)

    def _state(self, state: State) -> str:
        if state not in self._hoisted:
            memory = f"self.{self.names(f'memory {state.slot}')}"
            arguments = [self.value(argument) for argument in state.args]
            result = self.names(f"{state.function}_{state.slot}")
            if self.starting:
                self.lines += reset_lines(state, memory, result, arguments)
            else:
                self.lines += advance_lines(state, memory, result, arguments, self._timestep)
            self._hoisted[state] = result
        return self._hoisted[state]


def outer_states(expression: Scalar) -> list[State]:
    """Stateful functions in order of evaluation, without those inside others."""
    match expression:
        case State():
            return [expression]
        case Op(_, args) | Draw(_, args, _):
            return [state for argument in args for state in outer_states(argument)]
        case _:
            return []
