"""The choice of the player of a source; playing recordings, and running them again to compare; playing the
log of a robot.

The joint positions and poses that a log reports move the model of the robot, and all reported values are
plotted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.frames import Frame
from deepbots_cli.port import View
from deepbots_cli.rollout import Start
from deepbots_cli.rollout.drivers import HAND, RECORDED, ROBOT, sequence_driver
from deepbots_cli.rollout.recordings import (
    LoggedEpisode,
    LoggedStep,
    RecordedEpisode,
    Recording,
    RecordingError,
    RobotLog,
    actions,
    damaged,
)
from deepbots_cli.scenario.sensors import SENSORS
from deepbots_cli.view.episodes import BatchPlayer, Player, Showing, ShowingState
from deepbots_cli.view.frames import (
    END_OF_LOG,
    END_OF_RECORDING,
    AgentFrame,
    FrameReader,
    PlottedField,
    WorldFrame,
)
from deepbots_cli.view.recordings import NS_PER_S, TopicEncoder, read_frame, versions

if TYPE_CHECKING:
    from deepbots_robot.model import Input, Output


def open_player(opened: ShowingState, driver: str | None = None) -> Player:
    """Open a player of a shown source.

    Raises:
        ScenarioError, EngineError, UsageError: As for `Player`.
    """
    if opened.shown.worlds:
        return BatchPlayer(opened, driver)
    if opened.recording is None:
        return Player(opened, driver)
    if driver not in (None, *opened.drivers):
        raise UsageError(f"a recording already contains its actions; leave out --driver {driver}")
    return LogPlayer(opened) if isinstance(opened.recording, RobotLog) else ReplayPlayer(opened)


def closing_player(showing: Showing, driver: str | None) -> closing[Player]:
    """Open a player of a shown source without a page, to be used in a `with` statement.

    Raises:
        ScenarioError: The scenario has errors.
        UsageError: There is no such driver, or a person would have to act.
    """
    if driver == HAND:
        raise UsageError("you can drive in the browser only; use `deepbots play`")
    return closing(open_player(showing.open(), driver))


class ReplayPlayer(Player):
    """Plays a recording: frames come from the file, and the environment provides the world in which they are
    drawn."""

    _recorded: RecordedEpisode | LoggedEpisode

    def __init__(self, opened: ShowingState) -> None:
        """Make the environment.

        Raises:
            ScenarioError, EngineError, UsageError: As for `Player`.
        """
        assert isinstance(opened.recording, Recording)
        self.recording = opened.recording
        self._numbers = [episode.number for episode in self.recording.episodes]
        self._read = lru_cache(maxsize=2000)(self._frame_of)
        super().__init__(opened, RECORDED)

    def set_driver(self, name: str) -> None:
        """Do nothing, because a recording has its actions."""
        self.driver_name = name

    def begin(self, seed: int, episode: int) -> WorldFrame:
        """Return the first frame of an episode of the recording; `seed` is that of the recording."""
        self._recorded = self.recording.episode(self._numbers[0] if episode == 0 else episode)
        self.env.reset(seed=self._recorded.seed)  # colors and light are not part of frames
        return self.seek(0)

    def next_episode(self, episode: int) -> int:
        """Return the number of the next episode; after the last comes the first."""
        return self._numbers[(self._numbers.index(self._recorded.number) + 1) % len(self._numbers)]

    @property
    def length(self) -> int:
        """The number of frames of the episode."""
        return len(self._recorded.steps)

    def seek(self, index: int) -> WorldFrame:
        """Go to a frame of the episode, counted from 0."""
        self._index = min(max(0, index), self.length - 1)
        self.frame = self._read(self._recorded.number, self._index)
        return self.frame

    def step(self, *, by_hand: bool = False) -> WorldFrame:
        return self.seek(self._index + 1)

    def last_frames(self, count: int) -> list[WorldFrame]:
        """Return at most so many frames up to the present one."""
        return [
            self._read(self._recorded.number, index)
            for index in range(max(0, self._index + 1 - count), self._index + 1)
        ]

    def shortest_paths(self) -> list[list[tuple[float, float]]]:
        """Return nothing, because frames have no paths."""
        return []

    def view(self, width: int, height: int) -> View:
        engine = self.env.engine
        for robot in self.env.world.robots:
            engine.place(robot.name, *self.frame.links[robot.name, robot.model.root])
            for joint, position in zip(
                robot.model.moving_joints, self.frame.joints.get(robot.name, ()), strict=False
            ):
                engine.set_joint(robot.name, joint.name, position, 0.0)
        for body in self.env.world.objects:
            if not body.fixed and (body.name, body.name) in self.frame.links:
                engine.place(body.name, *self.frame.links[body.name, body.name])
        return super().view(width, height)

    def render(self, view: View) -> Any:
        self.view(view.width, view.height)
        return super().render(view)

    def _frame_of(self, number: int, index: int) -> WorldFrame:
        steps = self.recording.episode(number).steps
        with damaged(self.recording.path):
            frame = read_frame(steps[index], self.reader.layout)
        if index == len(steps) - 1 and frame.ended_by is None:
            frame = replace(frame, ended_by=END_OF_RECORDING, truncated=True)
        return frame


# What is verified

_EXACT_PARTS = {"/step": ("velocities", "observation", "images", "random"), "/world": ("forces",)}
"""Parts of topics that are compared to the bit or not at all."""
_DERIVED_PARTS = {"/step": ("hash",)}
"""Parts that follow from others, and that recordings no longer have."""


class Divergence(NamedTuple):
    """The first difference of a replay. `recorded` and `now` are texts, and empty if only hashes are
    known."""

    episode: int
    step: int
    quantity: str
    recorded: str
    now: str


def observation_hash_at(recording: Recording, recorded: RecordedEpisode, index: int) -> str:
    """Return the hash of the observation after so many steps."""
    with damaged(recording.path):
        return msgspec.convert(msgspec.json.decode(recorded.steps[index]["/step"])["observation"], str)


def verify(
    recording: Recording,
    player: Player,
    on_episode: Callable[[int], object] = lambda count: None,
    *,
    tolerance: float = 0.0,
) -> Divergence | None:
    """Run the episodes of a recording again, with its seeds and actions, and compare every step. None if all
    are the same.

    Args:
        on_episode: Called after each episode with the number of episodes that are done.
        tolerance: Numbers may differ by this, and by this share of them where they are larger than 1. 0
            compares to the bit. Otherwise hashes, and contact forces, which jump, are left out.

    Raises:
        RecordingError: A step cannot be read.
    """
    describer = TopicEncoder(player)
    time = 0
    for count, recorded in enumerate(recording.episodes, start=1):
        player.driver = sequence_driver(actions(recording, recorded, player.env.action_space))
        begun = time
        for index, old in enumerate(recorded.steps):
            if index and player.frame.ended_by is not None:
                return Divergence(recorded.number, index, "ending", "none", player.frame.ending)
            try:
                frame = player.step() if index else player.start(Start(recorded.seed))
            except RecordingError:
                raise
            except DeepbotsError as error:
                return Divergence(recorded.number, index, "error", "none", str(error))
            # The same times as `RecordingWriter.encoded`, because the encoded topics contain them.
            time = begun + round(frame.time * NS_PER_S)
            new = describer.encode(time, recorded.number, recorded.seed)
            with damaged(recording.path):
                difference = _first_difference(old, new, tolerance)
            if difference is not None:
                return Divergence(recorded.number, index, *difference)
        time += NS_PER_S
        on_episode(count)
    return None


def version_changes(recording: Recording) -> list[str]:
    """Return the versions that differ from those of the recording, a sentence each."""
    return [
        f"{name} was {old} when this was recorded, and is {new} now"
        for name, new in versions().items()
        if (old := recording.metadata.get(name, "not installed")) != new
    ]


def _first_difference(
    old: Mapping[str, bytes], new: Mapping[str, bytes], tolerance: float
) -> tuple[str, str, str] | None:
    """Return the first difference between the topics of a recorded step and those of now: its path, and both
    values; None if there is none."""
    for topic in sorted({**old, **new}, key=_topic_rank):
        # The points of scans follow from the rays.
        if topic.startswith(("/image/", "/scan/")) or new.get(topic) == old.get(topic):
            continue
        # Other programs write the same numbers in another way.
        before, after = (msgspec.json.decode(topics.get(topic, b"{}")) for topics in (old, new))
        left_out = (*_DERIVED_PARTS.get(topic, ()), *(_EXACT_PARTS.get(topic, ()) if tolerance else ()))
        before, after = (
            {key: value for key, value in side.items() if key not in left_out} for side in (before, after)
        )
        if difference := _difference(topic.removeprefix("/"), before, after, tolerance):
            return difference
    return None


def _topic_rank(topic: str) -> int:
    """Return the rank of a topic in a step: causes before effects, so that the first difference is the
    cause."""
    kind = "/to_robot" if topic.endswith("/to_robot") else topic.split("/")[1]
    return ("episode", "/to_robot", "world", "tf", "scan", "message", "agent", "step", "image").index(kind)


def _difference(where: str, recorded: Any, now: Any, tolerance: float) -> tuple[str, str, str] | None:
    """Return the first part of a topic that differs, by its path, with its values; None if all are the
    same."""
    if isinstance(recorded, dict) and isinstance(now, dict):
        parts = [
            (
                f"{where}.{key}" if "." in where or key != "transforms" else where,
                recorded.get(key, ""),
                now.get(key, ""),
            )
            for key in {**recorded, **now}
        ]
    elif isinstance(recorded, list) and isinstance(now, list) and len(recorded) == len(now):
        names = [
            after.get("child_frame_id", index) if isinstance(after, dict) else index
            for index, after in enumerate(now)
        ]
        parts = [
            (f"{where} {name}", before, after)
            for name, before, after in zip(names, recorded, now, strict=True)
        ]
    else:
        numbers = type(recorded) in (int, float) and type(now) in (int, float)
        alike = recorded == now or (
            tolerance and numbers and abs(recorded - now) <= tolerance * max(1.0, abs(recorded), abs(now))
        )
        return None if alike else (where, str(recorded)[:80], str(now)[:80])
    return next(filter(None, (_difference(*part, tolerance) for part in parts)), None)


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
            ended_by=END_OF_LOG if is_last else None,
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
