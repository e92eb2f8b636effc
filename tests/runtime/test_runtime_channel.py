"""The channel delivers in order, as late as it says, and forgets at a reset."""

from __future__ import annotations

import pytest

from deepbots_cli.runtime.channel import Channel
from deepbots_cli.runtime.streams import Streams


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_message_arrives_so_many_ticks_after_it_was_sent(delay: int) -> None:
    channel = Channel(delay)
    arrived = []
    for tick in range(6):
        channel.send(f"sent in {tick}")
        arrived.append(channel.receive())
    assert arrived == [None] * delay + [f"sent in {tick}" for tick in range(6 - delay)]


def test_what_is_under_way_is_forgotten_when_an_episode_begins() -> None:
    channel = Channel(2)
    channel.send("old")
    channel.send("older")
    assert len(channel) == 2
    channel.begin(Streams(0))
    assert len(channel) == 0
    channel.send("new")
    assert channel.receive() is None


def test_without_delay_nothing_stays_in_the_channel() -> None:
    channel = Channel()
    channel.send("now")
    assert channel.receive() == "now"
    assert len(channel) == 0
