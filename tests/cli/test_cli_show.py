"""Commands about a scenario without training.

* `inspect`, `compile`, `run` and `bench`: commands about a scenario without training.
* `inspect` of robot files: tables, warnings, pictures.
* A quantity is shown in the unit in which the file writes it.
* `try --driver` and `try --start`, and the summary of `try` over many episodes.
* `deepbots test`: passing tests, the output of a failed test, and that tests change nothing else.
* `deepbots lsp --schema`: the JSON Schema for editors, in general and for one scenario.
"""

from __future__ import annotations

import json
import math
import re
import shlex
import struct
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from deepbots_cli import api
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.cli.throughput import note_faster_engine
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import shipped
from deepbots_cli.document.parse import parse
from deepbots_cli.insight.speed import EngineSpeeds, engine_speeds, measure
from deepbots_cli.learning.runs.draws import draw_labels, drawn_effects
from deepbots_cli.learning.runs.statistics import mean_interval, wilson
from deepbots_cli.learning.sb3 import defaults
from deepbots_cli.learning.scenario_tests import run_tests
from deepbots_cli.program import ZERO
from deepbots_cli.program.identity import digest
from deepbots_cli.rollout import Episode
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.panel import agent_rows, message_rows
from tests.commands import Deepbots, Ran
from tests.few import few

PLAIN = "train={algorithm: PPO, total_timesteps: 1000, network: {activation: relu}}"
COPIES = Path(__file__).parents[1] / "channel" / "copies.yaml"


def inspected(deepbots, *words):
    return json.loads(deepbots("inspect", "cartpole", "--json", *words).out)


def test_inspect_shows_units_ranges_and_what_was_written(deepbots):
    ran = deepbots("inspect", "cartpole", "--full")
    assert ran.err == ""
    for part in (
        "cart.pole_angle",
        "-20",
        "deg",
        "abs(cart.pole_angle) > fall_angle",
        "uniform(-1 .. 1 deg)",
        "n_steps",
    ):
        assert part in ran.out


def test_programs_get_every_table(deepbots):
    tables = inspected(deepbots)
    assert tables["scenario"]["digest"] == api.compile("cartpole").digest
    assert [row["name"] for row in tables["observation"]] == ["x", "speed", "cart.pole_angle", "tip_speed"]
    assert tables["observation"][1] | {"index": 1} == {
        "index": 1,
        "name": "speed",
        "low": -0.8,
        "high": 0.8,
        "unit": "m/s",
        "seen_as": "-1 .. 1",
    }
    assert [row["joint"] for row in tables["joints"]][-1] == "tip_mount"
    assert tables["reward"] == [{"term": "alive", "is": "1"}]
    assert {row["parameter"]: row["value"] for row in tables["parameters"]}["track"] == "0.39 m"


def test_inspect_shows_the_noise_of_a_measurement_and_of_the_goal(deepbots):
    goal = "goal={achieved: x, desired: 0.1 m, tolerance: 1 cm, range: -1 .. 1 m, noise: 1 %}"
    noisy = "augment.x={value: position(cart).x, noise: 2 mm}"
    tables = inspected(
        deepbots, "--set", noisy, "--set", goal, "--set", "reward={there: 1 when goal_reached}"
    )
    (x,) = (row for row in tables["signals"] if row["signal"] == "x")
    assert (x["is"], x["noise"], tables["goal"]["noise"]) == ("position(cart).x", "2 mm", "1 %")


def test_inspect_shows_the_mirror_image_and_the_sign_of_each_number(deepbots):
    rows = json.loads(deepbots("inspect", "biped", "--json").out)["mirror_images"]
    images = {(row["of"], row["name"]): (row["mirror_image"], row["sign"]) for row in rows}
    assert images["observation", "walker.q.left_hip_roll"] == ("walker.q.right_hip_roll", -1)
    assert images["observation", "walker.down.x"] == ("walker.down.x", 1)
    assert images["action", "stride.left_knee"] == ("stride.right_knee", 1)


def test_inspect_shows_the_mirror_images_of_options(deepbots):
    words = "train.symmetry={swap: {forward: backward}, flip: [x, '*speed', '*_angle']}"
    rows = inspected(deepbots, "--set", words)["mirror_images"]
    assert {"of": "action", "name": "drive.forward", "mirror_image": "drive.backward"} in rows


def test_inspect_shows_which_signals_the_policy_may_see(deepbots):
    rows = json.loads(deepbots("inspect", "find_ball", "--json").out)["signals"]
    visible = {row["signal"]: row["policy_may_see_it"] for row in rows}
    assert (visible["apart"], visible["angle"], visible["path"], visible["here"]) == (
        True,
        True,
        False,
        False,
    )


@pytest.mark.parametrize(
    ("format", "size"), [("struct", 12), ("msgpack", 15), ("csv", "varies"), ("json", "varies")]
)
def test_messages_have_a_size_where_it_is_fixed(deepbots, format, size):
    tables = inspected(deepbots, "--set", f"messages.format={format}")
    assert {row["bytes"] for row in tables["messages"]} == {size}
    assert {row["format"] for row in tables["messages"]} == {format}


@pytest.mark.parametrize("format", ["struct", "msgpack"])
def test_the_size_of_a_message_is_what_its_codec_makes(format):
    from deepbots_cli.insight.inspection import message_size
    from deepbots_cli.runtime.messages import codec

    program = api.compile("cartpole", overrides=[f"messages.format={format}"]).program
    for layout in (program.robots[0].to_robot, program.robots[0].from_robot):
        assert message_size(layout, format) == len(codec(layout, format).encode(*[0.5] * len(layout.fields)))


def test_inspect_prints_where_the_hand_of_an_arm_is_and_how_it_is_turned_at_the_start(deepbots):
    ran = deepbots("inspect", "panda_push", "--json")
    (pose,) = json.loads(ran.out)["poses"]
    assert (pose["robot"], pose["link"]) == ("panda", "panda_grasptarget")
    assert [pose["x_m"], pose["y_m"], pose["z_m"]] == pytest.approx([0.33, 0, 0.03], abs=1e-3)
    assert [abs(pose["roll_deg"]), pose["pitch_deg"], pose["yaw_deg"]] == pytest.approx([180, 0, 0], abs=0.1)


