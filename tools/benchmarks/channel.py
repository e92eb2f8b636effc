"""What routes deliver over 100 000 messages, against what is declared of them.

    python -m tools.benchmarks.channel [--json]

The first rows drive a radio by itself, message by message; the last go through a scenario, 100 000 steps of a
cart on a rail. A chi-square p says how often chance alone differs as much: below 0.001, something else is
behind it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np

from deepbots_cli import api
from tests.channel.conftest import CART
from tests.channel.test_channel_radio import (
    BURSTS,
    MESSAGES,
    SINGLE,
    arrivals,
    delay_p,
    drawn_latencies,
    geometric_p,
    lost_in,
    radio,
    runs_of,
    spread,
)
from tools.benchmarks.report import Row, options, show

LIKELY = 0.001


def delays_and_orders() -> Iterator[Row]:
    latencies = drawn_latencies()
    taken = arrivals(radio(order="arrival"), latencies)
    pairs = [(tick, message) for tick, messages in enumerate(taken) for message in messages]
    yield Row(
        "delays of latencies drawn from 0 .. 8 ticks: chi-square p",
        delay_p([tick - message for tick, message in pairs]),
        "",
        LIKELY,
        True,
    )
    yield Row(
        "of them delivered before they arrived, or a tick too late",
        float(sum(not -1e-9 <= tick - message - latencies[message] < 1 for tick, message in pairs)),
        "",
        0,
    )
    came = [message + latencies[message] for _, message in pairs]
    yield Row(
        "order arrival: delivered before one that came earlier",
        float(sum(a > b for a, b in pairwise(came))),
        "",
        0,
    )
    sent = [message for messages in arrivals(radio(order="sent"), latencies) for message in messages]
    yield Row(
        "order sent: missing or out of order",
        float(MESSAGES - sum(a == b for a, b in enumerate(sent))),
        "",
        0,
    )
    newest = [message for messages in arrivals(radio(order="newest"), latencies) for message in messages]
    yield Row(
        "order newest: delivered after a newer one", float(sum(a > b for a, b in pairwise(newest))), "", 0
    )


def losses() -> Iterator[Row]:
    for share, seed in SINGLE:
        lost = lost_in(radio(loss=share, seed=seed))
        yield Row(
            f"loss of {share:.0%}: off by (bar: 4 standard deviations)",
            100 * abs(float(np.mean(lost)) - share),
            "%",
            round(400 * spread(share), 2),
        )
        yield Row(
            f"loss of {share:.0%}: lengths of gaps, chi-square p",
            geometric_p(runs_of(lost), share),
            "",
            LIKELY,
            True,
        )
    for share, burst, seed in BURSTS:
        lost = lost_in(radio(loss=share, burst=burst, seed=seed))
        what = f"loss of {share:.0%} in bursts of {burst:g}"
        yield Row(
            f"{what}: off by (bar: 4 standard deviations)",
            100 * abs(float(np.mean(lost)) - share),
            "%",
            round(400 * spread(share, burst), 2),
        )
        yield Row(
            f"{what}: lengths, chi-square p", geometric_p(runs_of(lost), 1 - 1 / burst), "", LIKELY, True
        )


def through_a_scenario(*overrides: str) -> np.ndarray:
    """`fresh` and `age` (s) of what the supervisor has, over as many steps as messages."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "pyproject.toml").touch()
        file = Path(folder, "cart.yaml")
        reward = "reward={fresh: '1 if message_received(cart) else 0', age: age(cart) / (1 s)}"
        file.write_text(CART, encoding="utf-8")
        with closing(
            api.make(
                file,
                overrides=[*overrides, reward, f"truncation.max_steps={MESSAGES + 1}"],
                engine="pybullet",
            )
        ) as environment:
            environment.reset(seed=5)
            action = np.zeros(1, np.float32)
            rows = [environment.step(action)[4]["reward_terms"] for _ in range(MESSAGES)]
    return np.array([[row["fresh"], row["age"]] for row in rows])


def scenarios() -> Iterator[Row]:
    lossy = through_a_scenario("messages.from_robot={loss: 0.2}")
    yield Row(
        "through a scenario: loss of 20%, off by (bar: 4 standard deviations)",
        100 * abs(0.8 - lossy[:, 0].mean()),
        "%",
        round(400 * spread(0.2), 2),
    )
    late = through_a_scenario("messages.from_robot={latency: 50 ms}")
    yield Row(
        "through a scenario: latency of 50 ms at ticks of 20 ms, ages that are not 60 ms",
        wrong_ages(late, 0.06),
        "",
        0,
    )
    delayed = through_a_scenario("messages.timing=delayed")
    yield Row(
        "through a scenario: timing delayed, ages that are not one tick", wrong_ages(delayed, 0.02), "", 0
    )


def wrong_ages(rows: np.ndarray, age: float) -> float:
    return float(np.sum(np.abs(rows[10:, 1] - age) > 1e-9))


def main() -> None:
    arguments = options(__doc__)
    show([*delays_and_orders(), *losses(), *scenarios()], as_json=arguments.json)


if __name__ == "__main__":
    main()
