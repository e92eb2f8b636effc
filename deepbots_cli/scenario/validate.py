"""Validate the nodes of a scenario. Errors of pydantic become findings with exact places.

The first round reports findings. Each further round removes faulty entries and validates the rest, so later
passes get all valid entries and nothing is reported twice.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import takewhile
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from deepbots_cli.diagnostics import Edit, Finding, Findings, Fix, Label, Span, TooManyFindings
from deepbots_cli.diagnostics.nearest import Replacement
from deepbots_cli.document import nodes
from deepbots_cli.document.nodes import Node, NodePath, ScalarNode, descend, node_at, to_data, walk
from deepbots_cli.document.parse import resolve_plain_scalar
from deepbots_cli.document.syntax_hints import missing_colon
from deepbots_cli.document.value_hints import GIVE_A_VALUE
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.base import LENIENT, Forms, Kinds, MappingOf, Shape, noun_of, set_paths, shape_at
from deepbots_cli.scenario.documentation import advice
from deepbots_cli.scenario.fields import FieldType, error, mismatch
from deepbots_cli.scenario.keys import (
    Suggestion,
    keys_of,
    listed,
    misspelled_key,
    sentence_about_key,
    suggestion_for,
)
from deepbots_cli.scenario.scenario import VERSION, Scenario
from deepbots_cli.words import counted

# The language is nine levels deep; each round takes out at least the innermost faulty one.
_MAX_ROUNDS = 16
_MAX_SHOWN_CHARACTERS = 40

_ONLY_SPACE = r"\s*:(\s|#[^\n]*)*"
_END_OF_LINE = r"( *:)?[ \t]*(#[^\n]*)?\n([ \t]*#[^\n]*\n)* *"
_LINE = r"(?m)^(?=[^\n])"
_OWN_SECTION_HELP = "move it to the top level: indent this key, and its contents with it, by one level less"
# Stand-ins for required sections that had findings, so that the other sections are still checked.
_REQUIRED_SECTION_DEFAULTS: dict[str, object] = {
    "deepbots": VERSION,
    "name": "unnamed",
    "world": {"timestep": "32 ms"},
    "robots": {},
    "action": {},
    "observation": {},
    "reward": {},
}


@dataclass(frozen=True)
class _Problem:
    """A finding about `path`, with `missing` keys, or with the probable `replacement` of an unknown key."""

    path: NodePath
    finding: Finding
    missing: tuple[str, ...] = ()
    replacement: Replacement | None = None


def validate(root: nodes.MappingNode, findings: Findings) -> Scenario | None:
    """Validate `root`; errors go to `findings`.

    Returns the scenario. If there are findings, faulty entries are removed from it (`Scenario.pruned` has the
    paths), and stand-ins fill required sections. None if the file is written for another version of the
    language.

    Raises:
        TooManyFindings: There are more than `findings` takes.
    """
    if not _is_readable(root, findings):
        return None
    data: Any = to_data(root)
    pruned: set[NodePath] = set()
    _advise(root, data, findings)

    for round_number in range(_MAX_ROUNDS):
        try:
            scenario = Scenario.model_validate(data, context={LENIENT: round_number > 0})
        except ValidationError as invalid:
            errors = invalid.errors(include_url=False, include_input=False)[: findings.limit]
        else:
            scenario._pruned = frozenset(pruned)
            set_paths(scenario)
            return scenario
        problems = [_problem(root, data, error) for error in errors]
        if round_number == 0:
            new = [
                problem
                for problem in problems
                if not (_is_follow_up(root, problem) or _is_misspelled(problem, problems))
            ]
            new = _merge_outdented_entries(root, data, new, len(errors))
            new = _merge_forms_of_isaac_lab(root, data, new)
            outcome = [
                problem.finding
                for problem in _merge_missing_sections(root, _merge_misplaced_section(root, data, new))
            ]
            for finding in outcome:
                findings.append(finding)
            # The remaining errors would disturb later passes.
            if findings.limit is not None and len(problems) >= findings.limit:
                raise TooManyFindings(outcome[-1])
        for problem in problems:
            _prune(data, problem.path, pruned, problem.missing)
    return None


def findings_of(root: nodes.MappingNode, data: Any, invalid: ValidationError) -> list[Finding]:
    """Return the errors of a scenario whose text is `root` as findings."""
    errors = invalid.errors(include_url=False, include_input=False)
    return [_problem(root, data, error).finding for error in errors]


def _is_readable(root: nodes.MappingNode, findings: Findings) -> bool:
    node = root.get("deepbots")
    version = node.value if isinstance(node, ScalarNode) else None
    if node is None or not isinstance(version, int) or version <= VERSION:
        return True
    headline = (
        f"this file uses version {node.span.text[:9]} of the language, but this deepbots reads"
        f" version {VERSION}"
    )
    findings.add("DB105", node.span, headline, "install a newer version of deepbots")
    return False


def _prune(data: Any, path: NodePath, pruned: set[NodePath], missing: tuple[str, ...] = ()) -> None:
    """Remove the entry at `path`; of a list the whole list, since its items keep their numbers."""
    while path and isinstance(path[-1], int):
        path = path[:-1]
    if not path:
        for key in missing:
            if key in _REQUIRED_SECTION_DEFAULTS:
                data[key] = _REQUIRED_SECTION_DEFAULTS[key]
                pruned.add((key,))
        return
    holder = data
    for step in path[:-1]:
        try:
            holder = holder[step]
        except (KeyError, IndexError, TypeError):
            return  # was removed with an outer entry
    if isinstance(holder, dict) and path[-1] in holder:
        del holder[path[-1]]
        pruned.add(path)


# Errors to problems


def _problem(root: nodes.MappingNode, data: Any, error: ErrorDetails) -> _Problem:
    """Return an error of pydantic, of a field type or of a section, in the words of the language."""
    path, kind = error["loc"], error["type"]
    if kind == "missing":
        *_, key = path
        path = path[:-1]
        finding = Finding(
            "DB102",
            _key_span(root, path),
            f"missing key `{key}` {_place(path)}",
            sentence_about_key(data, (*path, key)),
        )
        return _Problem(path, finding, (str(key),))
    if kind == "extra_forbidden":
        return _unknown_key(root, data, path, suggestion_for(root, data, path))
    node, key_node, _ = descend(root, path)
    missing = error.get("ctx", {}).get("missing", ())
    if misspelled := misspelled_key(root, path, missing):  # the section is of no kind without this key
        return replace(_unknown_key(root, data, *misspelled), path=path)
    at_key = path[-1:] == ("[key]",) and not (isinstance(node, nodes.MappingNode) and "[key]" in node.entries)
    path = path[:-1] if at_key else path
    context = (
        error["ctx"]
        if kind.startswith("DB")
        else _reworded(shape_at(Scenario, data, path), to_data(node), error["msg"])
    )
    kind = context.get("code", kind)
    headline = context["headline"]
    help = context["help"]
    near = context["replacement"]
    if expected := context.get("expected"):
        headline = f"expected {expected}, found {_describe(node)}"
        help = help or keys_of(shape_at(Scenario, data, path))
        if hint := _typing_hint(node, data, path, takes_mapping=expected == "a mapping"):
            help = hint[0]
            near = near or hint[1]
    elif kind == "DB102":
        headline = f"{headline} {_place(path)}"
        help = ". ".join(
            filter(
                None,
                (
                    help,
                    sentence_about_key(data, (*path, context["missing"][0])) if context["missing"] else None,
                ),
            )
        )
    elif kind == "DB107":
        headline = f"{'a key' if at_key else f'`{_name_of(path)}`'} {headline}"
    at_key = at_key or kind in ("DB101", "DB102", "DB107")
    span = (
        _key_span(root, path)
        if at_key or node.span.start_position.line != node.span.end_position.line
        else node.span
    )
    fix = _fix(key_node if at_key else node, near)
    finding = Finding(kind, span, headline, help or sentence_about_key(data, path), fix=fix)
    return _Problem(
        path,
        _at_own_key(root, path, context.get("rival", ""), finding),
        context["missing"],
    )


def _at_own_key(root: nodes.MappingNode, path: NodePath, rival: str, finding: Finding) -> Finding:
    """Return a finding about two keys that cannot be combined, at the one that the file itself has if the
    other one is inherited."""
    own, span = _key_span(root, (*path[:-1], rival)), finding.span
    if not rival or span.source is root.span.source or own.source is not root.span.source:
        return finding
    headline = f"`{rival}` cannot be combined with `{path[-1]}`"
    return replace(finding, headline=headline, span=own, labels=(Label(span, f"`{path[-1]}` is inherited"),))


def _unknown_key(root: nodes.MappingNode, data: Any, path: NodePath, suggestion: Suggestion) -> _Problem:
    headline = f"unknown key `{str(path[-1])[:60]}` {_place(path[:-1])}"
    fix = _fix(descend(root, path)[1], suggestion.replacement) if suggestion.is_fix else None
    return _Problem(
        path,
        Finding(
            "DB101",
            _key_span(root, path),
            headline,
            suggestion.help or sentence_about_key(data, path),
            fix=fix,
        ),
        replacement=suggestion.replacement,
    )


def _key_span(root: nodes.MappingNode, path: NodePath) -> Span:
    """Return the key at `path`, the head of the item of a list, or the first line of the file."""
    node, key, _ = descend(root, path)
    if key is not None and path:
        return key.span
    span = node.span
    end = span.source.text.find("\n", span.start, span.end)
    return Span(span.source, span.start, span.end if end < 0 else end)


def _fix(word: Node | None, near: Replacement | None) -> Fix | None:
    if near is None or not isinstance(word, ScalarNode):
        return None
    # A number loses its quotes.
    if word.style in ("single", "double") and resolve_plain_scalar(near.text) != near.text:
        return Fix((Edit(word.span, near.text),), near.safe)
    return Fix.replacing(word.part(0, len(word.text)), word.text, near.text, safe=near.safe)


def _reworded(shape: Shape | None, value: object, message: str) -> dict[str, Any]:
    """Return the words of the field type for a value that pydantic's own type refused with `message`."""
    problem = mismatch("another type" if shape is None else noun_of(shape), value=value)
    if isinstance(shape, FieldType):
        try:
            shape.validate(value)
            problem = error("DB105", message)  # a bound of pydantic, in the model of a plug-in
        except PydanticCustomError as own:
            problem = own
    return {**(problem.context or {}), "code": problem.type}


