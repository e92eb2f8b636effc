"""Nodes to a validated scenario: what the models refuse becomes findings, each at its exact place.

The first round reports. Whatever has a finding is then taken out and the rest is validated again, until it passes: later
passes see all that is sound, and nothing is reported twice.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

from deepbots_cli.diagnostics import Finding, Findings, Fix, Span, TooManyFindings
from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.document.hints import GIVE_A_VALUE
from deepbots_cli.document.nodes import Mapping, Path, Scalar, descend, to_data, walk
from deepbots_cli.scenario.check import check
from deepbots_cli.scenario.explain import about, describe, expected_at, help_for_unknown, keys_of, meant_by, name_of, place, wanted
from deepbots_cli.scenario.part import Keys
from deepbots_cli.scenario.refusal import Refusal
from deepbots_cli.scenario.scenario import VERSION, Scenario
from deepbots_cli.scenario.walk import parts, spec_at

# The language is nine levels deep; each round takes out at least the innermost faulty one.
_ROUNDS = 16

# Characters before a value in which its key stands.
_LOOKED_BACK = 400

# Stand-ins for required sections that had findings, so that the other sections are still looked at.
_STAND_INS: dict[str, object] = {
    "deepbots": VERSION,
    "name": "unnamed",
    "world": {"timestep": "32 ms"},
    "robots": {},
    "action": {},
    "observation": {},
    "reward": {},
}


@dataclass(frozen=True)
class _Trouble:
    """A complaint of a model about what is at `path`: `missing` keys, or an unknown key or value with what was probably `meant`."""

    code: str
    path: Path
    headline: str
    help: str | None = None
    missing: tuple[str, ...] = ()
    at_key: bool = False
    meant: Meant | None = None
    notes: tuple[str, ...] = ()


def validate(root: Mapping, findings: Findings) -> Scenario | None:
    """The scenario in `root`; what is wrong with it goes to `findings`.

    With findings, the scenario lacks what they are about (`Scenario.pruned` has the paths) and stand-ins
    fill required sections. None if the file is written for another version of the language.

    Raises:
        TooManyFindings: There are more than `findings` takes.
    """
    if not _is_readable(root, findings):
        return None
    data: Any = to_data(root)
    pruned: set[Path] = set()
    for path, node in walk(root):
        if path and isinstance(node, Scalar) and node.value is None:
            span = _key_span(root, path)
            findings.add("DB107", span, f"`{name_of(path)}` has no value", help="give it one, or take the key out")
            _prune(data, path, pruned)
    _advise(root, data, findings)

    earlier = findings.errors  # a warning leaves its value in place, so nothing is missing because of it
    troubles = list(islice(_key_troubles(data), findings.limit))
    for round_number in range(_ROUNDS):
        scenario, refusals = check(Scenario, data, lenient=round_number > 0)
        troubles += [_trouble(root, data, refusal) for refusal in refusals[: findings.limit]]
        if round_number == 0:
            news = [new for new in troubles if not (_is_follow_up(root, new, earlier) or _is_misspelt(new, troubles))]
            found = [_finding(root, data, trouble) for trouble in _together(_in_place(root, data, news, findings))]
            for one in found:
                findings.append(one)
            if findings.limit is not None and len(troubles) >= findings.limit:  # what was left aside would be in the way of later passes
                raise TooManyFindings(found[-1])
        for trouble in troubles:
            _prune(data, trouble.path, pruned, trouble.missing)
        if scenario is not None and not troubles:
            return scenario.lacking(pruned) if pruned else scenario
        troubles = []
    return None


def _advise(root: Mapping, data: Any, findings: Findings) -> None:
    """Say of keys without a value what they take: the text alone, which was read first, does not know."""
    vague = {found.span: found for found in findings if found.code == "DB107" and found.help == GIVE_A_VALUE}
    for path, node in walk(root) if vague else ():
        for key in node.hollow if isinstance(node, Mapping) else ():
            if found := vague.get(key.span):
                findings.advise(found, wanted(data, (*path, key.text)))


def _in_place(root: Mapping, data: Any, troubles: list[_Trouble], findings: Findings) -> list[_Trouble]:
    """The same, with a section that stands inside of another as one trouble."""
    if not troubles:
        return troubles
    from deepbots_cli.scenario.displaced import HELP, displaced, hollow_sections  # only on the way to a finding

    sections = displaced(root, data, [trouble.path for trouble in troubles])
    inside = sections | hollow_sections(root, findings)
    if not inside:
        return troubles
    names = {str(path[-1]) for path in sections}
    left = [
        trouble
        for trouble in troubles
        if not any(trouble.path[:depth] in inside for depth in range(1, len(trouble.path) + 1))
        and not (trouble.code == "DB102" and not trouble.path and names.issuperset(trouble.missing))
    ]
    told = [_Trouble("DB101", path, f"`{path[-1]}` stands {place(path[:-1])}", HELP, at_key=True) for path in sorted(sections, key=str)]
    return [*told, *left]


def _together(troubles: list[_Trouble]) -> list[_Trouble]:
    """All sections that a file lacks as one trouble: they are many while it is being written. Its notes explain all but the first."""
    lacking = [trouble for trouble in troubles if trouble.code == "DB102" and not trouble.path]
    if len(lacking) < 2:
        return troubles
    missing = tuple(key for trouble in lacking for key in trouble.missing)
    headline = f"missing keys {', '.join(f'`{key}`' for key in missing)} {place(())}"
    notes = tuple(trouble.help for trouble in lacking[1:] if trouble.help)
    together = _Trouble("DB102", (), headline, lacking[0].help, missing, at_key=True, notes=notes)
    return [together, *(trouble for trouble in troubles if trouble not in lacking)]


def _is_readable(root: Mapping, findings: Findings) -> bool:
    node = root.get("deepbots")
    version = node.value if isinstance(node, Scalar) else None
    if node is None or not isinstance(version, int) or version <= VERSION:
        return True
    headline = f"this file is written in version {node.span.text[:9]} of the language, and this deepbots reads version {VERSION}"
    findings.add("DB105", node.span, headline, help="this file needs a newer deepbots: pip install --upgrade deepbots-cli")
    return False


def _key_troubles(data: Any) -> Iterator[_Trouble]:
    """Keys that exclude each other, and parts that lack all of several keys."""
    for path, part, mapping in parts(Scenario, data):
        for keys in part.needs:
            given = [name for name in keys.names if name in mapping]
            if len(given) > keys.most:
                yield _Trouble(
                    "DB101", (*path, given[-1]), f"`{given[-1]}` cannot stand beside `{given[0]}`", "keep one of the two", at_key=True
                )
            elif len(given) < keys.least:
                yield _lacking(path, keys)


def _lacking(path: Path, keys: Keys) -> _Trouble:
    names = " or ".join(f"`{name}`" for name in keys.names)
    return _Trouble("DB102", path, f"missing key {names} {place(path)}", "give one of them", keys.names, at_key=True)


def _trouble(root: Mapping, data: Any, refusal: Refusal) -> _Trouble:
    """A refusal in our own words."""
    code, path, help = refusal.code, refusal.path, refusal.help
    match code, refusal.headline:
        case "DB102", None:
            (key,) = refusal.missing
            return _Trouble(code, path, f"missing key `{key}` {place(path)}", about(data, (*path, key)), (key,), at_key=True)
        case "DB101", None:
            key = str(path[-1])
            help, meant = help_for_unknown(data, path[:-1], key), meant_by(data, path)
            return _Trouble(code, path, f"unknown key `{key[:60]}` {place(path[:-1])}", help, at_key=True, meant=meant)
        case _, None:
            node = descend(root, path)[0]
            headline = f"expected {refusal.expected or expected_at(data, path)}, found {describe(node)}"
            from deepbots_cli.scenario.habits import habit_of  # only on the way to a finding

            help = help or keys_of(spec_at(Scenario, data, path))
            if habit := habit_of(node):
                help = "; ".join(filter(None, (habit.help, about(data, path) if habit.is_part else None)))
                refusal.meant = refusal.meant or habit.meant
        case "DB102", str(headline):
            headline = f"{headline} {place(path)}"
        case "DB107", str(headline):
            headline = f"{'a key' if refusal.at_key else f'`{name_of(path)}`'} {headline}"
        case _, str(headline):
            pass
    at_key = refusal.at_key or code in ("DB102", "DB107")
    return _Trouble(code, path, headline, help, refusal.missing, at_key=at_key, meant=refusal.meant)


def _is_follow_up(root: Mapping, trouble: _Trouble, earlier: Sequence[Finding]) -> bool:
    """Whether something is missing or empty only because the value there was found faulty before, and left out."""
    if trouble.code not in ("DB102", "DB107"):
        return False
    span = descend(root, trouble.path)[0].span
    inside = [found.span for found in earlier if found.span.source is span.source and span.start <= found.span.start <= span.end]
    if trouble.code == "DB107":
        return bool(inside)
    return any(_is_about(found, key) for found in inside for key in trouble.missing)


def _is_about(span: Span, key: str) -> bool:
    """Whether a finding at `span` marks this key, its value or an item of it, or a file that was to be included and may have held it."""
    # Not all of the text before it: with tens of thousands of findings the copies took minutes.
    before = span.source.text[max(0, span.start - _LOOKED_BACK) : span.start].rstrip()
    list_so_far = r"\s*(\[[^][{}:]*|-[^:]*)?$"
    return span.text.strip("'\"") == key or re.search(rf"\b({re.escape(key)}|include)['\"]?:{list_so_far}", before) is not None


def _is_misspelt(trouble: _Trouble, troubles: list[_Trouble]) -> bool:
    """Whether the missing key stands there in a spelling that is reported anyway."""
    if not trouble.missing:
        return False
    misspelt = (other for other in troubles if other.at_key and other.meant is not None and other.path[:-1] == trouble.path)
    return any(other.meant is not None and other.meant.text in trouble.missing for other in misspelt)


def _finding(root: Mapping, data: Any, trouble: _Trouble) -> Finding:
    help = trouble.help or about(data, trouble.path)
    return Finding(trouble.code, _span(root, trouble), trouble.headline, help, notes=trouble.notes, fix=_fix(root, trouble))


def _span(root: Mapping, trouble: _Trouble) -> Span:
    if trouble.at_key:
        return _key_span(root, trouble.path)
    span = descend(root, trouble.path)[0].span
    return span if span.begin.line == span.finish.line else _key_span(root, trouble.path)


def _fix(root: Mapping, trouble: _Trouble) -> Fix | None:
    node, key, _ = descend(root, trouble.path)
    word = key if trouble.at_key else node
    if trouble.meant is None or not isinstance(word, Scalar):
        return None
    return Fix.replacing(word.part(0, len(word.text)), word.text, trouble.meant.text, safe=trouble.meant.safe)


def _key_span(root: Mapping, path: Path) -> Span:
    """The key at `path`, the head of the item of a list, or the first line of the file."""
    if not path:
        return _first_line(root.span)
    node, key, _ = descend(root, path)
    return key.span if key is not None else _first_line(node.span)


def _first_line(span: Span) -> Span:
    end = span.source.text.find("\n", span.start, span.end)
    return Span(span.source, span.start, span.end if end < 0 else end)


def _prune(data: Any, path: Path, pruned: set[Path], missing: tuple[str, ...] = ()) -> None:
    """Take out the entry at `path`; from a list the whole list, since its other items keep their numbers."""
    while path and isinstance(path[-1], int):
        path = path[:-1]
    if not path:
        for key in missing:
            if key in _STAND_INS:
                data[key] = _STAND_INS[key]
                pruned.add((key,))
        return
    holder = data
    for step in path[:-1]:
        try:
            holder = holder[step]
        except (KeyError, IndexError, TypeError):
            return  # went out together with something around it
    if isinstance(holder, dict) and path[-1] in holder:
        del holder[path[-1]]
        pruned.add(path)
