"""The files that commands write: new files in a folder, which replace no others, and changes of the user's
files.

Changes are the fixes of `lint`, the layout of `fmt`, and the values of `apply`, shown as a difference or
written.
"""

from __future__ import annotations

import json
import os
import sys
from codecs import BOM_UTF8
from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import unified_diff
from io import StringIO
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from deepbots_cli.cli import terminal
from deepbots_cli.diagnostics import RULES, Finding
from deepbots_cli.document import Permissions, files, shipped, to_data
from deepbots_cli.document.layout import assigned_text
from deepbots_cli.document.load import setting_path
from deepbots_cli.errors import EngineError, UsageError
from deepbots_cli.files import (
    atomic_write,
    check_folder,
    check_writable,
    read_at_most,
    refuse_overwriting,
    unwritable_message,
)
from deepbots_cli.program import Program, identity
from deepbots_cli.rollout.source import RECORDING_SUFFIX, Source, SourceKind
from deepbots_cli.words import shell_word

if TYPE_CHECKING:
    from deepbots_cli.compiler import CheckedScenario
    from deepbots_cli.lint import FoundExploits
    from deepbots_cli.lint.fixes import Rewrite

Files = dict[PurePosixPath, bytes]
"""The contents of files by path below the folder that they are written to."""


def check_new_folder(folder: Path, *, force: bool) -> None:
    """Find out before long work whether a folder is new or empty, unless `force`, and can be written.

    Raises:
        UsageError: The folder cannot be written into, or is not empty.
    """
    check_folder(folder)
    if not force and folder.is_dir() and any(folder.iterdir()):
        raise UsageError(
            f"{folder} is not empty; choose another folder, or replace files of the same name with --force"
            " (in Python: force=True)"
        )


def refuse_links_within(folder: Path) -> None:
    """Find out before long work whether files in a folder are links or pipes: writing would follow a link,
    and wait for a pipe.

    Raises:
        UsageError: One is.
    """
    if folder.is_dir():
        for path in sorted(folder.rglob("*")):
            if path.is_symlink() or not (path.is_file() or path.is_dir()):
                raise UsageError(f"{path} is neither a file nor a directory; choose another folder")


