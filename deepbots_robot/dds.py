"""The link over ROS 2: topics of Cyclone DDS, on the loopback interface unless another one is named.

A topic `/cart/joint_states` of ROS 2 is the topic `rt/cart/joint_states` of DDS. Sensors are sent as ROS 2
sends sensor data: best effort, the last five messages; commands and resets arrive reliably. An image takes
its time in this serializer: 640 x 480 pixels in color take 34 to 67 ms, 64 x 48 less than 1 ms.

Every program in a domain receives the topics and types of the others, so that a type that differs or a second
policy is noticed for any other end. The descriptions of two ends of deepbots are the user data of their
participants.
"""

from __future__ import annotations

import math
import re
import socket
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import msgspec
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as DdsTopic
from cyclonedds.util import duration

from deepbots_robot.link import (
    ACTION_TOPIC,
    EPISODE_TOPIC,
    About,
    Array,
    Arrival,
    Remark,
    differences,
    misfit,
    with_fields,
)
from deepbots_robot.ros import TYPES, Codec, by_topic, header, stamp_of
from deepbots_robot.topics import Field, Topic

MAX_DOMAIN = 232
"""The largest DDS domain, `ROS_DOMAIN_ID`, whose ports exist."""
_LOOPBACK = (
    '<General><Interfaces><NetworkInterface name="lo"'
    ' multicast="true"/></Interfaces><AllowMulticast>false</AllowMulticast></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer"
    ' address="127.0.0.1"/></Peers></Discovery>'
)
_PLAIN_CDR = Policy.DataRepresentation(use_cdrv0_representation=True)
SENSOR_DATA = Qos(
    Policy.Reliability.BestEffort, Policy.History.KeepLast(5), Policy.Durability.Volatile, _PLAIN_CDR
)
"""The profile of ROS 2 for sensors: the newest five messages, without a repetition of a lost one."""
COMMANDS = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.History.KeepLast(10),
    Policy.Durability.Volatile,
    _PLAIN_CDR,
)
"""The default profile of ROS 2, for commands and resets."""
_TAKEN = 256
_CONNECTED = 2.0
"""The time after the first connection, in s, in which the link waits for listeners of all topics. Another
program may leave some out."""
_DISCOVERY = 0.5
"""The time in s in which a policy looks for another one before it begins. On one machine they find each other
within 0.1 s."""
_DESCRIBED = 8000
"""The largest size of the description of a participant in bytes, which fits into a message of discovery."""

_DOMAINS: dict[int, tuple[str, Any]] = {}
"""The domains of this process with their networks. A process has one of each number, which two ends in it
share."""

Mapped = Sequence[tuple[Field, Topic]]


