"""Checks that an exported policy acts as in the scenario, and records the steps by which every robot repeats
this check.

The first steps are those of a simulation: the commands of the graph are compared with the commands that the
robots of the simulation applied. Further steps have random inputs around the first ones, to test parts of the
networks that no episode uses.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export.control import ControlStep
from deepbots_cli.insight.export.devices import RecordedStep, recorded_steps
from deepbots_cli.learning.learner import Learner
from deepbots_cli.rollout.policies import PolicyDriver
from deepbots_robot.bundle import TOLERANCE, Bundle, most_steps, span_of
from deepbots_robot.model import BundleError, Input, Output

RECORDED, RANDOM = 200, 200
"""The number of steps of each kind; fewer for a policy that computes so much that loading its bundle would
take seconds."""
_TRIES = 10
"""The factor that limits the number of tried steps."""
_RANDOM_EPISODE = 10
_WIDTHS = (1.0, 3.0, 30.0)
"""The widths of random values in widths of the recorded ones: within the observed range, and beyond it, where
values are clipped."""
_CLEAR = 10 * TOLERANCE
"""The smallest distance of the two best scores of a recorded step. Closer ones might change places on another
processor."""

Array = NDArray[Any]


class Comparison:
    """A bundle beside a simulation, step by step.

    Attributes:
        steps: The number of compared steps.
        worst: The largest difference of a command, in shares of its range.
    """

    def __init__(self, bundle: Bundle) -> None:
        self._info = bundle.info
        self._policy = bundle.start()
        self._spans = {output.name: span_of(output) for output in bundle.info.outputs}
        self._parted = False
        self.steps, self.worst = 0, 0.0

    def add(self, step: RecordedStep) -> dict[str, Array]:
        """Compare a step, and return the results of the bundle for its inputs.

        Raises:
            UsageError: The commands differ from those that the robots of the simulation applied, although no
                two options were equally good.
        """
        if step.first:
            self._policy.reset()
            self._parted = False
        try:
            commands = self._policy.step(values=step.inputs)
        except BundleError as error:
            raise UsageError(
                f"the exported policy cannot act in the scenario: {error}; please report this"
            ) from error
        choices = self._info.choices
        if (
            choices
            and not np.array_equal(commands["action"], step.action)
            and least_gap(choices, commands) <= TOLERANCE
        ):
            self._parted = True
        if self._parted:  # the memory of one of the two holds another action
            return commands
        for output in self._info.outputs:
            expected = clipped(step.commands[output.name], output)
            apart = float(np.max(np.abs(commands[output.name] - expected) / self._spans[output.name]))
            self.worst = max(self.worst, apart)
            if not apart <= TOLERANCE:  # also where it is not a number
                numbers = f"{commands[output.name].tolist()} instead of {expected.tolist()}"
                raise UsageError(
                    f"the exported policy does not command '{output.name}' as the scenario does: {numbers};"
                    " please report this"
                )
        self.steps += 1
        return commands


def clipped(command: Array, output: Output) -> Array:
    """Return a command within the limits of its actuator."""
    low, high = output.range
    return np.clip(
        command, [-np.inf if x is None else x for x in low], [np.inf if x is None else x for x in high]
    )


def least_gap(choices: tuple[int, ...], outputs: Mapping[str, Array]) -> float:
    """Return the smallest distance between the two best scores of a choice; infinite without choices."""
    if not choices:
        return np.inf
    best = [
        np.sort(scores)[-2:]
        for scores in np.split(outputs["scores"], np.cumsum(choices)[:-1])
        if len(scores) > 1
    ]
    return min((float(pair[1] - pair[0]) for pair in best), default=np.inf)


def recorded_parity(bundle: Bundle, step: ControlStep, learner: Learner, *, engine: str | None) -> bytes:
    """Return the content of parity.npz.

    Raises:
        UsageError: The commands of the bundle differ from those that the robots of the simulation applied.
    """
    rows, comparison = _Rows(bundle), Comparison(bundle)
    recorded = recorded_steps(step, lambda world: PolicyDriver(learner, world), engine=engine)
    for number, recorded_step in enumerate(recorded):
        rows.add(recorded_step.first, recorded_step.inputs, comparison.add(recorded_step))
        if rows.count == min(RECORDED, most_steps(bundle) // 2) or number == _TRIES * RECORDED:
            break
    recorded.close()
    if rows.count == 0:
        raise UsageError(
            "the scores of the options are equal in every step, so that no step can be recorded; train the"
            " policy first"
        )
    _add_random_steps(bundle, rows)
    return rows.content()


class _Rows:
    """The recorded steps. An episode is cut where two options are equally good, or a command is not a
    number."""

    def __init__(self, bundle: Bundle) -> None:
        self._choices = bundle.info.choices
        self._inputs: list[Mapping[str, Array]] = []
        self._outputs: list[Mapping[str, Array]] = []
        self._starts: list[int] = []
        self._is_open = False

    @property
    def count(self) -> int:
        return len(self._inputs)

    @property
    def inputs(self) -> dict[str, Array]:
        return _stacked(self._inputs)

    def add(self, first: bool, inputs: Mapping[str, Array], outputs: Mapping[str, Array]) -> None:
        if first:
            self._is_open = True
        finite = all(np.isfinite(value).all() for value in outputs.values())  # scores, too
        self._is_open = self._is_open and finite and least_gap(self._choices, outputs) > _CLEAR
        if self._is_open:
            if first:
                self._starts.append(self.count)
            self._inputs.append(inputs)
            self._outputs.append(outputs)

    def cut(self) -> None:
        """End the episode before this step."""
        self._is_open = False

    def content(self) -> bytes:
        arrays = {f"input/{name}": rows for name, rows in self.inputs.items()}
        arrays |= {f"output/{name}": rows for name, rows in _stacked(self._outputs).items()}
        stream = io.BytesIO()
        arrays["starts"] = np.array(self._starts, np.int64)
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
        return stream.getvalue()


def _stacked(rows: list[Mapping[str, Array]]) -> dict[str, Array]:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _add_random_steps(bundle: Bundle, rows: _Rows) -> None:
    """Add steps with inputs in and around the range of the recorded ones, and far beyond."""
    # A fixed seed, so that the same policy gets the same steps.
    random, policy, input_rows = np.random.default_rng(0), bundle.start(), rows.inputs
    total = rows.count + min(RANDOM, most_steps(bundle) // 2)
    for number in range(_TRIES * RANDOM):
        first = number % _RANDOM_EPISODE == 0
        if first:
            policy.reset()
        inputs = {
            entry.name: _random_value(entry, input_rows[entry.name], random) for entry in bundle.info.inputs
        }
        try:
            rows.add(first, inputs, policy.step(values=inputs))
        except BundleError:
            # `apply` need not be defined far beyond the values of an episode, so commands may be infinite
            # there.
            rows.cut()
        if rows.count == total:
            break


def _random_value(entry: Input, recorded: Array, random: np.random.Generator) -> Array:
    if entry.dtype == "bool":
        return random.random(entry.shape) < 0.5
    if entry.dtype == "uint8":
        return random.integers(0, 256, entry.shape, np.uint8)
    low, high = recorded.min(axis=0), recorded.max(axis=0)
    width = random.choice(_WIDTHS) * np.where(high > low, high - low, 1.0)
    ends = entry.range or ((None,) * len(low), (None,) * len(low))
    least = [-np.inf if end is None else end for end in ends[0]]
    most = [np.inf if end is None else end for end in ends[1]]
    return np.asarray(np.clip((low + high) / 2 + width * random.uniform(-1.0, 1.0, entry.shape), least, most))
