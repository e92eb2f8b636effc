"""The text of a scenario for a robot file: sections in order, each with a comment that says what it is for."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, degrees, floor, radians

from deepbots_cli.robots.model import Joint

_COMMENTS: Mapping[str, str] = {
    "parameters": "figures by name; try another one with --set",
    "world": "robots sense and act once per timestep; physics takes so many substeps in it",
    "objects": "bodies that are no robots",
    "robots": "",
    "action": "what the agent decides; it acts in [-1, 1], and the range says what that means",
    "augment": "what the supervisor adds to the robot's message",
    "observation": "what the agent sees; each range becomes [-1, 1]",
    "signals": "helpers for reward and endings, which the agent does not see",
    "reward": "summands by names of your choice, paid in every step",
    "termination": "what ends the task",
    "truncation": "what only cuts an episode short",
    "reset": "how an episode begins",
    "scripts": "a policy by hand, to compare with: deepbots run ... --script",
    "train": "figures to begin with, which nobody has tuned for this robot; docs/training.md says what they do",
}
_COLUMN = 40  # of comments
_WIDTH = 110
_PLAIN = re.compile(r"(?:package://|(?:\.\./)+)?[A-Za-z_][A-Za-z0-9_./-]*")
_READ_OTHERWISE = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})


@dataclass
class Draft:
    """A scenario in the making: the lines of each section by its name, and remarks about the robot."""

    summary: str
    remarks: list[str] = field(default_factory=list)
    sections: dict[str, list[str]] = field(default_factory=dict)

    def add(self, section: str, *lines: str) -> None:
        self.sections.setdefault(section, []).extend(lines)

    def text(self, name: str) -> str:
        head = [_with_comment("deepbots: 1", "the version of the language"), f"name: {name}", f"summary: {self.summary}", ""]
        head += [f"# {' '.join(line.split())}" for line in self.remarks]  # a remark quotes the name of a file, which may hold anything
        body = [line for section, comment in _COMMENTS.items() if section in self.sections for line in self._section(section, comment)]
        return "\n".join([*head, *body]) + "\n"

    def _section(self, section: str, comment: str) -> list[str]:
        return ["", _with_comment(f"{section}:", comment), *(_aligned(f"  {line}") for line in self.sections[section])]


def _aligned(line: str) -> str:
    """A line with its comment, which stands behind four spaces, in the column of comments."""
    text, mark, comment = line.partition("    # ")
    return _with_comment(text, comment) if mark else line


def _with_comment(text: str, comment: str) -> str:
    return f"{text:<{_COLUMN - 2}}  # {comment}" if comment else text


def word(name: str) -> str:
    """A name of a robot file as YAML."""
    plain = _PLAIN.fullmatch(name) and name.lower() not in _READ_OTHERWISE
    return name if plain else json.dumps(name, ensure_ascii=False)


def listed(key: str, names: Sequence[str]) -> list[str]:
    """`key: [a, b]`, over several lines where it is long."""
    return _wrapped(f"{key}: [", [word(name) for name in names], "]")


def pose(key: str, positions: Mapping[str, float], joints: Iterable[Joint]) -> list[str]:
    """`key: {hinge: 10 deg}`, over several lines where it is long."""
    return _wrapped(f"{key}: {{", [f"{word(joint.name)}: {_position(joint, positions[joint.name])}" for joint in joints], "}")


def settled(joint: Joint, value: float) -> float:
    """A position in rad or m, in whole degrees or millimetres within the joint's limits; between the two if they are too close for that."""
    step = 1e-3 if joint.type == "prismatic" else radians(1.0)
    low, high = joint.limit.lower, joint.limit.upper
    rounded = round(value / step) * step
    if joint.type == "continuous" or low is None or high is None or low <= rounded <= high:
        return rounded
    inside = ceil(low / step) * step if rounded < low else floor(high / step) * step
    return inside if low <= inside <= high else (low + high) / 2


def _position(joint: Joint, value: float) -> str:
    measure, unit = (value, "m") if joint.type == "prismatic" else (degrees(value), "deg")
    return f"{measure + 0.0:.6g} {unit}"


def figure(value: float) -> str:
    """Three digits of a number."""
    return f"{value + 0.0:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def fresh(name: str, taken: Iterable[str]) -> str:
    """A name that is not taken."""
    known = set(taken)
    return next(candidate for candidate in (name, *(f"{name}_{number}" for number in range(2, len(known) + 3))) if candidate not in known)


def _wrapped(start: str, items: Sequence[str], end: str) -> list[str]:
    lines, line = [], start
    for number, item in enumerate(items):
        piece = item + ("," if number < len(items) - 1 else end)
        if len(line) + len(piece) > _WIDTH and line.strip():
            lines.append(line.rstrip())
            line = "  "
        line += piece + " "
    return [*lines, line.rstrip()]
