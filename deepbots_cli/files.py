"""Files that are read up to a limit, or written whole or not at all."""

from __future__ import annotations

import csv
import errno
import os
import shutil
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from io import StringIO
from pathlib import Path
from tempfile import TemporaryFile

from deepbots_cli.errors import UsageError

_REMEDIES = {
    errno.ENOSPC: "; free some space there, and try again",
    errno.EDQUOT: "; free some space there, and try again",
    errno.EROFS: "; choose a place that may be written to",
    errno.EACCES: "; choose a place that may be written to",
    errno.EPERM: "; choose a place that may be written to",
}


Stamps = dict[Path, tuple[int, int] | None]
"""Time of change and size of each file, None for a missing one; they differ after a file was saved."""
READS: ContextVar[Stamps | None] = ContextVar("reads", default=None)
"""The files that were read or looked for by functions of this module within the innermost `recorded_reads`,
as they were before."""


@contextmanager
def recorded_reads() -> Iterator[Stamps]:
    """Collect the files that are read within the context, and those that are missing. A file that changes
    afterwards, also within the context, has another stamp."""
    reads: Stamps = {}
    token = READS.set(reads)
    try:
        yield reads
    finally:
        READS.reset(token)


def _note_read(path: Path) -> None:
    if (reads := READS.get()) is not None and path not in reads:
        reads |= file_stamps([path])


def read_at_most(path: Path, limit: int) -> bytes:
    """Return the first `limit` bytes of a file. `recorded_reads` collects its path.

    Raises:
        OSError: The file cannot be read.
    """
    _note_read(path)
    with path.open("rb") as file:
        # A buffer of `limit` bytes (32 MB for a mesh) fragments the heap: a process grew by 20 MB in 60 000
        # reads.
        size = os.fstat(file.fileno()).st_size
        data = file.read(min(size + 1, limit))
        # Special files, such as those in /proc, report size 0.
        return data if len(data) <= size else data + file.read(limit - len(data))


def is_file(path: Path) -> bool:
    """Return whether there is a file; False for a name that no file can have, because it is too long or has a
    null byte. `recorded_reads` collects its path."""
    _note_read(path)
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def unwritable_message(path: Path, error: OSError) -> str:
    """Return a sentence with the file that cannot be written, the reason, and what to do."""
    reason = (error.strerror or str(error).strip().partition("\n")[0] or "no reason given").lower()
    return f"{path} cannot be written: {reason}{_REMEDIES.get(error.errno or 0, '')}"


def check_writable(path: Path) -> None:
    """Find out before long work whether a file can be written.

    Raises:
        UsageError: It is a directory, its directory does not exist, or the system refuses to write there.
    """
    folder = path.absolute().parent
    if path.is_dir():
        raise UsageError(f"{path} cannot be written: it is a directory")
    if not folder.is_dir():
        raise UsageError(f"{path} cannot be written: there is no directory {path.parent}")
    # `/dev` refuses a temporary file to most users, although `/dev/null` itself can be written to.
    if path.exists() and not path.is_file():  # a device or a pipe
        return
    try:
        # `os.access` may answer wrongly, for example on network file systems.
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(unwritable_message(path, error)) from error


def check_output(*paths: Path, force: bool) -> None:
    """Find out before long work whether files can be written, and that none is overwritten unless `force`.

    Raises:
        UsageError: A file cannot be written, or exists.
    """
    for path in paths:
        check_writable(path)
    if present := [path for path in paths if path.is_file()]:
        refuse_overwriting(*present, force=force)


def refuse_overwriting(*present: Path, force: bool) -> None:
    """Refuse to overwrite these files or folders unless `force`.

    Raises:
        UsageError: `force` is false.
    """
    if not force:
        names = ", ".join(sorted(map(str, present)))
        is_single = len(present) == 1
        raise UsageError(
            f"{names} already exist{'s' * is_single}; overwrite {'it' if is_single else 'them'} with --force"
            " (in Python: force=True), "
            "or choose another name"
        )


def check_folder(folder: Path) -> None:
    """Find out before long work whether files can be written into a folder, which need not be there yet.

    Raises:
        UsageError: A file cannot be written there.
    """
    present = next(parent for parent in (folder, *folder.absolute().parents) if os.path.lexists(parent))
    if not present.is_dir():
        raise UsageError(f"{folder} cannot be written: {present} is not a directory")
    check_writable(present / "file")


def csv_text(rows: Sequence[Mapping[str, object]]) -> str:
    """Return rows as CSV, under the names of all their keys. No spreadsheet takes a cell for a formula."""
    names = [*dict.fromkeys(name for row in rows for name in row)]
    out = StringIO()
    csv.writer(out).writerows([names, *([_harmless(row.get(name)) for name in names] for row in rows)])
    return out.getvalue()


def _harmless(value: object) -> object:
    is_formula = isinstance(value, str) and value.lstrip()[:1] in tuple("=+-@")
    return f"'{value}" if is_formula else value


@contextmanager
def atomic_write(path: Path, refused: type[UsageError] = UsageError) -> Iterator[Path]:
    """Yield an empty file beside `path` to write to, which replaces `path` at the end and takes over its
    permissions.

    Readers never see half a file, and an exception leaves `path` as it was. There is no fsync: it protects
    from a killed process, not from a power cut.

    Raises:
        UsageError: The system refuses it; `refused` is the class to raise.
    """
    # `replace` would replace a symbolic link; the file that it leads to is written instead.
    path = path.resolve()
    # A rename is atomic only within a file system, so the draft is in the folder of the file.
    # The thread is part of the name because two threads may write the same file.
    # The name does not contain that of the file, which may be as long as names can be.
    draft = path.with_name(f".deepbots-{os.getpid()}-{threading.get_ident()}{path.suffix}")
    try:
        if path.exists() and not path.is_file():  # a device or a pipe, which is written to as it is
            yield path
            return
        # A killed process with the same number may have left this draft.
        draft.unlink(missing_ok=True)
        os.close(
            # O_EXCL refuses a symbolic link at this name, so the draft is never written through a link.
            os.open(
                draft,
                os.O_WRONLY | os.O_CREAT | os.O_EXCL,
                # The draft of a private file is private from the start; 0o600 lets this process write to it.
                path.stat().st_mode & 0o777 | 0o600 if path.exists() else 0o666,
            )
        )
        yield draft
        if path.exists():
            # `os.open` has removed the bits of the umask.
            shutil.copymode(path, draft)
        draft.replace(path)
    except OSError as error:
        raise refused(unwritable_message(path, error)) from error
    finally:
        draft.unlink(missing_ok=True)


def file_stamps(files: Iterable[Path]) -> Stamps:
    """Return the stamps of files as they are now."""
    stamps: Stamps = dict.fromkeys(files)
    for file in stamps:
        with suppress(OSError, ValueError):  # ValueError: a name with a null byte
            status = file.stat()
            stamps[file] = (status.st_mtime_ns, status.st_size)
    return stamps