def test_without_sensors_and_hands_the_end_that_the_reset_sets_has_a_pose(deepbots):
    (pose,) = inspected(deepbots)["poses"]
    assert (pose["robot"], pose["link"]) == ("cart", "tip")
    assert abs(pose["pitch_deg"]) < 1.0


def test_a_world_that_cannot_begin_is_inspected_without_poses(deepbots):
    ran = deepbots("inspect", "cartpole", "--json", "--set", "termination.failure.fallen=age(cart) < 1 s")
    assert "poses" not in json.loads(ran.out)
    assert "the table of poses is missing" in ran.err


def test_without_messages_there_is_no_table_of_messages(deepbots):
    assert not {"messages", "message_fields"} & inspected(deepbots, "--set", "messages.format=none").keys()


def test_immediate_actions_act_at_once_and_every_observation_is_fresh(deepbots):
    timing = inspected(deepbots)["timing"]
    assert {row["age_s"] for row in timing} == {0}
    assert [row["physics_step"] for row in timing] == ["4n + 1"] + ["4n + 4"] * 4


def test_paper_timing_ages_actions_and_messages_by_a_tick_but_not_what_the_supervisor_adds(deepbots):
    timing = {row["name"]: row for row in inspected(deepbots, "--set", "messages.timing=delayed")["timing"]}
    assert (timing["drive"]["physics_step"], timing["drive"]["age_s"]) == ("4n + 5", 0.032)
    assert (timing["cart.pole_angle"]["physics_step"], timing["cart.pole_angle"]["age_s"]) == ("4n", 0.032)
    assert (timing["x"]["physics_step"], timing["x"]["age_s"]) == ("4n + 4", 0)


def test_a_picture_of_the_world_is_a_png_with_something_in_it(deepbots, tmp_path):
    assert deepbots("render", "cartpole", "-o", "world.png").out == "world.png\n"
    with Image.open(tmp_path / "world.png") as image:
        assert image.size == (640, 480)
        assert len(set(image.tobytes())) > 20


def test_compile_prints_what_runs(deepbots, tmp_path):
    compiled = api.compile("cartpole")
    assert deepbots("compile", "cartpole").out == compiled.code
    assert deepbots("compile", "cartpole", "-o", "e.py").out == ""
    assert (tmp_path / "e.py").read_text() == compiled.code
    assert json.loads(deepbots("compile", "cartpole", "--program").out)["name"] == "CartPole"
    assert json.loads(deepbots("compile", "cartpole", "--json").out)["digest"] == compiled.digest
    deepbots("compile", "cartpole", "--json", "--program", code=2)


def test_run_shows_returns_endings_and_terms(deepbots):
    ran = deepbots("try", "cartpole", "--episodes", "2")
    assert "fallen" in ran.out
    assert "alive" in ran.out
    assert "ended_by" in ran.out


def test_the_start_of_an_episode_of_run_can_be_given_back(deepbots):
    words = [
        "try",
        "cartpole",
        "--set",
        "reset.joints.cart.pole_hinge=uniform(-3 .. 3 deg)",
        "--driver",
        "zero",
        "--episodes",
        "2",
        "--json",
    ]
    _, second = json.loads(deepbots(*words).out)["episodes"]
    ((name, value),) = second["drawn"].items()
    first, _ = json.loads(deepbots(*words, "--start", f"{name}={value!r}").out)["episodes"]
    assert first == second


def test_the_same_seed_runs_the_same_episodes(deepbots):
    first, again, another_seed = (
        deepbots("try", "cartpole", "--seed", seed, "--json").out for seed in (3, 3, 4)
    )
    assert first == again != another_seed
    episode = json.loads(first)["episodes"][0]
    assert episode["return"] == episode["length"] == episode["reward_terms"]["alive"]


def test_copies_of_a_robot_all_take_the_actions_of_the_command_line(deepbots):
    deepbots("try", str(COPIES), "--driver", "forward,backward", "--engine", "exact", "--episodes", "1")


def test_actions_go_by_name_or_number(deepbots):
    named, numbered, other = (
        json.loads(deepbots("try", "cartpole", "--driver", actions, "--json").out)["episodes"]
        for actions in ("forward, backward", "0,1", "0")
    )
    assert named == numbered
    assert named != other


def test_a_limit_of_steps_cuts_the_episode_and_says_so(deepbots):
    episodes = json.loads(deepbots("try", "cartpole", "--steps", "5", "--json").out)["episodes"]
    assert [(row["length"], row["ended_by"]) for row in episodes] == [(5, "--steps")]


def test_ranges_are_acted_on_by_numbers_from_minus_one_to_one(deepbots):
    continuous = ["--set", "action.drive=-1 .. 1", "--steps", "3"]
    deepbots("try", "cartpole", "--driver=0.5,-1", *continuous)
    deepbots("try", "cartpole", "--driver", "zero", *continuous)
    assert "-1 to 1" in deepbots("try", "cartpole", "--driver", "1.5", *continuous, code=2).err


def test_bench_compares_a_step_with_bare_physics(deepbots):
    bench = ("bench", "cartpole", "--engine", "mujoco", "--steps", "100", "--pairs", "1")
    figures = json.loads(deepbots(*bench, "--json").out)
    assert figures["steps"] == 100
    assert figures["step_us"] > 0
    assert figures["bare_us"] > 0
    assert figures["ratio"] > 0
    output = deepbots(*bench).out
    assert "ratio" in output
    assert "mujoco steps" not in output  # an engine that is named is not compared with others


def test_latencies_age_actions_and_observations_and_draws_make_that_vary(deepbots):
    sections = inspected(
        deepbots, "--set", "messages.to_robot={latency: 40 ms}", "--set", "messages.from_robot={loss: 5 %}"
    )
    timing = {row["name"]: row for row in sections["timing"]}
    assert (timing["drive"]["physics_step"], timing["drive"]["age_s"]) == ("4n + 9", 0.064)
    assert timing["cart.pole_angle"]["physics_step"] == "varies"
    assert timing["cart.pole_angle"]["age_s"] is None
    assert [(row["direction"], row["latency"], row["loss"]) for row in sections["routes"]] == [
        ("to robot", "40 ms", ""),
        ("from robot", "", "5 %"),
    ]


