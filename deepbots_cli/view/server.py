"""The web server of a page for one person: which requests it answers, and viser's server behind these checks.

    Host       must be the host and port of the server, so that no other site can reach it by another name
    Origin     must be this server, if a request has one
    token      the first request sends it, and a cookie keeps it; it is required beyond loopback, and for a
               page that writes files
    site       browsers name the site that a request comes from; pages of other sites and ports, which the
               cookie would follow within one site, may only link to this one
    paths      `/` is the page, `/drive` takes keys, gamepads and whether the page is hidden; there are no
               files
    messages   have at most 1 MB; a message that cannot be read closes the connection and is not logged; a
               value that a control does not offer is ignored

The first four are the `Gate`, which the studio has too. viser has no place for such checks, so its websocket
server is wrapped while a `ViserServer` is made, and `_check_updates` names private members of viser, as no
other module does. `viser` is pinned to 1.1 for this, and a test looks for each member in the library.
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
from collections.abc import Callable, Iterator, Mapping
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.records import dataclass
from deepbots_cli.view.playback import KEYS, Axes, Keys

if TYPE_CHECKING:
    import viser
    from websockets.http11 import Response

LOOPBACK = "127.0.0.1"
FIRST_PORT = 8787
"""The port of the first page. A page without a chosen port takes the next free one."""
_MAX_PORTS = 20


class Refusal(NamedTuple):
    """The answer to a request that is not let through."""

    status: HTTPStatus
    text: str
    headers: Mapping[str, str] = {}


@dataclass(frozen=True)
class Gate:
    """Decides about requests to a server at `host` and `port`; an empty `token` asks for none."""

    host: str
    port: int
    token: str

    def refuse(
        self, path: str, query: str, headers: Mapping[str, str], *, opens_socket: bool
    ) -> Refusal | None:
        """Return the answer to a request that may not pass, None for one that may.

        Args:
            headers: The headers of the request; `get` must not mind case.
            opens_socket: Whether the request opens a web socket, for which browsers always send an origin.
        """
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if (
            # Another page can let its name resolve to this machine (DNS rebinding), but Host keeps its name.
            not may_be_called(host, self.host, self.port)
            or origin not in (None, f"http://{host}")
            or (opens_socket and origin is None and self.token)
            or _comes_from_another_page(headers)
        ):
            return Refusal(HTTPStatus.FORBIDDEN, "this page is served to its own address only\n")
        if not self.token:
            return None
        cookie = f"deepbots-{self.port}={self.token}"
        token = urllib.parse.parse_qs(query).get("token", [""])[0]
        # The time of a plain comparison depends on the first difference, and would reveal the token in parts.
        if secrets.compare_digest(token.encode(), self.token.encode()):
            set_cookie = f"{cookie}; Path=/; HttpOnly; SameSite=Strict"
            target = "/" + urllib.parse.quote(path.lstrip("/"))  # two slashes would begin the name of a host
            # The token leaves the address, and so the history.
            return Refusal(HTTPStatus.FOUND, "", {"Location": target, "Set-Cookie": set_cookie})
        sent = [part.strip() for part in headers.get("Cookie", "").split(";")]
        if not any(secrets.compare_digest(part.encode(), cookie.encode()) for part in sent):
            return Refusal(HTTPStatus.FORBIDDEN, "open the address that deepbots printed, with its token\n")
        return None


def safe_headers(ancestors: str = "'none'") -> dict[str, str]:
    """Return the headers of a page that loads nothing from elsewhere; `ancestors` are the pages that may
    frame it."""
    policy = (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:; connect-src 'self' ws:"
        f" data: blob:; frame-ancestors {ancestors}; form-action 'none'; base-uri 'none'"
    )
    return {
        "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
    }


def _comes_from_another_page(headers: Mapping[str, str]) -> bool:
    is_foreign = headers.get("Sec-Fetch-Site") in ("cross-site", "same-site")
    return is_foreign and headers.get("Sec-Fetch-Mode", "navigate") != "navigate"


def new_token() -> str:
    return secrets.token_urlsafe(16)


def address(host: str, port: int, token: str) -> str:
    """Return the URL of the page, for a browser of this machine or, beyond loopback, of another one."""
    if host in ("0.0.0.0", "::"):
        host = socket.gethostname()
    url_host = f"[{host}]" if ":" in host else host
    return f"http://{url_host}:{port}/" + (f"?token={token}" if token else "")


def plain_address(host: str) -> str:
    """Return the plain form of an address as the system reads it, such as `127.0.0.1` for `127.1`; a name
    stays as it is."""
    if host.split() == [host]:  # the system also reads a number before blanks
        with contextlib.suppress(OSError, UnicodeError):
            return socket.inet_ntoa(socket.inet_aton(host))
    return host


def is_loopback(host: str) -> bool:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def listening_socket(host: str, port: int | None, first: int = FIRST_PORT) -> socket.socket:
    """Return a socket that listens on `port`, or on the first free one from `first` on. No other program can
    take the port before the server answers.

    Raises:
        UsageError: The host is unknown, or the port is in use.
    """
    for number in [port] if port is not None else range(first, first + _MAX_PORTS):
        try:
            family, kind, _, _, address = socket.getaddrinfo(host, number, type=socket.SOCK_STREAM)[0]
            listener = socket.socket(family, kind)
            try:
                # Otherwise a port is refused for about a minute after a server that had connections.
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listener.bind(address)
                listener.listen(128)
            except OSError:
                listener.close()
                raise
            return listener
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
        f"the ports from {first} to {first + _MAX_PORTS - 1} are in use; choose another one with --port"
    )


def may_be_called(host_header: str, host: str, port: int) -> bool:
    """Return whether a Host header names this server. Beyond loopback, where the token protects the page,
    addresses and the name of the machine are accepted too."""
    name, _, number = host_header.rpartition(":")
    if number != str(port):
        return False
    if name in (LOOPBACK, "localhost", "[::1]", host, f"[{host}]"):
        return True
    if is_loopback(host):
        return False
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(name.strip("[]")))
    return name in (socket.gethostname(), socket.getfqdn())


# The page of viser

MAX_MESSAGE_BYTES = 1 << 20
MAX_KEYS = 7
"""How many keys the page sends at a time."""
_MAX_NUMBER, _MAX_TEXT = 2**53, 1_000
"""The limits of the value of a control that has no limits of its own."""

# Goes into viser's page: held keys, the newest first, gamepads, and whether the page is hidden. viser
# sends none of these. The script takes keys before viser does, whose camera would move. NAME returns what is
# sent for a key, and null for a key of the page.
_KEYS_SCRIPT = """<script>{
const held = new Map(), name = NAME;
let wire = null, last = "||";
const key = e => {
  const sent = name(e);
  if (e.type == "keyup") held.delete(e.code);
  if (sent == null || e.target.closest?.("input, textarea, select")) return;
  e.stopImmediatePropagation(); e.preventDefault();
  if (e.type == "keydown") held.set(e.code, sent); };
addEventListener("keydown", key, true); addEventListener("keyup", key, true);
addEventListener("blur", () => held.clear());
setInterval(() => {
  const pad = [...(navigator.getGamepads?.() ?? [])].find(pad => pad);
  const axes = pad ? pad.axes.slice(0, 4).map(x => Math.abs(x) > 0.12 ? x : 0) : [];
  const keys = [...held.values()].reverse().slice(0, MAX_KEYS).join("+");
  const moved = axes.some(x => x) ? axes.map(x => x.toFixed(3)).join() : "";
  const now = [keys, moved, document.hidden ? "hidden" : ""].join("|");
  if (now == last && !keys && !moved) return;
  if (!wire || wire.readyState > 1) wire = new WebSocket("drive");
  else if (wire.readyState == 1) { wire.send(now); last = now; } }, 50); }</script></head>""".replace(
    "MAX_KEYS", str(MAX_KEYS)
)
# The keys that drive, by their place on the keyboard.
_DRIVING_KEY = f"""e => {json.dumps(KEYS)}.includes(e.code) && !e.ctrlKey && !e.metaKey && !e.altKey
  ? e.code : null"""

# The fonts and colors of the studio. All tabs fit in a row. In a window that is narrower than viser's limit
# (36em), its panel lies over the world; here it stands below.
_STYLE = """<style>html:root {
  --mantine-font-family: -apple-system, BlinkMacSystemFont, "Segoe UI", Helvetica, Arial, sans-serif; }
