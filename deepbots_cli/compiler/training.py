"""Levels of the curriculum (the values of the parameters in each level, and the endings after which a world
changes its own) and the mirror symmetry of a task, `train.symmetry`: pairs of words in names, and numbers
that change their sign."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from math import inf
from typing import Literal, NamedTuple

from deepbots_cli.compiler.namespace import Namespace, NamespaceReader
from deepbots_cli.compiler.values import ValueReader
from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Const, Draw, Scalar
from deepbots_cli.expressions.types import Context
from deepbots_cli.program import Program
from deepbots_cli.program.resets import EpisodeDraw
from deepbots_cli.program.task import (
    LIMITS,
    SUCCESS,
    ActionRange,
    Agent,
    Levels,
    Mirror,
    Symmetry,
    action_names,
)
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.training import MAX_ENVIRONMENTS, MAX_LEVELS
from deepbots_cli.scenario.training import Levels as LevelsSpec
from deepbots_cli.scenario.training import Symmetry as SymmetrySpec

_TOLERANCE = 1e-9
"""The tolerance for whole numbers, and for values beyond their interval, as a share of the interval."""


def levels(namespace: Namespace, program: Program) -> Levels | None:
    """Return the levels of the curriculum of a program; None without levels, after a finding, and if each
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
        shared = sorted(up & down)
        if shared:
            self._values.add(
                "DB407",
                (*spec.path, "down"),
                f"after `{shared[0]}` a world cannot be one level higher and one level lower",
                f"remove `{shared[0]}` from `up` or `down`, or name the single endings",
            )
        drawn = tuple((name, numbers) for name, numbers in values.items() if numbers is not None)
        if len(self._values.findings.errors) > errors_before or start is None or not drawn:
            return None
        return Levels(
            spec.levels,
            drawn,
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
        component = name.partition(".")[2]
        return self._drawable(entry, parameter.typed.type.interval_of(component), numbers, path)

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
        elif not self._is_assigned(name) and not self._is_invalid(name):
            self._values.add("DB205", span, f"`{name}` has one value in all episodes", if_fixed)
        return None

    def _is_invalid(self, name: str) -> bool:
        """Return whether the definition of a parameter had a finding."""
        symbol = self._namespace.resolve(name)
        return self._values.is_invalid(name) or (symbol is not None and symbol.type is None)

    def _is_assigned(self, name: str) -> bool:
        """Return whether `--set` gives the parameter its value."""
        return self._values.span(("parameters", name)).source.assigned is not None

    def _drawable(
        self, entry: EpisodeDraw, interval: Interval, numbers: tuple[float, ...], path: NodePath
    ) -> tuple[float, ...] | None:
        """Return the values of the levels, without the rounding of choices and whole numbers; None after a
        finding, if an episode of the scenario could not draw one of them."""
        name, tree = entry.name, entry.tree
        low, high = interval
        kind = tree.distribution if isinstance(tree, Draw) else ""
        if kind == "choice" and isinstance(tree, Draw):
            options = [option.value for option in tree.args if isinstance(option, Const)]
            tolerance = _TOLERANCE * max(map(abs, options), default=0.0)
            values = tuple(_nearest(options, number) for number in numbers)
            pairs = zip(numbers, values, strict=True)
            missing = [number for number, value in pairs if abs(number - value) > tolerance]
            if missing:
                headline = f"a level has `{name}` = {missing[0]:g}, which is none of its choices"
                help = f"draw a number in place of a choice: `{name}: integer(0 .. 9)`"
                self._values.add("DB105", path, headline, help)
                return None
            return values
        if kind == "integer":
            values = tuple(float(round(number)) for number in numbers)
            if any(abs(number - value) > _TOLERANCE for number, value in zip(numbers, values, strict=True)):
                self._report_fractions(name, numbers, path)
                return None
            numbers = values
        beyond = [
            number
            for number in numbers
            if not low - _TOLERANCE * abs(low) <= number <= high + _TOLERANCE * abs(high)
        ]
        if beyond:
            headline = f"a level has `{name}` = {beyond[0]:g}, but the scenario draws {low:g} to {high:g}"
            help = "keep the range within it, or draw the parameter from a wider range"
            self._values.add("DB105", path, f"{headline} (SI units)", help)
            return None
        return numbers

    def _report_fractions(self, name: str, numbers: tuple[float, ...], path: NodePath) -> None:
        """Report levels of a parameter of whole numbers that have fractions."""
        first, last = round(numbers[0]), round(numbers[-1])
        if max(abs(numbers[0] - first), abs(numbers[-1] - last)) > _TOLERANCE:
            headline = f"`{name}` is a whole number, but the ends of its range are not"
            help = f"write whole ends, or draw `{name}` from a `uniform` range"
        else:
            headline = f"{len(numbers)} levels do not divide the range into whole numbers"
            count = max(step + 1 for step in range(1, MAX_LEVELS) if (last - first) % step == 0)
            help = f"write `levels: {count}` for {first} .. {last}, or draw `{name}` from a `uniform` range"
        self._values.add("DB105", path, headline, help)

    def _per_world(self, name: str) -> tuple[str, tuple[float, ...]] | None:
        """Return a parameter and its values, of which each world has one; None after a finding."""
        path: NodePath = (*self._levels.path, "per_world")
        help = f"draw it, for example `{name}: integer(0 .. 5)`, or remove `per_world`"
        entry = self._draw(name, self._values.span(path), help)
        if entry is None:
            return None
        values = _finite_values(entry.tree)
        # `len` of a range fails beyond 2^63.
        count = values.stop - values.start if isinstance(values, range) else len(values)
        help = ""
        if name in self._levels.set:
            headline = f"`{name}` has a value in each level, so a world cannot keep one"
            help = f"remove `{name}` from `set` or from `per_world`"
        elif not values:
            headline = f"`{name}` is not drawn from single values, which the worlds could have in turn"
            help = f"draw `{name}` from whole numbers or choices: `integer(0 .. 5)`, `choice(1 | 2 | 3)`"
        elif count > MAX_ENVIRONMENTS:
            most = MAX_ENVIRONMENTS
            headline = f"`{name}` has {count} values, but a training has at most {most} environments"
            help = f"draw `{name}` from fewer values, or remove `per_world`"
        elif self._spec.train is not None and self._spec.train.environments < count:
            worlds = self._spec.train.environments
            headline = f"`{name}` has {count} values, but the training has only {worlds} environments"
            help = f"write `train.environments: {count}` or a multiple, or remove `per_world`"
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
            self._values.add(
                "DB105",
                text.span,
                f"`start` is {text.text}, which is not a level",
                f"write a level from 0 to {self._levels.levels - 1}, or a range such as"
                f" `0 .. {self._levels.levels - 1}`",
            )
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
            "termination": {*termination.success} | failure,
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
                self._values.add(
                    "DB407",
                    path,
                    f"no episode of the scenario ends by `{name}`",
                    f"define {defined}, or name another ending",
                )
            return outcomes
        if name not in single and not self._values.is_invalid("termination"):
            self._values.report_unknown(self._values.span(path), "ending", name, [*groups, *sorted(single)])
        return {name}


def _nearest(options: Iterable[float], number: float) -> float:
    return float(min(options, key=lambda option: abs(option - number), default=inf))


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


# Symmetry


_PATH: NodePath = ("train", "symmetry")
_MAX_LISTED = 3


class RangedName(NamedTuple):
    """A number with a name: where it is in time, its unit, and its range, which maps to [-1, 1]. A truth
    value has no range."""

    name: str
    steps_ago: int
    unit: str
    low: float
    high: float
    is_truth: bool = False


def symmetry(namespace: Namespace, agent: Agent) -> Symmetry | None:
    """Return the symmetry of the training of an agent; None without one, and after a finding."""
    spec = namespace.scenario.train
    symmetry_spec = None if spec is None else spec.symmetry
    if symmetry_spec is None or agent.training is None:
        return None
    if namespace.values.findings.errors:
        return None  # a name that another mistake has left out is not a mistake of the symmetry
    reader = _SymmetryReader(symmetry_spec, namespace.values, _acted_before(agent))
    if not reader.is_inverse:
        return None
    if agent.goal is not None or agent.images:
        subject = "a `goal`" if agent.goal is not None else "pictures"
        namespace.values.add(
            "DB612", _PATH, f"`symmetry` does not know the mirror image of {subject}", "remove `symmetry`"
        )
        return None
    observed = [
        RangedName(entry.name, entry.steps_ago, entry.unit, entry.low, entry.high, entry.truth)
        for entry in agent.inputs
    ]
    acted = [
        RangedName(name, 0, part.unit, part.low, part.high) for part in agent.ranges for name in part.names
    ]
    choices = {part.name: [option.name for option in part.options] for part in agent.choices}
    section = "observation with the critic" if agent.critic else "observation"
    observation, ranges = reader.mirror(section, observed), reader.mirror("action", acted)
    options = reader.options(choices)
    reader.check_flips([entry.name for entry in (*observed, *acted)])
    if observation is None or ranges is None or options is None:
        return None
    sources = [reader.image(name) for name in choices]
    return Symmetry(observation, ranges, tuple(list(choices).index(name) for name in sources), options)


def words_pattern(words: Iterable[str]) -> re.Pattern[str]:
    """Return a pattern that finds words. A word ends at `_`, at `.` and at the ends of a name."""
    # A regular expression takes the first alternative that fits: `left_hand` must precede `left`.
    alternatives = "|".join(map(re.escape, sorted(words, key=len, reverse=True)))
    # `_` separates words, which `\b` takes for a letter.
    return re.compile(rf"(?<![A-Za-z0-9])(?:{alternatives})(?![A-Za-z0-9])")


def _acted_before(agent: Agent) -> dict[str, str]:
    """Return the number of the action that each number of a previous action repeats:
    `previous_action.left` of an only range `speed` repeats `speed.left`."""
    acted = [
        name
        for part in agent.action
        for name in (
            part.names if isinstance(part, ActionRange) else (option.name for option in part.options)
        )
    ]
    return dict(zip((f"previous_action.{name}" for name in action_names(agent.action)), acted, strict=True))


class _SymmetryReader:
    """Finds mirror images of names. `is_inverse` is false after a finding about the pairs of words."""

    def __init__(self, spec: SymmetrySpec, values: ValueReader, acted_before: Mapping[str, str]) -> None:
        self._values = values
        self._flips = spec.flip
        self._acted_before = acted_before
        self._words: dict[str, str] = {}
        self.is_inverse = True
        for word, opposite in spec.swap.items():
            for original, image in ((word, opposite), (opposite, word)):
                if self._words.setdefault(original, image) != image:
                    self.is_inverse = False
                    self._values.add(
                        "DB202",
                        (*_PATH, "swap", word),
                        f"`{original}` has two mirror images, `{self._words[original]}` and `{image}`",
                        "write each word in one pair; a mirror image of a mirror image is the original",
                    )
        self._pattern = words_pattern(self._words) if self._words else None

    def image(self, name: str) -> str:
        """Return the name of the mirror image: each word of a pair is replaced by the other one."""
        if self._pattern is None:
            return name
        return self._pattern.sub(lambda match: self._words[match[0]], name)

    def _changes_sign(self, name: str) -> bool:
        """Return whether a number is listed under `flip`; a previous action has the sign of the action."""
        names = (name, self._acted_before.get(name, name))
        return any(fnmatchcase(candidate, pattern) for pattern in self._flips for candidate in names)

    def mirror(self, section: str, numbers: Sequence[RangedName]) -> Mirror | None:
        """Return the mirror image of numbers; None after a finding."""
        indices = {(number.name, number.steps_ago): index for index, number in enumerate(numbers)}
        sources: list[int] = []
        factors: list[float] = []
        offsets: list[float] = []
        missing: dict[str, str] = {}
        wrong: dict[str, str] = {}
        for number in numbers:
            image = self.image(number.name)
            index = indices.get((image, number.steps_ago))
            if index is None:
                missing[number.name] = image
                continue
            image_number = numbers[index]
            if reason := self._reason_against(number, image_number):
                wrong[number.name] = reason
                continue
            sign = -1.0 if self._changes_sign(number.name) else 1.0
            sources.append(index)
            factor, offset = (1.0, 0.0) if number.is_truth else _between_ranges(number, image_number, sign)
            if section == "action" and max(abs(abs(factor) - 1.0), abs(offset)) > _TOLERANCE:
                wrong[number.name] = f"its range, mirrored, is not that of `{image}`"
            factors.append(factor)
            offsets.append(offset)
        self._report_missing(section, missing, [number.name for number in numbers])
        for name, reason in list(wrong.items())[:1]:
            more = f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""
            self._values.add(
                "DB203",
                (*_PATH, "flip"),
                f"the mirror image of `{name}` is not possible{more}: {reason}",
                "list under `flip` both numbers of a pair, or none; truth values have no sign, and a single"
                " action that changes its sign needs a range such as -1 .. 1",
            )
        if missing or wrong:
            return None
        return Mirror(tuple(sources), tuple(factors), tuple(offsets))

    def _reason_against(self, number: RangedName, image_number: RangedName) -> str:
        """Return why two numbers are not mirror images of each other; empty if they may be."""
        if (number.unit, number.is_truth) != (image_number.unit, image_number.is_truth):
            return f"`{image_number.name}` is another kind of value"
        if self._changes_sign(number.name) != self._changes_sign(image_number.name):
            return f"only one of them and `{image_number.name}` changes its sign"
        if number.is_truth and self._changes_sign(number.name):
            return "a truth value cannot change its sign"
        return ""

    def _report_missing(self, section: str, missing: Mapping[str, str], names: Sequence[str]) -> None:
        """Report numbers whose mirror image is not in the section, which has these names."""
        if not missing:
            return
        name, image = next(iter(missing.items()))
        more = f", and of {len(missing) - 1} more there is none either" if len(missing) > 1 else ""
        self._values.add(
            "DB201",
            (*_PATH, "swap"),
            f"the {section} has no `{image}`, the mirror image of `{name}`{more}",
            self._swapped_values(name, missing)
            or self._longer_words(name, names)
            or f"change the words under `swap`, or add `{image}` to the {section}",
        )

    def _swapped_values(self, name: str, missing: Mapping[str, str]) -> str:
        """Return the help where the components of two values change places, as those of `left` and `right`;
        empty for other names."""
        value, _, component = missing[name].partition(".")
        others = [other.partition(".")[0] for other in missing if other.partition(".")[2] == component]
        if not component or len(others) != 1 or others[0] == value:
            return ""
        return f"if `{value}` and `{others[0]}` change places, add `{value}: {others[0]}` to `swap`"

    def _longer_words(self, name: str, names: Sequence[str]) -> str:
        """Return the help where a word of a name without mirror image is a part of names that have one; empty
        for other names."""
        words = self._pattern.findall(name) if self._pattern else []
        for candidate in names:
            image = self.image(candidate)
            pairs = zip(candidate.split("."), image.split("."), strict=False)
            shared = set(words) & set(self._pattern.findall(candidate)) if self._pattern else set()
            part, part_image = next((pair for pair in pairs if pair[0] != pair[1]), ("", ""))
            if shared and image in names and part not in self._words:
                return (
                    f"`{min(shared)}` under `swap` is a word of `{name}` too: write whole parts of the names"
                    f" that change places, such as `{part}: {part_image}`"
                )
        return ""

    def options(self, choices: Mapping[str, Sequence[str]]) -> tuple[tuple[int, ...], ...] | None:
        """Return for each choice the mirror image of each option of its source; None after a finding."""
        tables: list[tuple[int, ...]] = []
        for name, options in choices.items():
            source = choices.get(self.image(name))
            images = [self.image(option) for option in source or ()]
            missing = [image for image in images if image not in options]
            if source is None or missing or len(images) != len(options):
                lacking = f"no option `{missing[0]}`" if missing else f"no mirror image `{self.image(name)}`"
                self._values.add(
                    "DB201",
                    (*_PATH, "swap"),
                    f"the action `{name}` has {lacking}",
                    "change the words under `swap`, or name the options of the action in pairs",
                )
                return None
            tables.append(tuple(options.index(image) for image in images))
        return tuple(tables)

    def check_flips(self, names: Sequence[str]) -> None:
        """Report patterns that match no number."""
        for index, pattern in enumerate(self._flips):
            if not any(fnmatchcase(name, pattern) for name in names):
                listed = ", ".join(f"`{name}`" for name in names[:_MAX_LISTED])
                self._values.add(
                    "DB206",
                    (*_PATH, "flip", index),
                    f"`{pattern}` matches no number of the observation or the action",
                    f"write names such as {listed}, or patterns such as `*_hip_joint`",
                )


def _between_ranges(number: RangedName, image_number: RangedName, sign: float) -> tuple[float, float]:
    """Return factor and offset from the other number, scaled to [-1, 1], to this one."""
    middles = [(entry.low + entry.high) / 2.0 for entry in (number, image_number)]
    halves = [(entry.high - entry.low) / 2.0 for entry in (number, image_number)]
    # Adding 0.0 turns -0.0 into 0.0.
    return sign * halves[1] / halves[0], (sign * middles[1] - middles[0]) / halves[0] + 0.0
