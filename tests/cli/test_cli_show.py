"""Commands about a scenario without training.

* `inspect`, `compile`, `run` and `bench`: commands about a scenario without training.
* `inspect` of robot files: tables, warnings, pictures.
* A quantity is shown in the unit in which the file writes it.
* `try --driver` and `try --start`, and the summary of `try` over many episodes.
* `deepbots test`: passing tests, the output of a failed test, and that tests change nothing else.
* `deepbots lsp --schema`: the JSON Schema for editors, in general and for one scenario.
"""

from __future__ import annotations

import ast
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
from deepbots_cli.cli.terminal import note_faster_engine
from deepbots_cli.codegen.names import WIDTH
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import Permissions, shipped
from deepbots_cli.document.parse import parse
from deepbots_cli.insight.speed import EngineSpeeds, engine_speeds, measure
from deepbots_cli.learning.runs.evaluations import draw_labels, drawn_effects
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

COPIES = Path(__file__).parents[1] / "channel" / "copies.yaml"


def changed(*settings: str) -> tuple[str, ...]:
    """The words of CartPole with settings."""
    return ("cartpole", *(word for text in settings for word in ("--set", text)))


AGED = changed(
    "augment.was=previous(position(cart).xy)",
    "augment.before=previous(was)",
    "augment.gone=delta(x)",
    "observation.was=-1 .. 1 m",
    "observation.before=-1 .. 1 m",
    "observation.gone=-1 .. 1 m",
    "robots.cart.sensors.pole_angle.latency=40 ms",
)
TOLD = (
    "tag",
    *("--set", "robots.hunter.hear={prey_near: prey.proximity}"),
    *("--set", "robots.prey.hear={hunter_near: hunter.proximity}"),
    *("--set", "agents.hunter.observation={hunter.proximity: 0 .. 4095, hunter.prey_near: 0 .. 4095}"),
    *("--set", "messages.between_robots={latency: 100 ms}"),
)
# The tables and the parts of their rows that `inspect --json` shows for these words.
INSPECTED = [
    (
        changed(),
        [
            ("scenario", {"name": "CartPole", "digest": api.compile("cartpole").digest}),
            ("observation", {"name": "speed", "low": -0.8, "high": 0.8, "unit": "m/s", "seen_as": "-1 .. 1"}),
            ("observation", {"name": "cart.pole_angle", "low": -0.3490658503988659, "unit": "rad"}),
            ("joints", {"joint": "tip_mount"}),
            ("reward", {"term": "alive", "is": "1"}),
            ("parameters", {"parameter": "track", "value": "0.39 m"}),
            ("timing", {"name": "drive", "physics_step": "4n + 1", "age_s": 0}),
            ("timing", {"name": "cart.pole_angle", "physics_step": "4n + 4", "age_s": 0}),
            ("hyperparameters", {"hyperparameter": "n_steps", "value": 64, "from": "scenario"}),
            ("hyperparameters", {"hyperparameter": "clip_range", "value": 0.2, "from": "Stable-Baselines3"}),
            ("poses", {"robot": "cart", "link": "tip"}),
        ],
    ),
    (
        changed(
            "augment.x={value: position(cart).x, noise: 2 mm}",
            "goal={achieved: x, desired: 0.1 m, tolerance: 1 cm, range: -1 .. 1 m, noise: 1 %}",
            "reward={there: 1 when goal_reached}",
        ),
        [
            ("signals", {"signal": "x", "is": "position(cart).x", "noise": "2 mm"}),
            ("goal", {"noise": "1 %"}),
        ],
    ),
    (
        ("biped",),
        [
            (
                "mirror_images",
                {"name": "walker.q.left_hip_roll", "mirror_image": "walker.q.right_hip_roll", "sign": -1},
            ),
            ("mirror_images", {"name": "walker.down.x", "mirror_image": "walker.down.x", "sign": 1}),
            (
                "mirror_images",
                {"of": "action", "name": "stride.left_knee", "mirror_image": "stride.right_knee"},
            ),
        ],
    ),
    (
        changed("train.symmetry={swap: {forward: backward}, flip: [x, '*speed', '*_angle']}"),
        [("mirror_images", {"of": "action", "name": "drive.forward", "mirror_image": "drive.backward"})],
    ),
    (
        ("find_ball",),
        [
            ("signals", {"signal": "apart", "policy_may_see_it": True}),
            ("signals", {"signal": "path", "policy_may_see_it": False}),
        ],
    ),
    (changed("messages.format=struct"), [("messages", {"format": "struct", "bytes": 12})]),
    (changed("messages.format=msgpack"), [("messages", {"format": "msgpack", "bytes": 15})]),
    (changed("messages.format=json"), [("messages", {"format": "json", "bytes": "varies"})]),
    (
        changed("messages.timing=delayed"),
        [
            ("timing", {"name": "drive", "physics_step": "4n + 5", "age_s": 0.032}),
            ("timing", {"name": "cart.pole_angle", "physics_step": "4n", "age_s": 0.032}),
            ("timing", {"name": "x", "physics_step": "4n + 4", "age_s": 0}),
        ],
    ),
    (
        changed("messages.to_robot={latency: 40 ms}", "messages.from_robot={loss: 5 %}"),
        [
            ("timing", {"name": "drive", "physics_step": "4n + 9", "age_s": 0.064}),
            ("timing", {"name": "cart.pole_angle", "physics_step": "varies", "age_s": None}),
            ("routes", {"direction": "to robot", "latency": "40 ms", "loss": ""}),
            ("routes", {"direction": "from robot", "latency": "", "loss": "5 %"}),
        ],
    ),
    (
        changed("robots.cart.pose={y: -180 m}"),
        [("poses", {"y_m": -180, "yaw_deg": 0})],
    ),
    (
        changed("robots.cart.actuators.wheels.delay=20 ms"),
        [("timing", {"name": "drive", "physics_step": "4n + 4", "age_s": 0.024})],
    ),
    (
        changed("robots.cart.actuators.wheels.delay=uniform(0 .. 20 ms)"),
        [("timing", {"name": "drive", "physics_step": "varies", "age_s": None})],
    ),
    (
        changed("parameters.p1=uniform(1 .. 2) every 2 s", "parameters.p2=2 * p1"),
        [("parameters", {"parameter": "p2", "drawn": "repeatedly"})],
    ),
    (
        TOLD,
        [
            ("timing", {"name": "hunter__hunter.prey_near.ps0", "physics_step": "8n - 8", "by": "prey"}),
            ("timing", {"name": "prey__prey.hunter_near.ps0", "age_s": 0.256, "by": "hunter"}),
            ("reward", {"term": "prey__farther", "is": "10 * delta(apart) / m"}),
            ("signals", {"signal": "prey__angle", "is": "bearing(prey, hunter)"}),
            ("signals", {"signal": "apart", "is": "clearance(hunter, prey)"}),
            (
                "scripts",
                {
                    "script": "prey__stroll",
                    "action": "prey__gas",
                    "is": "0 if max(prey.proximity) > 150 else 0.6",
                },
            ),
        ],
    ),
    (
        AGED,
        [
            ("timing", {"name": "was.x", "physics_step": "4n", "age_s": 0.032}),
            ("timing", {"name": "before.y", "age_s": 0.064}),
            ("timing", {"name": "gone", "age_s": 0}),
            ("timing", {"name": "cart.pole_angle", "age_s": 0.064, "by": "cart"}),
        ],
    ),
    (
        changed(
            "objects.puck={shape: sphere, radius: 2 cm, mass: uniform(0.1 .. 300 g) * 2, friction: uniform(0.4 .. 0.8)}",
            "reset.place={puck: {x: 0.3 m}, cart: {x: 0 m, z: 0.04 m}}",
            "robots.cart.links={pole: {mass: urdf * uniform(80 % .. 120 %)}}",
        ),
        [
            ("objects", {"mass_kg": "uniform(0.0001 .. 0.3) * 2", "friction": "uniform(0.4 .. 0.8)"}),
            ("drawn", {"drawn": "mass", "of": "cart.pole"}),
            ("robots", {"robot": "cart", "mass": "the mean; drawn in every episode"}),
            ("reset", {"reset": "place", "of": "cart", "to": "{x: 0 m, z: 0.04 m}"}),
        ],
    ),
    (
        changed("agent={action_repeat: 3}"),
        [
            ("timing", {"name": "drive", "physics_step": "12n + 1"}),
            ("timing", {"name": "x", "physics_step": "12n + 12"}),
        ],
    ),
    (
        ("find_ball_random",),
        [
            (
                "curriculum",
                {
                    "stage": "few",
                    "set": "{obstacles: integer(1 .. 3)}",
                    "until": "success_rate >= 0.7 over 40 episodes",
                },
            ),
        ],
    ),
    (
        ("find_ball_random", "--stage", "few"),
        [
            ("parameters", {"parameter": "obstacles", "value": "integer(1 .. 3)"}),
        ],
    ),
    (
        changed("train={algorithm: PPO, total_timesteps: 1000, network: {activation: relu}}"),
        [
            ("hyperparameters", {"hyperparameter": "n_steps", "value": 256, "from": "deepbots"}),
            (
                "hyperparameters",
                {"hyperparameter": "network.activation", "value": "relu", "from": "scenario"},
            ),
        ],
    ),
    (
        changed("scripts={catch: {drive: {forward: cart.pole_angle > 0 rad, backward: true}}}"),
        [
            (
                "scripts",
                {
                    "script": "catch",
                    "action": "drive",
                    "is": "{forward: cart.pole_angle > 0 rad, backward: true}",
                },
            )
        ],
    ),
    (
        changed("world.gravity=uniform(0 0 -9.9 .. 0 0 -9.7 m/s^2)"),  # the middle of each component
        [("scenario", {"gravity": [0.0, 0.0, pytest.approx(-9.8)]})],
    ),
    (
        ("epuck",),
        [
            ("robot", {"mass_kg": pytest.approx(0.162)}),
            ("links", {"link": "left_wheel", "collides_as": ["cylinder r 0.02 l 0.004"]}),
            ("joints", {"joint": "caster_front_mount", "type": "fixed"}),
        ],
    ),
]


