"""The reference of the site, from the tables of the language, so that it cannot go stale.

keys.md      every key of a scenario, from the schema
functions.md units, functions and built-in names, from the expression language
rules.md     every finding, from the registry of rules and the docstrings of lint rules
commands.md  every command with its options, from the help of the commands
glossary.md  terms of reinforcement learning and their place in the language, from the glossary of `deepbots
explain`

The page isaac-lab.md has the terms of `deepbots_cli/scenario/isaac_lab.json`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from inspect import cleandoc
from pathlib import Path
from typing import Any

import typer

from deepbots_cli.cli.command import Commands
from deepbots_cli.cli.commands import GROUPS
from deepbots_cli.cli.explanations import topics
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, NUMBER, TIME, UNITS
from deepbots_cli.expressions.functions import ALLOWED_FAMILIES, FUNCTIONS, Family, Function
from deepbots_cli.expressions.types import Context, Kind
from deepbots_cli.learning.sb3.defaults import DEFAULTS, library_defaults, library_of
from deepbots_cli.lint.pages import RulePage, every_page
from deepbots_cli.scenario.base import (
    Forms,
    Kinds,
    ListOf,
    MappingOf,
    Section,
    Shape,
    section_fields,
    unit_of,
)
from deepbots_cli.scenario.documentation import (
    TERMS_FILE,
    default_of,
    example_of,
    key_description,
    section_description,
)
from deepbots_cli.scenario.fields import FieldType
from deepbots_cli.scenario.quantities import Expression, Quantity
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import PythonTerm
from deepbots_cli.scenario.training import ALGORITHMS

DOCS = Path(__file__).parent
Route = tuple[str, ...]


def pages() -> dict[str, str]:
    """Return the text of each page by its path in the repository; only the site has them."""
    return {
        "docs/reference/keys.md": _Keys().text(),
        "docs/reference/functions.md": _functions(),
        "docs/reference/rules.md": _rules(),
        "docs/reference/commands.md": _commands(),
        "docs/reference/glossary.md": _glossary(),
        "docs/isaac-lab.md": _isaac_lab(),
    }


# Keys


class _Keys:
    """Walks the schema in the order of the file; a part is described where it is first met."""

    def __init__(self) -> None:
        self._met: set[type[Section]] = {PythonTerm}

    def text(self) -> str:
        head = [
            "# Every key of a scenario",
            "",
            "`NAME` stands for a name of your choice. The column *known* says when deepbots knows a value:"
            " *fixed* values are"
            " constants, *episode* values may be drawn at each reset, and *step* values are computed in each"
            " timestep.",
            "Values are stored in SI units; the unit 1 is a plain number. [Units](../units.md) describes how"
            " values are written."
            " The tests insert each example into a suitable scenario and run it.",
        ]
        return "\n".join([*head, *self._section("scenario", Scenario, ()), *_defaults()]) + "\n"

    def _section(self, title: str, part: type[Section], route: Route) -> Iterator[str]:
        if part not in self._met:
            self._met.add(part)
            rows = [(_Key(part, key), "") for key in section_fields(part)]
            yield from self._table(title, section_description(part), rows, route)

    def _kinds(self, title: str, spec: Kinds, route: Route) -> Iterator[str]:
        """One table for all kinds; a key that only some have says so."""
        models = {name: model for name, model in spec.models.items() if name != spec.default}
        if self._met.issuperset(models.values()):
            return
        self._met.update(models.values())
        owners: dict[_Key, list[str]] = {}
        for name, model in models.items():
            for key in section_fields(model):
                owners.setdefault(
                    _Key(model, key, kind=next(iter(models)) if key == spec.key else ""), []
                ).append(name)
        rows = [(key, _of_kinds(names, list(models))) for key, names in owners.items()]
        doc = f"`{spec.key}` is one of {_listed(models)}."
        if spec.default is not None:
            chosen = spec.models[spec.default]
            doc += f" Without it, or with `{spec.default}`, {section_description(chosen)}"
        yield from self._table(title, doc, sorted(rows, key=lambda row: row[1] != ""), route)

    def _table(self, title: str, doc: str, rows: list[tuple[_Key, str]], route: Route) -> Iterator[str]:
        yield from [
            "",
            f"## {title}",
            "",
            doc,
            "",
            "| key | value | unit | default | known | example | meaning |",
            "|---|---|---|---|---|---|---|",
        ]
        for key, owners in rows:
            yield f"{key.cells} {owners}{key.meaning} |"
        for key, _ in rows:
            yield from self._below(f"{title}.{key.name}" if route else key.name, key.spec, (*route, key.name))

    def _below(self, title: str, spec: Shape, route: Route) -> Iterator[str]:
        """The sections of the parts that are met inside the value of a key."""
        match spec:
            case type():
                yield from self._section(title, spec, route)
            case MappingOf(value=inner) | ListOf(item=inner):
                yield from self._below(f"{title}.NAME", inner, (*route, "*"))
            case Forms(options=options):
                parts = [
                    option for option in options if isinstance(option, type) and option is not PythonTerm
                ]
                for option in options:
                    named = isinstance(option, type) and len(parts) > 1
                    yield from self._below(
                        f"{title} with {next(iter(section_fields(option)))}" if named else title,
                        option,
                        route,
                    )
            case Kinds():
                yield from self._kinds(title, spec, route)


def _defaults() -> Iterator[str]:
    """The hyperparameters of each algorithm, with what a training takes where the scenario is silent."""
    yield from ["", "## Defaults of the hyperparameters", ""]
    yield (
        "The values that a training uses if `train` does not set them. `deepbots inspect` shows them for"
        " one scenario or run."
    )
    for algorithm, model in ALGORITHMS.items():
        own, library, title = (
            DEFAULTS.get(algorithm, {}),
            library_defaults(algorithm) or {},
            library_of(algorithm),
        )
        yield from ["", f"### {algorithm}", "", "| hyperparameter | default | set by |", "|---|---|---|"]
        for name in model.hyperparameter_names():
            text, source = (
                (own[name].description, "deepbots") if name in own else (_plain(library.get(name)), title)
            )
            yield f"| `{name}` | {text} | {source} |"


def _plain(value: object) -> str:
    """A default of a library as the language writes it."""
    if value is None:
        return "none"
    return (
        str(value).lower()
        if isinstance(value, bool)
        else f"{value:_}"
        if isinstance(value, int)
        else str(value)
    )


class _Key:
    """One key of a part; equal to another that reads the same."""

    def __init__(self, part: type[Section], name: str, kind: str = "") -> None:
        self.name = name
        self.spec = section_fields(part)[name]
        self.meaning = _cell(key_description(part, name))
        default = (
            "**required**"
            if part.model_fields[name].is_required()
            else f"`{written}`"
            if (written := default_of(part, name))
            else ""
        )
        example = found.text if (found := example_of(part, name)) else kind
        value = "a kind" if kind else _value(self.spec)
        self.cells = (
            f"| `{name}` | {value} | {unit_of(self.spec)} | {default} | {_known(self.spec)} |"
            f" `{_cell(example)}` |"
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and (self.cells, self.meaning) == (other.cells, other.meaning)

    def __hash__(self) -> int:
        return hash((self.cells, self.meaning))


def _value(spec: Shape) -> str:
    match spec:
        case Quantity(words=words, relative=relative):
            more = [f"`{word}`" for word in words] + ["a percentage"] * relative
            return " or ".join([spec.noun, *more])
        case FieldType():
            return _cell(spec.noun)
        case ListOf(item=FieldType() as item):
            return f"list of {_cell(item.plural)}"
        case ListOf(item=item):
            return f"list, each: {_inner(item)}"
        case MappingOf(value=value):
            return f"mapping, each: {_inner(value)}"
        case Forms(options=options):  # short ones first
            texts = dict.fromkeys(sorted(map(_value, options), key=_openness))
            return " **or** ".join(
                f"({text})" if "each:" in text and len(texts) > 1 else text for text in texts
            )
        case Kinds(key=key):
            return f"mapping, kind given by `{key}`"
        case _:
            return "mapping"


def _openness(value: str) -> tuple[int, bool]:
    return value.count("each:"), value.startswith("list")


def _inner(spec: Shape) -> str:
    """The value of each entry; several forms, and a value with entries of its own, in parentheses."""
    text = _value(spec)
    return f"({text})" if (" **or** " in text and isinstance(spec, Forms)) or "each:" in text else text


def _known(spec: Shape) -> str:
    match spec:
        case Quantity(known=known):
            return known
        case Expression(context="parameter" | "require"):
            return "episode"
        case Expression():
            return "step"
        case MappingOf(value=value):
            return _known(value)
        case Forms(options=options):
            return next((known for known in map(_known, options) if known), "")
        case _:
            return ""


def _of_kinds(names: list[str], kinds: list[str]) -> str:
    """The kinds that have a key, or if they are many, those that lack it; nothing if all have it."""
    lacking = [kind for kind in kinds if kind not in names]
    if not lacking:
        return ""
    return f"all but {_listed(lacking)}: " if len(lacking) < len(names) // 2 else f"{_listed(names)}: "


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


# Functions


_FAMILIES = {
    Family.PURE: "Arithmetic",
    Family.WORLD: "The world",
    Family.MESSAGE: "Messages",
    Family.STATEFUL: "Functions with a memory",
    Family.DRAW: "Draws",
}
_KNOWN = {
    Family.PURE: "A result becomes known with its latest argument: if all arguments are fixed, the result is"
    " fixed.",
    Family.WORLD: "The present state of the world, which only the supervisor knows. The values change in"
    " each timestep (*step*).",
    Family.MESSAGE: "The supervisor's information about messages. The values change in each timestep"
    " (*step*).",
    Family.STATEFUL: "These functions remember values between timesteps. Their values change in each"
    " timestep (*step*). The optional"
    " argument `start` is the value before the first timestep.",
    Family.DRAW: "One draw per episode (*episode*), or, in a parameter, `every 5 s` or `each step`.",
}
_PLACES = {
    Context.FIXED: "values that must be fixed: timestep, sizes, ranges",
    Context.PARAMETER: "`parameters`",
    Context.FIELD: "other values of the world and its robots",
    Context.RESET: "`reset`",
    Context.EMIT: "`emit`",
    Context.APPLY: "`apply`",
    Context.RECEIVE: "`receive`",
    Context.SIGNAL: "`augment`, `signals`",
    Context.FORBID: "`forbid`",
    Context.SCRIPT: "`scripts`",
    Context.REWARD: "`reward`",
    Context.ENDING: "`termination`",
}


def _functions() -> str:
    lines = [
        "# Units and functions",
        "",
        "[Units](../units.md) and [expressions](../language.md#expressions) describe their use. The examples"
        " are about one scenario: a"
        " small two-wheeled `rover` with a camera `eye` and rays `near`, its actions `gas` and `turn`, a"
        " `ball`, and a painted line"
        " `track`. The unit column gives the unit in which a value is stored; 1 is a plain number. *fixed*,"
        " *episode* and *step* have"
        " the meaning that they have in [the keys](keys.md).",
        "",
        "## Units",
        "",
        "| unit | measures | in SI |",
        "|---|---|---|",
    ]
    lines += [
        f"| `{unit.text}` | {unit.dimension.description} | {unit.to_si(1.0):.10g} |"
        for unit in UNITS.values()
    ]
    for family, title in _FAMILIES.items():
        lines += [
            "",
            f"## {title}",
            "",
            _KNOWN[family],
            "",
            "| function | gives | unit | example |",
            "|---|---|---|---|",
        ]
        lines += [_function_row(function) for function in FUNCTIONS.values() if function.family is family]
    lines += [
        "",
        "## Where they may be called",
        "",
        f"| place | {' | '.join(_FAMILIES.values())} |",
        f"|---|{'---|' * len(_FAMILIES)}",
    ]
    for context, place in _PLACES.items():
        cells = ["yes" if family in ALLOWED_FAMILIES[context] else "" for family in _FAMILIES]
        lines.append(f"| {place} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _function_row(function: Function) -> str:
    example = _cell(function.example)
    return f"| `{_cell(function.signature)}` | {_cell(function.doc)} | {_unit(function)} | `{example}` |"


def _unit(function: Function) -> str:
    """The unit of the result; where it follows that of the arguments, how, found by trying a length."""
    if function.boolean:
        return "truth value"
    given = function.result(LENGTH)
    if Kind.JOINT in function.params[0].kinds:
        return f"`{function.result(ANGLE)}` or `{given}`"
    if function.result(TIME) == given:
        return "1" if given == NUMBER else f"`{given}`"
    return {LENGTH: "as given", LENGTH * TIME: "as given, times seconds"}.get(
        given, "the square root of the given unit"
    )


# Commands


def _commands() -> str:
    lines = [
        "# Every command",
        "",
        "`deepbots COMMAND --help` prints the same. A SCENARIO is the path of a file, or the name of a"
        " [shipped scenario](../worlds.md)."
        " A RUN is the folder of a training. All commands use the same [exit"
        " codes](../diagnostics.md#exit-codes).",
    ]
    for group, commands in GROUPS.items():
        lines += ["", f"## {group}"]
        for name in commands:
            lines += _command(name)
    return "\n".join(lines) + "\n"


def _command(name: str) -> Iterator[str]:
    command = Commands().get_command(None, name)
    context = typer.Context(command)
    arguments = [_argument(one) for one in command.params if one.param_type_name == "argument"]
    yield from ("", f"### deepbots {name}", "")
    for block in command.help.split("\n\n"):
        if block.startswith("\b"):  # a block to show as it is
            lines = [
                line.strip() if "deepbots " in line[:12] else line
                for line in cleandoc(block.removeprefix("\b")).splitlines()
            ]
            is_examples = all(line.startswith("deepbots ") for line in lines)
            yield from (
                "```console" if is_examples else "```text",
                *(f"$ {line}" if is_examples else line for line in lines),
                "```",
                "",
            )
        else:
            yield from (_with_options_marked(" ".join(block.split())), "")
    yield f"`{' '.join(['deepbots', name, '[OPTIONS]', *arguments])}`"
    panels: dict[str, list[str]] = {}
    for parameter in command.params:
        if parameter.hidden:
            continue
        names, meaning = parameter.get_help_record(context)
        if parameter.param_type_name == "argument":
            names, meaning = parameter.metavar or parameter.name.upper(), meaning.removesuffix("  [required]")
        row = f"| `{_cell(names)}` | {_cell(_with_options_marked(meaning))} |"
        panels.setdefault(parameter.rich_help_panel or "", []).append(row)
    for panel, rows in sorted(panels.items(), key=lambda pair: pair[0] != ""):
        yield from ("", f"| {panel.lower() or 'argument or option'} | meaning |", "|---|---|", *rows)


def _with_options_marked(text: str) -> str:
    """With options such as --set as code, which the help for a terminal leaves plain."""
    parts = text.split("`")
    parts[::2] = [re.sub(r"(?<![\w-])--?[a-z][a-z-]*\b", r"`\g<0>`", part) for part in parts[::2]]
    return "`".join(parts)


def _argument(parameter: Any) -> str:
    name = parameter.metavar or parameter.name.upper()
    return f"{name if parameter.required else f'[{name}]'}{'...' if parameter.nargs == -1 else ''}"


# Rules


def _rules() -> str:
    lines = [
        "# Every finding",
        "",
        "Errors keep a scenario from being compiled; warnings do not, and can be suppressed."
        " [Findings](../diagnostics.md) describes"
        " the format of findings and the exit codes. A rule in preview may still give false positives, and"
        " runs with `--preview`. Rules"
        " that need a simulation run with [`--deep`](../linting.md#simulating), those that search for"
        " exploits of the reward with"
        " [`--exploits`](../linting.md#searching-for-exploits).",
        "",
        "| code | name | severity | by | what it is about |",
        "|---|---|---|---|---|",
    ]
    for rule in RULES.values():
        severity = f"{rule.severity}, in preview" if rule.preview else rule.severity
        by = {
            "no": "text",
            "too": "text, simulation",
            "only": "simulation",
            "exploits": "search for exploits",
        }[rule.deep]
        lines.append(f"| {rule.code} | `{rule.name}` | {severity} | {by} | {_cell(rule.summary)} |")
    for page in every_page():
        lines += _rule_page(page)
    return "\n".join(lines) + "\n"


def _rule_page(page: RulePage) -> Iterator[str]:
    """What `deepbots explain` says too; the tests lay examples in YAML upon CartPole, and read robot files as
    they are."""
    is_second = page.deep and RULES[page.code].deep == "too"
    yield from [
        "",
        f"### {page.code} by simulation" if is_second else f"## {page.code} {RULES[page.code].name}",
        "",
        page.about,
    ]
    if page.example:
        mark = "deep" if page.deep else "wrong"
        wrong, right = (
            ("xml", "xml") if page.language == "xml" else (f"yaml {mark} {page.code}", "yaml fragment")
        )
        yield from [
            "",
            f"```{wrong}",
            page.example,
            "```",
            "",
            "Instead:",
            "",
            f"```{right}",
            page.instead,
            "```",
        ]


# Glossary


def _glossary() -> str:
    lines = [
        "# Glossary",
        "",
        "Terms of reinforcement learning and robotics, with the keys and commands of deepbots for each."
        " `deepbots explain` prints the same"
        ' texts, and finds British and American spellings: `deepbots explain "time limit"`.',
        "",
        "| term | also |",
        "|---|---|",
    ]
    lines += [
        f"| [{topic.name}](#{topic.name.replace(' ', '-')}) | {', '.join(topic.names)} |"
        for topic in topics()
    ]
    for topic in topics():
        lines += ["", f"## {topic.name}", "", " ".join(topic.about.split())]
        if topic.example:
            lines += ["", "```yaml fragment", *topic.example.splitlines(), "```"]
        page, _, section = topic.read.removeprefix("docs/").partition("#")
        place = page.removeprefix("reference/") if page.startswith("reference/") else f"../{page}"
        title = (section or page.removesuffix(".md")).replace("-", " ")
        lines += ["", f"Read more: [{title}]({place}{f'#{section}' if section else ''})"]
    return "\n".join(lines) + "\n"


def _isaac_lab() -> str:
    """Return the page about Isaac Lab with the terms of each section."""
    parts = re.split(r"^(?=## )", (DOCS / "isaac-lab.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    sections = json.loads(TERMS_FILE.read_text(encoding="utf-8"))
    for index, part in enumerate(parts):
        rows = sections.get(part.partition("\n")[0].removeprefix("## "), ())
        parts[index] = part.replace("<!-- terms -->", "\n".join(_terms(rows)))
    return "".join(parts)


def _terms(rows: Iterable[dict[str, Any]]) -> Iterator[str]:
    """Yield a table of terms; the observation of a line is in its row."""
    yield from ("| term | under | line | under `observation` |", "|---|---|---|---|")
    for row in rows:
        name = ", ".join(f"`{name}`" for name in row["names"])
        if row["reason"]:
            yield f"| {name} | | {row['reason']} | |"
        cells: list[list[str]] = []
        for section, line in row["lines"]:
            text = f"`{line}`".replace("|", r"\|")
            if section == "observation" and cells and not cells[-1][2]:
                cells[-1][2] = text
            elif section == "observation":
                cells.append(["", "", text])
            else:
                cells.append([f"`{section}`" if section else "", text, ""])
        for under, text, observed in cells:
            yield f"| {name} | {under} | {text} | {observed} |"
            name = ""