def test_what_is_previous_is_one_tick_old_and_what_a_sensor_delays_as_old_as_that(deepbots, tmp_path):
    scenario = tmp_path / "aged.yaml"
    scenario.write_text(
        """\
deepbots: 1
extends: cartpole.yaml
augment:
  was:    previous(position(cart).xy)
  before: previous(was)
  gone:   delta(x)
observation: {was: -1 .. 1 m, before: -1 .. 1 m, gone: -1 .. 1 m}
robots: {cart: {sensors: {pole_angle: {latency: 40 ms}}}}
"""
    )
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    timing = {
        row["name"]: row for row in json.loads(deepbots("inspect", "aged.yaml", "--json").out)["timing"]
    }
    ages = {name: timing[name]["age_s"] for name in ("x", "was.x", "before.y", "gone", "cart.pole_angle")}
    assert ages == {"x": 0, "was.x": 0.032, "before.y": 0.064, "gone": 0, "cart.pole_angle": 0.064}
    assert (timing["was.x"]["physics_step"], timing["cart.pole_angle"]["by"]) == ("4n", "cart")


def test_drawn_masses_and_frictions_are_shown_as_draws(deepbots):
    sections = inspected(
        deepbots,
        "--set",
        "objects.puck={shape: sphere, radius: 2 cm, mass: uniform(0.1 .. 300 g) * 2, friction: uniform(0.4"
        " .. 0.8)}",
        "--set",
        "reset.place={puck: {x: 0.3 m}}",
        "--set",
        "robots.cart.links={pole: {mass: urdf * uniform(80 % .. 120 %)}}",
    )
    assert sections["objects"][0]["mass_kg"] == "uniform(0.0001 .. 0.3) * 2"
    assert sections["objects"][0]["friction"] == "uniform(0.4 .. 0.8)"
    assert {"drawn": "mass", "of": "cart.pole"}.items() <= sections["drawn"][0].items()
    assert "uniform(0.8 .. 1.2)" in sections["drawn"][0]["from"]


def test_a_value_on_several_lines_is_shown_as_a_mapping_on_one(deepbots, tmp_path):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    scenario = tmp_path / "cartpole.yaml"
    start = "\nreset:\n"
    assert start in scenario.read_text()
    scenario.write_text(
        scenario.read_text().replace(
            start, f"{start}  place:\n    cart:\n      x: 0 m  # the middle\n      z: 0.04 m\n"
        )
    )
    rows = json.loads(deepbots("inspect", "cartpole.yaml", "--json").out)["reset"]
    assert rows[0] == {"reset": "place", "of": "cart", "to": "{x: 0 m, z: 0.04 m}"}


def test_held_actions_are_counted_in_the_steps_of_the_agent(deepbots):
    timing = {row["name"]: row for row in inspected(deepbots, "--set", "agent={action_repeat: 3}")["timing"]}
    assert (timing["drive"]["physics_step"], timing["x"]["physics_step"]) == ("12n + 1", "12n + 12")


def test_inspect_shows_the_stages_of_the_curriculum_and_one_of_them(deepbots):
    stages = json.loads(deepbots("inspect", "find_ball_random", "--json").out)["curriculum"]
    assert [row["stage"] for row in stages] == ["open", "few", "crowded"]
    assert stages[1]["set"] == "{obstacles: integer(1 .. 3)}"
    assert stages[1]["until"] == "success_rate >= 0.7 over 40 episodes"
    tables = json.loads(deepbots("inspect", "find_ball_random", "--stage", "few", "--json").out)
    assert {row["parameter"]: row["value"] for row in tables["parameters"]}["obstacles"] == "integer(1 .. 3)"
    assert len(tables["objects"]) == 1 + 3


def test_a_stage_of_the_curriculum_can_be_run(deepbots):
    lonely = json.loads(
        deepbots(
            "try", "find_ball_random", "--stage", "open", "--episodes", "1", "--steps", "100", "--json"
        ).out
    )
    assert (lonely["stage"], lonely["episodes"][0]["reward_terms"]["scrape"]) == ("open", 0)


def test_inspect_shows_every_hyperparameter_with_its_source(deepbots):
    rows = {
        row["hyperparameter"]: (row["value"], row["from"]) for row in inspected(deepbots)["hyperparameters"]
    }
    assert (rows["n_steps"], rows["clip_range"]) == ((64, "scenario"), (0.2, "Stable-Baselines3"))
    rows = {
        row["hyperparameter"]: (row["value"], row["from"])
        for row in inspected(deepbots, "--set", PLAIN)["hyperparameters"]
    }
    assert (rows["n_steps"], rows["network.hidden"]) == ((256, "deepbots"), ([64, 64], "deepbots"))
    assert rows["network.activation"] == ("relu", "scenario")


def test_without_the_library_its_defaults_are_called_so(deepbots, monkeypatch):
    monkeypatch.setattr(defaults, "library_defaults", lambda algorithm: None)
    rows = {row["hyperparameter"]: row for row in inspected(deepbots)["hyperparameters"]}
    assert rows["clip_range"] == {"hyperparameter": "clip_range", "value": None, "from": "library default"}


@pytest.mark.parametrize(
    ("written", "meant"),
    [("1e1", 10), ("2_0", 20), pytest.param("1k", 1000, marks=pytest.mark.slow), ("1.5e2", 150)],
)
def test_whole_numbers_may_be_written_short(deepbots, written, meant):
    ran = deepbots(
        "try",
        "cartpole",
        "--set",
        "truncation={max_steps: 1000}",
        "--episodes",
        "1000",
        "--steps",
        written,
        "--json",
    )
    assert sum(episode["length"] for episode in json.loads(ran.out)["episodes"]) == meant


@pytest.mark.slow
def test_the_engine_that_steps_a_world_fastest_is_named_with_its_ratio(deepbots):
    pytest.importorskip("pybullet")
    speeds = r"\([\d,]+ against [\d,]+ steps/s\)"
    line = (
        rf"mujoco steps this world (\d+\.\d) times as fast as pybullet {speeds}\. To use it, add the line"
        r" `engine: mujoco`"
    )
    output = deepbots("bench", "cartpole", "--steps", "100", "--pairs", "1").out
    assert re.search(line, output)
    assert "Motion and results may differ; `deepbots transfer RUN` shows how much." in output
    faster = json.loads(deepbots("bench", "cartpole", "--steps", "100", "--pairs", "1", "--json").out)[
        "faster_engine"
    ]
    assert (faster["engine"], faster["used"]) == ("mujoco", "pybullet")
    assert faster["steps_per_second"] > 1.5 * faster["used_steps_per_second"]


