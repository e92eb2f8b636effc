"""Serves a bundle: its fields, the requested link, the loop until a signal, and the report."""

from __future__ import annotations

import re
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_robot import model
from deepbots_robot.link import About, Array, Link, pace
from deepbots_robot.server import QUIET, Input, Output, Server
from deepbots_robot.topics import Field, Topic, action_field, conflicts, first_mapping

if TYPE_CHECKING:
    from deepbots_robot.bundle import Bundle
    from deepbots_robot.log import LogWriter

MAX_SPEED = 1000.0
_MAX_EVENTS = 100
"""The largest number of events of one kind that are logged per second. Without a limit, a flood of wrong
messages would fill the disk."""
NO_ROS1 = "the link over ROS 1 is gone; use ROS 2 (from ROS 1 through ros1_bridge), ZeroMQ or WebSocket"


class ServeError(Exception):
    """The error for a bundle that cannot be served as requested, in one sentence."""


@dataclass(frozen=True)
class Transport:
    """The link to open. Without an address it is ROS 2, by default on the loopback interface."""

    zmq: str | None = None
    websocket: str | None = None
    interface: str | None = None
    domain: int = 0

    @property
    def is_ros(self) -> bool:
        return self.zmq is None and self.websocket is None

    @classmethod
    def at(cls, address: str) -> Transport:
        """Return the transport of an address: `ros`, `ros:3` of domain 3, `ros:3@eth0`, `tcp://HOST:PORT`,
        `ipc://FILE`, `ws://HOST:PORT`.

        Raises:
            ServeError: The address is none of these.
        """
        ros = re.fullmatch(r"ros(?::([0-9]{1,3}))?(?:@(.{1,32}))?", address)
        if ros:
            return cls(interface=ros[2], domain=int(ros[1] or 0))
        if address == "ros1":
            raise ServeError(NO_ROS1)
        if address.startswith("ws://"):
            return cls(websocket=address.removeprefix("ws://").removesuffix("/"))
        if address.startswith(("tcp://", "ipc://")):
            return cls(zmq=address)
        raise ServeError(
            f"'{address[:100]}' is not an address of a robot; write ros, ros:DOMAIN, tcp://HOST:PORT,"
            " ipc://FILE or ws://HOST:PORT"
        )

    def open(
        self,
        receives: Sequence[tuple[Field, Topic]],
        sends: Sequence[tuple[Field, Topic]],
        *,
        robot: bool,
        about: About | None = None,
    ) -> Link:
        """Open one end of the link, with the description of this end.

        Raises:
            ServeError: The package of the link is missing, or the address, the interface or a topic cannot be
                used.
        """
        if (
            self.is_ros
            and any(topic.type == "sensor_msgs/CompressedImage" for _, topic in (*receives, *sends))
            and find_spec("PIL") is None
        ):
            raise ServeError(
                "pillow, which reads compressed images, is not installed; install it with: pip install pillow"
            )
        package, extra = "cyclonedds", "ros"
        if self.zmq is not None:
            package, extra = "pyzmq", "zmq"
        elif self.websocket is not None:
            package, extra = "websockets", "websocket"
        fields = [field for field, _ in receives], [field for field, _ in sends]
        try:
            if self.zmq is not None:
                from deepbots_robot.zeromq import ZmqLink

                return ZmqLink(self.zmq, *fields, robot=robot, about=about)
            if self.websocket is not None:
                from deepbots_robot.websocket import WebSocketLink

                return WebSocketLink(self.websocket, *fields, robot=robot, about=about)
            from deepbots_robot.dds import RosLink

            return RosLink(
                receives, sends, robot=robot, interface=self.interface, domain=self.domain, about=about
            )
        except ModuleNotFoundError as error:
            lacks = "" if error.name in (package, extra) else f", or lacks {error.name}"
            raise ServeError(
                f'{package} is not installed{lacks}; install it with: pip install "deepbots-robot[{extra}]"'
            ) from None
        except ValueError as error:
            raise ServeError(str(error)) from None


# The fields of a bundle


def field_of(entry: model.Input | model.Output) -> Field:
    """Return an input or an output as a field."""
    if isinstance(entry, model.Output):
        return Field(
            entry.name,
            entry.robot,
            entry.kind,
            entry.unit or "1",
            entry.shape,
            _joints(entry),
            entry.components,
        )
    joints = entry.joints if entry.source == "sensor" else ()
    return Field(
        entry.name,
        entry.robot or "",
        entry.sensor or "value",
        entry.unit or "1",
        entry.shape,
        joints,
        entry.components,
    )


def _joints(entry: model.Output) -> tuple[str, ...]:
    """Return the joints of the numbers; empty if the numbers are not those of joints."""
    return (
        entry.joints
        if entry.kind in ("velocity", "position", "effort") and len(entry.joints) == entry.shape[0]
        else ()
    )


