"""The tutorials, done word by word in an empty folder: files are written, edits are made, and commands print
what the page shows."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from deepbots_cli.cli import main

DOCS = Path(__file__).parents[2] / "docs"
TUTORIALS = ("start", "what-is-rl", "first", "rewards-that-cheat", "own-robot", "teach")
BLOCK = re.compile(r"^```(\w+)[ ]?([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
QUICK = {"new", "lint", "inspect", "explain"}
"""Commands that run no simulation; what they print is the same on every machine."""
SERVED = {"view", "play"}
"""Commands that serve a page until Ctrl-C."""


@pytest.mark.parametrize("page", TUTORIALS)
def test_the_files_of_a_tutorial_are_what_its_page_says(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    follow(page, tmp_path, monkeypatch, capsys, whole=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_done_word_by_word(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    follow(page, tmp_path, monkeypatch, capsys, whole=True)


def follow(
    page: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *,
    whole: bool,
) -> None:
    """Do what the page says; without `whole`, leave out simulations and what is shown of them."""
    monkeypatch.chdir(folder)
    printed, exact, complete = "", True, False
    for language, mark, text in BLOCK.findall((DOCS / f"{page}.md").read_text(encoding="utf-8")):
        kind, _, file = mark.rpartition(" ")
        if language == "console":
            lines = [
                shlex.split(line.removeprefix("$ "))
                for line in text.splitlines()
                if line.startswith("$ deepbots ")
            ]
            wanted = [line for line in lines if whole or is_quick(line)]
            complete, exact = len(wanted) == len(lines), all(is_quick(line) for line in lines)
            for _, *words in wanted:
                if words[0] in SERVED:
                    continue
                assert main(words) == (1 if mark == "fails" else 0), words
            captured = capsys.readouterr()
            printed = captured.out + captured.err
        elif language == "text" and mark == "output" and complete:
            assert [line for line in text.splitlines() if not is_shown(line, printed, exact=exact)] == []
        elif language == "yaml" and kind == "part":
            with Path(file).open("a", encoding="utf-8") as target:
                target.write(text)
        elif language == "xml" and file:
            Path(file).write_text(text, encoding="utf-8")
        elif language == "diff":
            edit(Path(file), text)


def is_quick(line: list[str]) -> bool:
    return line[1] in QUICK and not any(
        word.startswith("runs/") or word in ("--deep", "--exploits") for word in line
    )


def edit(file: Path, text: str) -> None:
    """Replace the lines with a minus by those with a plus."""
    old = "".join(f"{line[1:]}\n" for line in text.splitlines() if line[0] in " -")
    new = "".join(f"{line[1:]}\n" for line in text.splitlines() if line[0] in " +")
    before = file.read_text(encoding="utf-8")
    assert before.count(old) == 1, old
    file.write_text(before.replace(old, new), encoding="utf-8")


def is_shown(line: str, printed: str, *, exact: bool) -> bool:
    """Whether a line was printed; `...` stands for the rest of a line, or for lines."""
    start, rest, _ = line.partition("...")
    lines = [plain(one, exact=exact) for one in printed.splitlines()]
    return any(
        one.startswith(plain(start, exact=exact)) if rest else one == plain(line, exact=exact)
        for one in ["", *lines]
    )


def plain(line: str, *, exact: bool) -> str:
    """The words of a line; unless it must be exact, without numbers, which depend on the machine."""
    return " ".join((line if exact else re.sub(r"[-+]?\d[\d,.:]*%?", "0", line)).split())
