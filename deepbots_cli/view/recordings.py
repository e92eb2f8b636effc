"""Recordings: episodes as MCAP files, which Foxglove opens too.

    metadata `deepbots`           format, versions, engine, seed, driver, case and stage
    attachments                   resolved.yaml and inputs/: the scenario, from which a recording is compiled when it is opened
    /episode                      its number and its seed
    /tf                           foxglove.FrameTransforms: the pose of every link
    /scan/ROBOT.SENSOR            foxglove.LaserScan, or foxglove.PointCloud where the rays are no fan
    /image/ROBOT.SENSOR           foxglove.CompressedImage
    /message/ROBOT/DIRECTION      the message that its receiver goes by
    /agent/NAME                   observation, action, reward, reward terms
    /world                        drawn values, joints, rays, readings, contacts, pushes, the ending
    /step                         the action in the action space, and hashes of the state

All messages are JSON. Numbers that are not finite are null. Episodes follow each other with a second between them.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import platform
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, cast

import msgspec
import numpy as np

import deepbots_cli
from deepbots_cli import frames
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.files import atomic_write, read_at_most
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.view.episodes import Player
from deepbots_cli.view.frames import AgentFrame, FrameLayout, Image, LinkName, PlottedField, ReceivedMessage, SensorRays, WorldFrame

FORMAT = 1
NS_PER_S = 1_000_000_000
"""In ns, in which MCAP counts time."""
_MAX_FILE, _MAX_RECORD, _MAX_CONTENT = 1 << 28, 1 << 26, 1 << 29  # bytes: of a file, of one record, and of all of them unpacked
_MAX_INPUTS, _MAX_SIDE = 1000, 1024
_MAX_NUMBER = 1e9  # of a position in m, and of the time in s: one more cannot be drawn
_RECORD_OVERHEAD_BYTES = 100
"""Bytes that a record takes in memory besides its content: a chunk of empty ones is a bomb too."""
Payloads = Mapping[str, bytes]


class RecordingError(UsageError):
    """A recording cannot be read: it is none, cut short, damaged, or of another version."""


# What is written


def _named(names: Iterable[str], values: Iterable[float | None]) -> dict[str, float | None]:
    return {name: None if value is None else float(value) for name, value in zip(names, values, strict=True)}


def _pose(pose: Frame) -> dict[str, Any]:
    return {"position": _named("xyz", pose[0]), "orientation": _named("xyzw", pose[1])}


def _stamp(time: int) -> dict[str, int]:
    return {"sec": time // NS_PER_S, "nsec": time % NS_PER_S}


def _packed(value: Any) -> dict[str, Any]:
    """An action, or a part of one, to the bit."""
    array = np.asarray(value)
    return {"dtype": str(array.dtype), "rows": array.shape[0] if array.ndim == 2 else 0, "data": array.tobytes()}


def unpacked(packed: Mapping[str, Any], space: Any) -> Any:
    dtype = np.dtype({"float32": "f4", "float64": "f8", "int64": "i8", "int32": "i4"}[packed["dtype"]])
    array = np.frombuffer(msgspec.convert(packed["data"], bytes), dtype)
    return array.reshape(space.shape).copy() if space.shape else array.item()


def _hash(*parts: bytes) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()[:32]


def observation_hash(observation: Any) -> str:
    """What `/step` keeps of an observation."""
    parts = observation.values() if isinstance(observation, dict) else [observation]
    return _hash(*(np.asarray(part).tobytes() for part in parts))


class TopicEncoder:
    """Describes the steps of a player as topics."""

    def __init__(self, player: Player) -> None:
        self._player = player
        env = player.env
        moving = {robot.name: [joint.name for joint in robot.model.moving_joints] for robot in env.world.robots}
        bodies = [*moving, *(thing.name for thing in env.world.objects)]
        self._velocities = [env.engine.velocity(body) for body in bodies]
        self._joints = [env.engine.joint_states(robot, joints) for robot, joints in moving.items() if joints]
        self._scans = {key: _fan(beams) for key, beams in player.reader.layout.sensor_rays.items()}

    def encode(self, time: int, number: int, seed: int) -> dict[str, bytes]:
        """The topics of the newest frame, encoded; `time` in ns."""
        player = self._player
        frame, layout, stamp = player.frame, player.reader.layout, _stamp(time)
        topics: dict[str, Any] = {} if frame.step else {"/episode": {"episode": number, "seed": seed}}
        topics["/tf"] = {
            "transforms": [
                {"timestamp": stamp, "parent_frame_id": "world", "child_frame_id": f"{body}/{link}",
                 "translation": _named("xyz", place), "rotation": _named("xyzw", turn)}
                for (body, link), (place, turn) in frame.links.items()
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
        }
        for key, beams in layout.sensor_rays.items():
            topics[f"/scan/{key}"] = _scan(beams, self._scans[key], frame.rays[key], stamp)
        for name, agent in frame.agents.items():
            topics[f"/agent/{name}"] = {
                "observation": _named(_names(layout.observation), agent.observation),
                "action": _named(_names(layout.action), agent.action or (None,) * len(layout.action)),
                "reward": agent.reward,
                "episode_return": agent.episode_return,
                "terms": dict(agent.terms),
                "allowed": {str(number): may for number, may in enumerate(agent.allowed)},
            }
        encoded = {topic: msgspec.json.encode(content) for topic, content in topics.items()}
        encoded["/step"] = msgspec.json.encode(self._step(encoded))
        for key, image in frame.cameras.items():
            encoded[f"/image/{key}"] = msgspec.json.encode(
                {"timestamp": stamp, "frame_id": key.replace(".", "/"), "format": "png", "data": _png(image)}
            )
        return encoded

    def _step(self, encoded: Payloads) -> dict[str, Any]:
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
        return {"step": player.frame.step, "action": action, **hidden, "hash": _hash(*encoded.values(), *map(str.encode, hidden.values()))}


def _names(fields: Iterable[PlottedField]) -> list[str]:
    return [field.name for field in fields]


def _joints(layout: FrameLayout, robot: str) -> list[str]:
    return [joint.name for joint in layout.robots[robot].moving_joints]


def _numbered(groups: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float | None]]:
    return {key: _named(map(str, range(len(values))), values) for key, values in groups.items()}


def _fan(beams: SensorRays) -> tuple[Frame, float] | None:
    """The frame of rays that lie in a plane at equal angles, the first along x, and the angle (rad) between two; None for others."""
    starts, ways = beams.starts, beams.directions
    if len(ways) < 3 or not np.allclose(starts, starts[0]):
        return None
    step, normal = float(np.arccos(np.clip(ways[0] @ ways[1], -1.0, 1.0))), np.cross(ways[0], ways[1])
    if step < 1e-6 or np.linalg.norm(normal) < 1e-9:
        return None
    normal = normal / np.linalg.norm(normal)
    angles = step * np.arange(len(ways))[:, None]
    if not np.allclose(ways, np.cos(angles) * ways[0] + np.sin(angles) * np.cross(normal, ways[0]), atol=1e-6):
        return None
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(np.stack([ways[0], np.cross(normal, ways[0]), normal], axis=1)).as_quat()
    return (tuple(starts[0]), tuple(turn)), step


def _scan(beams: SensorRays, fan: tuple[Frame, float] | None, free: Sequence[float], stamp: Any) -> dict[str, Any]:
    head = {"timestamp": stamp, "frame_id": "/".join(beams.part)}
    if fan is not None:
        pose, step = fan
        return {**head, "pose": _pose(pose), "start_angle": 0.0, "end_angle": step * (len(free) - 1), "ranges": list(free),
                "intensities": [0.0] * len(free)}  # fmt: skip
    points = (beams.starts + np.array(free)[:, None] * beams.directions).astype("<f4")
    fields = [{"name": axis, "offset": 4 * place, "type": 7} for place, axis in enumerate("xyz")]  # 7: FLOAT32
    return {**head, "pose": _pose(frames.IDENTITY_FRAME), "point_stride": 12, "fields": fields, "data": points.tobytes()}


def _png(image: Image) -> bytes:
    import PIL.Image

    stream = io.BytesIO()
    PIL.Image.fromarray(image[..., 0] if image.shape[2] == 1 else image).save(stream, "PNG")
    return stream.getvalue()


def _type_of(topic: str, content: Mapping[str, Any]) -> str:
    kind = topic.split("/")[1]
    types = {"tf": "FrameTransforms", "scan": "LaserScan" if "ranges" in content else "PointCloud", "image": "CompressedImage"}
    return f"foxglove.{types[kind]}" if kind in types else f"deepbots.{kind.capitalize()}"


def _schema_of(value: Any, key: str = "") -> dict[str, Any]:
    """The JSON Schema of what such a value is."""
    if isinstance(value, dict):
        return {"type": "object", "properties": {name: _schema_of(part, name) for name, part in value.items()}}
    if isinstance(value, list):
        return {"type": "array", "items": _schema_of(value[0]) if value else {"type": "number"}}
    if key == "data":
        return {"type": "string", "contentEncoding": "base64"}
    return {"type": {bool: "boolean", str: "string", int: "integer"}.get(type(value), "number")}


def record(
    player: Player,
    path: Path,
    seed: int,
    episodes: Sequence[int],
    on_episode: Callable[[int], object] = lambda number: None,
    *,
    steps: int | None = None,
) -> list[WorldFrame]:
    """Record episodes of a seed in a new file; the last frame of each.

    Args:
        path: Replaced whole, at the end.
        on_episode: Called after each episode with its number.
        steps: Where to cut an episode.

    Raises:
        MissingExtraError: mcap is not installed.
    """
    try:
        from mcap.writer import Writer
    except ModuleNotFoundError as error:
        raise MissingExtraError("view", "a recording") from error
    compiled = player.opened.checked()
    describer, time, channels, last = TopicEncoder(player), 0, dict[str, int](), list[WorldFrame]()
    with atomic_write(path) as draft, draft.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", f"deepbots {deepbots_cli.__version__}")
        writer.add_metadata("deepbots", _metadata(player, seed, compiled.digest))
        inputs = {f"inputs/{name}": data for name, data in compiled.inputs.items()}
        for name, content in {"resolved.yaml": compiled.resolved.encode(), **inputs}.items():
            writer.add_attachment(0, 0, name, "application/octet-stream", content)
        for number in episodes:
            begun = time
            for frame in player.episode(seed, number, steps):
                time = begun + round(frame.time * NS_PER_S)
                for topic, payload in describer.encode(time, number, player.seed).items():
                    if topic not in channels:
                        content = msgspec.json.decode(payload)
                        schema = writer.register_schema(_type_of(topic, content), "jsonschema", json.dumps(_schema_of(content)).encode())
                        channels[topic] = writer.register_channel(topic, "json", schema)
                    writer.add_message(channels[topic], time, payload, time)
            last.append(player.frame)
            on_episode(number)
            time += NS_PER_S
        writer.finish()  # type: ignore[no-untyped-call]
    return last


def _metadata(player: Player, seed: int, digest: str) -> dict[str, str]:
    shown = player.opened.shown
    return {
        "format": str(FORMAT),
        "scenario": player.program.name,
        "source": shown.reference,
        "digest": digest,
        "engine": player.env.engine.name,
        "seed": str(seed),
        "driver": player.driver_name,
        "case": shown.case or "",
        "stage": shown.stage or "",
        **versions(),
    }


def versions() -> dict[str, str]:
    """Of what an episode depends on."""
    known = {"deepbots": deepbots_cli.__version__, "platform": platform.platform(), "python": platform.python_version()}
    for name in ("gymnasium", "mujoco", "numpy", "pybullet"):
        with suppress(PackageNotFoundError):
            known[name] = version(name)
    return known


# What is read


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """One episode of a recording: its number, the seed of its reset, and the topics of each step, as bytes."""

    number: int
    seed: int
    steps: Sequence[Payloads]


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording as it was read; `folder` holds its scenario while it is open."""

    path: Path
    metadata: Mapping[str, str]
    episodes: Sequence[RecordedEpisode]
    folder: TemporaryDirectory[str]

    @staticmethod
    def read(path: Path) -> Recording:
        """Read a file, and unpack its scenario into a folder of its own.

        Raises:
            RecordingError: It cannot be read; says why in one sentence.
            MissingExtraError: mcap is not installed.
        """
        if path.exists() and not (path.is_file() or path.is_dir()):  # opening a pipe waits for ever
            raise RecordingError(f"{path} is not a regular file")
        try:
            data = read_at_most(path, _MAX_FILE + 1)
        except OSError as error:
            raise RecordingError(f"{path} cannot be read: {(error.strerror or 'unknown reason').lower()}") from error
        if len(data) > _MAX_FILE:
            raise RecordingError(f"{path} is larger than {_MAX_FILE >> 20} MiB, which is the largest recording that can be shown")
        if not data.startswith(b"\x89MCAP"):
            raise RecordingError(f"{path} is not a recording: it is not an MCAP file")
        metadata, files, steps = _content(path, data)
        if metadata is None:
            raise RecordingError(f"{path} is an MCAP file that deepbots did not record; open it in Foxglove")
        if metadata.get("format") != str(FORMAT):
            raise RecordingError(
                f"{path} is a recording of format {metadata.get('format', '?')[:20]}, but this version of deepbots reads {FORMAT}; "
                "use the version that recorded it"
            )
        if "resolved.yaml" not in files or not steps:
            raise RecordingError(f"{path} is damaged: it contains no {'episode' if files else 'scenario'}")
        folder = TemporaryDirectory(prefix="deepbots-recording-")
        for name, content in files.items():
            target = Path(folder.name, name)
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
            except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
                raise RecordingError(f"{path} is damaged: it contains a file and a folder of the same name") from error
        return Recording(path, metadata, list(_episodes(path, steps)), folder)

    def episode(self, number: int) -> RecordedEpisode:
        """The episode of this number.

        Raises:
            UsageError: There is none; says which there are.
        """
        found = next((episode for episode in self.episodes if episode.number == number), None)
        if found is None:
            numbers = [episode.number for episode in self.episodes]
            listed = str(numbers[0]) if len(numbers) == 1 else f"{min(numbers)} to {max(numbers)}"
            raise UsageError(f"{self.path} contains no episode {number}; it contains {listed}")
        return found


