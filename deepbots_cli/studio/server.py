"""The web server of the studio: one address, one token, one session.

Every request passes the checks of `view/server.py` (host, origin, token), those of NiceGUI for its files and
web sockets too. The page of the robot has its own port, which only this machine reaches; its requests are
passed on below `/robot/`, so that one port is enough, for example through a tunnel of ssh.
"""

from __future__ import annotations

import asyncio
import gc
import http.client
import os
import urllib.parse
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, MutableMapping
from contextlib import AbstractContextManager, asynccontextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from nicegui import ui
from starlette.datastructures import Headers

from deepbots_cli.cli.written_files import refuse_links_within
from deepbots_cli.course.grading import started_in
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.files import read_at_most
from deepbots_cli.records import dataclass
from deepbots_cli.studio.dialogs import PICTURES
from deepbots_cli.studio.page import StudioPage, add_style
from deepbots_cli.studio.robot_pane import ROBOT_PATH
from deepbots_cli.studio.session import Session
from deepbots_cli.view import server as web

FIRST_PORT = 8750
"""The port of the first studio. A studio without a chosen port takes the next free one."""
_MAX_TEXT_BYTES = 4 << 20
_LOCK_NAME, _OWNER_NAME = "lock", "address"
_MEDIA_TYPES = {".html": "text/html", ".mp4": "video/mp4", ".gif": "image/gif", ".png": "image/png"}
_PAGE_POLICY = "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:; frame-ancestors 'none'"
_MEDIA_POLICY = (
    "default-src 'none'; img-src 'self'; media-src 'self'; style-src 'unsafe-inline'; frame-ancestors 'none'"
)
"""For pictures and videos, which have no scripts: in a sandbox, the player would ask for a video without the
token."""
_ROBOT_SOCKETS = {"/robot": "/", "/robot/": "/", "/robot/drive": "/drive"}
"""The web sockets of the robot's page, and their paths there; viser opens its own without the last slash."""
_HEAD = """<meta name="color-scheme" content="%s"><style>
html, body { background: var(--mantine-color-body, %s); }
.mantine-Notification-root[style*="orange"] { display: none !important; }
:root { --mantine-color-dimmed: %s !important; } .mantine-Button-label { color: %s; }
html:root[data-mantine-color-scheme="dark"] { --mantine-color-body: #16191f; --mantine-color-dark-7: #16191f;
  --mantine-color-dark-6: #20242c; --mantine-color-dark-5: #2a2f39; --mantine-color-dark-4: #343a46;
  --mantine-color-dark-3: #566073; --mantine-color-dark-2: #a9b2c0; --mantine-color-placeholder: #a9b2c0; }
[data-mantine-color-scheme="dark"] [style*="rgb(20, 20, 20)"] { background: #16191f !important; }
[data-mantine-color-scheme="dark"] [role="tab"][aria-selected="true"] { color: #8fc1f5 !important; }
[data-mantine-color-scheme="dark"] canvas[data-engine] { filter: brightness(0.72); }
@media (min-width: 30rem) { .mantine-ScrollArea-content { padding-right: 11px; } }
.mantine-ScrollArea-content .mantine-ScrollArea-content { padding: 0; }
html:root [role="tab"] { padding-inline: 0.36em !important; }
.mantine-ScrollArea-content [style*="width: 7.25em"] { width: 5.2em !important; }
@media (min-width: 36.01em) { div:has(> div > .tabler-icon-cloud-check) { display: none !important; } }
html.waits::before { content: "starting the robot ..."; position: fixed; inset: 0; z-index: 9999;
  background: inherit; display: grid; place-items: center; font: 15px sans-serif;
  color: var(--mantine-color-dimmed); }
html.waits::after { content: ""; position: fixed; inset: 0 0 5rem; margin: auto; z-index: 9999; width: 1.6rem;
  height: 1.6rem; border-radius: 1rem; border: 3px solid color-mix(in srgb, currentColor, transparent);
  border-top-color: #4a93d0;
  animation: turn 0.9s linear infinite; }
@keyframes turn { to { rotate: 1turn; } }</style><script>
addEventListener("keydown", (event) => {
  if (event.key == "F6" || (event.key == "Escape" && !event.defaultPrevented)) {
    event.preventDefault();
    parent.document.querySelector(".studio-enter")?.focus();
  }
  const isKey = (event.ctrlKey || event.metaKey) && /^(s|z|y|Enter)$/i.test(event.key);
  if (isKey && !event.target.matches?.("input, textarea")) {
    event.preventDefault();
    parent.dispatchEvent(new KeyboardEvent("keydown", event));
  }
});
const begin = Date.now();
const look = setInterval(() => {
  const waits = !document.querySelector(".tabler-icon-cloud-check") && Date.now() - begin < 60000;
  document.documentElement.classList.toggle("waits", waits);
  if (!waits) clearInterval(look);
}, 150);</script>"""
"""What is added to the page of the robot:

- its ground, which would be white before anything is drawn;
- no notice of viser that the browser draws by software: it covers the robot;
- no head of the controls while they are connected, because the page has the name of the scenario already; in
  a narrow window, it opens and closes them;
- labels of enough contrast, a place for the scroll bar beside the buttons, and all tabs in one row;
- the dark colors of `studio.css`, in which the floor of the scene does not glare;
- the keys that lead out of the page, and those of the editor;
- a word and a ring in place of the controls until they are connected.
"""
_GROUND = {
    False: ("light", "#ffffff", "#56606d", "#1a6bb0"),
    True: ("dark", "#16191f", "#a9b2c0", "#7db8ec"),
}
_MAX_MESSAGE_BYTES = 1 << 20
_MAX_REQUEST_BYTES = 20 << 20

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]


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
    host: str = web.LOOPBACK,
    port: int | None = None,
) -> Studio:
    """Prepare the studio of a folder, or of a scenario in it.

    Args:
        source: A folder, or a scenario file.
        host: The address to listen on.
        port: The port; None takes the first free one from `FIRST_PORT` on.

    Raises:
        UsageError: There is no such file or folder, another studio shows it, or the address cannot be used.
    """
    path = Path(source)
    if not path.exists():
        raise UsageError(
            f"there is no file or folder {path}; write a scenario first: deepbots new mine --template"
            " cartpole"
        )
    folder = path if path.is_dir() else path.parent
    session = Session(folder, permissions)
    first = path.absolute() if path.is_file() else next(iter(session.scenarios()), None)
    with suppress(UsageError):  # of a lesson that is not on this machine
        if path.is_dir() and (started := started_in(session.folder)) and started.scenario.is_file():
            first = started.scenario
    if first is not None and not session.may_open(first):
        raise UsageError(f"{first} is no YAML file in {session.folder}")
    host = web.plain_address(host)
    listener = web.listening_socket(host, port, FIRST_PORT)
    number = int(listener.getsockname()[1])
    lock = _lock(session, web.address(host, number, ""))
    gate = web.Gate(host, number, web.new_token())
    server = uvicorn.Server(
        uvicorn.Config(
            application_of(session, gate, first),
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

    return Studio(session, web.address(host, number, gate.token), serve)


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
            f"another studio shows {session.folder}: {_owner(state)}; open the address with the token that it"
            " printed, or end it first"
        ) from None
    except OSError:  # in a folder that cannot be written, nothing can be lost
        return nullcontext()
    return lock


def _owner(state: Path) -> str:
    try:
        return read_at_most(state / _OWNER_NAME, 200).decode("utf-8", "replace")
    except OSError:
        return "its address is unknown"


# The application


def application_of(session: Session, gate: web.Gate, first: Path | None) -> Guarded:
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


# The checks, and the page of the robot


class Guarded:
    """The application of the studio behind its checks."""

    def __init__(self, inner: Application, gate: web.Gate, robot_address: Callable[[], str]) -> None:
        """`robot_address` returns the URL of the robot's page with its token, empty while there is none."""
        self._inner, self._gate, self._robot_address = inner, gate, robot_address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._inner(scope, receive, send)
            return
        is_socket = scope["type"] == "websocket"
        path, query = scope["path"], scope.get("query_string", b"").decode("latin-1")
        refusal = self._gate.refuse(path, query, Headers(scope=scope), opens_socket=is_socket)
        if refusal is not None:
            if is_socket:
                await receive()
                await send({"type": "websocket.close", "code": 1008})
            else:
                await _answer(send, refusal.status, refusal.text.encode(), refusal.headers)
            return
        if f"{path}/".startswith(ROBOT_PATH):
            if is_socket:
                await _pass_socket(self._robot_address(), scope, receive, send)
            else:
                await self._pass_page(scope, send)
            return
        limited = receive if is_socket else _limited(receive)
        await self._inner(scope, limited, _with_policy(send))

    async def _pass_page(self, scope: Scope, send: Send) -> None:
        """Answer with the page of the robot."""
        address = self._robot_address()
        if not address or scope["path"] != ROBOT_PATH:
            await _answer(send, 404 if address else 503, b"there is no robot yet\n", {})
            return
        try:
            body = await asyncio.to_thread(_fetch, address)
        except OSError:
            await _answer(send, 503, b"the robot is being restarted\n", {})
            return
        is_dark = b"darkMode" in scope.get("query_string", b"")
        head = _HEAD % _GROUND[is_dark]
        body = body.replace(b"<head>", b"<head>" + head.encode(), 1)
        headers = {"Content-Type": "text/html; charset=utf-8", "Cache-Control": "no-store"}
        await _answer(send, 200, body, headers, "'self'")


def _limited(receive: Receive) -> Receive:
    """Return a receiver that ends a request of too many bytes."""
    size = 0

    async def limited() -> MutableMapping[str, Any]:
        nonlocal size
        message = await receive()
        size += len(message.get("body", b""))
        return message if size <= _MAX_REQUEST_BYTES else {"type": "http.disconnect"}

    return limited


def _with_policy(send: Send, ancestors: str = "'none'") -> Send:
    """Return a sender that adds the headers of safety to answers without; a stricter policy stays."""
    added = _encoded(web.safe_headers(ancestors))

    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            present = {name.lower() for name, _ in message["headers"]}
            message["headers"] = [*message["headers"], *(pair for pair in added if pair[0] not in present)]
        await send(message)

    return sending


def _encoded(headers: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.lower().encode(), value.encode()) for name, value in headers.items()]


