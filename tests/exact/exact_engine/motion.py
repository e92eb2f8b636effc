"""Equations of motion in closed form, integrated by Runge and Kutta's fourth-order rule in steps of at most
`FINE`.

A motion keeps its state between calls of `advance(dt)`, and says where its links are and how they move.

Cart-pole: axes may point anywhere. With x along the unit vector a, the angle t about b, the pole's center at
R(t) r from the hinge, u = b x Rr, n = b x u, total mass M + m, the pole's mass m and its moment of inertia J
about the hinge, gravity g, damping c and d:

    (M + m) x"  + m (a.u) t"  =  F + (M + m) g.a - m (a.n) t'^2 - c x'
    m (a.u) x"  +    J    t"  =  T + m g.u - d t'

These are Lagrange's equations of the two bodies: kinetic energy (M + m) x'^2 / 2 + m (a.u) x' t' + J t'^2 /
2, potential energy of both in g. For a level rail and an upright pole with its center at l, a.u = l cos t and
a.n = -l sin t, which is the textbook's pair.

Rigid bodies: the center of mass follows a parabola; the attitude follows from the angular momentum L, which
is constant, by q' = w q / 2 with w = L / I in the body's present attitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, cos, isfinite, sin

from deepbots_cli import frames
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import (
    IDENTITY_FRAME,
    Frame,
    Quaternion,
    Triple,
    add,
    cross,
    dot,
    inverse,
    multiply,
    rotate,
    scaled,
    subtract,
)
from deepbots_cli.port import SERVO_TIME
from deepbots_cli.robots.model import Joint
from exact_engine.lump import Lump

FINE = 5e-4  # s; keeps the energy of a pendulum that goes round to 1e-10 over 10 s
SWEEPS = 30  # rounds in which motors on both joints settle what each has to exert
State = tuple[float, float, float, float]


class RigidBody:
    """A body in free flight: a parabola, and a spin whose angular momentum is constant. It stays put unless
    it `flies`."""

    def __init__(self, lump: Lump, gravity: Triple, flies: bool) -> None:
        self.flies = flies
        self._gravity = gravity
        self.weigh(lump)
        self.place(IDENTITY_FRAME)

    @property
    def lumps(self) -> tuple[str, ...]:
        """The first link of each."""
        return (self.lump.name,)

    def weigh(self, lump: Lump) -> None:
        """Have this mass and inertia; to be placed afterwards."""
        self.lump = lump
        self._inverse = lump.inverse_inertia() if self.flies else None

    def pull(self, gravity: Triple) -> None:
        """Feel this gravity (m/s^2, world frame) from now on."""
        self._gravity = gravity

    def place(self, frame: Frame) -> None:
        """Put the origin of the root link there, at rest."""
        self.center = add(frame[0], rotate(frame[1], self.lump.center))
        self.turned = frame[1]
        self.speed: Triple = (0.0, 0.0, 0.0)
        self.momentum: Triple = (0.0, 0.0, 0.0)

    def throw(self, linear: Triple, angular: Triple) -> None:
        """Give its root link's origin a velocity (m/s), and it an angular one (rad/s), in the world frame."""
        if self.flies:
            self.speed = add(linear, cross(angular, rotate(self.turned, self.lump.center)))
            self.spin(angular)

    def spin(self, angular: Triple) -> None:
        """Give it an angular velocity (rad/s, world frame)."""
        self.momentum = rotate(self.turned, self.lump.times_inertia(rotate(inverse(self.turned), angular)))

    def advance(self, dt: float) -> None:
        if not self.flies:
            return
        self.center = add(self.center, add(scaled(self.speed, dt), scaled(self._gravity, dt * dt / 2)))
        self.speed = add(self.speed, scaled(self._gravity, dt))
        pieces = ceil(dt / FINE)
        for _ in range(pieces):
            self._turn(dt / pieces)

    def _turn(self, h: float) -> None:
        q = self.turned
        k1 = self._rate(q)
        k2 = self._rate(_moved(q, k1, h / 2))
        k3 = self._rate(_moved(q, k2, h / 2))
        k4 = self._rate(_moved(q, k3, h))
        a, b, c, d = (
            h / 6 * (r1 + 2 * r2 + 2 * r3 + r4) for r1, r2, r3, r4 in zip(k1, k2, k3, k4, strict=True)
        )
        self.turned = frames.normalized((q[0] + a, q[1] + b, q[2] + c, q[3] + d))

    def _rate(self, q: Quaternion) -> Quaternion:
        x, y, z = self._angular(q)
        return multiply((x / 2, y / 2, z / 2, 0.0), q)

    def _angular(self, q: Quaternion) -> Triple:
        """Angular velocity (rad/s, world frame) of the constant momentum in the attitude `q`."""
        if self._inverse is None:
            return (0.0, 0.0, 0.0)
        local = rotate(inverse(q), self.momentum)
        rows = self._inverse
        return rotate(q, (dot(rows[0], local), dot(rows[1], local), dot(rows[2], local)))

    @property
    def links(self) -> tuple[str, ...]:
        return tuple(self.lump.members)

    def pose(self, link: str) -> Frame:
        root = (subtract(self.center, rotate(self.turned, self.lump.center)), self.turned)
        return frames.compose(root, self.lump.members[link])

    def velocity(self, link: str) -> tuple[Triple, Triple]:
        angular = self._angular(self.turned)
        return add(self.speed, cross(angular, subtract(self.pose(link)[0], self.center))), angular

    @property
    def finite(self) -> bool:
        return isfinite(sum(self.center) + sum(self.turned) + sum(self.speed))

    @property
    def energy(self) -> float:
        """Kinetic and potential energy, in J."""
        mass = self.lump.mass
        turning = dot(self.momentum, self._angular(self.turned)) / 2
        return mass * dot(self.speed, self.speed) / 2 + turning - mass * dot(self._gravity, self.center)


