"""Names of robots, links, sensors and objects in a scenario."""

from __future__ import annotations

import re

_HUMP = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_OTHER = re.compile(r"[^a-z0-9]+")
_RESERVED_WORDS = (
    "and or not if else when true false null yes no on off time step ground arena any each every over from urdf"
    " terminated truncated ended goal_reached achieved desired previous_action previous_reward episode_return"
    " m mm cm km s ms us min h kg g rad deg rpm hz n j w pa max abs sum mean norm sqrt x y z"
)
_RESERVED = frozenset(_RESERVED_WORDS.split())
MAX_LENGTH = 40


def scenario_name(text: str, fallback: str = "part") -> str:
    """Return a name of the scenario language for a name of Webots or Python: `polePosSensor` becomes
    `pole_pos_sensor`."""
    name = _OTHER.sub("_", _HUMP.sub("_", text).lower()).strip("_")[:MAX_LENGTH].strip("_")
    if not name:
        name = fallback
    return f"{fallback}_{name}" if name[0].isdigit() or name in _RESERVED else name


class Names:
    """Gives names that differ from each other."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def new(self, text: str, fallback: str = "part") -> str:
        """Return a name that was not returned before."""
        name = scenario_name(text, fallback)
        number = 2
        unused = name
        while unused in self._taken:
            unused = f"{name}_{number}"
            number += 1
        self._taken.add(unused)
        return unused
