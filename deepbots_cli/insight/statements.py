"""Sentences with their evidence, the form of every row in the two tables, and the templates of pages.

A row is a condition, a sentence with fields for numbers, and these numbers. There is no sentence without its
numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Any, Generic, TypeVar

from deepbots_cli.expressions.dimensions import ONE, Unit
from deepbots_cli.learning.runs.statistics import wilson
from deepbots_cli.records import dataclass
from deepbots_cli.words import number_text, rate_text, sentence_list

Numbers = Mapping[str, Any]
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class StatementRule(Generic[T]):
    """A row of a table.

    Attributes:
        name: The cause.
        title: The cause in a few words, with the same fields; causes have one.
        text: The sentence, with a field in braces for each number.
        numbers: Returns the numbers, or None where the row does not apply. They may be more than the sentence
            shows; the entries `settings` and `command` become those of the statement, and the entry
            `likelihood` replaces that of the row.
        when: The condition of the row; `numbers` is called only where it is true.
        advice: The advice, with the same fields; may be empty.
        likelihood: The number from 0 to 1 that orders causes.
        command: The command that shows more of a cause for which no value under `train` is advised.
        explains: The causes that this one implies, which are then not listed: a policy that repeats the
            action that pays most is not reported as exploring too little.
        is_symptom: Whether the cause is only a symptom beside one that is certain.
        is_provisional: Whether a young training may still outgrow it. It becomes a cause when the training or
            the stage is mature, or when it is certain.
    """

    name: str
    text: str
    numbers: Callable[[T], Numbers | None]
    when: Callable[[T], object] = lambda subject: True
    advice: str = ""
    title: str = ""
    likelihood: float | None = None
    command: str = ""
    explains: tuple[str, ...] = ()
    is_symptom: bool = False
    is_provisional: bool = False

    def evidence(self, subject: T) -> Numbers | None:
        """Return the numbers, with the likelihood of a cause; None where the row does not apply."""
        numbers = self.numbers(subject) if self.when(subject) else None
        if numbers is None or self.likelihood is None:
            return numbers
        return {"likelihood": self.likelihood, **numbers}


@dataclass(frozen=True)
class Statement:
    """A sentence with the numbers of its evidence, and for a cause a title of a few words.

    `settings` are the advised values of the scenario: the value as text, by the path of its setting.
    `command` is the next command to run.
    """

    cause: str
    text: str
    advice: str
    evidence: Mapping[str, Any]
    settings: Mapping[str, str] = field(default_factory=dict)
    command: str = ""
    title: str = ""

    def as_json(self) -> dict[str, Any]:
        further = {"advice": self.advice, "settings": self.settings, "command": self.command}
        return {
            "cause": self.cause,
            "text": self.text,
            **{name: value for name, value in further.items() if value},
            "evidence": self.evidence,
        }


class Percentage(float):
    """A fraction, shown in per cent."""


class SuccessRate(dict[str, Any]):
    """The success rate of some episodes, with Wilson's 95 % interval; shown as `52% (46% to 58%) of 240
    episodes`."""

    def __init__(self, successes: Sequence[float]) -> None:
        count, episodes = int(sum(successes)), len(successes)
        interval = wilson(count, episodes) if episodes else (0.0, 1.0)
        super().__init__(successes=count, episodes=episodes, rate=count / max(1, episodes), interval=interval)

    @staticmethod
    def of(episodes: Sequence[Any]) -> SuccessRate:
        """Return the rate of episodes, run again or of an evaluation, by their `is_success`."""
        return SuccessRate([episode.is_success for episode in episodes])

    @staticmethod
    def counted(successes: int, episodes: int) -> SuccessRate:
        return SuccessRate([1.0] * successes + [0.0] * (episodes - successes))

    @property
    def rate(self) -> float:
        return float(self["rate"])

    @property
    def low(self) -> float:
        """The lower end of the interval."""
        return float(self["interval"][0])

    @property
    def high(self) -> float:
        return float(self["interval"][1])

    @property
    def episodes(self) -> int:
        return int(self["episodes"])

    def __str__(self) -> str:
        rate, low, high = (rate_text(share) for share in (self.rate, self.low, self.high))
        return f"{rate} ({low} to {high}) of {self.episodes:,} episodes"


class EvaluationRate(SuccessRate):
    """The successes in some evaluations of a training; shown as `52% of the episodes in 12 evaluations`.

    Evaluations repeat their starts while the policy changes, so an interval over all episodes would be too
    narrow.
    """

    def __init__(self, evaluations: Sequence[Sequence[float]]) -> None:
        super().__init__([success for successes in evaluations for success in successes])
        self["evaluations"] = len(evaluations)

    def __str__(self) -> str:
        if self["evaluations"] < 2:
            return super().__str__()
        return f"{rate_text(self.rate)} of the episodes in {self['evaluations']} evaluations"


def statements_about(rules: Sequence[StatementRule[T]], subject: T) -> list[Statement]:
    """Return the statements of the rows that apply, in the order of the table."""
    statements = []
    for rule in rules:
        evidence = rule.evidence(subject)
        if evidence is not None:
            texts = {key: _shown(value) for key, value in evidence.items()}
            further = {"settings": evidence.get("settings", {}), "command": evidence.get("command", "")}
            sentence, remedy, title = (
                form.format(**texts).strip() for form in (rule.text, rule.advice, rule.title)
            )
            statements.append(
                Statement(
                    rule.name,
                    sentence,
                    remedy,
                    {key: value for key, value in evidence.items() if key not in further},
                    **further,
                    title=title,
                )
            )
    return statements


def _shown(value: Any) -> str:
    match value:
        case Percentage():
            return rate_text(value)
        case float():
            return number_text(value, 3)
        case int() if not isinstance(value, bool):
            return f"{value:,}"
        case _:
            return str(value)


def quantity_text(value: float, unit: Unit, digits: int = 4) -> str:
    """Return a number, given in SI units, in a unit of `ShownUnits`, such as `15.3 deg`."""
    return f"{number_text(unit.from_si(value), digits)}{'' if unit.text == ONE.text else f' {unit.text}'}"


MAX_LISTED = 4
"""The largest number of terms, options and numbers of the observation in one sentence."""


def sentence(words: str) -> str:
    """Return words with a capital letter at their beginning."""
    return words[0].upper() + words[1:]


def list_text(parts: Sequence[str], limit: int = MAX_LISTED) -> str:
    """Return parts as a list in words: `a, b and c`, or `a, b and 7 more` if there are more than `limit`."""
    return sentence_list([*parts[:limit], *([f"{len(parts) - limit} more"] if len(parts) > limit else [])])


_ENTITIES = {ord(sign): f"&#{ord(sign)};" for sign in "\\`*{}[]<>#!|~&"}
"""The characters with a meaning in Markdown or HTML, as HTML writes them."""


def plain_markdown(text: str) -> str:
    """Return a text from an untrusted file as one line of Markdown without markup, links and HTML. Addresses,
    which many renderers make links, are code."""
    # An underscore between letters or digits, as in a name, has no meaning.
    words = [
        f"`{re.sub('[`|]', '', word)}`"
        if re.search(r"://|www\.|@", word, re.IGNORECASE)
        else re.sub(r"(?<![^\W_])_|_(?![^\W_])", "&#95;", word.translate(_ENTITIES))
        for word in text.split()
    ]
    return re.sub(r"^(\d*)([-+=.)])", lambda match: f"{match[1]}&#{ord(match[2])};", " ".join(words))


def render_template(template: str, *, html: bool = False, **values: Any) -> str:
    """Return the text of a template of this package."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("deepbots_cli.insight", "."), undefined=StrictUndefined, autoescape=html,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["plain"] = plain_markdown
    return environment.get_template(template).render(**values)
