"""The descriptions that the two ends of a link exchange, and their misfits: fields, scenario, pace."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta

from deepbots_robot.model import LINE
from deepbots_robot.topics import ACTION, Field, describe

MAX_FIELDS = 4096
Text = Annotated[str, Meta(max_length=200, pattern=LINE)]
Role = Literal["policy", "robot"]


class About(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """One end of a link.

    Attributes:
        role: The role of the end: it is the policy, or the robot.
        scenario: The name of its scenario.
        digest: The digest of all parts of the scenario that affect an episode.
        pace: The pace of its time: `in lockstep`, or `at speed 1`.
        sends: The sent fields: counts and units by their names. Over ROS 2 only if it is short enough for
            discovery.
        takes: The received fields.
        rate: The number of steps in a second of its time, at which the robot steps, or the policy acts. 0 if
            it is unknown.
        scores: Whether it needs the values at the end of an episode too, since it computes rewards.
    """

    role: Role
    scenario: Text
    digest: Text
    pace: Text
    sends: Annotated[dict[Text, Text], Meta(max_length=MAX_FIELDS)] = {}
    takes: Annotated[dict[Text, Text], Meta(max_length=MAX_FIELDS)] = {}
    rate: Annotated[float, Meta(ge=0.0)] = 0.0
    scores: bool = False


class Remark(NamedTuple):
    """A sentence about the other end. An end that `is_misfit` cannot be used."""

    text: str
    is_misfit: bool = False


def pace(*, lockstep: bool, speed: float) -> str:
    return "in lockstep" if lockstep else f"at speed {speed:g}"


def with_fields(about: About, sends: Sequence[Field], takes: Sequence[Field]) -> About:
    """Return the description with the sent and received fields, without the action, which no end requires."""
    named = (
        {field.name: describe(field) for field in fields if field.name != ACTION} for fields in (sends, takes)
    )
    return msgspec.structs.replace(about, **dict(zip(("sends", "takes"), named, strict=True)))


def misfit(own: About, other: About, *, topics: bool = False) -> str:
    """Return why the two ends cannot work together; empty if they can. With `topics`, a field that no end
    receives does no harm."""
    problem = _difference(own, other, topics=topics) or _difference(other, own, topics=topics)
    if own.role == other.role:
        problem = f"it is a {own.role} too"
    return f"{_other(other)} does not fit {_this(own)}: {problem}" if problem else ""


def _difference(sender: About, taker: About, *, topics: bool) -> str:
    """Return the first field that one end does not send as the other one receives it."""
    for name in (*taker.takes, *(() if topics else sender.sends)):
        sent, taken = sender.sends.get(name), taker.takes.get(name)
        if sent is None:
            return f"the {taker.role} needs {name} ({taken}), which the {sender.role} does not send"
        if taken is None:
            return f"the {sender.role} sends {name} ({sent}), which the {taker.role} does not know"
        if sent != taken:
            return f"the {sender.role} sends {name} as {sent}, and the {taker.role} takes {taken}"
    return ""


def differences(own: About, other: About) -> list[str]:
    """Return the disagreements of two ends that can work together."""
    if own.scenario != other.scenario:
        return [f"{_other(other)} is of another scenario than {_this(own)}"]
    texts = []
    if own.digest != other.digest:
        texts.append(
            f"{_other(other)} is of another version of the scenario than {_this(own)}: another world, other"
            " values, or another robot file"
        )
    if own.rate and other.rate and not math.isclose(own.rate, other.rate, rel_tol=1e-3):
        texts.append(
            ", ".join(_rate(each) for each in sorted((own, other), key=lambda each: each.role, reverse=True))
        )
    if own.pace != other.pace:
        paces = f"the {other.role} runs {other.pace}, and this {own.role} {own.pace}"
        texts.append(f"{paces}; give --lockstep, or the same --speed, on both sides")
    return texts


def _rate(about: About) -> str:
    return f"the {about.role} {'steps' if about.role == 'robot' else 'acts'} at {about.rate:g} Hz"


def _other(about: About) -> str:
    return f"the {about.role} of {about.scenario} at the other end"


def _this(about: About) -> str:
    return f"this {about.role} of {about.scenario}"
