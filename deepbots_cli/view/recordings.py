"""Recordings: episodes as MCAP files, which Foxglove opens too.

    metadata `deepbots`           format, versions, engine, seed, driver, case and stage
    attachments                   resolved.yaml and inputs/: the scenario, from which a recording is compiled
        when it is opened
    /episode                      its number and its seed
    /tf                           foxglove.FrameTransforms: the pose of every link
    /scan/ROBOT.SENSOR            foxglove.PointCloud: where rays end
    /image/ROBOT.SENSOR           foxglove.CompressedImage
    /message/ROBOT/DIRECTION the message that its receiver uses
    /agent/NAME                   observation, action, reward, reward terms
    /world                        drawn values, joints, rays, readings, contacts, pushes, the ending
    /step                         the action in the action space, and hashes of the state

All messages are JSON. Numbers that are not finite are null. Episodes follow each other with a second between
them.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import platform
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any, BinaryIO, cast

import msgspec
import numpy as np

import deepbots_cli
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.files import atomic_write
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.learning.runs.run import versions as installed_versions
from deepbots_cli.rollout.drivers import HAND
from deepbots_cli.rollout.recordings import FORMAT, Payloads
from deepbots_cli.view.episodes import Player
from deepbots_cli.view.frames import (
    AgentFrame,
    FrameLayout,
    Image,
    LinkName,
    PlottedField,
    ReceivedMessage,
    WorldFrame,
)
from deepbots_cli.words import counted

NS_PER_S = 1_000_000_000
"""Nanoseconds per second, because MCAP counts time in ns."""
MAX_DRIVEN_BYTES = 1 << 28
"""The largest size of all steps of `DrivenEpisodes` before compression, so that the recording stays below the
limits for reading. It is half an hour of CartPole, or two hours of FindBall."""
_MESSAGE_OVERHEAD_BYTES = 100  # bytes in memory, as for a recording that is read
_MAX_SIDE = 1024
_MAX_NUMBER = 1e9  # of positions in m and times in s that are drawn
_decode = msgspec.json.decode
_POINT_FIELDS = [{"name": axis, "offset": 4 * index, "type": 7} for index, axis in enumerate("xyz")]
"""The fields of a point of foxglove.PointCloud; the type 7 is FLOAT32."""
RecordedStep = tuple[int, Payloads]
"""The time of a step in ns, and its topics."""


# What is written


def _named(names: Iterable[str], values: Iterable[float | None]) -> dict[str, float | None]:
    return {name: None if value is None else float(value) for name, value in zip(names, values, strict=True)}


def _stamp(time: int) -> dict[str, int]:
    return {"sec": time // NS_PER_S, "nsec": time % NS_PER_S}


def _packed(value: Any) -> dict[str, Any]:
    """Return an action, or a part of one, to the bit."""
    array = np.asarray(value)
    return {
        "dtype": str(array.dtype),
        "rows": array.shape[0] if array.ndim == 2 else 0,
        "data": array.tobytes(),
    }


def _hash(*parts: bytes) -> str:
    digest = hashlib.sha256()
    for part in parts:
        # With lengths: parts that are split elsewhere must have another hash.
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()[:32]


def observation_hash(observation: Any) -> str:
    """Return the hash of an observation in `/step`."""
    parts = observation.values() if isinstance(observation, dict) else [observation]
    return _hash(*(np.asarray(part).tobytes() for part in parts))


class TopicEncoder:
    """Describes the steps of a player as topics."""

    def __init__(self, player: Player) -> None:
        self._player = player
        env = player.env
        moving = {
            robot.name: [joint.name for joint in robot.model.moving_joints] for robot in env.world.robots
        }
        bodies = [*moving, *(body.name for body in env.world.objects)]
        self._velocities = [env.engine.velocity(body) for body in bodies]
        self._joints = [env.engine.joint_states(robot, joints) for robot, joints in moving.items() if joints]

    def encode(self, time: int, number: int, seed: int) -> dict[str, bytes]:
        """Return the topics of the newest frame, encoded; `time` in ns."""
        player = self._player
        frame = player.frame
        layout = player.reader.layout
        stamp = _stamp(time)
        topics: dict[str, Any] = {} if frame.step else {"/episode": {"episode": number, "seed": seed}}
        topics["/tf"] = {
            "transforms": [
                {"timestamp": stamp, "parent_frame_id": "world", "child_frame_id": f"{body}/{link}",
                 "translation": _named("xyz", position), "rotation": _named("xyzw", turn)}
                for (body, link), (position, turn) in frame.links.items()
            ]
        }  # fmt: skip
        for key, message in frame.messages.items():
            values = _named(_names(layout.messages[key]), message.values)
            topics[f"/message/{key}"] = {"age": message.age, "received": message.received, "values": values}
        topics["/world"] = {
            "step": frame.step,
            "time": frame.time,
            "drawn": dict(frame.drawn),
            "joints": {name: _named(_joints(layout, name), values) for name, values in frame.joints.items()},
            "rays": _numbered(frame.rays),
            "readings": _numbered(frame.readings),
            "forces": {f"{body}/{link}": force for (body, link), force in frame.forces.items()},
            "pushes": {f"{body}/{link}": _named("xyz", force) for (body, link), force in frame.pushes},
            "variants": dict(frame.variants),
            "ended_by": frame.ended_by or "",
            "is_success": frame.is_success,
            "truncated": frame.truncated,
            **({"succeeded": list(frame.succeeded)} if frame.succeeded else {}),
        }
        for key, beams in layout.sensor_rays.items():
            ends = beams.lines(frame, key)[:, 1, :3].astype("<f4")
            topics[f"/scan/{key}"] = {
                "timestamp": stamp,
                "frame_id": "world",
                "pose": {"position": _named("xyz", (0, 0, 0)), "orientation": _named("xyzw", (0, 0, 0, 1))},
                "point_stride": 12,
                "fields": _POINT_FIELDS,
                "data": ends.tobytes(),
            }
        for name, agent in frame.agents.items():
            topics[f"/agent/{name}"] = {
                "observation": _named(_names(layout.observation), agent.observation),
                "action": _named(_names(layout.action), agent.action or (None,) * len(layout.action)),
                "reward": agent.reward,
                "episode_return": agent.episode_return,
                "terms": dict(agent.terms),
                "allowed": {str(number): may for number, may in enumerate(agent.allowed)},
            }
        # NaN becomes null, which `_floats` reads back; bytes become base64.
        encoded = {topic: msgspec.json.encode(content) for topic, content in topics.items()}
        encoded["/step"] = msgspec.json.encode(self._step())
        for key, image in frame.cameras.items():
            encoded[f"/image/{key}"] = msgspec.json.encode(
                {"timestamp": stamp, "frame_id": key.replace(".", "/"), "format": "png", "data": _png(image)}
            )
        return encoded

    def _step(self) -> dict[str, Any]:
        player = self._player
        parts = player.action if isinstance(player.action, dict) else {"action": player.action}
        velocities = [float(x) for read in self._velocities for triple in read() for x in triple]
        velocities += [float(state[1]) for read in self._joints for state in read()]
        hidden = {
            "velocities": _hash(struct.pack(f"{len(velocities)}d", *velocities)),
            "observation": observation_hash(player.observation),
            "images": _hash(*(image.tobytes() for image in player.frame.cameras.values())),
            "random": _hash(json.dumps(player.env.random_state(), sort_keys=True).encode()),
        }
        action = {} if player.action is None else {name: _packed(value) for name, value in parts.items()}
        return {
            "step": player.frame.step,
            "action": action,
            **hidden,
        }


def _names(fields: Iterable[PlottedField]) -> list[str]:
    return [field.name for field in fields]


def _joints(layout: FrameLayout, robot: str) -> list[str]:
    return [joint.name for joint in layout.robots[robot].moving_joints]


def _numbered(groups: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float | None]]:
    return {key: _named(map(str, range(len(values))), values) for key, values in groups.items()}


def _png(image: Image) -> bytes:
    import PIL.Image

    stream = io.BytesIO()
    PIL.Image.fromarray(image[..., 0] if image.shape[2] == 1 else image).save(stream, "PNG")
    return stream.getvalue()


def _type_of(topic: str, content: Mapping[str, Any]) -> str:
    kind = topic.split("/")[1]
    types = {
        "tf": "FrameTransforms",
        "scan": "PointCloud",
        "image": "CompressedImage",
    }
    return f"foxglove.{types[kind]}" if kind in types else f"deepbots.{kind.capitalize()}"


def _schema_of(value: Any, key: str = "") -> dict[str, Any]:
    """Return the JSON Schema of a value."""
    if isinstance(value, dict):
        return {
            "type": "object",
            "properties": {name: _schema_of(part, name) for name, part in value.items()},
        }
    if isinstance(value, list):
        return {"type": "array", "items": _schema_of(value[0]) if value else {"type": "number"}}
    if key == "data":
        return {"type": "string", "contentEncoding": "base64"}
    return {"type": {bool: "boolean", str: "string", int: "integer"}.get(type(value), "number")}


class RecordingWriter:
    """Writes episodes of a player to a stream as MCAP, one after the other; `mcap.finish()` completes it."""

    def __init__(self, stream: BinaryIO, player: Player, seed: int) -> None:
        """Write the scenario.

        Raises:
            MissingExtraError: mcap is not installed.
        """
        try:
            from mcap.writer import Writer
        except ModuleNotFoundError as error:
            raise MissingExtraError("sim", "a recording") from error
        compiled = player.opened.checked()
        self._player = player
        self._encoder = TopicEncoder(player)
        self._begun = 0
        self._channels: dict[str, int] = {}
        self.mcap: Any = Writer(stream)
        self.mcap.start("", f"deepbots {deepbots_cli.__version__}")
        self.mcap.add_metadata("deepbots", _metadata(player, seed, compiled.digest))
        inputs = {f"inputs/{name}": data for name, data in compiled.inputs.items()}
        for name, content in {"resolved.yaml": compiled.resolved.encode(), **inputs}.items():
            self.mcap.add_attachment(0, 0, name, "application/octet-stream", content)

    def encoded(self, number: int) -> RecordedStep:
        """Return the newest frame of the player, as a step of the episode that is written next."""
        time = self._begun + round(self._player.frame.time * NS_PER_S)
        return time, self._encoder.encode(time, number, self._player.seed)

    def write(self, steps: Iterable[RecordedStep]) -> None:
        """Write an episode."""
        time = self._begun
        for time, topics in steps:
            for topic, payload in topics.items():
                if topic not in self._channels:
                    content = msgspec.json.decode(payload)
                    schema = json.dumps(_schema_of(content)).encode()
                    number = self.mcap.register_schema(_type_of(topic, content), "jsonschema", schema)
                    self._channels[topic] = self.mcap.register_channel(topic, "json", number)
                self.mcap.add_message(self._channels[topic], time, payload, time)
        self._begun = time + NS_PER_S  # episodes are 1 s apart, so that times ascend in the file


def record(
    player: Player,
    path: Path,
    seed: int,
    episodes: Sequence[int],
    on_episode: Callable[[int], object] = lambda number: None,
    *,
    steps: int | None = None,
) -> list[WorldFrame]:
    """Record episodes of a seed in a new file, and return the last frame of each.

    Args:
        path: Replaced whole, at the end.
        on_episode: Called after each episode with its number.
        steps: Where to cut an episode.

    Raises:
        MissingExtraError: mcap is not installed.
    """
    last = list[WorldFrame]()
    with atomic_write(path) as draft, draft.open("wb") as stream:
        writer = RecordingWriter(stream, player, seed)
        for number in episodes:
            writer.write(writer.encoded(number) for _ in player.episode(seed, number, steps))
            last.append(player.frame)
            on_episode(number)
        writer.mcap.finish()
    return last


class DrivenEpisodes:
    """The episodes that a person drives from the reset to the end, in a file that is complete after each of
    them.

    They are numbered from 0 in the order in which they ended, since a person may drive one start twice.
    `ends` has their last frames. The encoded episodes stay in memory, up to `MAX_DRIVEN_BYTES`.
    """

    def __init__(self, player: Player, path: Path, seed: int) -> None:
        """Check that episodes can be written. Nothing is written yet, because a recording has at least one
        episode.

        Raises:
            MissingExtraError: mcap is not installed.
        """
        self.player = player
        self.path = path
        self.ends: list[WorldFrame] = []
        self.is_full = False
        self._stream = io.BytesIO()
        self._writer = RecordingWriter(self._stream, player, seed)
        self._steps: list[RecordedStep] = []
        self._bytes = 0
        self._kept_bytes = 0
        self._has_unsaved = False

    def begin(self) -> None:
        """Leave out the episode under way, and begin another one with its first frame, if the person
        drives."""
        self._steps.clear()
        self._bytes = self._kept_bytes
        if self.player.driver_name == HAND and not self.is_full:
            self._add()

    def step(self) -> None:
        """Add the newest frame; with the last one of the episode, write the file.

        Raises:
            UsageError: It cannot be written. The episode is in the file after the next one, or after `save`.
        """
        if not self._steps:
            return
        self._add()
        if self.player.frame.ended_by is not None and self._steps:
            self._writer.write(self._steps)
            self._steps.clear()
            self.ends.append(self.player.frame)
            self._kept_bytes = self._bytes
            self._has_unsaved = True
            self.save()

    def _add(self) -> None:
        step = self._writer.encoded(len(self.ends))
        self._steps.append(step)
        self._bytes += sum(len(payload) + _MESSAGE_OVERHEAD_BYTES for payload in step[1].values())
        if self._bytes > MAX_DRIVEN_BYTES:
            self.is_full = True
            self._steps.clear()

    def save(self) -> None:
        """Write the episodes that are not in the file yet.

        Raises:
            UsageError: The file cannot be written.
        """
        if not self._has_unsaved:
            return
        # A copy is finished, because a finished MCAP file takes no more episodes.
        # Both in one call, so that the copied writer writes to the copied stream.
        mcap, stream = deepcopy((self._writer.mcap, self._stream))
        mcap.finish()
        with atomic_write(self.path) as draft:
            draft.write_bytes(stream.getbuffer())
        self._has_unsaved = False

    @property
    def note(self) -> str:
        """A note for the person who drives, in a line."""
        summary = f"{counted(len(self.ends), 'episode')} recorded in {self.path.name}"
        if self.is_full:
            return f"{summary}; it takes no more, since the next one goes beyond {MAX_DRIVEN_BYTES >> 20} MiB"
        return (
            summary
            if self.player.driver_name == HAND
            else f"{summary}; not this one, which {self.player.driver_name} drives"
        )


def _metadata(player: Player, seed: int, digest: str) -> dict[str, str]:
    showing = player.opened.shown
    return {
        "format": str(FORMAT),
        "scenario": player.program.name,
        "source": showing.reference,
        "digest": digest,
        "engine": player.env.engine.name,
        "seed": str(seed),
        "driver": player.driver_name,
        "case": showing.case or "",
        "stage": showing.stage or "",
        **versions(),
    }


def versions() -> dict[str, str]:
    """Return the versions of everything on which an episode depends."""
    installed = installed_versions()
    return {
        "deepbots": deepbots_cli.__version__,
        "platform": platform.platform(),
        **{name: installed[name] for name in ("python", "gymnasium", "mujoco", "numpy", "pybullet")},
    }


# What is read


def _floats(values: Mapping[str, Any], names: Sequence[str] | None = None) -> tuple[float, ...]:
    """Return the numbers of an object, which must have these names."""
    if names is not None and list(values) != list(names):
        raise ValueError(list(values))
    return tuple(math.nan if value is None else float(value) for value in values.values())


def read_frame(topics: Payloads, layout: FrameLayout) -> WorldFrame:
    """Read a step as a frame.

    Raises:
        msgspec.MsgspecError, LookupError, TypeError, ValueError, AttributeError, OSError, OverflowError,
        RecursionError: The step is not as `TopicEncoder` describes one.
    """
    world = _decode(topics["/world"])
    if not 0 <= float(world["time"]) <= _MAX_NUMBER:
        raise ValueError(world["time"])
    links = _link_frames(topics, layout)
    return WorldFrame(
        step=msgspec.convert(world["step"], int),
        time=float(world["time"]),
        links=links,
        joints={
            name: _floats(world["joints"][name], names)
            for name in layout.robots
            if (names := _joints(layout, name))
        },
        rays={
            key: _floats(world["rays"][key], [str(n) for n in range(len(beams.starts))])
            for key, beams in layout.sensor_rays.items()
        },
        readings={key: _floats(values) for key, values in world["readings"].items()},
        forces={_link(key): float(force) for key, force in world["forces"].items() if _link(key) in links},
        pushes=tuple(
            (_link(key), cast("Triple", _floats(force, "xyz"))) for key, force in world["pushes"].items()
        ),
        variants=msgspec.convert(world["variants"], dict[str, str]),
        messages={key: _message(topics, key, len(fields)) for key, fields in layout.messages.items()},
        cameras={
            topic.removeprefix("/image/"): _picture(_decode(payload)["data"])
            for topic, payload in topics.items()
            if topic.startswith("/image/")
        },
        drawn=msgspec.convert(world["drawn"], dict[str, float | str]),
        agents=_agents(topics, layout),
        ended_by=msgspec.convert(world["ended_by"], str) or None,
        is_success=bool(world["is_success"]),
        truncated=bool(world["truncated"]),
        succeeded=tuple(msgspec.convert(world.get("succeeded", []), list[str])),
    )


def _link_frames(topics: Payloads, layout: FrameLayout) -> dict[LinkName, Frame]:
    """Return the frames of all links, which must include those of the robots."""
    links = dict[LinkName, Frame]()
    for transform in _decode(topics["/tf"])["transforms"]:
        links[_link(transform["child_frame_id"])] = cast(
            "Frame", (_floats(transform["translation"], "xyz"), _floats(transform["rotation"], "xyzw"))
        )
    for name, model in layout.robots.items():
        for link in model.links:
            position, turn = links[name, link.name]
            is_unit = math.isclose(math.hypot(*turn), 1.0, rel_tol=1e-3)
            if not is_unit or any(map(math.isnan, position)):
                raise ValueError(link.name)
            # Of a simulation that has diverged, but is finite, the numbers can be shown.
            within = cast("Triple", tuple(max(-_MAX_NUMBER, min(x, _MAX_NUMBER)) for x in position))
            links[name, link.name] = (within, turn)
    return links


def _message(topics: Payloads, key: str, fields: int) -> ReceivedMessage:
    decoded = _decode(topics[f"/message/{key}"])
    values = tuple(None if value is None else float(value) for value in decoded["values"].values())
    if len(values) != fields:
        raise ValueError(key)
    return ReceivedMessage(values, float(decoded["age"]), bool(decoded["received"]))


def _agents(topics: Payloads, layout: FrameLayout) -> dict[str, AgentFrame]:
    agents = {}
    for topic, payload in topics.items():
        if topic.startswith("/agent/"):
            decoded = _decode(payload)
            action = _floats(decoded["action"], _names(layout.action))
            agents[topic.removeprefix("/agent/")] = AgentFrame(
                _floats(decoded["observation"], _names(layout.observation)),
                None if any(map(math.isnan, action)) else action,
                float(decoded["reward"]),
                float(decoded["episode_return"]),
                dict(zip(layout.terms, _floats(decoded["terms"], layout.terms), strict=True)),
                tuple(map(bool, decoded["allowed"].values())),
            )
    if not agents:
        raise LookupError("agent")
    return agents


def _link(key: str) -> LinkName:
    body, _, link = key.partition("/")
    return body, link


def _picture(data: str) -> Image:
    import PIL.Image

    # A recording may be a stranger's: one decoder only, and Pillow reads the size before it decodes pixels.
    with PIL.Image.open(io.BytesIO(msgspec.convert(data, bytes)), formats=("PNG",)) as image:
        if max(image.size) > _MAX_SIDE or image.mode not in ("L", "RGB"):
            raise ValueError(image.size)
        array = np.asarray(image)
    return array if array.ndim == 3 else array[..., None]
