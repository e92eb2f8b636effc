"""Playing recordings, and running them again to compare."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec

from deepbots_cli.errors import DeepbotsError
from deepbots_cli.port import View
from deepbots_cli.rollout import Start
from deepbots_cli.rollout.drivers import RECORDED, sequence_driver
from deepbots_cli.rollout.recordings import RecordedEpisode, Recording, RecordingError, actions, damaged
from deepbots_cli.rollout.robot_logs import LoggedEpisode
from deepbots_cli.view.episodes import Player, ShowingState
from deepbots_cli.view.frames import WorldFrame
from deepbots_cli.view.recordings import NS_PER_S, TopicEncoder, read_frame, versions


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
            frame = replace(frame, ended_by="end of the recording", truncated=True)
        return frame


# What is verified

_EXACT_PARTS = {"/step": ("hash", "velocities", "observation", "images", "random"), "/world": ("forces",)}
"""Parts of topics that are compared to the bit or not at all."""


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
            compares to the bit. Otherwise hashes, images, contact forces, which jump, and the points of
            scans, which follow from the rays, are left out.

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
        if (old := recording.metadata.get(name)) != new
    ]


def _first_difference(
    old: Mapping[str, bytes], new: Mapping[str, bytes], tolerance: float
) -> tuple[str, str, str] | None:
    """Return the first difference between the topics of a recorded step and those of now: its path, and both
    values; None if there is none."""
    for topic in sorted({**old, **new}, key=_topic_rank):
        is_left_out = topic.startswith("/image/") or (tolerance and topic.startswith("/scan/"))
        if is_left_out or new.get(topic) == old.get(topic):
            continue
        # Other programs write the same numbers in another way.
        before, after = (msgspec.json.decode(topics.get(topic, b"{}")) for topics in (old, new))
        if tolerance:
            before, after = (
                {key: value for key, value in side.items() if key not in _EXACT_PARTS.get(topic, ())}
                for side in (before, after)
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
