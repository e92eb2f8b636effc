"""Names of robots, links, sensors and objects in a scenario."""

from __future__ import annotations

import re

from deepbots_cli.scenario.fields.names import RESERVED_NAMES, suggested_name

_WORDS_OF_YAML = frozenset(["true", "false", "null", "yes", "no", "on", "off"])
_RESERVED = _WORDS_OF_YAML.union(*RESERVED_NAMES.values())
_COMPONENTS = frozenset("xyz")
_MAX_LENGTH = 40


def scenario_name(text: str, fallback: str = "part") -> str:
    """Return a name of the scenario language for a name of Webots or Python: `polePosSensor` becomes
    `pole_pos_sensor`."""
    name = re.sub("__+", "_", suggested_name(text))[:_MAX_LENGTH].strip("_") or fallback
    is_taken = name in _RESERVED or name in _COMPONENTS
    return f"{fallback}_{name}" if is_taken or name[0].isdigit() else name


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
