"""The checks in front of the studio, and the page of the robot behind its address, as ASGI applications.

Every request passes the checks, those of NiceGUI for its files and web sockets too: host, origin and token
(`view/access.py`). The page of the robot has its own port, which only this machine reaches; its requests are
passed on below `/robot/`, so that one port is enough, for example through a tunnel of ssh.
"""

from __future__ import annotations

import asyncio
import http.client
import urllib.parse
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from contextlib import suppress
from typing import Any

from starlette.datastructures import Headers

from deepbots_cli.view.access import Gate

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

ROBOT_PATH = "/robot/"
_ROBOT_SOCKETS = {"/robot": "/", "/robot/": "/", "/robot/drive": "/drive"}
"""The web sockets of the robot's page, and their paths there; viser opens its own without the last slash."""
_POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:;"
    " connect-src 'self' ws: data: blob:; frame-ancestors {}; form-action 'none'; base-uri 'none'"
)
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


class Guarded:
    """The application of the studio behind its checks."""

    def __init__(self, inner: Application, gate: Gate, robot_address: Callable[[], str]) -> None:
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
        await self._inner(scope, limited, _with_policy(send, "'none'"))

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


def _with_policy(send: Send, ancestors: str) -> Send:
    """Return a sender that adds the headers of safety to answers without; a stricter policy stays."""
    policy = _POLICY.format(ancestors)
    added = {
        "content-security-policy": policy,
        "x-content-type-options": "nosniff",
        "referrer-policy": "no-referrer",
    }

    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            present = {name.decode("latin-1").lower() for name, _ in message["headers"]}
            new = [(name.encode(), text.encode()) for name, text in added.items() if name not in present]
            message["headers"] = [*message["headers"], *new]
        await send(message)

    return sending


async def _answer(
    send: Send, status: int, body: bytes, headers: Mapping[str, str], ancestors: str = "'none'"
) -> None:
    contents = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), **headers}
    encoded = [(name.lower().encode(), value.encode()) for name, value in contents.items()]
    sending = _with_policy(send, ancestors)
    await sending({"type": "http.response.start", "status": status, "headers": encoded})
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