def _describe(node: Node) -> str:
    """Return the noun for a node, for `expected ..., found ...`."""
    match node:
        case nodes.SequenceNode():
            return "a list"
        case nodes.MappingNode():
            return "a mapping"
        case ScalarNode(value=bool()):
            return f"the truth value `{node.text}`"
        case ScalarNode(value=int() | float()):
            return f"the number `{_shortened(node.text)}`"
        case ScalarNode():
            return f"the text `{_shortened(node.text)}`"


def _typing_hint(
    node: Node, data: object, path: NodePath, *, takes_mapping: bool
) -> tuple[str, Replacement | None] | None:
    """Return help and replacement for a typing error that the form of a wrong value shows."""
    # A mapping on the line of its key needs braces.
    form = "{{{}}}" if node.span.source.text[: node.span.start].rpartition("\n")[2].strip(" -") else "{}"
    match node:
        case ScalarNode(style="plain", text=text) if glued := re.fullmatch(
            r"([A-Za-z_]\w*):[^\S ]*(\S.*)", text
        ):
            replacement = Replacement(form.format(f"{glued[1]}: {glued[2]}"), safe=False)
            return f"put a space after the colon: `{replacement.text[:60]}`", replacement
        case ScalarNode(style="plain", text=text) if (
            takes_mapping
            and (corrected := missing_colon(text))
            and (form == "{}" or not corrected[1].endswith(":"))
        ):
            replacement = Replacement(form.format(corrected[1]), safe=False)
            return f"write a colon after the key: `{replacement.text[:60]}`", replacement
        case ScalarNode(style="plain", text=text) if text.endswith(",") and (bare := text.rstrip(", ")):
            return f"remove the comma at the end of the line: `{bare[:60]}`", Replacement(bare, safe=True)
        case nodes.SequenceNode(items=items) if items and all(
            isinstance(item, nodes.MappingNode) for item in items
        ):
            return ". ".join(filter(None, (_without_dashes(items[0]), sentence_about_key(data, path)))), None
    return None


