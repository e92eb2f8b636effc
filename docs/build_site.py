"""Builds the site in build/docs from the pages of the repository.

    python docs/build_site.py

`write_sources` copies the pages into build/docs-sources, with links that hold there, and writes those that
are not committed: the gallery, the lessons, the reference and the measurements.
Sphinx makes HTML of them (conf.py). Each page is in the site as Markdown too, beside llms.txt, rules.json and
the JSON Schema.
"""

from __future__ import annotations

import json
import posixpath
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

import build_course  # noqa: E402
import build_gallery  # noqa: E402
import build_reference  # noqa: E402

from deepbots_cli.cli.commands.explain import rules_data  # noqa: E402
from tools.results import page as results  # noqa: E402
from tools.results.experiment import experiments  # noqa: E402
from tools.results.measure import Places  # noqa: E402

SOURCES = ROOT / "build" / "docs-sources"
SITE = ROOT / "build" / "docs"
LIST = "docs/README.md"
"""The page that lists all pages in groups, which are those of the navigation."""
NAMES = {
    "README.md": "index.md",
    LIST: "pages.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "NOTICES.md": "notices.md",
}
"""Pages whose name in the site differs from their path below docs/."""
UNSEARCHED = ("pages.md", "changelog.md")
"""Pages that would be found for every word."""
_LINK = re.compile(r"(\]\(|<img src=\")([^)\s\"#]*)(#[^)\s\"]*)?")
_LESSON = re.compile(r"course/([^/]+)/text\.md")
_FENCE = re.compile(r"^(```.*?^```$)", re.MULTILINE | re.DOTALL)
_ROW = re.compile(r"^\| \[([^\]]+)\]\(([^)]+)\) \| (.*) \|$")


class Entry(NamedTuple):
    """A page in the list of pages: its title, its place in the site, and what it is about."""

    title: str
    place: str
    about: str


def write_sources(target: Path) -> None:
    """Write all pages of the site as Markdown, with the pictures and files that they link to."""
    shutil.rmtree(target, ignore_errors=True)
    copied: set[str] = set()
    for path, text in _all_pages():
        place = place_of(path)
        file = target / place
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(
            ("---\nnosearch: true\n---\n" if place in UNSEARCHED else "") + _for_site(text, path, copied),
            encoding="utf-8",
        )
    for path in sorted(copied):
        file = target / place_of(path)
        file.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / path, file)


def _all_pages() -> Iterator[tuple[str, str]]:
    """Yield the path of each page in the repository, or the path that a built one would have, and its text."""
    built = built_pages()
    committed = [*sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "course").glob("[0-9]*/text.md"))]
    paths = [*NAMES, *(path.relative_to(ROOT).as_posix() for path in committed)]
    for path in dict.fromkeys([*paths, *built]):
        if path in build_gallery.merged():
            continue
        text = built.get(path) or (ROOT / path).read_text(encoding="utf-8")
        yield path, f"{text}\n{_navigation()}" if path == "README.md" else text


@cache
def built_pages() -> dict[str, str]:
    """Return the pages that are written from tables, records and scenarios, by their path."""
    return {
        **build_reference.pages(),
        **results.built(Places(), experiments()),
        **build_gallery.pages(),
        **build_course.pages(),
    }


def place_of(path: str) -> str:
    """Where a file of the repository is in the site."""
    if path in NAMES:
        return NAMES[path]
    path = build_gallery.merged().get(path, path)
    if lesson := _LESSON.fullmatch(path):
        return f"course/{lesson[1]}.md"
    return (
        path.removeprefix("docs/")
        if path.startswith("docs/")
        else f"files/{path.replace('/.', '/').removeprefix('.')}"
    )


