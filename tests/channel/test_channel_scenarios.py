"""Messages on their way, from the text of a scenario to the results of a step, on a cart that follows its
commands at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import MessageError
from deepbots_cli.runtime import Supervisor
from tests.worlds import SCENARIOS, Make

DRIVES = (1.0, -1.0, 0.5, -0.5, 0.25, 0.75)
NEARLY = 1e-4
PAIR = SCENARIOS / "pair.yaml"


def terms(environment: Supervisor, drives: Sequence[float] = DRIVES, seed: int = 0) -> dict[str, list[float]]:
    """Each reward term over an episode that takes these actions."""
    environment.reset(seed=seed)
    rows = [environment.step(np.array([drive]))[4]["reward_terms"] for drive in drives]
    return {name: [row[name] for row in rows] for name in rows[0]}


@pytest.mark.parametrize(
    ("latency", "ticks"), [("0 ms", 0), ("1 ms", 1), ("20 ms", 1), ("40 ms", 2), ("41 ms", 3)]
)
def test_a_robot_acts_when_the_message_arrives(cart: Make, latency: str, ticks: int) -> None:
    values = terms(cart(f"messages.to_robot={{latency: {latency}}}"))
    assert values["truth"] == pytest.approx([*[0.0] * ticks, *DRIVES][:6], abs=NEARLY)
    assert values["sent"] == pytest.approx(values["truth"])


@pytest.mark.parametrize(
    ("latency", "ticks"), [("0 ms", 0), ("1 ms", 1), ("20 ms", 1), ("40 ms", 2), ("41 ms", 3)]
)
def test_a_supervisor_uses_the_values_that_have_arrived(cart: Make, latency: str, ticks: int) -> None:
    values = terms(cart(f"messages.from_robot={{latency: {latency}}}"))
    assert values["truth"] == pytest.approx(DRIVES, abs=NEARLY)
    assert values["sent"] == pytest.approx([*[0.0] * ticks, *DRIVES][:6], abs=NEARLY)


def test_paper_timing_is_one_tick_more_either_way(cart: Make) -> None:
    route = "{to_robot: {latency: 20 ms}, from_robot: {latency: 20 ms}"
    immediate, paper = (
        terms(cart(f"messages={route}, timing: {timing}}}")) for timing in ("immediate", "delayed")
    )
    assert immediate["truth"] == pytest.approx([0.0, *DRIVES[:5]], abs=NEARLY)
    assert immediate["sent"] == pytest.approx([0.0, 0.0, *DRIVES[:4]], abs=NEARLY)
    assert paper["truth"] == pytest.approx([0.0, 0.0, *DRIVES[:4]], abs=NEARLY)
    assert paper["sent"] == pytest.approx([0.0] * 4 + [*DRIVES[:2]], abs=NEARLY)


@pytest.mark.parametrize("format", ["struct", "csv", "json", "msgpack"])
def test_every_format_may_be_late_and_lost(cart: Make, format: str) -> None:
    environment = cart(
        f"messages={{format: {format}, to_robot: {{loss: 100 %, on_loss: zero}}, from_robot: {{latency: 20"
        f" ms}}}}"
    )
    assert terms(environment)["truth"] == pytest.approx([0.0] * 6, abs=NEARLY)


@pytest.mark.parametrize(
    ("on_loss", "moves"),
    [("hold", [0.0] * 6), ("skip", [0.0] * 6), ("zero", [1.0] * 6)],
    ids=lambda value: str(value)[:4],
)
def test_what_a_robot_makes_of_a_lost_message(cart: Make, on_loss: str, moves: list[float]) -> None:
    """All is lost here: the robot acts on zeros or on nothing at all."""
    environment = cart(
        f"messages.to_robot={{loss: 1, on_loss: {on_loss}}}",
        "robots.cart.apply.motor=0.1 m/s + drive * 0.1 m/s",
    )
    assert terms(environment, [0.5] * 6)["truth"] == pytest.approx(moves, abs=NEARLY)


@pytest.mark.parametrize(("on_loss", "low", "high"), [("hold", 3.8, 4.2), ("skip", 1.0, 3.5)])
def test_a_held_message_counts_as_one_more_for_what_the_robot_remembers(
    cart: Make, on_loss: str, low: float, high: float
) -> None:
    environment = cart(
        f"messages.to_robot={{loss: 50 %, on_loss: {on_loss}}}",
        "robots.cart.apply.motor=accumulate(drive * 0.1 m/s, -9 .. 9 m/s, 0 m/s)",
    )
    environment.reset(seed=1)
    last = [environment.step(np.array([0.1]))[4]["reward_terms"]["truth"] for _ in range(40)][-1]
    assert low < last < high


def test_what_the_supervisor_holds_or_zeroes_is_what_arrived(cart: Make) -> None:
    held, zeroed = (
        terms(cart(f"messages.from_robot={{loss: 0.5, on_loss: {word}}}"), [1.0] * 60)
        for word in ("hold", "zero")
    )
    lost = [value == 0.0 for value in zeroed["sent"]]
    assert 10 < sum(lost) < 50
    first = lost.index(False)
    assert held["sent"][:first] == [0.0] * first
    assert held["sent"][first:] == pytest.approx([1.0] * (60 - first), abs=NEARLY)


def test_beyond_its_range_a_robot_hears_nothing(cart: Make) -> None:
    near, far = (cart("messages.to_robot={range: 1 m}", f"robots.cart.pose={{y: {y} m}}") for y in (0.5, 1.5))
    assert terms(near)["truth"] == pytest.approx(DRIVES, abs=NEARLY)
    assert terms(far)["truth"] == pytest.approx([0.0] * 6, abs=NEARLY)


# What the supervisor knows of it

TOLD = "augment: {stale: age(cart), came: message_received(cart)}\n"
SEEN = "reward={age: stale / (20 ms), came: 1 when came}"


@pytest.mark.parametrize(
    ("route", "ages", "fresh"),
    [
        ("messages.from_robot={latency: 0 ms}", [0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1]),
        ("messages.from_robot={latency: 30 ms}", [1, 2, 2, 2, 2, 2], [0, 0, 1, 1, 1, 1]),
        ("messages.from_robot={loss: 1}", [1, 2, 3, 4, 5, 6], [0, 0, 0, 0, 0, 0]),
        ("messages.from_robot={loss: 1, on_loss: zero}", [1, 2, 3, 4, 5, 6], [0, 0, 0, 0, 0, 0]),
        ("messages.timing=delayed", [1, 1, 1, 1, 1, 1], [1, 1, 1, 1, 1, 1]),
        ("messages.format=none", [0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1]),
    ],
)
def test_age_counts_from_measurement_and_fresh_says_that_one_came(
    cart: Make, route: str, ages: list[int], fresh: list[int]
) -> None:
    values = terms(cart(route, SEEN, more=TOLD))
    assert values["age"] == pytest.approx(ages)
    assert values["came"] == fresh


def test_the_first_message_of_an_episode_is_there_at_once(cart: Make) -> None:
    observed = "observation={stale: 0 .. 1 s, came: auto, cart.place: -2.4 .. 2.4 m}"
    environment = cart(
        "messages.from_robot={latency: 300 ms, loss: 0.9}",
        observed,
        "reset.joints={cart.slider: 1.2 m}",
        more=TOLD,
    )
    assert environment.reset(seed=0)[0].tolist() == pytest.approx([-1.0, 1.0, 0.5])


def test_ages_of_a_drawn_latency_lie_between_its_ends(cart: Make) -> None:
    environment = cart(
        "messages.from_robot={latency: uniform(0 .. 60 ms) each step, order: newest}", SEEN, more=TOLD
    )
    ages = {round(age) for age in terms(environment, [0.0] * 200)["age"]}
    assert ages == {1, 2, 3}


@pytest.mark.parametrize(
    "signal", ["age(cart) / s", "limit * step * inner", "wind * cart.place / m", "position(cart.cart).x / m"]
)
def test_a_signal_is_never_observed_whatever_it_is_made_of(cart: Make, tmp_path: Path, signal: str) -> None:
    names = f'{{inner: cart.rate * s / m, seen: "{signal}"}}'
    cart(more=f"parameters: {{limit: 2, wind: uniform(0 .. 1)}}\nsignals: {names}\n")
    findings = api.lint(tmp_path / "scenario.yaml", overrides=["observation={seen: -1 .. 1}"])
    assert [finding.code for finding in findings] == ["DB609"]


# Episodes and robots


def test_a_new_episode_starts_without_messages_of_the_last(cart: Make) -> None:
    route = (
        "{to_robot: {latency: 60 ms, loss: 0.3, burst: 4}, from_robot: {latency: uniform(0 .. 50 ms)"
        " each step, loss: 0.3}}"
    )
    environment = cart(f"messages={route}")
    first = terms(environment)
    terms(environment, [0.3] * 11, seed=5)
    assert terms(environment) == first
    assert terms(cart(f"messages={route}")) == first


def test_what_happens_on_one_channel_leaves_the_other_alone(cart: Make) -> None:
    """Robot `left` is out of reach of the supervisor in one world; what `right` hears and says stays the
    same, bit by bit."""

    def right(reach: str, *overrides: str) -> list[float]:
        drawn = "{latency: uniform(0 .. 60 ms) each step, loss: 0.3, burst: 2, range: REACH}".replace(
            "REACH", reach
        )
        environment = cart(
            f"messages={{to_robot: {drawn}, from_robot: {drawn}}}", *overrides, source=PAIR.read_text()
        )
        observations = [environment.reset(seed=3)[0]]
        observations += [environment.step(np.array([step % 3, 0]))[0] for step in range(50)]
        return [float(observation[2]) for observation in observations]

    in_range, left_out_of_range = right("3 m"), right("3 m", "robots.left.pose={y: 5 m}", "termination={}")
    assert len(set(in_range)) > 10
    assert in_range == left_out_of_range


@pytest.mark.parametrize(
    ("sensor", "route", "ages"),
    [
        ("", "{latency: 0 ms}", [0, 0, 0, 0, 0, 0]),
        ("latency: 40 ms", "{latency: 0 ms}", [1, 2, 2, 2, 2, 2]),
        ("period: 60 ms", "{latency: 0 ms}", [1, 2, 0, 1, 2, 0]),
        ("period: 60 ms", "{latency: 20 ms}", [1, 2, 3, 1, 2, 3]),
        ("latency: 20 ms", "{latency: 30 ms}", [1, 2, 3, 3, 3, 3]),
    ],
)
@pytest.mark.parametrize("format", ["struct", "csv"])
def test_the_age_of_a_reading_is_its_own_and_that_of_the_message(
    cart: Make, sensor: str, route: str, ages: list[int], format: str
) -> None:
    faults = [f"robots.cart.sensors.place.{sensor.replace(': ', '=')}"] if sensor else []
    messages = f"messages={{format: {format}, from_robot: {route}}}"
    values = terms(cart(messages, *faults, "reward={place: age(cart.place) / (20 ms)}"))
    assert values["place"] == pytest.approx(ages)


REWARD = "reward={rival: joint_velocity(rival.slider) / (0.1 m/s)}"
SCRIPTED = """\
  rival:
    urdf: cartpole_rail
    base: fixed
    pose: {y: 1 m}
    joints: {slider: {max_torque: 1000 N}}
    sensors: {place: {type: joint_position, joint: slider}}
    actuators: {motor: {type: velocity_motor, joint: slider, max_torque: 1000 N}}
    receive:
      seen: cart.place
    emit: []
    apply:
      motor: (-1 if place > 3 mm else 1) * 0.1 m/s + seen / s
"""


@pytest.mark.parametrize("format", ["struct", "csv", "none"])
def test_a_scripted_robot_acts_on_its_own_sensors_and_on_received_values(cart: Make, format: str) -> None:
    """No action variable reaches the robot. It drives forth and back around 3 mm by its own sensors, and
    drifts with the place of the other robot."""
    environment = cart(f"messages.format={format}", REWARD, rival=SCRIPTED)
    values = terms(environment, [0.0] * 4)
    assert values["rival"] == pytest.approx([1.0, 1.0, -1.0, 1.0], abs=NEARLY)
    drifting = terms(environment, [1.0, 0.0])["rival"]
    assert drifting == pytest.approx([1.0, 1.0 + 0.02], abs=1e-3)
    assert [field.name for field in environment.scenario.robots[1].to_robot.fields] == ["seen"]


def test_a_message_on_a_foreign_channel_is_refused(cart: Make) -> None:
    environment = cart(REWARD, rival=SCRIPTED)
    environment.reset(seed=0)
    environment.to_rival.transmit(environment.to_cart.wire.encode((1.0,)))
    with pytest.raises(
        MessageError, match="robot 'rival', to the robot, step 1: the message has another layout"
    ):
        environment.step(np.zeros(1))
