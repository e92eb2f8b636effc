"""`inspect`, `compile`, `run` and `bench`: commands about a scenario without training."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
from PIL import Image

from deepbots_cli import api
from deepbots_cli.cli.throughput import note_faster_engine
from deepbots_cli.insight.speed import EngineSpeeds, engine_speeds, measure
from deepbots_cli.learning.sb3 import defaults

PLAIN = "train={algorithm: PPO, total_timesteps: 1000, network: {activation: relu}}"
COPIES = Path(__file__).parents[1] / "channel" / "copies.yaml"


def inspected(deepbots, *words):
    ran = deepbots("inspect", "cartpole", "--json", *words)
    return json.loads(ran.out)


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
    assert timing["drive"]["physics_step"] == "4n + 5"
    assert timing["drive"]["age_s"] == 0.032
    assert timing["cart.pole_angle"]["physics_step"] == "4n"
    assert timing["cart.pole_angle"]["age_s"] == 0.032
    assert timing["x"]["physics_step"] == "4n + 4"
    assert timing["x"]["age_s"] == 0


def test_a_picture_of_the_world_is_a_png_with_something_in_it(deepbots, tmp_path):
    ran = deepbots("render", "cartpole", "-o", "world.png")
    assert ran.out == "world.png\n"
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
    ran = deepbots("try", "cartpole", "--driver", "1.5", *continuous, code=2)
    assert "-1 to 1" in ran.err


def test_bench_compares_a_step_with_bare_physics(deepbots):
    bench = ("bench", "cartpole", "--engine", "mujoco", "--steps", "100", "--pairs", "1")
    ran = deepbots(*bench, "--json")
    figures = json.loads(ran.out)
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
    assert timing["drive"]["physics_step"] == "4n + 9"
    assert timing["drive"]["age_s"] == 0.064
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
    assert timing["was.x"]["physics_step"] == "4n"
    assert timing["cart.pole_angle"]["by"] == "cart"


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
    assert lonely["stage"] == "open"
    assert lonely["episodes"][0]["reward_terms"]["scrape"] == 0


def test_inspect_shows_every_hyperparameter_with_its_source(deepbots):
    rows = {
        row["hyperparameter"]: (row["value"], row["from"]) for row in inspected(deepbots)["hyperparameters"]
    }
    assert rows["n_steps"] == (64, "scenario")
    assert rows["clip_range"] == (0.2, "Stable-Baselines3")
    rows = {
        row["hyperparameter"]: (row["value"], row["from"])
        for row in inspected(deepbots, "--set", PLAIN)["hyperparameters"]
    }
    assert rows["n_steps"] == (256, "deepbots")
    assert rows["network.hidden"] == ([64, 64], "deepbots")
    assert rows["network.activation"] == ("relu", "scenario")


def test_without_the_library_its_defaults_are_called_so(deepbots, monkeypatch):
    monkeypatch.setattr(defaults, "library_defaults", lambda algorithm: None)
    rows = {row["hyperparameter"]: row for row in inspected(deepbots)["hyperparameters"]}
    assert rows["clip_range"] == {"hyperparameter": "clip_range", "value": None, "from": "library default"}


@pytest.mark.parametrize(("written", "meant"), [("1e1", 10), ("2_0", 20), ("1k", 1000), ("1.5e2", 150)])
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
    assert speeds.best == {"pybullet": 100.0, "mujoco": 110.0}
    assert speeds.spread == pytest.approx(1.0)
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
    assert (figures["steps"], figures["pairs"]) == (100, 1)
    assert json.loads(deepbots(*quick).out)["pairs"] == 3


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