def test_the_faster_engine_is_named_where_it_saves_half_a_minute_and_none_is_chosen(capfd):
    pytest.importorskip("pybullet")
    cartpole = api.compile("cartpole").program
    chosen = api.compile("cartpole", overrides=["world.engine=pybullet"]).program
    note_faster_engine(cartpole, 10_000_000)
    assert "note: mujoco steps this world" in capfd.readouterr().err
    note_faster_engine(cartpole, 600)
    note_faster_engine(cartpole, 20_000)
    note_faster_engine(chosen, 10_000_000)
    assert "mujoco" not in capfd.readouterr().err


def test_an_engine_that_is_little_faster_is_not_named():
    assert EngineSpeeds({"pybullet": [100.0], "mujoco": [149.0]}).faster_than("pybullet") is None
    assert EngineSpeeds({"pybullet": [100.0], "mujoco": [150.0]}).faster_than("pybullet").ratio == 1.5


def test_a_window_that_another_program_disturbed_does_not_choose_the_engine():
    """On a busy machine, one window of each engine named the wrong one."""
    speeds = EngineSpeeds({"pybullet": (50.0, 100.0, 95.0), "mujoco": (110.0, 60.0, 105.0)})
    assert (speeds.best, speeds.spread) == ({"pybullet": 100.0, "mujoco": 110.0}, pytest.approx(1.0))
    assert speeds.faster_than("pybullet") is None
    busy = EngineSpeeds({"pybullet": [100.0, 50.0], "mujoco": [300.0, 290.0]}).faster_than("pybullet")
    assert busy.text.endswith(
        "Measurements of one engine differ by 100%, as on a busy machine: repeat them when it is idle."
    )
    idle = EngineSpeeds({"pybullet": [100.0, 95.0], "mujoco": [300.0, 290.0]}).faster_than("pybullet")
    assert "busy" not in idle.text


def test_an_engine_that_cannot_build_the_world_is_not_compared(tmp_path):
    pytest.importorskip("pybullet")
    (tmp_path / "ground.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "hills.yaml").write_text(
        "deepbots: 1\nextends: cartpole\nname: Hills\nworld: {terrain: {type: mesh, file: ground.obj}}\n"
    )
    program = api.compile(tmp_path / "hills.yaml").program
    assert list(engine_speeds(program, "pybullet", seconds=0.001).windows) == ["pybullet"]


def test_a_bench_measures_no_more_rounds_than_fit_into_its_time():
    (rounds,) = measure(api.compile("cartpole"), ["mujoco"], steps=20, rounds=5, seed=0, end=0.0)
    assert len(rounds) == 1


@pytest.mark.slow
def test_a_quick_bench_measures_less(deepbots):
    quick = ("bench", "cartpole", "--engine", "mujoco", "--quick", "--steps", "100", "--json")
    figures = json.loads(deepbots(*quick, "--pairs", "1").out)
    assert ((figures["steps"], figures["pairs"]), json.loads(deepbots(*quick).out)["pairs"]) == ((100, 1), 3)


def test_bench_reports_its_progress():
    progress = []
    measure(
        api.compile("cartpole"),
        ["mujoco"],
        steps=20,
        rounds=2,
        seed=0,
        end=math.inf,
        on_measured=lambda *at: progress.append(at),
    )
    assert progress == [(0, 2), (1, 2), (2, 2)]


def test_a_project_names_a_clone_and_no_index(deepbots, tmp_path):
    deepbots("compile", "cartpole", "--project", "mine")
    text = (tmp_path / "mine" / "requirements.txt").read_text()
    assert "==" not in text
    assert "deepbots-cli[train] @ file:///" in text


BROKEN = '<robot name="r"><link name="a"/><link name="a"/></robot>'
ODD = """<robot name="odd"><link name="base"><collision><geometry><box size="2 1 0.5"/></geometry></collision></link>
<link name="arm"><inertial><mass value="3"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""


def test_a_robot_file_is_shown_in_tables(deepbots):
    tables = json.loads(deepbots("inspect", "epuck", "--json").out)
    assert tables["robot"]["mass_kg"] == pytest.approx(0.162)
    assert tables["robot"]["size_m"] == pytest.approx([0.076, 0.074, 0.05], abs=2e-3)
    assert [row["link"] for row in tables["links"]] == [
        "base_link",
        "left_wheel",
        "right_wheel",
        "caster_front",
        "caster_rear",
    ]
    assert tables["links"][1]["collides_as"] == ["cylinder r 0.02 l 0.004"]
    assert {row["joint"]: row["type"] for row in tables["joints"]}["caster_front_mount"] == "fixed"
    assert "findings" not in tables


def test_a_warning_about_a_robot_file_is_printed_with_its_place(deepbots, tmp_path):
    file = tmp_path / "odd.urdf"
    file.write_text(ODD, encoding="utf-8")
    ran = deepbots("inspect", str(file))
    assert "box 2 1 0.5" in ran.out
    assert "DB305" in ran.err
    assert "odd.urdf:1:31" in ran.err
    findings = json.loads(deepbots("inspect", str(file), "--json").out)["findings"]
    assert [row["code"] for row in findings] == ["DB305"]


def test_warnings_about_a_file_of_a_package_are_one_line(deepbots):
    pytest.importorskip("pybullet_data")
    robot = "package://pybullet_data/laikago/laikago.urdf"
    assert deepbots("inspect", robot).err == (
        "1 warning about a file of a package, which you cannot change (1 DB306); --json lists them\n"
    )
    assert len(json.loads(deepbots("inspect", robot, "--json").out)["findings"]) == 1


def test_a_robot_file_that_cannot_be_read_is_an_error(deepbots, tmp_path):
    file = tmp_path / "broken.urdf"
    file.write_text(BROKEN, encoding="utf-8")
    assert "DB301" in deepbots("inspect", str(file), code=1).err


@pytest.mark.parametrize(
    "name", ["none.urdf", "package://pybullet_data/none.urdf", "package://no_such_package/x.urdf"]
)
def test_a_robot_file_that_is_not_there_is_one_line_that_lists_the_shipped_ones(deepbots, name):
    assert "cartpole_rail, epuck" in deepbots("inspect", name, code=2).err


HUSKY = "package://pybullet_data/husky/husky.urdf"


@pytest.mark.parametrize(
    "name", few([*(n for n in shipped.robot_names() if n != "cartpole"), HUSKY], ("epuck", HUSKY))
)
def test_a_robot_is_drawn_so_that_it_fills_the_picture(deepbots, tmp_path, name):
    deepbots("render", str(shipped.robot_path(name) or name), "-o", str(tmp_path / "robot.png"))
    assert struct.unpack(">II", (tmp_path / "robot.png").read_bytes()[16:24]) == (640, 480)


def test_a_scenario_goes_before_a_robot_of_the_same_name(deepbots):
    assert "scenario" in json.loads(deepbots("inspect", "cartpole", "--json").out)


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
    assert (units.of_entry("tilt", "rad").text, units.of_entry("heading", "rad").text) == ("rad", "rad")
    assert (units.of("rad/s").text, ShownUnits().of("rad/s").text) == ("rad/s", "deg/s")


BASE = Path(__file__).parents[1] / "golden" / "lint" / "cartpole.yaml"
SCRIPTED = """\
deepbots: 1
extends: cartpole.yaml
name: Scripted
scripts:
  onward: {drive: forward}
  catch: {drive: {forward: cart.pole_angle > 0 rad, backward: true}}