def inputs_of(info: model.BundleInfo) -> list[Input]:
    """Return the inputs with the limits by which messages are checked."""
    return inputs_of_entries(info.inputs, info.rate_hz)


def inputs_of_entries(
    entries: Sequence[model.Input], rate: float, *, needs_goals: bool = True
) -> list[Input]:
    """Return the inputs for these entries of a policy that acts at `rate`; see `inputs_of`. Without
    `needs_goals`, steps do not wait for goals."""
    return [
        Input(
            field_of(entry),
            entry.dtype,
            *_ends(entry.range, entry.shape),
            max_age=np.inf if entry.max_age_s is None else entry.max_age_s,
            every_step=entry.source != "goal" and entry.rate_hz >= rate * 0.999,
            is_needed=needs_goals or entry.source != "goal",
        )
        for entry in entries
    ]


def outputs_of(info: model.BundleInfo) -> list[Output]:
    """Return the outputs with the limits of their commands."""
    return outputs_of_entries(info.outputs)


def outputs_of_entries(entries: Sequence[model.Output]) -> list[Output]:
    """Return the outputs for these entries; see `outputs_of`."""
    return [
        Output(
            field_of(entry),
            *_ends(entry.range, entry.shape),
            max_rate=_filled(entry.max_rate, entry.shape, np.inf),
            safe=_filled(entry.safe, entry.shape, np.nan),
        )
        for entry in entries
    ]


def _ends(
    ends: tuple[tuple[float | None, ...], tuple[float | None, ...]] | None, shape: tuple[int, ...]
) -> tuple[Array, Array]:
    low, high = ends if ends is not None else ((), ())
    return _filled(low, shape, -np.inf), _filled(high, shape, np.inf)


def _filled(values: Sequence[float | None], shape: tuple[int, ...], missing: float) -> Array:
    return (
        np.array([missing if each is None else each for each in values])
        if values
        else np.full(shape, missing)
    )


def mapped(
    fields: Sequence[Field], given: Mapping[str, Topic], *, commands: bool = False
) -> list[tuple[Field, Topic]]:
    """Return each field with its topic: the given one, else the default one.

    Raises:
        ServeError: Two fields cannot share a topic, or a field does not fit.
    """
    topics = {**first_mapping(fields, commands=commands), **given}
    without = next((field.name for field in fields if field.name not in topics), None)
    if without is not None:
        raise ServeError(
            f"no topic fits {without}; name its topic under `ros` in the scenario, and export the run again"
        )
    by_name = {field.name: (field, topics[field.name]) for field in fields}
    try:
        problems = conflicts(by_name)
    except ValueError as error:
        raise ServeError(str(error)) from None
    if problems:
        name, problem = next(iter(problems.items()))
        raise ServeError(
            f"{name}: {problem}; name its topic under `ros` in the scenario, and export the run again"
        )
    return list(by_name.values())


# Serving


def serve(
    bundle: Bundle,
    transport: Transport,
    *,
    speed: float = 1.0,
    lockstep: bool = False,
    log: Path | None = None,
    seconds: float | None = None,
    note: Callable[[str], object] = lambda text: None,
) -> dict[str, Any]:
    """Serve until SIGINT or SIGTERM, or for `seconds`; returns the report of the server.

    Args:
        note: Called with a sentence about each remark, and at most one per second about each other kind of
            event, except episodes.

    Raises:
        ServeError: The link or the log cannot be opened.
    """
    if not 0.0 < speed <= MAX_SPEED:
        raise ServeError(f"the speed {speed:g} is not between 0 and {MAX_SPEED:g}")
    if seconds is not None and not 0.0 < seconds < np.inf:
        raise ServeError(
            f"{seconds:g} is not a time to serve for; write a number of seconds above 0, or none, to serve"
            " until Ctrl-C"
        )
    inputs, outputs = inputs_of(bundle.info), outputs_of(bundle.info)
    topics = {name: Topic(topic.topic, topic.type, topic.part) for name, topic in bundle.info.ros.items()}
    receives = mapped([each.field for each in inputs], topics)
    sends = [
        action_field(len(bundle.info.choices) or len(bundle.info.action)),
        *mapped([each.field for each in outputs], topics, commands=True),
    ]
    scenario = bundle.info.scenario
    about = About(
        "policy",
        scenario.name,
        scenario.task_digest,
        pace(lockstep=lockstep, speed=speed),
        rate=bundle.info.rate_hz,
    )
    sources = (
        ", ".join(dict.fromkeys(topic.name for _, topic in receives)) if transport.is_ros else "the robot"
    )
    with ExitStack() as stack:
        link = transport.open(receives, sends, robot=False, about=about)
        stack.callback(link.close)
        # After the link: the log of a server that cannot begin would refuse the next one.
        writer = _opened(log, bundle)
        if writer is not None:
            stack.callback(_close, writer)
        server = Server(
            bundle.start(),
            inputs,
            outputs,
            link,
            bundle.info.rate_hz,
            speed=speed,
            lockstep=lockstep,
            log=Notes(writer, note),
        )
        with stopping() as stopped:
            note(
                f"{scenario.name} acts at {bundle.info.rate_hz:g} Hz over {link.name}; it waits for {sources}"
            )
            server.run(until(stopped, seconds, server, note))
    return {**server.report(), "stopped_by_signal": stopped()}


