"""The link over ROS 1, where rospy is installed: the topics of ROS 2, through the master of ROS_MASTER_URI.

rospy belongs to the Python of the system (Debian: ros-core, python3-sensor-msgs, python3-nav-msgs). A message
without a header has the time of its arrival. Each topic has its own TCP connection, so that the order of
messages on different topics is not kept: the policy acknowledges a reset on `/deepbots/begun`, and the robot
sends its first values afterwards.
"""

from __future__ import annotations

import atexit
import logging
import os
import re
import signal
import socket
import threading
import time
import xmlrpc.client
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any

import msgspec
import rosgraph
import rospy
from genpy import Time

from deepbots_robot.about import About, Remark, differences
from deepbots_robot.link import ACTION_TOPIC, EPISODE_TOPIC, MAX_BYTES, Array, Arrival
from deepbots_robot.ros import Codec, by_topic
from deepbots_robot.topics import Field, Topic

_BEGUN_TOPIC = "/deepbots/begun"
_PARAMETER = "/deepbots_about"
"""The suffix of the name of the parameter with the description of a node."""
_MAX_WAITING = 4096
_LOOK = 1.0
"""The time in s between two requests to the master."""
_ACKNOWLEDGED = 1.0
_CONNECTED = 2.0
"""The time after the first connection, in s, in which the link waits for all topics."""
_FAILURES = (OSError, xmlrpc.client.Error, rosgraph.MasterException, socket.timeout)

Mapped = Sequence[tuple[Field, Topic]]


