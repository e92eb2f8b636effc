"""The levels of the curriculum: the values of the parameters in each level, and the endings after which a
world changes its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from deepbots_cli.compiler.namespace import Namespace, NamespaceReader
from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.scalar import Const, Draw, Scalar
from deepbots_cli.expressions.types import Context
from deepbots_cli.program import Program
from deepbots_cli.program.draws import EpisodeDraw
from deepbots_cli.program.levels import LIMITS, SUCCESS, Levels
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.training import Levels as LevelsSpec

_TOLERANCE = 1e-9
"""The tolerance for whole numbers, and for values beyond their interval, as a share of the interval."""


def levels(namespace: Namespace, program: Program) -> Levels | None:
    """Return the levels of the curriculum of a program; None without levels, after a finding, and if a
    parameter has one value: a training with `--set level=5` plays one level."""
    spec = namespace.scenario.levels
    return None if spec is None else _LevelsReader(namespace, program, spec).levels()


class _LevelsReader(NamespaceReader):
    def __init__(self, namespace: Namespace, program: Program, spec: LevelsSpec) -> None:
        super().__init__(namespace)
        self._program = program
        self._levels = spec

    def levels(self) -> Levels | None:
        spec = self._levels
        errors_before = len(self._values.findings.errors)
        values = {name: self._values_of(name) for name in spec.set}
        per_world = self._per_world(spec.per_world) if spec.per_world is not None else None
        start = self._start()
        up, down = self._outcomes("up"), self._outcomes("down")
        shared = sorted(up & down - {SUCCESS})
        if shared:
            headline = f"after `{shared[0]}` a world cannot be one level higher and one level lower"
            help = f"remove `{shared[0]}` from `up` or `down`, or name the single endings"
            self._values.add("DB407", (*spec.path, "down"), headline, help)
        if len(self._values.findings.errors) > errors_before or start is None or None in values.values():
            return None
        return Levels(
            spec.levels,
            tuple((name, numbers) for name, numbers in values.items() if numbers is not None),
            start,
            frozenset(up),
            frozenset(down),
            spec.at_top == "random",
            per_world,
        )

    # The values of a parameter

    def _values_of(self, name: str) -> tuple[float, ...] | None:
        """Return the value of a parameter in each level; None after a finding."""
        path: NodePath = (*self._levels.path, "set", name)
        help = f"draw it from all levels, for example `{name}: uniform({self._values.text(path).text})`"
        entry = self._draw(name, self._values.key_span(path), help)
        if entry is None:
            return None
        parameter = self._parameter(name)
        if parameter is None:
            return None
        text = self._values.text(path)
        ends = self._values.ends(
            text,
            f"`{name}`",
            self._namespace.scope(Context.FIXED),
            dimension=parameter.typed.type.dimension,
            falling=True,
        )
        if ends is None:
            return None
        (low,) = ends.low
        (high,) = ends.high
        last = self._levels.levels - 1
        # `low + (high - low)` may miss `high` by rounding.
        numbers = (*(low + (high - low) * level / last for level in range(last)), high)
        return numbers if self._is_drawable(entry, parameter, numbers, path) else None

    def _parameter(self, name: str) -> Expression | None:
        parameter = name.partition(".")[0]
        return next((value for value in self._program.parameters if value.name == parameter), None)

    def _draw(self, name: str, span: Span, if_fixed: str) -> EpisodeDraw | None:
        """Return the draw of a parameter; None after a finding, whose help is `if_fixed` for a parameter with
        one value."""
        draws = [entry for entry in self._program.draws.entries if entry.is_parameter]
        entry = next((entry for entry in draws if entry.name == name), None)
        if entry is not None and not entry.changes:
            return entry
        if entry is not None:
            help = f"draw it once for each episode: remove `every` from `{name}`"
            self._values.add("DB407", span, f"`{name}` changes within an episode", help)
        elif name not in self._spec.parameters:
            self._values.report_unknown(
                span,
                "parameter",
                name,
                list(dict.fromkeys([*self._spec.parameters, *(entry.name for entry in draws)])),
            )
        elif components := [entry.name for entry in draws if entry.name.startswith(f"{name}.")]:
            help = f"set its components: {', '.join(f'`{component}`' for component in components)}"
            self._values.add("DB404", span, f"`{name}` is a vector", help)
        elif self._parameter(name) is not None:
            help = "name those in place of it"
            self._values.add("DB407", span, f"`{name}` is computed from other parameters", help)
        elif not self._is_assigned(name) and not self._values.is_invalid(name):
            self._values.add("DB205", span, f"`{name}` has one value in all episodes", if_fixed)
        return None

    def _is_assigned(self, name: str) -> bool:
        """Return whether `--set` gives the parameter its value."""
        return self._values.span(("parameters", name)).source.assigned is not None

    def _is_drawable(
        self, entry: EpisodeDraw, parameter: Expression, numbers: tuple[float, ...], path: NodePath
    ) -> bool:
        """Return whether an episode of the scenario could draw each of the numbers, else after a finding."""
        name, tree = entry.name, entry.tree
        low, high = parameter.typed.type.interval
        kind = tree.distribution if isinstance(tree, Draw) else ""
        if kind == "choice" and isinstance(tree, Draw):
            options = [option.value for option in tree.args if isinstance(option, Const)]
            missing = [
                number
                for number in numbers
                if not any(abs(number - option) <= _TOLERANCE * abs(option) for option in options)
            ]
            if missing:
                headline = f"a level has `{name}` = {missing[0]:g}, which is none of its choices"
                help = f"draw a number in place of a choice: `{name}: integer(0 .. 9)`"
                self._values.add("DB105", path, headline, help)
            return not missing
        if kind == "integer" and any(abs(number - round(number)) > _TOLERANCE for number in numbers):
            count = round(abs(numbers[-1] - numbers[0])) + 1
            headline = f"{len(numbers)} levels do not divide the range into whole numbers"
            ends = f"{numbers[0]:g} .. {numbers[-1]:g}"
            help = f"write `levels: {count}` for {ends}, or draw `{name}` from a `uniform` range"
            self._values.add("DB105", path, headline, help)
            return False
        beyond = [
            number
            for number in numbers
            if not low - _TOLERANCE * abs(low) <= number <= high + _TOLERANCE * abs(high)
        ]
        if beyond:
            headline = f"a level has `{name}` = {beyond[0]:g}, but the scenario draws {low:g} to {high:g}"
            help = "keep the range within it, or draw the parameter from a wider range"
            self._values.add("DB105", path, f"{headline} (SI units)", help)
        return not beyond

    def _per_world(self, name: str) -> tuple[str, tuple[float, ...]] | None:
        """Return a parameter and its values, of which each world has one; None after a finding."""
        path: NodePath = (*self._levels.path, "per_world")
        help = f"draw it, for example `{name}: integer(0 .. 5)`, or remove `per_world`"
        entry = self._draw(name, self._values.span(path), help)
        if entry is None:
            return None
        values = _finite_values(entry.tree)
        help = ""
        if name in self._levels.set:
            headline = f"`{name}` has a value in each level, so a world cannot keep one"
            help = f"remove `{name}` from `set` or from `per_world`"
        elif not values:
            headline = f"`{name}` is not drawn from single values, which the worlds could have in turn"
            help = f"draw `{name}` from whole numbers or choices: `integer(0 .. 5)`, `choice(1 | 2 | 3)`"
        elif self._spec.train is not None and self._spec.train.environments < len(values):
            worlds = self._spec.train.environments
            headline = f"`{name}` has {len(values)} values, but the training has only {worlds} environments"
            help = f"write `train.environments: {len(values)}` or a multiple, or remove `per_world`"
        if help:
            self._values.add("DB407", path, headline, help)
            return None
        return entry.name, tuple(map(float, values))

    # The level of a world

    def _start(self) -> tuple[int, int] | None:
        """Return the lowest and the highest first level; None after a finding."""
        text = self._values.field(self._levels, "start")
        scope = self._namespace.scope(Context.FIXED)
        if ".." in text.text:
            ends = self._values.ends(text, "`start`", scope, dimension=NUMBER, falling=True)
            bounds = None if ends is None else (ends.low[0], ends.high[0])
        else:
            typed = self._values.quantity(text, "`start`", scope, NUMBER)
            number = typed and self._values.fixed(typed, text, "`start`")
            bounds = (float(number[0]), float(number[0])) if number else None
        if bounds is None:
            return None
        low, high = bounds
        if not (low.is_integer() and high.is_integer() and 0 <= low <= high < self._levels.levels):
            help = f"write a level from 0 to {self._levels.levels - 1}, or a range such as `0 .. 2`"
            self._values.add("DB105", text.span, f"`start` is {text.text}, which is not a level", help)
            return None
        return int(low), int(high)

    def _outcomes(self, key: Literal["up", "down"]) -> set[str]:
        """Return the outcomes that a key names."""
        value = getattr(self._levels, key)
        names = value if isinstance(value, tuple) else (value,)
        outcomes: set[str] = set()
        for index, name in enumerate(names if value is not None else ()):
            path: NodePath = (*self._levels.path, key, *([index] if isinstance(value, tuple) else []))
            outcomes |= self._outcomes_of(name, path)
        return outcomes

    def _outcomes_of(self, name: str, path: NodePath) -> set[str]:
        """Return the outcomes of a name; none after a finding."""
        termination, truncation = self._spec.termination, self._spec.truncation
        limits = {limit for limit in LIMITS if getattr(truncation, limit, None) is not None}
        success = {*termination.success, *({SUCCESS} if self._spec.goal else ())}
        success |= {*truncation.success} if truncation is not None else set()
        failure = {*termination.failure}
        groups = {
            "success": success,
            "failure": failure,
            "termination": success - {SUCCESS} | failure,
            "truncation": limits,
        }
        single = {*termination.success, *termination.failure, *limits}
        self._namespace.mark_used(name)
        if name in groups:
            outcomes = groups[name]
            if not outcomes and not self._values.is_invalid("termination"):
                defined = "a limit under `truncation`" if name == "truncation" else f"`termination.{name}`"
                if name == "termination":
                    defined = "an ending under `termination`"
                help = f"define {defined}, or name another ending"
                self._values.add("DB407", path, f"no episode of the scenario ends by `{name}`", help)
            return outcomes
        if name not in single and not self._values.is_invalid("termination"):
            self._values.report_unknown(self._values.span(path), "ending", name, [*groups, *sorted(single)])
        return {name}


def _finite_values(tree: Scalar | None) -> Sequence[float]:
    """Return the values of a draw of whole numbers or of a choice, as often as it names them; none of another
    expression."""
    if not isinstance(tree, Draw):
        return ()
    numbers = [argument.value for argument in tree.args if isinstance(argument, Const)]
    if len(numbers) < len(tree.args):
        return ()
    if tree.distribution == "integer":
        low, high = numbers
        return range(round(low), round(high) + 1)
    return numbers if tree.distribution == "choice" else ()
