"""Random streams: one root seed, and each purpose for itself."""

from __future__ import annotations

import pytest

from deepbots_cli.runtime.streams import Streams, derive_seed

PINNED_SEEDS = [1726737503, 2927587060, 1207722611, 1478552595]
PINNED_DRAWS = [0.09192528450451198, -0.2648980716967728, 2.0, 2.0]


def test_derived_seeds_are_the_same_in_every_version() -> None:
    """A run is repeated by its seed, so these figures may never change."""
    assert [
        derive_seed(0),
        derive_seed(0, "reset"),
        derive_seed(0, "environment", 3),
        derive_seed(2**40, "évaluation"),
    ] == PINNED_SEEDS


def test_drawn_values_are_the_same_in_every_version() -> None:
    streams = Streams(7)
    drawn = [
        streams.uniform("a", -1.0, 1.0),
        streams.normal("b", 0.0, 1.0),
        streams.integer("c", 1, 6),
        streams.choice("d", 2.0, 3.0, 5.0),
    ]
    assert drawn == PINNED_DRAWS


def test_draws_from_other_streams_do_not_change_a_stream() -> None:
    alone, mixed = Streams(3), Streams(3)
    expected = [alone.uniform("wanted", 0.0, 1.0) for _ in range(5)]
    drawn = []
    for index in range(5):
        mixed.normal(f"other {index}", 0.0, 1.0)
        drawn.append(mixed.uniform("wanted", 0.0, 1.0))
        mixed.integer("another", 0, 9)
    assert drawn == expected


def test_without_a_seed_two_environments_differ() -> None:
    assert Streams(None).root != Streams(None).root


@pytest.mark.parametrize("root", [-1, 2**70])
def test_any_whole_number_is_a_seed(root: int) -> None:
    assert 0.0 <= Streams(root).uniform("a", 0.0, 1.0) < 1.0
    assert 0 <= derive_seed(root, "a") < 2**32


def test_whole_numbers_are_drawn_with_both_ends() -> None:
    streams = Streams(1)
    assert {streams.integer("n", 2, 4) for _ in range(100)} == {2.0, 3.0, 4.0}


def test_draws_are_plain_floats_that_every_message_format_can_carry() -> None:
    streams = Streams(1)
    drawn = [
        streams.uniform("a", 0, 1),
        streams.normal("b", 0, 1),
        streams.integer("c", 1, 6),
        streams.choice("d", 2.0, 3.0),
    ]
    assert {type(value) for value in drawn} == {float}
