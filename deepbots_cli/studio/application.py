"""The application of the studio: the page, and the answers to requests of its editor."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from nicegui import ui

from deepbots_cli.studio.gate import Guarded
from deepbots_cli.studio.page import StudioPage, add_style
from deepbots_cli.studio.session import Session
from deepbots_cli.studio.start import PICTURES
from deepbots_cli.view import access

_MEDIA_TYPES = {".html": "text/html", ".mp4": "video/mp4", ".gif": "image/gif", ".png": "image/png"}
_PAGE_POLICY = "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:; frame-ancestors 'none'"
_MEDIA_POLICY = (
    "default-src 'none'; img-src 'self'; media-src 'self'; style-src 'unsafe-inline'; frame-ancestors 'none'"
)
"""For pictures and videos, which have no scripts: in a sandbox, the player would ask for a video without the
token."""


def application_of(session: Session, gate: access.Gate, first: Path | None) -> Guarded:
    """Return the application behind its checks. `first` is the scenario that it shows first, if any."""

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        # Each analysis collects garbage, and would visit the 400,000 objects of the imports.
        gc.collect()
        gc.freeze()
        if first is not None:
            session.show(first)
        watching = asyncio.create_task(session.run_forever())
        try:
            yield
        finally:
            watching.cancel()
            with suppress(asyncio.CancelledError):
                await watching
            await session.close()

    application = FastAPI(lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)
    _Routes(session).add_to(application)
    add_style()

    def root() -> None:
        StudioPage(session)

    ui.run_with(
        application,
        root=root,
        title="deepbots studio",
        dark=None,
        language="en-US",
        tailwind=False,
        show_welcome_message=False,
        binding_refresh_interval=0.5,
        reconnect_timeout=60.0,
    )
    return Guarded(application, gate, lambda: session.robot.address)


class _Routes:
    """The answers to requests of the editor, and the files that commands have written."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add_to(self, application: FastAPI) -> None:
        application.add_route("/studio/complete", self._complete, methods=["POST"])
        application.add_route("/studio/hover", self._hover, methods=["POST"])
        application.add_route("/studio/picture", self._picture, methods=["GET"])
        application.add_route("/studio/output/{number}", self._output, methods=["GET"])
        application.mount("/studio/pictures", StaticFiles(directory=PICTURES))

    async def _complete(self, request: Request) -> Response:
        place = await self._place(request)
        return JSONResponse({"options": []} if place is None else self._session.language.complete(*place))

    async def _hover(self, request: Request) -> Response:
        place = await self._place(request)
        return JSONResponse(None if place is None else self._session.language.hover(*place))

    async def _place(self, request: Request) -> tuple[Path, str, int, int] | None:
        """Return file, text, line and column of a request; None if it has none."""
        try:
            content = await request.json()
            path = Path(content["path"])
            text, line, column = content["text"], content["line"], content["column"]
        except (ValueError, TypeError, KeyError, RecursionError):
            return None
        is_place = isinstance(text, str) and all(type(at) is int and at >= 0 for at in (line, column))
        return (path, text, line, column) if is_place and path in self._session.files else None

    async def _picture(self, _: Request) -> Response:
        content = await self._session.picture()
        return Response(content, media_type="image/png") if content else Response("no picture\n", 404)

    async def _output(self, request: Request) -> Response:
        number = request.path_params["number"]
        session = self._session
        task = next(
            (candidate for candidate in session.commands.tasks.all if candidate.path.name == number), None
        )
        file = session.folder / task.record.output if task is not None and task.record.output else None
        kind = _MEDIA_TYPES.get(file.suffix) if file is not None else None
        if file is None or kind is None or not file.resolve().is_relative_to(session.folder):
            return Response("there is no such file\n", 404)
        if not file.is_file():
            return Response("the file is gone\n", 404)
        policy = _PAGE_POLICY if kind == "text/html" else _MEDIA_POLICY
        return FileResponse(file, media_type=kind, headers={"Content-Security-Policy": policy})
