"""Episodes of policies that learned nothing: random, zero, a list of actions, or a script of the scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import cycle
from typing import Any

from deepbots_cli.errors import UsageError
from deepbots_cli.learning.episodes import Episode, Tally
from deepbots_cli.program import Program
from deepbots_cli.program.task import ActionRange, Choices
from deepbots_cli.runtime import Supervisor

Policy = Callable[[], Any]
"""Gives the next action."""


def random(environment: Supervisor) -> Policy:
    """Actions drawn from the action space, which the reset seeds."""
    return environment.action_space.sample


def zero(environment: Supervisor) -> Policy:
    """The middle of every range, and the first of every choice."""
    drawn = environment.action_space.sample()
    action = {key: part * 0 for key, part in drawn.items()} if isinstance(drawn, dict) else drawn * 0
    return lambda: action


def repeated(scenario: Program, text: str) -> Policy:
    """The actions of `text`, over and over: separated by commas, the parts of one action by colons; copies of a robot all take the same.

    A part is the name of an option, or a number: of the option from 0, or from -1 to 1 in the range.

    Raises:
        UsageError: If one of them is no action of the scenario; says what is.
    """
    actions = cycle([_of_all(scenario, _action(scenario, word.strip())) for word in text.split(",")])
    return lambda: next(actions)


def written(environment: Supervisor, name: str) -> Policy:
    """What a script of the scenario says."""
    return partial(environment.script, name)


def episodes(environment: Supervisor, policy: Policy, *, count: int, seed: int, most_steps: int | None) -> Iterator[Episode]:
    """Up to `count` episodes, the first reset with `seed`; an episode that the limit of steps cuts is ended by `--steps`."""
    left = most_steps
    for number in range(count):
        environment.reset(seed=seed if number == 0 else None)
        tally, ended = Tally(), False
        while not ended:
            _, reward, terminated, truncated, info = environment.step(policy())
            tally.add(reward, info)
            left = None if left is None else left - 1
            ended = terminated or truncated or left == 0
            if left == 0 and not (terminated or truncated):
                info = info | {"ended_by": "--steps"}
        yield tally.close(info)
        if left == 0:
            return


def _action(scenario: Program, text: str) -> Any:
    import numpy as np

    parts = [width for part in scenario.action for width in _slots(part)]
    words = text.split(":")
    if len(words) != len(parts):
        raise UsageError(f"the action '{text}' has {len(words)} parts, the scenario's has {len(parts)}; separate them by colons")
    values = [_value(part, word.strip()) for part, word in zip(parts, words, strict=True)]
    ranges = [value for part, value in zip(parts, values, strict=True) if isinstance(part, ActionRange)]
    choices = [int(value) for part, value in zip(parts, values, strict=True) if isinstance(part, Choices)]
    if not choices:
        return np.array(ranges, np.float32)
    chosen = choices[0] if len(choices) == 1 else np.array(choices, np.int64)
    return {"choices": chosen, "ranges": np.array(ranges, np.float32)} if ranges else chosen


def _of_all(scenario: Program, action: Any) -> Any:
    """The action of one robot as that of all its copies, where there are any."""
    import numpy as np

    copies = scenario.agent.each
    if copies is None:
        return action
    if isinstance(action, dict):
        return {key: _of_all(scenario, part) for key, part in action.items()}
    return np.array([action] * copies.count)


def _slots(part: Choices | ActionRange) -> Sequence[Choices | ActionRange]:
    """The part once for each number of the action that it takes."""
    return [part] * (max(1, len(part.components)) if isinstance(part, ActionRange) else 1)


def _value(part: Choices | ActionRange, word: str) -> float:
    if isinstance(part, Choices):
        names = [option.name for option in part.options]
        if word in names:
            return names.index(word)
        if word.isdecimal() and int(word) < len(names):
            return int(word)
        raise UsageError(f"'{word}' is no choice of '{part.name}'; there are: {', '.join(names)}")
    try:
        value = float(word)
    except ValueError:
        value = float("nan")
    if not -1 <= value <= 1:
        order = f"; its numbers go in the order {':'.join(part.components)}" if len(part.components) > 1 else ""
        meaning = f"which mean {part.low:g} and {part.high:g} {part.unit}{order}"
        raise UsageError(f"'{word}' is no value of '{part.name}'; the agent acts from -1 to 1, {meaning}")
    return value
