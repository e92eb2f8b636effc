"""The observation of a policy from named values in SI units, without a world, as an environment computes it
in each step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deepbots_cli.arrays import evaluate
from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar, names_in
from deepbots_cli.program import Program
from deepbots_cli.runtime.formulas import scale, scale_freely
from deepbots_cli.runtime.spaces import scaled_goal
from deepbots_cli.words import counted


class Observer:
    """Makes observations of one policy.

    Attributes:
        values: The names of the values that an observation is made of: its own numbers, and with a goal the
            achieved goal. The achieved goal is computed from message fields (`panda.tip.x`) if the scenario
            computes it from them; otherwise its components (`achieved.x`) must be given.
    """

    def __init__(self, program: Program) -> None:
        agent = program.agent
        self._inputs = agent.inputs
        self._goal = agent.goal
        self._unsupported = self._unsupported_for(program)
        self._achieved: dict[str, Scalar] = {}
        sent = {f"{robot.name}.{field.name}" for robot in program.robots for field in robot.from_robot.fields}
        texts = {number: entry.value.text for entry in agent.observation for number, _ in entry.value.numbers}
        if self._goal is not None:
            names = [name.full_name for name in self._goal.names("achieved")]
            signals = {
                full: value
                for entry in program.signals
                for full, value in entry.numbers
                if entry.noise is None
            }
            trees = [_from_messages(tree, sent, signals) for tree in self._goal.achieved.scalars]
            computed = [tree for tree in trees if tree is not None]
            self._achieved = dict(
                zip(names, computed if len(computed) == len(names) else map(Name, names), strict=True)
            )
            texts |= dict.fromkeys(names, self._goal.achieved.text)
        texts |= {full: signal.text for signal in program.signals for full, _ in signal.numbers}
        leaf_names = (leaf.full_name for tree in self._achieved.values() for leaf in names_in(tree))
        self.values = tuple(dict.fromkeys((*(value.name for value in self._inputs), *leaf_names)))
        self._computed = {
            name: texts[name]
            for name in self.values
            if name in texts and sent.isdisjoint((name, name.rpartition(".")[0]))
        }

    def observe(self, values: Mapping[str, float], desired: Sequence[float] | None = None) -> Any:
        """Return the observation, float32: an array, or with a goal a dictionary of arrays.

        Args:
            values: The value of each name of `values`, in its unit. A value beyond its range is clipped, as
                in an environment.
            desired: The goal, a number per component in its unit; only for a policy with a goal.

        Raises:
            UsageError: The policy sees more than present values; a name is missing or unknown; a value is not
                finite; the goal is missing or has another size.
        """
        if self._unsupported:
            raise UsageError(self._unsupported)
        goal = self._desired(desired)
        self._require_complete(values)
        numbers = [
            float(bool(values[entry.name]))
            if entry.truth
            else (scale if entry.clipped else scale_freely)(float(values[entry.name]), entry.low, entry.high)
            for entry in self._inputs
        ]
        vector = np.array(numbers, np.float32)
        if self._goal is None:
            return vector
        by_name = {Name(name): np.asarray(float(value)) for name, value in values.items()}
        achieved = [float(evaluate(tree, by_name)) for tree in self._achieved.values()]
        return {
            "observation": vector,
            "achieved_goal": np.array(scaled_goal(self._goal, achieved), np.float32),
            "desired_goal": np.array(scaled_goal(self._goal, goal), np.float32),
        }

    def _desired(self, desired: Sequence[float] | None) -> list[float]:
        goal = self._goal
        if goal is None:
            if desired is not None:
                raise UsageError("this policy has no goal; leave out `desired`")
            return []
        size = len(goal.low)
        names = f" ({', '.join(goal.components)})" if goal.components else ""
        expected = f"{counted(size, 'number')}{names}{f' in {goal.unit}' if goal.unit != '1' else ''}"
        if desired is None:
            raise UsageError(f"this policy has a goal; give it as `desired`: {expected}")
        try:
            numbers = np.asarray(desired, float)
        except (TypeError, ValueError):
            numbers = np.asarray(None, float)
        if numbers.reshape(-1).shape != (size,) or not np.isfinite(numbers).all():
            raise UsageError(f"`desired` is {str(desired)[:80]}; give {expected}, all of them finite")
        return [float(value) for value in numbers.reshape(-1)]

    def _require_complete(self, values: Mapping[str, float]) -> None:
        missing = [name for name in self.values if name not in values]
        unknown = [name for name in values if name not in self.values]
        if missing:
            texts = [
                f"{name} (no message contains it; the scenario computes `{self._computed[name]}`)"
                if name in self._computed
                else name
                for name in missing
            ]
            raise UsageError(f"the observation needs {', '.join(self.values)}; missing: {', '.join(texts)}")
        if unknown:
            raise UsageError(
                f"the observation needs {', '.join(self.values)}; unknown: {', '.join(map(str, unknown))}"
            )
        for name, number in values.items():
            try:
                is_finite = math.isfinite(number)
            except (TypeError, ValueError, OverflowError):
                raise UsageError(f"the value of {name} is {str(number)[:80]}; it must be a number") from None
            if not is_finite:
                raise UsageError(f"the value of {name} is {number}; it must be finite")

    def _unsupported_for(self, program: Program) -> str:
        """Return why the present values are not enough for an observation; empty if they are."""
        if program.agent.images:
            return (
                f"this policy sees the image '{program.agent.images[0].key}'; take observations from the"
                " environment"
            )
        older = next((value.name for value in self._inputs if value.steps_ago), None)
        return (
            f"this policy sees older values of {older}; take observations from the environment"
            if older
            else ""
        )


def _from_messages(tree: Scalar, sent: set[str], signals: Mapping[str, Scalar]) -> Scalar | None:
    """Return the tree over full names of the fields that are `sent`, through `signals`; None if it reads
    something else."""
    match tree:
        case Const():
            return tree
        case Name():
            full = tree.full_name
            if tree.name in sent:
                return Name(full)
            return _from_messages(signals[full], sent, signals) if full in signals else None
        case Op(op=name, args=args):
            sent_args = [
                sent_arg for arg in args if (sent_arg := _from_messages(arg, sent, signals)) is not None
            ]
            return Op(name, tuple(sent_args)) if len(sent_args) == len(args) else None
    return None