def write_new(files: Files, folder: Path, *, force: bool = False) -> list[Path]:
    """Write the files into `folder`. A file that is already there with the same content is left alone, and
    another one is replaced with `force`.

    Raises:
        UsageError: Other files are in the way; the message lists them. Or a file cannot be written. No new
            file is left in either case.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file; name a folder (deepbots creates it if it does not exist)")
    contents = {folder / target: content for target, content in files.items()}
    existing = {path for path in contents if path.exists() or path.is_symlink()}
    if in_the_way := [path for path in existing if not path.is_file() or path.read_bytes() != contents[path]]:
        refuse_overwriting(*in_the_way, force=force)
    for path in in_the_way:
        check_writable(path)
    for path in in_the_way:
        with atomic_write(path) as draft:
            draft.write_bytes(contents[path])
    begun: list[Path] = []
    for path in contents.keys() - existing:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # `x` fails if another program has written the file in the meantime.
            with path.open("xb") as file:
                begun.append(path)
                file.write(contents[path])
        except OSError as error:
            for begun_file in begun:
                begun_file.unlink(missing_ok=True)
            raise UsageError(unwritable_message(path, error)) from error
    return list(contents)


def modeline(scenario: Path, schema: Path) -> str:
    """Return the first line of a scenario, from which a YAML language server finds the schema."""
    relative = Path(os.path.relpath(schema.resolve(), scenario.resolve().parent))
    return f"# yaml-language-server: $schema={relative.as_posix()}"


def show_difference(rewrite: Rewrite) -> None:
    """Print the changes; to a file or a pipe byte for byte, so that `patch -p0` and `git apply -p0` can read
    them."""
    text = _difference(rewrite)
    print(terminal.printable(text) if sys.stdout.isatty() else text, end="")


def _difference(rewrite: Rewrite) -> str:
    """Return a unified diff."""
    name = files.display_path(rewrite.path)
    if name.isprintable():
        name += "\t" if " " in name else ""  # without it, `patch` reads the name up to the blank
    else:
        name = f'"{"".join(map(_quoted, os.fsencode(name)))}"'
    # Only \n separates lines here.
    before, after = (
        list(StringIO(data.decode("utf-8", "replace"))) for data in (rewrite.before, rewrite.after)
    )
    lines = unified_diff(before, after, name, name)
    return "".join(
        line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines
    )


def _quoted(byte: int) -> str:
    """Return a byte of an unusual file name as `git` and `patch` write it."""
    return chr(byte) if chr(byte).isprintable() and byte < 128 and chr(byte) not in '"\\' else f"\\{byte:03o}"


def write_change(rewrite: Rewrite) -> None:
    """Replace the file as a whole.

    Raises:
        UsageError: The file has changed since it was read, or the system refuses it; nothing is written.
    """
    path = rewrite.path
    with atomic_write(path) as draft:
        if path.read_bytes() != rewrite.before:
            raise UsageError(
                f"another program changed {files.display_path(path)} in the meantime, so it was not"
                " overwritten; run the command again"
            )
        with path.open("r+b"):  # a read-only file stays as it is, even if its folder permits replacing it
            pass
        draft.write_bytes(rewrite.after)


def write_values(name: str, values: Mapping[str, str], comment: str, permissions: Permissions) -> Path:
    """Write values into the file of a scenario, by the paths of their settings, with a comment on each of
    their lines.

    Raises:
        UsageError: The file comes with deepbots, has changed meanwhile, or its text does not allow a change;
            nothing is written.
    """
    from deepbots_cli.lint.fixes import Rewrite  # with the rules of lint

    opened = Source.open(name, permissions, SourceKind.SCENARIO)
    file = opened.path.resolve()
    if any(file.is_relative_to(root) for root in shipped.data_roots()):
        raise UsageError(
            f"{file.name} comes with deepbots; copy it with `deepbots new mine --from {file.stem}`, and name"
            " the copy: mine.yaml"
        )
    before = after = files.read(file)
    expected = opened.document(overrides=[f"{path}={text}" for path, text in values.items()], tests=True)
    for path, text in values.items():
        document = opened.document(drafts={file: after})
        root = document.root
        source = document.files[file]
        changed = (
            None if root is None else assigned_text(root, source, setting_path(root, path), text, comment)
        )
        if changed is None:
            raise UsageError(f"{file} cannot be changed by `deepbots apply`; write {path}: {text} yourself")
        after = (BOM_UTF8 if before.startswith(BOM_UTF8) else b"") + changed.encode()
    new_document = opened.document(drafts={file: after})
    if (
        expected.root is None
        or new_document.root is None
        or to_data(expected.root) != to_data(new_document.root)
    ):
        listed = ", ".join(f"{path}: {text}" for path, text in values.items())
        raise UsageError(f"{file} cannot be changed by `deepbots apply`; write the values yourself: {listed}")
    write_change(Rewrite(file, before, after))
    return file


EXPLOITS = Path("exploits")
_RECORD = "searched.json"
_MAX_RECORD = 100_000
"""The largest size of a record that is read, in bytes."""
_MAX_RECORDS = 1000


def folder_of_exploits(checked: CheckedScenario) -> Path:
    """Return the folder of a scenario.

    Raises:
        UsageError: The folder cannot be written to.
    """
    folder = EXPLOITS / checked.document.path.stem
    check_folder(folder)
    return folder


def keep_exploits(
    exploits: FoundExploits,
    checked: CheckedScenario,
    name: str,
    overrides: Sequence[str],
    permissions: Permissions,
) -> list[Finding]:
    """Record the episode of each exploit, and record that the task was searched. Returns the findings with
    the names of the recordings.

    Recordings of an earlier search of the scenario are replaced.

    Raises:
        UsageError: The folder cannot be written to.
    """
    assert checked.program is not None  # a scenario with errors is not searched
    folder = folder_of_exploits(checked)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(unwritable_message(folder, error)) from error
    for old in folder.glob(f"*{RECORDING_SUFFIX}"):
        # A search names its recordings after rules; those with other names stay.
        if old.stem in {rule.name for rule in RULES.values() if rule.deep == "exploits"}:
            old.unlink()
    findings: list[Finding] = []
    for finding, episode in exploits.exploits:
        if episode is None:
            findings.append(finding)
            continue
        file = folder / f"{finding.name}{RECORDING_SUFFIX}"
        note = f"`deepbots view {shell_word(file)}` shows the episode"
        try:
            from deepbots_cli.view.episodes import Showing
            from deepbots_cli.view.recordings import record
            from deepbots_cli.view.replay import closing_player

            with closing_player(Showing(name, overrides, permissions), episode.driver) as player:
                record(player, file, 0, [episode.number])
        except EngineError as error:
            note = f"the episode was not recorded: {error}"
        findings.append(replace(finding, notes=(*finding.notes, note)))
    if exploits.episodes:
        searched = {
            "task": identity.task_digest(checked.program),
            "episodes": exploits.episodes,
            "findings": [finding.code for finding in findings],
        }
        with atomic_write(folder / _RECORD) as draft:
            draft.write_text(json.dumps(searched) + "\n", encoding="utf-8")
    return findings


def was_searched(program: Program) -> bool:
    """Return whether `lint --exploits` has searched this task from this folder."""
    digest = identity.task_digest(program)
    for file in islice(EXPLOITS.glob(f"*/{_RECORD}"), _MAX_RECORDS):
        try:
            searched = json.loads(read_at_most(file, _MAX_RECORD)) if file.is_file() else None
        except (OSError, ValueError, RecursionError):
            continue
        if isinstance(searched, dict) and searched.get("task") == digest:
            return True
    return False
