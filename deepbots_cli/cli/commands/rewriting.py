"""Changes of the user's files: `fmt`, `upgrade`, and the fixes of `lint`, shown as a difference or written.

`upgrade` has one step per version of the language. A step changes the text and keeps comments and layout. A file without the key
`deepbots` counts as version 0. The fixes of DB109 replace former names, also in included files of the project.
"""

from __future__ import annotations

import os
import sys
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import unified_diff
from io import StringIO
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import option
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import MappingNode as Tree
from deepbots_cli.document import ScalarNode, files
from deepbots_cli.document.layout import canonical_text
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import ScenarioError, UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.lint.fixes import Fixer, Rewrite
from deepbots_cli.lint.settings import scenarios_in, settings
from deepbots_cli.scenario.scenario import VERSION


def fmt(
    paths: Annotated[list[Path], typer.Argument(metavar="FILE", help="Scenario files, or folders of them.")],
    check: Annotated[bool, option("--check", "Write nothing, and exit with 1 if a file would change.")] = False,
    diff: Annotated[bool, option("--diff", "Like --check, and show the changes.")] = False,
) -> None:
    """Format scenario files in the canonical layout.

    Formatting keeps all values, comments and aligned columns. In a folder, fmt formats every .yaml or .yml file with a `deepbots:` key,
    also in subfolders, except the files that the project excludes from linting.

    \b
      deepbots fmt cartpole.yaml
      deepbots fmt cartpole.yaml --diff
      deepbots fmt scenarios/ --check
    """
    rewrites, refused = [], False
    for path in _scenario_files(paths):
        rewrite = _tidied(path)
        refused = refused or rewrite is None
        if rewrite is not None and rewrite.after != rewrite.before:
            rewrites.append(rewrite)
            if diff:
                show(rewrite)
            elif not check:
                write(rewrite)
            terminal.note(f"{'would change' if check or diff else 'changed'} {path}")
    if refused or (rewrites and (check or diff)):
        raise typer.Exit(FAILED)


def _scenario_files(paths: Sequence[Path]) -> Iterator[Path]:
    """The named files, and the scenarios in named folders that the project does not exclude."""
    for given in paths:
        if not given.exists():
            raise UsageError(f"there is no file {given}")
    project = settings() if any(given.is_dir() for given in paths) else None
    for given in paths:
        if project is not None and given.is_dir():
            yield from scenarios_in(given, project)
        else:
            yield given


def _tidied(path: Path) -> Rewrite | None:
    """The file in the canonical layout; None after an error message if it cannot be formatted."""
    data, findings = _read(path), Findings()
    source, readable = files.decode(data, str(path), findings)
    root = parse(source, findings) if readable else None
    if root is None or findings.errors:
        terminal.print_error(f"{path} is not changed because it cannot be read; see: deepbots lint {quote(str(path))}")
        return None
    done = canonical_text(source.text)
    if done is None:
        terminal.print_error(f"{path} is not changed because a new layout would change its values")
        return None
    return Rewrite(path.resolve(), data, (BOM_UTF8 if data.startswith(BOM_UTF8) else b"") + done.encode())


Step = Callable[[str, Tree], str]
"""From a text and its tree to the text in the next version of the language."""

_SCENARIO_KEYS = frozenset({"extends", "action", "observation", "reward", "robots"})
_BOM = "\ufeff"


def upgrade(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A scenario file.")],
    diff: Annotated[bool, option("--diff", "Show the changes and write nothing; exit with 1 if the file would change.")] = False,
) -> None:
    """Upgrade a scenario file to the present language.

    The command adds a missing line `deepbots: 1`, and replaces old names of keys, functions and values, such as the type of a sensor.
    It also upgrades the files of the project that the scenario includes. Comments and layout stay. A file of a newer version is an error.

    \b
      deepbots upgrade old.yaml --diff
      deepbots upgrade old.yaml

    Next: `deepbots lint old.yaml` reports the other problems of the file.
    """
    found = upgraded(file)
    if not found.rewrites:
        terminal.print_result(f"{file} is up to date: version {VERSION} of the language")
    elif diff:
        for rewrite in found.rewrites:
            show(rewrite)
        raise typer.Exit(FAILED)
    else:
        for rewrite in found.rewrites:
            write(rewrite)
        if found.version != VERSION:
            was = f"version {found.version}" if found.version else "no version"
            terminal.print_result(f"{file} is now in version {VERSION} of the language; before, it had {was}")
        for old, new in found.renamed.items():
            terminal.print_result(f"{old} -> {new}")
        terminal.note(f"next: deepbots lint {quote(str(file))}")


@dataclass(frozen=True)
class Upgrade:
    """The version of a file, the rewrites of it and of its included files, and the former names with the present ones."""

    version: int
    rewrites: list[Rewrite]
    renamed: dict[str, str]


