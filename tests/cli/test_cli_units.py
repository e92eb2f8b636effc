"""A quantity is shown in the unit in which the file writes it."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document.parse import parse
from deepbots_cli.learning.runs.draws import draw_labels, drawn_effects
from deepbots_cli.program.members import ZERO
from deepbots_cli.rollout import Episode
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.panel import agent_rows, message_rows

WALKER = """
deepbots: 1
extends: cartpole
name: Angles
robots: {cart: {sensors: {gyro: {type: gyro, link: pole}}}}
observation: {x: -40 .. 40 cm, cart.gyro: -300 .. 300 deg/s}
reset: {place: {cart: {x: uniform(-5 .. 5 cm), yaw: any}}}
"""


@pytest.fixture
def walker(tmp_path):
    (tmp_path / "walker.yaml").write_text(WALKER)
    return tmp_path / "walker.yaml"


def test_the_page_of_view_shows_degrees_and_centimeters_where_the_file_writes_them(walker):
    with closing(Player(Showing(str(walker)).open(), ZERO)) as player:
        frame = player.begin(0, 0)
        layout = player.reader.layout
        rows = "".join(agent_rows(layout, frame.agents["agent"]))
        messages = "".join(message_rows(layout, frame, ()))
    assert " rad" not in rows + messages
    assert "title='-20 deg .. 20 deg'" in rows
    assert "title='-40 cm .. 40 cm'" in rows
    assert "title='-300 deg/s .. 300 deg/s'" in rows
    angle = next(field for field in layout.observation if field.name == "cart.pole_angle")
    assert angle.label == "cart.pole_angle (deg)"
    assert angle.from_shown(angle.to_shown(0.1)) == pytest.approx(0.1)


def test_inspect_shows_each_component_of_a_vector_in_the_unit_of_the_file(deepbots, walker):
    rows = [line.split() for line in deepbots("inspect", str(walker)).out.splitlines()]
    assert ["cart.gyro.y", "-300", "300", "deg/s"] in [row[1:5] for row in rows]


def test_a_yaw_that_is_any_is_shown_in_degrees_and_not_from_minus_3_12_to_minus_1_44(walker):
    compiled = api.compile(walker)
    labels = draw_labels(compiled.program, compiled.units)
    yaws = np.linspace(-3.12, 3.12, 200)
    done = [
        Episode(0.0, 1, bool(yaw > 0.0), None, drawn={"reset.place.cart.yaw": float(yaw)}) for yaw in yaws
    ]
    (value,) = drawn_effects(done, labels).effective
    assert value.label.range_text(value.parts[0]).startswith("-178.8 .. -")
    assert value.label.range_text(value.parts[0]).endswith(" deg")
    assert labels["reset.place.cart.x"].unit.text == "cm"


def test_an_angle_is_shown_in_radians_where_the_file_writes_all_angles_in_radians():
    text = "parameters: {lean: 0.2 rad}\nobservation: {tilt: -lean .. lean, heading: auto, far: auto}"
    units = ShownUnits(parse(Source("radians.yaml", text), Findings()))
    assert units.of_entry("tilt", "rad").text == "rad"
    assert units.of_entry("heading", "rad").text == "rad"
    assert units.of("rad/s").text == "rad/s"
    assert ShownUnits().of("rad/s").text == "deg/s"
