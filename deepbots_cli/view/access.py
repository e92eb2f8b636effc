"""The checks of a server for one person: the address to listen on, and which requests it answers.

Host       must be the host and port of the server, so that no other site can reach it by another name
Origin     must be this server, if a request has one
token      the first request sends it, and a cookie keeps it
site       browsers name the site that a request comes from; pages of other sites and ports, which the cookie
           would follow within one site, may only link to this one
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import secrets
import socket
import urllib.parse
from collections.abc import Mapping
from dataclasses import dataclass

from deepbots_cli.errors import UsageError

LOOPBACK = "127.0.0.1"
FIRST_PORT = 8787
"""The port of the first page. A page without a chosen port takes the next free one."""
_MAX_PORTS = 20
_BACKLOG = 128


@dataclass(frozen=True)
class Refusal:
    """The answer to a request that is not let through: a status, a sentence and headers."""

    status: int
    reason: str
    text: str
    headers: Mapping[str, str]


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
            return Refusal(403, "Forbidden", "this page is served to its own address only", {})
        if not self.token:
            return None
        cookie = f"deepbots-{self.port}={self.token}"
        token = urllib.parse.parse_qs(query).get("token", [""])[0]
        # The time of a plain comparison depends on the first difference, and would reveal the token in parts.
        if secrets.compare_digest(token.encode(), self.token.encode()):
            set_cookie = f"{cookie}; Path=/; HttpOnly; SameSite=Strict"
            target = "/" + urllib.parse.quote(path.lstrip("/"))  # two slashes would begin the name of a host
            # The token leaves the address, and so the history.
            return Refusal(302, "Found", "", {"Location": target, "Set-Cookie": set_cookie})
        sent = [part.strip() for part in headers.get("Cookie", "").split(";")]
        if not any(secrets.compare_digest(part.encode(), cookie.encode()) for part in sent):
            return Refusal(403, "Forbidden", "open the address that deepbots printed, with its token", {})
        return None


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


def free_port(host: str, port: int | None, first: int = FIRST_PORT) -> int:
    """Return a port that can be listened on: `port`, or the first free one from `first` on.

    Raises:
        UsageError: The host is unknown, or the port is in use.
    """
    with listening_socket(host, port, first) as probe:
        return int(probe.getsockname()[1])


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
                listener.listen(_BACKLOG)
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
