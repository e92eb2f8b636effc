"""How fast bodies and joints are, and whether that is still physics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from deepbots_cli.port import JointReader, MotionReader
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.team import populated

FASTEST = 300.0
"""m/s; near the speed of sound. What falls may become faster, as long as it falls."""
HALF_TURN = math.pi
"""rad in one physics step. From there on an engine cannot tell which way a thing turns."""
SPINNING = 1000.0
"""rad/s; slower turns are left alone, however long the physics step."""
_GROWN = 4.0


class _Watched(NamedTuple):
    body: str
    motion: MotionReader
    joints: tuple[str, ...]
    revolute: tuple[bool, ...]
    states: JointReader | None


class Speeds:
    """Robots first, then objects that can move. `news` holds the fastest so far, whenever that has grown a lot."""

    def __init__(self, environment: Supervisor) -> None:
        scenario, engine = environment.scenario, environment.engine
        world = populated(scenario.world, scenario.agent.each) if scenario.agent.each else scenario.world
        self._substep = world.timestep / world.substeps
        self._fall = math.hypot(*engine.gravity)
        self._watched = []
        for robot in world.robots:
            moving = robot.model.moving_joints
            names = tuple(joint.name for joint in moving)
            reader = engine.joint_states(robot.name, names) if names else None
            turns = tuple(joint.type != "prismatic" for joint in moving)
            self._watched.append(_Watched(robot.name, engine.motion(robot.name), names, turns, reader))
        self._watched += [_Watched(thing.name, engine.motion(thing.name), (), (), None) for thing in world.objects if not thing.fixed]
        self._most = 1.0
        self.news: list[Any] = []

    def look(self, time: float) -> dict[str, Any]:
        """What is beyond plausibility after so many s; empty where all is well."""
        self.news = []
        for watched in self._watched:
            velocity, spin = (math.hypot(*part) for part in watched.motion()[1])
            if not math.isfinite(velocity + spin):
                return {"body": watched.body, "what": "nan"}
            if velocity > self._most * _GROWN:
                self._most, self.news = velocity, [watched.body, velocity]
            if velocity > FASTEST + self._fall * time:
                return {"body": watched.body, "what": "velocity", "figure": velocity}
            if spin > SPINNING and spin * self._substep > HALF_TURN:
                return {"body": watched.body, "what": "spin", "figure": spin}
            found = self._joint(watched)
            if found:
                return found
        return {}

    def _joint(self, watched: _Watched) -> dict[str, Any]:
        states: Sequence[Sequence[float]] = watched.states() if watched.states else ()
        for name, turns, state in zip(watched.joints, watched.revolute, states, strict=True):
            speed = abs(state[1])
            if not math.isfinite(state[0] + speed):
                return {"body": watched.body, "joint": name, "what": "nan"}
            if speed > (max(SPINNING, HALF_TURN / self._substep) if turns else FASTEST):
                return {"body": watched.body, "joint": name, "what": "joint", "figure": speed}
        return {}

    def lost(self) -> list[str]:
        """The bodies whose motion is no longer a number."""
        return [watched.body for watched in self._watched if not math.isfinite(sum(map(sum, (*watched.motion()[0], *watched.motion()[1]))))]