@pytest.mark.parametrize(("words", "shown"), INSPECTED)
def test_inspect_shows_rows(deepbots, words, shown):
    tables = json.loads(deepbots("inspect", *words, "--json").out)
    for name, part in shown:
        rows = tables[name] if isinstance(tables[name], list) else [tables[name]]
        assert any({**row, **part} == row for row in rows), (name, part)


@pytest.mark.parametrize("format", ["struct", "msgpack"])
def test_the_size_of_a_message_is_what_its_codec_makes(format):
    from deepbots_cli.insight.inspection import message_size
    from deepbots_cli.runtime.messages import codec

    program = api.compile("cartpole", overrides=[f"messages.format={format}"]).program
    for layout in (program.robots[0].to_robot, program.robots[0].from_robot):
        assert message_size(layout, format) == len(codec(layout, format).encode(*[0.5] * len(layout.fields)))


@pytest.mark.parametrize(
    ("scenario", "robot", "link", "pose"),
    [
        ("panda_push", "panda", "panda_grasptarget", [0.33, 0, 0.03, 180, 0, 0]),
        # Without sensors and hands, the end that the reset sets.
        ("cartpole", "cart", "tip", [0, 0, 1.07, 0, 0, 0]),
    ],
)
def test_inspect_prints_where_a_hand_is_and_how_it_is_turned_at_the_start(
    deepbots, scenario, robot, link, pose
):
    (shown,) = json.loads(deepbots("inspect", scenario, "--json").out)["poses"]
    assert (shown["robot"], shown["link"]) == (robot, link)
    names = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
    assert [abs(shown[name]) for name in names] == pytest.approx(pose, abs=1.0)
    assert [abs(shown[name]) for name in names[:3]] == pytest.approx(pose[:3], abs=0.05)