class RosLink:
    """An end of a link over ROS 2.

    The end of the robot (`robot=True`) sends sensors and resets and receives commands.
    """

    def __init__(
        self,
        receives: Mapped,
        sends: Mapped,
        *,
        robot: bool = False,
        interface: str | None = None,
        domain: int = 0,
        about: About | None = None,
    ) -> None:
        """Open the topics of the fields.

        Raises:
            ValueError: A field does not fit its topic, the interface or the domain does not exist, or another
                policy sends these commands.
        """
        if not 0 <= domain <= MAX_DOMAIN:
            raise ValueError(f"the domain {domain} does not exist; choose one from 0 to {MAX_DOMAIN}")
        interfaces = [name for _, name in socket.if_nameindex()]
        if interface is not None and (
            interface not in interfaces or not re.fullmatch(r"[A-Za-z0-9_.:-]{1,32}", interface)
        ):
            raise ValueError(
                f"'{interface[:40]}' is not a network interface of this machine; it has"
                f" {', '.join(interfaces)}"
            )
        self.name = f"ROS 2 on {interface or 'the loopback interface'}, domain {domain}"
        network = (
            _LOOPBACK
            if interface is None
            else f'<General><Interfaces><NetworkInterface name="{interface}"/></Interfaces></General>'
        )
        try:
            if domain not in _DOMAINS:
                _DOMAINS[domain] = (
                    network,
                    Domain(domain, f"<CycloneDDS><Domain>{network}</Domain></CycloneDDS>"),
                )
            if _DOMAINS[domain][0] != network:
                raise ValueError(f"the domain {domain} is already open on another network interface")
            whole = about and with_fields(
                about, [field for field, _ in sends], [field for field, _ in receives]
            )
            texts = [msgspec.json.encode(each) for each in (whole, about) if each is not None]
            described = (
                Qos(
                    Policy.Userdata(
                        MARK + next((text for text in texts if len(text) < _DESCRIBED), texts[-1])
                    )
                )
                if texts
                else None
            )
            self._participant = DomainParticipant(domain, qos=described)
        except DDSException as error:
            raise ValueError(
                f"{self.name} cannot be opened; `ip address` lists the network interfaces"
            ) from error
        codecs = by_topic(receives) | by_topic(sends)
        sensors, commands = (sends, receives) if robot else (receives, sends)
        qos = dict.fromkeys(by_topic(sensors), SENSOR_DATA) | dict.fromkeys(by_topic(commands), COMMANDS)
        self._readers = [
            (name, self._reader(name, codec, qos[name]), codec) for name, codec in by_topic(receives).items()
        ]
        self._writers = [
            (self._writer(name, codec.type, qos[name]), codec) for name, codec in by_topic(sends).items()
        ]
        ends = {
            f"rt{name}": End(codec.type, name in by_topic(sends), qos[name] is COMMANDS)
            for name, codec in codecs.items()
        }
        ends[f"rt{EPISODE_TOPIC}"] = End("std_msgs/Header", robot, is_reliable=True)
        self._connected_at = math.inf
        self._others = Others(self._participant, ends, whole)
        if about is not None and about.role == "policy":
            self._refuse_a_second_policy([f"rt{name}" for name in by_topic(sends) if name != ACTION_TOPIC])
        self._waiting = WaitSet(self._participant)
        self._episode_writer = self._writer(EPISODE_TOPIC, "std_msgs/Header", COMMANDS) if robot else None
        self._episode_reader = (
            None
            if robot
            else DataReader(self._participant, self._topic(EPISODE_TOPIC, "std_msgs/Header"), qos=COMMANDS)
        )
        everything = SampleState.Any | ViewState.Any | InstanceState.Any
        readers = [reader for _, reader, _ in self._readers] + [self._episode_reader] * (not robot)
        self._conditions = [ReadCondition(reader, everything) for reader in readers]
        for condition in self._conditions:
            self._waiting.attach(condition)

    def _topic(self, name: str, type: str) -> Any:
        return DdsTopic(self._participant, f"rt{name}", TYPES[type])

    def _reader(self, name: str, codec: Codec, qos: Any) -> Any:
        return DataReader(self._participant, self._topic(name, codec.type), qos=qos)

    def _writer(self, name: str, type: str, qos: Any) -> Any:
        return DataWriter(self._participant, self._topic(name, type), qos=qos)

    def _refuse_a_second_policy(self, commands: Sequence[str]) -> None:
        until = time.monotonic() + _DISCOVERY
        while time.monotonic() < until:
            taken = self._others.sent_by_others(commands)
            if taken:
                raise ValueError(
                    f"another program sends commands on {taken} in {self.name}; end it, or choose another"
                    f" --domain on both sides {KILLED}"
                )
            time.sleep(0.02)

    def wait(self, timeout: float) -> None:
        self._waiting.wait(duration(seconds=max(0.0, timeout)))

    def take(self) -> Sequence[Arrival]:
        arrivals = (
            [] if self._episode_reader is None else [_episode(each) for each in _taken(self._episode_reader)]
        )
        for name, reader, codec in self._readers:
            arrivals += [_arrival(name, codec, message) for message in _taken(reader)]
        return arrivals

    def send(self, values: Mapping[str, Array], stamp: float) -> None:
        for writer, codec in self._writers:
            if all(field.name in values for field in codec.fields):
                with suppress(DDSException):  # the reader does not react
                    writer.write(codec.encode(values, stamp), round(stamp * 1e9))

    def reset(self, number: int, stamp: float) -> None:
        if self._episode_writer is not None:
            self._episode_writer.write(header(stamp, str(number)))
            # A killed reader never answers, and cyclonedds then raises its own AttributeError.
            with suppress(Exception):
                self._episode_writer.wait_for_acks(duration(seconds=1))

    def connected(self) -> bool:
        writers = [writer for writer, _ in self._writers]
        matched = [
            bool(writer.get_matched_subscriptions())
            for writer in [*writers, self._episode_writer]
            if writer is not None
        ]
        if any(matched):
            self._connected_at = min(self._connected_at, time.monotonic())
        return all(matched) or time.monotonic() > self._connected_at + _CONNECTED

    def remarks(self) -> Sequence[Remark]:
        return self._others.remarks()

    def others(self) -> Sequence[About]:
        return self._others.abouts()

    def close(self) -> None:
        """End all topics at once. A topic that is lost at the end of the process is alive for 10 s at the
        other end."""
        self._others.close()
        self._conditions.clear()
        self._readers.clear()
        self._writers.clear()
        self._episode_writer = self._episode_reader = None
        del self._waiting, self._participant


