"""Messages of commands about mistakes that are not mistakes of a scenario. Each test is named after the
report of a user."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.document import load, shipped
from deepbots_cli.document.nodes import to_data
from deepbots_cli.learning.report import TrainingProgress
from deepbots_cli.robots.kinematics import box_around
from deepbots_cli.runtime.overview import extent

CARTPOLE = "deepbots: 1\nextends: cartpole\nname: Copy\n"


def findings_of(folder: Path, text: str, name: str = "mine.yaml") -> list[tuple[str, str, str]]:
    (folder / name).write_text(text, encoding="utf-8")
    return [(finding.code, finding.headline, finding.help or "") for finding in api.lint(folder / name)]


def test_xyz_replaces_the_z_of_the_scenario_that_is_extended(tmp_path):
    (tmp_path / "base.yaml").write_text(f"{CARTPOLE}reset: {{place: {{cart: {{z: 5 cm, yaw: 10 deg}}}}}}\n")
    (tmp_path / "mine.yaml").write_text(
        "deepbots: 1\nextends: base.yaml\nreset: {place: {cart: {xyz: 0 0 1 m}}}\n"
    )
    assert to_data(load(tmp_path / "mine.yaml").root)["reset"]["place"]["cart"] == {
        "yaw": "10 deg",
        "xyz": "0 0 1 m",
    }
    assert api.lint(tmp_path / "mine.yaml") == []


def test_a_height_of_the_ground_that_is_drawn_is_called_drawn(tmp_path):
    text = f"{CARTPOLE}parameters: {{rise: uniform(1 .. 2 cm)}}\n"
    text += "world: {terrain: {type: formula, heights: rise if x > 1 m else 0 m, size: 9 9 m}}\n"
    ((code, headline, help),) = findings_of(tmp_path, text)
    assert code == "DB407"
    assert headline == "`heights` must be fixed, but uses `rise`, which is drawn in every episode"
    assert help.startswith("give it a fixed value")


def test_an_existing_value_under_augment_has_one_finding_that_shows_the_list(tmp_path):
    text = (
        f"{CARTPOLE}signals: {{clock: sin(360 deg * time / (1 s))}}\naugment: {{clock: clock, track:"
        f" track}}\n"
    )
    findings = [finding for finding in findings_of(tmp_path, text) if finding[0] in ("DB202", "DB207")]
    assert [(code, headline) for code, headline, _ in findings] == [
        ("DB202", "`clock` under `augment` exists already"),
        ("DB202", "`track` under `augment` exists already"),
    ]
    assert "`augment: [clock, ...]`" in findings[0][2]


def test_a_robot_outside_the_folder_can_be_allowed_and_named(deepbots, tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "buggy.urdf").write_bytes(shipped.robot_path("rover").read_bytes())
    refused = deepbots("new", "mine", "here", "--urdf", "there/buggy.urdf", code=2)
    assert "`--allow-path there`" in refused.err
    assert "package://PACKAGE/PATH" in refused.err
    deepbots("new", "mine", "here", "--urdf", "there/buggy.urdf", "--allow-path", "there")
    deepbots("lint", "here/mine.yaml", "--allow-path", "there")


def test_new_from_an_own_scenario_suggests_cp_and_extends(deepbots, tmp_path):
    (tmp_path / "one.yaml").write_text(CARTPOLE)
    error = deepbots("new", "base", "--from", "one.yaml", code=2).err
    assert "`cp one.yaml base.yaml`" in error
    assert "`extends: one.yaml`" in error


def test_a_picture_of_a_robot_names_the_option_that_needs_a_scenario(deepbots):
    assert "--labels needs a scenario" in deepbots("render", "epuck", "--labels", "-o", "a.png", code=2).err


def test_a_drawn_mass_is_marked_in_inspect(deepbots, tmp_path):
    (tmp_path / "mine.yaml").write_text(
        f"{CARTPOLE}robots: {{cart: {{links: {{pole: {{mass: uniform(0.1 .. 0.3 kg)}}}}}}}}\n"
    )
    assert "drawn in every episode" in deepbots("inspect", "mine.yaml").out
    assert "drawn in every episode" not in deepbots("inspect", "cartpole").out


@pytest.mark.parametrize("seconds", ["nan", "inf", "0", "-1"])
def test_serving_for_no_number_of_seconds_is_refused(deepbots, seconds):
    assert (
        f"--seconds {float(seconds):g}: write a number of seconds above 0"
        in deepbots("serve", "bundle", "--seconds", seconds, code=2).err
    )


def test_the_first_seconds_of_a_training_say_no_time_to_go():
    """The first updates of a training were slow, and it seemed to take 20 min; it took 4."""
    progress = TrainingProgress(
        steps=100, total_steps=100_000, episodes=1, mean_return=None, success_rate=None
    )
    assert progress.seconds_left(0, 1.0) is None
    assert progress.seconds_left(0, 60.0) == pytest.approx(60.0 * 999)
    assert not math.isnan(progress.seconds_left(0, 60.0) or math.nan)


@pytest.mark.parametrize("far", ["1e38", "12345678"])
def test_a_mesh_with_a_vertex_far_out_is_refused_before_an_engine_searches_it(deepbots, tmp_path, far):
    (tmp_path / "far.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 {far} 0\nf 1 2 3\n")
    (tmp_path / "far.urdf").write_text(
        '<robot name="far"><link name="a"><visual><geometry><mesh'
        ' filename="far.obj"/></geometry></visual></link></robot>'
    )
    ran = deepbots("inspect", "far.urdf", code=1)
    assert "the mesh has a vertex at 1" in ran.out + ran.err


def test_inspect_has_ranges_in_si_units_as_json(deepbots):
    assert '"low": -0.3490658503988659' in deepbots("inspect", "cartpole", "--json").out


def test_a_robot_on_a_large_field_is_not_a_dot(tmp_path):
    field = "deepbots: 1\nextends: quadruped\nname: Field\n"
    field += "world: {terrain: {type: formula, heights: 1 cm * sin(x / m * 90 deg), size: 40 40 m}}\n"
    (tmp_path / "field.yaml").write_text(field)
    low, high = box_around(extent(api.compile(tmp_path / "field.yaml").program))
    assert max(b - a for a, b in zip(low, high, strict=True)) < 10.0


def test_a_ground_beside_the_terrain_of_an_inherited_case_is_reported_at_the_ground(deepbots):
    Path("mine.yaml").write_text(
        "deepbots: 1\nextends: quadruped\nname: Mine\nworld: {ground: {friction: 0.5}}\n", encoding="utf-8"
    )
    ran = deepbots("lint", "mine.yaml", code=1)
    assert "`ground` cannot be combined with `terrain`\n   --> mine.yaml:4:9" in ran.out
    assert "with the settings of the case `rough`" in ran.out
    assert "or leave this case out: `remove: [evaluation.cases.rough]`" in ran.out
    text = Path("mine.yaml").read_text(encoding="utf-8")
    Path("mine.yaml").write_text(text + "remove: [evaluation.cases.rough]\n", encoding="utf-8")
    assert "DB101" not in deepbots("lint", "mine.yaml").out
