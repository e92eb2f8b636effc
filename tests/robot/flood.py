"""What floods of messages do to a server: its memory, and whether a robot goes on getting its commands in
time.

    python -m tests.robot.flood [--seconds 60] [--clients 3] [--bundle FOLDER] [--json]

`deepbots-robot serve` acts on ZeroMQ, then on WebSocket. For each, a robot sends its sensors at the rate of
the policy: first alone, then while other clients send as fast as they can, each in a process of its own: the
longest legal messages, the longest bytes that are not a message, longer ones than any message, and
(WebSocket) connections that never say anything. An answer is in time if it comes within a period. The share
without a flood says what the machine allows. The clients run with less priority (`nice`): they stand for
other machines.
"""

from __future__ import annotations

import argparse
import logging
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from deepbots_robot import model
from deepbots_robot.bundle import BUNDLE_NAME
from deepbots_robot.link import About, longest_message
from deepbots_robot.serving import Transport, field_of
from tools.benchmarks.report import Row, show

ROOT = Path(__file__).parents[2]
MAX_RISE = 50.0  # MB
KINDS = ("legal", "illegal", "too long")


class Served(NamedTuple):
    """The share of the messages of a robot that were answered within a period, and the median answer in s."""

    in_time: float
    median: float


def memory_of(process: int, key: str = "VmRSS") -> float:
    """MB of a process."""
    status = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in status if line.startswith(f"{key}:"))


def flood_message(info: model.BundleInfo, kind: str) -> bytes:
    """A message of a flood: as long as the fields of the bundle allow, or longer."""
    fields = [field_of(entry) for entry in info.inputs]
    longest = longest_message(
        fields, About("policy", info.scenario.name, info.scenario.task_digest, "at speed 1")
    )
    if kind == "illegal":
        return b"{" + b"[" * (longest - 1)
    if kind == "too long":
        return b"{" + b" " * (2 * longest)
    values = {
        entry.name: [-1.2345678901234567e-100] * field.count
        for entry, field in zip(info.inputs, fields, strict=True)
    }
    message = msgspec.json.encode({"robot": "r" * 200, "stamp": time.time(), "fields": values})
    return message[:-1] + b" " * (longest - len(message)) + message[-1:]


def flood(address: str, info: model.BundleInfo, kind: str, seconds: float) -> None:
    """Send as fast as possible; a connection that ends is opened again."""
    content = flood_message(info, kind)
    until = time.monotonic() + seconds
    if address.startswith("tcp://"):
        import zmq

        dealer = zmq.Context.instance().socket(zmq.DEALER)
        dealer.setsockopt(zmq.LINGER, 0)
        dealer.setsockopt(zmq.SNDTIMEO, 1000)
        dealer.connect(address)
        while time.monotonic() < until:
            with suppress(zmq.Again):
                dealer.send(content)
        return
    from websockets.exceptions import WebSocketException
    from websockets.sync.client import connect

    while time.monotonic() < until:
        with (
            suppress(WebSocketException, OSError),
            connect(address, compression=None, max_size=None, open_timeout=1) as peer,
        ):
            while time.monotonic() < until:
                peer.send(content.decode())


def open_and_wait(address: str, seconds: float) -> None:
    """Open connections that never say anything, as many as there may be."""
    host, _, port = address.removeprefix("ws://").partition(":")
    until = time.monotonic() + seconds
    kept = list[socket.socket]()
    while time.monotonic() < until:
        with suppress(OSError):
            kept.append(socket.create_connection((host, int(port)), timeout=1))
        if len(kept) > 500:
            kept.pop(0).close()
        time.sleep(0.002)