def _taken(reader: Any) -> list[Any]:
    """Return the messages of a reader. An exception stands for bytes that are not a message of its type."""
    messages: list[Any] = []
    for _ in range(_TAKEN):
        try:
            taken = reader.take(1)
        except Exception as error:  # noqa: BLE001  what the deserializer raises for bytes that are not a message is not documented
            messages.append(error)
            continue
        if not taken:
            break
        messages += [message for message in taken if not isinstance(message, InvalidSample)]
    return messages


def _arrival(name: str, codec: Codec, message: Any) -> Arrival:
    if isinstance(message, Exception):
        return Arrival(name, problem=f"a message that is not of type {codec.type}")
    stamp = stamp_of(message)
    if stamp is None and message.sample_info is not None:
        stamp = message.sample_info.source_timestamp * 1e-9
    try:
        return Arrival(name, codec.decode(message), stamp)
    except (ValueError, TypeError, OverflowError) as error:
        return Arrival(name, stamp=stamp, problem=str(error))


def _episode(message: Any) -> Arrival:
    if isinstance(message, Exception) or not re.fullmatch(r"[0-9]{1,9}", message.frame_id):
        return Arrival(EPISODE_TOPIC, problem="a reset without the number of an episode")
    return Arrival(EPISODE_TOPIC, stamp=stamp_of(message) or 0.0, kind="reset", number=int(message.frame_id))


# The other programs in a domain


MARK = b"deepbots="
"""The prefix of the user data of a participant, before the `About` as JSON."""
KILLED = "(a program that was killed counts for 10 s)"
_MOST, _TAKEN_ENDS = 2000, 50
"""The largest number of known ends of topics, and of ends that are taken at a time. A call that takes none
lasts 0.05 ms."""
_SETTLED = 1.0
"""The time in s in which the other end of the same scenario is found, if it runs already, before one of
another scenario is considered."""


class End(NamedTuple):
    """Our end of a topic."""

    type: str
    sends: bool
    is_reliable: bool


