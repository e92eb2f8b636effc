"""The search of `tune`: each end of a range and each choice is checked as if `--set` had set it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from pydantic_core import PydanticCustomError

from deepbots_cli.diagnostics import Finding, Findings, Label, Source, Span
from deepbots_cli.document import Document, Entry, MappingNode, NodePath, SequenceNode, inline_text
from deepbots_cli.document.load import TESTS, TUNE, apply_assignment, setting_path
from deepbots_cli.document.nodes import ScalarNode, entries_at, without_paths
from deepbots_cli.program import Program, identity
from deepbots_cli.scenario.search import SearchSpace, read_range, split_choices

if TYPE_CHECKING:
    from deepbots_cli.compiler import CheckedScenario

MAX_SEARCHED = 32
"""The maximum number of keys of a search; each is compiled with at least three values."""
_FIXED_HELP = {
    **dict.fromkeys(("deepbots", "name", "summary", TUNE, TESTS), "remove it"),
    "evaluation": "remove it: it determines how trials are compared",
    "solved": "remove it: it determines how trials are compared",
    "train.total_timesteps": "remove it: all trials train for the same number of steps, which"
    " `tune.timesteps` or `--timesteps` sets",
}


def compile_search(
    document: Document, program: Program, findings: Findings, check: Callable[[Document], CheckedScenario]
) -> dict[str, SearchSpace]:
    """Return the search space of each key, by its path as it is written; a key that cannot be searched is a
    finding."""
    spaces: dict[str, SearchSpace] = {}
    entries = entries_at(document.root, TUNE, "search")
    if document.root is None or not entries:
        return spaces
    if len(entries) > MAX_SEARCHED:
        headline = f"a search over {len(entries)} keys"
        findings.add(
            "DB005",
            next(iter(entries.values())).key.span,
            headline,
            f"search over at most {MAX_SEARCHED} keys",
        )
        return spaces
    prober = _Prober(document, program, findings, check)
    for name, entry in entries.items():
        space = prober.space(name.strip(), entry)
        if space is not None:
            spaces[name.strip()] = space
    return spaces


class _Prober:
    """Checks the scenario with one value of one key after the other."""

    def __init__(
        self,
        document: Document,
        program: Program,
        findings: Findings,
        check: Callable[[Document], CheckedScenario],
    ) -> None:
        # The tests would be compiled again for each value.
        root = without_paths(document.root, ((TUNE,), (TESTS,))) if document.root else None
        assert isinstance(root, MappingNode)  # only keys below the root were removed
        self._root = root
        self._document = document
        self._base = program
        self._findings = findings
        self._check = check
        self._known = {finding.sort_key for finding in findings}
        self._searched: dict[NodePath, Entry] = {}

    def space(self, name: str, entry: Entry) -> SearchSpace | None:
        """Return the search space of a key; None after a finding."""
        path = setting_path(self._root, name)
        dotted = ".".join(map(str, path))
        reason = _FIXED_HELP.get(dotted) or _FIXED_HELP.get(str(path[0]))
        if reason is not None:
            self._findings.add("DB407", entry.key.span, f"a search cannot change `{dotted}`", reason)
            return None
        if path in self._searched:
            labels = (Label(self._searched[path].key.span, "first searched here"),)
            self._findings.add(
                "DB202",
                entry.key.span,
                f"`{name}` is already searched",
                "remove one of the two",
                labels=labels,
            )
            return None
        self._searched[path] = entry
        try:
            space = _read(entry)
        except PydanticCustomError:  # the validation has reported it
            return None
        if space.choices:
            return space if all(self._is_sound(name, choice, entry) for choice in space.choices) else None
        if not all(self._is_sound(name, space.text(end), entry) for end in (space.low, space.high)):
            return None
        return self._with_sound_middle(name, space, entry)

    def _with_sound_middle(self, name: str, space: SearchSpace, entry: Entry) -> SearchSpace | None:
        """Return the space if a value with a fraction has no errors either; else the space of the whole
        numbers, if both ends have none."""
        middle = space.middle
        is_whole = space.low.is_integer() and space.high.is_integer() and not space.unit
        if is_whole and not list(self._errors(name, space.text(int(middle) + 0.5))):
            return space
        if is_whole:
            space = space.model_copy(update={"whole": True})
            middle = int(middle)
        return space if self._is_sound(name, space.text(middle), entry) else None

    def _is_sound(self, name: str, text: str, entry: Entry) -> bool:
        """Return whether the scenario compiles with this value, and the same policy can act in it; else after
        findings at the entry."""
        errors = list(self._errors(name, text))
        for finding in errors:
            source, start, _ = finding.span
            at_key = source.text == f"{name}={text}" and start < len(name)
            elsewhere = (
                () if source.text == f"{name}={text}" else (Label(finding.span, f"with `{name}: {text}`"),)
            )
            span = entry.key.span if at_key else entry.value.span
            self._findings.append(replace(finding, span=span, labels=elsewhere, fix=None))
        return not errors

    def _errors(self, name: str, text: str) -> Iterator[Finding]:
        """Yield the errors that this value adds to the scenario."""
        findings = Findings(self._document.findings.limit)
        root = apply_assignment(self._root, f"{name}={text}", findings)
        if findings.errors:
            yield from findings.errors
            return
        checked = self._check(replace(self._document, root=root, findings=findings))
        yield from (finding for finding in checked.findings.errors if finding.sort_key not in self._known)
        lines = (
            identity.differences(self._base, checked.program, words=("in the scenario", "with this value"))
            if checked.program
            else []
        )
        if lines:
            headline = f"`{name}: {text}` changes the interface of the policy"
            help = (
                "search only over values that leave the observation, the action and the messages as they are"
            )
            source = Source("", f"{name}={text}")
            yield Finding(
                "DB613", Span(source, len(name), len(source.text)), headline, help, notes=tuple(lines[:5])
            )


def _read(entry: Entry) -> SearchSpace:
    """Return the search space that an entry writes."""
    match entry.value:
        case SequenceNode(items=items):
            return SearchSpace(choices=tuple(dict.fromkeys(map(inline_text, items))))
        case ScalarNode(text=text) if len(choices := split_choices(text)) > 1:
            return SearchSpace(choices=tuple(dict.fromkeys(choices)))
        case value:
            return read_range(inline_text(value))
