"""Memories of stateful functions that several methods of generated code update."""

from __future__ import annotations

import pytest

from tests.worlds import Make

VECTOR = "sum(running_max(vector(0 m, 0 m, time * 1 m/s)))"


@pytest.mark.parametrize("function", ["running_max(place)", "previous(place)", "low_pass(place, 0.1 s)"])
def test_a_sum_over_three_memories_drives_a_motor(make: Make, function: str) -> None:
    rows = " + ".join([function] * 3)
    environment = make(
        f"""\
deepbots: 1
name: Sum
world: {{timestep: 20 ms, substeps: 4}}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors: {{place: {{type: joint_position, joint: slider}}}}
    actuators: {{motor: {{type: velocity_motor, joint: slider}}}}
    apply: {{motor: "(0.3 m - sum({function.replace("place", "vector(place, place, place)")})) / s"}}
action: {{drive: -1 .. 1}}
signals: {{three: {rows}}}
observation: {{cart.place: -2 .. 2 m}}
reward: {{alive: 1}}
truncation: {{max_steps: 60}}
""".replace(f"three: {rows}", "three: 3 * cart.place")
    )
    environment.reset(seed=0)
    for _ in range(60):
        observation, *_ = environment.step([0.0])
    # The motor moves until three times the place is 0.3 m.
    assert 2 * observation[0] == pytest.approx(0.1, abs=0.02)


def test_a_sum_over_three_memories_is_sent_to_a_robot(make: Make) -> None:
    environment = make(
        f"""\
deepbots: 1
name: Sent
world: {{timestep: 20 ms, substeps: 4}}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors: {{place: {{type: joint_position, joint: slider}}}}
    actuators: {{motor: {{type: velocity_motor, joint: slider}}}}
    receive: {{aim: "{VECTOR}"}}
    apply: {{motor: aim / s}}
action: {{drive: -1 .. 1}}
observation: {{cart.place: -2 .. 2 m}}
reward: {{alive: 1}}
truncation: {{max_steps: 50}}
"""
    )
    environment.reset(seed=0)
    for _ in range(50):
        observation, *_ = environment.step([0.0])
    # The speed is the time: 0.5 m after 1 s, less one timestep.
    assert 2 * observation[0] == pytest.approx(0.5, abs=0.03)
