"""What a policy and a world have agreed on: observation, action, messages.

A policy is only as good as the meaning of the numbers that it was trained on. Each agreed item has a name and a text;
a run records them all: they tell whether, and where, a scenario no longer fits its policy.
"""

from __future__ import annotations

from collections.abc import Mapping

from deepbots_cli.program import Program
from deepbots_cli.program.robots import MessageField, MessageLayout
from deepbots_cli.program.task import ActionRange, Choices, ObservedNumber


def interface(program: Program) -> dict[str, str]:
    """The agreed items of a scenario in order: `observation.speed` to `-0.8 .. 0.8 m/s`."""
    items: dict[str, str] = {}
    for observed in program.policy.numbers:
        items[f"observation.{observed.full_name}"] = _observed(observed)
    for pictured in program.policy.images:
        items[f"observation.{pictured.name}"] = f"picture of {' x '.join(map(str, pictured.shape))}, {pictured.history} in a row"
    if program.policy.goal is not None:
        for component, low, high in zip(
            program.policy.goal.components or ("",), program.policy.goal.low, program.policy.goal.high, strict=True
        ):
            items[f"goal.{component}".rstrip(".")] = _range(low, high, program.policy.goal.unit)
    if program.policy.frame_stack > 1:
        items["agent.frame_stack"] = f"{program.policy.frame_stack} observations in a row"
    for part in program.policy.action:
        items[f"action.{part.name}"] = _action(part)
    for robot in program.robots:
        for layout in (robot.to_robot, robot.from_robot):
            items |= _message(layout)
    return items


def differences(one: Program, other: Program, *, words: tuple[str, str] = ("run", "scenario")) -> list[str]:
    """One line for each item that the two, called by `words`, do not share; empty when a policy of one fits the other."""
    return compare(interface(one), interface(other), words=words)


def compare(old: Mapping[str, str], new: Mapping[str, str], *, words: tuple[str, str] = ("run", "scenario")) -> list[str]:
    """The same for two sets of agreed items."""
    here, there = words
    names = [*old, *(name for name in new if name not in old)]
    lines = [
        f"{name}: {here} {old.get(name, 'has none')}, {there} {new.get(name, 'has none')}"
        for name in names
        if old.get(name) != new.get(name)
    ]
    if not lines and list(old) != list(new):
        lines.append(f"order: {here} {', '.join(old)}; {there} {', '.join(new)}")
    return lines


def other_conditions(run: Program, scenario: Program) -> list[str]:
    """One line for each circumstance that a policy bears, but was not trained under: how often and how late it acts."""
    circumstances = (
        ("timing", run.timing, scenario.timing),
        ("timestep", f"{run.world.timestep:g} s", f"{scenario.world.timestep:g} s"),
        ("action_repeat", str(run.action_repeat), str(scenario.action_repeat)),
    )
    return [f"trained with {name} {old}, evaluated with {new}" for name, old, new in circumstances if old != new]


def _range(low: float, high: float, unit: str) -> str:
    return f"{low:g} .. {high:g} {unit}".rstrip()


def _observed(observed: ObservedNumber) -> str:
    text = "true or false" if observed.truth else _range(observed.low, observed.high, observed.unit)
    text += "" if observed.clip or observed.truth else ", not clipped"
    return f"{text}, {observed.history} in a row" if observed.history > 1 else text


def _action(part: Choices | ActionRange) -> str:
    if isinstance(part, ActionRange):
        size = f" for {', '.join(part.components)}" if part.components else ""
        return _range(part.low, part.high, part.unit) + size
    options = (f"{option.name} ({', '.join(f'{value:g}' for value in option.values)})" for option in part.options)
    return f"{' | '.join(options)} sets {', '.join(part.variables)}"


def _message(layout: MessageLayout) -> dict[str, str]:
    prefix = f"message {layout.direction.replace('_', ' ')} {layout.robot}"
    return {f"{prefix}.{field.name}": " ".join(filter(None, (field.dtype, _inside(field), field.unit))) for field in layout.fields}


def _inside(field: MessageField) -> str:
    """The components of a vector, the sides of a picture."""
    listed = field.components or tuple(map(str, field.shape))
    return f"[{', '.join(listed)}]" if listed else ""
