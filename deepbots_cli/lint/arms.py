"""Commands to `cartesian` actuators, and how far from each the inverse kinematics ends. Runs in the process that simulates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import atan2, dist, hypot, radians

from deepbots_cli import frames
from deepbots_cli.footprint import link_frames
from deepbots_cli.frames import Triple
from deepbots_cli.lint.report import Missed
from deepbots_cli.program.robots import Cartesian as BuiltCartesian
from deepbots_cli.robots.model import RobotModel
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.actuation import Cartesian

_DISTANCE = 0.005  # m
_ANGLE = radians(1.0)
"""What a pose may be missed by. Where the search succeeds it ends within 0.1 um."""
_TURN = radians(90.0)
_IN_PLACE = 0.2
"""rad and m: an arm that starts elsewhere, such as stretched out, turns on its way and is not meant."""
_AT_LIMIT = 1e-6  # rad or m; the search clips positions to the limits exactly


class Reaches:
    """Watches the commands to the `cartesian` actuators of an environment."""

    def __init__(self, environment: Supervisor) -> None:
        self.watching = False
        self.commands: dict[tuple[str, str], int] = {}
        """How many were given since the last `missed`, by robot and actuator."""
        self._missed: dict[tuple[str, str], Missed] = {}
        self.arms = [arm for world in getattr(environment, "members", [environment]) for arm in self._watched(world)]

    def _watched(self, world: Supervisor) -> Iterator[str]:
        """Watch what a supervisor commands; the names of the actuators."""
        models = {body.name: body.model for body in world.scenario.world.robots}
        for robot in world.scenario.robots:
            for actuator in robot.actuators:
                drive = getattr(getattr(world, f"robot_{robot.name}"), f"drive_{actuator.name}", None)
                if isinstance(actuator, BuiltCartesian) and isinstance(drive, Cartesian):
                    drive.watch = partial(self._look, world, robot.name, models[robot.name], actuator, drive)
                    yield actuator.name

    def missed(self, by: str, seed: int) -> list[Missed]:
        """Of each actuator the first command since the last call that it missed: later ones begin from where that brought the arm."""
        found = [replace(missed, by=by, seed=seed, commands=self.commands[key]) for key, missed in self._missed.items()]
        self.commands.clear()
        self._missed.clear()
        return found

    def _look(
        self,
        world: Supervisor,
        robot: str,
        model: RobotModel,
        actuator: BuiltCartesian,
        drive: Cartesian,
        target: Triple,
        solution: Sequence[float],
    ) -> None:
        if not self.watching:
            return
        key = (robot, actuator.name)
        self.commands[key] = self.commands.get(key, 0) + 1
        found = dict(zip(actuator.joints, solution, strict=True))
        others = [joint.name for joint in model.moving_joints if joint.name not in found]
        now = {name: state[0] for name, state in zip(others, world.engine.joint_states(robot, others)(), strict=True)} if others else {}
        place, turned = frames.inside(world.engine.pose(robot)(), link_frames(model, now | found)[actuator.link])
        distance = dist(place, target)
        angle = 0.0 if drive.attitude is None else _angle(frames.multiply(drive.attitude, frames.inverse(turned)))
        if distance <= _DISTANCE and angle <= _ANGLE:
            self._look_for_turn(world, key, actuator, drive, target)
            return
        if key not in self._missed:
            stops = {name: stop for name, position in found.items() for stop in _stops(model, name, position)}
            self._missed[key] = Missed(robot, actuator.name, distance, angle, stops, step=world.step_count)
        self._missed[key] = replace(self._missed[key], out=self._missed[key].out + 1)

    def _look_for_turn(self, world: Supervisor, key: tuple[str, str], actuator: BuiltCartesian, drive: Cartesian, target: Triple) -> None:
        """Whether the first command of an episode asks a link to stay about where it is and to turn."""
        if drive.attitude is None or self.commands[key] > 1 or key in self._missed:
            return
        place, attitude = world.engine.pose(key[0], actuator.link)()
        turn = _angle(frames.multiply(drive.attitude, frames.inverse(attitude)))
        if turn > _TURN and dist(place, target) < _IN_PLACE:
            start = frames.roll_pitch_yaw(attitude)
            self._missed[key] = Missed(*key, 0.0, 0.0, {}, turn=turn, start=start, step=world.step_count)


def _angle(q: frames.Quaternion) -> float:
    """Of a rotation, in rad from 0 to half a turn."""
    return 2.0 * atan2(hypot(q[0], q[1], q[2]), abs(q[3]))


def _stops(model: RobotModel, joint: str, position: float) -> Iterator[float]:
    """The limit of a joint (rad or m) that it is at, if it is at one."""
    limit = model.joint(joint).limit
    yield from (end for end in (limit.lower, limit.upper) if end is not None and abs(position - end) < _AT_LIMIT)
