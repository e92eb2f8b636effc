"""The link over ZeroMQ: the policy has a ROUTER socket and answers in the format of the last message, a robot
has a DEALER socket.

A ROUTER takes the messages of its connections in turn, so a flood in one of them delays another one by a
message. It keeps the parts of a message until the last one arrives, and has no limit for their number. If the
process grows, all connections are closed.

`link.py` describes the messages.
"""

from __future__ import annotations

import mmap
import re
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from deepbots_robot.link import About, Arrival, MessageLink, Remark
from deepbots_robot.topics import Field

ADDRESS = r"tcp://[A-Za-z0-9_.*:\[\]-]{1,255}:[0-9]{1,5}|ipc://[^\x00]{1,100}"
_TAKEN = 64
"""The largest number of messages that are taken before the policy may act."""
_MOST_SENT = 64
"""The largest number of commands that wait for a robot that does not read."""
_MOST_GROWTH = 100_000_000
"""The bytes by which the process may grow; a policy has loaded its weights before."""
_LOOK = 0.05
"""The time in s between two checks of the memory, which take 0.02 ms each."""
_CLOSING = 2.0
"""The time in s in which ZeroMQ releases an address."""
_ENDLESS = Remark(
    "the memory of this policy grew, as by a message without an end; all connections were closed, and robots"
    " connect again"
)


class ZmqLink(MessageLink):
    """An end of a link over ZeroMQ: a policy binds an address, a robot connects to it."""

    def __init__(
        self,
        address: str,
        receives: Sequence[Field],
        sends: Sequence[Field],
        *,
        robot: bool = False,
        about: About | None = None,
    ) -> None:
        """Bind the address, or with `robot` connect to it.

        Raises:
            ValueError: It is not an address of ZeroMQ, or is taken.
        """
        if not re.fullmatch(ADDRESS, address) or (
            address.startswith("tcp") and int(address.rpartition(":")[2]) > 65535
        ):
            raise ValueError(
                f"'{address[:100]}' is not an address of ZeroMQ; write one like tcp://127.0.0.1:5555"
            )
        self.name = f"ZeroMQ at {address}"
        super().__init__(receives, sends, about)
        self._robot, self._peer = robot, b""
        if not robot and _is_taken(address):  # otherwise ZeroMQ would take the address from the other policy
            raise ValueError(f"{address} cannot be opened: address already in use")
        self._address, self._was_flooded = address, False
        try:
            self._socket: Any = self._opened()
        except zmq.ZMQError as error:
            raise ValueError(f"{address} cannot be opened: {error.strerror.lower()}") from None
        self._looked_at, self._size = time.monotonic(), _process_bytes()
        self._usual = self._size

    def _opened(self) -> Any:
        opened: Any = zmq.Context.instance().socket(zmq.DEALER if self._robot else zmq.ROUTER)
        opened.setsockopt(zmq.LINGER, 1000)
        opened.setsockopt(zmq.MAXMSGSIZE, self._longest)
        opened.setsockopt(zmq.RCVHWM, self._most_waiting)
        opened.setsockopt(zmq.SNDHWM, _MOST_SENT)
        try:
            if self._robot:
                opened.setsockopt(zmq.IMMEDIATE, 1)  # no message waits for a policy that is not connected
                opened.connect(self._address)
            else:
                opened.bind(self._address)
        except zmq.ZMQError:
            opened.close()
            raise
        return opened

    def _limit_memory(self) -> None:
        """Close all connections of a policy if the process has grown, except those of a socket file, which
        only its owners reach."""
        now = time.monotonic()
        if self._robot or now < self._looked_at + _LOOK or not self._address.startswith("tcp"):
            return
        self._looked_at, size = now, _process_bytes()
        # The memory of closed connections is released a little later.
        self._usual = max(self._size, min(self._usual, size))
        if size <= self._usual + _MOST_GROWTH:
            return
        self._was_flooded, self._peer = True, b""
        self._socket.close(0)
        while True:
            try:
                self._socket = self._opened()
                break
            except zmq.ZMQError:  # the address is still in use
                if time.monotonic() > now + _CLOSING:
                    raise
                time.sleep(0.01)
        self._usual = size

    def remarks(self) -> Sequence[Remark]:
        return [*super().remarks(), *([_ENDLESS] if self._was_flooded else [])]

    def wait(self, timeout: float) -> None:
        self._socket.poll(max(0, int(np.ceil(timeout * 1000))))

    def take(self) -> Sequence[Arrival]:
        self._limit_memory()
        arrivals: list[Arrival] = []
        for _ in range(_TAKEN):
            try:
                *sender, content = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                break
            if self._robot or sender:
                arrivals += self._received(content, sender)
        return arrivals

    def _is_answered(self, sender: Any) -> bool:
        return self._robot or not self._peer or sender[0] == self._peer

    def _answer(self, sender: Any) -> None:
        if not self._robot:
            self._peer = sender[0]

    def _write(self, content: bytes) -> None:
        with suppress(zmq.ZMQError):  # no robot is connected, or it does not read
            self._socket.send_multipart([content] if self._robot else [self._peer, content], zmq.NOBLOCK)

    def connected(self) -> bool:
        return bool(self._socket.poll(0, zmq.POLLOUT)) if self._robot else bool(self._peer)

    def close(self) -> None:
        self._socket.close()


def _process_bytes() -> int:
    """Return the memory of this process in bytes; 0 if the system does not report it."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE
    except OSError:
        return 0


def _is_taken(address: str) -> bool:
    """Return whether a process listens at a socket file."""
    if sys.platform == "win32" or not address.startswith("ipc://"):  # Python has no socket files on Windows
        return False
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(0.5)
        try:
            probe.connect(address.removeprefix("ipc://"))
        except OSError:
            return False
    return True