def _close(writer: LogWriter) -> None:
    with suppress(OSError):  # a note has reported it
        writer.close()


def nothing_served(report: Mapping[str, Any], seconds: float | None) -> str:
    """Return a message for a server that made no step; empty if there was one, or if the server ended by a
    signal."""
    if seconds is None or report["steps"] or report["stopped_by_signal"]:
        return ""
    missing = ", ".join(report["missing"][:5])
    because = f": no value of {missing} arrived" if missing else ""
    return f"the policy did not act within {seconds:g} s{because}"


def _opened(path: Path | None, bundle: Bundle) -> LogWriter | None:
    if path is None:
        return None
    try:
        from deepbots_robot.log import LogWriter

        about = {"scenario": bundle.info.scenario.name, "digest": bundle.info.scenario.digest}
        return LogWriter(path, about, files=bundle.description())
    except ModuleNotFoundError as error:
        raise ServeError(
            f"--log needs {error.name}, which is not installed; install it with: pip install"
            ' "deepbots-robot[log]"'
        ) from None
    except FileExistsError:
        raise ServeError(f"{path} exists already; name another file for the log") from None
    except OSError as error:
        raise ServeError(
            f"{path} cannot be written: {(error.strerror or 'unknown reason').lower()}"
        ) from None


class Notes:
    """Passes events to a log, and the more important of them to a person."""

    def __init__(self, log: LogWriter | None, note: Callable[[str], object]) -> None:
        self._log, self._note = log, note
        self._said: dict[str, float] = {}
        self._logged: Counter[str] = Counter()
        self._second = 0

    def step(self, *step: Any, **rest: Any) -> None:
        """Log a step; the arguments are those of `LogWriter.step`."""
        self._write(lambda log: log.step(*step, **rest))

    def _write(self, entry: Callable[[LogWriter], object]) -> None:
        """Write to the log. Without the log, the robot still gets its commands."""
        try:
            if self._log is not None:
                entry(self._log)
        except OSError as error:
            self._log = None
            self._note(
                f"nothing more is written to the log ({(error.strerror or 'unknown reason').lower()}); the"
                " policy continues to act"
            )

    def event(self, stamp: float, kind: str, text: str) -> None:
        now = time.monotonic()
        if int(now) != self._second:
            self._second = int(now)
            self._logged.clear()
        self._logged[kind] += 1
        if self._logged[kind] <= _MAX_EVENTS:
            self._write(lambda log: log.event(stamp, kind, text))
        if kind == "remark" or (kind != "episode" and now - self._said.get(kind, -10.0) > 1.0):
            self._said[kind] = now
            self._note({"safe": "safe posture: ", "refused": "refused: "}.get(kind, "") + text)


@contextmanager
def stopping() -> Iterator[Callable[[], bool]]:
    """Context in which SIGINT and SIGTERM make `stopped()` true instead of ending the process."""
    is_stopped = False

    def stop(*_: object) -> None:
        nonlocal is_stopped
        is_stopped = True

    handlers = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        with suppress(ValueError):  # not in the main thread
            handlers[number] = signal.signal(number, stop)
    try:
        yield lambda: is_stopped
    finally:
        for number, handler in handlers.items():
            # A handler that C code installed is None, and Python cannot set it again.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def until(
    stopped: Callable[[], bool], seconds: float | None, server: Server, note: Callable[[str], object]
) -> Callable[[], bool]:
    """Return the stop condition of the server: a signal (`stopped`), or the end of `seconds`. Without a step
    in the first 5 s, `note` is called with the missing inputs."""
    began = time.monotonic()
    noted = False

    def done() -> bool:
        nonlocal noted
        passed = time.monotonic() - began
        if not noted and not server.steps and passed > QUIET:
            noted = True
            missing = ", ".join(server.intake.missing()[:5])
            note(
                f"no step in {QUIET:g} s: there is no value of {missing} yet"
                if missing
                else f"no step in {QUIET:g} s"
            )
        return stopped() or (seconds is not None and passed >= seconds)

    return done