def _without_dashes(item: Node) -> str:
    """Return what to write instead of a list of mappings, of which `item` is the first."""
    first = next(iter(item.entries.values()), None) if isinstance(item, nodes.MappingNode) else None
    if first is None or not isinstance(first.value, ScalarNode):
        return "remove the dashes before the keys"
    entry = f"{_shortened(first.key.text)}: {_shortened(first.value.text)}"
    return f"remove the dashes: write `{entry}`, not `- {entry}`"


def _is_follow_up(root: nodes.MappingNode, problem: _Problem) -> bool:
    """Return whether a key is missing, or a mapping empty, only because its text had a finding and was left
    out."""
    node = descend(root, problem.path)[0]
    if not isinstance(node, nodes.MappingNode) or not node.partial:
        return False
    empty = {key.text.partition(":")[0] for key in node.keys_without_value}
    return problem.finding.code == "DB107" or (
        problem.finding.code == "DB102" and (not empty or not empty.isdisjoint(problem.missing))
    )


def _is_misspelled(problem: _Problem, problems: list[_Problem]) -> bool:
    """Return whether a key that is reported as unknown is the missing one, misspelled."""
    misspelled = (
        other.replacement for other in problems if problem.missing and other.path[:-1] == problem.path
    )
    return any(near is not None and near.text in problem.missing for near in misspelled)


