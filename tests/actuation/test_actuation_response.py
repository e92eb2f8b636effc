"""Commands on their way: the closed forms of delay, lag and a limited rate."""

from __future__ import annotations

from math import exp, inf

import pytest

from deepbots_cli.runtime.actuation import Response

SUBSTEP = 0.005


def followed(response: Response, substeps: int) -> list[float]:
    """What is followed in each of the next substeps; not a number before the first command takes effect."""
    values, now = [], float("nan")
    for _ in range(substeps):
        found = response.advance()
        now = now if found is None else found[0]
        values.append(now)
    return values


def zero() -> list[float]:
    return [0.0]


def test_a_lag_is_the_step_response_of_first_order():
    tau = 0.03
    response = Response(SUBSTEP, zero, time_constant=tau)
    response.send([2.0])
    for k, value in enumerate(followed(response, 40), start=1):
        assert value == pytest.approx(2.0 * (1 - exp(-k * SUBSTEP / tau)), abs=1e-12)


def test_a_lag_ends_at_the_command_and_then_has_nothing_to_do():
    response = Response(SUBSTEP, zero, time_constant=0.01)
    response.send([0.3])
    assert followed(response, 200)[-1] == pytest.approx(0.3, abs=1e-15)
    assert response.advance() is None


@pytest.mark.parametrize(
    ("delay", "waits"), [(0.0, 0), (0.001, 1), (0.005, 1), (0.0051, 2), (0.020, 4), (0.3, 60)]
)
def test_a_command_takes_effect_in_the_first_substep_that_begins_late_enough(delay: float, waits: int):
    response = Response(SUBSTEP, zero, delay=delay)
    response.send([1.0])
    values = followed(response, waits + 1)
    assert values[-1] == 1.0
    assert all(value != value for value in values[:-1])


@pytest.mark.parametrize("substeps", [1, 2, 4, 8])
def test_a_delay_longer_than_a_tick_keeps_commands_in_order(substeps: int):
    response = Response(SUBSTEP, zero, delay=2.5 * SUBSTEP)
    changes = {}
    for tick in range(10):
        response.send([float(tick)])
        for k in range(substeps):
            found = response.advance()
            if found is not None:
                changes[tick * substeps + k] = found[0]
    assert changes == {
        tick * substeps + 3: float(tick) for tick in range(10) if tick * substeps + 3 < 10 * substeps
    }


def test_a_rate_bounds_every_change_and_the_command_is_reached_exactly():
    response = Response(SUBSTEP, lambda: [0.1, 0.0], rates=[2.0, inf])
    response.send([0.15, 5.0])
    for k in range(1, 5):
        first, second = response.advance() or ()
        assert first == pytest.approx(0.1 + k * 2.0 * SUBSTEP)
        assert second == 5.0
    assert (response.advance() or (0.0,))[0] == pytest.approx(0.15)


def test_after_a_reset_nothing_is_left_of_earlier_commands_and_new_figures_are_in_force():
    response = Response(SUBSTEP, zero, delay=0.01, time_constant=0.1)
    response.send([1.0])
    followed(response, 10)
    response.delay, response.time_constant = 0.0, 0.0
    response.reset()
    assert response.advance() is None
    response.send([3.0])
    assert response.advance() == [3.0]


def test_figures_below_zero_count_as_zero():
    response = Response(SUBSTEP, zero, delay=-1.0, time_constant=-1.0)
    response.send([1.0])
    assert response.advance() == [1.0]