@dataclass
class Drive:
    """What the motor of a joint does: exert `torque`, or chase a velocity or a position with at most `limit`.

    All in N m, rad/s, rad (hinge) or N, m/s, m (slide).
    """

    torque: float = 0.0
    velocity: float | None = None
    position: float | None = None
    limit: float = 0.0

    def chased(self, position: float) -> float | None:
        """The velocity to reach, if the motor has one."""
        return self.velocity if self.position is None else (self.position - position) / SERVO_TIME


class CartPole:
    """A cart on a straight rail with a pole on a hinge; axes may point anywhere.

    With x along the unit vector a, the angle t about b, the pole's center at R(t) r from the hinge,
    u = b x R r and n = b x u, and g for gravity:

        (M + m) x" + m (a.u) t"  =  F + (M + m) g.a - m (a.n) t'^2 - c x'
        m (a.u) x" + J t"        =  T + m g.u - d t'
    """

    state: State
    """Positions of slide and hinge, then their velocities."""

    def __init__(
        self, rail: Lump, cart: Lump, pole: Lump, slide: Joint, hinge: Joint, gravity: Triple
    ) -> None:
        self._slide, self._hinge = slide, hinge
        self._gravity = gravity
        self._base = IDENTITY_FRAME
        self._slot = frames.compose(rail.members[slide.parent], frames.frame(slide.origin))
        self._bearing = frames.compose(
            self._slot, frames.compose(cart.members[hinge.parent], frames.frame(hinge.origin))
        )
        self._along = rotate(self._slot[1], slide.axis)
        self._about = rotate(self._bearing[1], hinge.axis)
        self.weigh(rail, cart, pole)
        self.rest()

    @property
    def lumps(self) -> tuple[str, ...]:
        """The first link of each."""
        return tuple(lump.name for lump in self._lumps)

    def weigh(self, rail: Lump, cart: Lump, pole: Lump) -> None:
        """Have these masses and inertias; where the links are stays as it was."""
        self._lumps = (rail, cart, pole)
        self._mass = cart.mass + pole.mass
        self._pole_mass = pole.mass
        self._inertia = pole.inertia_about(self._hinge.axis)
        if cart.mass <= 0.0 or self._inertia <= 0.0:
            raise EngineError(
                f"links '{cart.name}' and '{pole.name}' move without mass or inertia; give each an inertial"
            )
        self.place(self._base)

    def pull(self, gravity: Triple) -> None:
        """Feel this gravity (m/s^2, world frame) from now on."""
        self._gravity = gravity
        self.place(self._base)

    def damp(self, index: int, damping: float) -> None:
        """Give a joint this damping (N s/m or N m s/rad)."""
        if index == 0:
            self._slide = replace(self._slide, damping=damping)
        else:
            self._hinge = replace(self._hinge, damping=damping)

    def throw(self, linear: Triple, angular: Triple) -> None:
        """The base is fixed."""

    def place(self, frame: Frame) -> None:
        """Put the origin of the root link there; the joints stay as they are."""
        self._base = frame
        gravity = rotate(inverse(frame[1]), self._gravity)
        u = cross(self._about, rotate(self._bearing[1], self._lumps[2].center))
        n = cross(self._about, u)
        self._a_u, self._a_n = dot(self._along, u), dot(self._along, n)
        self._g_u, self._g_n = dot(gravity, u), dot(gravity, n)
        self._g_a = dot(gravity, self._along)

    @property
    def joints(self) -> dict[str, int]:
        return {self._slide.name: 0, self._hinge.name: 1}

    def set_joint(self, index: int, position: float, velocity: float) -> None:
        state = list(self.state)
        state[index], state[index + 2] = position, velocity
        self.state = (state[0], state[1], state[2], state[3])

    def rest(self) -> None:
        """Joints to 0 and at rest, motors off."""
        self.state = (0.0, 0.0, 0.0, 0.0)
        self.drives = [Drive(), Drive()]
        self.efforts = [0.0, 0.0]

    def advance(self, dt: float) -> None:
        pieces = ceil(dt / FINE)
        h = dt / pieces
        for _ in range(pieces):
            if not self.finite:
                return
            self._settle(h)
            k1 = self._rates(self.state)
            k2 = self._rates(_moved(self.state, k1, h / 2))
            k3 = self._rates(_moved(self.state, k2, h / 2))
            k4 = self._rates(_moved(self.state, k3, h))
            x, t, v, w = (
                h / 6 * (r1 + 2 * r2 + 2 * r3 + r4) for r1, r2, r3, r4 in zip(k1, k2, k3, k4, strict=True)
            )
            self.state = _moved(self.state, (x, t, v, w), 1.0)
        self._require_in_range()

    def _settle(self, h: float) -> None:
        """Choose what the motors exert for `h` seconds: those that chase a velocity reach it in that time if
        they can."""
        chased = [drive.chased(self.state[i]) for i, drive in enumerate(self.drives)]
        efforts = self.efforts = [drive.torque for drive in self.drives]
        for _ in range(SWEEPS if None not in chased else 1):
            for i, target in enumerate(chased):
                if target is not None:
                    _, _, *rates = self._rates(self.state)
                    missing = (target - self.state[2 + i]) / h - rates[i]
                    limit = self.drives[i].limit
                    efforts[i] = min(max(efforts[i] + missing / self._response(i), -limit), limit)

    def _response(self, index: int) -> float:
        """The acceleration of a joint per unit of its own effort."""
        coupling = self._coupling(self.state[1])
        diagonal = (self._inertia, self._mass)[index]
        return diagonal / (self._mass * self._inertia - coupling * coupling)

    def _coupling(self, angle: float) -> float:
        return self._pole_mass * (self._a_u * cos(angle) + self._a_n * sin(angle))

    def _rates(self, state: State) -> State:
        _, t, v, w = state
        m = self._pole_mass
        c = cos(t)
        s = sin(t)
        coupling = m * (self._a_u * c + self._a_n * s)
        force = (
            self.efforts[0]
            + self._mass * self._g_a
            - m * (self._a_n * c - self._a_u * s) * w * w
            - self._slide.damping * v
        )
        torque = self.efforts[1] + m * (self._g_u * c + self._g_n * s) - self._hinge.damping * w
        det = self._mass * self._inertia - coupling * coupling
        return (
            v,
            w,
            (self._inertia * force - coupling * torque) / det,
            (self._mass * torque - coupling * force) / det,
        )

    def _require_in_range(self) -> None:
        for joint, position in zip((self._slide, self._hinge), self.state, strict=False):
            lower, upper = joint.limit.lower, joint.limit.upper
            if joint.type != "continuous" and (
                (lower is not None and position < lower) or (upper is not None and position > upper)
            ):
                raise EngineError(
                    f"joint '{joint.name}' passed the end of its range at {position:.4g}, and the exact"
                    " engine has no stops"
                )

    @property
    def links(self) -> tuple[str, ...]:
        return tuple(name for lump in self._lumps for name in lump.members)

    def pose(self, link: str) -> Frame:
        x, angle, _, _ = self.state
        moved = scaled(self._along, x)
        hanging = multiply(frames.from_axis_angle(self._about, angle), self._bearing[1])
        origins = (
            IDENTITY_FRAME,
            (add(self._slot[0], moved), self._slot[1]),
            (add(self._bearing[0], moved), hanging),
        )
        index = self._part(link)
        return frames.compose(self._base, frames.compose(origins[index], self._lumps[index].members[link]))

    def velocity(self, link: str) -> tuple[Triple, Triple]:
        x, _, v, w = self.state
        index = self._part(link)
        turned = self._base[1]
        linear = scaled(rotate(turned, self._along), v if index else 0.0)
        angular = scaled(rotate(turned, self._about), w if index == 2 else 0.0)
        pivot = frames.compose(
            self._base, (add(self._bearing[0], scaled(self._along, x)), frames.IDENTITY_ROTATION)
        )[0]
        return add(linear, cross(angular, subtract(self.pose(link)[0], pivot))), angular

    def _part(self, link: str) -> int:
        return next(index for index, lump in enumerate(self._lumps) if link in lump.members)

    @property
    def finite(self) -> bool:
        return isfinite(sum(self.state))

    @property
    def energy(self) -> float:
        """Kinetic and potential energy, in J, but for a constant."""
        x, t, v, w = self.state
        kinetic = self._mass * v * v / 2 + self._coupling(t) * v * w + self._inertia * w * w / 2
        # u turns as cos, n as sin, of the angle; the center itself is -n turned.
        return (
            kinetic - self._mass * self._g_a * x + self._pole_mass * (self._g_n * cos(t) - self._g_u * sin(t))
        )


def _moved(state: State, rates: Sequence[float], h: float) -> State:
    a, b, c, d = state
    return a + h * rates[0], b + h * rates[1], c + h * rates[2], d + h * rates[3]