def _merge_forms_of_isaac_lab(root: nodes.MappingNode, data: Any, problems: list[_Problem]) -> list[_Problem]:
    """Replace all problems of a section that is written as in Isaac Lab by a single one."""
    for path, paths, headline, help in advice(data):
        inside = [problem for problem in problems if any(problem.path[: len(at)] == at for at in paths)]
        if inside:
            finding = Finding("DB101", _key_span(root, path), headline, help)
            merged = _Problem(path, finding)
            problems = [merged, *(problem for problem in problems if problem not in inside)]
    return problems


def _merge_outdented_entries(
    root: nodes.MappingNode, data: Any, problems: list[_Problem], errors: int
) -> list[_Problem]:
    """Replace the problems of entries by a single one if they are valid in the section right above them,
    which is empty or indented by more."""
    paths = {problem.path[:depth]: None for problem in problems for depth in range(1, len(problem.path) + 1)}
    for *path, name in paths:
        holder = node_at(root, *path)
        if not isinstance(holder, nodes.MappingNode) or name not in holder.entries:
            continue
        below = [problem.path[len(path) :] for problem in problems if _is_below(problem, path)]
        # A section of the language at the top level with a mistake further in is right where it is.
        faulty = {way[0] for way in below if path or len(way) == 1 or way[0] not in Scenario.model_fields}
        entries = list(holder.entries.values())
        following = entries[list(holder.entries).index(str(name)) :]
        moved = list(takewhile(lambda entry: entry.key.text in faulty, following))  # noqa: B023
        at_fault = {problem.path: problem.replacement for problem in problems}
        near = at_fault.get((*path, name))
        present = {*holder.entries, *(key.text for key in holder.keys_without_value)}
        is_misspelled = (
            near is not None
            and near.text not in present
            and _is_improved(data, path, str(name), near.text, errors)
        )
        is_of_holder = is_misspelled or _is_key(data, path, str(name))
        fitting = (
            _unindented(moved, section[-1], spaces, rest)
            for section, spaces in _sections_above(path, holder, following[0].key)
            if section not in at_fault and moved and (_is_key(data, section, str(name)) or not is_of_holder)
            for rest in (_rest(data, section, moved[-1], spaces),)
            if _fits(data, path, section, moved, rest, errors)
        )
        finding = next(fitting, None)
        if finding is None:
            continue
        names = {entry.key.text for entry in moved}
        problems = [
            _Problem((*path, name), finding),
            *(each for each in problems if not (_is_below(each, path) and each.path[len(path)] in names)),
        ]
    return problems


def _is_key(data: Any, path: Sequence[str | int], name: str) -> bool:
    """Return whether a name is a key of the language at a path, and not one that a user may choose there."""
    section = shape_at(Scenario, data, tuple(path))
    return isinstance(section, type) and name in section.model_fields


def _rest(data: Any, section: NodePath, entry: nodes.Entry, spaces: int) -> list[nodes.Entry]:
    """Return the keys of `section` that a text has below an entry only because the entry is indented by so
    many spaces less than they are."""
    value = entry.value
    if not isinstance(value, nodes.MappingNode) or value.span.text.startswith("{"):
        return []
    below = [*value.entries.values()]
    count = next((index for index, each in enumerate(below) if _is_key(data, section, each.key.text)), 0)
    are_beside = count and _column(below[count].key) == _column(entry.key) + spaces
    return below[count:] if are_beside else []


