"""The link over WebSocket: the messages of `zeromq.py`, JSON as text and MessagePack as binary frames.

The policy listens on a port, and a robot connects to it. Pages of a browser are refused: they would send an
origin. Each connection has threads and a buffer, so there are `MOST_CONNECTIONS` at most: a new one ends the
oldest of those that the policy does not answer. The package `websockets` has no such limit, none for the
parts of a message, and none for the time of a send; it does all else: handshake, origins, frames, sizes,
pings, and timeouts of opening and closing.
"""

from __future__ import annotations

import logging
import re
import socket
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from itertools import islice
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.sync.server import serve

from deepbots_robot.link import About, Arrival, MessageLink
from deepbots_robot.topics import Field

# websockets writes a traceback for each connection that is not a WebSocket.
_SILENT = logging.getLogger(__name__)
_SILENT.disabled = True

MOST_CONNECTIONS = 8
_PAUSE = 0.02
"""The time in s between connections when there are too many, so that opening them takes little of the CPU."""
_LOOK = 0.5
"""The time in s after which a wait for a connection checks whether the link is closed."""
_OPENING = 2.0
"""The time in s within which a connection must become a WebSocket."""
_MOST_PARTS = 1000
"""The largest number of parts of a message; the usual libraries send it in one."""
_SENDING = 0.5
"""The time in s after which a robot that does not read is given up."""


class WebSocketLink(MessageLink):
    """An end of a link over WebSocket: a policy listens on a port, a robot connects to it."""

    def __init__(
        self,
        address: str,
        receives: Sequence[Field],
        sends: Sequence[Field],
        *,
        robot: bool = False,
        about: About | None = None,
    ) -> None:
        """Listen at `PORT` of this machine or at `HOST:PORT`, or with `robot` connect to it.

        Raises:
            ValueError: The address is not valid, is taken, or cannot be reached at all.
        """
        host, _, port = address.rpartition(":")
        if not re.fullmatch(r"([A-Za-z0-9_.-]{1,255}:)?[0-9]{1,5}", address) or not 0 < int(port) < 2**16:
            raise ValueError(f"'{address[:100]}' is not a port; write one like 8765, or HOST:PORT")
        self._host, self._port = host or "127.0.0.1", int(port)
        self.name = f"WebSocket at {self._host}:{self._port}"
        super().__init__(receives, sends, about)
        self._robot, self._peer = robot, None
        self._waiting: deque[tuple[Any, bytes]] = deque(maxlen=self._most_waiting)
        """The messages with their connections; the oldest are dropped."""
        self._here = threading.Event()
        self._server: Any = None
        self._open: dict[socket.socket, None] = {}
        """The connections of a policy, the oldest first."""
        self._is_closed = False
        if not robot:
            try:
                self._server = serve(
                    self._listen,
                    self._host,
                    self._port,
                    origins=[None],
                    open_timeout=_OPENING,
                    close_timeout=_OPENING,
                    max_size=self._longest,
                    max_queue=1,
                    compression=None,
                    logger=_SILENT,
                )
                self._server.socket.settimeout(_LOOK)
            except OSError as error:
                raise ValueError(
                    f"{self.name} cannot be opened: {(error.strerror or 'unknown reason').lower()}"
                ) from None
            self._accepting = threading.Thread(target=self._accept, daemon=True)
            self._accepting.start()

    def _accept(self) -> None:
        """Take connections, in a separate thread, until the link is closed.

        `serve_forever` of websockets starts a thread for each connection at once, and ends when there are no
        more files to open.
        """
        while not self._is_closed:
            try:
                connection, address = self._server.socket.accept()
            except OSError:  # no connection, a closed one, or too many open files
                time.sleep(_PAUSE)
                continue
            if len(self._open) >= MOST_CONNECTIONS:
                self._end_oldest()
                time.sleep(_PAUSE)
            if len(self._open) < MOST_CONNECTIONS:
                self._open[connection] = None
                threading.Thread(target=self._handle, args=(connection, address), daemon=True).start()
            else:
                connection.close()

    def _end_oldest(self) -> None:
        """End the oldest connection that the policy does not answer."""
        kept = getattr(self._peer, "socket", None)
        # Other connections may end at this moment, so the keys are copied.
        oldest = next((each for each in list(self._open) if each is not kept), None)
        with suppress(OSError):
            if oldest is not None:
                oldest.shutdown(socket.SHUT_RDWR)

    def _handle(self, connection: socket.socket, address: Any) -> None:
        try:
            self._server.handler(connection, address)
        finally:
            self._open.pop(connection, None)

    def _listen(self, peer: Any) -> None:
        """Take the messages of a connection, in a separate thread, until it ends."""
        with suppress(WebSocketException, OSError):
            if sys.platform != "win32":
                peer.socket.setsockopt(
                    socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", 0, int(_SENDING * 1e6))
                )
            while True:
                # Iterating over the connection would gather the parts of a message without a limit; empty
                # ones have no size.
                parts = [*islice(peer.recv_streaming(decode=False), _MOST_PARTS + 1)]
                if len(parts) > _MOST_PARTS:
                    peer.close(1009, "a message in too many parts")
                    break
                if not self._is_taken(peer):  # its messages would replace those of the robot
                    self._is_crowded = True
                    peer.close(1013, "the policy acts for another robot")
                    break
                self._waiting.append((peer, b"".join(parts)))
                self._here.set()
        if self._peer is peer:
            self._peer = None

    def wait(self, timeout: float) -> None:
        if not self._waiting:
            self._here.wait(max(0.0, timeout))
        self._here.clear()

    def take(self) -> Sequence[Arrival]:
        arrivals: list[Arrival] = []
        while self._waiting:
            peer, content = self._waiting.popleft()
            arrivals += self._received(content, peer)
        return arrivals

    def _is_answered(self, sender: Any) -> bool:
        return self._robot or self._peer is None or sender is self._peer

    def _answer(self, sender: Any) -> None:
        if not self._robot:
            self._peer = sender

    def _write(self, content: bytes) -> None:
        peer: Any = self._peer
        if peer is not None:
            with suppress(WebSocketException, OSError):  # the other end has closed
                peer.send(content, text=not self._packed)

    def connected(self) -> bool:
        if self._peer is None and self._robot:
            with suppress(WebSocketException, OSError):  # no other end is connected yet
                peer = connect(
                    f"ws://{self._host}:{self._port}",
                    max_size=self._longest,
                    compression=None,
                    open_timeout=5,
                    logger=_SILENT,
                )
                self._peer = peer
                threading.Thread(target=self._listen, args=(peer,), daemon=True).start()
        return self._peer is not None

    def close(self) -> None:
        self._is_closed = True
        if self._server is not None:
            with suppress(OSError):
                # This ends the wait for a connection, which would keep the port.
                self._server.socket.shutdown(socket.SHUT_RDWR)
            self._accepting.join(2 * _LOOK)
        with suppress(WebSocketException, OSError):
            if self._server is not None:
                self._server.shutdown()
            peer: Any = self._peer
            if peer is not None:
                peer.close()