def test_a_world_that_cannot_begin_is_inspected_without_poses(deepbots):
    ran = deepbots("inspect", "cartpole", "--json", "--set", "termination.failure.fallen=age(cart) < 1 s")
    assert "poses" not in json.loads(ran.out)
    assert "the table of poses is missing" in ran.err


def test_a_picture_of_the_world_is_a_png_with_something_in_it(deepbots, tmp_path):
    assert deepbots("render", "cartpole", "-o", "world.png").out == "world.png\n"
    with Image.open(tmp_path / "world.png") as image:
        assert image.size == (640, 480)
        assert len(set(image.tobytes())) > 20


def test_compile_prints_what_runs(deepbots, tmp_path):
    compiled = api.compile("cartpole")
    code = deepbots("compile", "cartpole").out
    assert ast.dump(ast.parse(code)) == ast.dump(ast.parse(compiled.code))
    assert max(map(len, code.splitlines())) <= WIDTH < max(map(len, compiled.code.splitlines()))
    assert deepbots("compile", "cartpole", "-o", "e.py").out == ""
    assert (tmp_path / "e.py").read_text() == code
    assert json.loads(deepbots("compile", "cartpole", "--program").out)["name"] == "CartPole"
    assert json.loads(deepbots("compile", "cartpole", "--json").out)["digest"] == compiled.digest
    deepbots("compile", "cartpole", "--json", "--program", code=2)


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


