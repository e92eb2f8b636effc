"""Copies of a robot in one world, under one policy: a supervisor for each, and one that keeps them together.

Each copy sees the engine through a `Share`, in which the name of the robot means that copy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium.vector.utils import batch_space

from deepbots_cli.frames import Frame, Quaternion, Triple
from deepbots_cli.port import (
    STILL,
    CameraReader,
    ContactReader,
    Engine,
    ForceReader,
    GapReader,
    JointReader,
    Kinematics,
    MotionReader,
    MotorWriter,
    Overlap,
    Part,
    PoseReader,
    Pusher,
    RayReader,
    TorqueReader,
    VelocityReader,
    View,
)
from deepbots_cli.program import Program
from deepbots_cli.program.task import RobotCopies
from deepbots_cli.program.world import WorldModel
from deepbots_cli.runtime.placement import offset
from deepbots_cli.runtime.streams import Streams
from deepbots_cli.runtime.supervisor import Info, Supervisor

if TYPE_CHECKING:
    from deepbots_cli.port import Image

_FINISHED = object()


def copy_name(copies: RobotCopies, number: int) -> str:
    """The name of a copy in the world, numbered from 1."""
    return f"{copies.robot}#{number}"


def _leave_it(_force: Triple, _torque: Triple) -> None:
    """How a copy pushes what is no part of it: the first one does that for all."""


class Share:
    """An engine in which the robot's name means one of its copies.

    What is not of a copy is set by the first one alone, and time is not for a copy to advance: `step` only notes
    how far the world shall go on after the reset.
    """

    def __init__(self, engine: Engine, copies: RobotCopies, number: int) -> None:
        self._engine = engine
        self._robot = copies.robot
        self._copy = copy_name(copies, number)
        self._offset = offset(copies, number)
        self._leads = number == 1
        self.name = engine.name
        self.capabilities = engine.capabilities
        self.settling = 0

    def _of(self, body: str) -> str:
        return self._copy if body == self._robot else body

    def _at(self, part: Part) -> Part:
        return self._of(part[0]), part[1]

    def _sets(self, body: str | None) -> bool:
        """Whether this copy sets figures of the body."""
        return self._leads or body == self._robot

    # Episodes

    def reset(self) -> None:
        self.settling = 0

    def step(self, substeps: int) -> None:
        self.settling = substeps

    def close(self) -> None:
        """The world is not its own to close."""

    def place(
        self, body: str, position: Triple, orientation: Quaternion, velocity: Triple = STILL, angular_velocity: Triple = STILL
    ) -> None:
        if body == self._robot:
            (x, y, z), (dx, dy, dz) = position, self._offset
            position = (x + dx, y + dy, z + dz)
        if self._sets(body):
            self._engine.place(self._of(body), position, orientation, velocity, angular_velocity)

    def set_joint(self, robot: str, joint: str, position: float, velocity: float) -> None:
        if self._sets(robot):
            self._engine.set_joint(self._of(robot), joint, position, velocity)

    def choose(self, body: str, variant: str) -> None:
        if self._sets(body):
            self._engine.choose(self._of(body), variant)

    def set_mass(self, body: str, link: str | None, mass: float) -> None:
        if self._sets(body):
            self._engine.set_mass(self._of(body), link, mass)

    def set_friction(
        self,
        body: str,
        link: str | None,
        *,
        lateral: float | None = None,
        spinning: float | None = None,
        rolling: float | None = None,
        restitution: float | None = None,
    ) -> None:
        if self._sets(body):
            self._engine.set_friction(self._of(body), link, lateral=lateral, spinning=spinning, rolling=rolling, restitution=restitution)

    def set_joint_damping(self, robot: str, joint: str, damping: float) -> None:
        if self._sets(robot):
            self._engine.set_joint_damping(self._of(robot), joint, damping)

    def set_joint_friction(self, robot: str, joint: str, friction: float) -> None:
        if self._sets(robot):
            self._engine.set_joint_friction(self._of(robot), joint, friction)

    def set_gravity(self, gravity: Triple) -> None:
        if self._leads:
            self._engine.set_gravity(gravity)

    def set_colour(self, body: str, link: str | None, colour: tuple[float, float, float, float]) -> None:
        if self._sets(body):
            self._engine.set_colour(self._of(body), link, colour)

    def set_light(self, brightness: float) -> None:
        if self._leads:
            self._engine.set_light(brightness)

    # What is bound once

    @property
    def gravity(self) -> Triple:
        return self._engine.gravity

    def before_substep(self, act: Callable[[], object]) -> None:
        self._engine.before_substep(act)

    def pusher(self, part: Part, frame: Literal["world", "link"] = "world") -> Pusher:
        return self._engine.pusher(self._at(part), frame) if self._sets(part[0]) else _leave_it

    def contact(self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True) -> ContactReader:
        return self._engine.contact(self._at(one), None if others is None else [self._at(other) for other in others], ground=ground)

    def contact_force(self, one: Part) -> ForceReader:
        return self._engine.contact_force(self._at(one))

    def gap(self, one: Part, other: Part) -> GapReader:
        return self._engine.gap(self._at(one), self._at(other))

    def rays(self, part: Part, rays: Sequence[Frame], reach: float) -> RayReader:
        return self._engine.rays(self._at(part), rays, reach)

    def camera(self, part: Part, mount: Frame, width: int, height: int, fov: float) -> CameraReader:
        return self._engine.camera(self._at(part), mount, width, height, fov)

    def inverse_kinematics(self, part: Part, joints: Sequence[str]) -> Kinematics:
        return self._engine.inverse_kinematics(self._at(part), joints)

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader:
        return self._engine.joint_states(self._of(robot), joints)

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader:
        return self._engine.joint_torques(self._of(robot), joints)

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        return self._engine.pose(self._of(body), link)

    def velocity(self, body: str, link: str | None = None) -> VelocityReader:
        return self._engine.velocity(self._of(body), link)

    def motion(self, body: str, link: str | None = None) -> MotionReader:
        return self._engine.motion(self._of(body), link)

    def velocity_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return self._engine.velocity_motor(self._of(robot), joints, max_torque)

    def position_motor(
        self,
        robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> MotorWriter:
        return self._engine.position_motor(self._of(robot), joints, max_torque, stiffness, damping)

    def torque_motor(self, robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        return self._engine.torque_motor(self._of(robot), joints, max_torque)

    def overlaps(self) -> Sequence[Overlap]:
        return self._engine.overlaps()

    def require_finite(self) -> None:
        self._engine.require_finite()

    def render(self, view: View) -> Image:
        return self._engine.render(view)


def populated(world: WorldModel, copies: RobotCopies) -> WorldModel:
    """The world with the copies in place of the robot."""
    one = next(robot for robot in world.robots if robot.name == copies.robot)
    others = tuple(robot for robot in world.robots if robot is not one)
    return replace(world, robots=(*others, *(replace(one, name=copy_name(copies, k + 1)) for k in range(copies.count))))


def assemble(
    kind: type[Supervisor], scenario: Program, create: Callable[[WorldModel], Engine], render_mode: str | None = None
) -> Supervisor:
    """The environment of a scenario whose generated supervisor is `kind`: one of these, or a team of them."""
    copies = scenario.agent.each
    if copies is None:
        return kind(scenario, create(scenario.world), render_mode)
    return Team(kind, scenario, copies, create(populated(scenario.world, copies)), render_mode)


class Team(Supervisor):
    """A Gymnasium environment over all copies: observations and actions have a row for each.

    Each of `members` is the supervisor of one copy, with rewards, endings and channels of its own; draws are its own
    too, but for parameters, which have one value for all. The episode ends for all when it ends for one. The reward is
    the mean over the copies; `info["each"]` holds what each has got, and whether it was the one that ended.
    """

    def __init__(
        self, kind: type[Supervisor], scenario: Program, copies: RobotCopies, engine: Engine, render_mode: str | None = None
    ) -> None:
        self.copies = copies
        shares = [Share(engine, copies, number + 1) for number in range(copies.count)]
        self.members = [kind(scenario, share) for share in shares]
        self._shares = shares
        self._divided: Streams | None = None
        super().__init__(scenario, engine, render_mode)
        self.observation_space = batch_space(self.members[0].observation_space, copies.count)
        self.action_space = batch_space(self.members[0].action_space, copies.count)

    def begin_robots(self) -> None:
        for member in self.members:
            member.begin_robots()

    def random_state(self) -> dict[str, Any]:
        members = [member.random_state() for member in self.members] if self._divided is self.streams else []
        return {**super().random_state(), "members": members}

    def set_random_state(self, state: Mapping[str, Any]) -> None:
        super().set_random_state(state)
        for number, (member, inner) in enumerate(zip(self.members, state["members"], strict=False), start=1):
            member.streams = Streams.restored(inner, copy_name(self.copies, number))
            self._divided = self.streams

    def _begin(self) -> None:
        if self._divided is not self.streams:
            self._divided = self.streams
            for number, member in enumerate(self.members):
                member.streams = Streams(self.streams.root, copy_name(self.copies, number + 1))
        self.engine.reset()
        for member in self.members:
            member._forget()
            member.chosen = self.chosen
            member._begin()
        if self._shares[0].settling:
            self.engine.step(self._shares[0].settling)

    def _start(self) -> None:
        for member in self.members:
            member._start()
            member._fill_frames()
        self._gather()

    def _fill_frames(self) -> None:
        """Frames are those of the members."""

    def _advance(self, action: Any) -> None:
        if not _takes(self.action_space, action):
            raise ValueError("no action of this space")
        self.step_count += 1
        rows = (
            [{key: part[row] for key, part in action.items()} for row in range(len(self.members))] if isinstance(action, dict) else action
        )
        turns = [member._advance(row) for member, row in zip(self.members, rows, strict=True)]
        for turn in turns:
            next(turn)
        running = True
        while running:
            self.engine.step(self.scenario.world.substeps)
            running = not [turn for turn in turns if next(turn, _FINISHED) is _FINISHED]
        for turn in turns:
            turn.close()
        self._gather()

    def _gather(self) -> None:
        """What the team has come to by what its members have."""
        members = self.members
        self.step_count, self.tick_count = members[0].step_count, members[0].tick_count
        self.reward = sum(member.reward for member in members) / len(members)
        ended = [member for member in members if member.terminated]
        over = ended or [member for member in members if member.truncated]
        self.terminated, self.truncated = bool(ended), bool(over) and not ended
        self.is_success = bool(ended) and all(member.is_success for member in ended)
        self.endings = tuple(dict.fromkeys(name for member in over for name in member.endings))
        failed = [member for member in over if not member.is_success]
        self.ended_by = (failed or over)[0].ended_by if over else None

    def scripted(self, name: str) -> Any:
        """Every copy follows the script."""
        rows = [member.scripted(name) for member in self.members]
        if isinstance(rows[0], dict):
            return {key: np.stack([row[key] for row in rows]) for key in rows[0]}
        return np.stack(rows)

    def get_observations(self) -> Any:
        rows = [member.get_observations() for member in self.members]
        if isinstance(rows[0], dict):
            return {key: np.stack([row[key] for row in rows]) for key in rows[0]}
        return np.stack(rows)

    def get_reward(self) -> float:
        return self.reward

    def is_done(self) -> tuple[bool, bool]:
        return self.terminated, self.truncated

    def get_info(self) -> Info:
        infos = [member.get_info() for member in self.members]
        terms = {name: sum(info["reward_terms"][name] for info in infos) / len(infos) for name in infos[0]["reward_terms"]}
        each = {
            "reward": tuple(member.reward for member in self.members),
            "terminated": tuple(member.terminated for member in self.members),
            "is_success": tuple(member.is_success for member in self.members),
        }
        return {
            "is_success": self.is_success,
            "ended_by": self.ended_by,
            "endings": self.endings,
            "reward_terms": terms,
            "each": each,
        }

    def _strayed(self) -> Triple:
        return self.members[0]._strayed()

    def allowed(self) -> tuple[tuple[bool, ...], ...]:
        return tuple(mask for member in self.members for mask in member.allowed())


def _takes(space: gym.Space[Any], action: Any) -> bool:
    """Whether every row can be acted on; a team that has half acted could not go back."""
    if isinstance(space, gym.spaces.Dict):
        return isinstance(action, dict) and set(action) == set(space.spaces) and all(_takes(space[key], action[key]) for key in action)
    if isinstance(space, gym.spaces.Box):
        return isinstance(action, np.ndarray) and action.shape == space.shape and bool(np.isfinite(action).all())
    return space.contains(action)
