"""Plays the log of a robot: reported joint positions and poses move its model, and all reported values are
plotted."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.frames import Frame
from deepbots_cli.rollout.drivers import ROBOT
from deepbots_cli.rollout.robot_logs import LoggedStep, RobotLog
from deepbots_cli.scenario.sensors import SENSORS
from deepbots_cli.view.episodes import Player, ShowingState
from deepbots_cli.view.frames import AgentFrame, FrameReader, PlottedField, WorldFrame
from deepbots_cli.view.replay import ReplayPlayer

if TYPE_CHECKING:
    from deepbots_robot.model import Input, Output

POSTURE, TIMES = "posture: 0 policy, 1 safe", "ages and answer time (ms)"
"""The groups that are always plotted for a log."""
_SAFE = "safe"
_MAX_PLACE = 1e6  # m or rad; the largest drawn value
_MAX_NUMBERS = 2048  # the largest number of components of a plotted input

Values = Mapping[str, Sequence[float]]


class _Column(NamedTuple):
    """A number of the log: the name of its input or output, and its place there."""

    name: str
    place: int
    field: PlottedField

    def of(self, values: Values) -> float:
        numbers = values.get(self.name, ())
        return numbers[self.place] if self.place < len(numbers) else math.nan


class LogPlayer(ReplayPlayer):
    """Plays a log. The world is that of the scenario at the start of an episode, except for the values that
    the robot reported."""

    def __init__(self, opened: ShowingState) -> None:
        """Make the environment.

        Raises:
            ScenarioError, EngineError, UsageError: As for `Player`.
        """
        assert isinstance(opened.recording, RobotLog)
        self.log = opened.recording
        self._numbers = [episode.number for episode in self.log.episodes]
        # On the instance: a cache on the method would keep the player, and with it its engine, in memory.
        self._read = lru_cache(maxsize=2000)(self._frame_of)
        Player.__init__(self, opened, ROBOT)

    def make_reader(self) -> FrameReader:
        reader = super().make_reader()
        info = self.log.info
        every = [step for episode in self.log.episodes for step in episode.steps]
        units = self.opened.checked().units
        self._inputs = list(_columns(info.inputs, [step.inputs for step in every], units))
        self._commands = list(_columns(info.outputs, [step.commands for step in every], units))
        self._aged = [entry.name for entry in info.inputs if entry.max_age_s is not None]
        longest = 1e3 * max(
            (age for step in every for age in (step.answer, *step.ages.values()) if math.isfinite(age)),
            default=0.0,
        )
        times = ("answer time", *(f"age of {name}" for name in self._aged))
        rays = reader.layout.sensor_rays
        self._rays = {
            entry.name: len(rays[entry.name].starts)
            for entry in info.inputs
            if entry.name in rays and entry.unit == "m" and entry.shape == (len(rays[entry.name].starts),)
        }
        self._drawn = [entry.name for entry in info.inputs if entry.name in self._rays or self._moves(entry)]
        reader.layout = replace(
            reader.layout,
            observation=(
                *(column.field for column in self._inputs),
                PlottedField("posture", POSTURE, 0.0, 1.0, "", ("policy", _SAFE)),
                *(PlottedField(name, TIMES, 0.0, longest or 1.0, "ms") for name in times),
            ),
            action=tuple(column.field for column in self._commands),
            terms=(),
            messages={},
            sensor_rays={name: rays[name] for name in self._rays},
            of_robot=(POSTURE, TIMES),
        )
        return reader

    def begin(self, seed: int, episode: int) -> WorldFrame:
        """Return the first frame of an episode of the log; `seed` has no meaning."""
        self._recorded = logged = self.log.episode(self._numbers[0] if episode == 0 else episode)
        self._rows = logged.steps
        observation, _ = self.env.reset(seed=self._recorded.seed)
        self._start = self.reader.read(observation)
        return self.seek(0)

    @property
    def note(self) -> str:
        """The last event, the drawn values, and whether the log was read in part."""
        last = next((event for step in self._rows[self._index :: -1] for event in step.events[::-1]), "")
        drawn_text = (
            f"the log moves {', '.join(self._drawn)}"
            if self._drawn
            else "the log has no joint position and no pose"
        )
        partly = "".join(f" Note: {note}." for note in self.log.notes)
        return (
            f"{last or 'no event so far'}. Drawn: {drawn_text}; all else stands as the scenario places"
            f" it.{partly}"
        )

    def _frame_of(self, number: int, index: int) -> WorldFrame:
        steps = self.log.episode(number).steps
        step = steps[index]
        inputs: Values = next((earlier.inputs for earlier in steps[index::-1] if earlier.inputs), {})
        self._move(inputs)
        is_last = index == len(steps) - 1
        return replace(
            self._start,
            step=index,
            time=step.time,
            links={part: pose for part, pose in self.reader.links().items() if part in self._start.links},
            joints=self.reader.joints(),
            rays={
                name: tuple(inputs.get(name, ()))[:count] or (0.0,) * count
                for name, count in self._rays.items()
            },
            readings={},
            forces={},
            pushes=(),
            messages={},
            cameras={},
            drawn={},
            agents={next(iter(self.env.agents)): self._agent(step)},
            ended_by="end of the log" if is_last else None,
            is_success=False,
            truncated=is_last,
        )

    def _agent(self, step: LoggedStep) -> AgentFrame:
        times = (step.answer or math.nan, *(step.ages.get(name, math.nan) for name in self._aged))
        values = (
            *(column.of(step.inputs) for column in self._inputs),
            float(step.posture == _SAFE),
            *(1e3 * time for time in times),
        )
        return AgentFrame(values, tuple(column.of(step.commands) for column in self._commands), 0.0, 0.0, {})

    # The world

    def _moves(self, entry: Input) -> bool:
        """Return whether the input gives the position of a part of the world."""
        return _quantity(entry) == "joint_position" or self._body(entry) is not None

    def _body(self, entry: Input) -> str | None:
        """Return the robot or object whose origin the input gives; None for another quantity or another place
        on it."""
        if _quantity(entry) not in ("position", "orientation"):
            return None
        roots = {robot.name: robot.model.root for robot in self.env.world.robots if not robot.fixed_base}
        if entry.sensor in SENSORS and "(" not in entry.name:
            body = entry.robot or ""
            return (
                body
                if entry.link is not None and roots.get(body) == entry.link and entry.mount is None
                else None
            )
        body = entry.name.partition("(")[2].removesuffix(")")
        objects = [object_body.name for object_body in self.env.world.objects if not object_body.fixed]
        return body if body in roots or body in objects else None

    def _move(self, inputs: Values) -> None:
        """Move the parts that the robot reported; all else is as at the start."""
        engine = self.env.engine
        joints: dict[tuple[str, str], float] = {}
        poses: dict[str, Frame] = {}
        for robot in self.env.world.robots:
            poses[robot.name] = self._start.links[robot.name, robot.model.root]
            starts = zip(robot.model.moving_joints, self._start.joints.get(robot.name, ()), strict=False)
            joints |= {(robot.name, joint.name): position for joint, position in starts}
        for entry in self.log.info.inputs:
            numbers = inputs.get(entry.name, ())
            if len(numbers) != math.prod(entry.shape) or not all(
                abs(number) <= _MAX_PLACE for number in numbers
            ):
                continue
            if _quantity(entry) == "joint_position":
                joints |= {
                    (entry.robot or "", joint): number
                    for joint, number in zip(entry.joints, numbers, strict=False)
                }
            elif (body := self._body(entry)) is not None and (
                body in poses or (body, body) in self._start.links
            ):
                origin, turn = poses.get(body) or self._start.links[body, body]
                is_turn = _quantity(entry) == "orientation"
                if is_turn and not math.isclose(math.hypot(*numbers), 1.0, rel_tol=0.01):
                    continue
                poses[body] = (origin, _four(numbers)) if is_turn else (_three(numbers), turn)
        for body, pose in poses.items():
            engine.place(body, *pose)
        for robot in self.env.world.robots:
            for joint in robot.model.moving_joints:
                if joint.name not in robot.model.followers and (robot.name, joint.name) in joints:
                    engine.set_joint(robot.name, joint.name, joints[robot.name, joint.name], 0.0)


def _columns(
    entries: Sequence[Input | Output], rows: Sequence[Values], units: ShownUnits
) -> Iterator[_Column]:
    """Yield the numbers of inputs or outputs except for pictures, each with its range, or that of its values
    if it has none."""
    for entry in entries:
        if len(entry.shape) > 1 or entry.shape[0] > _MAX_NUMBERS:
            continue
        names = entry.components or entry.joints or [str(index) for index in range(entry.shape[0])]
        for index in range(entry.shape[0]):
            name = f"{entry.name}.{names[index]}" if entry.shape[0] > 1 and index < len(names) else entry.name
            unit = units.of_entry(entry.name, entry.unit)
            column = _Column(
                entry.name, index, PlottedField(name, entry.name, math.nan, math.nan, entry.unit, shown=unit)
            )
            values = [value for row in rows if math.isfinite(value := column.of(row))] or [0.0]
            low, high = (ends[index] for ends in entry.range) if entry.range is not None else (None, None)
            ends = min(values) if low is None else low, max(values) if high is None else high
            yield column._replace(field=column.field._replace(low=ends[0], high=ends[1]))


def _quantity(entry: Input) -> str:
    """Return the function of the language that has the value of an input; the kind of its sensor for one
    without."""
    kind = SENSORS.get(entry.sensor or "")
    return (kind.world_function if kind is not None else None) or entry.sensor or ""


def _three(numbers: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = numbers
    return x, y, z


def _four(numbers: Sequence[float]) -> tuple[float, float, float, float]:
    x, y, z, w = numbers
    return x, y, z, w
