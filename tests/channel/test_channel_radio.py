"""The radio alone: latency, order and loss of messages, against the numbers of the route.

Many messages over one radio: what arrives, when, and how likely it is that chance made the difference to
what was asked for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import groupby
from math import erfc, exp, gamma, sqrt
from typing import Any

import numpy as np
import pytest

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


# The radio alone: latency, order and loss of messages, against the numbers of the route


# Latency


@pytest.mark.parametrize(
    ("latency", "ticks"),
    [(0.0, 0), (0.001, 1), (0.01, 1), (0.01 + 1e-13, 1), (0.0101, 2), (0.03, 3), (0.1 + 0.2, 30), (-1.0, 0)],
)
def test_a_message_is_delivered_in_the_first_tick_at_or_after_its_arrival(latency: float, ticks: int) -> None:
    link = radio(latency=latency)
    link.send("a")
    assert [link.receive() for _ in range(ticks + 1)] == [[]] * ticks + [["a"]]


def test_late_is_not_lost() -> None:
    taken = arrivals(radio(on_loss="zero"), [3.0] * 50)
    assert [message for tick in taken for message in tick] == list(range(50))


def test_delays_of_many_messages_have_the_distribution_that_they_are_drawn_from() -> None:
    """Uniform latencies over 0 to 8 ticks: each number of ticks from 1 to 8 alike."""
    taken = arrivals(radio(order="arrival"), drawn_latencies())
    assert delay_p([tick - message for tick, messages in enumerate(taken) for message in messages]) > 1e-3


# Order


def test_sent_order_lets_a_late_message_hold_up_those_after_it() -> None:
    assert arrivals(radio(), [3.0, 0.0, 0.0, 0.0, 0.0])[:5] == [[], [], [], [0, 1, 2, 3], [4]]


def test_arrival_order_takes_messages_as_they_come() -> None:
    assert arrivals(radio(order="arrival"), [3.0, 0.0, 0.0, 0.0, 0.0])[:5] == [[], [1], [2], [0, 3], [4]]


def test_within_a_tick_the_exact_times_of_arrival_count() -> None:
    assert arrivals(radio(order="arrival"), [1.9, 0.2, 0.0])[:3] == [[], [], [1, 0, 2]]


def test_newest_drops_what_is_older_than_what_was_delivered() -> None:
    assert arrivals(radio(order="newest"), [3.0, 0.0, 0.0, 0.0, 0.0])[:5] == [[], [1], [2], [3], [4]]


@pytest.mark.parametrize(
    ("order", "latest", "measured"),
    [("sent", 1, [0, 0, 2]), ("arrival", 0, [0, 2, 1]), ("newest", 1, [0, 2, 2])],
)
def test_the_message_that_came_last_counts(order: Any, latest: int, measured: list[int]) -> None:
    link = radio(order=order)
    measured_ticks = []
    for number, latency in enumerate([2.0, 0.0]):
        link.latency = latency * TICK
        link.send(number)
        link.receive()
        measured_ticks.append(link.measured_tick)
    link.receive()
    assert (link.latest, [*measured_ticks, link.measured_tick]) == (latest, measured)


# Loss


@pytest.mark.parametrize(("share", "seed"), SINGLE)
def test_without_bursts_each_message_is_lost_or_not_by_itself(share: float, seed: int) -> None:
    """The share within 4 standard deviations; runs geometric, with the mean 1 / (1 - share)."""
    lost = lost_in(radio(loss=share, seed=seed))
    assert abs(np.mean(lost) - share) < 4 * spread(share)
    assert geometric_p(runs_of(lost), share) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("share", "burst", "seed"), BURSTS)
def test_losses_in_bursts_have_the_share_and_the_mean_length_that_are_asked_for(
    share: float, burst: float, seed: int
) -> None:
    lost = lost_in(radio(loss=share, burst=burst, seed=seed))
    assert abs(np.mean(lost) - share) < 4 * spread(share, burst)
    runs = runs_of(lost)
    stay = 1 - 1 / burst
    assert abs(np.mean(runs) - burst) < 4 * sqrt(stay) * burst / sqrt(len(runs)) + 1e-12
    assert geometric_p(runs, stay) > 1e-3


def test_all_or_nothing_is_lost_at_the_ends() -> None:
    assert not any(lost_in(radio(loss=0.0), 100))
    assert all(lost_in(radio(loss=1.0), 100))
    assert all(lost_in(radio(loss=1.0, burst=4.0), 100))


def test_beyond_the_range_nothing_arrives() -> None:
    place = [0.0, 0.0, 0.0]
    link = LossyChannel("cart.to_robot", Route(range=constant(5.0)), TICK, where=lambda: (tuple(place), None))
    arrived = []
    for x in (0.0, 3.0, 4.0):
        place[:] = x, 4.0, 0.0
        arrived += [not lost for lost in lost_in(link, 1)]
    assert arrived == [True, True, False]


# Gaps


@pytest.mark.parametrize(
    ("on_loss", "taken", "latest"),
    [
        ("hold", [["a"], ["a"], ["c"]], "c"),
        ("zero", [["a"], ["zeros"], ["c"]], "c"),
        ("skip", [["a"], [], ["c"]], "c"),
    ],
)
def test_a_lost_message_is_a_gap_that_the_receiver_fills_as_the_route_says(
    on_loss: Any, taken: list[Any], latest: str
) -> None:
    link = radio(on_loss=on_loss)
    link._loses = True
    link._random = lambda: 0.5
    messages, fresh = [], []
    for message, loss in (("a", 0.0), ("b", 1.0), ("c", 0.0)):
        link.loss = loss
        link.send(message)
        messages.append(link.receive())
        fresh.append(link.message_received)
    assert (messages, fresh, link.latest) == (taken, [True, False, True], latest)


@pytest.mark.parametrize("on_loss", ["hold", "skip"])
def test_there_is_nothing_to_hold_before_the_first_message(on_loss: Any) -> None:
    link = radio(loss=1.0, on_loss=on_loss)
    link.send("a")
    assert link.receive() == []


def test_a_gap_comes_when_the_message_would_have_come() -> None:
    link = radio(latency=0.02, loss=1.0, on_loss="zero")
    link.send("a")
    assert [link.receive() for _ in range(4)] == [[], [], ["zeros"], []]


def test_the_gap_of_a_message_that_would_have_been_dropped_is_dropped() -> None:
    link = radio(order="newest", on_loss="zero")
    link._loses = True
    link._random = lambda: 0.5
    taken = []
    for latency, loss in ((2.0, 1.0), (0.0, 0.0), (0.0, 0.0)):
        link.latency = latency * TICK
        link.loss = loss
        link.send(len(taken))
        taken.append(link.receive())
    assert taken == [[], [1], [2]]


# Episodes and streams


def test_two_channels_never_share_a_draw() -> None:
    to_robot, from_robot = (
        lost_in(radio(loss=0.5, name=name), 2000) for name in ("left.to_robot", "left.from_robot")
    )
    alike = sum(a == b for a, b in zip(to_robot, from_robot, strict=True))
    assert abs(alike - 1000) < 4 * sqrt(2000) / 2
    assert to_robot == lost_in(radio(loss=0.5, name="left.to_robot"), 2000)
