"""What a scenario already contains, so that advice does not propose it again, and the units of its file.

The causes of a training use them before they advise a value of the observation, a term of the reward or a
script.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.conditions import ConditionComparison, comparisons
from deepbots_cli.analysis.returns import total_range, uses_earlier_values
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar
from deepbots_cli.expressions.types import Known
from deepbots_cli.insight.statements import quantity_text
from deepbots_cli.program import Program
from deepbots_cli.program.task import ObservedNumber


class ScenarioFacts:
    """What a scenario already contains, and the units of its file.

    Args:
        program: The scenario.
        units: The units of its file.
    """

    def __init__(self, program: Program, units: ShownUnits | None = None) -> None:
        self.program = program
        self.units = units or ShownUnits()

    @cached_property
    def _analysis(self) -> Analysis:
        return Analysis(self.program)

    # Observation

    @property
    def shows_previous_action(self) -> bool:
        return any(entry.name == "previous_action" for entry in self.program.agent.observation)

    @property
    def history(self) -> int:
        """The longest history of a value of the observation, in steps; 1 if the policy observes the newest
        values only."""
        return max((entry.history for entry in self.program.agent.observation), default=1)

    def is_measured(self, number: ObservedNumber) -> bool:
        """Return whether a number of the observation may differ in each step: it is not a parameter, and no
        value that depends on parameters alone."""
        entry = next(entry for entry in self.program.agent.observation if entry.name == number.name)
        known_when = entry.value.typed.type.known
        return entry.value.foreign is not None or known_when is Known.STEP or entry.noise is not None

    def observes(self, name: str) -> bool:
        """Return whether the observation depends on a value, such as a drawn parameter. The effect of the
        value in the world is ignored."""
        trees = [tree for entry in self.program.agent.observation for tree in entry.value.scalars]
        return any(name in self._analysis.dependencies(tree) for tree in trees)

    # Reward

    @cached_property
    def terms_towards_success(self) -> tuple[str, ...]:
        """The terms that can pay in ordinary steps, and depend on the values that the success compares;
        progress first."""
        reward = self._analysis.reward
        running, (ordinary, _) = reward.ranges_while_running(), reward.split_by_end()
        aims = {reading for tree in self._success_trees for reading in self._readings(tree)}
        towards = [
            (term.name, node)
            for term, node in ordinary
            if running.of(node).high > 0.0 and aims.intersection(self._readings(node))
        ]
        return tuple(
            name
            for name, _ in sorted(
                towards, key=lambda entry: not uses_earlier_values(self._analysis, entry[1])
            )
        )

    @cached_property
    def pays_in_ordinary_steps_only(self) -> bool:
        """Whether ordinary steps can pay, and a success itself does not, so that no reward comes late."""
        reward = self._analysis.reward
        running, (ordinary, final) = reward.ranges_while_running(), reward.split_by_end()
        at_success = [
            total_range(final, reward.ranges_at(success)).high for success in self.program.successes
        ]
        return any(running.of(node).high > 0.0 for _, node in ordinary) and not any(
            paid > 0.0 for paid in at_success
        )

    def terms_about(self, comparison: str) -> tuple[str, ...]:
        """Return the terms of ordinary steps that depend on the values of a comparison of the success, given
        by its text."""
        aims = {
            reading
            for ending in self.program.successes
            for compared in comparisons(self._analysis, ending)
            if compared.value.text[compared.node.start : compared.node.end] == comparison
            for tree in self._sides(compared)
            for reading in self._readings(tree)
        }
        ordinary, _ = self._analysis.reward.split_by_end()
        return tuple(term.name for term, node in ordinary if aims.intersection(self._readings(node)))

    def uses_earlier_values(self, term: str) -> bool:
        """Return whether a term depends on earlier values, as with `delta`."""
        nodes = [node for entry, node in self._analysis.reward.terms if entry.name == term]
        return any(uses_earlier_values(self._analysis, node) for node in nodes)

    def price_of(self, failure: str) -> float | None:
        """Return the reward of a failure by terms that pay only at an end: negative for a cost, None if it is
        unknown."""
        reward = self._analysis.reward
        ending = next((ending for ending in self.program.endings if ending.name == failure), None)
        _, final = reward.split_by_end()
        if ending is None or not reward.is_complete:
            return None
        price = total_range(final, reward.ranges_at(ending))
        return price.low if price.is_single else None

    @cached_property
    def _success_trees(self) -> list[Scalar]:
        trees: list[Scalar] = []
        for ending in self.program.successes:
            compared = [
                tree for comparison in comparisons(self._analysis, ending) for tree in self._sides(comparison)
            ]
            if not compared and ending.foreign is None:
                compared = list(self._analysis.scalars(ending))
            trees += compared
        goal = self.program.agent.goal
        return [*trees, *(goal.achieved.scalars if goal is not None else ())]

    def _sides(self, comparison: ConditionComparison) -> list[Scalar]:
        """Return the values on both sides of a comparison."""
        return [
            tree
            for side in comparison.node.args
            for tree in self._analysis.lowered(side, comparison.value.owner)
        ]

    def _readings(self, tree: Scalar) -> Iterator[int]:
        """Yield the values of the world and of sensors that a value is computed from, as numbers of
        `Analysis.identity`."""
        for node in self._analysis.walk_definitions(tree):
            if isinstance(node, EngineRead) or (
                isinstance(node, Name) and self._analysis.sensor(node) is not None
            ):
                yield self._analysis.identity(node)

    # Units

    def range_text(self, number: ObservedNumber, value: float) -> str:
        """Return the text of a value of an observed number, given in SI units, in the unit of its range in
        the file."""
        return quantity_text(value, self.units.of_entry(number.full_name, number.unit))
