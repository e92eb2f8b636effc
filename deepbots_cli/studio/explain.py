"""Explanations of words and findings as Markdown, with links to further words and findings.

The texts are those of `deepbots explain`. A link has the address `#explain:WORD`; `linked` calls a function
with the word.
"""

from __future__ import annotations

import re
import urllib.parse
from collections.abc import Callable, Iterable, Sequence
from functools import partial

from nicegui import ui

from deepbots_cli.cli.explanations import (
    entry_names,
    explain_word,
    misspelled_word,
    page_section,
    related_entries,
    unknown_word_message,
)
from deepbots_cli.diagnostics.registry import RULES, matching_rules, retired_rule_message
from deepbots_cli.insight.suggestions import Suggestion
from deepbots_cli.lint.pages import pages_of
from deepbots_cli.records import dataclass
from deepbots_cli.studio.language import line_link

_LINK = "#explain:"
_MAX_NAMES = 6
_WHY = (
    "*Diagnose*, in the tab *Runs*, names what keeps a training from learning, and the values that changed."
)
_HINT = "Put the cursor on a word of the text and press F1, or write a word here: a key, a unit, a term."
_FENCED = re.compile(r"(```.*?```|^(?: {4}.*\n?)+)", re.DOTALL | re.MULTILINE)
_WORD = re.compile(r"(?<!\[)`([A-Za-z][\w ]{2,40})`|\b(DB\d{3}|docs/[\w-]+\.md(?:#[\w-]+)?)(?!\w)")
_PAGE_LINK = re.compile(r"!?\[([^]]*)\]\((?:([\w-]+\.md)?(#[\w-]+)?\)|[^)]*\))")
_ON_CLICK = """(event) => {
  const link = event.target.closest("a[href]");
  if (!/^#(explain|line):/.test(link?.hash ?? "")) return;
  event.preventDefault();
  emit(decodeURIComponent(link.hash.slice(1)));
}"""


@dataclass(frozen=True)
class OfText:
    """What the open text says about words.

    Attributes:
        fixes: Title and action of each fix of the findings with a code, and of each change that a phrase
            asks for.
        names: The names of the text that have a word of a phrase, with the line of each, from 0.
        suggestions: The changes that a phrase asks for.
        go_to: It leads the cursor to a line, from 0.
    """

    fixes: Callable[[str], Iterable[tuple[str, Callable[[], object]]]]
    names: Callable[[str], Sequence[tuple[str, int]]]
    suggestions: Callable[[str], Sequence[Suggestion]]
    go_to: Callable[[int], object]


def explanation(word: str, *, only_concepts: bool = False) -> str:
    """Return what `deepbots explain` says about a word, or a code or name of a finding, as Markdown with
    links."""
    if page := page_section(word):
        return _PAGE_LINK.sub(partial(_of_page, word), page)
    rules = matching_rules(word) if word else ()
    if len(rules) == 1:
        rule = rules[0]
        return f"**{rule.code} {rule.name}** ({rule.severity}): {rule.summary}.\n\n{rule_page(rule.code)}"
    if rules:
        return "\n".join(f"- {_link(rule.code)} {rule.name}: {rule.summary}" for rule in rules)
    explained = explain_word(word)
    misspelled, retired = misspelled_word(word), retired_rule_message(word)
    related = [misspelled] if misspelled else related_entries(word)
    if not explained.entries and (retired or not related):
        return _with_links(retired or unknown_word_message(word))
    if not explained.entries:
        nearest, *others = related
        more = ", ".join(_link(name) for name in others if name not in explain_word(nearest).others)
        parts = [
            f"The entry that is nearest to `{word}`:",
            explanation(nearest),
            more and f"Further entries: {more}",
        ]
        return "\n\n".join(filter(None, parts))
    entries = [entry for entry in explained.entries if not only_concepts or entry[0].endswith(": a concept")]
    also = ", ".join(map(_link, explained.others))
    parts = [*(_entry(title, text) for title, *text in entries), also and f"See also: {also}"]
    return "\n\n---\n\n".join(filter(None, parts))


def rule_page(code: str) -> str:
    """Return the page of a rule as Markdown with links; empty if there is none."""
    return _with_links("\n\n".join(page.markdown() for page in pages_of(code))) if code in RULES else ""


def linked(on_word: Callable[[str], object], on_line: Callable[[int], object] | None = None) -> ui.markdown:
    """Return an element for such Markdown, whose links call a function with the word, or with the line, from
    0."""
    shown = ui.markdown().classes("studio-answer")

    def follow(link: str) -> None:
        kind, _, target = link.partition(":")
        if kind == "explain":
            on_word(target)
        elif on_line is not None and target.isdecimal():
            on_line(int(target) - 1)

    shown.on("click", lambda event: follow(str(event.args)), js_handler=_ON_CLICK)
    return shown