def _is_below(problem: _Problem, path: Sequence[str | int]) -> bool:
    return len(problem.path) > len(path) and problem.path[: len(path)] == tuple(path)


def _sections_above(
    path: Sequence[str | int], holder: nodes.MappingNode, key: ScalarNode
) -> Iterator[tuple[NodePath, int]]:
    """Yield the paths of the sections that end, or are empty, right above a key of the mapping `holder` at
    `path`, the outermost first, and by how many spaces the key is indented less than the keys of each."""
    source = key.span.source
    for owner in holder.keys_without_value:
        if owner.span.source is source and re.compile(_ONLY_SPACE).fullmatch(
            source.text, owner.span.end, key.span.start
        ):
            yield (*path, owner.text), _column(owner) + 2 - _column(key)
    for entry in holder.entries.values():
        if (
            entry.key.span.source is source
            and isinstance(section := entry.value, nodes.MappingNode)
            and section.span.start > entry.key.span.start  # the mapping of an alias is elsewhere
            and not section.span.text.startswith("{")
            and re.compile(_END_OF_LINE).fullmatch(source.text, section.span.end, key.span.start)
        ):
            place = (*path, entry.key.text)
            first = next(iter(section.entries.values()), None)
            if first is not None and (spaces := _column(first.key) - _column(key)) > 0:
                yield place, spaces
            yield from _sections_above(place, section, key)


def _column(node: Node) -> int:
    return node.span.start_position.column


def _fits(
    data: Any,
    path: Sequence[str | int],
    section: NodePath,
    entries: Sequence[nodes.Entry],
    rest: Sequence[nodes.Entry],
    errors: int,
) -> bool:
    """Return whether there are fewer errors, and none of the entries, if they are moved from the mapping at
    `path` into the one at `section`, which is below it; `rest` stands in the last one, and beside it then."""
    data = holder = deepcopy(data)
    for step in path:
        holder = holder[step]
    target = holder
    for step in section[len(path) :]:
        target = target.setdefault(step, {})
    last = holder[entries[-1].key.text]
    beside = {entry.key.text: last.pop(entry.key.text) for entry in rest}
    names = {entry.key.text for entry in entries}
    if not target.keys().isdisjoint(names | beside.keys()):
        return False
    target |= beside | {name: holder.pop(name) for name in names}
    left, depth = _places_of_errors(data), len(section)
    is_at_fault = any(loc[:depth] == section and names.intersection(map(str, loc[depth:])) for loc in left)
    return not left or (len(left) < errors and not is_at_fault)


def _is_improved(data: Any, path: Sequence[str | int], name: str, key: str, errors: int) -> bool:
    """Return whether there are fewer errors if the key `name` of the mapping at `path` is another key."""
    data = holder = deepcopy(data)
    for step in path:
        holder = holder[step]
    holder[key] = holder.pop(name)
    return len(_places_of_errors(data)) < errors


def _places_of_errors(data: Any) -> list[tuple[str | int, ...]]:
    try:
        Scenario.model_validate(data, context={LENIENT: False})
    except ValidationError as invalid:
        return [error["loc"] for error in invalid.errors(include_url=False, include_input=False)]
    return []


def _unindented(
    entries: Sequence[nodes.Entry], section: str | int, spaces: int, rest: Sequence[nodes.Entry]
) -> Finding:
    first = entries[0].key
    source = first.span.source
    more = f" and {counted(len(entries) - 1, 'more key')}" if len(entries) > 1 else ""
    begin = source.text.rfind("\n", 0, first.span.start) + 1
    depth = first.span.start - begin + spaces
    last = entries[-1].value
    if rest and isinstance(last, nodes.MappingNode):
        last = [*last.entries.values()][-len(rest) - 1].value
    starts = [match.start() for match in re.compile(_LINE).finditer(source.text, begin, last.span.end)]
    if len(entries) == 1 and _column(entries[0].value) > _column(first) + spaces:
        starts = starts[:1]  # the lines below it are indented as they should be
    return Finding(
        "DB101",
        first.span,
        f"`{first.text}`{more} {'are' if more else 'is'} not indented below `{section}`",
        f"indent {'them' if more else 'it'} to {counted(depth, 'space')}: `{' ' * depth}{first.text}: ...`",
        fix=Fix(tuple(Edit(Span(source, start, start), " " * spaces) for start in starts), safe=False),
    )


