"""Bodies of an engine by name, objects as robots of one link, masses, the torque of DC motors, and inverse
kinematics.

Inverse kinematics (`Chain`) follows the rule of Levenberg and Marquardt on the error of position (m) and
attitude (rad, counted as `METERS_PER_RAD` m each): a step is (J^T J + c 1)^-1 J^T e, and c falls after steps
that help and grows after steps that do not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import atan2, inf
from typing import TYPE_CHECKING, Generic, NamedTuple, ParamSpec, Protocol, TypeVar

import numpy as np

from deepbots_cli import frames
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_FRAME, Frame, Quaternion, Triple
from deepbots_cli.port import ZERO_VECTOR
from deepbots_cli.program.world import ARENA_WALLS, WALL_COLOR, Arena, ObjectBody
from deepbots_cli.robots.model import (
    Box,
    Friction,
    Geometry,
    Inertial,
    Link,
    Pose,
    RobotModel,
    homogeneous_inertial,
    with_link,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.port import Engine, Kinematics, Part
    from deepbots_cli.robots.model import Joint

    FloatArray = NDArray[np.float64]


Entry = TypeVar("Entry")
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def named(table: Mapping[str, Entry], name: str, message: str) -> Entry:
    """Return the entry called `name`.

    Raises:
        EngineError: There is none. It begins with `message`, and lists the existing names.
    """
    try:
        return table[name]
    except KeyError:
        raise EngineError(f"{message} '{name}'; there are {', '.join(table)}") from None


class BodyForm(Protocol):
    """A body in an engine."""

    def deactivate(self) -> None:
        """Make the body absent: touched and seen by nothing."""

    def activate(self) -> None:
        """Make the body present."""


Body = TypeVar("Body", bound=BodyForm)


class Pool(Generic[Body]):
    """The forms of one name. A body that is not pooled has one form and is always present."""

    def __init__(self, name: str, forms: Sequence[tuple[str, Body]], pooled: bool) -> None:
        self.name = name
        self.pooled = pooled
        self.present = not pooled
        self.current = forms[0][1]
        self._forms = dict(forms)

    def __iter__(self) -> Iterator[Body]:
        return iter(self._forms.values())

    def choose(self, form: str) -> None:
        self.current = named(self._forms, form, f"'{self.name}' has no variant")

    def deactivate(self) -> None:
        """Make the body absent, in the first form."""
        if self.pooled:
            self.present = False
            self.current = next(iter(self))
            for body in self:
                body.deactivate()

    def activate(self) -> Body:
        """Make the body present, in the chosen form."""
        self.present = True
        self.current.activate()
        return self.current

    def bind_current(
        self, bind: Callable[[Body], Callable[Arguments, Result]]
    ) -> Callable[Arguments, Result]:
        """Bind a function to the form that is present when it is called. A body with a single form is bound
        directly, without a look-up."""
        if len(self._forms) == 1:
            return bind(self.current)
        table = {id(body): bind(body) for body in self}

        def call_current(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
            return table[id(self.current)](*args, **kwargs)

        return call_current


MAX_TURN_RATE = 1e4
"""In rad/s, ten times the speed of a rotor; the turbine of a dental drill, the fastest of joints, states its
own."""
MAX_SLIDING_SPEED = 1e3
"""In m/s; three times the speed of sound."""


def fastest(joint: Joint) -> float:
    """Return the speed (rad/s or m/s) that no motor and no fall gives a joint: the larger of the constant for
    its kind and twice the limit that the joint states."""
    most = MAX_SLIDING_SPEED if joint.type == "prismatic" else MAX_TURN_RATE
    return max(most, 2.0 * (joint.limit.velocity or 0.0))


class JointSpeed(NamedTuple):
    """A joint of a robot, its speed (rad/s or m/s), and the stiffness of its spring motor (N m/rad or N/m; 0
    without one)."""

    robot: str
    joint: Joint
    speed: float
    stiffness: float = 0.0


def require_possible(speeds: Iterable[JointSpeed], step: float) -> None:
    """Check the speeds of joints after a physics step of `step` s.

    Raises:
        EngineError: No motor and no fall gives a joint that speed. One with a spring is named first, because
            it may drive the others.
    """
    impossible = [entry for entry in speeds if abs(entry.speed) > fastest(entry.joint)]
    if impossible:
        robot, joint, speed, stiffness = max(impossible, key=lambda entry: entry.stiffness)
        slides = joint.type == "prismatic"
        unit = "N/m" if slides else "N*m/rad"
        spring = f"its spring of {stiffness:g} {unit}" if stiffness else "its motion"
        raise EngineError(
            f"joint '{joint.name}' of '{robot}' {'slides' if slides else 'turns'} at {abs(speed):.3g}"
            f" {'m/s' if slides else 'rad/s'}, which no motor and no fall could give it: {spring} is not stable"
            f" with physics steps of {1000.0 * step:g} ms; write more `substeps` under `world`, or lower the"
            " `stiffness` and `damping` of its motor (`deepbots lint` names stable ones)"
        )


ROOT_MASS_FRACTION = 1e-6
"""The mass of a root without mass, as a share of the mass that is attached to it. Its inertia is that of this
mass at a distance of 1 m."""


def rigid_group(model: RobotModel, first: str) -> dict[str, Frame]:
    """Return the links that fixed joints attach to `first`, itself included, and their frames in its
    frame."""
    members = {first: IDENTITY_FRAME}
    waiting = [first]
    while waiting:
        parent = waiting.pop()
        for joint in model.joints:
            if joint.parent == parent and joint.type == "fixed":
                members[joint.child] = frames.compose(members[parent], frames.frame(joint.origin))
                waiting.append(joint.child)
    return members


def with_explicit_masses(name: str, model: RobotModel, fixed_base: bool) -> RobotModel:
    """Return the model with a mass on each link: 0 where the file states none, for which a loader would
    invent 1 kg.

    Raises:
        EngineError: A joint or a free base moves nothing that has mass, or a joint is of a kind that is not
            supported.
    """
    subtree_mass = model.subtree_mass()
    for joint in model.joints:
        if joint.type in ("floating", "planar"):
            raise EngineError(
                f"the engine does not support {joint.type} joints, such as '{joint.name}' of '{name}'"
            )
        if joint.moves and subtree_mass[joint.child] <= 0.0:
            raise EngineError(
                f"joint '{joint.name}' of '{name}' moves no mass; add an <inertial> with a mass to link"
                f" '{joint.child}', or a `mass` under `links` in the scenario"
            )
    root = model.link(model.root).inertial
    if not fixed_base and (root is None or root.mass <= 0.0):
        model = _with_trace_mass_at_root(name, model)
    return replace(
        model, links=tuple(replace(link, inertial=link.inertial or Inertial(0.0)) for link in model.links)
    )


def _with_trace_mass_at_root(name: str, model: RobotModel) -> RobotModel:
    """Return the model whose root is a mere frame, as `base_footprint` is, with a trace of the mass that
    fixed joints attach to it.

    The engine would take a free root without mass for one that is bolted to the world.

    Raises:
        EngineError: No link that is rigidly attached to the root has a mass.
    """
    links = [model.link(link).inertial for link in rigid_group(model, model.root)]
    mass = sum(link_mass.mass for link_mass in links if link_mass)
    if mass <= 0.0:
        raise EngineError(
            f"root link '{model.root}' of '{name}' has no mass; add an <inertial>, or write `base: fixed`"
        )
    trace = ROOT_MASS_FRACTION * mass
    return with_link(
        model, replace(model.link(model.root), inertial=Inertial(trace, ixx=trace, iyy=trace, izz=trace))
    )


LINK_COLORS = (
    (0.84, 0.44, 0.24, 1.0),
    (0.27, 0.45, 0.66, 1.0),
    (0.30, 0.32, 0.36, 1.0),
    (0.86, 0.70, 0.32, 1.0),
    (0.42, 0.60, 0.46, 1.0),
)
"""The colors that links without a color of their own get, in turn."""


def is_movable(body: ObjectBody) -> bool:
    """Return whether physics moves the object. One without mass, or that is only seen, stays where it is
    put."""
    return body.solid and not body.fixed and body.mass > 0.0


def forms_of(body: ObjectBody) -> dict[str, ObjectBody]:
    """Return the object in each of its variants, by their names; by its own if it has none."""
    fields = ("shape", "mass", "color", "friction", "fixed")
    forms = {
        variant.name: replace(body, variants=(), **{field: getattr(variant, field) for field in fields})
        for variant in body.variants
    }
    return forms or {body.name: body}


def as_robot(body: ObjectBody) -> RobotModel:
    """Return the object as a robot of one link with the object's name; the inertia of a mesh is 0, for the
    engine to find."""
    geometry = Geometry(body.shape, color=body.color)
    link = Link(
        name=body.name,
        inertial=homogeneous_inertial(body.shape, body.mass) or Inertial(body.mass),
        visuals=(geometry,),
        collisions=(geometry,) if body.solid else (),
        friction=Friction(body.friction, body.spinning_friction, body.rolling_friction, body.restitution),
    )
    return RobotModel(name=body.name, links=(link,), joints=(), root=body.name)


def arena_walls(arena: Arena) -> tuple[ObjectBody, ...]:
    """Return four fixed boxes around the inner size of the arena. They are not one body of four parts, since
    an engine discards distant boxes cheaply."""
    x, y = arena.size
    height = arena.wall_height
    thick = arena.wall_thickness
    sides = (
        ((x + thick) / 2, 0.0, thick, y + 2 * thick),
        (-(x + thick) / 2, 0.0, thick, y + 2 * thick),
        (0.0, (y + thick) / 2, x, thick),
        (0.0, -(y + thick) / 2, x, thick),
    )
    return tuple(
        ObjectBody(
            name=name,
            shape=Box((along_x, along_y, height)),
            pose=Pose((at_x, at_y, height / 2)),
            color=arena.color or WALL_COLOR,
            friction=arena.friction,
            fixed=True,
        )
        for name, (at_x, at_y, along_x, along_y) in zip(ARENA_WALLS, sides, strict=True)
    )


class TorqueCurve(NamedTuple):
    """The stall torques (N m or N) and no-load speeds (rad/s or m/s) of the motors of several joints.

    The largest torque falls linearly from the stall torque at rest to 0 at the no-load speed; a motor that
    brakes exerts more than its stall torque. Both are cut off at a limit.
    """

    stall_torques: Sequence[float]
    no_load_speeds: Sequence[float]

    def bounds(self, velocities: Sequence[float], limits: Sequence[float]) -> list[tuple[float, float]]:
        """Return the smallest and the largest torque of each motor (N m or N), at velocities in rad/s or m/s
        and limits in N m or N."""
        bounds = []
        for stall, fastest, velocity, limit in zip(*self, velocities, limits, strict=True):
            share = velocity / fastest
            low, high = stall * (1.0 + share), stall * (1.0 - share)
            bounds.append((-min(max(low, 0.0), limit), min(max(high, 0.0), limit)))
        return bounds


def torque_curve(
    stall_torque: Sequence[float] | None, no_load_speed: Sequence[float] | None
) -> TorqueCurve | None:
    """Return the curve of the arguments of a motor; None where there is none."""
    if stall_torque is None or no_load_speed is None:
        return None
    return TorqueCurve(tuple(stall_torque), tuple(no_load_speed))


METERS_PER_RAD = 0.3  # m; the weight of an error of 1 rad
TOLERANCE_M = 1e-7  # m; an error to stop at
MAX_ITERATIONS = 100
STALL_RATIO = 0.99  # a round that leaves more than this share of the square of the error has not helped
CHORD_RATIO = 1e-5  # a round that leaves less of it does not need a new Jacobian
MAX_STALLED_ITERATIONS = 12  # in a row, after which the search gives up
MAX_STEP = 0.5  # rad or m; of a joint in one round


class Segment(NamedTuple):
    """The step from one moving joint to the next: a fixed frame, then the joint."""

    frame: Frame
    axis: Triple
    turns: bool

    def movement(self, place: Frame, point: Triple) -> tuple[Triple, Triple]:
        """Return how the joint moves a point, per rad or m of the joint, and the rotation, in `METERS_PER_RAD`
        m per rad. `place` is the frame of the joint."""
        axis = frames.rotate(place[1], self.axis)
        if not self.turns:
            return axis, ZERO_VECTOR
        return frames.cross(axis, frames.subtract(point, place[0])), frames.scaled(axis, METERS_PER_RAD)


class Chain:
    """The chain from the root of a robot to one of its links. `moving_joints` names the joints on the way,
    and joints beside it that these follow; `driven` of them may be solved for."""

    def __init__(self, model: RobotModel, link: str, driven: Sequence[str]) -> None:
        path = _path(model, link)
        names = [joint.name for joint in path if joint.moves]
        leaders = {mimic.joint for name, mimic in model.followers.items() if name in names}
        self.moving_joints = (*names, *(name for name in driven if name in leaders.difference(names)))
        strange = [name for name in driven if name not in self.moving_joints]
        if strange:
            raise EngineError(f"joint '{strange[0]}' does not move link '{link}' of '{model.name}'")
        self._segments: list[Segment] = []
        self._tip = IDENTITY_FRAME
        """The frame of the link in that of the last moving joint."""
        for joint in path:
            self._tip = frames.compose(self._tip, frames.frame(joint.origin))
            if joint.moves:
                self._segments.append(Segment(self._tip, joint.axis, joint.type != "prismatic"))
                self._tip = IDENTITY_FRAME
        # A leader beside the way moves nothing but its followers.
        beside = len(self.moving_joints) - len(names)
        self._segments += [Segment(IDENTITY_FRAME, ZERO_VECTOR, turns=False)] * beside
        self._driven = [self.moving_joints.index(name) for name in driven]
        self._followers = [
            (index, self._driven.index(self.moving_joints.index(mimic.joint)), mimic)
            for index, name in enumerate(self.moving_joints)
            if (mimic := model.followers.get(name)) is not None and mimic.joint in driven
        ]
        """The followers of driven joints: their place, that of the leader among the driven joints, and their
        linear relation."""
        self._ranges = [model.joint(name).ends(inf) for name in driven]

    def solve(
        self, root: Frame, positions: Sequence[float], target: Triple, attitude: Quaternion | None
    ) -> list[float]:
        """Return positions of the driven joints that bring the link's origin to a position, or as near as the
        search gets.

        `root` is the pose of the root link, `positions` are the positions of all `moving_joints`. The search
        begins there; if it misses the target, it begins again in the middle and at both quarters of the
        ranges: from a stretched arm, or with joints at their limits, it does not find a way to bend.
        """
        inward = frames.inverse(root[1])
        goal = frames.rotate(inward, frames.subtract(target, root[0]))
        local_attitude = None if attitude is None else frames.multiply(inward, frames.normalized(attitude))
        best = self._search(self._clamped(positions), goal, local_attitude)
        for share in (0.5, 0.25, 0.75):
            if best[1] > TOLERANCE_M * TOLERANCE_M:
                other = self._search(self._within_ranges(positions, share), goal, local_attitude)
                # An arm does not jump to another pose that is hardly nearer.
                best = other if other[1] < STALL_RATIO * best[1] else best
        return [best[0][index] for index in self._driven]

    def _clamped(self, positions: Sequence[float]) -> list[float]:
        """Return these positions, with the driven joints within their ranges."""
        joints = list(positions)
        for index, (low, high) in zip(self._driven, self._ranges, strict=True):
            joints[index] = min(max(joints[index], low), high)
        return joints

    def _within_ranges(self, positions: Sequence[float], share: float) -> list[float]:
        """Return these positions, with the driven joints at this share of their ranges, if they have any."""
        joints = list(positions)
        for index, (low, high) in zip(self._driven, self._ranges, strict=True):
            if low > -inf and high < inf:
                joints[index] = (1.0 - share) * low + share * high
        return joints

    def _search(
        self, joints: list[float], goal: Triple, local_attitude: Quaternion | None
    ) -> tuple[list[float], float]:
        """Return the end of the search from these positions, and the square of the error that is left."""
        end_frame, places = self._forward(joints)
        error = _error(end_frame, goal, local_attitude)
        jacobian = None
        identity = np.eye(len(self._driven))
        damping = 1e-4
        missing = sum(part * part for part in error)
        idle = 0
        for _ in range(MAX_ITERATIONS):
            if missing < TOLERANCE_M * TOLERANCE_M or damping > 1e8 or idle > MAX_STALLED_ITERATIONS:
                break
            if jacobian is None:
                jacobian = self._jacobian(end_frame, places, len(error))
            # Damping keeps the matrix invertible where a stretched chain makes the Jacobian lose rank.
            normal = jacobian.T @ jacobian + damping * identity
            steps = np.linalg.solve(normal, jacobian.T @ error).tolist()
            tried = list(joints)
            for index, step, (low, high) in zip(self._driven, steps, self._ranges, strict=True):
                tried[index] = min(max(joints[index] + min(max(step, -MAX_STEP), MAX_STEP), low), high)
            new_frame, new_places = self._forward(tried)
            new_error = _error(new_frame, goal, local_attitude)
            left = sum(part * part for part in new_error)
            idle = idle + 1 if left > STALL_RATIO * missing else 0
            if left > CHORD_RATIO * missing:
                jacobian = None
            if left < missing:
                joints, end_frame, places = tried, new_frame, new_places
                error, missing = new_error, left
                damping = max(damping * 0.2, 1e-9)
            else:
                damping *= 10.0
        return joints, missing

    def _jacobian(self, end_frame: Frame, places: Sequence[Frame], size: int) -> FloatArray:
        """Return how the error, which has this size, shrinks with each driven joint; `places` are the frames
        of all moving joints."""
        indices = (*self._driven, *(follower for follower, _, _ in self._followers))
        movements = [self._segments[index].movement(places[index], end_frame[0]) for index in indices]
        return self._with_followers(np.array([(*way, *turn)[:size] for way, turn in movements])).T

    def _forward(self, joints: Sequence[float]) -> tuple[Frame, list[Frame]]:
        """Return the frame of the link at these positions, and those of all moving joints."""
        joints = list(joints)
        for follower, leader, mimic in self._followers:
            joints[follower] = mimic.position(joints[self._driven[leader]])
        end_frame = IDENTITY_FRAME
        places = []
        for (frame, axis, turns), value in zip(self._segments, joints, strict=True):
            position, rotation = end_frame = frames.compose(end_frame, frame)
            places.append(end_frame)
            end_frame = (
                (position, frames.multiply(rotation, frames.from_axis_angle(axis, value)))
                if turns
                else (frames.add(position, frames.scaled(frames.rotate(rotation, axis), value)), rotation)
            )
        return frames.compose(end_frame, self._tip), places

    def _with_followers(self, rows: FloatArray) -> FloatArray:
        """Return a row for each driven joint, from its own row and those of its followers."""
        count = len(self._driven)
        for row, (_, leader, mimic) in zip(rows[count:], self._followers, strict=True):
            rows[leader] += mimic.multiplier * row
        return rows[:count]


def inverse_kinematics(engine: Engine, model: RobotModel, part: Part, joints: Sequence[str]) -> Kinematics:
    """Return `Engine.inverse_kinematics` for a robot of this model."""
    chain = Chain(model, part[1] or model.root, joints)
    root = engine.pose(part[0])
    read = engine.joint_states(part[0], chain.moving_joints)
    return lambda position, attitude: chain.solve(root(), [state[0] for state in read()], position, attitude)


def _path(model: RobotModel, link: str) -> list[Joint]:
    """Return the joints from the root to a link, in this order."""
    above = {joint.child: joint for joint in model.joints}
    path = []
    while link in above:
        path.append(above[link])
        link = above[link].parent
    return path[::-1]


def _error(end_frame: Frame, goal: Triple, attitude: Quaternion | None) -> Sequence[float]:
    """Return the way to the goal: of the position, and with an attitude of the rotation."""
    way = frames.subtract(goal, end_frame[0])
    if attitude is None:
        return way
    turn = _rotation_vector(frames.multiply(attitude, frames.inverse(end_frame[1])))
    return (*way, *frames.scaled(turn, METERS_PER_RAD))


def _rotation_vector(q: Quaternion) -> Triple:
    """Return the axis of a rotation times its angle (rad), at most half a turn."""
    # q and -q are the same rotation; the one with w >= 0 is the shorter way.
    x, y, z, w = q if q[3] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    length = float(np.hypot(np.hypot(x, y), z))
    # 2 is the limit of the ratio for small angles.
    return frames.scaled((x, y, z), 2.0 * atan2(length, w) / length if length > 0.0 else 2.0)
