"""Walls and the arena as bodies with names: what expressions, sensors and cameras know of them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.compiler.inventory import definition, names_at
from deepbots_cli.runtime import Supervisor
from tests.worlds import Make

# The puck is 4 cm high and 2 cm in radius; the faces of `bay` are at x = 0.39 and 0.41 m, those of the arena
# at 1 m.
YARD = """
deepbots: 1
name: Yard
summary: A puck between walls.
world:
  timestep: 32 ms
  arena: {size: 2 2 m}
  walls:
    bay:  {points: [0.4 -0.3 m, 0.4 0.3 m], thickness: 2 cm, height: 20 cm}
    nook: {points: [-0.4 -0.3 m, -0.4 0.3 m, -0.1 0.3 m], thickness: 2 cm}
objects:
  puck: {shape: cylinder, radius: 2 cm, height: 4 cm, mass: 0.1 kg, friction: 0}
robots:
  stand:
    urdf: cartpole_rail
    base: fixed
    pose: {x: 5 m}
action: {idle: -1 .. 1}
augment:
  to_bay:   clearance(puck, bay)
  to_nook:  clearance(nook, puck)
  to_arena: clearance(puck, arena)
  middle:   position(bay)
  touched:  contact(puck, bay)
  bumped:   collided(bay)
  fenced:   contact(arena, puck)
observation: {to_bay: 0 .. 2 m, to_nook: 0 .. 2 m, to_arena: 0 .. 2 m, middle: -1 .. 1 m, touched: auto, bumped: auto, fenced: auto}
reward: {idle: idle}
truncation: {max_steps: 50}
reset: {place: {puck: {x: 0.2 m, y: 0.25 m}}}
"""


def observed_values(environment: Supervisor) -> dict[str, float]:
    """The values of the observation, in m and as truth values."""
    entries = environment.scenario.agent.numbers
    observation = environment.get_observations()
    return {
        f"{entry.name}{f'.{entry.component}' if entry.component else ''}": entry.low
        + (value + 1) / 2 * (entry.high - entry.low)
        for entry, value in zip(entries, observation.tolist(), strict=True)
    }


def test_a_wall_and_the_arena_can_be_named_in_gap_and_the_least_distance_counts(
    make: Make,
) -> None:
    environment = make(YARD)
    environment.reset(seed=0)
    values = observed_values(environment)
    assert values["to_bay"] == pytest.approx(0.39 - 0.22, abs=2e-3)
    assert values["to_nook"] == pytest.approx(
        math.hypot(0.29, 0.04) - 0.02, abs=2e-3
    )  # to the corner of the nearer of its two pieces
    assert values["to_arena"] == pytest.approx(1 - 0.27, abs=2e-3)  # the left wall


def test_a_wall_of_one_piece_has_a_position(make: Make) -> None:
    environment = make(YARD)
    environment.reset(seed=0)
    values = observed_values(environment)
    assert [values[f"middle.{axis}"] for axis in "xyz"] == pytest.approx([0.4, 0.0, 0.1], abs=1e-6)


def test_contact_and_collided_tell_walls_apart(make: Make) -> None:
    environment = make(YARD, "reset.place.puck.velocity=2 0 0 m/s")
    environment.reset(seed=0)
    touched = set()
    for _ in range(10):
        environment.step([0.0])
        values = observed_values(environment)
        assert values["touched"] == values["bumped"]
        touched |= {name for name in ("touched", "fenced") if values[name] > 0.5}
    assert touched == {"touched"}


def test_contact_with_the_arena_is_contact_with_any_of_its_walls(make: Make) -> None:
    environment = make(YARD, "reset.place.puck.velocity=0 4 0 m/s")
    environment.reset(seed=0)
    touched = set()
    for _ in range(15):
        environment.step([0.0])
        touched |= {name for name in ("touched", "fenced") if observed_values(environment)[name] > 0.5}
    assert touched == {"fenced"}


def test_a_touch_sensor_feels_a_wall_that_is_named(tmp_path: Path) -> None:
    file = tmp_path / "yard.yaml"
    sensors = "    sensors: {bump: {type: touch, link: pole, against: [nook, arena]}}\n    emit: [bump]\n"
    file.write_text(
        YARD.replace("    pose: {x: 5 m}\n", f"    pose: {{x: 5 m}}\n{sensors}"), encoding="utf-8"
    )
    (sensor,) = api.compile(file).program.robots[0].sensors
    assert sensor.against == ("nook 1", "nook 2", "front wall", "back wall", "left wall", "right wall")


def test_editors_offer_walls_and_the_arena_and_lead_to_where_they_stand(tmp_path: Path) -> None:
    file = tmp_path / "yard.yaml"
    file.write_text(YARD, encoding="utf-8")
    checked = api.load(file)
    felt = [
        entry.name
        for entry in names_at(checked, "bodies or links", ("robots", "stand", "sensors", "bump", "against"))
    ]
    assert {"bay", "nook", "arena"} <= set(felt)
    assert not {"bay", "arena"} & {entry.name for entry in names_at(checked, "body", ("reset", "place"))}
    for name in ("bay", "arena"):
        target = definition(checked, name)
        assert target is not None
        assert target.span is not None
        assert target.span.text == name
