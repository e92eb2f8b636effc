"""Python identifiers for the names of a scenario: readable, unique, and never a word that is taken."""

from __future__ import annotations

import builtins
import keyword
import math
import re

RUNTIME = (
    "Cartesian",
    "Follower",
    "Arrangement",
    "MALFORMED",
    "Motor",
    "Push",
    "RobotController",
    "Supervisor",
    "Ways",
    "Thrust",
    "clipped",
    "foreign",
    "quaternion",
    "unbounded",
)
"""What a printed module may import from `deepbots_cli.runtime`."""

_TAKEN = frozenset(
    {*keyword.kwlist, *keyword.softkwlist, *dir(builtins), *(n for n in dir(math) if not n.startswith("_"))}
    | {"self", "engine", "action", "message", "stamp", "reward", "terminated", "truncated", "ended", "Any", "Iterator", "Struct"}
    | {*RUNTIME, "wrap", "copysign"}
    | {"bodies", "body", "layout", "spot", "spots"}
)


class Names:
    """Hands out one identifier per key, the same for the same key."""

    def __init__(self) -> None:
        self._given: dict[str, str] = {}
        self._used: set[str] = set(_TAKEN)

    def __call__(self, *parts: str | None) -> str:
        """The identifier of a dotted name, such as `cart_pole_angle` for ("cart.pole_angle",)."""
        key = "\0".join(part for part in parts if part)
        if key not in self._given:
            wanted = re.sub(r"\W", "_", "_".join(part for part in parts if part))
            wanted = f"_{wanted}" if wanted[0].isdigit() else wanted
            name, number = wanted, 1
            while name in self._used:
                name, number = f"{wanted}_{number}", number + 1
            self._used.add(name)
            self._given[key] = name
        return self._given[key]


def class_name(text: str) -> str:
    """`line_follower` or `Line follower` to `LineFollower`."""
    words = re.findall(r"[A-Za-z0-9]+", text)
    name = "".join(word[:1].upper() + word[1:] for word in words) or "Scenario"
    return f"S{name}" if name[0].isdigit() else name
