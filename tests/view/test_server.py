"""The server of the page: who may call it, and what rubbish does to it."""

from __future__ import annotations

import http.client
import os
import socket
import threading
import time
from contextlib import suppress

import pytest

viser = pytest.importorskip("viser")
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from deepbots_cli.errors import UsageError  # noqa: E402
from deepbots_cli.view import access, server  # noqa: E402


@pytest.fixture
def page():
    """The port of a server on loopback, and what arrived by `/drive`."""
    arrived: list[object] = []
    running, address = server.serve(
        access.LOOPBACK, 0, "test", lambda keys, axes: arrived.append((keys, axes))
    )
    assert address == f"http://127.0.0.1:{running.get_port()}/"
    yield running.get_port(), arrived
    server.stop(running)


def _get(port, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request(
        "GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()}
    )
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


def _open(port, path="/", origin=None, cookie=None, protocol=f"viser-v{viser.__version__}"):
    headers = {"Cookie": cookie} if cookie else {}
    return connect(
        f"ws://127.0.0.1:{port}{path}",
        origin=origin,
        subprotocols=[protocol],
        additional_headers=headers,
        max_size=None,
    )


def test_it_serves_its_page_with_keys_and_no_other_source(page):
    answer, body = _get(page[0])
    assert answer.status == 200
    assert b'WebSocket("drive")' in body
    assert "connect-src 'self'" in answer.headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    "path",
    [
        "/etc/passwd",
        "/../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/index.html",
        "//etc/passwd",
        "/x\\y",
    ],
)
def test_it_serves_no_file(page, path):
    answer, body = _get(page[0], path)
    assert answer.status == 404
    assert b"root:" not in body


def test_a_foreign_host_or_origin_is_refused(page):
    port, _ = page
    assert _get(port, Host=f"evil.example:{port}")[0].status == 403
    assert _get(port, Host="127.0.0.1:1")[0].status == 403
    assert _get(port, Origin="http://evil.example")[0].status == 403
    with pytest.raises(InvalidStatus, match="403"):
        _open(port, origin="http://evil.example")
    with pytest.raises(InvalidStatus, match="403"):
        _open(port, "/drive", origin=f"http://localhost:{port + 1}")
    _open(port, origin=f"http://127.0.0.1:{port}").close()


def test_beyond_loopback_a_token_is_asked_for():
    running, address = server.serve("0.0.0.0", 0, "test", lambda keys, axes: None)
    try:
        port = running.get_port()
        token = address.partition("?token=")[2]
        assert len(token) > 16
        assert _get(port)[0].status == 403
        assert _get(port, "/?token=wrong")[0].status == 403
        answer, _ = _get(port, f"/?token={token}")
        cookie = answer.headers["Set-Cookie"].partition(";")[0]
        assert answer.status == 302
        assert answer.headers["Location"] == "/"
        assert "HttpOnly" in answer.headers["Set-Cookie"]
        assert _get(port, Cookie=cookie)[0].status == 200
        assert _get(port, Cookie=cookie + "x")[0].status == 403
        origin = f"http://127.0.0.1:{port}"
        for path in ("/", "/drive"):
            with pytest.raises(InvalidStatus, match="403"):
                _open(port, path, origin=origin)
            _open(port, path, origin=origin, cookie=cookie).close()
        assert _get(port, Host=f"evil.example:{port}", Cookie=cookie)[0].status == 403
    finally:
        server.stop(running)


def test_an_abbreviated_address_is_loopback():
    running, address = server.serve("127.1", 0, "test", lambda keys, axes: None)
    server.stop(running)
    assert address == f"http://127.0.0.1:{running.get_port()}/"


def test_keys_and_axes_arrive_and_rubbish_does_not(page, capfd):
    port, arrived = page
    origin = f"http://127.0.0.1:{port}"
    for text in ("KeyW|a,b|", b"\x00\xff", "x" * 1000, "KeyW|" + "1," * 90 + "|", "KeyW|", "|||"):
        with _open(port, "/drive", origin=origin) as wire:
            wire.send(text)
    with _open(port, "/drive", origin=origin) as wire:
        wire.send("KeyW+KeyA|0.5,-7|")
        wire.send("|nan,0.25|hidden")
        held = (frozenset({"KeyW", "KeyA"}), (0.5, -1.0))
        for sent in (held, (frozenset(), (0.0, 0.25))):
            end = time.monotonic() + 10
            while sent not in arrived and time.monotonic() < end:
                time.sleep(0.01)
            assert sent in arrived
    assert all(-1.0 <= value <= 1.0 for _, axes in arrived for value in axes)
    assert capfd.readouterr().err == ""


def test_rubbish_to_viser_changes_nothing_and_prints_nothing(page, capfd):
    port, _ = page
    origin = f"http://127.0.0.1:{port}"
    for message in (
        b"",
        b"\x00" * 100,
        b"\xff" * 10_000,
        "text",
        b"\x93\x01\x02\x03",
        b"\xdf\xff\xff\xff\xff",
        b"x" * (server.MAX_MESSAGE_BYTES + 1),
    ):
        with suppress(OSError, TimeoutError, ConnectionClosed), _open(port, origin=origin) as wire:
            wire.send(message)
            wire.recv(timeout=0.3)
    with socket.create_connection(("127.0.0.1", port)) as raw:
        raw.sendall(b"\x16\x03\x01 rubbish \r\n\r\n")
    time.sleep(0.3)
    assert _get(port)[0].status == 200
    printed = capfd.readouterr()
    assert "Traceback" not in printed.out + printed.err


def test_fifty_closed_connections_leave_nothing_behind(page):
    port, _ = page
    origin = f"http://127.0.0.1:{port}"

    def opened() -> tuple[int, int]:
        return len(os.listdir("/proc/self/fd")), threading.active_count()

    def connect() -> None:
        with _open(port, origin=origin) as wire:
            wire.recv(timeout=5)

    for _ in range(3):
        connect()
    before = opened()
    for _ in range(50):
        connect()
    end = time.monotonic() + 10
    while any(now > then for now, then in zip(opened(), before, strict=True)) and time.monotonic() < end:
        time.sleep(0.05)
    assert opened() <= before


def test_another_version_of_the_page_is_refused(page):
    with pytest.raises(InvalidStatus, match="400"):
        _open(page[0], origin=f"http://127.0.0.1:{page[0]}", protocol="viser-v0.0.1")


def test_a_port_in_use_and_an_unknown_host_are_errors(page):
    with pytest.raises(UsageError, match=f"port {page[0]} of 127.0.0.1 is in use"):
        server.serve(access.LOOPBACK, page[0], "test", lambda keys, axes: None)
    with pytest.raises(UsageError, match="there is no host"):
        server.serve("no-such-host.invalid", 0, "test", lambda keys, axes: None)
