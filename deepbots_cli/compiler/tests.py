"""Tests of the scenario: who acts, for how long, and the expected result."""

from __future__ import annotations

import math
from collections.abc import Iterator

from deepbots_cli.compiler.namespace import Namespace, SupervisorScope
from deepbots_cli.compiler.policy import Decisions
from deepbots_cli.compiler.scoring import NO_SUCCESS
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.lower import constant
from deepbots_cli.expressions.types import Constant, Context, Operation, Typed, walk
from deepbots_cli.expressions.unification import expect_range
from deepbots_cli.program import Program
from deepbots_cli.program.task import (
    ActionRange,
    Choices,
    Expected,
    ExpectedKey,
    FixedAction,
    ScenarioTest,
    ScriptedChoice,
    ScriptedRange,
    Truncation,
)
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.task import Expectation
from deepbots_cli.scenario.task import ScenarioTest as TestSpec

MAX_TESTS = 200
MAX_STEPS = 1_000_000
"""Timesteps of a test: a few minutes in a light world."""
PLAIN_POLICIES = ("random", "zero")
_COMPARISONS = frozenset({"less", "less_equal", "greater", "greater_equal", "equal", "not_equal"})
_RATES: tuple[ExpectedKey, ...] = ("success_rate", "failure_rate", "mean_return")
_CONDITIONS: tuple[ExpectedKey, ...] = ("always", "eventually")
_COMPARED = 4
"""Values that a failed condition shows."""


def scenario_tests(namespace: Namespace, program: Program) -> tuple[ScenarioTest, ...]:
    """The tests without findings, compiled in the namespace of `program`."""
    given, values = namespace.scenario.tests, namespace.values
    if len(given) > MAX_TESTS:
        values.findings.add("DB005", values.key_span(("tests",)), f"more than {MAX_TESTS} tests", help="join tests, or write another file")
        return ()
    reader = _Reader(namespace, program)
    found = [reader.test(name, spec) for name, spec in given.items()]
    return tuple(test for test in found if test is not None)


