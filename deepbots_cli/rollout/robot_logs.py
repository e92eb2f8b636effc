"""Reading the log of a robot, which `deepbots serve --log` writes, with the bundle and the scenario of the
policy that acted."""

from __future__ import annotations

import shutil
import weakref
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import msgspec

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.rollout.recordings import RecordingError, safe_name, scenario_folder

if TYPE_CHECKING:
    from deepbots_robot.model import BundleInfo

MAX_STEPS = 500_000

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
                    f" {quote(str(path))}"
                )
            info = decode(description)
            files = {safe_name(name): content for name, content in files.items()}
            notes: list[str] = []
            episodes = list(_episodes(read_log(path), notes.append))
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
                f"{self.path} contains no episode {number}; list them with: deepbots replay {self.path}"
            )
        return numbered


def is_robot_log(path: Path) -> bool:
    """Return whether a file is the log of `deepbots serve`, and no recording of a simulation."""
    try:
        from mcap import records
        from mcap.stream_reader import StreamReader
    except ModuleNotFoundError:
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


def _episodes(
    messages: Iterator[tuple[str, float, dict[str, Any]]], note: Callable[[str], object]
) -> Iterator[LoggedEpisode]:
    """Yield the episodes with a step. They have the numbers of the log, or their places if a number occurs
    twice. Calls `note` if there are more than `MAX_STEPS` steps, of which the others are left out."""
    episodes: list[tuple[int, list[LoggedStep]]] = []
    begun = 0.0
    events: list[str] = []
    count = 0
    for topic, stamp, content in messages:
        kind, text = (str(content.get(key, "")) for key in ("kind", "text"))
        if topic == "/event" and kind == "episode":
            episodes.append((int(text) if text.isdecimal() else 0, []))
            begun = stamp
            events = []
        elif topic == "/event":
            events.append(f"{EVENT_PREFIXES.get(kind, '')}{text}"[:200])
        elif topic == "/step":
            if not episodes:
                episodes.append((0, []))
                begun = stamp
            count += 1
            if count > MAX_STEPS:
                note(f"the log is longer than {MAX_STEPS:,} steps; later steps are left out")
                break
            content = {"ages": {}, **content, "time": max(0.0, stamp - begun), "events": events}
            episodes[-1][1].append(msgspec.convert(content, LoggedStep))
            events = []
    numbers = Counter(number for number, steps in episodes if steps)
    twice = any(times > 1 for times in numbers.values())
    for index, (number, steps) in enumerate([episode for episode in episodes if episode[1]]):
        yield LoggedEpisode(index if twice else number, steps)