def _content(path: Path, data: bytes) -> tuple[Mapping[str, str] | None, dict[str, bytes], list[dict[str, bytes]]]:
    """Metadata, attached files, and the topics of each step."""
    try:
        from mcap import records
        from mcap.exceptions import McapError
        from mcap.stream_reader import StreamReader, breakup_chunk
        from zstandard import ZstdError, get_frame_parameters
    except ModuleNotFoundError as error:
        raise MissingExtraError("view", "a recording") from error
    metadata: Mapping[str, str] | None = None
    files: dict[str, bytes] = {}
    topics: dict[int, str] = {}
    messages: list[records.Message] = []
    size = 0
    try:
        for found in StreamReader(io.BytesIO(data), emit_chunks=True, record_size_limit=_MAX_RECORD).records:
            if isinstance(found, records.Metadata) and found.name == "deepbots":
                metadata = found.metadata
            elif isinstance(found, records.Attachment):
                size += len(found.data)
                files[_safe(found.name)] = found.data
            elif isinstance(found, records.Chunk):
                # The unpacked size is in the frame too, and decompression goes by that one.
                unpacked = get_frame_parameters(found.data).content_size if found.compression == "zstd" else len(found.data)
                size += unpacked
                if found.compression not in ("zstd", "") or unpacked != found.uncompressed_size or max(size, 8 * unpacked) > _MAX_CONTENT:
                    raise RecordingError(
                        f"{path} is damaged, larger than {_MAX_CONTENT >> 20} MiB when decompressed, or uses an unknown compression"
                    )
                inner = breakup_chunk(found, validate_crc=True)
                size += _RECORD_OVERHEAD_BYTES * len(inner)
                topics |= {each.id: each.topic for each in inner if isinstance(each, records.Channel)}
                messages += [each for each in inner if isinstance(each, records.Message)]
            if size > _MAX_CONTENT or len(files) > _MAX_INPUTS:
                raise RecordingError(f"{path} contains more than {_MAX_CONTENT >> 20} MiB, or more than {_MAX_INPUTS} files")
        steps = [{topics[each.channel_id]: each.data for each in step} for _, step in groupby(messages, lambda each: each.log_time)]
    except (McapError, ZstdError, struct.error, ValueError, KeyError, IndexError, MemoryError) as error:
        raise RecordingError(f"{path} is cut short or damaged; record the episode again") from error
    return metadata, files, steps


