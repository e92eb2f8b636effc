"""Drivers without a policy: by the name that a person writes, or with given actions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import cycle
from typing import TYPE_CHECKING, Any

from deepbots_cli.diagnostics.nearest import did_you_mean
from deepbots_cli.errors import UsageError
from deepbots_cli.program import RANDOM, ZERO, Program
from deepbots_cli.program.task import ActionRange, Choices
from deepbots_cli.rollout.episode import Driver, Start
from deepbots_cli.words import counted

if TYPE_CHECKING:
    import gymnasium as gym

    from deepbots_cli.runtime import Supervisor
    from deepbots_cli.runtime.spaces import Predictor

# The names of drivers besides the scripts of a scenario. `zero` is the middle of each range and the first
# option of each choice.
HAND = "you"
POLICY = "policy"
POLICY_OF = "policy of "
"""The beginning of the name of the policy of a run that drives in another scenario; the path of the run follows."""
RECORDED = "recording"
ROBOT = "robot"

_MAX_DIGITS = 6


def named_driver(world: gym.Env[Any, Any], name: str) -> Driver:
    """Return the driver of a name: `random`, `zero`, a script of the scenario, or actions such as
    `forward,backward`, which are repeated without end.

    Raises:
        UsageError: The name is none of these.
    """
    driver = _driver_of_name(world, name)
    if driver is not None:
        return driver
    if name == POLICY:
        raise UsageError(
            "only a run has a policy; train one with `deepbots train`, and name the run instead of the"
            " scenario"
        )
    if name == HAND:
        raise UsageError("you can drive in the browser only; use `deepbots play`")
    program: Program = world.get_wrapper_attr("scenario")
    options = [option.name for part in program.agent.choices for option in part.options]
    if not name.isidentifier() or name in options:
        return repeated_actions(world, name)
    scripts = [script.name for script in program.agent.scripts]
    if program.members:
        of_all = [member.program.agent.scripts for member in program.members.values()]
        scripts = list(dict.fromkeys(script.name for agent_scripts in of_all for script in agent_scripts))
    names = (*scripts, RANDOM, ZERO)
    hint = did_you_mean(name, (*names, *options))
    slots = [
        part.options if isinstance(part, Choices) else ()
        for action_part in program.agent.action
        for part in _slots(action_part)
    ]
    example = ",".join(
        ":".join(slot[at].name if slot else number for slot in slots)
        for at, number in ((0, "0.5"), (-1, "-0.5"))
    )
    raise UsageError(
        f"there is no driver '{name}'{hint}; the drivers are {', '.join(names)}, and actions such as"
        f" {example}"
    )


def _driver_of_name(world: gym.Env[Any, Any], name: str) -> Driver | None:
    """Return the driver that a name means, also in place of an action: `random`, `zero`, or a script of the
    scenario or of its agents; None for an action. An option of the same name is written by its index."""
    if name == RANDOM:
        return random_driver(world)
    if name == ZERO:
        return constant_driver(zero_action(world.action_space))
    program: Program = world.get_wrapper_attr("scenario")
    if name in {script.name for script in program.agent.scripts}:
        script = partial(world.get_wrapper_attr("script"), name)
        return Driver(lambda _: script())
    of_agents = _drivers_of_agents(program, name)
    supervisor: Any = world.unwrapped
    return AgentsDriver(supervisor, of_agents) if of_agents else None


def _drivers_of_agents(program: Program, script: str) -> dict[str, str]:
    """Return the driver of each of several agents: the script of this name, or else the first script of the
    agent, or `random`; empty if no agent has such a script."""
    scripts = {
        name: [entry.name for entry in member.program.agent.scripts]
        for name, member in program.members.items()
    }
    if not any(script in names for names in scripts.values()):
        return {}
    return {name: script if script in names else next(iter(names), RANDOM) for name, names in scripts.items()}


class AgentsDriver(Driver):
    """Drives all agents of a world, each by a policy or by the driver of a name."""

    def __init__(self, world: Supervisor, drivers: Mapping[str, str | Predictor]) -> None:
        from deepbots_cli.runtime import agents

        self._world = world
        self._seats = agents.seats_of(world)
        self._join = agents.combined_action
        self._policies = {
            name: agents.PolicyAct(driver, self._seats[name])
            for name, driver in drivers.items()
            if not isinstance(driver, str)
        }
        self._acts: dict[str, Callable[[Any], Any]] = {
            name: agents.driven(world, self._seats[name], driver)
            if isinstance(driver, str)
            else self._policies[name]
            for name, driver in drivers.items()
        }

    def begin(self, start: Start) -> None:
        for act in self._policies.values():
            act.begin(start.number or 0)

    def act(self, observation: Any) -> Any:
        actions = {name: act(self._seats[name].observation(observation)) for name, act in self._acts.items()}
        return self._join(self._world, self._seats, actions)


def random_driver(world: gym.Env[Any, Any]) -> Driver:
    """Return a driver with random actions. The reset seeds the action space."""
    sample = world.action_space.sample
    return Driver(lambda _: sample())


def constant_driver(action: Any) -> Driver:
    """Return a driver with the same action in every step."""
    return Driver(lambda _: action)


def sequence_driver(actions: Iterable[Any]) -> Driver:
    """Return a driver with actions in their order, one in each step.

    Raises:
        UsageError: From `act`, when no action is left.
    """
    following = iter(actions)

    def act(_: Any) -> Any:
        for action in following:
            return action
        raise UsageError("no action is left: the episode did not end with the last of the given actions")

    return Driver(act)


def repeated_actions(world: gym.Env[Any, Any], text: str) -> Driver:
    """Return a driver with the actions in `text`, repeated without end; each episode begins with the first.
    Commas separate actions, colons the parts of one action.

    A part is the name or the index of an option, or a number from -1 to 1 for a range. `forward*8` is eight
    steps of the same action. In place of an action, `random`, `zero` or the name of a script lets this driver
    act; its index means an option of the same name. All copies of a robot get the same action.

    Raises:
        UsageError: The scenario has no such action.
    """
    return _RepeatedActions([_read_repeated(world, word.strip()) for word in text.split(",")])


class _RepeatedActions(Driver):
    """Repeats its parts without end; each episode begins with the first part. A part is a driver, and the
    number of steps."""

    def __init__(self, parts: Sequence[tuple[Driver, int]]) -> None:
        self._parts = parts
        self._following = self._drivers()

    def begin(self, start: Start) -> None:
        self._following = self._drivers()

    def act(self, observation: Any) -> Any:
        return next(self._following).act(observation)

    def _drivers(self) -> Iterator[Driver]:
        return (driver for driver, times in cycle(self._parts) for _ in range(times))


def _read_repeated(world: gym.Env[Any, Any], word: str) -> tuple[Driver, int]:
    """Return a driver, and the number of its steps."""
    text, star, times = (piece.strip() for piece in word.partition("*"))
    if star and not (times.isdecimal() and len(times) <= _MAX_DIGITS and int(times)):
        raise UsageError(
            f"'{word}' is not valid; write the number of steps after the asterisk, such as {text}*8"
        )
    driver = _driver_of_name(world, text) or constant_driver(_read_action(world, text))
    return driver, int(times or 1)


def _read_action(world: gym.Env[Any, Any], text: str) -> Any:
    parts = [width for part in world.get_wrapper_attr("scenario").agent.action for width in _slots(part)]
    words = text.split(":")
    if len(words) != len(parts):
        hint = "; separate the parts by colons" if len(words) < len(parts) else ""
        raise UsageError(
            f"the action '{text}' has {counted(len(words), 'part')}, but this scenario needs"
            f" {len(parts)}{hint}"
        )
    values = [_read_part(part, word.strip()) for part, word in zip(parts, words, strict=True)]
    ranges = [value for part, value in zip(parts, values, strict=True) if isinstance(part, ActionRange)]
    choices = [int(value) for part, value in zip(parts, values, strict=True) if isinstance(part, Choices)]
    return world.get_wrapper_attr("make_action")(choices, ranges)


def _slots(part: Choices | ActionRange) -> Sequence[Choices | ActionRange]:
    """Return the part, repeated once per number that it takes in an action."""
    return [part] * (max(1, len(part.components)) if isinstance(part, ActionRange) else 1)


def _read_part(part: Choices | ActionRange, word: str) -> float:
    if isinstance(part, Choices):
        names = [option.name for option in part.options]
        if word in names:
            return names.index(word)
        if word.isdecimal() and len(word) <= _MAX_DIGITS and int(word) < len(names):
            return int(word)
        raise UsageError(f"'{part.name}' has no option '{word}'; its options are: {', '.join(names)}")
    try:
        value = float(word)
    except ValueError:
        value = float("nan")
    if not -1 <= value <= 1:
        order = (
            f"; the order of its numbers is {':'.join(part.components)}" if len(part.components) > 1 else ""
        )
        unit = "" if part.unit == "1" else f" {part.unit}"
        scale = f"-1 is {part.low:g}{unit}, 1 is {part.high:g}{unit}"
        raise UsageError(
            f"'{word}' is not valid for '{part.name}': write a number from -1 to 1 ({scale}){order}"
        )
    return value


def zero_action(space: gym.Space[Any]) -> Any:
    """Return the middle of every range, and the first option of every choice."""
    import gymnasium as gym  # the module of a command is imported without a simulator too
    import numpy as np

    if isinstance(space, gym.spaces.Dict):
        return {key: zero_action(part) for key, part in space.spaces.items()}
    return np.int64(0) if isinstance(space, gym.spaces.Discrete) else np.zeros(space.shape or (), space.dtype)


def action_from_values(env: Supervisor, values: Mapping[str, float]) -> Any:
    """Return the action with these values by the names of action fields: the index of an option, or a number
    from -1 to 1; others are 0."""
    choices, ranges = [], []
    for part in env.scenario.agent.action:
        if isinstance(part, Choices):
            choices.append(int(values.get(part.name, 0)))
        else:
            ranges += [float(values.get(name, 0.0)) for name in part.names]
    return env.make_action(choices, ranges)
