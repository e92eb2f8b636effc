"""Many messages over one radio: what arrives, when, and how likely it is that chance made the difference to
what was asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import groupby
from math import erfc, exp, gamma, sqrt
from typing import Any

from deepbots_cli.program.robots import Route
from deepbots_cli.runtime.messages import LossyChannel
from deepbots_cli.runtime.streams import Streams
from tests.named import constant

MESSAGES = 100_000
TICK = 0.01
BURSTS = (
    (0.05, 3.0, 1),
    (0.2, 10.0, 2),
    (0.5, 1.5, 3),
    (0.3, 1.0, 4),
)  # share that is lost, mean length, seed
SINGLE = ((0.05, 1), (0.3, 2), (0.9, 3))  # share, seed


class Plain:
    """Messages go as they are."""

    silence = "zeros"

    def encode(self, message: Any) -> Any:
        return message

    decode = encode


def radio(
    *, latency: float = 0.0, loss: float = 0.0, seed: int = 0, name: str = "cart.to_robot", **others: Any
) -> LossyChannel:
    channel = LossyChannel(name, Route(constant(latency), constant(loss), **others), TICK, wire=Plain())
    channel.begin(Streams(seed))
    return channel


def arrivals(link: LossyChannel, latencies: Sequence[float]) -> list[list[Any]]:
    """What is taken in each tick, when message k is sent in tick k with the k-th latency (in ticks), and
    until all is quiet."""
    taken = []
    for number, latency in enumerate(latencies):
        link.latency = latency * TICK
        link.send(number)
        taken.append(link.receive())
    return taken + [link.receive() for _ in range(int(max(latencies)) + 2)]


def drawn_latencies() -> list[float]:
    """Uniform over 0 to 8 ticks."""
    return Streams(3)["cart.to_robot.latency#0"].uniform(0.0, 8.0, MESSAGES).tolist()  # type: ignore[no-any-return]


def lost_in(link: LossyChannel, count: int = MESSAGES) -> list[bool]:
    lost = []
    for number in range(count):
        link.send(number)
        link.receive()
        lost.append(not link.message_received)
    return lost


def runs_of(lost: list[bool]) -> list[int]:
    return [len(list(members)) for value, members in groupby(lost) if value]


def spread(share: float, burst: float | None = None) -> float:
    """Standard deviation of the share that is lost of all messages: the memory of bursts widens it."""
    memory = 0.0 if burst is None else (1 - 1 / burst) - share / (burst * (1 - share))
    return sqrt(share * (1 - share) / MESSAGES * (1 + memory) / (1 - memory))


def chi_square_p(observed: Sequence[float], expected: Sequence[float]) -> float:
    """How often chance alone differs as much, where the counts of all classes together are given: Pearson's
    test."""
    half = sum((count - wanted) ** 2 / wanted for count, wanted in zip(observed, expected, strict=True)) / 2
    freedom = len(observed) - 1
    tail = erfc(sqrt(half)) if freedom % 2 else 0.0
    return tail + sum(
        half**k * exp(-half) / gamma(k + 1) for k in (order / 2 for order in range(freedom % 2, freedom, 2))
    )


def delay_p(delays: Sequence[int]) -> float:
    """Of delays that are uniform over 1 to 8 ticks."""
    counts = Counter(delays)
    return (
        chi_square_p([counts[ticks] for ticks in range(1, 9)], [len(delays) / 8] * 8)
        if set(counts) <= set(range(1, 9))
        else 0.0
    )


def geometric_p(runs: Sequence[int], stay: float) -> float:
    """Of runs whose length is k with the share (1 - stay) stay^(k-1); classes with an expectation of at least
    10, the rest together."""
    counts = Counter(runs)
    observed = []
    expected = []
    length = 1
    left = float(len(runs))
    while (wanted := len(runs) * (1 - stay) * stay ** (length - 1)) >= 10 and left - wanted >= 10:
        observed.append(counts[length])
        expected.append(wanted)
        left -= wanted
        length += 1
    if not expected:
        return 1.0 if set(counts) == {1} else 0.0
    return chi_square_p([*observed, len(runs) - sum(observed)], [*expected, left])
