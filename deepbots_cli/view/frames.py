"""Frames: the drawn and plotted values of an environment at one moment.

`FrameReader` binds the readers of the engine port once, and reads a `WorldFrame` after a reset and after each
step. It calls only readers, so an episode is the same with and without it. `FrameLayout` has the values that
do not change in an episode.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import frames
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.expressions.dimensions import ONE, Unit
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.port import ZERO_VECTOR, Engine, RayReader, cast_rays
from deepbots_cli.program import AgentEnding, Program, generated
from deepbots_cli.program.robots import Sensor
from deepbots_cli.program.task import Choices
from deepbots_cli.program.world import Variant
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import RobotModel
from deepbots_cli.runtime import RobotController, Supervisor
from deepbots_cli.runtime.actuation import Push
from deepbots_cli.runtime.messages import Channel, FieldCodec, LossyChannel
from deepbots_cli.runtime.placement import Arrangement

COLORS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#8a8a8a", "#a58b00")
"""The colors of Okabe and Ito, which color-blind people can distinguish; gray replaces black."""

Image = NDArray[np.uint8]
LinkName = tuple[str, str]
"""A body and one of its links; the root link of an object has the name of the object."""

# Turns x to -z, the direction of a reflectance sensor.
_DOWNWARD = frames.quaternion(0.0, np.pi / 2, 0.0)

END_OF_RECORDING, END_OF_LOG = "end of the recording", "end of the log"
"""The last frame of what ends before its episode: no ending of the scenario."""
_REFLECTANCE_REACH_M = 0.1  # a reflectance sensor has no reach


class PlottedField(NamedTuple):
    """A number that is plotted, with its range. `group` is the entry of the scenario that it belongs to;
    `options` are the names of the options of a choice, whose number is the index of an option. Values are in
    the SI unit `unit`, and shown in the unit `shown`, None for the SI unit."""

    name: str
    group: str
    low: float
    high: float
    unit: str
    options: tuple[str, ...] = ()
    shown: Unit | None = None

    def text(self, value: float) -> str:
        """Return the value in words: the name of an option, or a number with its unit."""
        if self.options:
            return self.options[round(value)]
        return f"{self.to_shown(value):.3g}{self._shown_unit and f' {self._shown_unit}'}"

    @property
    def label(self) -> str:
        """The name with the unit of `to_shown`, such as `yaw (deg)`."""
        return f"{self.name}{self._shown_unit and f' ({self._shown_unit})'}"

    @property
    def _shown_unit(self) -> str:
        text = self.unit if self.shown is None else self.shown.text
        return "" if text == ONE.text else text

    def to_shown(self, value: float) -> float:
        """Return a value in SI units in the unit in which it is shown."""
        return value if self.shown is None else self.shown.from_si(value)

    def from_shown(self, value: float) -> float:
        """Return the SI value of a value in the unit in which it is shown."""
        return value if self.shown is None else self.shown.to_si(value)


class SensorRays(NamedTuple):
    """The rays of a sensor: `starts` (n, 3) and unit vectors `directions` (n, 3) in the frame of the link,
    free up to `reach` m. `upright` rays follow the yaw of the link alone."""

    part: LinkName
    starts: NDArray[np.float64]
    directions: NDArray[np.float64]
    reach: float
    upright: bool = False

    def reader(self, engine: Engine, rays: Sequence[Frame]) -> RayReader:
        """Return a reader of how far the rays, as frames along x, are free."""
        return cast_rays(engine, self.part, rays, self.reach, upright=self.upright)

    def lines(self, frame: WorldFrame, key: str) -> NDArray[np.float32]:
        """Return each ray from its start to the end of its free part: x, y, z (world frame) and red, green,
        blue of both ends, shape (n, 2, 6).

        Free rays are green, and rays that end near the sensor are red.
        """
        free = np.array(frame.rays[key])[:, None]
        origin, turn = frame.links[self.part]
        turn = frames.yaw_only(turn) if self.upright else turn
        axes = np.array(
            [frames.rotate(turn, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
        )
        closeness = np.clip(1 - free / self.reach, 0.0, 1.0)
        colors = np.concatenate([20 + 200 * closeness, 150 - 110 * closeness, 60 - 20 * closeness], axis=1)
        ends = (self.starts, self.starts + free * self.directions)
        return np.stack(
            [np.concatenate([origin + end @ axes, colors], axis=1) for end in ends], axis=1
        ).astype(np.float32)


@dataclass(frozen=True, eq=False)
class FrameLayout:
    """The constant parts of an environment: the fields of an agent, the robots, the rays by `robot.sensor`,
    and the fields of messages by `robot/direction`."""

    observation: tuple[PlottedField, ...]
    action: tuple[PlottedField, ...]
    terms: tuple[str, ...]
    robots: Mapping[str, RobotModel]
    sensor_rays: Mapping[str, SensorRays]
    messages: Mapping[str, tuple[PlottedField, ...]]
    of_robot: tuple[str, ...] = ()
    """The groups of values of the log of a robot that are always plotted; such a log has no reward."""

    def goal_point(self, agent: AgentFrame, word: str) -> Triple | None:
        """Return the `achieved` or `desired` goal as a point (m, world frame), on the ground if it has no z;
        None if it is not a position."""
        indices = [index for index, field in enumerate(self.observation) if field.group == word]
        axes = [self.observation[index].name for index in indices if self.observation[index].unit == "m"]
        if axes not in ([f"{word}.x", f"{word}.y"], [f"{word}.x", f"{word}.y", f"{word}.z"]):
            return None
        x, y, z = (*(agent.observation[index] for index in indices), 0.0)[:3]
        return x, y, z


@dataclass(frozen=True, eq=False)
class AgentFrame:
    """The values of an agent at one moment.

    `observation` has the newest value of each field in its unit, followed by the achieved and the desired
    goal. `action` is None after a reset. `allowed` has, for each option of each choice in a row, whether it
    may be chosen next; empty if all may.
    """

    observation: tuple[float, ...]
    action: tuple[float, ...] | None
    reward: float
    episode_return: float
    terms: Mapping[str, float]
    allowed: tuple[bool, ...] = ()


class ReceivedMessage(NamedTuple):
    """The message that its receiver uses: a value for each field, None for a picture and before the first
    message.

    `age` (s) is the time since it was created, and `received` is true if it arrived in this step.
    """

    values: tuple[float | None, ...]
    age: float
    received: bool


@dataclass(frozen=True, eq=False)
class WorldFrame:
    """The world at one moment, in SI units and the world frame; quaternions are (x, y, z, w).

    `links` has the pose of every link of a body that is present, `joints` the positions of the moving joints
    of each robot, `rays` the free length (m) of each ray, `readings` the last values of each sensor, `forces`
    the sum of normal forces (N) on each link that touches something, and `pushes` the forces (N) of
    disturbances that act now. `variants` are the forms of bodies with variants. `messages` are by
    `robot/to_robot` and `robot/from_robot`. `cameras` has the newest image of each camera, by `robot.sensor`:
    uint8 (rows, columns, 1 or 3). `drawn` are the values that the episode drew, in SI units.
    """

    step: int
    time: float
    links: Mapping[LinkName, Frame]
    joints: Mapping[str, tuple[float, ...]]
    rays: Mapping[str, tuple[float, ...]]
    readings: Mapping[str, tuple[float, ...]]
    forces: Mapping[LinkName, float]
    pushes: tuple[tuple[LinkName, Triple], ...]
    variants: Mapping[str, str]
    messages: Mapping[str, ReceivedMessage]
    cameras: Mapping[str, Image]
    drawn: Mapping[str, float | str]
    agents: Mapping[str, AgentFrame]
    ended_by: str | None
    is_success: bool
    truncated: bool
    succeeded: tuple[str, ...] = ()
    """Of several agents, those for which the episode is a success."""

    @property
    def ending(self) -> str:
        """The ending of the episode in words; empty while it runs."""
        if self.ended_by in (None, END_OF_RECORDING, END_OF_LOG):
            return self.ended_by or ""
        if self.is_success:
            return f"success: {self.ended_by}"
        if self.succeeded:
            return f"success of {', '.join(self.succeeded)}: {self.ended_by}"
        return f"{'time limit' if self.truncated else 'failure'}: {self.ended_by}"


def successful_agents(
    program: Program, endings: Sequence[str], ended_alone: Mapping[str, AgentEnding] = MappingProxyType({})
) -> tuple[str, ...]:
    """Return the names of those of several agents for which the episode is a success, given the endings of
    the world, and those of the agents that ended before."""
    outcomes = {name: member.has_succeeded(endings) for name, member in program.members.items()}
    outcomes |= {name: ending.is_success for name, ending in ended_alone.items()}
    return tuple(name for name, is_success in outcomes.items() if is_success)


def observation_fields(program: Program, units: ShownUnits) -> tuple[PlottedField, ...]:
    """Return the numbers of the newest observation, then those of the goal."""
    agent = program.agent
    named = [
        PlottedField(n.full_name, n.name, 0.0 if n.is_truth else n.low, 1.0 if n.is_truth else n.high, n.unit)
        for n in agent.numbers
    ]
    if (goal := agent.goal) is not None:
        for word in ("achieved", "desired"):
            ends = zip(goal.components or ("",), goal.low, goal.high, strict=True)
            named += [
                PlottedField(f"{word}.{part}".rstrip("."), word, low, high, goal.unit)
                for part, low, high in ends
            ]
    return tuple(field._replace(shown=units.of_entry(field.name, field.unit)) for field in named)


def action_fields(program: Program, units: ShownUnits) -> tuple[PlottedField, ...]:
    """Return a field for each choice and for each component of a range, choices and ranges in file order."""
    fields = []
    for part in program.agent.action:
        if isinstance(part, Choices):
            names = tuple(option.name for option in part.options)
            fields.append(PlottedField(part.name, part.name, 0.0, len(names) - 1.0, "", names))
        else:
            unit = units.of_entry(part.name, part.unit)
            fields += [
                PlottedField(name, part.name, part.low, part.high, part.unit, shown=unit)
                for name in part.names
            ]
    return tuple(fields)


class MessageRecorder:
    """A wrapper of the `FieldCodec` of a channel that keeps the last received message."""

    def __init__(self, wire: FieldCodec, units: ShownUnits) -> None:
        self._wire = wire
        self.layout = wire.layout
        self.silence = wire.silence
        self.encode = wire.encode
        self.fields = tuple(
            PlottedField(
                name,
                field.name,
                math.nan,
                math.nan,
                field.unit,
                shown=units.of_entry(f"{wire.layout.robot}.{name}", field.unit),
            )
            for field in wire.layout.fields
            for name in ([f"{field.name}.{part}" for part in field.components] or [field.name])
        )
        self.forget()

    def forget(self) -> None:
        """Keep no message of the episode before."""
        self._values: Sequence[Any] = (None,) * len(self.fields)
        self._received = 0

    def decode(self, message: Any) -> Sequence[Any]:
        self._values = self._wire.decode(message)
        self._received += 1
        return self._values

    def message(self, channel: Channel | LossyChannel, *, after_reset: bool) -> ReceivedMessage:
        """Return the newest message. Messages that arrive later belong to the next frame."""
        if after_reset and not self._received:
            self._values = (None,) * len(self.fields)  # the values of the episode before are dropped
        flat = [
            part for value in self._values for part in (value if isinstance(value, list | tuple) else [value])
        ]
        values = tuple(
            None if value is None or isinstance(value, np.ndarray) else float(value) for value in flat
        )
        received = self._received > 0 and (isinstance(channel, Channel) or channel.message_received)
        self._received = 0
        return ReceivedMessage(values, 0.0 if isinstance(channel, Channel) else channel.age, received)


def _called(env: Supervisor, body: str, agent: str) -> str:
    """Return the name of a body of an agent. A copy of a robot has the name of its agent."""
    copies = env.scenario.agent.copies
    return agent if copies and copies.robot == body else body


def recorded_channels(
    env: Supervisor, units: ShownUnits
) -> Iterator[tuple[str, tuple[Channel | LossyChannel, MessageRecorder]]]:
    """Yield the channels by robot and direction. From now on, they keep the messages that they decode."""
    for copy, agent in env.agents.items():
        for (name, direction), channel in agent.channels.items():
            assert channel.wire is not None  # only channels of tests have none
            if not isinstance(channel.wire, MessageRecorder):
                channel.wire = cast("FieldCodec", MessageRecorder(channel.wire, units))
            yield f"{_called(env, name, copy)}/{direction}", (channel, cast("MessageRecorder", channel.wire))


class FrameReader:
    """Reads frames of one environment, one after each reset and each step, because it adds up the returns."""

    def __init__(self, env: Supervisor, units: ShownUnits | None = None) -> None:
        """Bind the readers. `units` are those of the file, in which fields are shown."""
        self.env, units = env, units or ShownUnits()
        program, engine, world = env.scenario, env.engine, env.world
        models = {robot.name: robot.model for robot in world.robots}
        self._poses = {
            (name, link.name): engine.pose(name, link.name)
            for name, model in models.items()
            for link in model.links
        }
        self._poses |= {(body.name, body.name): engine.pose(body.name) for body in world.objects}
        self._joints = {
            name: engine.joint_states(name, [joint.name for joint in model.moving_joints])
            for name, model in models.items()
            if model.moving_joints
        }
        touching = [
            (name, link.name) for name, model in models.items() for link in model.links if link.collisions
        ]
        reported = touching if "contacts" in engine.capabilities else []
        self._forces = {part: engine.contact_force(part) for part in reported}
        controllers = {
            _called(env, name, copy): controller
            for copy, agent in env.agents.items()
            for name, controller in agent.controllers.items()
        }
        devices = {
            f"{body}.{name}": device
            for body, controller in controllers.items()
            for name, device in controller.devices.items()
        }
        cameras = {
            f"{body}.{sensor.name}"
            for body, controller in controllers.items()
            for sensor in controller.spec.sensors
            if sensor.optics
        }
        self._cameras = {key: device for key, device in devices.items() if key in cameras}
        self._sensors = {key: device for key, device in devices.items() if key not in cameras}
        self._message_recorders = dict(recorded_channels(env, units))
        beams = {
            key: _beams((body, sensor.subjects[0]), sensor)
            for key, body, sensor in _named_sensors(controllers)
            if sensor.beams and sensor.subjects[0] in {link.name for link in models[body].links}
        }
        self.layout = FrameLayout(
            observation_fields(program, units),
            action_fields(program, units),
            tuple(term.name for term in program.agent.reward),
            models,
            {key: beam for key, (beam, _) in beams.items()},
            {key: tap.fields for key, (_, tap) in self._message_recorders.items()},
        )
        self._rays = {key: beam.reader(engine, rays) for key, (beam, rays) in beams.items()}
        self._pushes = list(self._pushed_links(models))
        self._pooled = {body.name for body in world.objects if body.pooled}
        self._variants = {body.name: body.variants[0].name for body in world.objects if body.variants}
        self._newest = np.array(program.agent.newest, np.intp)
        self._truths = [number.is_truth for number in program.agent.numbers]
        self._ranges = [(f.low, f.high) for f in self.layout.observation]
        self._returns: dict[str, float] = {}

    def _pushed_links(self, models: Mapping[str, RobotModel]) -> Iterator[tuple[LinkName, Push]]:
        """Yield the links that disturbances push; without a link, the root of a robot or an object."""
        for name, agent in self.env.agents.items():
            for disturbance in self.env.scenario.disturbances:
                push = getattr(agent, generated.push(disturbance.name), None)
                if isinstance(push, Push):
                    body = _called(self.env, disturbance.body, name)
                    root = models[body].root if body in models else body
                    yield (body, disturbance.link or root), push

    def read(self, observation: Any, action: Any = None) -> WorldFrame:
        """Return the frame of this moment, given the observation that `reset` or `step` returned and the
        action of the step."""
        env = self.env
        bodies = [getattr(agent, "bodies", None) for agent in env.agents.values()]
        arrangement = next((arranged for arranged in bodies if isinstance(arranged, Arrangement)), None)
        absent = self._pooled - set(arrangement.placed) if arrangement else self._pooled
        chosen_variants: Mapping[str, Variant] = arrangement.forms.chosen if arrangement else {}
        forces = {part: read() for part, read in self._forces.items()}
        several = len(env.agents) > 1 or next(iter(env.agents.values())) is not env
        agents = {}
        for row, (name, agent) in enumerate(env.agents.items()):
            own_observation, own_action = (
                (value_of_row(observation, row), value_of_row(action, row))
                if several
                else (observation, action)
            )
            # A reset begins at 0.
            self._returns[name] = self._returns.get(name, 0.0) + agent.reward if env.step_count else 0.0
            agents[name] = self._agent(agent, own_observation, own_action, self._returns[name])
        images = {key: camera.reading for key, camera in self._cameras.items()}
        substeps = env.scenario.world.substeps * env.scenario.action_repeat
        pushes = ((part, push.force_within(substeps)) for part, push in self._pushes)
        return WorldFrame(
            step=env.step_count,
            time=env.step_count * env.scenario.period,
            links={part: pose for part, pose in self.links().items() if part[0] not in absent},
            joints=self.joints(),
            rays={key: tuple(map(float, read())) for key, read in self._rays.items()},
            readings={key: tuple(map(float, sensor.reading)) for key, sensor in self._sensors.items()},
            forces={part: force for part, force in forces.items() if force > 0.0},
            pushes=tuple(push for push in pushes if push[1] != ZERO_VECTOR),
            variants=self._variants
            | {body: variant.name for body, variant in chosen_variants.items() if body in self._variants},
            messages={
                key: tap.message(channel, after_reset=not env.step_count)
                for key, (channel, tap) in self._message_recorders.items()
            },
            cameras={
                key: np.asarray(image[0] if isinstance(image, list | tuple) else image)
                for key, image in images.items()
            },
            drawn=env.present_values(),
            agents=agents,
            ended_by=env.ended_by,
            is_success=env.is_success,
            truncated=env.truncated,
            succeeded=successful_agents(env.scenario, env.endings, env.agent_endings),
        )

    def links(self) -> dict[LinkName, Frame]:
        """Return the pose of every link and object, including absent ones."""
        return {part: read() for part, read in self._poses.items()}

    def joints(self) -> dict[str, tuple[float, ...]]:
        """Return the positions of the moving joints of each robot."""
        return {name: tuple(float(state[0]) for state in read()) for name, read in self._joints.items()}

    def _agent(self, agent: Supervisor, observation: Any, action: Any, episode_return: float) -> AgentFrame:
        vector = observation
        goal = []
        if isinstance(observation, dict):
            vector = observation.get("observation", np.zeros(0, np.float32))
            goal = (
                [*observation["achieved_goal"], *observation["desired_goal"]]
                if "desired_goal" in observation
                else []
            )
        masks = agent.allowed() if agent.ended_by is None else ()
        mapped = [*np.asarray(vector)[self._newest], *goal]
        values = tuple(
            float(value) if truth else (low + high) / 2 + (high - low) / 2 * float(value)
            for value, truth, (low, high) in zip(
                mapped, [*self._truths, *[False] * len(goal)], self._ranges, strict=True
            )
        )
        return AgentFrame(
            values,
            None if action is None else self._action(agent, action),
            agent.reward,
            episode_return,
            dict(agent.get_info()["reward_terms"]),
            tuple(may for mask in masks for may in mask) if not all(map(all, masks)) else (),
        )

    def _action(self, agent: Supervisor, action: Any) -> tuple[float, ...]:
        """Return one number for each action field."""
        parts = action if isinstance(action, dict) else {"choices": action, "ranges": action}
        choices = iter(np.atleast_1d(np.asarray(parts["choices"])).tolist())
        ranges = iter(np.atleast_1d(np.asarray(parts["ranges"], np.float64)).tolist())
        return tuple(
            float(next(choices))
            if f.options
            else (f.low + f.high) / 2 + (f.high - f.low) / 2 * min(1.0, max(-1.0, next(ranges)))
            for f in self.layout.action
        )


def value_of_row(value: Any, row: int) -> Any:
    """Return the part of one agent or world of the observation or action of all; None stays None."""
    if isinstance(value, dict):
        return {key: part[row] for key, part in value.items()}
    return None if value is None else value[row]


def _beams(part: LinkName, sensor: Sensor) -> tuple[SensorRays, Sequence[Frame]]:
    """Return the rays of a sensor as arrays and as frames along x. The rays of a reflectance sensor point
    down."""
    assert sensor.beams is not None
    mount = frames.frame(sensor.mount)
    rays = [frames.compose(mount, frames.frame(ray)) for ray in sensor.beams.rays]
    if sensor.kind == "reflectance":
        rays = [frames.compose(ray, (ZERO_VECTOR, _DOWNWARD)) for ray in rays]
    starts = np.array([origin for origin, _ in rays])
    directions = np.array([frames.rotate(turn, (1.0, 0.0, 0.0)) for _, turn in rays])
    reach = sensor.beams.reach or _REFLECTANCE_REACH_M
    return SensorRays(part, starts, directions, reach, sensor.beams.upright), rays


def _named_sensors(controllers: Mapping[str, RobotController]) -> Iterator[tuple[str, str, Sensor]]:
    """Yield the sensors of robots as `robot.sensor`, each after its body, given the controllers by body."""
    for body, controller in controllers.items():
        for sensor in controller.spec.sensors:
            yield f"{body}.{sensor.name}", body, sensor
