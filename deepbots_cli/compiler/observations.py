"""What the policy sees: the entries of the observation, in file order."""

from __future__ import annotations

import math

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope, SupervisorScope
from deepbots_cli.compiler.values import Text
from deepbots_cli.compiler.variations import noise
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.types import Context, Typed
from deepbots_cli.program.task import MAX_OBSERVED_BYTES, MAX_OBSERVED_NUMBERS, ImageObservation, Observation
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import Observed

Bounds = tuple[tuple[float, ...], tuple[float, ...]]

LEAST_SIDE = 36
"""Pixels: filters of 8, 4 and 3 with strides of 4, 2 and 1 leave one of them."""


class Observations:
    """Reads the entries of the observation."""

    def __init__(self, spec: Scenario, namespace: Namespace) -> None:
        self._spec = spec
        self._namespace = namespace
        self._values = namespace.values

    def entries(self) -> tuple[Observation, ...]:
        found = tuple(entry for key, spec in self._spec.observation.items() if (entry := self._entry(key, spec)) is not None)
        self._check_size(found)
        self._check_pictures(found)
        self._check_keys(found)
        return found

    def _entry(self, key: str, given: Observed | str) -> Observation | None:
        place: Path = ("observation", key)
        spec = Observed.model_construct(range=given) if isinstance(given, str) else given
        text = self._values.key_text(place)
        typed = self._observed(text)
        range_text = self._values.text(place if isinstance(given, str) else (*place, "range"), spec.range)
        if typed is None:
            if range_text.text != "auto":
                self._values.range(range_text, ParameterScope(self._namespace, Context.FIXED))
            return None
        bounds = self._bounds(typed, range_text)
        scope = ParameterScope(self._namespace, Context.FIELD)
        added = noise(self._values, (*place, "noise"), spec.noise, typed, scope) if "noise" in spec.model_fields_set else None
        if bounds is None:
            return None
        kind = ImageObservation if typed.type.picture else Observation
        return kind(Expression(key, text.span, text.text, typed, f"observation.{key}"), *bounds, spec.history, spec.clip, added)

    def _observed(self, text: Text) -> Typed | None:
        tree = self._values.parsed(text)
        if tree is None:
            return None
        if not isinstance(tree, syntax.Name):
            self._values.findings.add(
                "DB103",
                text.span,
                "an expression where a name is needed",
                help="name the expression under `augment`, and observe that name",
            )
            return None
        return self._values.expression(text, SupervisorScope(self._namespace, Context.OBSERVATION))

    def _bounds(self, typed: Typed, text: Text) -> Bounds | None:
        count = len(typed.type.components or ("",))
        if typed.type.picture:
            if text.text != "auto":
                self._values.findings.add("DB403", text.span, "a range for a picture", help="write `auto`: its pixels are seen as 0 to 255")
                return None
            return (), ()
        if typed.type.boolean:
            if text.text != "auto":
                self._values.findings.add("DB403", text.span, "a range for a truth value", help="write `auto`: it is seen as 0 or 1")
                return None
            return (0.0,) * count, (1.0,) * count
        if text.text == "auto":
            low, high = typed.type.interval.low, typed.type.interval.high
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                self._values.findings.add("DB102", text.span, "the range of this value is not known", help="give it: `lo .. hi unit`")
                return None
            return (low,) * count, (high,) * count
        scope = ParameterScope(self._namespace, Context.FIXED)
        components = typed.type.components or None
        ends = self._values.ends(text, "the range of an observation", scope, dimension=typed.type.dimension, components=components)
        return (ends.low, ends.high) if ends else None

    def _check_size(self, entries: tuple[Observation, ...]) -> None:
        stack = self._spec.agent.stack
        seen = stack * sum(len(entry.low) * entry.history for entry in entries)
        pixels = stack * sum(math.prod(entry.value.typed.type.picture or (0,)) * entry.history for entry in entries)
        for found, most, what in ((seen, MAX_OBSERVED_NUMBERS, "numbers"), (pixels, MAX_OBSERVED_BYTES, "bytes of pictures")):
            if found > most:
                headline = f"an observation of {found} {what}, which is more than {most}"
                help = "shorten its histories, or the stack of the agent"
                self._values.findings.add("DB105", self._values.key_span(("observation",)), headline, help=help)

    def _check_pictures(self, entries: tuple[Observation, ...]) -> None:
        """Whether the network that is trained can see the pictures: its three layers of filters must fit in.

        It tells the channels, which histories and stacks add to, from the sides by their being fewest.
        """
        for entry in entries if self._spec.train is not None else ():
            picture = entry.value.typed.type.picture
            if picture is None:
                continue
            rows, columns, channels = picture[0], picture[1], picture[2] * entry.history * self._spec.agent.stack
            if min(rows, columns) < LEAST_SIDE:
                headline = f"pictures of {columns} x {rows} pixels, where the network needs {LEAST_SIDE} x {LEAST_SIDE}"
                self._values.findings.add("DB612", entry.value.span, headline, help="raise the `resolution` of the camera")
            elif channels >= min(rows, columns):
                headline = f"pictures of {columns} x {rows} pixels with {channels} channels in all, more than the sides have pixels"
                self._values.findings.add("DB612", entry.value.span, headline, help="shorten the history, or raise the `resolution`")

    def _check_keys(self, entries: tuple[Observation, ...]) -> None:
        """Pictures stand under keys of their own, in which a dot is an underscore."""
        taken = {"observation", "achieved_goal", "desired_goal"}
        for entry in entries:
            key = entry.value.name.replace(".", "_")
            if entry.value.typed.type.picture and key in taken:
                headline = f"the picture `{entry.value.name}` would stand under the key `{key}`, which is taken"
                self._values.findings.add("DB202", entry.value.span, headline, help="send it under another name")
            taken |= {key} if entry.value.typed.type.picture else set()
