"""Changes of the user's files, shown as a difference or written.

They are the fixes of `lint`, the layout of `fmt`, and the values of `apply`.
"""

from __future__ import annotations

import os
import sys
from codecs import BOM_UTF8
from collections.abc import Mapping
from difflib import unified_diff
from io import StringIO
from pathlib import Path

from deepbots_cli.cli import terminal
from deepbots_cli.document import Permissions, files, shipped, to_data
from deepbots_cli.document.edits import assigned_text
from deepbots_cli.document.load import setting_path
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.lint.fixes import Rewrite
from deepbots_cli.rollout.source import Source, SourceKind


def show(rewrite: Rewrite) -> None:
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


def write(rewrite: Rewrite) -> None:
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
    write(Rewrite(file, before, after))
    return file
