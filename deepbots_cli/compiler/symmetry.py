"""The mirror symmetry of a task, `train.symmetry`: pairs of words in names, and numbers that change their
sign."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.values import ValueReader
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.program.task import ActionRange, Agent, Mirror, Symmetry, action_names
from deepbots_cli.scenario.training import Symmetry as SymmetrySpec

_PATH: NodePath = ("train", "symmetry")
_MAX_LISTED = 3
_PREVIOUS = "previous_action."


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
    return dict(zip((f"{_PREVIOUS}{name}" for name in action_names(agent.action)), acted, strict=True))


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
            factors.append(factor)
            offsets.append(offset)
        self._report_missing(section, missing, [number.name for number in numbers])
        for name, reason in list(wrong.items())[:1]:
            more = f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""
            self._values.add(
                "DB203",
                (*_PATH, "flip"),
                f"the mirror image of `{name}` is not possible{more}: {reason}",
                "list under `flip` both numbers of a pair, or none; truth values have no sign",
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