async def _answer(
    send: Send, status: int, body: bytes, headers: Mapping[str, str], ancestors: str = "'none'"
) -> None:
    contents = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), **headers}
    sending = _with_policy(send, ancestors)
    await sending({"type": "http.response.start", "status": status, "headers": _encoded(contents)})
    await sending({"type": "http.response.body", "body": body})


def _cookie(address: str) -> tuple[str, str]:
    """Return host with port, and the cookie of the robot's page."""
    parts = urllib.parse.urlsplit(address)
    token = urllib.parse.parse_qs(parts.query).get("token", [""])[0]
    return parts.netloc, f"deepbots-{parts.port}={token}"


def _fetch(address: str) -> bytes:
    """Return the page of the robot.

    Raises:
        OSError: It cannot be had.
    """
    host, cookie = _cookie(address)
    connection = http.client.HTTPConnection(host, timeout=10)
    try:
        connection.request("GET", "/", headers={"Cookie": cookie})
        answer = connection.getresponse()
        if answer.status != 200:
            raise OSError(answer.status)
        return answer.read()
    except http.client.HTTPException as error:
        raise OSError(str(error)) from error
    finally:
        connection.close()


async def _pass_socket(address: str, scope: Scope, receive: Receive, send: Send) -> None:
    """Pass the messages of a web socket on, in both directions, until one side closes it."""
    from websockets.asyncio.client import connect
    from websockets.exceptions import WebSocketException

    await receive()  # the message that asks for the connection
    path = _ROBOT_SOCKETS.get(scope["path"])
    if not address or path is None:
        await send({"type": "websocket.close", "code": 1013})
        return
    host, cookie = _cookie(address)
    try:
        async with connect(
            f"ws://{host}{path}",
            origin=f"http://{host}",
            additional_headers={"Cookie": cookie},
            subprotocols=scope.get("subprotocols") or None,
            max_size=None,
            compression=None,
            proxy=None,
        ) as wire:
            await send({"type": "websocket.accept", "subprotocol": wire.subprotocol})
            tasks = [
                asyncio.create_task(_upwards(receive, wire)),
                asyncio.create_task(_downwards(wire, send)),
            ]
            _, pending = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in pending:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
    except (OSError, WebSocketException):
        pass
    with suppress(Exception):  # the browser has closed it already
        await send({"type": "websocket.close", "code": 1001})


async def _upwards(receive: Receive, wire: Any) -> None:
    while True:
        message = await receive()
        if message["type"] == "websocket.disconnect":
            return
        content = message.get("bytes") or message.get("text") or b""
        if len(content) > _MAX_MESSAGE_BYTES:
            return
        await wire.send(content)


async def _downwards(wire: Any, send: Send) -> None:
    async for content in wire:
        kind = "text" if isinstance(content, str) else "bytes"
        await send({"type": "websocket.send", kind: content})
