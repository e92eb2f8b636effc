"""What contradicts the geometry of a robot file: rays of sensors that meet nothing (DB615), which pass over
everything or begin below the ground, and mirror images of joints (DB618)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from functools import cached_property
from math import copysign
from typing import NamedTuple

from deepbots_cli import frames
from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.ranges import with_unit
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import LENGTH
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar
from deepbots_cli.frames import Triple
from deepbots_cli.lint.context import RuleContext, Simulation, rule
from deepbots_cli.lint.observations import linear
from deepbots_cli.lint.simulation import ARENA, Clearance, driven_wheels
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Motor, Thrust
from deepbots_cli.program.task import Mirror, Symmetry
from deepbots_cli.robots.kinematics import link_frames
from deepbots_cli.robots.model import Joint, RobotModel

SAME_HEIGHT_M = 1e-4
"""The difference of heights (m) below which they are equal."""
_RANGE_FACTOR = 1.2


@rule("DB615", simulated=True)
def rays_meet_nothing(simulation: Simulation) -> Iterator[Finding]:
    """Report a sensor whose rays passed over everything in the world in each step, or began below the ground.

    Not where a case or a stage has another world, nor rays above everything where a robot flies or may lift
    an object into their way.
    """
    program = simulation.program
    if not simulation.is_complete or any(
        version.world != program.world for version in program.versions.values()
    ):
        return
    for robot, sensor, depth in simulation.report.summary.depths:
        yield _buried(simulation, robot, sensor, depth)
    if not _may_lift(program):
        for robot, sensor, clearance in simulation.report.summary.clearances:
            yield _passing_over(simulation, robot, sensor, clearance)


def _may_lift(program: Program) -> bool:
    """Return whether a robot flies, or has other motors than those of wheels beside an object that moves."""
    models = {body.name: body.model for body in program.world.robots}
    is_loose = any(
        body.solid and not kind.fixed for body in program.world.objects for kind in (body.variants or (body,))
    )
    return any(
        isinstance(actuator, Thrust) or (is_loose and not driven_wheels(robot, models[robot.name]))
        for robot in program.robots
        for actuator in robot.actuators
    )


def _passing_over(simulation: Simulation, robot: str, sensor: str, clearance: Clearance) -> Finding:
    values = simulation.values
    base = clearance.tallest.partition("#")[0]
    height, top, lower = (
        with_unit(length, LENGTH)
        for length in (clearance.lowest, clearance.top, clearance.lowest - clearance.top)
    )
    help = f"lower the `pose` of the sensor by more than {lower}"
    if clearance.tallest == ARENA:
        subject = "the walls of the arena"
        span = values.span_of_first(("world", "arena"), "wall_height")
        help = (
            f"write `wall_height: {with_unit(float(f'{_RANGE_FACTOR * clearance.lowest:.2g}'), LENGTH)}`"
            f" for the arena, or {help}"
        )
    else:
        wall = base.rpartition(" ")[0]  # `stub 1` is a piece of the wall `stub`
        paths = ("objects", base), ("robots", base), ("world", "walls", wall), ("reset", "layouts", wall)
        subject = f"`{wall or base}`"
        span = values.key_span(next((path for path in paths if values.is_present(path)), ("world",)))
    also = (Label(span, f"{top} high"),)
    headline = (
        f"the rays of `{sensor}` meet nothing: they are at least {height} above the ground, "
        f"but the tallest body, {subject}, is only {top} high"
    )
    return Finding(
        "DB615",
        values.key_span(("robots", robot, "sensors", sensor)),
        headline,
        help,
        notes=(simulation.summary,),
        labels=also,
    )


def _buried(simulation: Simulation, robot: str, sensor: str, depth: float) -> Finding:
    lower = with_unit(float(f"{depth:.3g}"), LENGTH)
    headline = f"the rays of `{sensor}` meet nothing: they begin {lower} below the ground"
    help = f"raise the `pose` of the sensor by more than {lower}"
    span = simulation.values.key_span(("robots", robot, "sensors", sensor))
    return Finding("DB615", span, headline, help, notes=(simulation.summary,))


_JOINT_READINGS = frozenset({"joint_position", "joint_velocity", "joint_torque"})
_TOLERANCE_M = 0.005
"""The distance below which two places are the same: robot files have rounded and measured numbers."""
_MIN_PARALLEL = 0.99
"""The cosine of the angle from which two axes are parallel."""
_MAX_LISTED = 3


class JointNumber(NamedTuple):
    """A number that is proportional to a reading of a joint or commands it; with the sign of its factor."""

    robot: str
    joint: str
    sign: int


class JointPlace(NamedTuple):
    """A joint, its place (m) and its axis in the frame of the root link, with all joints at 0."""

    joint: Joint
    position: Triple
    axis: Triple


class MirrorPlane(NamedTuple):
    """The plane on which one coordinate (0 to 2) of the frame of the root link has a value, in m."""

    coordinate: int
    value: float

    def __str__(self) -> str:
        # Adding 0.0 turns -0.0 into 0.0.
        return f"{'xyz'[self.coordinate]} = {round(self.value, 4) + 0.0:g} m"

    def distance(self, joint_place: JointPlace) -> float:
        return joint_place.position[self.coordinate] - self.value

    def are_opposite(self, first: JointPlace, second: JointPlace) -> bool:
        """Return whether the places of two joints are mirror images of each other."""
        return all(
            abs(self.distance(first) + self.distance(second) if k == self.coordinate else a - b)
            < _TOLERANCE_M
            for k, (a, b) in enumerate(zip(first.position, second.position, strict=True))
        )

    def sign(self, first: JointPlace, second: JointPlace) -> int | None:
        """Return the sign with which the position of a joint is that of its mirror image; None if their axes
        are not mirror images of each other.

        A rotation is mirrored in the other direction than a vector.
        """
        turns = first.joint.type != "prismatic"
        x, y, z = (-a if (k == self.coordinate) != turns else a for k, a in enumerate(first.axis))
        cosine = frames.dot((x, y, z), second.axis)
        return None if abs(cosine) < _MIN_PARALLEL else round(cosine)


class _MirroredNumber(NamedTuple):
    """A number and its mirror image, with the sign between them, and the joints of both."""

    name: str
    image: str
    sign: int
    joint: JointNumber | None
    image_joint: JointNumber | None


class _Mirrors:
    """The mirrored numbers of an agent."""

    def __init__(self, analysis: Analysis, symmetry: Symmetry) -> None:
        self._analysis = analysis
        wide = analysis.program.with_critic.agent
        trees = [
            tree
            for entry in wide.observation
            for tree, _ in zip(self._analysis.scalars(entry.value), entry.numbers, strict=False)
        ]
        observed = [self._measured_joint(trees[index]) for index, _ in wide.seen]
        names = [entry.name for entry in wide.inputs]
        agent = analysis.program.agent
        parts = [(part.name, component) for part in agent.ranges for component in part.components or (None,)]
        driven = [self._driven_joints.get(part) for part in parts]
        self.of_observation = list(_mirrored(names, observed, symmetry.observation))
        self.of_action = list(_mirrored(agent.range_names, driven, symmetry.ranges))

    def _measured_joint(self, tree: Scalar) -> JointNumber | None:
        leaves = [leaf for leaf in self._analysis.walk_definitions(tree) if self._joint_of(leaf) is not None]
        joint = self._joint_of(leaves[0]) if len(leaves) == 1 else None
        sign = self._sign(tree, leaves[0]) if joint is not None else None
        return None if joint is None or sign is None else JointNumber(*joint, sign)

    def _joint_of(self, leaf: Scalar) -> tuple[str, str] | None:
        """Return the robot and the joint that a leaf reads."""
        if isinstance(leaf, EngineRead) and leaf.function in _JOINT_READINGS and len(leaf.subjects) == 1:
            robot, _, joint = leaf.subjects[0].partition(".")
            return robot, joint
        reading = self._analysis.sensor(leaf)
        if reading is None or reading[1].kind not in _JOINT_READINGS:
            return None
        component = leaf.component if isinstance(leaf, Name) else None
        return reading[0], component or reading[1].subjects[0]

    def _sign(self, tree: Scalar, leaf: Scalar) -> int | None:
        """Return the sign of the factor of a leaf in a sum; None if the value is another function of it."""
        factor = linear(self._analysis, tree, {}).terms.get(self._analysis.identity(leaf))
        return None if factor is None else round(copysign(1.0, factor))

    @cached_property
    def _driven_joints(self) -> Mapping[tuple[str, str | None], JointNumber]:
        """The joint that a number of the action commands, of numbers that command one joint."""
        several: dict[tuple[str, str | None], list[JointNumber]] = {}
        for robot in self._analysis.program.robots:
            for command in robot.commands:
                if not isinstance(command.actuator, Motor):
                    continue
                joints = command.actuator.joints
                trees = self._analysis.value_on_robot(command.target.typed, command.target.owner, robot.name)
                if len(trees) != len(joints):
                    continue
                for joint, tree in zip(joints, trees, strict=True):
                    for leaf, sign in self._factors(tree, robot.name):
                        several.setdefault(leaf, []).append(JointNumber(robot.name, joint, sign))
        return {leaf: numbers[0] for leaf, numbers in several.items() if len(numbers) == 1}

    def _factors(self, tree: Scalar, robot: str) -> Iterator[tuple[tuple[str, str | None], int]]:
        variables = {part.name for part in self._analysis.program.agent.ranges}
        for leaf in self._analysis.walk_definitions(tree):
            if not isinstance(leaf, Name):
                continue
            variable = leaf.name.removeprefix(f"{robot}:")
            sign = self._sign(tree, leaf) if variable in variables else None
            if sign is not None:
                yield (variable, leaf.component), sign


def _mirrored(
    names: Sequence[str], joints: Sequence[JointNumber | None], mirror: Mirror
) -> Iterator[_MirroredNumber]:
    for index, (source, factor) in enumerate(zip(mirror.sources, mirror.factors, strict=True)):
        sign = -1 if factor < 0.0 else 1
        yield _MirroredNumber(names[index], names[source], sign, joints[index], joints[source])


@rule("DB618", versions="training")
def wrong_mirror_image(context: RuleContext) -> Iterator[Finding]:
    """Report mirror images that contradict the names of numbers, or the places and axes of joints."""
    training = context.program.agent.training
    if training is None or training.symmetry is None:
        return
    mirrors = _Mirrors(context.analysis, training.symmetry)
    numbers = [*mirrors.of_observation, *mirrors.of_action]
    yield from _unmatched_words(context, mirrors)
    for robot in context.program.world.robots:
        joint_numbers = [number for number in numbers if number.joint and number.joint.robot == robot.name]
        yield from _wrong_joints(context, joint_numbers, robot.model)


def _unmatched_words(context: RuleContext, mirrors: _Mirrors) -> Iterator[Finding]:
    """Report numbers that are their own mirror image, although their name has a word of `swap` in another
    spelling, and the name with the other word exists."""
    spec = context.checked.spec
    swap = spec.train.symmetry.swap if spec and spec.train and spec.train.symmetry else {}
    pairs = {**swap, **{image: word for word, image in swap.items()}}
    images: dict[str, str] = {}
    for numbers in (mirrors.of_observation, mirrors.of_action):
        names = {number.name for number in numbers}
        images |= {
            number.name: image
            for number in numbers
            if number.image == number.name and (image := _respelled(number.name, pairs, names))
        }
    if images:
        name, image = next(iter(images.items()))
        yield Finding(
            "DB618",
            context.values.key_span(("train", "symmetry", "swap")),
            f"`{name}` is its own mirror image, but there is also `{image}`{_more(images)}",
            "a word ends at `_`, at `.` and at the ends of a name: write the whole part of the name under"
            f" `swap`, with its mirror image: `{_part(name, image)}: ...`",
        )


def _respelled(name: str, pairs: Mapping[str, str], names: Iterable[str]) -> str | None:
    """Return the name with a word in place of its partner, where neither begins and ends at `_` or `.`, or
    both are in another case."""
    for word, image in pairs.items():
        for spell in (str, str.lower, str.upper, str.capitalize):
            changed = re.sub(re.escape(spell(word)), spell(image), name)
            if word.isalpha() and changed != name and changed in names:
                return changed
    return None


def _part(name: str, image: str) -> str:
    """Return the first part of a name, between `.` and `_`, that differs from that of another name."""
    pairs = zip(re.split("[._]", name), re.split("[._]", image), strict=False)
    return next((part for part, different in pairs if part != different), name)


class _PlacedNumber(NamedTuple):
    """A number of a joint, and the places of its joint and of that of its mirror image."""

    name: str
    sign: int
    place: JointPlace
    image: JointPlace


def _wrong_joints(
    context: RuleContext, numbers: Sequence[_MirroredNumber], model: RobotModel
) -> Iterator[Finding]:
    """Report numbers of joints of a robot whose mirror image is another joint, or has the other sign."""
    turned = link_frames(model)
    joint_places = {
        joint.name: JointPlace(
            joint, turned[joint.child][0], frames.rotate(turned[joint.child][1], joint.axis)
        )
        for joint in model.moving_joints
    }
    placed = [
        _PlacedNumber(
            number.name,
            number.sign * number.joint.sign * number.image_joint.sign,
            joint_places[number.joint.joint],
            joint_places[number.image_joint.joint],
        )
        for number in numbers
        if number.joint and number.image_joint and number.joint.robot == number.image_joint.robot
    ]
    plane = _mirror_plane([(entry.place, entry.image) for entry in placed if entry.place is not entry.image])
    if plane is not None:
        yield from _lone_joints(context, placed, plane, joint_places.values())
        yield from _wrong_signs(context, placed, plane)


def _lone_joints(
    context: RuleContext,
    numbers: Iterable[_PlacedNumber],
    plane: MirrorPlane,
    joint_places: Iterable[JointPlace],
) -> Iterator[Finding]:
    """Report numbers that are their own mirror image, although another joint is opposite of theirs."""
    notes: dict[str, str] = {}
    for name, _, joint_place, image in numbers:
        if joint_place is not image or abs(plane.distance(joint_place)) < _TOLERANCE_M:
            continue
        partner = next(
            (candidate for candidate in joint_places if plane.are_opposite(joint_place, candidate)), None
        )
        if partner is not None:
            notes[name] = (
                f"`{joint_place.joint.name}` is {abs(plane.distance(joint_place)):.3g} m from the mirror"
                f" plane {plane}; `{partner.joint.name}` is opposite"
            )
    if notes:
        name, note = next(iter(notes.items()))
        yield Finding(
            "DB618",
            context.values.key_span(("train", "symmetry", "swap")),
            f"`{name}` is its own mirror image, but its joint is on one side of the robot{_more(notes)}",
            "write under `swap` the words in which the names of the two sides differ",
            notes=(note,),
        )


def _wrong_signs(
    context: RuleContext, numbers: Iterable[_PlacedNumber], plane: MirrorPlane
) -> Iterator[Finding]:
    """Report numbers with a sign that contradicts the axes of their joints."""
    wrong = [
        entry
        for entry in numbers
        if (entry.place is not entry.image or abs(plane.distance(entry.place)) < _TOLERANCE_M)
        and plane.sign(entry.place, entry.image) == -entry.sign
    ]
    if not wrong:
        return
    first = wrong[0]
    changes = [
        f"{verb} `flip`: {_listed(names)}"
        for verb, sign in (("list under", 1), ("leave out of", -1))
        if (names := [entry.name for entry in wrong if entry.sign == sign])
    ]
    axes = " and ".join(dict.fromkeys((_axis(first.place), _axis(first.image))))
    yield Finding(
        "DB618",
        context.values.key_span(("train", "symmetry", "flip")),
        f"the sign of the mirror image of `{first.name}` contradicts the axes of the joints{_more(wrong)}",
        "; ".join(changes),
        notes=(f"with all joints at 0, {axes}, and the mirror plane is {plane}",),
    )


def _mirror_plane(pairs: Sequence[tuple[JointPlace, JointPlace]]) -> MirrorPlane | None:
    """Return the plane that mirrors the places of all pairs of joints; None if there is none, or several."""
    planes = []
    for k in range(3):
        middles = [(first.position[k] + second.position[k]) / 2.0 for first, second in pairs]
        plane = MirrorPlane(k, sum(middles) / len(middles)) if middles else None
        if plane and all(plane.are_opposite(*pair) for pair in pairs):
            planes.append(plane)
    return planes[0] if len(planes) == 1 else None


def _axis(joint_place: JointPlace) -> str:
    x, y, z = (round(part, 3) + 0.0 for part in joint_place.axis)
    return f"`{joint_place.joint.name}` has the axis {x:g} {y:g} {z:g}"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names[:_MAX_LISTED]) + _more(names, _MAX_LISTED)


def _more(names: Sized, listed: int = 1) -> str:
    return f", and {len(names) - listed} more" if len(names) > listed else ""
