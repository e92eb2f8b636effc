"""The engine port: everything that the runtime requires of a physics engine.

SI units, world frame (x forward, y left, z up), quaternions (x, y, z, w). Bodies, links and joints are
identified by name. Readers and writers are bound once, when the environment is built, so that a step needs no
look-up. A reader changes nothing: two calls between two steps return equal values.

docs/engine-port.md describes every method of `Engine`. `EngineProxy` passes each of them on: a method that is
added to the port is added there.

A further engine is a class that fits `Engine`: in a package with an entry point of the group
`deepbots.engines`, or in `engines/`, with its line in `engine_kinds.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partialmethod
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, ParamSpec, Protocol, TypeVar

from deepbots_cli.engine_kinds import Feature
from deepbots_cli.frames import Frame, Quaternion, Triple
from deepbots_cli.records import dataclass

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from deepbots_cli.program.world import EngineParameter, WorldModel

    Image = NDArray[np.uint8]

P = ParamSpec("P")
R = TypeVar("R")

SERVO_TIME = 0.02
"""Time (s) in which the servo of an engine, without stiffness, reduces its error to 1/e."""
Capability = Literal["contacts", "mimic", "rendering", "snapshot", Feature]
"""A feature that an engine may lack: contacts between bodies, joints that follow others, pictures, an exact
`snapshot` of the world; the armature of joints, a center of mass that an episode moves, motors whose torque
falls with their speed, the wrench in a joint, links of one robot that touch each other."""
Part = tuple[str, str | None]
"""A body and one of its links; None for all of its links, or for the root link where one frame is needed."""
JointReader = Callable[[], Sequence[Sequence[float]]]
"""One item per joint: position (rad or m) at index 0, velocity (rad/s or m/s) at index 1. Further items
depend on the engine."""
TorqueReader = Callable[[], Sequence[float]]
"""The torque (N m) or force (N) of the motor of each joint in the last engine step."""
PoseReader = Callable[[], tuple[Triple, Quaternion]]
"""Position of the link's origin (m), not of its center of mass, and its orientation."""
VelocityReader = Callable[[], tuple[Triple, Triple]]
"""Velocity of the link's origin (m/s) and its angular velocity (rad/s), both in the world frame."""
Motion = tuple[tuple[Triple, Quaternion], tuple[Triple, Triple]]
MotionReader = Callable[[], Motion]
"""The results of a `PoseReader` and a `VelocityReader`, read together."""
Gain = Sequence[float] | None
"""The gain of a spring, one per joint; None if a motor is not a spring, or does not damp."""
MotorWriter = Callable[[Sequence[float]], object]
"""Sets one target per joint, in force until the next call; after a reset motors exert nothing until written.

The limits that a motor is bound with are infinite where a joint has none.
"""


ZERO_VECTOR: Triple = (0.0, 0.0, 0.0)
Pusher = Callable[[Triple, Triple], object]
"""Takes a force (N) and a torque (N m)."""
ContactReader = Callable[[], bool]
ForceReader = Callable[[], float]
VectorReader = Callable[[], Triple]
WrenchReader = Callable[[], tuple[Triple, Triple]]
"""A force (N) and a torque (N m)."""
ClearanceReader = Callable[[], float]
RayReader = Callable[[], Sequence[float]]
Kinematics = Callable[[Triple, Quaternion | None], Sequence[float]]


CAMERA_RANGE_M = 100.0
"""The distance to which cameras see."""


_PARTS = frozenset({"body", "robot", "part", "one", "other", "others"})
"""The parameters of the port that are bodies or parts."""


class CameraImage(NamedTuple):
    """One picture: `colors` uint8 (height, width, 3); `depth` float32 (height, width) in m along the line of
    sight's axis, at most `CAMERA_RANGE_M`; `bodies` int32 (height, width), the index of each pixel's body in
    `body_names`, -1 for none. Each pixel is sampled at its center."""

    colors: Image
    depth: NDArray[np.float32]
    bodies: NDArray[np.int32]
    body_names: tuple[str, ...]


CameraReader = Callable[[], CameraImage]


class Overlap(NamedTuple):
    """Two links that lie within each other, by `depth` in m."""

    one: tuple[str, str]
    other: tuple[str, str]
    depth: float


@dataclass(frozen=True)
class View:
    """A camera that looks from `eye` at `target` (m), z up; `fov` is the vertical angle in rad.

    Each pixel is the mean of `samples` x `samples` points, which smooths edges.
    """

    eye: Triple
    target: Triple
    width: int = 480
    height: int = 320
    fov: float = 0.7
    samples: int = 2


