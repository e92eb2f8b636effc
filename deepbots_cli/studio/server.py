"""The web server of the studio: one address, one token, one session."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from deepbots_cli.cli.written_files import refuse_links_within
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.files import read_at_most
from deepbots_cli.studio.session import Session
from deepbots_cli.view import access

FIRST_PORT = 8750
"""The port of the first studio. A studio without a chosen port takes the next free one."""
_MAX_TEXT_BYTES = 4 << 20
_LOCK_NAME, _OWNER_NAME = "lock", "address"


@dataclass(frozen=True)
class Studio:
    """A studio before it serves. `address` is the URL of its page, with the token."""

    session: Session
    address: str
    serve: Callable[[], None]


def studio(
    source: str | Path,
    *,
    permissions: Permissions = Permissions(),
    host: str = access.LOOPBACK,
    port: int | None = None,
) -> Studio:
    """Prepare the studio of a folder, or of a scenario in it.

    Args:
        source: A folder, or a scenario file.
        host: The address to listen on.
        port: The port; None takes the first free one from `FIRST_PORT` on.

    Raises:
        UsageError: There is no such file or folder, another studio shows it, or the address cannot be used.
        MissingExtraError: NiceGUI is not installed.
    """
    path = Path(source)
    if not path.exists():
        raise UsageError(
            f"there is no file or folder {path}; write a scenario first: deepbots new mine --template"
            " cartpole"
        )
    folder = path if path.is_dir() else path.parent
    try:
        import uvicorn

        from deepbots_cli.studio.application import application_of
    except ModuleNotFoundError as error:
        raise MissingExtraError("studio", "the studio") from error
    session = Session(folder, permissions)
    first = path if path.is_file() else next(iter(session.scenarios()), None)
    if first is not None and not session.may_open(first):
        raise UsageError(f"{first} is no YAML file in {session.folder}")
    host = access.plain_address(host)
    listener = access.listening_socket(host, port, FIRST_PORT)
    number = int(listener.getsockname()[1])
    lock = _lock(session, access.address(host, number, ""))
    gate = access.Gate(host, number, access.new_token())
    application = application_of(session, gate, first)
    server = uvicorn.Server(
        uvicorn.Config(
            application,
            log_level="critical",
            access_log=False,
            lifespan="on",
            timeout_graceful_shutdown=1,
            ws_max_size=_MAX_TEXT_BYTES,
        )
    )

    def serve() -> None:
        with lock:
            server.run([listener])

    return Studio(session, access.address(host, number, gate.token), serve)


def _lock(session: Session, address: str) -> AbstractContextManager[object]:
    """Return the lock of the folder, which ends with the process.

    Raises:
        UsageError: Another studio has it, or the folder of the studio has links.
    """
    from filelock import FileLock, Timeout

    state = session.state_folder
    if state.is_symlink():
        raise UsageError(f"{state} is a symbolic link; remove it, and start the studio again")
    refuse_links_within(state)
    try:
        state.mkdir(parents=True, exist_ok=True)
        lock = FileLock(state / _LOCK_NAME)
        lock.acquire(timeout=0)
        (state / _OWNER_NAME).write_text(f"{address} (process {os.getpid()})", encoding="utf-8")
    except Timeout:
        raise UsageError(
            f"another studio shows {session.folder}: {_owner(state)}; use its page, or end it first"
        ) from None
    except OSError:  # in a folder that cannot be written, nothing can be lost
        return nullcontext()
    return lock


def _owner(state: Path) -> str:
    try:
        return read_at_most(state / _OWNER_NAME, 200).decode("utf-8", "replace")
    except OSError:
        return "its address is unknown"
