"""The web server of a page: viser's, behind checks that it lacks.

    Host       must be the host and port of the server, so that no other site can reach it by another name
    Origin     of a web socket must be this server
    token      is required beyond loopback, and for a page that writes files; the first request sends it, and
               a cookie keeps it
    paths      `/` is the page, `/drive` takes keys and gamepads; no file is served
    messages   have at most 1 MB; a message that cannot be read closes the connection and is not logged; a
               value that a control does not offer is ignored

viser has no place for such checks, so its websocket server is wrapped while a `ViserServer` is made. `viser`
is pinned to 1.1 for this.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import io
import ipaddress
import json
import logging
import math
import secrets
import socket
import urllib.parse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.view import viser_internals
from deepbots_cli.view.manual_input import KEYS, Axes, Keys

if TYPE_CHECKING:
    import viser
    from websockets.http11 import Response

MAX_MESSAGE_BYTES = 1 << 20
LOOPBACK = "127.0.0.1"
FIRST_PORT = 8787
"""The port of the first page. A page without a chosen port takes the next free one."""
_MAX_PORTS = 20
_MAX_NUMBER, _MAX_TEXT = 2**53, 1_000
"""The limits of the value of a control that has no limits of its own."""

_CONTENT_SECURITY_POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:; connect-src 'self' ws:"
    " data: blob:; "
    "frame-ancestors 'none'; form-action 'none'; base-uri 'none'"
)
# Goes into viser's page: keys that are held, and gamepads, which viser lacks. It takes keys before viser
# does, whose camera would move.
_KEYS_SCRIPT = """<script>{
const codes = new Set(CODES), held = new Set();
let wire = null, last = "";
const key = e => {
  if (!codes.has(e.code) || e.ctrlKey || e.metaKey || e.altKey || e.target.closest?.("input, textarea, select")) return;
  e.stopImmediatePropagation(); e.preventDefault();
  e.type == "keydown" ? held.add(e.code) : held.delete(e.code); };
addEventListener("keydown", key, true); addEventListener("keyup", key, true);
addEventListener("blur", () => held.clear());
setInterval(() => {
  const pad = [...(navigator.getGamepads?.() ?? [])].find(pad => pad);
  const axes = pad ? pad.axes.slice(0, 4).map(x => Math.abs(x) > 0.12 ? x : 0) : [];
  const now = [...held].join("+") + "|" + (axes.some(x => x) ? axes.map(x => x.toFixed(3)).join() : "");
  if (now == "|" && last == "|") return;
  if (!wire || wire.readyState > 1) wire = new WebSocket("/drive");
  else if (wire.readyState == 1) { wire.send(now); last = now; } }, 50); }</script></head>""".replace(
    "CODES", json.dumps(KEYS)
)

# All tabs fit in a row. In a window that is narrower than viser's limit (36em), its panel lies over the
# world; here it stands below.
_STYLE = """<style>[role=tab] { padding-inline: 0.5em !important; } @media (max-width: 36em) {
  div:has(> .mantine-Paper-root[style*="fixed"]) { flex-direction: column !important; }
  .mantine-Paper-root[style*="fixed"] { position: relative !important; flex-shrink: 0; width: 100% !important;
    max-height: 50% !important; }
  .mantine-Paper-root[style*="fixed"] [style*="width: 20em"] { width: 100% !important; }
  .mantine-Notifications-root { top: auto !important; bottom: 0.5em !important; }
  .mantine-Notification-description { display: none; } }</style>"""

OnDrive = Callable[[Keys, Axes], None]


def serve(
    host: str, port: int | None, label: str, on_drive: OnDrive, *, writes: bool = False
) -> tuple[viser.ViserServer, str]:
    """Start the server in a thread. Returns the server, and the address of the page with its token, if any.

    Args:
        host: The address to listen on. Beyond loopback the page requires a token.
        port: None takes the first free one from `FIRST_PORT` on, 0 any.
        label: The title of the page.
        on_drive: Called in the server's thread with the keys that are held and the axes of a gamepad.
        writes: Whether the page can write files. It then requires a token on loopback too, because other
            users of the machine can reach it.

    Raises:
        UsageError: The host is unknown, or the port is in use.
        MissingExtraError: viser is not installed.
    """
    try:
        import viser
    except ModuleNotFoundError as error:
        raise MissingExtraError("view", "a page in the browser") from error
    host = _plain_address(host)
    number = _free_port(host, port)
    token = "" if _is_loopback(host) and not writes else secrets.token_urlsafe(16)
    for name in ("websockets", "websockets.server", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with _guarded(host, token, on_drive), contextlib.redirect_stdout(io.StringIO()):  # viser prints a banner
        server = viser.ViserServer(host, number, label=label, verbose=False)
    viser_internals.check_updates(server, _is_offered)
    if host in ("0.0.0.0", "::"):
        shown = socket.gethostname()
    elif ":" in host:
        shown = f"[{host}]"
    else:
        shown = host
    return server, f"http://{shown}:{server.get_port()}/" + (f"?token={token}" if token else "")


def stop(server: viser.ViserServer) -> None:
    """End a server."""
    with contextlib.redirect_stdout(io.StringIO()):  # viser prints that it ends
        server.stop()


def _plain_address(host: str) -> str:
    """Return the plain form of an address as the system reads it, such as `127.0.0.1` for `127.1`; a name
    stays as it is."""
    if host.split() == [host]:  # the system also reads a number before blanks
        with contextlib.suppress(OSError, UnicodeError):
            return socket.inet_ntoa(socket.inet_aton(host))
    return host


def _is_loopback(host: str) -> bool:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def _is_offered(value: object, control: Any) -> bool:
    """Return whether a control can have this value: an option, a number in its range, or a text."""
    options = getattr(control.props, "options", None)
    if options is not None:
        return isinstance(value, str) and value in options
    if isinstance(control.value, bool):
        return isinstance(value, bool)
    if isinstance(control.value, int | float):
        low, high = (getattr(control.props, end, None) for end in ("min", "max"))
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _MAX_NUMBER:
            return False
        # A slider rounds its value to its steps.
        slack = 1e-6 * abs(high - low) if low is not None and high is not None else 0.0
        return (low is None or value >= low - slack) and (high is None or value <= high + slack)
    return isinstance(value, str) and isinstance(control.value, str) and len(value) <= _MAX_TEXT


def _free_port(host: str, port: int | None) -> int:
    """Return a port that can be listened on; viser would silently take another one than the chosen one."""
    for number in [port] if port is not None else range(FIRST_PORT, FIRST_PORT + _MAX_PORTS):
        try:
            family, kind, _, _, address = socket.getaddrinfo(host, number, type=socket.SOCK_STREAM)[0]
            with socket.socket(family, kind) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
                return int(probe.getsockname()[1])
        except (socket.gaierror, UnicodeError):
            raise UsageError(
                f"there is no host '{host}'; use 127.0.0.1 for this machine only, or 0.0.0.0 for all its"
                " networks"
            ) from None
        except OSError as error:
            if port is not None or error.errno != errno.EADDRINUSE:
                reason = (
                    "is in use"
                    if error.errno == errno.EADDRINUSE
                    else f"cannot be used ({(error.strerror or '').lower()})"
                )
                raise UsageError(
                    f"port {number} of {host} {reason}; choose another one with --port"
                ) from None
    raise UsageError(
        f"the ports from {FIRST_PORT} to {FIRST_PORT + _MAX_PORTS - 1} are in use; choose another one with"
        " --port"
    )


@contextlib.contextmanager
def _guarded(host: str, token: str, on_drive: OnDrive) -> Iterator[None]:
    """Context in which a new `ViserServer` gets the checks."""
    import viser
    import websockets.asyncio.server as wire

    text = Path(viser.__file__).parent.joinpath("client/build/index.html").read_text("utf-8")
    page = text.replace("</head>", _STYLE + _KEYS_SCRIPT, 1).encode()
    original = wire.serve

    def guarded(handler: Any, host_: str, port: int, *, process_request: Any, **options: Any) -> Any:
        async def handle(connection: Any) -> None:
            # Malformed messages of clients are not logged.
            asyncio.get_running_loop().set_exception_handler(lambda loop, context: None)
            with contextlib.suppress(Exception):
                if connection.request.path == "/drive":
                    async for text in connection:
                        on_drive(*_read_drive(text))
                else:
                    await handler(connection)

        def check(connection: Any, request: Any) -> Response | None:
            return _check(request, host, port, token, page, f"viser-v{viser.__version__}")

        options |= {"max_size": MAX_MESSAGE_BYTES}
        return original(handle, host_, port, process_request=check, **options)

    wire.serve = guarded  # viser's thread looks it up before the constructor returns
    try:
        yield
    finally:
        wire.serve = original


def _check(request: Any, host: str, port: int, token: str, page: bytes, protocol: str) -> Response | None:
    """Return the answer to a request; None lets a web socket open."""
    path, _, query = request.path.partition("?")
    asked, origin = request.headers.get("Host", ""), request.headers.get("Origin")
    upgrade = request.headers.get("Upgrade", "").lower() == "websocket"
    if (
        not _may_be_called(asked, host, port)
        or origin not in (None, f"http://{asked}")
        or (upgrade and origin is None and token)
    ):
        return _answer(403, "Forbidden", b"this page is served to its own address only\n")
    if token:
        cookie = f"deepbots-{port}={token}"
        token_ = urllib.parse.parse_qs(query).get("token", [""])[0]
        if secrets.compare_digest(token_.encode(), token.encode()):
            return _answer(
                302,
                "Found",
                b"",
                **{"Location": path, "Set-Cookie": f"{cookie}; Path=/; HttpOnly; SameSite=Strict"},
            )
        held = [part.strip() for part in request.headers.get("Cookie", "").split(";")]
        if not any(secrets.compare_digest(part.encode(), cookie.encode()) for part in held):
            return _answer(403, "Forbidden", b"open the address that deepbots printed, with its token\n")
    if upgrade:
        offered = request.headers.get("Sec-WebSocket-Protocol", "")
        if path == "/drive" or (path == "/" and protocol in offered):
            return None
        return _answer(400, "Bad Request", b"this is another version of the page; load it again\n")
    if path == "/":
        return _answer(200, "OK", page)
    return _answer(404, "Not Found", b"there is no such page\n")


def _may_be_called(asked: str, host: str, port: int) -> bool:
    """Return whether a Host header names this server. Beyond loopback, where the token protects the page,
    addresses and the name of the machine are accepted too."""
    name, _, number = asked.rpartition(":")
    if number != str(port):
        return False
    if name in (LOOPBACK, "localhost", "[::1]", host, f"[{host}]"):
        return True
    if _is_loopback(host):
        return False
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(name.strip("[]")))
    return name in (socket.gethostname(), socket.getfqdn())


def _answer(status: int, reason: str, body: bytes, **headers: str) -> Response:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    kind = "text/html; charset=utf-8" if status == 200 else "text/plain; charset=utf-8"
    contents = {
        "Content-Type": kind,
        "Content-Length": str(len(body)),
        "Content-Security-Policy": _CONTENT_SECURITY_POLICY,
        "Cache-Control": "no-store",
    }
    safe = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Connection": "close"}
    return Response(status, reason, Headers(contents | safe | headers), body)


def _read_drive(text: Any) -> tuple[Keys, Axes]:
    """Read the held keys and the axes of a gamepad, from -1 to 1, from a message such as `KeyW+KeyA|0.5,-1`.
    An axis that is no number is 0.

    Raises:
        ValueError: The text is not such a message.
    """
    if not isinstance(text, str) or len(text) > 300:
        raise ValueError(text)
    keys, _, axes = text.partition("|")
    numbers = [float(part) for part in axes.split(",") if part]
    values = tuple(0.0 if math.isnan(value) else min(1.0, max(-1.0, value)) for value in numbers)
    return frozenset(filter(None, keys.split("+"))), values
