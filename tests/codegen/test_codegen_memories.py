"""Memories of stateful functions that several methods of generated code update."""

from __future__ import annotations

import pytest

from tests.worlds import CART, Make

ALIVE = "reward: {alive: 1}\n"


@pytest.mark.parametrize("function", ["running_max", "previous", "low_pass"])
def test_a_sum_over_three_memories_drives_a_motor(make: Make, function: str) -> None:
    tau = ", 0.1 s" if function == "low_pass" else ""
    sum_of_three = f"sum({function}(vector(place, place, place){tau}))"
    environment = make(CART.replace("drive * 0.02 m/s", f'"(0.3 m - {sum_of_three}) / s"') + ALIVE)
    environment.reset(seed=0)
    for _ in range(60):
        observation, *_ = environment.step([0.0])
    # The motor moves until three times the place is 0.3 m.
    assert 2.4 * observation[0] == pytest.approx(0.1, abs=0.02)


def test_a_sum_over_three_memories_is_sent_to_a_robot(make: Make) -> None:
    aim = '    receive: {aim: "sum(running_max(vector(0 m, 0 m, time * 1 m/s)))"}\n    apply:'
    environment = make(CART.replace("    apply:", aim).replace("drive * 0.02 m/s", "aim / s") + ALIVE)
    environment.reset(seed=0)
    for _ in range(50):
        observation, *_ = environment.step([0.0])
    # The speed is the time: 0.5 m after 1 s, less one timestep.
    assert 2.4 * observation[0] == pytest.approx(0.5, abs=0.03)
