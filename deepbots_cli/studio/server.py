"""The web server of the studio: one address, one token, one session."""

from __future__ import annotations

import asyncio
import gc
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.studio.session import Session
from deepbots_cli.view import access

FIRST_PORT = 8750
"""The port of the first studio. A studio without a chosen port takes the next free one."""
_MAX_TEXT_BYTES = 4 << 20
_MEDIA_TYPES = {".html": "text/html", ".mp4": "video/mp4", ".gif": "image/gif", ".png": "image/png"}
_OUTPUT_POLICY = "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:; frame-ancestors 'none'"


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
        UsageError: There is no such file or folder, or the address cannot be used.
        MissingExtraError: NiceGUI is not installed.
    """
    path = Path(source)
    if not path.exists():
        raise UsageError(
            f"there is no file or folder {path}; write a scenario first: deepbots new mine --template cartpole"
        )
    folder = path if path.is_dir() else path.parent
    try:
        import nicegui  # noqa: F401
        import uvicorn
    except ModuleNotFoundError as error:
        raise MissingExtraError("studio", "the studio") from error
    session = Session(folder, permissions)
    first = path if path.is_file() else next(iter(session.scenarios()), None)
    if first is not None and not session.may_open(first):
        raise UsageError(f"{first} is no YAML file in {session.folder}")
    host = access.plain_address(host)
    number = access.free_port(host, port, FIRST_PORT)
    gate = access.Gate(host, number, access.new_token())
    application = _application(session, gate, first)
    server = uvicorn.Server(
        uvicorn.Config(
            application,  # type: ignore[arg-type]
            host=host,
            port=number,
            log_level="critical",
            access_log=False,
            lifespan="on",
            timeout_graceful_shutdown=1,
            ws_max_size=_MAX_TEXT_BYTES,
        )
    )
    return Studio(session, access.address(host, number, gate.token), server.run)


def _application(session: Session, gate: access.Gate, first: Path | None) -> Any:
    from fastapi import FastAPI
    from nicegui import ui

    from deepbots_cli.studio.gate import Guarded
    from deepbots_cli.studio.page import StudioPage, add_style

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        # Each analysis collects garbage, which visited the 400 000 objects of the imports every time.
        gc.collect()
        gc.freeze()
        if first is not None:
            session.show(first)
        watching = asyncio.create_task(session.run_forever())
        try:
            yield
        finally:
            watching.cancel()
            await session.close()

    application = FastAPI(lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)
    _add_routes(application, session)
    add_style()

    def root() -> None:
        StudioPage(session)

    ui.run_with(
        application,
        root=root,
        title="deepbots studio",
        dark=None,
        tailwind=False,
        show_welcome_message=False,
        binding_refresh_interval=0.5,
        reconnect_timeout=60.0,
    )
    return Guarded(application, gate, lambda: session.robot.address)


def _add_routes(application: Any, session: Session) -> None:
    from fastapi import Request, Response

    async def place(request: Request) -> tuple[Path, str, int, int] | None:
        """Return file, text, line and column of a request; None if it is none."""
        try:
            content = json.loads(await request.body())
            path = Path(content["path"])
            text, line, column = content["text"], content["line"], content["column"]
        except (ValueError, TypeError, KeyError, RecursionError):
            return None
        is_place = isinstance(text, str) and isinstance(line, int) and isinstance(column, int)
        return (path, text, line, column) if is_place and path in session.files else None

    @application.post("/studio/complete")
    async def complete(request: Request) -> Any:
        at = await place(request)
        return {"options": []} if at is None else session.language.complete(*at)

    @application.post("/studio/hover")
    async def hover(request: Request) -> Any:
        at = await place(request)
        return None if at is None else session.language.hover(*at)

    @application.get("/studio/output/{number}")
    async def output(number: str) -> Response:
        task = next((each for each in session.tasks.all if each.path.name == number), None)
        file = session.folder / task.record.output if task is not None and task.record.output else None
        kind = _MEDIA_TYPES.get(file.suffix) if file is not None else None
        if file is None or kind is None or not file.resolve().is_relative_to(session.folder):
            return Response("there is no such file\n", 404)
        try:
            content = await asyncio.to_thread(file.read_bytes)
        except OSError:
            return Response("the file is gone\n", 404)
        return Response(content, media_type=kind, headers={"Content-Security-Policy": _OUTPUT_POLICY})
