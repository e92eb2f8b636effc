"""The unit in which each quantity of a scenario is shown: the one in which its file writes it.

Programs, messages, recordings and JSON have SI units. Everything that a person reads has the units of
`ShownUnits`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from functools import cached_property

from deepbots_cli.document.nodes import Node, ScalarNode, entries_at, inline_text, node_at, text_at, walk
from deepbots_cli.expressions.dimensions import Unit
from deepbots_cli.expressions.text import MAX_TEXT, unit_named, units_in, usual_unit, written_unit
from deepbots_cli.program import SEPARATOR

_NAME = r"[A-Za-z_][A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*)*"
_DEFINITIONS = ("parameters", "signals", "augment")
_RANGES = ("observation", "critic", "action")


class ShownUnits:
    """The units of the quantities of one scenario.

    Args:
        root: The text of the scenario; None where it is unknown.
    """

    def __init__(self, root: Node | None = None) -> None:
        self._root = root

    def of(self, unit: str, *texts: str) -> Unit:
        """Return the unit in which a quantity with the SI unit `unit` is shown; `texts` are the texts of the
        file about it.

        It is the first unit in the texts that fits, or else the first in the definitions of the names in
        them. An angle whose texts have no unit is shown in the unit that the file uses most for angles.
        Anything else has its usual unit.
        """
        names = [name for text in texts for name in re.findall(_NAME, text[:MAX_TEXT])]
        definitions = [text_at(self._root, section, name) for name in names for section in _DEFINITIONS]
        return written_unit(unit, *texts, *definitions) or self._of_angles.get(unit) or self._usual(unit)

    def of_entry(self, name: str, unit: str) -> Unit:
        """Return the unit of a number of the observation, the action or the goal, such as
        `robot.sensor.x` or `agent__x`."""
        section, _, entry = name.partition(".")
        if section in ("goal", "achieved", "desired") and node_at(self._root, "goal") is not None:
            return self.of(unit, text_at(self._root, "goal", "range"))
        owner = name.partition(SEPARATOR)[0].rpartition(".")[2]
        # The agent itself, the one that it is like, and the others.
        agents = (owner, text_at(self._root, "agents", owner, "like"), *entries_at(self._root, "agents"))
        texts_by_key = (
            [text_at(self._root, section, key) for section in _RANGES]
            + [
                text_at(self._root, "agents", agent, section, key.partition(SEPARATOR)[2] or key)
                for agent in agents
                for section in _RANGES
            ]
            for key in (name, name.rpartition(".")[0], entry, entry.rpartition(".")[0])
        )
        return self.of(unit, *next(filter(any, texts_by_key), ()))

    def _usual(self, unit: str) -> Unit:
        """Return the usual unit; radians where the file writes all of its angles in radians."""
        angle = self._of_angles.get("rad")
        return unit_named(unit) if angle is not None and angle.text == "rad" else usual_unit(unit)

    @cached_property
    def _of_angles(self) -> Mapping[str, Unit]:
        """The unit that the file uses most for angles, for angular velocities, and so on, by their SI
        units."""
        counts = Counter(
            unit
            for _, node in (() if self._root is None else walk(self._root))
            if isinstance(node, ScalarNode)
            for unit in units_in(inline_text(node))
            if unit.dimension.rad
        )
        # The most common unit is the last one, which replaces the others of its dimension.
        most = {str(unit.dimension): unit for unit, _ in reversed(counts.most_common())}
        return {dimension: unit for dimension, unit in most.items() if unit.dimension.rad == 1}