def _merge_misplaced_section(root: nodes.MappingNode, data: Any, problems: list[_Problem]) -> list[_Problem]:
    """Replace all problems of a section that is indented into another section by a single one."""
    moved: dict[NodePath, _Problem] = {}
    remaining = []
    for problem in problems:
        if path := _displaced(root, data, problem.path):
            moved[path] = _Problem(
                path,
                Finding(
                    "DB101",
                    _key_span(root, path),
                    f"`{path[-1]}` cannot be {_place(path[:-1])}",
                    _OWN_SECTION_HELP,
                ),
            )
        else:
            remaining.append(problem)
    lacking = {(str(path[-1]),) for path in moved}
    return [
        *moved.values(),
        *(problem for problem in remaining if problem.path or problem.missing not in lacking),
    ]


def _displaced(root: nodes.MappingNode, data: object, path: NodePath) -> NodePath | None:
    """Return the first key on the path that is a section which the file lacks, where its name is not a
    key."""
    for depth in range(1, len(path)):
        key, here = path[depth], path[: depth + 1]
        if (
            key in Scenario.model_fields
            and key not in root.entries
            and isinstance(descend(root, here)[0], nodes.MappingNode)
        ):
            holder = shape_at(Scenario, data, path[:depth])
            if not isinstance(holder, type) or key not in holder.model_fields:
                return here
    return None


def _merge_missing_sections(root: nodes.MappingNode, problems: list[_Problem]) -> list[_Problem]:
    """Replace the problems of missing sections by a single one: a new file lacks many. Its notes explain all
    but the first."""
    lacking = [problem for problem in problems if problem.finding.code == "DB102" and not problem.path]
    if len(lacking) < 2:
        return problems
    missing = tuple(key for problem in lacking for key in problem.missing)
    headline = f"missing keys {listed(missing)} {_place(())}"
    help, *notes = (problem.finding.help or "" for problem in lacking)
    together = _Problem(
        (), Finding("DB102", _key_span(root, ()), headline, help, notes=tuple(filter(None, notes))), missing
    )
    return [together, *(problem for problem in problems if problem not in lacking)]


# Keys without a value


def _advise(root: nodes.MappingNode, data: Any, findings: Findings) -> None:
    """Add help to the findings about keys without a value, which the parser does not add since it is
    independent of the language."""
    vague = {
        finding.span: finding
        for finding in findings
        if finding.code == "DB107" and finding.help == GIVE_A_VALUE
    }
    if vague:
        for path, node in walk(root):
            if isinstance(node, nodes.MappingNode):
                for key in node.keys_without_value:
                    if finding := vague.get(key.span):
                        help = _help_for_missing_value(data, (*path, key.text))
                        findings.replace(finding, replace(finding, help=help))


def _help_for_missing_value(data: object, path: NodePath) -> str:
    message = sentence_about_key(data, path)
    if message is not None and message.startswith(f"`{path[-1]}`"):
        return message
    holder = shape_at(Scenario, data, path[:-1], choose=False)
    if isinstance(holder, Kinds) and path[-1] == holder.key:
        return f"use one of {listed(holder.names)}"
    holder = shape_at(Scenario, data, path[:-1])
    if not isinstance(holder, MappingOf):
        return GIVE_A_VALUE
    match holder.value:
        case FieldType() as shape:
            hint = shape.help_for(None)
        case Kinds() as shape:
            hint = f"write it like `{{{shape.key}: {shape.names[0]}}}`"
        case Forms() as shape:
            hint = shape.help_for(None)
        case shape:
            hint = keys_of(shape)
    return hint or f"write {noun_of(shape)}"


# Wording


def _place(path: NodePath) -> str:
    if not path:
        return "at the top level"
    last = path[-1]
    return f"in entry {last + 1} of `{_name_of(path)}`" if isinstance(last, int) else f"in `{_name_of(path)}`"


def _name_of(path: NodePath) -> str:
    """Return the innermost key of a path, short enough for a headline."""
    return _shortened(next((step for step in reversed(path) if isinstance(step, str)), ""))


def _shortened(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _MAX_SHOWN_CHARACTERS else f"{line[: _MAX_SHOWN_CHARACTERS - 3]}..."
