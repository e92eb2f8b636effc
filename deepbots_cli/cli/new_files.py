"""New files in a folder, which replace no others, and the first line that names the schema of a scenario."""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath

from deepbots_cli.errors import UsageError
from deepbots_cli.files import (
    atomic_write,
    check_folder,
    check_writable,
    refuse_overwriting,
    unwritable_message,
)

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