def test_an_option_of_too_many_digits_does_not_exist(deepbots):
    assert "has no option '99" in deepbots("try", "cartpole", "--driver", "9" * 5000, code=2).err


def test_ranges_are_acted_on_by_numbers_from_minus_one_to_one(deepbots):
    continuous = ["--set", "action.drive=-1 .. 1", "--steps", "3"]
    deepbots("try", "cartpole", "--driver=0.5,-1", *continuous)
    deepbots("try", "cartpole", "--driver", "zero", *continuous)
    assert "-1 to 1" in deepbots("try", "cartpole", "--driver", "1.5", *continuous, code=2).err


def test_bench_compares_a_step_with_bare_physics(deepbots):
    bench = ("bench", "cartpole", "--engine", "mujoco", "--steps", "100", "--pairs", "1")
    figures = json.loads(deepbots(*bench, "--json").out)
    (speed,) = figures["speeds"]
    assert (figures["steps"], len(speed["ratios"])) == (100, 1)
    assert speed["step_us"] > speed["physics_us"] > 0
    assert speed["ratios"][0] > 1
    output = deepbots(*bench).out
    assert "ratio" in output
    assert "mujoco steps" not in output  # an engine that is named is not compared with others


def test_a_stage_of_the_curriculum_can_be_run(deepbots):
    lonely = json.loads(
        deepbots(
            "try", "find_ball_random", "--stage", "open", "--episodes", "1", "--steps", "100", "--json"
        ).out
    )
    assert (lonely["stage"], lonely["episodes"][0]["reward_terms"]["scrape"]) == ("open", 0)


def test_without_the_library_its_defaults_are_called_so(deepbots, monkeypatch):
    monkeypatch.setattr(defaults, "library_defaults", lambda algorithm: None)
    tables = json.loads(deepbots("inspect", "cartpole", "--json").out)
    rows = {row["hyperparameter"]: row for row in tables["hyperparameters"]}
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
    note_faster_engine(cartpole, 10_000_000, Permissions())
    assert "note: mujoco steps this world" in capfd.readouterr().err
    note_faster_engine(cartpole, 600, Permissions())
    note_faster_engine(cartpole, 20_000, Permissions())
    note_faster_engine(chosen, 10_000_000, Permissions())
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
    assert list(
        engine_speeds(api.compile(tmp_path / "hills.yaml").program, "pybullet", seconds=0.001).windows
    ) == ["pybullet"]


def test_a_bench_measures_no_more_rounds_than_fit_into_its_time():
    (rounds,) = measure(api.compile("cartpole"), ["mujoco"], steps=20, rounds=5, seed=0, end=0.0)
    assert len(rounds) == 1


@pytest.mark.slow
def test_a_quick_bench_measures_less(deepbots):
    quick = ("bench", "cartpole", "--engine", "mujoco", "--quick", "--steps", "100", "--json")
    rounds = [
        json.loads(deepbots(*quick, *more).out)["speeds"][0]["ratios"] for more in (["--pairs", "1"], [])
    ]
    assert [*map(len, rounds)] == [1, 3]


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


@pytest.mark.parametrize(
    ("scenario", "extra"), [("cartpole", "train"), ("find_and_avoid", "contrib")], ids=["train", "contrib"]
)
def test_a_project_names_a_clone_with_the_extra_of_its_algorithm_and_no_index(
    deepbots, tmp_path, scenario, extra
):
    deepbots("compile", scenario, "--project", "mine")
    text = (tmp_path / "mine" / "requirements.txt").read_text()
    assert ("==" in text, f"deepbots-cli[{extra}] @ file:///" in text) == (False, True)