def _safe(name: str) -> str:
    """The name of an attached file.

    Raises:
        ValueError: It leads elsewhere.
    """
    parts = PurePosixPath(name).parts
    if name != "resolved.yaml" and (parts[:1] != ("inputs",) or ".." in parts or "\\" in name or "\0" in name or len(name) > 500):
        raise ValueError(name)
    if any(len(part.encode()) > 255 for part in parts):  # which most file systems refuse
        raise ValueError(name)
    return name


def _episodes(path: Path, steps: Sequence[Payloads]) -> Iterator[RecordedEpisode]:
    begun = [place for place, step in enumerate(steps) if "/episode" in step]
    if begun[:1] != [0]:
        raise RecordingError(f"{path} is damaged: it does not begin with an episode")
    for first, end in zip(begun, [*begun[1:], len(steps)], strict=True):
        with damaged(path):
            known = msgspec.json.decode(steps[first]["/episode"])
            seed = msgspec.convert(known["seed"], int)
            if seed < 0:
                raise ValueError(seed)
            yield RecordedEpisode(msgspec.convert(known["episode"], int), seed, steps[first:end])


@contextmanager
def damaged(path: Path) -> Iterator[None]:
    """Within, content that is not as it should be is told in a sentence."""
    try:
        yield
    except (msgspec.MsgspecError, LookupError, TypeError, ValueError, AttributeError, OSError, OverflowError, RecursionError) as error:
        raise RecordingError(f"{path} is damaged: a step of it cannot be read") from error


