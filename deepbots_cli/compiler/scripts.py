"""Hand-written policies: what a script makes of each part of the action.

A script is no trained policy: it sees what a signal may see, the truth too. It is asked now and then, between two steps,
and so keeps nothing in memory.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import SupervisorScope
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.lower import constant
from deepbots_cli.expressions.types import Components, Context
from deepbots_cli.expressions.unification import expect
from deepbots_cli.program.task import MAX_CONDITIONS, ActionRange, Choices, Script, ScriptedChoice, ScriptedRange
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.scenario import Scenario

_WORD = re.compile(r"\w+", re.ASCII)


def scripts(spec: Scenario, namespace: Namespace, action: tuple[Choices | ActionRange, ...]) -> tuple[Script, ...]:
    """The scripts without findings, which decide every part of the `action`."""
    reader = _Reader(namespace, {part.name: part for part in action}, list(spec.action))
    found = (reader.script(name, given) for name, given in spec.scripts.items())
    return tuple(script for script in found if script is not None)


class _Reader:
    """Reads scripts for one action; `names` are those of all its parts, `parts` has those without findings."""

    def __init__(self, namespace: Namespace, parts: Mapping[str, Choices | ActionRange], names: list[str]) -> None:
        self._namespace = namespace
        self._values = namespace.values
        self._scope = SupervisorScope(namespace, Context.SCRIPT)
        self._parts = parts
        self._names = names

    def script(self, name: str, given: Mapping[str, object]) -> Script | None:
        place: Path = ("scripts", name)
        for part in given:
            if part not in self._names:
                self._values.unknown(self._values.key_span((*place, part)), "action", part, self._names)
        for part in self._names:
            if part not in given and not self._values.is_lost(part):
                headline = f"the script `{name}` does not decide `{part}`"
                self._values.findings.add("DB102", self._values.key_span(place), headline, help=self._example(part))
        decided = {part: self._decision((*place, part), self._parts[part], given[part]) for part in self._parts if part in given}
        parts = [decided.get(part) for part in self._names]
        return Script(name, tuple(part for part in parts if part is not None)) if all(parts) else None

    def _example(self, name: str) -> str | None:
        """How a part may be decided."""
        match self._parts.get(name):
            case Choices(options=options) if options:
                return f"name an option, as in `{name}: {options[0].name}`"
            case ActionRange(low=low, high=high, unit=unit):
                return f"give a value, as in `{name}: {f'{(low + high) / 2:g} {unit}'.removesuffix(' 1')}`"
            case _:
                return None

    def _decision(self, place: Path, part: Choices | ActionRange, given: object) -> ScriptedChoice | ScriptedRange | None:
        if isinstance(part, ActionRange):
            if isinstance(given, dict):
                return self._aims(place, part, given)
            aim = self._aim(place, part, given, part.components or None)
            return None if aim is None else ScriptedRange((aim,), max(1, len(part.components)))
        return self._pick(place, part, given) if isinstance(given, dict) else self._option(place, part, str(given))

    def _aims(self, place: Path, part: ActionRange, given: Mapping[str, object]) -> ScriptedRange | None:
        """A value for each component by its name."""
        key = self._values.key_span(place)
        if not part.components:
            self._values.findings.add("DB103", key, f"several values, where `{part.name}` is one", help=self._example(part.name))
            return None
        strange = [name for name in given if name not in part.components]
        for name in strange:
            self._values.unknown(self._values.key_span((*place, name)), f"component of `{part.name}` called", name, part.components)
        for name in part.components:
            if name not in given and not strange:  # otherwise it probably stands there under another name
                headline = f"the script `{place[1]}` does not decide `{name}` of `{part.name}`"
                self._values.findings.add("DB102", key, headline, help="give a value for each component, or one for all")
        aims = [self._aim((*place, name), part, given[name], None) for name in part.components if name in given]
        found = tuple(aim for aim in aims if aim is not None)
        return ScriptedRange(found, len(part.components)) if len(found) == len(part.components) else None

    def _aim(self, place: Path, part: ActionRange, given: object, components: Components | None) -> Expression | None:
        """A value of the dimension of the range, which may be a vector of these components."""
        known = self._namespace.settle(part.name)
        text = self._values.text(place, given)
        typed = self._values.expression(text, self._scope, boolean=False)
        if typed is None or known is None or known.type is None:
            return None
        report, dimension = self._values.report(text), known.type.dimension
        fitted = expect(typed, report, f"`{place[-1]}`", dimension=dimension, components=components)
        return fitted and Expression(part.name, text.span, text.text, fitted, ".".join(map(str, place)))

    def _option(self, place: Path, part: Choices, word: str) -> ScriptedChoice | None:
        """The same option always."""
        span, options = self._values.span(place), [option.name for option in part.options]
        if not _WORD.fullmatch(word):
            help = f"name one, or say when each is taken: `{{{options[0]}: x > 0 m, {options[-1]}: true}}`"
            self._values.findings.add("DB103", span, f"an expression, where an option of `{part.name}` is due", help=help)
        elif word not in options:
            self._values.unknown(span, "choice", word, options)
        else:
            return ScriptedChoice((), word)
        return None

    def _pick(self, place: Path, part: Choices, given: Mapping[str, object]) -> ScriptedChoice | None:
        """The first option whose condition holds; one of the conditions must hold always, and nothing stands behind it."""
        if len(given) > MAX_CONDITIONS:
            self._values.findings.add("DB005", self._values.key_span(place), f"more than {MAX_CONDITIONS} conditions")
            return None
        options, rules, broken = [option.name for option in part.options], [], False
        for option, condition in given.items():
            if option not in options:
                self._values.unknown(self._values.key_span((*place, option)), "choice", option, options)
            rule = self._condition((*place, option), condition)
            broken = broken or rule is None or option not in options
            if rule is not None:
                rules.append((option, rule))
        if broken:
            return None
        always = next((index for index, (_, rule) in enumerate(rules) if constant(rule.typed) == (True,)), None)
        if always is None:
            headline = f"`{part.name}` may be left undecided: none of the conditions always holds"
            help = f"let the last one hold always: `{rules[-1][0]}: true`"
            self._values.findings.add("DB102", self._values.key_span(place), headline, help=help)
            return None
        otherwise = rules[always][0]
        for option, _ in rules[always + 1 :]:
            headline = f"`{option}` is never taken, as `{otherwise}` before it always is"
            self._values.findings.add("DB205", self._values.key_span((*place, option)), headline, help="take it out, or put it before")
        return ScriptedChoice(tuple(rules[:always]), otherwise)

    def _condition(self, place: Path, given: object) -> Expression | None:
        text = self._values.text(place, given)
        typed = self._values.expression(text, self._scope, boolean=True)
        typed = typed and expect(typed, self._values.report(text), "a condition", boolean=True)
        return typed and Expression(str(place[-1]), text.span, text.text, typed, ".".join(map(str, place)))