evaluation: {cases: {back: {set: {scripts.onward.drive: backward}}}}
reward: {far: 300 when far}
termination: {success: {far: x > 0.1 m}}
"""


@pytest.fixture
def scripted(tmp_path):
    (tmp_path / "cartpole.yaml").write_bytes(BASE.read_bytes())
    (tmp_path / "scripted.yaml").write_text(SCRIPTED)
    return "scripted.yaml"


def report_of(deepbots, *words):
    return json.loads(deepbots("try", *words, "--json").out)


def test_a_script_drives_every_episode(deepbots, scripted):
    onward = report_of(deepbots, scripted, "--driver", "onward")
    assert onward["driver"] == "onward"
    assert onward["episodes"] == report_of(deepbots, scripted, "--driver", "forward")["episodes"]
    assert onward["episodes"] != report_of(deepbots, scripted, "--driver", "catch")["episodes"]


def test_a_script_may_be_another_in_a_case(deepbots, scripted):
    words = (scripted, "--case", "back")
    assert (
        report_of(deepbots, *words, "--driver", "onward")["episodes"]
        == report_of(deepbots, *words, "--driver", "backward")["episodes"]
    )


def test_actions_are_repeated_and_may_be_those_of_a_script(deepbots, scripted):
    once = report_of(deepbots, scripted, "--driver", "forward,forward,forward,backward")["episodes"]
    assert report_of(deepbots, scripted, "--driver", "onward*3,backward*1")["episodes"] == once
    assert report_of(deepbots, scripted, "--driver", "forward*3,backward")["episodes"] == once


KNOWN = "the drivers are onward, catch, random, zero, and actions such as forward,backward\n"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cach", f"error: there is no driver 'cach' (did you mean catch?); {KNOWN}"),
        ("best", f"error: there is no driver 'best'; {KNOWN}"),
        ("foward,backward", "error: 'drive' has no option 'foward'; its options are: forward, backward\n"),
        (
            "onward*x",
            "error: 'onward*x' is not valid; write the number of steps after the asterisk, such as"
            " onward*8\n",
        ),
        (
            "catch*0",
            "error: 'catch*0' is not valid; write the number of steps after the asterisk, such as catch*8\n",
        ),
        (
            "policy",
            "error: only a run has a policy; train one with `deepbots train`, and name the run instead of"
            " the scenario\n",
        ),
        ("you", "error: you can drive in the browser only; use `deepbots play`\n"),
    ],
)
def test_a_driver_that_cannot_act_is_refused_with_those_that_can(deepbots, scripted, name, message):
    assert deepbots("try", scripted, "--driver", name, code=2).err.endswith(message)


def test_a_scenario_without_scripts_says_so(deepbots):
    result = deepbots("try", "cartpole", "--driver", "catch", code=2)
    assert (
        result.err == "error: there is no driver 'catch'; the drivers are random, zero, and actions such as"
        " forward,backward\n"
    )


def test_few_episodes_are_shown_one_by_one_and_summed_up(deepbots, scripted):
    result = deepbots("try", scripted, "--driver", "onward", "--episodes", "20")
    assert result.out.startswith(
        "13 of 20 episodes succeeded, mean return 316.00, ended by far 13, fallen 7\n\n"
    )
    assert "summary of 20 episodes" in result.out
    assert "\n       19 " in result.out
    assert "more" not in result.out
    assert result.err == ""
    assert "summary" not in deepbots("try", scripted, "--episodes", "1").out


def test_of_many_episodes_the_first_are_shown_and_all_are_counted(deepbots, scripted):
    words = ("try", scripted, "--driver", "onward", "--episodes", "21")
    ran = deepbots(*words)
    assert "\n        4 " in ran.out
    assert "\n        5 " not in ran.out
    assert "\n  and 16 more\n" in ran.out
    assert "of 21 episodes\n" in ran.err
    assert len(json.loads(deepbots(*words, "--json").out)["episodes"]) == 21


def test_the_summary_is_that_of_the_episodes_with_intervals(deepbots, scripted):
    data = report_of(deepbots, scripted, "--driver", "random", "--episodes", "8")
    summary = data["summary"]
    returns = [episode["return"] for episode in data["episodes"]]
    successes = sum(episode["success"] for episode in data["episodes"])
    assert summary["success_defined"] is True
    assert (summary["episodes"], summary["mean_return"]) == (8, pytest.approx(sum(returns) / 8))
    assert summary["return_interval"] == pytest.approx(list(mean_interval(returns)))
    assert summary["successes"] == successes
    assert summary["success_interval"] == pytest.approx(list(wilson(successes, 8)))
    assert sum(summary["endings"].values()) == 8
    assert {episode["ended_by"] for episode in data["episodes"]} == set(summary["endings"])


def test_a_success_that_the_scenario_does_not_know_is_not_counted(deepbots):
    assert "success rate" not in deepbots("try", "cartpole", "--episodes", "2").out
    assert report_of(deepbots, "cartpole", "--episodes", "2")["summary"]["success_defined"] is False


def test_a_limit_of_steps_holds_for_all_episodes_of_a_script(deepbots, scripted):
    data = report_of(deepbots, scripted, "--driver", "catch", "--episodes", "50", "--steps", "30")
    assert sum(episode["length"] for episode in data["episodes"]) == 30
    assert data["episodes"][-1]["ended_by"] == "--steps"


def test_inspect_shows_the_action_of_each_script(deepbots, scripted):
    assert json.loads(deepbots("inspect", scripted, "--json").out)["scripts"] == [
        {"script": "onward", "action": "drive", "is": "forward"},
        {"script": "catch", "action": "drive", "is": "{forward: cart.pole_angle > 0 rad, backward: true}"},
    ]
    assert "onward" in deepbots("inspect", scripted, "--full").out


def test_compile_prints_a_method_for_each_script(deepbots, scripted):
    code = deepbots("compile", scripted).out
    assert code == api.compile(scripted).code
    assert "    def script_catch(self) -> Any:\n" in code
    assert "        if cart_pole_angle > 0.0:\n            drive_pick = 0  # forward\n" in code


def test_a_start_is_set_on_the_command_line(deepbots, scripted):
    words = (scripted, "--driver", "onward", "--episodes", "2")
    upright = report_of(deepbots, *words, "--start", "reset.joints.cart.pole_hinge=0.01")
    assert upright["start"] == {"reset.joints.cart.pole_hinge": 0.01}
    first, second = upright["episodes"]
    assert first == second


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ("pole=0.01", "cannot set 'pole': "),
        ("reset.joints.cart.pole_hinge=far", "it is a single number"),
        ("reset.joints.cart.pole_hinge=nan", "it is not finite"),
        (
            "mark=[0.01,0.05]",
            "separate the numbers by commas, without spaces or brackets: --start mark=0.01,0.05",
        ),
        ("reset.joints.cart.pole_hinge", "write NAME=VALUE, such as --start mark.x=0.5"),
    ],
)
def test_a_start_that_no_episode_has_ends_in_one_line(deepbots, scripted, start, message):
    result = deepbots("try", scripted, "--start", start, code=2)
    assert message in result.err
    assert len(result.err.strip().splitlines()) == 1


# The exact engine moves the cart by 0.4 mm in a step at full drive.
WORLD = """\
deepbots: 1
name: Small
parameters: {start: uniform(-1 .. 1 m), edge: 3 mm}
world: {timestep: 20 ms, substeps: 4}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors: {place: {type: joint_position, joint: slider}}
    actuators: {motor: {type: velocity_motor, joint: slider, max_torque: 10 N}}
    emit: [place]
    apply: {motor: drive * 0.02 m/s}