class Bindable(Protocol):
    """The object to which readers and writers are bound when an environment is made: one world, or many
    worlds of one model.

    In many worlds, each number is a column: an array with one number per world. A column does not change
    after it was read.
    """

    name: str

    @property
    def gravity(self) -> Triple:
        """Gravity of the present episode, in m/s^2, world frame."""

    def contact(
        self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True
    ) -> ContactReader:
        """Return whether `one` touched one of `others` in any engine step of the last `step`; false after a
        reset.

        If `others` is None, all other bodies are meant, and other links of a robot with `self_collision`.
        `ground` includes plane and terrain.
        """

    def contact_force(self, one: Part) -> ForceReader:
        """Return the sum of normal forces (N) on `one` from everything that it touches: the mean of the
        engine steps of the last `step`; 0 after a reset."""

    def contact_force_vector(self, one: Part) -> VectorReader:
        """Return the sum of the contact forces (N, world frame) on `one` from everything else that it
        touches, friction included: the mean of the engine steps of the last `step`; 0 after a reset."""

    def clearance(self, one: Part, other: Part) -> ClearanceReader:
        """Return the distance between two surfaces, m: 0 if they touch, infinite if a body is absent."""

    def rays(self, part: Part, rays: Sequence[Frame], reach: float, *, upright: bool = False) -> RayReader:
        """Return a reader of rays along the x axis of frames in the frame of a link: the free distance (m) of
        each, at most `reach`.

        Rays ignore their own body, and bodies that are not solid. With `upright`, the frames follow the yaw
        of the link alone, and stay level when it tilts.
        """

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader: ...

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader: ...

    def joint_wrench(self, part: Part) -> WrenchReader:
        """Return the force and the torque that a link got from the joint that carries it, in the last engine
        step: at the origin of the link, in its axes; 0 after a reset.

        The link is not the root link. Callers need an engine with the capability `joint_wrench`.
        """

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        """Return a reader of the pose of a link, or of the root link of a robot or object."""

    def velocity(self, body: str, link: str | None = None) -> VelocityReader: ...

    def angular_momentum(self, robot: str) -> VectorReader:
        """Return the angular momentum (N m s, world frame) of a robot about its center of mass, with the
        masses of the episode. The base of a robot with a fixed base counts as a link at rest."""

    def motion(self, body: str, link: str | None = None) -> MotionReader:
        """Return a reader of pose and velocity in one call, which takes half the time of two calls if the
        link is not the root."""

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        """Drive joints towards target velocities (rad/s or m/s) with at most `max_torque` (N m or N)."""

    def position_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        stiffness: Gain,
        damping: Gain,
        *,
        stall_torque: Gain = None,
        no_load_speed: Gain = None,
    ) -> MotorWriter:
        """Drive joints towards target positions (rad or m).

        With stiffness (N m/rad or N/m) and damping (N m s/rad or N s/m), one per joint, the torque is
        `stiffness * (target - position) - damping * velocity`, limited, renewed in every engine step, and
        None for `damping` is 0; without stiffness the engine's own servo closes all but 1/e of its error in
        `SERVO_TIME`, as far as the limit allows, and `damping` means nothing.

        With `stall_torque` (N m or N) and `no_load_speed` (rad/s or m/s), one per joint, and stiffness, the
        torque at the velocity v lies, in every engine step, between `stall_torque * (-1 - v / no_load_speed)`
        and `stall_torque * (1 - v / no_load_speed)` as well, or 0 where these have the other sign. Callers
        pass them to engines with the capability `torque_curve` alone.
        """

    def torque_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        *,
        stall_torque: Gain = None,
        no_load_speed: Gain = None,
    ) -> MotorWriter:
        """Exert target torques (N m or N), limited, in every engine step until the next call.

        `stall_torque` and `no_load_speed` are those of `position_motor`.
        """

    def close(self) -> None:
        """Release the world; may be called twice."""