def drive(transport: Transport, info: model.BundleInfo, seconds: float) -> Served:
    """A robot that sends its sensors at the rate of the policy, and waits for each answer until the next."""
    period = 1.0 / info.rate_hz
    receives, sends = [field_of(entry) for entry in info.outputs], [field_of(entry) for entry in info.inputs]
    values = {entry.name: np.zeros(entry.shape, entry.dtype) for entry in info.inputs}
    answers = list[float]()
    sent = 0
    with closing(
        transport.open([(field, None) for field in receives], [(field, None) for field in sends], robot=True)
    ) as link:  # type: ignore[misc]
        until = time.monotonic() + 10
        while not link.connected() and time.monotonic() < until:
            time.sleep(0.01)
        link.reset(0, time.time())
        begun = time.monotonic()
        while time.monotonic() < begun + seconds:
            due = begun + sent * period
            time.sleep(max(0.0, due - time.monotonic()))
            link.take()
            at = time.monotonic()
            link.connected()
            link.send(values, time.time())
            sent += 1
            while (left := due + period - time.monotonic()) > 0:
                link.wait(left)
                if any(arrival.fields for arrival in link.take()):
                    answers.append(time.monotonic() - at)
                    break
    return Served(len(answers) / max(1, sent), float(np.median(answers or [np.inf])))


@contextmanager
def serving(bundle: Path, words: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A server of a bundle, which has begun to listen."""
    command = [sys.executable, "-m", "deepbots_robot", "serve", str(bundle), *words, "--json"]
    process = subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert process.stderr is not None
        process.stderr.readline()
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


@contextmanager
def flooding(bundle: Path, address: str, seconds: float, clients: int) -> Iterator[None]:
    """Clients that flood, each in a process of its own."""
    kinds = [*(KINDS * clients)[:clients], *(["silent"] if address.startswith("ws") else [])]
    spawn = multiprocessing.get_context("spawn")
    running = [spawn.Process(target=client, args=(bundle, address, kind, seconds)) for kind in kinds]
    for process in running:
        process.start()
    try:
        time.sleep(1.0)  # they are there
        yield
    finally:
        for process in running:
            process.kill()
            process.join()


def client(bundle: Path, address: str, kind: str, seconds: float) -> None:
    """What a process of a flood does."""
    os.nice(10)  # another machine would take no time from the server
    logging.disable()  # of websockets, about each connection that ends
    if kind == "silent":
        open_and_wait(address, seconds)
    else:
        flood(address, model.decode((bundle / BUNDLE_NAME).read_bytes()), kind, seconds)


def measured(bundle: Path, kind: str, address: str, seconds: float, clients: int) -> Iterator[Row]:
    """A server before and during a flood, in which a robot goes on that acts before it begins."""
    info, transport = model.decode((bundle / BUNDLE_NAME).read_bytes()), Transport.at(address)
    words = ["--zmq", address] if transport.zmq else ["--websocket", str(transport.websocket)]
    flooded = list[Served]()
    robot = threading.Thread(target=lambda: flooded.append(drive(transport, info, seconds)))
    with serving(bundle, words) as server:
        drive(transport, info, 1.0)
        before = memory_of(server.pid)
        alone = drive(transport, info, min(seconds, 20.0))
        robot.start()
        time.sleep(0.5)
        with flooding(bundle, address, seconds, clients):
            robot.join()
        rise = memory_of(server.pid, "VmHWM") - before
    yield Row(f"{kind}: rise of the server's memory, at its peak", rise, "MB", MAX_RISE)
    for when, served in (("no flood", alone), ("flood", flooded[0])):
        within = f"{kind}: answers within a period ({1e3 / info.rate_hz:.0f} ms), {when}"
        yield Row(within, 100 * served.in_time, "%")
        yield Row(f"{kind}: median answer, {when}", 1e3 * served.median, "ms")


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.robot.flood", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="of each flood, by default 60")
    parser.add_argument("--clients", type=int, default=3, help="that send, by default 3")
    parser.add_argument("--bundle", type=Path, help="by default one of the CartPole without a training")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        bundle = options.bundle or Path(place) / "bundle"
        if options.bundle is None:
            code = (
                "from pathlib import Path; from tests.bundle.untrained import write_bundle;"
                f" write_bundle(Path({str(bundle)!r}), 'cartpole')"
            )
            subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
        rows: list[Any] = [Row("load of the machine over the last minute, before", os.getloadavg()[0], "")]
        for kind, address in (("ZeroMQ", "tcp://127.0.0.1:58761"), ("WebSocket", "ws://127.0.0.1:58762")):
            rows += measured(bundle.resolve(), kind, address, options.seconds, options.clients)
        show(rows, as_json=options.json)


if __name__ == "__main__":
    main()