class Others:
    """Watches the other programs in a domain."""

    def __init__(self, participant: DomainParticipant, ends: Mapping[str, End], about: About | None) -> None:
        """Watch the topics. `ends` are our topics, by their names in DDS."""
        self._began = time.monotonic()
        self._own, self._about, self._ends = participant.guid, about, ends
        topics = (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription, BuiltinTopicDcpsParticipant)
        self._readers: list[tuple[Any, dict[Any, Any]]] = [
            (BuiltinDataReader(participant, topic), {}) for topic in topics
        ]

    def sent_by_others(self, names: Sequence[str]) -> str:
        """Return the first of these topics on which another program sends; empty if there is none."""
        self._update()
        return next(
            (
                _plain(each.topic_name)
                for is_sent, each in self._of_others()
                if is_sent and each.topic_name in names
            ),
            "",
        )

    def remarks(self) -> list[Remark]:
        """Return the misfits between our topics and those of others, and the topics on which several programs
        send."""
        self._update()
        texts = []
        senders: Counter[str] = Counter()
        for is_sent, each in self._of_others():
            own, topic = self._ends[each.topic_name], _plain(each.topic_name)
            senders[each.topic_name] += is_sent
            if each.type_name != _dds_type(own.type):
                texts.append(
                    Remark(
                        f"{topic} has messages of the type {_ros_type(each.type_name)} at the other end, and"
                        f" {own.type} here",
                        True,
                    )
                )
            elif own.sends is not is_sent and (text := _lost(topic, own, each, is_sent=is_sent)):
                texts.append(Remark(text))
        for name, count in senders.items():
            everybody = count + self._ends[name].sends
            if everybody > 1 and count:
                texts.append(
                    Remark(
                        f"{everybody} programs send on {_plain(name)}; end all but one, or give each robot"
                        f" its own --domain {KILLED}"
                    )
                )
        return [*texts, *self._differences()]

    def abouts(self) -> list[About]:
        """Return the descriptions of programs of deepbots in the domain."""
        read = [_about(each) for key, each in self._readers[2][1].items() if key != self._own]
        return [each for each in read if each is not None]

    def _update(self) -> None:
        """Take the changes since the last call."""
        for reader, endpoints in self._readers:
            for each in reader.take(_TAKEN_ENDS):
                if each.sample_info.instance_state == InstanceState.Alive and len(endpoints) < _MOST:
                    endpoints[each.key] = each
                else:
                    endpoints.pop(each.key, None)

    def _of_others(self) -> Iterator[tuple[bool, Any]]:
        """Yield the other programs that send (True) or receive on a topic of ours."""
        for (_, endpoints), is_sent in zip(self._readers[:2], (True, False), strict=True):
            yield from (
                (is_sent, each)
                for each in endpoints.values()
                if each.participant_key != self._own and each.topic_name in self._ends
            )

    def _differences(self) -> Iterator[Remark]:
        """Yield the disagreements with programs of deepbots with the other role: those of its scenario, else
        all."""
        own = self._about
        if own is None:
            return
        others = [each for each in self.abouts() if each.role != own.role]
        near = [each for each in others if each.scenario == own.scenario]
        if not near and time.monotonic() < self._began + _SETTLED:
            return
        for each in near or others:
            problem = misfit(own, each, topics=True) if each.sends and each.takes else ""
            if problem:
                yield Remark(
                    problem if near else f"{problem}; give each robot its own --domain {KILLED}",
                    is_misfit=True,
                )
            else:
                yield from (Remark(text) for text in differences(own, each))

    def close(self) -> None:
        self._readers.clear()


def _about(participant: Any) -> About | None:
    """Return the description of a program; None if it is not a program of deepbots."""
    data = bytes(participant.qos[Policy.Userdata].data) if Policy.Userdata in participant.qos else b""
    try:
        return msgspec.json.decode(data.removeprefix(MARK), type=About) if data.startswith(MARK) else None
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def _lost(topic: str, own: End, other: Any, *, is_sent: bool) -> str:
    """Return why no message passes: one end requires reliable ones, and the other one sends with best effort.
    Empty if messages pass."""
    is_reliable = Policy.Reliability in other.qos and isinstance(
        other.qos[Policy.Reliability], Policy.Reliability.Reliable
    )
    if is_sent and own.is_reliable and not is_reliable:
        return (
            f"another program sends {topic} with best effort, and reliable messages are asked for here:"
            " none arrives"
        )
    if not is_sent and is_reliable and not own.is_reliable:
        return (
            f"another program asks for reliable messages on {topic}, which is sent with best effort: none"
            " arrives there"
        )
    return ""


def _plain(name: str) -> str:
    return name.removeprefix("rt")


def _dds_type(type: str) -> str:
    package, _, name = type.partition("/")
    return f"{package}::msg::dds_::{name}_"


def _ros_type(name: str) -> str:
    """Return a type in the form that people write."""
    return name.replace("::msg::dds_::", "/").removesuffix("_")[:100]