class Engine(Bindable, Protocol):
    """A physics engine with one world, for one environment."""

    capabilities: frozenset[Capability]

    def reset(self) -> None:
        """Reset every body to its pose in the world model, at rest, joints at 0, followers in place, motors
        off, no memory of contacts.

        The same calls then give bit for bit the same results as in a new world.
        """

    def place(
        self,
        body: str,
        position: Triple,
        orientation: Quaternion,
        velocity: Triple = ZERO_VECTOR,
        angular_velocity: Triple = ZERO_VECTOR,
    ) -> None:
        """Set the frame and the velocities of a body's root link (world frame). Called between `reset` and
        the first step.

        A pooled body is absent from a reset until it is placed: it touches nothing, and sensors do not see
        it.
        """

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        """Set position and velocity of a joint (rad or m; rad/s or m/s), and of its followers. Called between
        `reset` and the first step.

        Followers are the joints with `<mimic>` (`RobotModel.followers`). An engine that simulates them has
        "mimic" among its capabilities; others do not get such a world.
        """

    def choose(self, body: str, variant: str) -> None:
        """Let a pooled body take the form of one of its variants. Called between `reset` and `place`, before
        parameters are set."""

    def set_parameter(self, parameter: EngineParameter, owner: tuple[str, ...], *values: float) -> None:
        """Set a parameter of an episode. Called between `reset` and `place`; it is valid until the next
        reset, which restores the model.

        Of the world, `()`: `gravity` (x, y, z in m/s^2, world frame), `light` (brightness of images; 1 is
        normal). Of a body and its link, or "" for its root link: `mass` (kg; the inertia scales along),
        `inertia` (a further factor on the inertia), `center_of_mass` (x, y, z of its offset from the model in
        m, axes of a link with `center_varies`), `color` (red, green, blue and opacity, 0 to 1),
        `lateral_friction`, `spinning_friction`, `rolling_friction`, `restitution`. Of a robot and its joint:
        `joint_damping` (N m s/rad or N s/m), `joint_friction` (N m or N), `joint_armature` (kg m^2 or kg).

        Raises:
            EngineError: The engine cannot set it, or the world has no such body, link or joint.
        """

    # Functions that act in every engine step; bound at build, called in the order of binding

    def before_substep(self, callback: Callable[[], object]) -> None:
        """Call `callback` before each engine step of `step`."""

    def pusher(self, part: Part, frame: Literal["world", "link"] = "world") -> Pusher:
        """Return a function that pushes a link at its origin, in the next engine step only, with axes of the
        world or of the link."""

    def camera(self, part: Part, mount: Frame, width: int, height: int, fov: float) -> CameraReader:
        """Return a camera that looks along the x axis of `mount`, z up; `fov` is the vertical angle in rad.

        Only the outer side of a surface is visible, so a camera inside a hull looks out of it.

        Raises:
            EngineError: The engine cannot draw.
        """

    def inverse_kinematics(self, part: Part, joints: Sequence[str]) -> Kinematics:
        """Return a function that gives positions of joints (rad or m), within their ranges, for which the
        origin of a link is at a position, in a given orientation or in any (None).

        The same call in the same state of the world gives the same bits.
        """

    def step(self, substeps: int) -> None:
        """Advance by `substeps` engine steps of `timestep / substeps` of the world model each."""

    def snapshot(self) -> object:
        """Return the state of the world between two steps, for `restore`; taking it changes nothing.

        It contains everything on which later steps depend: poses, velocities, the memory of contacts, the
        commands of motors, and the values that were set since the reset. It does not contain the state of
        callers: random streams, messages in flight, and the state of functions of `before_substep`.

        Only an engine with exact snapshots has "snapshot" among its capabilities. With other engines, callers
        begin the episode again and repeat its actions.

        Raises:
            EngineError: The engine has no exact snapshot.
        """

    def restore(self, snapshot: object) -> None:
        """Restore an earlier snapshot of this engine object; any number of times, also across resets.

        The same calls then give bit for bit the same readings as after the snapshot was taken. Readers and
        writers stay bound.

        Raises:
            EngineError: The engine has no exact snapshot.
        """

    def overlaps(self) -> Sequence[Overlap]:
        """Return the overlaps in the present state of the world: the deepest pair of links of every two
        bodies, and within a robot with `self_collision`; deepest first.

        At least one of the two can move; the ground is one of the bodies. The call may change later contacts
        by rounding errors.
        """

    def require_finite(self) -> None:
        """Check every pose and joint.

        Raises:
            EngineError: A number is not finite, or no motor and no fall gives a joint its speed; the message
                names the body, or the joint.
        """

    def render(self, view: View) -> Image:
        """Return an image of the world: uint8, shape (height, width, 3).

        Raises:
            EngineError: The engine cannot draw (no "rendering" among its capabilities).
        """