def upgraded(path: Path) -> Upgrade:
    """The upgrade of a file to the current version.

    Raises:
        UsageError: The file is not a scenario, or its version is newer or unknown.
        ScenarioError: The file is not valid YAML.
    """
    before = _read(path)
    root = _tree(path, before)
    version = _version(path, root)
    text = before.decode("utf-8")
    for step in range(version, VERSION):
        text = STEPS[step](text, _tree(path, text.encode()))
    after = text.encode()
    changed = _tree(path, after)
    if _version(path, changed) != VERSION:
        raise UsageError(f"{path} cannot be upgraded automatically; write `deepbots: {VERSION}` as its first line")
    place = path.resolve()
    fixer = Fixer([str(place)], api.load, wanted=lambda finding: finding.code == "DB109", drafts={place: after})
    rewrites = {rewrite.path: rewrite for rewrite in fixer.fix()}
    if before != (mended := fixer.drafts[place]):
        rewrites[place] = Rewrite(place, before, mended)
    edits = [edit for finding in fixer.fixed if finding.fix for edit in finding.fix.edits]
    return Upgrade(version, list(rewrites.values()), {edit.span.text: edit.text for edit in edits})


def _name_the_version(text: str, root: Tree) -> str:
    """From 0 to 1: adds the line `deepbots: 1` above the first key, with the same indentation."""
    start = root.span.start + text.startswith(_BOM)  # places count from behind the mark
    end = "\r\n" if "\r\n" in text else "\n"
    if text[start : start + 1] == "{":
        return f"{text[: start + 1]}deepbots: 1, {text[start + 1 :]}"
    indentation = text[text.rfind("\n", 0, start) + 1 : start].removeprefix(_BOM)
    return f"{text[:start]}deepbots: 1{end}{indentation}{text[start:]}"


STEPS: Mapping[int, Step] = {0: _name_the_version}
"""The steps by the version that each begins with."""


def _read(path: Path) -> bytes:
    if not path.is_file():
        raise UsageError(f"{path} {'is not a regular file' if path.exists() else 'does not exist'}; name a scenario file")
    return files.read(path)


def _tree(path: Path, data: bytes) -> Tree:
    findings = Findings()
    source, sound = files.decode(data, files.display_path(path.resolve()), findings)
    root = parse(source, findings) if sound else None
    if findings.errors or root is None:
        raise ScenarioError(list(findings))
    if not isinstance(root, Tree):
        raise UsageError(f"{path} is not a scenario because it has no keys")
    return root


def _version(path: Path, root: Tree) -> int:
    """The version that a file names; 0 if it names none."""
    entry = root.entries.get("deepbots")
    if entry is None:
        if not _SCENARIO_KEYS & root.entries.keys():
            raise UsageError(f"{path} is not a whole scenario; a file that scenarios include has no version")
        return 0
    version = entry.value.value if isinstance(entry.value, ScalarNode) else None
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        said = " ".join(entry.value.span.text.split())[:40]
        raise UsageError(f"{path} has `deepbots: {said}`, which is not a version of the language; write `deepbots: {VERSION}`")
    if version > VERSION:
        raise UsageError(
            f"{path} is in version {version} of the language, and this deepbots reads up to version {VERSION}; "
            "install a newer one: pip install --upgrade deepbots-cli"
        )
    return version


# Showing and writing


def show(rewrite: Rewrite) -> None:
    """Print what would change; to a file or a pipe byte for byte, so that `patch -p0` and `git apply -p0` can read it."""
    text = _difference(rewrite)
    print(terminal.printable(text) if sys.stdout.isatty() else text, end="")


def _difference(rewrite: Rewrite) -> str:
    """A unified diff."""
    name = files.display_path(rewrite.path)
    if name.isprintable():
        name += "\t" if " " in name else ""  # without it `patch` takes the name to end there
    else:
        name = f'"{"".join(map(_quoted, os.fsencode(name)))}"'
    before, after = (list(StringIO(data.decode("utf-8", "replace"))) for data in (rewrite.before, rewrite.after))  # parted by \n alone
    lines = unified_diff(before, after, name, name)
    return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)


def _quoted(byte: int) -> str:
    """A byte of an odd file name, as `git` and `patch` write it."""
    return chr(byte) if chr(byte).isprintable() and byte < 128 and chr(byte) not in '"\\' else f"\\{byte:03o}"


def write(rewrite: Rewrite) -> None:
    """Replace the file as a whole.

    Raises:
        UsageError: It has changed since it was read, or the system refuses it; nothing is written.
    """
    path = rewrite.path
    with atomic_write(path) as draft:
        if path.read_bytes() != rewrite.before:
            raise UsageError(f"{files.display_path(path)} was changed by someone else meanwhile, and is left alone")
        with path.open("r+b"):  # a file that its owner made read-only stays as it is, though its folder would let it be replaced
            pass
        draft.write_bytes(rewrite.after)
