"""Files that are either whole or as they were."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deepbots_cli.errors import UsageError


@contextmanager
def atomic(path: Path, refused: type[UsageError] = UsageError) -> Iterator[Path]:
    """Yield an empty file beside `path` to write to, which replaces `path` at the end and takes over its permissions.

    Readers never see half a file, and an exception leaves `path` as it was. There is no fsync: it protects from a killed process,
    not from a power cut.

    Raises:
        UsageError: The system refuses it; `refused` is the class to raise.
    """
    path = path.resolve()
    # The name does not contain that of the file, which may be as long as names can be.
    draft = path.with_name(f".deepbots-{os.getpid()}-{threading.get_ident()}{path.suffix}")
    try:
        if path.exists() and not path.is_file():  # a device or a pipe, which is written to as it is
            yield path
            return
        draft.unlink(missing_ok=True)
        os.close(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, path.stat().st_mode & 0o777 | 0o600 if path.exists() else 0o666))
        yield draft
        if path.exists():
            shutil.copymode(path, draft)
        draft.replace(path)
    except OSError as error:
        raise refused(f"{path} cannot be written: {(error.strerror or str(error) or 'no reason given').lower()}") from error
    finally:
        draft.unlink(missing_ok=True)