def _entry(title: str, text: list[str]) -> str:
    name, _, kind = title.partition(": ")
    head = f"**{name}**: {_with_links(kind, name)}" if kind else f"**{name}**"
    # Lines of an example are one block.
    lines = (line if line.startswith("    ") else f"\n{_with_links(_escaped(line), name)}\n" for line in text)
    return "\n".join([head, *lines]).rstrip()


def _escaped(text: str) -> str:
    """Return plain text as Markdown: `n_steps` and `2 * x` mean no emphasis, except in quoted code."""
    parts = text.split("`")
    return "`".join(
        part if number % 2 else re.sub(r"([_*])", r"\\\1", part) for number, part in enumerate(parts)
    )


def _with_links(text: str, itself: str = "") -> str:
    """Return Markdown in which words with an entry, and codes, are links, except in examples."""

    def word(match: re.Match[str]) -> str:
        name = match[1] or match[2]
        is_known = name in entry_names() or match[2] in RULES or bool(match[2] and page_section(match[2]))
        return _link(name) if name != itself and is_known else match[0]

    parts = _FENCED.split(text)
    return "".join(part if number % 2 else _WORD.sub(word, part) for number, part in enumerate(parts))


def _link(word: str, text: str = "") -> str:
    text = text or word.replace("_", "\\_")  # which would be emphasis
    return f"[{text}]({_LINK}{urllib.parse.quote(word)})"


def _of_page(shown: str, link: re.Match[str]) -> str:
    """Return a link of a shown page to another section or page; the text alone of other links."""
    word = f"docs/{link[2]}" if link[2] else shown.partition("#")[0]
    return _link(f"{word}{link[3] or ''}", link[1]) if link[2] or link[3] else link[1]


def show_explanation(first: str, of_text: OfText, meaning: str = "") -> None:
    """Open a dialog that explains words.

    Args:
        first: The first word; empty to ask for one.
        of_text: What the open text says about words.
        meaning: What the first word means at the cursor (Markdown).
    """
    earlier: list[str] = []

    def show(query: str) -> None:
        if not query:
            return
        earlier.append(query)
        word.set_value(query)
        answer.set_content(_answer(query, of_text, meaning if len(earlier) == 1 else ""))
        back.set_enabled(len(earlier) > 1)
        offered = list(of_text.fixes(query))
        fixes.clear()
        fixes.set_visibility(bool(offered))
        with fixes:
            for title, act in offered:
                ui.button(title, on_click=dialog.close).props("dense outline no-caps").on_click(act)

    def show_typed() -> None:
        show(str(word.value or "").strip())

    def return_to_earlier() -> None:
        earlier.pop()
        show(earlier.pop())

    def go_to(line: int) -> None:
        dialog.close()
        of_text.go_to(line)

    with ui.dialog().props('aria-label="Explain"') as dialog, ui.card().classes("studio-dialog"):
        with ui.row().classes("studio-wide"):
            word = (
                ui.input("A word, a code, or what you want", placeholder="make the pole longer")
                .classes("studio-grow")
                .on("keydown.enter", show_typed)
            )
            ui.button("Explain", on_click=show_typed).props("no-caps unelevated")
            back = ui.button("Back", on_click=return_to_earlier).props("flat no-caps disable")
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
        fixes = ui.element("div").classes("studio-bar")
        fixes.set_visibility(False)
        answer = linked(show, go_to).props('role="region" aria-label="Explanation" tabindex="0"')
        answer.set_content(_HINT)
    show(first)
    dialog.open()
    word.run_method("select")  # a letter replaces the word


def _answer(query: str, of_text: OfText, here: str) -> str:
    """Return the explanation of a word: what it means at the cursor (`here`) or in the text, and its
    entries."""
    has_entry = bool(matching_rules(query) or explain_word(query).entries)
    names = [] if here or (has_entry and " " in query) else of_text.names(query)
    listed = ", ".join(f"`{name}` in {line_link(line)}" for name, line in names[:_MAX_NAMES])
    in_text = [f"In this file: {listed}."] if names else []
    in_text = [f"**{query}** in this file\n\n{here}"] if here else in_text
    suggested = of_text.suggestions(query)
    in_file = [*(suggestion.text for suggestion in suggested), *in_text]
    # What the word is at the cursor says more than the entries of all keys of this name.
    is_answered = here or any(suggestion.value for suggestion in suggested)
    entry = "" if is_answered and not has_entry else explanation(query, only_concepts=bool(here))
    if query.lower().startswith("why "):
        entry = _WHY
    # The name of a section, such as `reward`, is a word of the language first.
    parts = [entry, *in_file] if has_entry and not here else [*in_file, entry]
    return "\n\n---\n\n".join(filter(None, parts))