class _Reader:
    def __init__(self, namespace: Namespace, program: Program) -> None:
        self._namespace = namespace
        self._scenario = namespace.scenario
        self._values = namespace.values
        self._program = program
        self._decisions = Decisions(namespace, program.policy.action, namespace.scope(Context.FIXED))
        self._scope = SupervisorScope(namespace, Context.TEST)

    def test(self, name: str, spec: TestSpec) -> ScenarioTest | None:
        """The test; None after an error."""
        known = len(self._values.findings.errors)
        policy = self._actions(spec) if spec.actions is not None else self._policy(spec)
        cases, stages = self._scenario.evaluation.cases, [stage.name for stage in self._scenario.curriculum]
        for word, given, others in (("case", spec.case, list(cases)), ("stage", spec.stage, stages)):
            if given is not None and given not in others:
                self._values.report_unknown(self._values.field(spec, word).span, word, given, others)
        expected = tuple(self._expected(spec.expect))
        steps = self._steps(spec, policy)
        if len(self._values.findings.errors) > known or policy is None:
            return None
        place = self._values.key_span(("tests", name))
        return ScenarioTest(name, place, policy, spec.episodes, spec.seed, steps, expected, spec.case, spec.stage)

    # Who acts, for how long

    def _policy(self, spec: TestSpec) -> str | None:
        name, known = spec.policy or "", [*self._scenario.scripts, *PLAIN_POLICIES]
        if name not in known and not (self._values.is_invalid("scripts") or self._values.is_invalid(name)):
            self._values.report_unknown(self._values.field(spec, "policy").span, "script", name, known)
        return name

    def _actions(self, spec: TestSpec) -> tuple[FixedAction, ...] | None:
        found = [self._action((*spec.path, "actions", index), given) for index, given in enumerate(spec.actions or ())]
        made = tuple(action for action in found if action is not None)
        return made if len(made) == len(found) else None

    def _action(self, place: Path, given: object) -> FixedAction | None:
        names = list(self._scenario.action)
        if not isinstance(given, dict):
            if len(names) > 1:
                help = f"write `{{{': ..., '.join(names)}: ...}}`"
                self._values.findings.add("DB103", self._values.span(place), f"one value for an action of {len(names)} parts", help=help)
                return None
            given = dict.fromkeys(names, given)
        return self._fixed(place, self._decisions.read(place, given, "the action"))

    def _fixed(self, place: Path, decided: tuple[ScriptedChoice | ScriptedRange, ...] | None) -> FixedAction | None:
        choices: list[int] = []
        ranges: list[float] = []
        words: list[str] = []
        for part, decision in zip(self._program.policy.action, decided or (), strict=False):
            if isinstance(part, Choices) and isinstance(decision, ScriptedChoice):
                choices.append([option.name for option in part.options].index(decision.otherwise))
                words.append(decision.otherwise)
            elif isinstance(part, ActionRange) and isinstance(decision, ScriptedRange):
                numbers = [number for value in decision.values for number in constant(value.typed) or (math.nan,)]
                if not all(map(math.isfinite, numbers)):
                    headline, help = (
                        f"`{part.name}` is not the same in every episode",
                        "give fixed values, or write a script under `scripts`",
                    )
                    self._values.findings.add("DB407", self._values.span(place), headline, help=help)
                    return None
                middle, half = (part.high + part.low) / 2, (part.high - part.low) / 2
                shares = [min(max((number - middle) / half, -1.0), 1.0) for number in numbers]
                shares *= decision.size if len(shares) == 1 else 1
                ranges += shares
                words += [f"{share:g}" for share in shares]
        return None if decided is None else FixedAction(tuple(choices), tuple(ranges), ":".join(words))

    def _steps(self, spec: TestSpec, policy: str | tuple[FixedAction, ...] | None) -> int:
        """The largest number of steps of an episode; a finding if all episodes of the test may take too many."""
        period = self._program.period
        own = Truncation(spec.max_steps, self._namespace.fixed(spec, "max_time")).max_episode_steps(period)
        steps = min(own, self._program.truncation.max_episode_steps(period), len(policy) if isinstance(policy, tuple) else own)
        total = steps * self._program.action_repeat * spec.episodes
        if total > MAX_STEPS and self._program.truncation != Truncation():
            help = "give fewer `episodes`, `max_steps` or `max_time`"
            headline = f"a test of {total:_} timesteps, which is more than {MAX_STEPS:_}"
            self._values.findings.add("DB105", self._values.key_span(spec.path), headline, help=help)
        return steps

    # What is expected

    def _expected(self, spec: Expectation) -> Iterator[Expected]:
        ends = self._scenario.termination
        endings = {"success_rate": ends.success or self._scenario.goal, "failure_rate": ends.failure}
        for key in _RATES:
            if getattr(spec, key) is not None:
                text = self._values.field(spec, key)
                bounds = self._bounds(spec, key)
                if not endings.get(key, True) and not any(map(self._values.is_invalid, ("success", "failure", "termination", "goal"))):
                    headline = NO_SUCCESS if key == "success_rate" else "a failure rate, but the scenario defines no failure"
                    help = f"add a condition under `termination.{key.removesuffix('_rate')}`, or expect something else, such as `ends_by`"
                    self._values.findings.add("DB407", text.span, headline, help=help)
                if bounds is not None:
                    yield Expected(key, text.span, text.text, *bounds)
        if spec.ends_by is not None:
            yield from self._ends_by(spec)
        for key in _CONDITIONS:
            given = getattr(spec, key)
            for index in range(len(given)) if isinstance(given, tuple) else (None,) if given is not None else ():
                yield from self._condition(key, (*spec.path, key) if index is None else (*spec.path, key, index))

    def _bounds(self, spec: Expectation, key: str) -> tuple[float, float] | None:
        """The smallest and the largest expected value; None after a finding."""
        text, scope = self._values.field(spec, key), self._namespace.scope(Context.FIXED)
        report, called = self._values.report(text), f"`{key}`"
        if ".." in text.text:
            found = self._values.range(text, scope)
            ends = found and expect_range(found, report, called, dimension=NUMBER)
            trees = [ends.low, ends.high] if ends else []
        else:
            typed = self._values.quantity(text, called, scope, NUMBER)
            trees = [typed] if typed else []
        numbers = [self._values.fixed(tree, text, called) for tree in trees]
        known = [float(number[0]) for number in numbers if number is not None]
        if not known or len(known) < len(trees):
            return None
        low, high = (*known, math.inf)[:2]
        if key != "mean_return" and not (0 <= low <= 1 and (high == math.inf or 0 <= high <= 1)):
            help = "a rate is from 0 to 1, or from 0 to 100 %"
            self._values.findings.add("DB105", text.span, f"{called} is {text.text}, which no episodes can reach", help=help)
            return None
        return low, high

    def _ends_by(self, spec: Expectation) -> Iterator[Expected]:
        termination, limits = self._scenario.termination, self._program.truncation
        cuts = [name for name in ("max_steps", "max_time") if getattr(limits, name) is not None]
        known = [*termination.success, *termination.failure, *cuts]
        several = isinstance(spec.ends_by, tuple)
        names = spec.ends_by if isinstance(spec.ends_by, tuple) else (spec.ends_by or "",)
        for index, name in enumerate(names):
            self._namespace.mark_used(name)
            if name not in known:
                place: Path = (*spec.path, "ends_by", index) if several else (*spec.path, "ends_by")
                self._values.report_unknown(self._values.span(place), "ending", name, known)
        yield Expected("ends_by", self._values.span((*spec.path, "ends_by")), " or ".join(names), endings=tuple(names))

    def _condition(self, key: ExpectedKey, place: Path) -> Iterator[Expected]:
        text = self._values.text(place)
        typed = self._values.condition(text, self._scope)
        if typed is not None:
            compared = tuple(
                Expression(text.text[part.start : part.end], text.span, text.text[part.start : part.end], part, text.owner)
                for part in _compared(typed)
            )
            yield Expected(key, text.span, text.text, condition=text.expression(typed), compared=compared[:_COMPARED])


def _compared(tree: Typed) -> Iterator[Typed]:
    """The single values that comparisons of a condition compare, except constants."""
    seen: set[tuple[int, int]] = set()
    for node in walk(tree):
        for part in node.args if isinstance(node, Operation) and node.operator in _COMPARISONS else ():
            single = part.type.components is None and not part.type.boolean
            if single and constant(part) is None and not isinstance(part, Constant) and (part.start, part.end) not in seen:
                seen.add((part.start, part.end))
                yield part
