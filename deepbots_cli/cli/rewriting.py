"""Files that commands write: changes of the user's files, shown or made, and new files, which never replace others."""

from __future__ import annotations

import os
import sys
from io import StringIO
from pathlib import Path, PurePosixPath

from deepbots_cli import api
from deepbots_cli.cli.terminal import printable
from deepbots_cli.document.files import display
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic
from deepbots_cli.lint.fixes import Rewrite

Files = dict[PurePosixPath, bytes]
"""Contents by path below the folder that they are written to."""


def show(rewrite: Rewrite) -> None:
    """Print what would change; to a file or a pipe byte for byte, so that `patch -p0` and `git apply -p0` can read it."""
    text = _difference(rewrite)
    print(printable(text) if sys.stdout.isatty() else text, end="")


def _difference(rewrite: Rewrite) -> str:
    """A unified diff."""
    from difflib import unified_diff

    name = display(rewrite.path)
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
    with atomic(path) as draft:
        if path.read_bytes() != rewrite.before:
            raise UsageError(f"{display(path)} was changed by someone else meanwhile, and is left alone")
        with path.open("r+b"):  # a file that its owner made read-only stays as it is, though its folder would let it be replaced
            pass
        draft.write_bytes(rewrite.after)


# New files


def write_new(files: Files, folder: Path) -> list[Path]:
    """Write the files into `folder`; one that is already there with the same content is left alone.

    Raises:
        UsageError: Other files are in the way; lists them, and nothing is written.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file; name a folder, which need not be there yet")
    wanted = {folder / target: content for target, content in files.items()}
    present = {path for path in wanted if path.exists() or path.is_symlink()}
    in_the_way = [path for path in present if not path.is_file() or path.read_bytes() != wanted[path]]
    if in_the_way:
        raise UsageError(f"nothing was written, since there are already: {', '.join(sorted(map(str, in_the_way)))}")
    for path in wanted.keys() - present:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            file.write(wanted[path])
    return list(wanted)


def modeline(scenario: Path, schema: Path) -> str:
    """The first line of a scenario, from which a YAML language server finds the schema."""
    way = os.path.relpath(schema.resolve(), scenario.resolve().parent)
    return f"# yaml-language-server: $schema={Path(way).as_posix()}"


def write_with_schema(files: Files, folder: Path) -> list[Path]:
    """Write the files into `folder`, the first of them a scenario, with a schema for that one; the files that were written.

    Raises:
        UsageError: Other files are in the way; nothing is written.
    """
    (target, text), *others = files.items()
    schema = target.with_suffix(".schema.json")
    if os.path.lexists(folder / schema):
        raise UsageError(f"nothing was written, since there is already: {folder / schema}")
    led = f"{modeline(folder / target, folder / schema)}\n\n".encode() + text
    written = write_new({target: led, **dict(others)}, folder)
    from deepbots_cli.compiler.inventory import known  # lint, which uses other parts of this module, starts without the schema
    from deepbots_cli.scenario.json_schema import to_text

    return [*written, *write_new({PurePosixPath(schema): to_text(known(api.load(written[0]))).encode()}, folder)]