def _floats(values: Mapping[str, Any], names: Sequence[str] | None = None) -> tuple[float, ...]:
    """The numbers of an object, which must have these names."""
    if names is not None and list(values) != list(names):
        raise ValueError(list(values))
    return tuple(math.nan if value is None else float(value) for value in values.values())


def read_frame(topics: Payloads, layout: FrameLayout) -> WorldFrame:
    """A step as a frame.

    Raises:
        msgspec.MsgspecError, LookupError, TypeError, ValueError, AttributeError, OSError, OverflowError, RecursionError: It is not as
            `TopicEncoder` describes one.
    """
    decode = msgspec.json.decode
    world, links, messages, agents, cameras = decode(topics["/world"]), dict[LinkName, Frame](), {}, {}, {}
    for each in decode(topics["/tf"])["transforms"]:
        links[_link(each["child_frame_id"])] = cast("Frame", (_floats(each["translation"], "xyz"), _floats(each["rotation"], "xyzw")))
    for name, model in layout.robots.items():
        for link in model.links:
            place, turn = links[name, link.name]
            if not (all(abs(x) <= _MAX_NUMBER for x in place) and math.isclose(math.hypot(*turn), 1.0, rel_tol=1e-3)):
                raise ValueError(link.name)
    for key, fields in layout.messages.items():
        found = decode(topics[f"/message/{key}"])
        values = tuple(None if value is None else float(value) for value in found["values"].values())
        if len(values) != len(fields):
            raise ValueError(key)
        messages[key] = ReceivedMessage(values, float(found["age"]), bool(found["received"]))
    for topic, payload in topics.items():
        if topic.startswith("/agent/"):
            found = decode(payload)
            action = _floats(found["action"], _names(layout.action))
            agents[topic.removeprefix("/agent/")] = AgentFrame(
                _floats(found["observation"], _names(layout.observation)),
                None if any(map(math.isnan, action)) else action,
                float(found["reward"]),
                float(found["episode_return"]),
                dict(zip(layout.terms, _floats(found["terms"], layout.terms), strict=True)),
                tuple(map(bool, found["allowed"].values())),
            )
        elif topic.startswith("/image/"):
            cameras[topic.removeprefix("/image/")] = _picture(decode(payload)["data"])
    if not agents:
        raise LookupError("agent")
    if not 0 <= float(world["time"]) <= _MAX_NUMBER:
        raise ValueError(world["time"])
    rays = {key: _floats(world["rays"][key], [str(n) for n in range(len(beams.starts))]) for key, beams in layout.sensor_rays.items()}
    return WorldFrame(
        step=msgspec.convert(world["step"], int),
        time=float(world["time"]),
        links=links,
        joints={name: _floats(world["joints"][name], _joints(layout, name)) for name in layout.robots if _joints(layout, name)},
        rays=rays,
        readings={key: _floats(values) for key, values in world["readings"].items()},
        forces={_link(key): float(force) for key, force in world["forces"].items() if _link(key) in links},
        pushes=tuple((_link(key), cast("Triple", _floats(force, "xyz"))) for key, force in world["pushes"].items()),
        variants=msgspec.convert(world["variants"], dict[str, str]),
        messages=messages,
        cameras=cameras,
        drawn=msgspec.convert(world["drawn"], dict[str, float | str]),
        agents=agents,
        ended_by=msgspec.convert(world["ended_by"], str) or None,
        is_success=bool(world["is_success"]),
        truncated=bool(world["truncated"]),
    )


def _link(key: str) -> LinkName:
    body, _, link = key.partition("/")
    return body, link


def _picture(data: str) -> Image:
    import PIL.Image

    with PIL.Image.open(io.BytesIO(msgspec.convert(data, bytes)), formats=("PNG",)) as image:
        if max(image.size) > _MAX_SIDE or image.mode not in ("L", "RGB"):
            raise ValueError(image.size)
        array = np.asarray(image)
    return array if array.ndim == 3 else array[..., None]
