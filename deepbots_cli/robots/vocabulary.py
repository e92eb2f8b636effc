"""The words of URDF that are read. Others belong to other tools and are passed over, unless they look misspelt."""

from __future__ import annotations

from typing import NamedTuple

from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.robots.report import Report, quoted
from deepbots_cli.robots.xml import Element

MAX_WORDS = 200  # unknown words that are compared with the known ones


class Words(NamedTuple):
    """What may stand inside an element."""

    children: tuple[str, ...] = ()
    attributes: tuple[str, ...] = ()


_VALUE = Words((), ("value",))
_PLACED = ("origin", "geometry", "material")

VOCABULARY = {
    "robot": Words(("link", "joint", "material"), ("name",)),
    "link": Words(("inertial", "visual", "collision", "contact"), ("name",)),
    "inertial": Words(("origin", "mass", "inertia")),
    "visual": Words(_PLACED, ("name",)),
    "collision": Words(_PLACED, ("name",)),
    "contact": Words(("lateral_friction", "spinning_friction", "rolling_friction", "restitution")),
    "lateral_friction": _VALUE,
    "spinning_friction": _VALUE,
    "rolling_friction": _VALUE,
    "restitution": _VALUE,
    "mass": _VALUE,
    "inertia": Words((), ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "origin": Words((), ("xyz", "rpy")),
    "geometry": Words(("box", "sphere", "cylinder", "capsule", "mesh")),
    "box": Words((), ("size",)),
    "sphere": Words((), ("radius",)),
    "cylinder": Words((), ("radius", "length")),
    "capsule": Words((), ("radius", "length")),
    "mesh": Words((), ("filename", "scale")),
    "material": Words(("color", "texture"), ("name",)),
    "color": Words((), ("rgba",)),
    "joint": Words(("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"), ("name", "type")),
    "parent": Words((), ("link",)),
    "child": Words((), ("link",)),
    "axis": Words((), ("xyz",)),
    "limit": Words((), ("lower", "upper", "effort", "velocity")),
    "dynamics": Words((), ("damping", "friction")),
    "mimic": Words((), ("joint", "multiplier", "offset")),
}


def check(root: Element, report: Report) -> None:
    """DB311 for each element or attribute that is unknown and close to a known one."""
    compared = 0
    waiting = [root]
    while waiting and compared < MAX_WORDS:
        element = waiting.pop()
        words = VOCABULARY[element.tag]
        for attribute in element.attributes:
            if attribute not in words.attributes and compared < MAX_WORDS:
                compared += 1
                _near_miss(report, element, attribute, words.attributes, attribute)
        for child in element.children:
            if child.tag in words.children:
                if child.tag in VOCABULARY:
                    waiting.append(child)
            elif compared < MAX_WORDS:
                compared += 1
                _near_miss(report, child, child.tag, words.children, None)


def _near_miss(report: Report, element: Element, word: str, known: tuple[str, ...], attribute: str | None) -> None:
    match = nearest(word, known, 0.75)
    if match:
        what = "attribute" if attribute else "element"
        report.warn("DB311", element, f"the {what} {quoted(word)} is not read", attribute=attribute, help=f"did you mean {match!r}?")