html:root[data-mantine-color-scheme=dark] { --mantine-color-body: #16191f; --mantine-color-default: #20242c;
  --mantine-color-text: #e4e6ea; --mantine-color-default-border: #566073; --mantine-color-dimmed: #a9b2c0; }
[role=tab] { padding-inline: 0.5em !important; }
[style*="letter-spacing"] { letter-spacing: normal !important; } @media (max-width: 36em) {
  div:has(> .mantine-Paper-root[style*="fixed"]) { flex-direction: column !important; }
  .mantine-Paper-root[style*="fixed"] { position: relative !important; flex-shrink: 0; width: 100% !important;
    max-height: 50% !important; }
  .mantine-Paper-root[style*="fixed"] [style*="width: 20em"] { width: 100% !important; }
  .mantine-Notifications-root { top: auto !important; bottom: 0.5em !important; }
  .mantine-Notification-description { display: none; } }</style>"""

OnDrive = Callable[[Keys, Axes], None]


def serve(
    host: str,
    port: int | None,
    label: str,
    on_drive: OnDrive,
    *,
    needs_token: bool = False,
    sent_key: str = _DRIVING_KEY,
    hidden: set[Any] | None = None,
) -> tuple[viser.ViserServer, str]:
    """Start the server in a thread. Returns the server, and the address of the page with its token, if any.

    Args:
        host: The address to listen on. Beyond loopback the page requires a token.
        port: None takes the first free one from `FIRST_PORT` on, 0 any.
        label: The title of the page.
        on_drive: Called in the server's thread with the keys that are held and the axes of a gamepad.
        needs_token: Whether the page requires a token on loopback too, because it can write files or act on
            programs, and other users of the machine can reach it.
        sent_key: A function of JavaScript that returns what the page sends for an event of a key, and null
            for a key of the page; by default the keys that drive.
        hidden: A set that the server's thread fills: an entry for each open page that its browser does not
            show, such as that of a tab in the background.

    Raises:
        UsageError: The host is unknown, or the port is in use.
        MissingExtraError: viser is not installed.
    """
    try:
        import viser
    except ModuleNotFoundError as error:
        raise MissingExtraError("view", "a page in the browser") from error
    host = plain_address(host)
    with listening_socket(host, port) as probe:
        number = int(probe.getsockname()[1])
    token = "" if is_loopback(host) and not needs_token else new_token()
    for name in ("websockets", "websockets.server", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with (
        _guarded(host, token, on_drive, sent_key, set() if hidden is None else hidden),
        contextlib.redirect_stdout(io.StringIO()),
    ):  # viser prints a banner
        server = viser.ViserServer(host, number, label=label, verbose=False)
    _check_updates(server)
    return server, address(host, server.get_port(), token)


def stop(server: viser.ViserServer) -> None:
    """End a server."""
    with contextlib.redirect_stdout(io.StringIO()):  # viser prints that it ends
        server.stop()


def _is_offered(value: object, control: Any) -> bool:
    """Return whether a control can have this value: an option, a number in its range, or a text."""
    options = getattr(control.props, "options", None)
    if options is not None:
        return isinstance(value, str) and value in options
    if isinstance(control.value, bool):
        return isinstance(value, bool)
    if isinstance(control.value, int | float):
        low, high = (getattr(control.props, end, None) for end in ("min", "max"))
        # bool is a subclass of int; `not <=` refuses NaN too.
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _MAX_NUMBER:
            return False
        # A slider rounds its value to its steps.
        slack = 1e-6 * abs(high - low) if low is not None and high is not None else 0.0
        return (low is None or value >= low - slack) and (high is None or value <= high + slack)
    return isinstance(value, str) and isinstance(control.value, str) and len(value) <= _MAX_TEXT


@contextlib.contextmanager
def _guarded(host: str, token: str, on_drive: OnDrive, key: str, hidden: set[Any]) -> Iterator[None]:
    """Context in which a new `ViserServer` gets the checks. `key` is a function of JavaScript that returns
    what the page sends for a key."""
    import viser
    import websockets.asyncio.server as wire

    text = Path(viser.__file__).parent.joinpath("client/build/index.html").read_text("utf-8")
    page = text.replace("</head>", _STYLE + _KEYS_SCRIPT.replace("NAME", key), 1).encode()
    original = wire.serve

    def guarded(handler: Any, host_: str, port: int, *, process_request: Any, **options: Any) -> Any:
        async def handle(connection: Any) -> None:
            # Malformed messages of clients are not logged.
            asyncio.get_running_loop().set_exception_handler(lambda loop, context: None)
            with contextlib.suppress(Exception):
                if connection.request.path == "/drive":
                    await _listen(connection, on_drive, hidden)
                else:
                    await handler(connection)

        def check(connection: Any, request: Any) -> Response | None:
            gate = Gate(host, port, token)
            return _check(request, gate, page, f"viser-v{viser.__version__}")

        options |= {"max_size": MAX_MESSAGE_BYTES}  # viser itself allows 50 MiB
        return original(handle, host_, port, process_request=check, **options)

    wire.serve = guarded  # viser's thread looks it up before the constructor returns
    try:
        yield
    finally:
        wire.serve = original


def _check(request: Any, gate: Gate, page: bytes, protocol: str) -> Response | None:
    """Return the answer to a request; None lets a web socket open."""
    path, _, query = request.path.partition("?")
    upgrade = request.headers.get("Upgrade", "").lower() == "websocket"
    refusal = gate.refuse(path, query, request.headers, opens_socket=upgrade)
    if refusal is not None:
        return _answer(refusal.status, refusal.text.encode(), **refusal.headers)
    if upgrade:
        offered = request.headers.get("Sec-WebSocket-Protocol", "")
        if path == "/drive" or (path == "/" and protocol in offered):
            return None
        return _answer(HTTPStatus.BAD_REQUEST, b"this is another version of the page; load it again\n")
    if path == "/":
        return _answer(HTTPStatus.OK, page)
    return _answer(HTTPStatus.NOT_FOUND, b"there is no such page\n")


def _answer(status: HTTPStatus, body: bytes, **headers: str) -> Response:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    kind = "text/html; charset=utf-8" if status == HTTPStatus.OK else "text/plain; charset=utf-8"
    contents = {
        "Content-Type": kind,
        "Content-Length": str(len(body)),
        "Cache-Control": "no-store",
        "Connection": "close",
    }
    return Response(status, status.phrase, Headers(safe_headers() | contents | headers), body)


async def _listen(connection: Any, on_drive: OnDrive, hidden: set[Any]) -> None:
    """Pass on what a page sends about its keys, until it closes."""
    try:
        async for text in connection:
            keys, axes, is_hidden = _read_drive(text)
            (hidden.add if is_hidden else hidden.discard)(connection)
            on_drive(keys, axes)
    finally:
        hidden.discard(connection)


def _read_drive(text: Any) -> tuple[Keys, Axes, bool]:
    """Read the held keys, the axes of a gamepad, from -1 to 1, and whether the page is hidden, from a message
    such as `KeyW+KeyA|0.5,-1|` or `||hidden`. An axis that is not a number is 0.

    Raises:
        ValueError: The text is not such a message.
    """
    if not isinstance(text, str) or len(text) > 300:
        raise ValueError(text)
    keys, axes, state = text.split("|")
    numbers = [float(part) for part in axes.split(",") if part]
    values = tuple(0.0 if math.isnan(value) else min(1.0, max(-1.0, value)) for value in numbers)
    return dict.fromkeys(filter(None, keys.split("+"))).keys(), values, state == "hidden"


def _check_updates(server: viser.ViserServer) -> None:
    """Let a client change the value of a control only, to one that the control offers.

    viser applies any value of any attribute that a client sends, and has no public place to check it.
    """
    from viser._messages import GuiUpdateMessage

    gui: Any = server.gui
    original = gui._handle_gui_updates

    async def checked(client: int, message: Any) -> None:
        handle = gui._gui_input_handle_from_uuid.get(message.uuid)
        is_value = handle is not None and list(message.updates) == ["value"]
        if is_value and _is_offered(message.updates["value"], handle._impl):
            await original(client, message)

    gui._websock_interface.unregister_handler(GuiUpdateMessage, original)
    gui._websock_interface.register_handler(GuiUpdateMessage, checked)