augment: {driven: cart.place - start}
observation: {cart.place: -2.4 .. 2.4 m, driven: auto}
action: {drive: -1 .. 1}
reward: {pay: 2}
termination:
  success: {there: driven > edge}
  failure: {back: driven < -3 mm}
truncation: {max_steps: 50}
reset: {joints: {cart.slider: start}}
scripts:
  onward: {drive: 1}
  homeward: {drive: -1}
  uncertain: {drive: "1 if start > 0 m else -1"}
evaluation: {cases: {near: {set: {edge: 1 mm}}}}
curriculum: [{name: far, set: {edge: 10 mm}, until: 100 steps}, {name: usual}]
"""


@pytest.fixture
def small(deepbots: Deepbots, tmp_path: Path):
    """Writes that world with tests, and runs them on the exact engine."""

    def run(tests: str, *words: object, world: str = WORLD) -> Ran:
        (tmp_path / "small.yaml").write_text(f"{world}tests:\n{tests}")
        return deepbots("test", "small.yaml", "--engine", "exact", *words, code=None)

    return run


@pytest.mark.parametrize(
    "test",
    [
        "{driver: onward, episodes: 3, expect: {success_rate: 100 %, failure_rate: 0 .. 0, ends_by: there,"
        " mean_return: 16 .. 16}}",
        "{driver: homeward, expect: {ends_by: [there, back], failure_rate: 100 %, eventually: back and time"
        " < 0.2 s}}",
        "{driver: zero, expect: {ends_by: max_steps, mean_return: 100, always: abs(driven) < 0.01 mm}}",
        "{driver: zero, max_time: 0.1 s, expect: {mean_return: 10 .. 10}}",
        "{driver: random, max_steps: 3, expect: {mean_return: 6, always: [abs(driven) < 1.3 mm,"
        " previous_reward == 2]}}",
        "{actions: [1, {drive: 1}, -1, 0.5], expect: {mean_return: 8 .. 8, eventually: driven > 0.7 mm,"
        " always: driven < 0.9 mm}}",
        "{driver: onward, case: near, expect: {mean_return: 6 .. 6, always: edge < 2 mm}}",
        "{driver: onward, stage: far, expect: {mean_return: 52 .. 52, eventually: driven > 9 mm}}",
        "{driver: uncertain, episodes: 20, expect: {success_rate: 20 .. 80 %, ends_by: [there, back]}}",
    ],
)
def test_an_expectation_that_is_met_passes(small, test: str) -> None:
    ran = small(f"  one: {test}\n")
    assert ran.code == 0, ran.out
    assert "1 passed in" in ran.out


@pytest.mark.parametrize(
    ("expect", "measured"),
    [
        ("always: driven < 2.1 mm", "; seed 0, episode 0, step 6 (0.12 s)"),
        ("always: cart.place - start < 2.1 mm", "cart.place - start is 0.0023"),
        ("eventually: driven < -1 mm", "never in 8 steps (0.16 s); at the end, driven is 0.00"),
        ("ends_by: back", "ended by `there` after 8 steps (0.16 s); in 2 of 2 episodes; seed 0, episode 0"),
        ("ends_by: max_steps", "ended by `there` after 8 steps"),
        ("failure_rate: 50 %", "0 of 2 episodes (0 %)"),
        ("success_rate: 0 .. 0.5", "2 of 2 episodes (100 %)"),
        ("mean_return: 17 .. 20", "16 over 2 episodes, the lowest is 16; seed 0, episode 0"),
    ],
)
def test_a_failed_test_shows_what_was_expected_and_measured(small, expect: str, measured: str) -> None:
    ran = small(f"  one: {{driver: onward, episodes: 2, expect: {{{expect}}}}}\n")
    assert ran.code == 1
    place = WORLD.count("\n") + 2
    assert "FAILED one" in ran.out
    assert f"expected  {expect} (small.yaml:{place}:" in ran.out
    assert measured in ran.out


def test_expectations_are_listed_as_they_are_missed(small) -> None:
    expect = '{always: ["driven < -1 m", "time < 0 s"], mean_return: 1000 .. 2000}'
    ran = small(f"  one: {{driver: onward, episodes: 2, expect: {expect}}}\n", "--json")
    misses = json.loads(ran.out)["scenarios"][0]["tests"][0]["misses"]
    assert [miss["expected"].split(" (")[0] for miss in misses] == [
        "always: driven < -1 m",
        "always: time < 0 s",
        "mean_return: 1000 .. 2000",
    ]


def test_the_command_of_a_failed_test_shows_its_episode(small, deepbots: Deepbots) -> None:
    """`view` begins an episode as the evaluation does; a sequence of actions is for `run`."""
    ran = small(
        "  one: {driver: uncertain, episodes: 9, seed: 4, case: near, expect: {ends_by: there}}\n", "--json"
    )
    (miss,) = json.loads(ran.out)["scenarios"][0]["tests"][0]["misses"]
    assert miss["command"] == (
        "deepbots view small.yaml --case near --engine exact --driver uncertain --seed 4 --episode"
        f" {miss['episode']}"
    )
    with closing(api.make("small.yaml", engine="exact")) as environment:
        starts = [
            environment.reset(seed=derive_seed(4, "evaluation", k))[1]["drawn"]["start"] for k in range(9)
        ]
    assert starts[miss["episode"]] < 0
    assert all(start > 0 for start in starts[: miss["episode"]])

    ran = small("  one: {actions: [0.5, -1, 1], episodes: 2, expect: {always: driven > -0.1 mm}}\n", "--json")
    (miss,) = json.loads(ran.out)["scenarios"][0]["tests"][0]["misses"]
    assert (miss["step"], miss["episode"]) == (2, 0)
    repeated = json.loads(deepbots(*shlex.split(miss["command"])[1:], "--json").out)
    assert [(episode["length"], episode["return"]) for episode in repeated["episodes"]] == [(3, 6.0)]


def test_an_episode_that_breaks_off_fails_its_test_alone(small) -> None:
    world = WORLD.replace("reward: {pay: 2}", "reward: {pay: 1 / (step - 3)}")
    tests = (
        "  one: {driver: zero, expect: {ends_by: max_steps}}\n  two: {driver: zero, max_steps: 2,"
        " expect: {mean_return: -2}}\n"
    )
    ran = small(tests, world=world)
    assert ran.code == 1
    assert "1 passed, 1 failed" in ran.out
    assert "step 3: no value for" in ran.out


def test_a_test_with_a_warning_runs(small) -> None:
    ran = small("  one: {driver: zero, max_steps: 2, expect: {always: step < 10 ^ 400}}\n", "--json")
    assert [test["test"] for test in json.loads(ran.out)["scenarios"][0]["tests"]] == ["one"]
    assert "see: deepbots lint small.yaml" in ran.err


def test_junit_that_cannot_be_written_is_reported_before_a_test_runs(small, tmp_path: Path) -> None:
    ran = small("  one: {driver: zero, expect: {ends_by: max_steps}}\n", "--junit", tmp_path)
    assert (ran.code, ran.out) == (2, "")
    assert "it is a directory" in ran.err


def test_k_selects_tests_by_a_part_of_their_names(small) -> None:
    tests = (
        "  drives: {driver: onward, expect: {ends_by: back}}\n  rests: {driver: zero, expect: {ends_by:"
        " max_steps}}\n"
    )
    assert (small(tests).code, small(tests, "-k", "rest").code) == (1, 0)
    nothing = small(tests, "-k", "sleeps")
    assert nothing.code == 2
    assert "there is no test whose name contains 'sleeps' in small.yaml" in nothing.err


def test_junit_has_a_suite_for_each_scenario_and_a_case_for_each_test(
    small, deepbots: Deepbots, tmp_path: Path
) -> None:
    tests = (
        "  drives: {driver: onward, expect: {ends_by: back}}\n  rests: {driver: zero, expect: {ends_by:"
        " max_steps}}\n"
    )
    assert small(tests, "--junit", "one.xml").code == 1
    suite = ElementTree.parse(tmp_path / "one.xml").getroot()
    assert (suite.tag, suite.attrib["tests"], suite.attrib["failures"]) == ("testsuite", "2", "1")
    assert [(case.attrib["name"], case.find("failure") is None) for case in suite] == [
        ("drives", False),
        ("rests", True),
    ]

    (tmp_path / "broken.yaml").write_text(
        "deepbots: 1\nextends: small.yaml\ntests: {one: {driver: nobody, expect: {mean_return: 1}}}\n"
    )
    ran = deepbots("test", ".", "--engine", "exact", "--junit", "both.xml", code=1)
    assert "there is no script `nobody`" in ran.err
    assert "1 passed, 1 failed, 1 scenario with errors" in ran.out
    suites = ElementTree.parse(tmp_path / "both.xml").getroot()
    assert [suite.attrib["name"] for suite in suites] == [
        "deepbots test broken.yaml",
        "deepbots test small.yaml",
    ]


def test_tests_change_neither_the_scenario_nor_one_that_extends_it(small, tmp_path: Path) -> None:
    small("  one: {driver: onward, expect: {ends_by: there, always: driven < 1 m}}\n")
    (tmp_path / "plain.yaml").write_text(WORLD)
    (tmp_path / "other.yaml").write_text(
        "deepbots: 1\nextends: small.yaml\nname: Other\nremove: [scripts.onward]\n"
    )
    tested, plain, extending = (
        api.compile(api.load(tmp_path / name)) for name in ("small.yaml", "plain.yaml", "other.yaml")
    )
    assert (tested.digest, tested.code, digest(tested.program)) == (plain.digest, plain.code, plain.digest)
    assert api.load(tmp_path / "small.yaml").tests
    assert api.load(tmp_path / "other.yaml").tests == ()
    assert [finding.code for finding in extending.findings] == [finding.code for finding in plain.findings]


def test_an_assignment_leaves_tests_out_except_of_a_test(small, deepbots: Deepbots) -> None:
    """`--set` may take away what a test names; `test --set` asks for the tests under this setting."""
    assert small("  one: {driver: onward, expect: {ends_by: there}}\n", "--set", "edge=40mm").code == 1
    deepbots("try", "small.yaml", "--engine", "exact", "--set", "scripts={rest: {drive: 0}}", "--steps", "2")


def test_a_condition_holds_only_if_it_holds_for_every_copy(tmp_path: Path) -> None:
    (tmp_path / "team.yaml").write_text(
        f"deepbots: 1\nextends: {shipped.scenario_path('multi_cartpole')}\n"
        "reset: {place: {cart: {x: uniform(-5 .. 5 cm), z: 0.04 m}}}\n"
        "tests:\n"
        "  some: {driver: zero, max_steps: 2, expect: {always: x > 0 m}}\n"
        "  all: {driver: zero, max_steps: 2, expect: {always: abs(x) < 10 cm}}\n"
    )
    checked = api.load(tmp_path / "team.yaml")
    assert checked.program is not None
    assert [result.passed for result in run_tests(checked.program, checked.tests)] == [False, True]


@pytest.mark.parametrize("name", few(shipped.scenario_names(), ("cartpole", "quadrotor", "panda_reach")))
def test_the_tests_of_a_shipped_scenario_pass(deepbots: Deepbots, name: str) -> None:
    deepbots("test", name)
    assert len(api.load(name).tests) >= 2


def test_the_schema_is_the_committed_one(deepbots):
    printed = deepbots("lsp", "--schema")
    assert json.loads(printed.out)["title"] == "deepbots scenario"
    assert deepbots("lsp", "--schema", "-o", "s.json").out == ""
    assert Path("s.json").read_text(encoding="utf-8") == printed.out


def test_for_a_scenario_it_has_its_names(deepbots):
    printed = deepbots("lsp", "--schema", "--for", "cartpole")
    assert printed.err == ""
    assert '"pole_hinge"' in printed.out
    assert json.loads(printed.out)["$defs"]["Robot.cart"]


def test_the_comment_that_leads_an_editor_to_the_schema_is_printed(deepbots):
    deepbots("new", "cartpole", "worlds", "--from", "cartpole", "--json")
    Path("schemas").mkdir()
    ran = deepbots("lsp", "--schema", "--for", "worlds/cartpole.yaml", "-o", "schemas/mine.json")
    assert ran.out == ""
    assert (
        ran.err
        == "write as the first line of cartpole.yaml: # yaml-language-server: $schema=../schemas/mine.json\n"
    )
    assert '"pole_hinge"' in Path("schemas/mine.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "text",
    ["robots: [", "deepbots: 1\nrobots: {a: {urdf: nowhere}}", ""],
    ids=["no yaml", "no robot", "empty"],
)
def test_a_file_with_errors_gets_a_schema_and_a_word_about_them(deepbots, text):
    Path("mine.yaml").write_text(text, encoding="utf-8")
    ran = deepbots("lsp", "--schema", "--for", "mine.yaml")
    assert json.loads(ran.out)["title"] == "deepbots scenario"
    assert ran.err.endswith("names in unreadable parts are missing; see: deepbots lint mine.yaml\n")
    assert ran.err.count("\n") == 1


@pytest.mark.parametrize(
    "content",
    [b"deepbots: 1\nname: Mine\n", b"robots: [", b"name: \xff\xfe"],
    ids=["a scenario", "no yaml", "no text"],
)
def test_the_scenario_itself_is_not_written_over(deepbots, content):
    Path("mine.yaml").write_bytes(content)
    Path("linked.yaml").symlink_to("mine.yaml")
    for output in ("mine.yaml", "./mine.yaml", "linked.yaml"):
        deepbots("lsp", "--schema", "--for", "mine.yaml", "-o", output, code=2)
        assert Path("mine.yaml").read_bytes() == content


def test_the_robot_file_is_not_written_over(deepbots):
    deepbots("new", "cartpole", ".", "--from", "cartpole", "--json")
    before = Path("robots/urdf/cartpole.urdf").read_bytes()
    deepbots("lsp", "--schema", "--for", "cartpole.yaml", "-o", "robots/urdf/cartpole.urdf", code=2)
    assert Path("robots/urdf/cartpole.urdf").read_bytes() == before


def test_a_scenario_that_there_is_not_is_wrong_usage(deepbots):
    ran = deepbots("lsp", "--schema", "--for", "nowhere.yaml", "-o", "s.json", code=2)
    assert not Path("s.json").exists()
    assert ran.err.startswith("error: no file, folder or shipped scenario is called")


def test_a_scenario_file_without_its_ending_is_suggested(deepbots):
    Path("park.yaml").write_text("deepbots: 1\n")
    for verb in ("try", "lint", "lsp --schema --for"):
        assert "; did you mean park.yaml?" in deepbots(*verb.split(), "park", code=2).err


def test_of_a_scenario_that_comes_with_deepbots_no_line_is_to_be_changed(deepbots):
    ran = deepbots("lsp", "--schema", "--for", "cartpole", "-o", "s.json")
    assert (ran.out, ran.err) == ("", "")


def test_a_dash_is_standard_output_and_no_file(deepbots, tmp_path):
    ran = deepbots("lsp", "--schema", "--for", "cartpole", "-o", "-")
    assert (ran.err, json.loads(ran.out)["title"]) == ("", "deepbots scenario")
    assert not any(tmp_path.iterdir())


def test_the_old_command_is_understood_with_a_note(deepbots):
    ran = deepbots("schema", "-o", "s.json")
    assert ran.out == ""
    assert "`deepbots schema` is now `deepbots lsp --schema`" in ran.err
    assert Path("s.json").read_text(encoding="utf-8") == deepbots("lsp", "--schema").out


def test_a_file_for_the_schema_needs_the_schema(deepbots):
    assert "add --schema" in deepbots("lsp", "-o", "s.json", code=2).err