def _for_site(text: str, page: str, copied: set[str]) -> str:
    """The text with links from its place in the site; the files that it links to are added to `copied`."""
    here = posixpath.dirname(place_of(page)) or "."

    def link(found: re.Match[str]) -> str:
        before, target, anchor = found[1], found[2], found[3] or ""
        if not target or "://" in target:
            return found[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(page), target))
        if not path.endswith(".md"):
            copied.add(path)
        return f"{before}{posixpath.relpath(place_of(path), here)}{anchor}"

    parts = _FENCE.split(text)
    parts[::2] = [re.sub(r"^</?p>\n", "", _LINK.sub(link, part), flags=re.MULTILINE) for part in parts[::2]]
    return "".join(part if not part.startswith("```{") else _LINK.sub(link, part) for part in parts)


# Navigation


def groups() -> dict[str, list[Entry]]:
    """The pages of each group of the list, in its order, with the pages of the gallery."""
    found: dict[str, list[Entry]] = {}
    for line in (ROOT / LIST).read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            entries = found.setdefault(line.removeprefix("## "), [])
        elif row := _ROW.match(line):
            entries.append(
                Entry(row[1], place_of(posixpath.normpath(posixpath.join("docs", row[2]))), row[3])
            )
    found["Gallery"] += [Entry(title, place_of(path), about) for path, title, about in build_gallery.listed()]
    return found


def _navigation() -> str:
    """Trees of contents of Sphinx, which are shown in the sidebar of each page."""
    blocks = []
    for group, entries in groups().items():
        names = "\n".join(f"{entry.title} <{entry.place.removesuffix('.md')}>" for entry in entries)
        blocks.append(f"```{{toctree}}\n:caption: {group}\n:hidden:\n\n{names}\n```\n")
    return "\n".join([*blocks, "```{toctree}\n:hidden:\n\npages\n```\n"])


# What machines read


def llms_txt() -> str:
    """The list of pages in the form of llmstxt.org."""
    intro = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split("\n\n")[2].split())
    lines = ["# deepbots", "", f"> {intro}", ""]
    lines += [
        "The JSON Schema of a scenario is `schemas/deepbots-1.schema.json`; `rules.json` holds every finding"
        " of `deepbots lint`.",
        "",
    ]
    for group, entries in groups().items():
        lines += [
            f"## {group}",
            "",
            *(f"- [{entry.title}]({entry.place}): {entry.about}" for entry in entries),
            "",
        ]
    return "\n".join(lines)


def write_for_machines(sources: Path, target: Path) -> None:
    """Put the pages as Markdown with their files, the JSON Schema, the registry of findings and llms.txt into
    the site."""
    shutil.copytree(sources, target, dirs_exist_ok=True)
    shutil.copytree(ROOT / "schemas", target / "schemas", dirs_exist_ok=True)
    (target / "rules.json").write_text(json.dumps(rules_data(), indent=2) + "\n", encoding="utf-8")
    (target / "llms.txt").write_text(llms_txt(), encoding="utf-8")


def write_html(sources: Path, target: Path) -> int:
    """Make HTML of the pages; the exit status of Sphinx, which counts warnings as errors and names their file
    and line."""
    shutil.rmtree(target, ignore_errors=True)
    options = [
        "-q",
        "-W",
        "--keep-going",
        "-E",
        "-b",
        "html",
        "-c",
        str(ROOT / "docs"),
        "-d",
        f"{target}-trees",
    ]
    return subprocess.run(
        [sys.executable, "-m", "sphinx", *options, str(sources), str(target)], check=False
    ).returncode


def build(sources: Path = SOURCES, target: Path = SITE) -> int:
    """Build the site; an exit status."""
    if missing := [name for name in ("sphinx", "myst_parser", "furo") if find_spec(name) is None]:
        print(
            f"{', '.join(missing)} cannot be imported; the site needs the extra `docs`: pip install -e"
            " '.[docs]'",
            file=sys.stderr,
        )
        return 2
    write_sources(sources)
    status = write_html(sources, target)
    if status == 0:
        write_for_machines(sources, target)
        print(f"{target}/index.html")
    return status


if __name__ == "__main__":
    sys.exit(build())
