"""The episodes in files: in recordings (MCAP), which `view.recordings` writes, with the scenario that they
ran in; and in the log of a robot, which `deepbots serve --log` writes, with the bundle and the scenario of
the policy that acted.
"""

from __future__ import annotations

import io
import shutil
import struct
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import groupby, islice
from pathlib import Path, PurePosixPath
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from gymnasium import spaces

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.files import read_at_most
from deepbots_cli.records import dataclass
from deepbots_cli.words import counted, shell_word

if TYPE_CHECKING:
    from deepbots_robot.model import BundleInfo

FORMAT = 1
# The largest sizes of a file, of one record, and of all records unpacked, in bytes.
_MAX_FILE = 1 << 28
_MAX_RECORD = 1 << 26
_MAX_CONTENT = 1 << 29
_MAX_INPUTS = 1000
_MAX_LISTED = 12
_RECORD_OVERHEAD_BYTES = 100
"""The number of bytes that a record takes in memory besides its content, because even a chunk of empty
records can exhaust the memory."""
Payloads = Mapping[str, bytes]


class RecordingError(UsageError):
    """The error for a recording that cannot be read: it is not a recording, cut short, damaged, or of another
    version."""


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """An episode of a recording: its number, the seed of its reset, and the topics of each step, as bytes."""

    number: int
    seed: int
    steps: Sequence[Payloads]


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording that was read; `folder` has its scenario, as long as the recording is in use."""

    path: Path
    metadata: Mapping[str, str]
    episodes: Sequence[RecordedEpisode]
    folder: Path

    @staticmethod
    def read(path: Path) -> Recording:
        """Read a file, and unpack its scenario into a new folder.

        Raises:
            RecordingError: The file cannot be read; the message has the reason.
            MissingExtraError: mcap is not installed.
        """
        if path.exists() and not (path.is_file() or path.is_dir()):  # opening a pipe waits for ever
            raise RecordingError(f"{path} is not a regular file")
        try:
            # One byte more than allowed, so that a larger file is noticed and not cut.
            data = read_at_most(path, _MAX_FILE + 1)
        except OSError as error:
            raise RecordingError(
                f"{path} cannot be read: {(error.strerror or 'unknown reason').lower()}"
            ) from error
        if len(data) > _MAX_FILE:
            raise RecordingError(
                f"{path} is larger than {_MAX_FILE >> 20} MiB, which is the largest recording that can be"
                " shown"
            )
        if not data.startswith(b"\x89MCAP"):
            raise RecordingError(f"{path} is not a recording: it is not an MCAP file")
        metadata, files, steps = _content(path, data)
        if metadata is None:
            raise RecordingError(
                f"{path} is an MCAP file, but neither a recording of a simulation nor the log of a robot;"
                " use Foxglove"
            )
        if metadata.get("format") != str(FORMAT):
            raise RecordingError(
                f"{path} is a recording of format {metadata.get('format', '?')[:20]}, but this version of"
                f" deepbots reads {FORMAT}; "
                "use the version that recorded it"
            )
        if "resolved.yaml" not in files or not steps:
            missing = "episode" if "resolved.yaml" in files else "scenario"
            raise RecordingError(f"{path} is damaged: it contains no {missing}")
        recording = Recording(path, metadata, list(_episodes(path, steps)), scenario_folder(path, files))
        # finalize also runs when the interpreter exits, at which `__del__` may not be called.
        weakref.finalize(recording, shutil.rmtree, recording.folder, ignore_errors=True)
        return recording

    def episode(self, number: int) -> RecordedEpisode:
        """Return the episode of this number.

        Raises:
            UsageError: There is none; the message lists the episodes.
        """
        numbered = next((episode for episode in self.episodes if episode.number == number), None)
        if numbered is None:
            numbers = [episode.number for episode in self.episodes]
            listed = ", ".join(map(str, numbers[:_MAX_LISTED]))
            more = f" and {len(numbers) - _MAX_LISTED} more" if len(numbers) > _MAX_LISTED else ""
            raise UsageError(f"{self.path} contains no episode {number}; it contains {listed}{more}")
        return numbered


def _content(
    path: Path, data: bytes
) -> tuple[Mapping[str, str] | None, dict[str, bytes], list[dict[str, bytes]]]:
    """Return metadata, attached files, and the topics of each step."""
    try:
        from mcap import records
        from mcap.exceptions import McapError
        from mcap.stream_reader import StreamReader, breakup_chunk
        from zstandard import ZstdError, get_frame_parameters
    except ModuleNotFoundError as error:
        raise MissingExtraError("sim", "a recording") from error
    metadata: Mapping[str, str] | None = None
    files: dict[str, bytes] = {}
    topics: dict[int, str] = {}
    messages: list[records.Message] = []
    size = 0
    try:
        for record in StreamReader(io.BytesIO(data), emit_chunks=True, record_size_limit=_MAX_RECORD).records:
            if isinstance(record, records.Metadata) and record.name == "deepbots":
                metadata = record.metadata
            elif isinstance(record, records.Attachment):
                size += len(record.data)
                files[safe_name(record.name)] = record.data
            elif isinstance(record, records.Chunk):
                # The unpacked size is in the frame too, and decompression goes by that one.
                unpacked = (
                    get_frame_parameters(record.data).content_size
                    if record.compression == "zstd"
                    else len(record.data)
                )
                size += unpacked
                if (
                    record.compression not in ("zstd", "")
                    or unpacked != record.uncompressed_size
                    or unpacked > _MAX_RECORD  # empty channels take 7.4 times their size as objects
                    or size > _MAX_CONTENT
                ):
                    raise RecordingError(
                        f"{path} is damaged, larger than {_MAX_CONTENT >> 20} MiB when decompressed, has a"
                        f" chunk of more than {_MAX_RECORD >> 20} MiB, or uses an unknown compression"
                    )
                inner = breakup_chunk(record, validate_crc=True)
                size += _RECORD_OVERHEAD_BYTES * len(inner)
                topics |= {entry.id: entry.topic for entry in inner if isinstance(entry, records.Channel)}
                messages += [entry for entry in inner if isinstance(entry, records.Message)]
            if size > _MAX_CONTENT or len(files) > _MAX_INPUTS:
                raise RecordingError(
                    f"{path} contains more than {_MAX_CONTENT >> 20} MiB, or more than {_MAX_INPUTS} files"
                )
        steps = [
            {topics[message.channel_id]: message.data for message in step}
            for _, step in groupby(messages, lambda message: message.log_time)
        ]
    except (McapError, ZstdError, struct.error, ValueError, KeyError, IndexError, MemoryError) as error:
        raise RecordingError(f"{path} is cut short or damaged; record the episode again") from error
    return metadata, files, steps


def scenario_folder(path: Path, files: Mapping[str, bytes]) -> Path:
    """Return a new folder with the scenario that is attached to the file `path`.

    Raises:
        RecordingError: A file and a folder have the same name.
    """
    folder = Path(mkdtemp(prefix="deepbots-recording-"))
    for name, content in files.items():
        target = folder / name
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise RecordingError(
                f"{path} is damaged: it contains a file and a folder of the same name"
            ) from error
    return folder


def safe_name(name: str) -> str:
    """Return the name of an attached file.

    Raises:
        ValueError: The name leads outside of the folder.
    """
    parts = PurePosixPath(name).parts
    if name != "resolved.yaml" and (
        parts[:1] != ("inputs",) or ".." in parts or "\\" in name or "\0" in name or len(name) > 500
    ):
        raise ValueError(name)
    if any(len(part.encode()) > 255 for part in parts):  # most file systems refuse longer names
        raise ValueError(name)
    return name


def _episodes(path: Path, steps: Sequence[Payloads]) -> Iterator[RecordedEpisode]:
    begun = [index for index, step in enumerate(steps) if "/episode" in step]
    if begun[:1] != [0]:
        raise RecordingError(f"{path} is damaged: it does not begin with an episode")
    for first, end in zip(begun, [*begun[1:], len(steps)], strict=True):
        with damaged(path):
            described = msgspec.json.decode(steps[first]["/episode"])
            seed = msgspec.convert(described["seed"], int)
            if seed < 0:
                raise ValueError(seed)
            yield RecordedEpisode(msgspec.convert(described["episode"], int), seed, steps[first:end])


@contextmanager
def damaged(path: Path) -> Iterator[None]:
    """Context in which damaged content of a recording raises a RecordingError."""
    try:
        yield
    except (
        msgspec.MsgspecError,
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        OSError,
        OverflowError,
        RecursionError,
    ) as error:
        raise RecordingError(f"{path} is damaged: a step of it cannot be read") from error


def actions(recording: Recording, recorded: RecordedEpisode, space: Any) -> Iterator[Any]:
    """Yield the actions of an episode, in the action space.

    Raises:
        RecordingError: An action cannot be read.
    """
    # The first step is the reset, which has no action.
    for step in recorded.steps[1:]:
        with damaged(recording.path):
            action = msgspec.json.decode(step["/step"])["action"]
            if isinstance(space, spaces.Dict):
                values: Any = {name: unpacked(action[name], part) for name, part in space.spaces.items()}
            else:
                values = unpacked(action["action"], space)
        yield values


def unpacked(packed: Mapping[str, Any], space: Any) -> Any:
    dtype = np.dtype({"float32": "f4", "float64": "f8", "int64": "i8", "int32": "i4"}[packed["dtype"]])
    array = np.frombuffer(msgspec.convert(packed["data"], bytes), dtype)
    # A copy, because an array over bytes cannot be written to.
    return array.reshape(space.shape).copy() if space.shape else array.item()


MAX_LOGGED_STEPS = 500_000

EVENT_PREFIXES = {
    "safe": "safe posture: ",
    "resumed": "the policy acts again: ",
    "refused": "a message was refused: ",
}


class LoggedStep(msgspec.Struct, frozen=True):
    """A command, and the inputs of the policy for it.

    Attributes:
        time: The time since the episode began, in s.
        inputs: The values by input, in C order; empty in the safe posture, in which the policy does not act.
        ages: The age of each value in s.
        commands: The commands by output.
        answer: The time in s from the newest value to the command; 0 for a command that answers no new value.
        posture: `policy` or `safe`.
        events: The events since the step before, a sentence each.
    """

    time: float
    inputs: dict[str, list[float]]
    ages: dict[str, float]
    commands: dict[str, list[float]]
    answer: float
    posture: str
    events: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class LoggedEpisode:
    """An episode of a log. Its start is unknown, so a simulation begins it with `seed`."""

    number: int
    steps: Sequence[LoggedStep]
    seed: int = 0


@dataclass(frozen=True, eq=False)
class RobotLog:
    """A log that was read; `folder` has the scenario, as long as the log is in use. `notes` say which steps
    were left out."""

    path: Path
    metadata: Mapping[str, str]
    info: BundleInfo
    episodes: Sequence[LoggedEpisode]
    folder: Path
    notes: tuple[str, ...] = ()

    @staticmethod
    def read(path: Path) -> RobotLog:
        """Read a log, even one of a process that was killed, and unpack its scenario into a new folder.

        Raises:
            RecordingError: It cannot be read, has no step, or no scenario; the message has the reason.
            MissingExtraError: deepbots-robot or mcap is not installed.
        """
        try:
            from deepbots_robot.log import read_attached, read_log
            from deepbots_robot.model import BundleError, decode
        except ModuleNotFoundError as error:
            raise MissingExtraError("robot", "the log of a robot") from error
        try:
            files = read_attached(path)
            description = files.pop("bundle.json", None)
            if description is None or "resolved.yaml" not in files:
                raise RecordingError(
                    f"{path} is the log of a robot without the scenario, which the page draws; serve a whole"
                    f" bundle of this version of deepbots, or read the log with: deepbots diagnose"
                    f" {shell_word(path)}"
                )
            info = decode(description)
            files = {safe_name(name): content for name, content in files.items()}
            notes: list[str] = []
            episodes = list(_logged_episodes(read_log(path, notes.append), notes.append))
            if not episodes:
                raise RecordingError(f"{path} contains no step: the robot sent no complete set of values")
            # The folder is made last, so that a log that cannot be read leaves none behind.
            folder = scenario_folder(path, files)
        except (OSError, ValueError, TypeError, msgspec.MsgspecError, BundleError) as error:
            if isinstance(error, UsageError):
                raise
            raise RecordingError(
                f"{path} cannot be read as the log of a robot: {' '.join(str(error).split())[:120]}"
            ) from error
        metadata = {"scenario": info.scenario.name, "digest": info.scenario.digest}
        log = RobotLog(path, metadata, info, episodes, folder, tuple(notes))
        weakref.finalize(log, shutil.rmtree, folder, ignore_errors=True)
        return log

    def episode(self, number: int) -> LoggedEpisode:
        """Return the episode of this number.

        Raises:
            UsageError: There is none; the message lists the episodes.
        """
        numbered = next((episode for episode in self.episodes if episode.number == number), None)
        if numbered is None:
            raise UsageError(
                f"{self.path} contains no episode {number}; list them with: deepbots replay"
                f" {shell_word(self.path)}"
            )
        return numbered


def consecutive(recording: Recording | RobotLog, first: int | None, count: int) -> Sequence[int]:
    """Return the numbers of `count` episodes, from `first` or else the first one of the recording on.

    Raises:
        UsageError: The recording does not contain so many episodes.
    """
    numbers = [episode.number for episode in recording.episodes]
    remaining = numbers if first is None else numbers[numbers.index(recording.episode(first).number) :]
    if count > len(remaining):
        start = "" if first is None else f" from episode {first} on"
        raise UsageError(
            f"{recording.path} contains {counted(len(remaining), 'episode')}{start}; write --episodes"
            f" {len(remaining)} or less"
        )
    return remaining[:count]


def is_robot_log(path: Path) -> bool:
    """Return whether a file is the log of `deepbots serve`, and no recording of a simulation."""
    try:
        from mcap import records
        from mcap.stream_reader import StreamReader
    except ModuleNotFoundError:
        return False
    if not path.is_file():  # opening a pipe waits for ever
        return False
    try:
        with path.open("rb") as file:
            # The log of a robot has its metadata first, so neither later records nor large ones are read.
            first = islice(StreamReader(file, record_size_limit=1 << 20).records, 8)
            return any(
                isinstance(record, records.Metadata) and record.name == "deepbots_robot" for record in first
            )
    except Exception:  # noqa: BLE001  mcap raises errors of many kinds for a file that is not an MCAP file
        return False


def _logged_episodes(
    messages: Iterator[tuple[str, float, dict[str, Any]]], note: Callable[[str], object]
) -> Iterator[LoggedEpisode]:
    """Yield the episodes with a step; their numbers are their places in the log, since a robot that restarts
    counts from the start. Calls `note` if there are more than `MAX_LOGGED_STEPS` steps, of which the others
    are left out."""
    episodes: list[list[dict[str, Any]]] = []
    begun = 0.0
    events: list[str] = []
    count = 0
    for topic, stamp, content in messages:
        kind, text = (str(content.get(key, "")) for key in ("kind", "text"))
        if topic == "/event" and kind == "episode" and text.isdecimal():
            if episodes and episodes[-1]:
                episodes[-1][-1]["events"] += events
                events = []
            episodes.append([])
            begun = stamp
        elif topic == "/event":
            events.append(f"{EVENT_PREFIXES.get(kind, '')}{text}"[:200])
        elif topic == "/step":
            if not episodes:
                episodes.append([])
                begun = stamp
            count += 1
            if count > MAX_LOGGED_STEPS:
                note(f"the log is longer than {MAX_LOGGED_STEPS:,} steps; later steps are left out")
                break
            episodes[-1].append({"ages": {}, **content, "time": max(0.0, stamp - begun), "events": events})
            events = []
    if episodes and episodes[-1]:
        episodes[-1][-1]["events"] += events
    for number, steps in enumerate(episodes):
        if steps:
            yield LoggedEpisode(number, [msgspec.convert(step, LoggedStep) for step in steps])
