"""The state of a world in MuJoCo: its steps, its bounces, its motors and rays through it.

A motor is a constraint with a limited force that reaches its velocity at the end of the basic time step. It
is the dry friction of the joint with a velocity of its own, so that MuJoCo solves it together with the
contacts.

One basic time step is made of substeps of at most 8 ms. Two things of Webots act between the two halves of a
substep, where MuJoCo has computed the constraints and not yet solved them:

- a motor (`Motors`) is a constraint, solved together with the contacts;
- a contact that closes faster than `bounceVelocity` leaves with `bounce` times its speed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil, isinf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import frames
from deepbots_cli.diagnostics import Span
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco import sliding
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.records import dataclass
from deepbots_webots.model import ModelBuilder
from deepbots_webots.nodes import number, numbers
from deepbots_webots.scene import ORIGIN, UP, Body, Geometry, Joint, Robot, Scene
from deepbots_webots.shapes import compose
from deepbots_webots.syntax import Node, WorldError

Floats = NDArray[np.float64]


_SKIPPED_GROUP = 5
_GROUPS = np.array([1, 1, 1, 1, 1, 0], np.uint8)
"""Whether a geometry of each group stops rays."""


MAX_TORQUE = 1e8


@dataclass(eq=False)
class MotorState:
    """The state of a motor: its commands, and its motion in the present basic time step.

    Positions in rad or m, velocities per s, torques in N m or N.
    """

    joint: Joint
    dof: int  # -1 for the motor of a propeller
    position_address: int
    max_velocity: float
    max_torque: float
    gains: tuple[float, float, float]
    acceleration: float
    target_position: float = 0.0
    target_velocity: float = 0.0
    available_torque: float = 0.0
    torque: float | None = None
    velocity: float = 0.0
    integral: float = 0.0
    last_error: float = 0.0
    turned: float = 0.0
    """The position of a propeller."""

    def reset(self, position: float) -> None:
        """Set the state in which Webots starts a motor: it keeps its position."""
        self.target_position, self.target_velocity = position, self.max_velocity
        self.available_torque, self.torque = self.max_torque, None
        self.velocity = self.integral = self.last_error = 0.0

    def next_velocity(self, position: float, step: float) -> float:
        """Return the target velocity in a basic time step of `step` s, from the present position."""
        velocity = self.target_velocity
        if not isinf(self.target_position):
            p, i, d = self.gains
            error = self.target_position - position
            self.integral += error * step
            velocity = p * error + i * self.integral + d * (error - self.last_error) / step
            self.last_error = error
            limit = abs(self.target_velocity)  # it keeps the sign of a velocity control before
            velocity = min(max(velocity, -limit), limit)
        if self.acceleration >= 0:
            max_change = self.acceleration * step
            velocity = min(max(velocity, self.velocity - max_change), self.velocity + max_change)
        self.velocity = velocity
        return velocity


class Motors:
    """The motors of a world, by node. Those without a torque control and with a torque are active."""

    def __init__(
        self, model: Any, data: Any, joint_ids: Mapping[Joint, int | None], states: Mapping[Node, MotorState]
    ) -> None:
        """Find the motors of a model, among them those of propellers, whose joints have no number; those that
        have a state keep it."""
        self._model, self._data = model, data
        self._states: dict[Node, MotorState] = {}
        for joint, index in joint_ids.items():
            node = joint.motor
            if node is None:
                continue
            motor = self._states[node] = states.get(node) or MotorState(joint, -1, -1, *_limits(node))
            if index is not None:
                motor.dof, motor.position_address = (
                    int(model.jnt_dofadr[index]),
                    int(model.jnt_qposadr[index]),
                )
            if node not in states:
                motor.reset(joint.position)
        in_joints = (motor for motor in self._states.values() if motor.dof >= 0)
        self._in_joints = sorted(in_joints, key=lambda motor: motor.dof)
        self._active: list[MotorState] = []

    def __getitem__(self, node: Node) -> MotorState:
        return self._states[node]

    def states(self) -> dict[Node, MotorState]:
        """Return copies of the states, by node."""
        return {node: replace(motor) for node, motor in self._states.items()}

    def restore(self, states: Mapping[Node, MotorState]) -> None:
        for node, motor in states.items():
            vars(self._states[node]).update(vars(motor))
        self.renew()

    def read(self, node: Node) -> None:
        """Read the fields of a motor again. All of its new torque or force is available."""
        motor = self._states[node]
        motor.max_velocity, motor.max_torque, motor.gains, motor.acceleration = _limits(node)
        motor.available_torque = motor.max_torque
        motor.target_velocity = min(max(motor.target_velocity, -motor.max_velocity), motor.max_velocity)
        self.renew()

    def reset(self) -> None:
        """Let all motors keep the present positions of their joints."""
        for motor in self._states.values():
            motor.reset(motor.turned if motor.dof < 0 else float(self._data.qpos[motor.position_address]))
        self.renew()

    def stop(self) -> None:
        """Set velocities to 0, and the torques of motors under torque control."""
        for motor in self._in_joints:
            motor.velocity = 0.0
            if motor.torque is not None:
                self._data.qfrc_applied[motor.dof] = 0.0
                motor.torque = 0.0

    def renew(self) -> None:
        """Apply limits and modes after a change."""
        self._active = []
        for motor in self._in_joints:
            is_active = motor.torque is None and motor.available_torque > 0
            limit = motor.available_torque if is_active else motor.joint.friction
            self._model.dof_frictionloss[motor.dof] = limit
            self._data.qfrc_applied[motor.dof] = motor.torque or 0.0
            if is_active:
                self._active.append(motor)
        # MuJoCo has a row of friction for each of these, in this order, after the rows of equalities (`ne`).
        rows = np.flatnonzero(self._model.dof_frictionloss > 0).tolist()
        self._rows = np.array([rows.index(motor.dof) for motor in self._active], np.intp)
        self._dofs = np.array([motor.dof for motor in self._active], np.intp)

    def target_velocities(self, step: float) -> Floats:
        """Return the velocity of each active motor at the end of a basic time step of `step` s."""
        positions = self._data.qpos
        return np.array(
            [motor.next_velocity(float(positions[motor.position_address]), step) for motor in self._active]
        )

    def turn(self, node: Node, step: float) -> float:
        """Turn a propeller for a basic time step of `step` s; return its velocity, rad/s. No load slows it."""
        motor = self._states[node]
        velocity = motor.next_velocity(motor.turned, step)
        motor.turned += velocity * step
        return velocity

    def drive(self, targets: Floats, time: float) -> None:
        """Let the active motors reach their target velocities in `time` s. The rows of constraints exist
        after the first half of a substep.

        Raises:
            FloatingPointError: MuJoCo has left out the constraints, of which there are too many.
        """
        if self._active:
            # A row of friction exerts at most `dof_frictionloss`; this reference makes it drive, not brake.
            velocity_change = targets - self._data.qvel[self._dofs]
            rows = self._rows + self._data.ne
            if rows[-1] >= self._data.nefc:
                raise FloatingPointError("the simulation has more contacts than MuJoCo has room for")
            self._data.efc_aref[rows] = velocity_change / time

    def torque(self, motor: MotorState) -> float:
        """Return the torque or force of a motor in the last substep."""
        if motor.torque is not None:
            return motor.torque
        if motor not in self._active:
            return 0.0
        row = int(self._rows[self._active.index(motor)]) + self._data.ne
        return float(self._data.efc_force[row]) if row < self._data.nefc else 0.0


def _limits(node: Node) -> tuple[float, float, tuple[float, float, float], float]:
    """Return the largest velocity and torque or force of a motor, its gains and its acceleration."""
    strength = "maxTorque" if node.type == "RotationalMotor" else "maxForce"
    p, i, d = (*numbers(node, "controlPID"), 0.0, 0.0, 0.0)[:3]
    max_torque = min(max(0.0, number(node, strength)), MAX_TORQUE)
    return max(0.0, number(node, "maxVelocity")), max_torque, (p, i, d), number(node, "acceleration")


MAX_SUBSTEP_MS = 8.0


@dataclass(frozen=True)
class State:
    """A state of a world: that of the engine, of joints and bodies, and of motors."""

    engine: Floats
    parts: dict[Joint | Body, list[Floats]]
    motors: dict[Node, MotorState]


class Physics:
    """The state of a world. Frames are (m; quaternions x, y, z, w) in the world."""

    def __init__(self, scene: Scene, span: Span) -> None:
        """Build the model.

        Raises:
            WorldError: MuJoCo refuses the world.
        """
        self.scene, self._span = scene, span
        self.substeps = ceil(scene.basic_step / MAX_SUBSTEP_MS)
        self.substep = scene.basic_step / 1000 / self.substeps
        self._build({})
        self.reset()

    def _build(self, motors: Mapping[Node, MotorState]) -> None:
        """Build the model and its state at the start; these motors keep theirs."""
        scene = self.scene
        builder = ModelBuilder(scene, self.substep)
        try:
            self.model = model = builder.spec.compile()
        except ValueError as error:
            message = " ".join(str(error).split())[:200]
            raise WorldError.at(self._span, f"MuJoCo refuses the world: {message}") from error
        self.data = mj.MjData(model)
        self.bodies = [int(element.id) for element in builder.bodies]
        self.geoms = builder.geometries_by_id()
        self._joint_ids = {joint: int(element.id) for joint, element in builder.joints.items()}
        self._free_ids = {body: int(element.id) for body, element in builder.free_joints.items()}
        self._free = {body: int(model.jnt_qposadr[index]) for body, index in self._free_ids.items()}
        self._free_dofs = {body: int(model.jnt_dofadr[index]) for body, index in self._free_ids.items()}
        self._static_frames = model.body_pos.copy(), model.body_quat.copy()
        self._usual_friction = model.dof_frictionloss.copy()
        self._bounces = _BounceTable(scene, [geometry for _, geometry in self.geoms])
        self._damped = [body for body in scene.bodies if any(body.damping)]
        shafts = dict.fromkeys(propeller.joint for propeller in scene.propellers)
        self.motors = Motors(model, self.data, {**self._joint_ids, **shafts}, motors)
        self._robot_geoms: dict[Robot | None, list[int]] = {}
        for index, (body, _) in enumerate(self.geoms):
            if body.robot is not None:
                self._robot_geoms.setdefault(body.robot, []).append(index)
        self._has_positions = self._has_velocities = False
        self._start = self._state_at_begin()

    def rebuild(self, change: Callable[[], None]) -> None:
        """Change the scene, and build the model anew. Bodies, joints and motors that stay keep their
        state."""
        parts = self._parts()
        change()
        self._build(self.motors._states)
        self.data.qpos[:], self.data.qvel[:] = self._start
        self._restore_parts(parts)
        self.motors.renew()
        mj.mj_forward(self.model, self.data)

    def _parts(self) -> dict[Joint | Body, list[Floats]]:
        return {owner: [array[at].copy() for array, at in places] for owner, places in self._places()}

    def _restore_parts(self, parts: Mapping[Joint | Body, list[Floats]]) -> None:
        for owner, places in self._places():
            for (array, at), values in zip(places, parts.get(owner, ()), strict=False):
                array[at] = values

    def _places(self) -> Iterator[tuple[Joint | Body, list[tuple[Floats, Any]]]]:
        """Yield joints and bodies with the arrays and indices of what they keep in a new model."""
        model, data = self.model, self.data
        positions, velocities = [*model.jnt_qposadr, model.nq], [*model.jnt_dofadr, model.nv]
        joints: list[tuple[Joint | Body, int]] = [*self._joint_ids.items(), *self._free_ids.items()]
        for owner, index in joints:
            dofs = slice(velocities[index], velocities[index + 1])
            at = slice(positions[index], positions[index + 1])
            yield owner, [(data.qpos, at), (data.qvel, dofs)]
        for body, number_ in zip(self.scene.bodies, self.bodies, strict=True):
            if body not in self._free:
                yield body, [(model.body_pos, number_), (model.body_quat, number_)]

    def _state_at_begin(self) -> tuple[Floats, Floats]:
        position, velocity = self.data.qpos.copy(), np.zeros(self.model.nv)
        for body, at in self._free_dofs.items():
            linear, angular = body.velocity
            velocity[at : at + 3] = linear
            # MuJoCo has the angular velocity of a free joint in the frame of the body.
            velocity[at + 3 : at + 6] = frames.rotate_back(body.frame[1], angular)
        return position, velocity

    # Steps

    def reset(self) -> None:
        """Bring the world back to its start."""
        model, data = self.model, self.data
        model.body_pos[:], model.body_quat[:] = self._static_frames
        model.dof_frictionloss[:] = self._usual_friction
        mj.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = self._start
        self.motors.reset()
        mj.mj_forward(model, data)
        self._has_positions = self._has_velocities = True

    def stop(self) -> None:
        """Set all velocities to 0, and the torques of motors under torque control."""
        self.data.qvel[:] = 0.0
        self.data.qacc_warmstart[:] = 0.0  # the solver would start from the motion before the stop
        self.motors.stop()
        self._has_velocities = False

    def step(self) -> None:
        """Advance by one basic time step.

        Raises:
            FloatingPointError: The state is not finite any more, or there are too many contacts.
        """
        model, data, count = self.model, self.data, self.substeps
        # Between both halves, motors and bounces set rows of constraints, before the solver runs.
        step1, step2 = mj.mj_step1, mj.mj_step2
        bounces = self._bounces.is_needed
        self._turn_propellers(self.substep * count)
        targets = self.motors.target_velocities(self.substep * count)
        for left in range(count, 0, -1):
            step1(model, data)
            self.motors.drive(targets, self.substep * left)
            if bounces and data.ncon:
                self._bounces.apply(data, self.substep)
            sliding.correct_contacts(model, data)
            if self._damped:
                self._damp()
            step2(model, data)
        # MuJoCo keeps applied forces, while those of supervisors and propellers act for one basic time step.
        data.xfrc_applied[:] = 0.0
        self._has_positions = self._has_velocities = False
        if not np.abs(data.qvel).max(initial=0.0) < 0.5 / self.substep:
            self._limit_spins()

    def _limit_spins(self) -> None:
        """Limit the angular velocity of free bodies to 1 rad in a substep. MuJoCo computes gyroscopic moments
        of a faster one with a growing error, such as of a stick that begins within a wall and is thrown out.

        Raises:
            FloatingPointError: The state is not finite any more.
        """
        if not np.isfinite(self.data.qvel).all():
            raise FloatingPointError("the simulation is not finite any more")
        for at in self._free_dofs.values():
            spin = self.data.qvel[at + 3 : at + 6]
            spin /= max(1.0, float(np.linalg.norm(spin)) * self.substep)

    def _turn_propellers(self, seconds: float) -> None:
        """Let propellers push their bodies for a basic time step. Along the shaft, thrust (N) and torque (N m)
        are a |w| w - b |w| v, where w is the velocity of the shaft (rad/s) and v that of its center (m/s)."""
        for body, joint in self.scene.propellers:
            if joint.node is None or joint.motor is None:
                continue
            speed, center = self.motors.turn(joint.motor, seconds), (joint.anchor, frames.IDENTITY_ROTATION)
            point, rotation = self.frame(body, center)
            shaft = frames.rotate(rotation, joint.axis)
            along = frames.dot(self.velocity(body, center)[0], shaft)
            thrust, torque = (
                abs(speed) * (first * speed - second * along)
                for first, second in (
                    numbers(joint.node, f"{kind}Constants") for kind in ("thrust", "torque")
                )
            )
            limit = self.motors[joint.motor].max_torque
            load = frames.scaled(shaft, -min(max(torque, -limit), limit))
            self.push(body, frames.scaled(shaft, thrust), load, point)

    def _damp(self) -> None:
        """Slow bodies with a Damping node by its share per s."""
        for body in self._damped:
            at, (linear, angular) = self._free_dofs.get(body), body.damping
            if at is not None:
                self.data.qvel[at : at + 3] *= (1.0 - linear) ** self.substep
                self.data.qvel[at + 3 : at + 6] *= (1.0 - angular) ** self.substep

    def update_positions(self) -> None:
        if not self._has_positions:
            mj.mj_kinematics(self.model, self.data)
            self._has_positions = True

    # Readings

    def frame(self, body: Body, frame_in_body: Frame = ORIGIN) -> Frame:
        """Return a frame of a body."""
        self.update_positions()
        index = self.bodies[body.index]
        x, y, z = self.data.xpos[index].tolist()
        w, qx, qy, qz = self.data.xquat[index].tolist()
        frame = ((x, y, z), (qx, qy, qz, w))
        return frame if frame_in_body is ORIGIN else compose(frame, frame_in_body)

    def poses(self) -> Floats:
        """Return the pose of each body, x, y, z (m) and the quaternion w, x, y, z, shape (bodies, 7)."""
        self.update_positions()
        return np.concatenate([self.data.xpos[self.bodies], self.data.xquat[self.bodies]], axis=1)

    def position(self, body: Body, frame_in_body: Frame = ORIGIN) -> Triple:
        """Return the origin of a frame of a body, m."""
        return self.frame(body, frame_in_body)[0]

    def velocity(self, body: Body, frame_in_body: Frame = ORIGIN) -> tuple[Triple, Triple]:
        """Return the velocity of the origin of a frame, m/s, and the angular velocity, rad/s."""
        self.update_positions()
        if not self._has_velocities:
            mj.mj_comPos(self.model, self.data)
            mj.mj_comVel(self.model, self.data)
            self._has_velocities = True
        index = self.bodies[body.index]
        # `cvel` has the linear velocity at the center of mass of the whole kinematic tree.
        root = int(self.model.body_rootid[index])
        wx, wy, wz, vx, vy, vz = self.data.cvel[index].tolist()
        x, y, z = self.data.subtree_com[root].tolist()
        arm = frames.subtract(self.position(body, frame_in_body), (x, y, z))
        return frames.add((vx, vy, vz), frames.cross((wx, wy, wz), arm)), (wx, wy, wz)

    def center_of_mass(self, body: Body) -> Triple:
        """Return the center of mass of a body; its origin if it has no mass."""
        self.update_positions()
        index = self.bodies[body.index]
        if not self.model.body_mass[index] > 0:
            return self.frame(body)[0]
        x, y, z = self.data.xipos[index].tolist()
        return x, y, z

    def joint_position(self, joint: Joint) -> float:
        return float(self.data.qpos[self.model.jnt_qposadr[self._joint_ids[joint]]])

    def cast(
        self, start: Triple, directions: Sequence[Triple] | Floats, reach: float, robot: Robot | None = None
    ) -> list[tuple[float, int, float]]:
        """Return for each ray the distance (m; `reach` if nothing is hit), the geometry (or -1), and the
        cosine of its incidence. The robot stops no ray."""
        rays, count = np.ascontiguousarray(directions, np.float64), len(directions)
        geoms, lengths, normals = np.full(count, -1, np.int32), np.zeros(count), np.zeros(3 * count)
        origin, seen, hits = np.array(start), (_GROUPS, True, -1), (geoms, lengths, normals)
        self.update_positions()
        # MuJoCo can leave out a single body, and a robot has several.
        groups, own = self.model.geom_group, self._robot_geoms.get(robot, [])
        saved = groups[own].copy()
        groups[own] = _SKIPPED_GROUP
        try:
            mj.mj_multiRay(self.model, self.data, origin, rays.ravel(), *seen, *hits, count, reach)
        finally:
            groups[own] = saved
        cosines = np.abs((normals.reshape(-1, 3) * rays).sum(axis=1))
        rows = zip(lengths.tolist(), geoms.tolist(), cosines.tolist(), strict=True)
        return [row if 0 <= row[0] <= reach else (reach, -1, 1.0) for row in rows]

    def contacts(self) -> list[tuple[int, int, Triple, Triple]]:
        """Return the contacts of the last substep: two geometries, the point, and the force on the second
        one, N."""
        contacts: list[tuple[int, int, Triple, Triple]] = []
        force = np.zeros(6)
        for index in range(self.data.ncon):
            contact = self.data.contact[index]
            # MuJoCo lists contacts that it leaves out of the constraints too, and these exert no force.
            if contact.efc_address < 0:
                continue
            mj.mj_contactForce(self.model, self.data, index, force)
            axes = contact.frame.reshape(3, 3)
            x, y, z = (axes.T @ force[:3]).tolist()
            px, py, pz = contact.pos.tolist()
            contacts.append((int(contact.geom1), int(contact.geom2), (px, py, pz), (x, y, z)))
        return contacts

    # Changes

    def place(self, body: Body, frame: Frame) -> None:
        """Move a body that stands alone, in the world; its velocity stays."""
        (x, y, z), (qx, qy, qz, w) = frame
        if body in self._free:
            at = self._free[body]
            self.data.qpos[at : at + 7] = (x, y, z, w, qx, qy, qz)
        else:
            index = self.bodies[body.index]
            self.model.body_pos[index] = (x, y, z)
            self.model.body_quat[index] = (w, qx, qy, qz)
        self._has_positions = self._has_velocities = False

    def set_velocity(self, body: Body, linear: Triple, angular: Triple) -> None:
        """Set the velocity of a free body: m/s and rad/s in the world."""
        at = self._free_dofs[body]
        self.data.qvel[at : at + 3] = linear
        self.data.qvel[at + 3 : at + 6] = frames.rotate_back(self.frame(body)[1], angular)
        self.data.qacc_warmstart[at : at + 6] = 0.0  # of the motion before
        self._has_velocities = False

    def stop_body(self, body: Body) -> None:
        """Set the velocities of a body, and of the bodies that hang on it, to 0."""
        roots = self.model.body_rootid
        self.data.qvel[roots[self.model.dof_bodyid] == roots[self.bodies[body.index]]] = 0.0
        self._has_velocities = False

    def set_joint_position(self, joint: Joint, position: float) -> None:
        index = self._joint_ids[joint]
        self.data.qpos[self.model.jnt_qposadr[index]] = position
        self._has_positions = self._has_velocities = False

    def set_gravity(self, gravity: float) -> None:
        """Set the gravity, m/s^2 downward."""
        self.scene.gravity = frames.scaled(self.scene.directions[UP], -gravity)
        self.model.opt.gravity[:] = self.scene.gravity

    def push(self, body: Body, force: Triple, torque: Triple, point: Triple | None = None) -> None:
        """Push a body for the next basic time step: N and N m in the world, at a point or at its center."""
        if point is not None:
            arm = frames.subtract(point, self.center_of_mass(body))
            torque = frames.add(torque, frames.cross(arm, force))
        self.data.xfrc_applied[self.bodies[body.index]] += (*force, *torque)

    def snapshot(self) -> State:
        # This state has the warm start of the solver too, without which a restored world goes on differently.
        spec = mj.mjtState.mjSTATE_INTEGRATION
        engine = np.zeros(mj.mj_stateSize(self.model, spec))
        mj.mj_getState(self.model, self.data, engine, spec)
        return State(engine, self._parts(), self.motors.states())

    def restore(self, state: State) -> None:
        self._restore_parts(state.parts)
        self.motors.restore(state.motors)
        mj.mj_setState(self.model, self.data, state.engine, mj.mjtState.mjSTATE_INTEGRATION)
        self._has_positions = self._has_velocities = False


class _BounceTable:
    """Bounces per pair of materials."""

    def __init__(self, scene: Scene, geometries: Sequence[Geometry]) -> None:
        names = sorted({geometry.material for geometry in geometries}) or [""]
        self._material = np.array([names.index(geometry.material) for geometry in geometries], np.intp)
        pairs = [[scene.contact(name, other) for other in names] for name in names]
        self._bounce = np.array([[pair.bounce for pair in row] for row in pairs])
        self._speed = np.array([[pair.bounce_velocity for pair in row] for row in pairs])
        self.is_needed = bool(self._bounce.max() > 0)
        self._slowest = max(float(self._speed.min()), 1e-6)
        # Contacts with rolling friction have more rows than others: then each row counts.
        self._rows_per_contact = 1 if any(any(contact.rolling) for contact in scene.contacts.values()) else 3

    def apply(self, data: Any, step: float) -> None:
        """Let contacts that close fast leave with a share of their speed: their reference acceleration
        reverses them in one substep."""
        # MuJoCo orders rows as equalities, frictions, limits, contacts.
        first = data.ne + data.nf + data.nl
        speeds = data.efc_vel[first :: self._rows_per_contact]
        if not speeds.size or speeds.min() >= -self._slowest:
            return  # 3 of 4 substeps of a cart; the rest of this function takes 20 us
        contacts = data.contact
        rows = contacts.efc_address
        is_active = rows >= 0
        rows, geoms = rows[is_active], contacts.geom[is_active]
        speeds = data.efc_vel[rows]
        ones, others = self._material[geoms[:, 0]], self._material[geoms[:, 1]]
        fast = speeds < -np.maximum(self._speed[ones, others], 1e-6)
        if fast.any():
            fast_rows = rows[fast]
            impedance = data.efc_KBIP[fast_rows, 2]  # stiffness, damping, impedance and its derivative
            shares = 1.0 + self._bounce[ones, others][fast]
            data.efc_aref[fast_rows] = -shares * speeds[fast] / (step * impedance)