class Ros1Link:
    """An end of a link over ROS 1. The end of the robot sends sensors and resets, and receives commands."""

    def __init__(
        self, receives: Mapped, sends: Mapped, *, robot: bool = False, about: About | None = None
    ) -> None:
        """Open the topics of the fields, as a node of this process.

        Raises:
            ValueError: There is no master, a field does not fit its topic, or another policy sends these
                commands.
        """
        master = os.environ.get("ROS_MASTER_URI", "http://localhost:11311")
        self.name = f"ROS 1, master {master}"
        if not rosgraph.is_master_online():
            raise ValueError(
                f"no ROS master answers at {master[:100]}; start `roscore`, or set ROS_MASTER_URI"
            )
        if not rospy.core.is_initialized():
            rospy.init_node(
                "deepbots",
                anonymous=True,
                disable_signals=True,
                disable_rosout=True,
                disable_rostime=True,
                log_level=rospy.FATAL,
            )
            logging.getLogger("rosout").setLevel(logging.CRITICAL)
            atexit.register(_end_node)
        self._node = rospy.get_name()
        self._master = rosgraph.Master(self._node)
        self._about, self._robot = about, robot
        self._key = f"{self._node}/{'robot' if robot else 'policy'}{_PARAMETER}"
        received, sent = (_codecs(mapped) for mapped in (receives, sends))
        self._types = {name: codec.type for name, codec in (received | sent).items()} | {
            EPISODE_TOPIC: "std_msgs/Header"
        }
        self._sends = {*sent, EPISODE_TOPIC} if robot else {*sent}
        if not robot:
            self._refuse_a_second_policy(sent)
        self._waiting: deque[Arrival] = deque(maxlen=_MAX_WAITING)
        self._here, self._begun = threading.Event(), threading.Event()
        self._looked_at, self._connected_at = -_LOOK, float("inf")
        self._remarks: list[Remark] = []
        self._others: list[About] = []
        self._publishers = [(self._publisher(name, codec.type), codec) for name, codec in sent.items()]
        self._resets = self._publisher(EPISODE_TOPIC if robot else _BEGUN_TOPIC, "std_msgs/Header")
        self._subscribers = [
            self._subscriber(name, codec.type, self._take_fields, (name, codec))
            for name, codec in received.items()
        ]
        asked = (_BEGUN_TOPIC, self._take_begun) if robot else (EPISODE_TOPIC, self._take_reset)
        self._subscribers.append(self._subscriber(asked[0], "std_msgs/Header", asked[1], None))
        if about is not None:
            self._master.setParam(self._key, msgspec.json.encode(about).decode())

    def _publisher(self, name: str, type: str) -> Any:
        return rospy.Publisher(name, message_class(type), queue_size=10, tcp_nodelay=True)

    def _subscriber(self, name: str, type: str, take: Any, about: Any) -> Any:
        return rospy.Subscriber(
            name, message_class(type), take, about, queue_size=10, buff_size=MAX_BYTES, tcp_nodelay=True
        )

    # In the threads of rospy

    def _take_fields(self, message: Any, topic: tuple[str, Codec]) -> None:
        name, codec = topic
        stamp = _stamp_of(message)
        try:
            self._add(Arrival(name, codec.decode(message), time.time() if stamp is None else stamp))
        except (ValueError, TypeError, OverflowError) as error:
            self._add(Arrival(name, stamp=stamp, problem=str(error)))

    def _take_reset(self, message: Any) -> None:
        if not re.fullmatch(r"[0-9]{1,9}", message.frame_id):
            self._add(Arrival(EPISODE_TOPIC, problem="a reset without the number of an episode"))
            return
        self._add(
            Arrival(EPISODE_TOPIC, stamp=message.stamp.to_sec(), kind="reset", number=int(message.frame_id))
        )
        self._resets.publish(message)

    def _take_begun(self, message: Any) -> None:
        self._begun.set()

    def _add(self, arrival: Arrival) -> None:
        self._waiting.append(arrival)
        self._here.set()

    # A link

    def wait(self, timeout: float) -> None:
        if not self._waiting:
            self._here.wait(max(0.0, timeout))
        self._here.clear()

    def take(self) -> Sequence[Arrival]:
        arrivals = []
        while self._waiting:
            arrivals.append(self._waiting.popleft())
        return arrivals

    def send(self, values: Mapping[str, Array], stamp: float) -> None:
        for publisher, codec in self._publishers:
            if all(field.name in values for field in codec.fields):
                with suppress(rospy.ROSException):  # the node ends
                    publisher.publish(codec.encode(values, stamp))

    def reset(self, number: int, stamp: float) -> None:
        self._begun.clear()
        self._resets.publish(message_class("std_msgs/Header")(0, Time.from_sec(stamp), str(number)))
        self._begun.wait(_ACKNOWLEDGED)

    def connected(self) -> bool:
        connections = [publisher.get_num_connections() for publisher, _ in self._publishers] + [
            self._resets.get_num_connections()
        ]
        if any(connections):
            self._connected_at = min(self._connected_at, time.monotonic())
        return all(connections) or time.monotonic() > self._connected_at + _CONNECTED

    def close(self) -> None:
        with suppress(*_FAILURES, KeyError):
            if self._about is not None:
                self._master.deleteParam(self._key)
        for end in (*(publisher for publisher, _ in self._publishers), self._resets, *self._subscribers):
            end.unregister()

    # What the master knows of others

    def remarks(self) -> Sequence[Remark]:
        self._look()
        return self._remarks

    def others(self) -> Sequence[About]:
        self._look()
        return self._others

    def _look(self) -> None:
        if time.monotonic() < self._looked_at + _LOOK:
            return
        with suppress(*_FAILURES):
            senders, types = dict(self._master.getSystemState()[0]), dict(self._master.getTopicTypes())
            self._remarks = [
                Remark(
                    f"{name} has messages of the type {types[name]} at the other end, and {own} here",
                    is_misfit=True,
                )
                for name, own in self._types.items()
                if types.get(name, own) not in (own, "*")
            ]
            for name in self._types:
                count = len({self._node} & {*senders.get(name, ())} | {*self._alive(senders.get(name, ()))})
                if count > 1:
                    self._remarks.append(
                        Remark(
                            f"{count} programs send on {name}; end all but one, or give each robot its own"
                            " topics"
                        )
                    )
            self._others = [
                each for key in self._master.getParamNames() if (each := self._described(key)) is not None
            ]
            fitting = [
                each for each in self._others if self._about is not None and each.role != self._about.role
            ]
            near = [
                each for each in fitting if self._about is not None and each.scenario == self._about.scenario
            ]
            self._remarks += [
                Remark(text) for each in near or fitting for text in differences(self._about or each, each)
            ]
        self._looked_at = time.monotonic()

    def _described(self, key: str) -> About | None:
        """Return the description of a node that runs, from its parameter."""
        if not key.endswith(_PARAMETER) or key == self._key:
            return None
        node = key.removesuffix(_PARAMETER).rpartition("/")[0]
        try:
            about = msgspec.json.decode(str(self._master.getParam(key)), type=About)
        except (*_FAILURES, msgspec.MsgspecError, KeyError):
            return None
        return about if node == self._node or [*self._alive([node])] else None

    def _alive(self, nodes: Sequence[str]) -> list[str]:
        """Return the nodes that answer, besides this one, because the master also lists one that was
        killed."""
        alive = []
        for node in nodes:
            if node != self._node:
                with suppress(*_FAILURES):
                    address = self._master.lookupNode(node)
                    with xmlrpc.client.ServerProxy(address, transport=_Patient()) as proxy:
                        proxy.getPid(self._node)
                    alive.append(node)
        return alive

    def _refuse_a_second_policy(self, sent: Mapping[str, Codec]) -> None:
        with suppress(*_FAILURES):
            for name, nodes in self._master.getSystemState()[0]:
                if name in sent and name != ACTION_TOPIC and self._alive(nodes):
                    raise ValueError(f"another program sends commands on {name} in {self.name}; end it first")


def _end_node() -> None:
    """End the node of this process without the wait of rospy for a daemon thread, which takes up to 5 s.
    Ctrl-C then ends the process at once."""
    with suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    getattr(rospy.core, "_shutdown_threads", []).clear()
    rospy.signal_shutdown("the process ends")


class _Patient(xmlrpc.client.Transport):
    """A transport that waits at most half a second for an answer."""

    def make_connection(self, host: Any) -> Any:
        connection = super().make_connection(host)
        connection.timeout = 0.5
        return connection


def message_class(type: str) -> Any:
    """Return the class of a type such as `sensor_msgs/JointState`.

    Raises:
        ValueError: The package of the type is not installed.
    """
    package, _, name = type.partition("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except ModuleNotFoundError:
        raise ValueError(
            f"the messages of {package} are not installed; in Debian: apt install"
            f" python3-{package.replace('_', '-')}"
        ) from None


def empty(type: str, stamp: float, frame: str) -> Any:
    """Return a message of zeros."""
    message = message_class(type)()
    if hasattr(message, "header"):
        message.header.stamp, message.header.frame_id = Time.from_sec(stamp), frame
    return message


def _stamp_of(message: Any) -> float | None:
    header = getattr(message, "header", None)
    return None if header is None or header.stamp.is_zero() else float(header.stamp.to_sec())


def _codecs(mapped: Mapped) -> dict[str, Codec]:
    return by_topic(mapped, empty)
