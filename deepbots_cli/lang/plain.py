"""Two texts that are no expressions: a schedule (`3e-4 -> 0`) and the end of a curriculum stage."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from deepbots_cli.lang.lexer import MAX_LENGTH
from deepbots_cli.lang.types import Report

_NUMBER = r"[-+]?(?:\d+(?:_\d{3})*(?:\.\d+)?|\.\d+)(?:[eE][-+]?\d+)?"
_SCHEDULE = rf"(?a)\s*({_NUMBER})(?:\s*->\s*({_NUMBER}))?\s*"
_UNTIL = rf"(?a)\s*([a-z_]+)\s*(>=|>)\s*({_NUMBER})(\s*%)?\s+over\s+(\d{{1,9}})\s+episodes?\s*"
METRICS = ("success_rate", "mean_return")


class Schedule(NamedTuple):
    """A plain number that goes in a straight line from `begin` to `end` over the training."""

    begin: float
    end: float

    @property
    def constant(self) -> bool:
        return self.begin == self.end


class Until(NamedTuple):
    """A stage ends when `metric` over the last `episodes` reaches `value`; `strictly` means above it."""

    metric: str
    value: float
    episodes: int
    strictly: bool = False


def parse_schedule(text: str, report: Report) -> Schedule | None:
    """`3e-4 -> 0`, or one number; None after DB401."""
    match = re.fullmatch(_SCHEDULE, text) if len(text) <= MAX_LENGTH else None
    if match is None:
        report(
            "DB401",
            0,
            len(text),
            "a schedule that cannot be read",
            "write a number, or `3e-4 -> 0` for a straight line from one to the other",
        )
        return None
    begin = _value(match[1])
    end = _value(match[2]) if match[2] else begin
    if not (math.isfinite(begin) and math.isfinite(end)):
        report("DB401", 0, len(text), "a number too large to be kept")
        return None
    return Schedule(begin, end)


def parse_until(text: str, report: Report) -> Until | None:
    """`success_rate >= 0.7 over 40 episodes`; None after DB401 or DB104."""
    match = re.fullmatch(_UNTIL, text) if len(text) <= MAX_LENGTH else None
    if match is None:
        report("DB401", 0, len(text), "a condition that cannot be read", "write it like `success_rate >= 0.7 over 40 episodes`")
        return None
    if match[1] not in METRICS:
        report("DB104", match.start(1), match.end(1), f"unknown measure `{match[1]}`", f"stages end by {' or '.join(METRICS)}")
        return None
    value, episodes = _value(match[3]) / (100.0 if match[4] else 1.0), int(match[5])
    if not math.isfinite(value):
        report("DB401", match.start(3), match.end(3), "a number too large to be kept")
        return None
    if match[1] == "success_rate" and not 0.0 <= value <= 1.0:
        report("DB105", match.start(3), match.end(3), "a success rate outside 0 .. 1")
        return None
    if episodes < 1:
        report("DB105", match.start(5), match.end(5), "an average over no episode")
        return None
    return Until(match[1], value, episodes, match[2] == ">")


def _value(text: str) -> float:
    return float(text.replace("_", ""))