class EngineProxy:
    """An `Engine` that passes each call on to another one. A method that is added to the port is added here.

    In the table below, each method has the number of its first arguments that are bodies or parts.
    """

    name: str
    capabilities: frozenset[Capability]

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.name = engine.name
        self.capabilities = engine.capabilities

    def body(self, name: str) -> str:
        """Return the name of a body in the other engine."""
        return name

    def bound(self, read: Callable[P, R]) -> Callable[P, R]:
        """Return a reader of the other engine, as this one gives it."""
        return read

    def changing(self, body: str = "") -> Engine | None:
        """Return the other engine, to change this body or the world; None where this engine leaves it
        alone."""
        return self.engine

    @property
    def gravity(self) -> Triple:
        return self.engine.gravity

    def close(self) -> None:
        """Do nothing: the creator of the other engine closes it."""

    def _renamed(self, value: Any) -> Any:
        """Return a body, a part or several parts, as the other engine calls them."""
        if not value:
            return value
        if isinstance(value, str):
            return self.body(value)
        if isinstance(value[0], str):
            return self.body(value[0]), *value[1:]
        return tuple(map(self._renamed, value))

    def _pass(self, method: str, parts: int, *args: Any, **kwargs: Any) -> Any:
        return getattr(self.engine, method)(
            *map(self._renamed, args[:parts]),
            *args[parts:],
            **{name: self._renamed(value) if name in _PARTS else value for name, value in kwargs.items()},
        )

    def _reader(self, method: str, parts: int, *args: Any, **kwargs: Any) -> Any:
        return self.bound(self._pass(method, parts, *args, **kwargs))

    def _call(self, method: str, parts: int, *args: Any, **kwargs: Any) -> Any:
        # The table would bind `_pass` of this class, also where a subclass has its own.
        return self._pass(method, parts, *args, **kwargs)

    def place(self, body: str, *args: Any, **kwargs: Any) -> None:
        if engine := self.changing(body):
            engine.place(self.body(body), *args, **kwargs)

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        if engine := self.changing(robot):
            engine.set_joint(self.body(robot), joint, position, velocity)

    def choose(self, body: str, variant: str) -> None:
        if engine := self.changing(body):
            engine.choose(self.body(body), variant)

    def set_parameter(self, parameter: EngineParameter, owner: tuple[str, ...], *values: float) -> None:
        if engine := self.changing(*owner[:1]):
            engine.set_parameter(parameter, self._renamed(owner), *values)

    contact = partialmethod(_reader, "contact", 2)
    contact_force = partialmethod(_reader, "contact_force", 1)
    contact_force_vector = partialmethod(_reader, "contact_force_vector", 1)
    clearance = partialmethod(_reader, "clearance", 2)
    rays = partialmethod(_reader, "rays", 1)
    camera = partialmethod(_reader, "camera", 1)
    inverse_kinematics = partialmethod(_reader, "inverse_kinematics", 1)
    joint_states = partialmethod(_reader, "joint_states", 1)
    joint_torques = partialmethod(_reader, "joint_torques", 1)
    joint_wrench = partialmethod(_reader, "joint_wrench", 1)
    pose = partialmethod(_reader, "pose", 1)
    velocity = partialmethod(_reader, "velocity", 1)
    angular_momentum = partialmethod(_reader, "angular_momentum", 1)
    motion = partialmethod(_reader, "motion", 1)

    velocity_motor = partialmethod(_call, "velocity_motor", 1)
    position_motor = partialmethod(_call, "position_motor", 1)
    torque_motor = partialmethod(_call, "torque_motor", 1)
    pusher = partialmethod(_call, "pusher", 1)

    reset = partialmethod(_call, "reset", 0)
    step = partialmethod(_call, "step", 0)
    before_substep = partialmethod(_call, "before_substep", 0)
    snapshot = partialmethod(_call, "snapshot", 0)
    restore = partialmethod(_call, "restore", 0)
    overlaps = partialmethod(_call, "overlaps", 0)
    require_finite = partialmethod(_call, "require_finite", 0)
    render = partialmethod(_call, "render", 0)


class BatchEngine(Bindable, Protocol):
    """An engine that steps many worlds of one model together; `gravity` is that of the model, which episodes
    may change."""

    capabilities: frozenset[Capability]
    """The capabilities that all members have."""
    members: Sequence[Engine]
    """An engine per world, which begins the episodes of its world and serves rare readers."""
    write_mask: NDArray[np.bool_] | None
    """The worlds that motors are written in; None for all."""

    def step(self, substeps: int, running: NDArray[np.bool_] | None = None) -> None:
        """Advance all worlds, or only those that are `running`."""

    def begin(self, worlds: Sequence[int]) -> None:
        """Reset some worlds together. The next reset of their members does nothing, and a step of a member
        waits for `begin_episodes`."""

    def begin_episodes(self) -> None:
        """Take over the episodes that members have begun, and let those of `begin` settle together."""

    def non_finite_worlds(self) -> NDArray[np.intp]:
        """Return the numbers of the worlds whose state is not finite."""


class EngineFactory(Protocol):
    """The class that `engines/` registers under a name."""

    def __call__(self, world: WorldModel) -> Engine: ...


def cast_rays(engine: Engine, part: Part, rays: Sequence[Frame], reach: float, *, upright: bool) -> RayReader:
    """Return a reader of rays; an engine of another package may lack `upright` and still cast other rays."""
    return engine.rays(part, rays, reach, upright=True) if upright else engine.rays(part, rays, reach)
