"""The values that a control step passes to the next one: memories of functions, past frames, and the number
of calls.

A memory is a tensor in and one out, zeros at the start of an episode. `memory.started` is false in the first
step of an episode, in which each memory begins as after a reset.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from deepbots_cli.expressions.scalar import State
from deepbots_cli.insight.export.trees import Arithmetic, MemoryFormulas, TreePrinter, Value
from deepbots_cli.program import Program
from deepbots_robot.model import Memory


class AdvancesBetweenActionsError(Exception):
    """The error for a memory of the observation in a scenario with several timesteps per action."""


class StepMemories:
    """The memories of the graph of a control step, which acts once in `repeat` calls; `entries` lists them in
    order of first use."""

    def __init__(self, math: Arithmetic, program: Program, repeat: int) -> None:
        self.repeat = repeat
        self.entries: list[Memory] = []
        self._kept_tensors: dict[str, str] = {}
        self._math, self._graph, self._program = math, math.graph, program
        self._formulas = MemoryFormulas(math, program.world.timestep)

    def memory(self, name: str, size: int, *, truth: bool = False) -> Value:
        """Return a value from the step before; zeros at the start of an episode."""
        return Value(self.tensor(name, np.bool_ if truth else np.float64, size), size, truth)

    def keep(self, name: str, value: Value) -> None:
        """Pass a value to the next step."""
        memory = next(entry for entry in self.entries if entry.name == f"memory.{name}")
        (size,) = memory.shape
        self.keep_tensor(
            name, self._math.spread(value if memory.dtype == "bool" else self._math.number(value), size).name
        )

    def tensor(self, name: str, dtype: Any, *shape: int) -> str:
        """Return a tensor from the step before; zeros at the start of an episode."""
        tensor = f"memory.{name}"
        dtype_name: Any = np.dtype(dtype).name
        self.entries.append(Memory(name=tensor, shape=shape, dtype=dtype_name, initial=(0.0,)))
        return self._graph.input(tensor, dtype, *shape)

    def keep_tensor(self, name: str, tensor: str) -> None:
        """Pass a tensor to the next step."""
        self._kept_tensors[f"memory.{name}"] = tensor

    def declare(self) -> None:
        """Declare the kept values as outputs of the graph."""
        for memory in self.entries:
            self._graph.output(
                f"{memory.name}_next", self._kept_tensors[memory.name], memory.dtype, *memory.shape
            )

    # The clock

    @cached_property
    def started(self) -> Value:
        """Whether there was a step before in this episode."""
        started = self.memory("started", 1, truth=True)
        self.keep("started", self._math.constant([True]))
        return started

    @cached_property
    def _acts(self) -> Value:
        """Whether the policy acts in this call."""
        math, calls = self._math, self._calls
        return math.binary(
            "Equal", math.remainder(calls, math.constant([float(self.repeat)])), math.constant([0.0])
        )

    @cached_property
    def _calls(self) -> Value:
        """The number of earlier calls in this episode."""
        calls = self.memory("calls", 1)
        self.keep("calls", self._math.binary("Add", calls, self._math.constant([1.0])))
        return calls

    def if_acting(self, value: Value, otherwise: Value) -> Value:
        """Return the value, or the other one in a call in which the policy does not act."""
        return value if self.repeat == 1 else self._math.where(self._acts, value, otherwise)

    def tensor_if_acting(self, tensor: str, otherwise: str) -> str:
        return (
            tensor if self.repeat == 1 else str(self._graph.add("Where", self._acts.name, tensor, otherwise))
        )

    def clock(self, name: str, ahead: int) -> Value | None:
        """Return the number of the step, or the time, `ahead` steps after the observation; None for other
        names."""
        if name not in ("time", "step"):
            return None
        calls, math, repeat = self._calls, self._math, self._program.action_repeat
        if name == "step":  # the step that has begun is counted
            begun = math.call("ceil", [math.binary("Div", calls, math.constant([float(self.repeat)]))])
            return math.binary("Add", begun, math.constant([float(ahead)]))
        ticks = math.binary("Mul", calls, math.constant([float(repeat // self.repeat)]))
        ticks = math.binary("Add", ticks, math.constant([1.0])) if ahead and repeat == 1 else ticks
        return math.binary("Mul", ticks, math.constant([self._program.world.timestep]))

    # Frames and stateful functions

    def frames(self, name: str, newest: str, depth: int, dtype: Any, *shape: int) -> str:
        """Return the newest frame, [1, *shape], after the `depth` - 1 frames before it, oldest first. After a
        reset, the older frames equal the newest."""
        graph = self._graph
        before = self.tensor(name, dtype, depth - 1, *shape)
        older = graph.add(
            "Where", self.started.name, before, graph.add("Concat", *[newest] * (depth - 1), axis=0)
        )
        frames = graph.add("Concat", older, newest, axis=0)
        without_oldest = graph.add(
            "Slice", frames, *(graph.constant([bound], np.int64) for bound in (1, depth, 0))
        )
        self.keep_tensor(name, self.tensor_if_acting(without_oldest, older))
        return str(frames)

    def per_timestep(self, states: Sequence[State], printer: TreePrinter) -> Value:
        """Return the values of a stateful function that advances once per timestep, from its value at the
        reset on."""
        function = states[0].function
        if self._program.action_repeat != self.repeat:
            raise AdvancesBetweenActionsError
        args = _columns(printer, states)
        begun, first = self._formulas.begin(function, args)
        name = self._slot(states[0])
        memory, value = self._formulas.proceed(
            function, self.memory(name, len(states), truth=begun.truth), args
        )
        self.keep(name, self._math.where(self.started, memory, begun))
        return self._math.where(self.started, value, first)

    def at_reset(self, states: Sequence[State], printer: TreePrinter) -> Value:
        """Return the values of a stateful function in a reset."""
        return self._formulas.begin(states[0].function, _columns(printer, states))[1]

    def per_message(
        self,
        states: Sequence[State],
        printer: TreePrinter,
        *,
        reset: TreePrinter,
        begun: frozenset[tuple[str, str]] = frozenset(),
    ) -> Value:
        """Return the values of a stateful function that advances with each message, from its value at the
        `reset` on.

        `begun` are the calls that begin with the first message.
        """
        function = states[0].function
        args = _columns(printer, states)
        start, _ = self._formulas.begin(
            function, args if states[0].call in begun else _columns(reset, states)
        )
        name = self._slot(states[0])
        before = self._math.where(self.started, self.memory(name, len(states), truth=start.truth), start)
        memory, value = self._formulas.proceed(function, before, args)
        self.keep(name, self.if_acting(memory, before))
        return value

    def _slot(self, state: State) -> str:
        """Return a name for the memory of a stateful call, which no other memory has."""
        item, occurrence = state.call
        names = {memory.name for memory in self.entries}
        candidates = [
            item if occurrence == "0" else f"{item}.{occurrence}",
            *(f"{item}.{occurrence}.{number}" for number in range(1, 10_000)),
        ]
        return next(name for name in candidates if f"memory.{name}" not in names)


def _columns(printer: TreePrinter, states: Sequence[State]) -> list[Value]:
    """Return each argument of a stateful function, one value per component."""
    return [printer.vector([state.args[index] for state in states]) for index in range(len(states[0].args))]
