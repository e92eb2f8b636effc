"""A compiled scenario as items: paths in the words of the language, to what stands there in the compiled scenario.

Items are compared by value. What only shows (colours, shapes that nothing touches) is told apart from what acts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from enum import StrEnum
from typing import NamedTuple

from deepbots_cli import canonical, interface
from deepbots_cli.canonical import members
from deepbots_cli.expressions.scalar import Draw, Scalar
from deepbots_cli.program import Program
from deepbots_cli.program.resets import RandomizedParameter
from deepbots_cli.program.robots import MessageLayout, Robot
from deepbots_cli.program.world import RobotBody, WorldModel


class Group(StrEnum):
    """What a difference comes to, the gravest first."""

    policy = "policy"
    task = "task"
    world = "world"
    training = "training"
    cosmetic = "cosmetic"


class Item(NamedTuple):
    """`path` leads to where the user wrote it; `value` is compared."""

    path: str
    group: Group
    value: object


VALUE = " value"
"""Marks what an agreed item means, apart from what was agreed on: `robots.cart.emit.tilt value`."""

LOOK = "look of "
"""Begins the path of what only shows."""

_LOOKS = frozenset({"colour", "visuals"})


def items(scenario: Program) -> dict[str, Item]:
    """Everything that a scenario means, its cases and stages apart; a path stands once."""
    placeless = canonical.with_files(scenario, lambda file: replace(file, path=""))
    found: dict[str, Item] = {}
    for item in (*_policy(placeless), *_task(placeless), *_world(placeless), *_training(placeless)):
        known = found.get(item.path)
        found[item.path] = (
            item if known is None else item._replace(value=(known.value, item.value), group=min(known.group, item.group, key=_rank))
        )
    return found


def _rank(group: Group) -> int:
    return list(Group).index(group)


def _policy(scenario: Program) -> Iterator[Item]:
    """What a policy and a world have agreed on."""
    agreed = interface.interface(scenario)
    for name, text in agreed.items():
        yield Item(_where(name, scenario), Group.policy, text)
    yield Item("order of what is observed, done and sent", Group.policy, tuple(agreed))


def _where(name: str, scenario: Program) -> str:
    """The path of an agreed item: a field that a robot sends stands under its `emit`."""
    for robot in scenario.robots:
        for prefix, section in ((f"message to robot {robot.name}.", "receive"), (f"message from robot {robot.name}.", "emit")):
            if name.startswith(prefix):
                return f"robots.{robot.name}.{section}.{name.removeprefix(prefix)}"
    return "goal.range" if name.partition(".")[0] == "goal" else name


def _task(scenario: Program) -> Iterator[Item]:
    """What is sensed, done, paid for and ended."""
    task = Group.task
    for observed in scenario.numbers:
        yield Item(f"observation.{observed.full_name}{VALUE}", task, observed.scalar)
        if observed.noise is not None:
            yield Item(f"observation.{observed.name}.noise", task, observed.noise)
    yield from (Item(f"observation.{picture.name}{VALUE}", task, picture.value.scalar) for picture in scenario.images)
    for part in scenario.action:
        forbidden = tuple((option.name, option.forbidden.scalar) for option in getattr(part, "options", ()) if option.forbidden)
        if forbidden:
            yield Item(f"action.{part.name}.forbid", task, forbidden)
    yield from (Item(f"signals.{entry.name}", task, entry) for entry in scenario.signals)
    if scenario.goal is not None:
        goal = scenario.goal
        if goal.achieved.noise is not None:
            yield Item("goal.noise", task, goal.achieved.noise)
        yield from (
            Item(f"goal.{key}", task, value)
            for key, value in (("achieved", goal.achieved.scalars), ("desired", goal.targets), ("within", goal.within))
        )
    yield from (Item(f"reward.{term.name}", task, term) for term in scenario.reward)
    yield from (Item(f"termination.{ending.outcome}.{ending.name}", task, ending) for ending in scenario.endings)
    yield Item("order of endings", task, tuple(ending.name for ending in scenario.endings))
    yield Item("truncation.max_steps", task, scenario.truncation.max_steps)
    yield Item("truncation.max_time", task, scenario.truncation.max_time)
    for robot in scenario.robots:
        yield from _controller(robot)


def _controller(robot: Robot) -> Iterator[Item]:
    here = f"robots.{robot.name}"
    named = (
        ("sensors", robot.sensors),
        ("actuators", robot.actuators),
        ("receive", robot.received),
        ("emit", robot.emitted),
        ("apply", robot.commands),
    )
    yield from (Item(f"{here}.{section}.{entry.name}{VALUE}", Group.task, entry) for section, entries in named for entry in entries)
    layouts: tuple[MessageLayout, ...] = (robot.to_robot, robot.from_robot)
    yield from (
        Item(f"order of fields {layout.direction} {robot.name}", Group.policy, tuple(f.name for f in layout.fields)) for layout in layouts
    )


def _world(scenario: Program) -> Iterator[Item]:
    """World, bodies, messages on their way, and starts: what makes a task easy or hard."""
    world, reset = scenario.world, scenario.reset
    seen = any(sensor.optics for robot in scenario.robots for sensor in robot.sensors)
    for name in ("timestep", "substeps", "gravity", "ground", "arena", "terrain", "light"):
        yield from _looked_at(f"world.{name}", getattr(world, name), seen=seen)
    yield from (item for line in world.lines for item in _looked_at(f"world.lines.{line.name}", line, seen=seen))
    for body in world.objects:
        yield from _looked_at(f"objects.{body.name.partition('#')[0]}", body, seen=seen)
    for robot in world.robots:
        yield from _body(robot, seen=seen)
    yield Item("messages.format", Group.world, scenario.format)
    yield Item("messages.timing", Group.world, scenario.timing)
    for controller in scenario.robots:
        yield Item("messages.to_robot", Group.world, controller.to_route)
        yield Item("messages.from_robot", Group.world, controller.from_route)
    yield Item("agent.repeat", Group.world, scenario.agent.repeat)
    if scenario.agent.each is not None:
        yield Item(f"robots.{scenario.agent.each.robot}.count", Group.world, scenario.agent.each)
    yield from (Item(f"parameters.{entry.name}", Group.world, entry) for entry in scenario.parameters)
    yield from (Item(f"disturbances.{entry.name}", Group.world, entry) for entry in scenario.disturbances)
    yield from (Item(f"reset.place.{place.body}", Group.world, place) for place in reset.placements)
    yield Item("order of reset.place", Group.world, tuple(place.body for place in reset.placements))
    yield from (
        Item(f"reset.set.{start.robot}.{joint}", Group.world, (position, velocity))
        for start in reset.joint_starts
        for joint, position, velocity in start.states
    )
    yield from (Item(_drawn(entry, world), Group.world, entry.scalars) for entry in reset.variations)
    yield from (Item(f"objects.{group.name}.count", Group.world, group) for group in reset.groups)
    yield from (Item(f"reset.layouts.{layout.name}", Group.world, layout) for layout in reset.layouts)
    yield from (Item(f"reset.{name}", Group.world, getattr(reset, name)) for name in ("settle", "require", "attempts"))


def _drawn(entry: RandomizedParameter, world: WorldModel) -> str:
    """The path of a figure that is drawn per episode: where the draw is written; a colour goes with the look of what has it."""
    if entry.what == "colour":
        body, link = entry.of
        is_robot = any(robot.name == body for robot in world.robots)
        return f"{LOOK}robots.{body}.links.{link}" if is_robot else f"{LOOK}objects.{body.partition('#')[0]}"
    first = entry.scalars[0]
    if isinstance(first, Draw):
        return first.stream.partition("#")[0].partition(":")[0]
    return f"drawn {entry.what} of {'.'.join(filter(None, entry.of))}"


def _body(robot: RobotBody, *, seen: bool) -> Iterator[Item]:
    here, model = f"robots.{robot.name}", robot.model
    touches = any(link.collisions for link in model.links)
    yield Item(f"{here}.base", Group.world, "fixed" if robot.fixed_base else "free")
    yield Item(f"{here}.pose", Group.world, robot.pose)
    yield Item(f"{here}.urdf", Group.world, model.root)
    yield Item(f"name of {here}.urdf", Group.cosmetic, model.name)
    for link in model.links:
        yield from _looked_at(f"{here}.links.{link.name}", link, seen=seen or not touches)
    yield from (Item(f"{here}.joints.{joint.name}", Group.world, joint) for joint in model.joints)


def _looked_at(path: str, value: object, *, seen: bool) -> Iterator[Item]:
    """What acts, and what only shows, which counts as the world where a camera sees it or nothing else has a size."""
    yield Item(path, Group.world, _without_looks(value))
    looks = tuple(_looks(value))
    if any(look is not None and look != () for look in looks):
        yield Item(f"{LOOK}{path}", Group.world if seen else Group.cosmetic, looks)


def _without_looks(value: object) -> object:
    """A record as its class and pairs of what acts; an expression as it is."""
    inside = None if isinstance(value, Scalar) else members(value)
    if inside is not None:
        return (type(value).__name__, *((name, _without_looks(member)) for name, member in inside.items() if name not in _LOOKS))
    return tuple(map(_without_looks, value)) if isinstance(value, tuple) and not isinstance(value, Scalar) else value


def _looks(value: object) -> Iterator[object]:
    inside = members(value)
    if inside is not None:
        for name, member in inside.items():
            yield from (member,) if name in _LOOKS else _looks(member)
    elif isinstance(value, tuple):
        for item in value:
            yield from _looks(item)


def _training(scenario: Program) -> Iterator[Item]:
    """How a policy is trained and judged, what it is compared with; and what a scenario is called."""
    yield Item("name", Group.cosmetic, scenario.name)
    yield Item("summary", Group.cosmetic, scenario.summary)
    kinds: Iterable[tuple[str, object]] = (("solved", scenario.solved), ("evaluation.episodes", scenario.evaluation.episodes))
    training = scenario.training
    if training is not None:
        shown = ("algorithm", "total_timesteps", "environments", "action_noise", "replay")
        kinds = (*kinds, *((f"train.{name}", getattr(training, name)) for name in shown))
        kinds = (*kinds, ("train.policy.hidden", training.policy.hidden), ("train.policy.activation", training.policy.activation))
        kinds = (*kinds, *((f"train.{entry.name}", entry.value) for entry in training.hyperparameters))
    yield from (Item(path, Group.training, value) for path, value in kinds)
    yield from (Item(f"scripts.{script.name}", Group.training, script) for script in scenario.scripts)
