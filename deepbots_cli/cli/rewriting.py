"""Files of the user written anew: shown as a difference, or put in place as a whole."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from deepbots_cli.atomic import atomic
from deepbots_cli.cli.terminal import printable
from deepbots_cli.document.files import display
from deepbots_cli.errors import UsageError


@dataclass(frozen=True)
class Rewrite:
    """One file, by its resolved path: what it held when it was read, and what it shall hold."""

    path: Path
    before: bytes
    after: bytes


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
    """Put the file in place as a whole, with the permissions that it had.

    Raises:
        UsageError: It is no longer what was read, or the system refuses it; nothing is written then.
    """
    path = rewrite.path
    with atomic(path) as draft:
        if path.read_bytes() != rewrite.before:
            raise UsageError(f"{display(path)} was changed by someone else meanwhile, and is left alone")
        with path.open("r+b"):  # a file that its owner made read-only stays as it is, though its folder would let it be replaced
            pass
        draft.write_bytes(rewrite.after)