def test_warnings_about_a_file_of_a_package_are_one_line(deepbots):
    pytest.importorskip("pybullet_data")
    robot = "package://pybullet_data/laikago/laikago.urdf"
    assert deepbots("inspect", robot).err == (
        "1 warning about a file of a package, which you cannot change (1 DB306); --json lists them\n"
    )
    assert len(json.loads(deepbots("inspect", robot, "--json").out)["findings"]) == 1


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


def test_a_range_of_an_agent_or_of_the_critic_is_shown_in_the_unit_of_the_file():
    text = """
critic: {height: 0 .. 90 cm}
agents:
  green: {observation: {gap: 0 .. 6 m}}
  red: {observation: {gap: 0 .. 600 cm}, critic: {speed: 0 .. 9 mm/s}}
  blue: {like: red}
"""
    units = ShownUnits(parse(Source("agents.yaml", text), Findings()))
    shown = {"height": "cm", "green__gap": "m", "red__gap": "cm", "blue__gap": "cm", "red.red__gap": "cm"}
    assert {name: units.of_entry(name, "m").text for name in shown} == shown
    assert units.of_entry("speed", "m/s").text == "mm/s"


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


@pytest.mark.parametrize(
    ("words", "same"),
    [
        (("--driver", "onward"), ("--driver", "forward")),
        (("--case", "back", "--driver", "onward"), ("--case", "back", "--driver", "backward")),
        (("--driver", "onward*3,backward*1"), ("--driver", "forward,forward,forward,backward")),
        (("--driver", "forward*3,backward"), ("--driver", "forward,forward,forward,backward")),
    ],
)
def test_a_script_drives_every_episode_and_actions_are_repeated(deepbots, scripted, words, same):
    driven = report_of(deepbots, scripted, *words)
    assert driven["driver"] == words[-1]
    assert driven["episodes"] == report_of(deepbots, scripted, *same)["episodes"]
    assert driven["episodes"] != report_of(deepbots, scripted, "--driver", "catch")["episodes"]


def test_a_name_means_the_same_driver_alone_and_among_actions(deepbots, scripted):
    path = Path(scripted)
    path.write_text(path.read_text().replace("onward: {drive: forward}", "forward: {drive: backward}"))
    path.write_text(path.read_text().replace("onward", "forward"))
    script, listed, option = (
        report_of(deepbots, scripted, "--driver", driver)["episodes"]
        for driver in ("forward", "forward*2,forward", "0")
    )
    assert script == listed != option


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


def test_compile_prints_a_method_for_each_script(deepbots, scripted):
    code = deepbots("compile", scripted).out
    assert "    def script_catch(self) -> Any:\n" in code
    assert "        if cart_pole_angle > 0.0:\n            drive_pick = 0  # forward\n" in code


def test_a_start_is_set_on_the_command_line(deepbots, scripted):
    words = (scripted, "--driver", "onward", "--episodes", "2")
    upright = report_of(deepbots, *words, "--start", "reset.joints.cart.pole_hinge=0.01")
    assert upright["start"] == {"reset.joints.cart.pole_hinge": 0.01}
    first, second = upright["episodes"]
    assert first == second


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
        (
            "eventually: driven < -1 mm",
            "never in 8 steps (0.16 s), when `there` ended it; at the end, driven is 0.00",
        ),
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


def test_junit_that_cannot_be_written_is_reported_before_a_test_runs(small, tmp_path: Path) -> None:
    ran = small("  one: {driver: zero, expect: {ends_by: max_steps}}\n", "--junit", tmp_path)
    assert (ran.code, ran.out) == (2, "")
    assert "it is a directory" in ran.err


def test_junit_has_a_suite_for_each_scenario_and_a_case_for_each_test(
    small, deepbots: Deepbots, tmp_path: Path
) -> None:
    tests = (
        "  drives: {driver: onward, expect: {ends_by: back}}\n  rests: {driver: zero, expect: {ends_by:"
        " max_steps}}\n"
    )
    assert (small(tests, "--junit", "one.xml").code, small(tests, "-k", "rest").code) == (1, 0)
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
