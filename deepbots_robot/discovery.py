"""The other programs in a domain of ROS 2: the topics of ours that they use, and the descriptions of programs
of deepbots."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import InstanceState
from cyclonedds.domain import DomainParticipant
from cyclonedds.qos import Policy

from deepbots_robot.about import About, Remark, differences, misfit

MARK = b"deepbots="
"""The prefix of the user data of a participant, before the `About` as JSON."""
KILLED = "(a program that was killed counts for 10 s)"
_MOST, _TAKEN = 2000, 50
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
            for each in reader.take(_TAKEN):
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
