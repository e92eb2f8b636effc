"""The damping of joints, by their velocities at the end of each physics step.

PyBullet exerts `-d * velocity` with the velocity at the start of a physics step of h s. A joint with the
inertia I then keeps `1 - x` of its velocity, x = d h / I: it swings from x = 1 on, and ever wider from x = 2
on. The velocities at the end of the step are those of the linearly implicit step,

    v' = (M + h D)^-1 (M v + h f),

with the mass matrix M of the joints, their damping D, and the torques f of motors, springs, gravity and
inertia. The torques -D v' are stable for any D. M, and the torques of gravity and inertia, are those at the
start of a control step. Contacts and limits are not in f: what they push turns up to 1 + x times as fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.engines.pybullet.motors import exert_torques, torques

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from deepbots_cli.engines.pybullet.motors import Springs
    from deepbots_cli.engines.pybullet.state import Body

    FloatArray = NDArray[Any]

NEGLIGIBLE_SHARE = 0.005
"""The x up to which PyBullet damps a joint itself; the way in which it comes to rest is off by this share."""
SMALL_INERTIA = 1e-16  # kg m^2 or kg; keeps a mass matrix invertible, and is below that of any link


class Damping:
    """Damps the joints of one robot.

    `update` begins a control step, and `apply` a physics step. The first control step of an episode decides
    whether PyBullet damps the joints itself.
    """

    def __init__(
        self, client: int, body: Body, step: float, springs: Mapping[tuple[int, tuple[int, ...]], Springs]
    ) -> None:
        self._client = client
        self._body = body
        self._step = step
        self._indices = tuple(sorted(body.brakes))
        damping = {body.joints[joint.name]: joint.damping for joint in body.model.moving_joints}
        self._nominal = np.array([damping[index] for index in self._indices])
        self._damping = self._nominal.copy()
        self._states: Any = ()
        self._read_torques = torques(lambda: self._states, body.number, self._indices, springs)
        self._exert = exert_torques(client, body.number, self._indices)
        self._is_decided = False
        self._is_implicit = False
        count = len(self._indices)
        self._gains: FloatArray = np.zeros((count, 2 * count))
        """The matrices D (M + h D)^-1 M and D (M + h D)^-1 h, side by side."""
        self._constant: FloatArray = np.zeros(count)
        """The torques D (M + h D)^-1 h f of gravity and inertia."""
        self._mass_matrix([0.0] * count)  # PyBullet keeps the masses of the first call

    def reset(self) -> None:
        """Restore the damping of the file."""
        self._damping[:] = self._nominal
        self._is_decided = False

    def set(self, index: int, damping: float) -> None:
        """Set the damping (N m s/rad or N s/m) of a joint."""
        self._damping[self._indices.index(index)] = damping
        self._is_decided = False

    def update(self) -> None:
        if self._is_decided and not self._is_implicit:
            return
        states = p.getJointStates(self._body.number, self._indices, self._client)
        positions = [state[0] for state in states]
        masses = self._mass_matrix(positions)
        if not self._is_decided:
            # The articulated inertia of a joint, with all others free, is 1 / (M^-1)_ii.
            scales = self._step * np.diag(np.linalg.inv(masses))
            self._decide(bool(np.any(scales * self._damping > NEGLIGIBLE_SHARE)))
        count = len(positions)
        damped = masses.copy()
        damped.ravel()[:: count + 1] += self._step * self._damping
        solution = self._damping[:, None] * np.linalg.inv(damped)
        np.matmul(solution, masses, out=self._gains[:, :count])
        np.multiply(solution, self._step, out=self._gains[:, count:])
        if self._body.fixed:
            loads = self._loads(positions, [state[1] for state in states])
            self._constant = self._gains[:, count:] @ loads

    def _decide(self, is_implicit: bool) -> None:
        self._is_decided = True
        self._is_implicit = is_implicit
        for index, damping in zip(self._indices, self._damping.tolist(), strict=True):
            p.changeDynamics(
                self._body.number,
                index,
                jointDamping=0.0 if is_implicit else damping,
                physicsClientId=self._client,
            )

    def _mass_matrix(self, positions: list[float]) -> FloatArray:
        """Return the mass matrix of the joints, while a free base follows them."""
        number, client = self._body.number, self._client
        masses = np.array(p.calculateMassMatrix(number, positions, physicsClientId=client))
        if not self._body.fixed:
            coupling = masses[6:, :6]
            masses = masses[6:, 6:] - coupling @ np.linalg.solve(masses[:6, :6], coupling.T)
        masses *= self._body.least_inertia_factor
        masses.ravel()[:: len(masses) + 1] += SMALL_INERTIA
        return masses

    def _loads(self, positions: list[float], velocities: list[float]) -> FloatArray:
        """Return the torques of gravity and inertia on the joints of a fixed robot. PyBullet computes them in
        the frame of the base."""
        number, client = self._body.number, self._client
        settings = p.getPhysicsEngineParameters(client)
        x, y, z = (settings[f"gravityAcceleration{axis}"] for axis in "XYZ")
        rotation = p.getBasePositionAndOrientation(number, client)[1]
        p.setGravity(*frames.rotate_back(rotation, (x, y, z)), client)
        loads = p.calculateInverseDynamics(
            number, positions, velocities, [0.0] * len(positions), physicsClientId=client
        )
        p.setGravity(x, y, z, client)
        return -self._body.least_inertia_factor * np.array(loads)

    def apply(self) -> None:
        if self._is_implicit:
            self._states = p.getJointStates(self._body.number, self._indices, self._client)
            inputs = [*(state[1] for state in self._states), *self._read_torques()]
            self._exert((-(self._gains @ inputs) - self._constant).tolist())
