"""`deepbots new` writes a whole scenario and overwrites nothing."""

from __future__ import annotations

import json
import re
import resource
from contextlib import closing
from pathlib import PurePosixPath

import numpy as np
import pytest
import yaml

from deepbots_cli import api
from deepbots_cli.cli.command import help_text
from deepbots_cli.cli.new_files import write_new
from deepbots_cli.cli.starters.templates import Template
from deepbots_cli.document import shipped
from deepbots_cli.errors import UsageError
from deepbots_cli.scenario.json_schema import schema_text
from tests.few import few


@pytest.mark.parametrize("template", few([*Template], ["arm", "duel"]))
def test_what_a_template_makes_is_clean_runs_and_says_what_to_do_next(deepbots, tmp_path, template):
    created = deepbots("new", "my_first", "--template", template)
    assert created.out.split()[0] == "my_first.yaml"
    assert all(
        f"deepbots {verb} my_first.yaml" in created.err for verb in ("try", "lint", "inspect", "train")
    )
    assert api.lint(tmp_path / "my_first.yaml", preview=True) == []
    compiled = api.compile(tmp_path / "my_first.yaml")
    assert compiled.program.name == "MyFirst"
    assert compiled.program.agent.training is not None
    deepbots("try", "my_first.yaml", "--episodes", "2")
    for script in compiled.program.agent.scripts:
        deepbots("try", "my_first.yaml", "--driver", script.name, "--episodes", "1")


@pytest.mark.parametrize("template", [*Template])
def test_every_section_of_a_template_has_a_comment(deepbots, tmp_path, template):
    deepbots("new", "a", "--template", template, "--json")
    text = (tmp_path / "a.yaml").read_text(encoding="utf-8")
    blocks = [
        block for block in text.split("\n\n") if not block.startswith(("deepbots", "solved", "objects"))
    ]
    assert blocks
    assert [block for block in blocks if "#" not in block] == []


def test_the_help_lists_every_template():
    text = help_text("new")
    assert [name for name in Template if f"  {name:<8}  a" not in text] == []


def test_the_script_of_the_wheeled_template_finds_its_ball(deepbots):
    deepbots("new", "rolling", "--template", "wheeled", "--json")
    ran = deepbots("try", "rolling.yaml", "--driver", "towards", "--episodes", "5", "--json")
    assert json.loads(ran.out)["summary"]["success_rate"] == 1.0


def test_an_arm_comes_with_a_robot_file_of_its_own(deepbots, tmp_path):
    report = json.loads(deepbots("new", "reach", "sub", "--template", "arm", "--json").out)
    assert report == {"scenario": "sub/reach.yaml", "files": ["sub/reach.yaml", "sub/reach.urdf"]}
    assert "urdf: reach.urdf" in (tmp_path / "sub" / "reach.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize("taken", ["mine.yaml", "mine.urdf"])
def test_a_new_scenario_overwrites_nothing_and_leaves_nothing_half_written(deepbots, tmp_path, taken):
    (tmp_path / taken).write_text("mine\n")
    ran = deepbots("new", "mine", "--template", "arm", code=2)
    assert taken in ran.err
    assert [path.name for path in tmp_path.iterdir()] == [taken]
    assert (tmp_path / taken).read_text() == "mine\n"


@pytest.mark.parametrize("name", ["", "../1", "/", "a/b/", "1st", "-x", "x" * 65, "a b", "a\nb", "ü"])
def test_a_name_that_names_no_file_is_wrong_usage(deepbots, tmp_path, name):
    ran = deepbots("new", "--template", "pit", "--", name, code=2)
    assert "begin with a letter" in ran.err
    assert not any(tmp_path.iterdir())


def test_a_name_with_a_folder_is_refused_with_the_command_to_write(deepbots, tmp_path):
    ran = deepbots("new", "my experiments/reach", "--template", "arm", code=2)
    assert "deepbots new reach 'my experiments'" in ran.err
    assert not any(tmp_path.iterdir())


def test_the_ending_of_the_file_may_be_written_or_left_out(deepbots):
    assert deepbots("new", "mine.yaml", "--template", "pit").out.split() == ["mine.yaml"]


def test_without_a_template_the_templates_are_listed(deepbots):
    ran = deepbots("new", "mine", code=2)
    assert "cartpole|wheeled|arm|pit|duel" in ran.err


ROBOTS = {
    "package://pybullet_data/kuka_iiwa/model.urdf": "arm",
    "package://pybullet_data/franka_panda/panda.urdf": "arm",
    "package://pybullet_data/xarm/xarm6_robot.urdf": "arm",
    "package://pybullet_data/a1/a1.urdf": "legs",
    "package://pybullet_data/laikago/laikago_toes.urdf": "legs",
    "package://pybullet_data/quadruped/minitaur.urdf": "legs",
    "package://pybullet_data/r2d2.urdf": "on wheels",
    "package://pybullet_data/husky/husky.urdf": "on wheels",
    "package://pybullet_data/racecar/racecar.urdf": "on wheels",
    "package://pybullet_data/cartpole.urdf": "upright",
    "package://pybullet_data/pendulum5.urdf": "arm",
    "epuck": "on wheels",
    "rover": "on wheels",
    "sumo": "on wheels",
    "balancer": "upright",
    "cartpole": "upright",
    "cartpole_rail": "upright",
    "a1": "legs",
    "biped": "legs",
    "panda": "arm",
    "roller": "moves away",
    "quadrotor": "rotors",
}


ONE_OF_EACH = tuple({kind: robot for robot, kind in ROBOTS.items()}.values())
"""A robot of each kind of scenario."""


@pytest.mark.parametrize("robot", few(ROBOTS, ONE_OF_EACH))
def test_a_scenario_for_a_robot_file_is_clean_suits_the_robot_and_runs(deepbots, tmp_path, robot):
    deepbots("new", "first", "--urdf", robot, "--json")
    assert api.lint(tmp_path / "first.yaml", preview=True) == []
    scenario = api.compile(tmp_path / "first.yaml").program
    assert ROBOTS[robot] in scenario.summary
    assert scenario.world.robots[0].fixed_base is (
        ROBOTS[robot] in ("arm", "posture") or robot.endswith(("rail", "data/cartpole.urdf"))
    )
    deepbots("try", "first.yaml", "--episodes", "2", "--steps", "100")


@pytest.mark.parametrize(
    ("robot", "way", "sign"),
    [("a1/a1", "x", "-"), ("quadruped/minitaur", "x", "-"), ("laikago/laikago_toes", "y", "+")],
)
def test_what_has_legs_walks_towards_the_end_where_its_front_legs_are(deepbots, tmp_path, robot, way, sign):
    pytest.importorskip("pybullet_data")
    deepbots("new", "first", "--urdf", f"package://pybullet_data/{robot}.urdf", "--json")
    text = (tmp_path / "first.yaml").read_text(encoding="utf-8")
    assert f"exp(-((v.{way} {sign} speed)^2" in text
    assert ("roll: 90 deg" in text) is (way == "y")


@pytest.mark.parametrize(
    ("robot", "feet"),
    [("a1", [{"FR_toe", "RL_toe"}, {"FL_toe", "RR_toe"}]), ("biped", [{"left_foot"}, {"right_foot"}])],
)
def test_a_legged_robot_begins_with_springs_a_gait_and_a_batch_of_worlds(deepbots, tmp_path, robot, feet):
    deepbots("new", "first", "--urdf", robot, "--json")
    program = api.compile(tmp_path / "first.yaml").program
    (motor,) = program.robots[0].actuators
    assert motor.stiffness is not None
    assert program.engine == "mujoco"
    assert program.agent.training.environments == 256
    groups = yaml.safe_load((tmp_path / "first.yaml").read_text())["robots"]["robot"]["groups"]
    assert sorted(sorted(groups[name]) for name in ("feet_a", "feet_b")) == sorted(map(sorted, feet))
    if robot == "a1":
        stood = deepbots("try", "first.yaml", "--driver", "zero", "--episodes", "2", "--json")
        assert json.loads(stood.out)["summary"]["mean_length"] > 100


@pytest.mark.slow
@pytest.mark.parametrize(
    "robot",
    few(
        ["a1/a1", "laikago/laikago_toes_limits", "laikago/laikago_toes_zup"], ["laikago/laikago_toes_limits"]
    ),
)
def test_a_legged_robot_stands_on_feet_below_its_hips(deepbots, tmp_path, robot):
    pytest.importorskip("pybullet_data")
    pytest.importorskip("mujoco")
    deepbots("new", "first", "--urdf", f"package://pybullet_data/{robot}.urdf", "--json")
    scenario = tmp_path / "first.yaml"
    assert "the feet are below the hips" in scenario.read_text(encoding="utf-8")
    with closing(api.make(scenario)) as environment:
        environment.reset(seed=0)
        read = environment.engine.pose("robot")
        upright = read()[1]
        for _ in range(50):
            _, _, terminated, _, _ = environment.step(np.zeros(environment.action_space.shape, np.float32))
        assert not terminated
        assert abs(np.dot(read()[1], upright)) > np.cos(np.radians(15.0) / 2.0)


def test_feet_without_links_of_their_own_are_not_described_as_below_the_hips(deepbots, tmp_path):
    pytest.importorskip("pybullet_data")
    deepbots("new", "first", "--urdf", "package://pybullet_data/quadruped/minitaur.urdf", "--json")
    text = (tmp_path / "first.yaml").read_text(encoding="utf-8")
    assert "the feet are below the hips" not in text
    assert "# Its feet are not links of their own" in text


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "roll"), [("a1/a1", 90), ("laikago/laikago_toes", 0)])
def test_a_legged_robot_on_its_side_falls_before_it_is_low(deepbots, tmp_path, robot, roll):
    pytest.importorskip("pybullet_data")
    pytest.importorskip("mujoco")
    deepbots("new", "first", "--urdf", f"package://pybullet_data/{robot}.urdf", "--json")
    lying = [f"reset.place.robot.roll={roll} deg", "reset.place.robot.z=3 m"]
    with closing(api.make(tmp_path / "first.yaml", overrides=lying)) as environment:
        environment.reset(seed=0)
        for _ in range(15):
            _, _, terminated, _, _ = environment.step(np.zeros(environment.action_space.shape, np.float32))
            if terminated:
                break
        assert terminated
        assert environment.engine.pose("robot")()[0][2] > 1.0


def test_every_shipped_robot_is_among_those_that_are_tried():
    assert set(shipped.robot_names()) <= set(ROBOTS)


@pytest.mark.parametrize("robot", ["rover", "package://pybullet_data/husky/husky.urdf"])
def test_wheels_of_a_robot_file_turn_the_way_that_the_scenario_says(deepbots, robot):
    deepbots("new", "rolling", "--urdf", robot, "--json")
    ran = deepbots("try", "rolling.yaml", "--driver", "towards", "--episodes", "3", "--json")
    assert json.loads(ran.out)["summary"]["success_rate"] == 1.0


def test_wheels_steering_and_held_joints_are_distinguished(deepbots, tmp_path):
    pytest.importorskip("pybullet_data")
    deepbots("new", "car", "--urdf", "package://pybullet_data/racecar/racecar.urdf", "--json")
    deepbots("new", "droid", "--urdf", "package://pybullet_data/r2d2.urdf", "--json")
    car, droid = (api.compile(tmp_path / f"{name}.yaml").program.robots[0] for name in ("car", "droid"))
    assert [len(motor.joints) for motor in car.actuators] == [4, 2]
    assert [motor.kind for motor in car.actuators] == ["velocity_motor", "position_motor"]
    assert [motor.joints for motor in droid.actuators if motor.name.startswith("hold")] == [
        ("left_gripper_joint", "right_gripper_joint", "head_swivel"),
        ("gripper_extension",),
    ]


@pytest.mark.parametrize("robot", ["package://pybullet_data/racecar/racecar.urdf", "balancer", "rover"])
def test_no_wheels_are_grouped_twice(deepbots, tmp_path, robot):
    deepbots("new", "car", "--urdf", robot, "--json")
    groups = re.findall(
        r"^      (\w+): (\[.*\])$", (tmp_path / "car.yaml").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert groups[0][0] == "wheels"
    assert len({members for _, members in groups}) == len(groups)


def test_a_robot_file_of_ones_own_is_named_by_its_path_from_the_scenario(deepbots, tmp_path):
    (tmp_path / "robots").mkdir()
    (tmp_path / "pyproject.toml").write_text("")
    (tmp_path / "robots" / "my rover.urdf").write_bytes(shipped.robot_path("rover").read_bytes())
    deepbots("new", "mine", "scenarios", "--urdf", "robots/my rover.urdf", "--json")
    assert 'urdf: "../robots/my rover.urdf"' in (tmp_path / "scenarios" / "mine.yaml").read_text(
        encoding="utf-8"
    )
    assert api.lint(tmp_path / "scenarios" / "mine.yaml") == []


def test_joints_and_a_file_with_unusual_names_make_a_scenario(deepbots, tmp_path):
    text = shipped.robot_path("rover").read_text(encoding="utf-8")
    text = text.replace('"left_wheel"', '"on"').replace('"right_wheel"', '"right: wheel, {1}"')
    (tmp_path / "a\nname: B.urdf").write_text(text, encoding="utf-8")
    deepbots("new", "odd", "--urdf", "a\nname: B.urdf", "--json")
    assert api.compile(tmp_path / "odd.yaml").program.name == "Odd"


@pytest.mark.parametrize(
    "names", [("#hip", "hip#1"), ("arm.1", "arm.2"), ("joint[1]", "joint[2]"), ("a*b", "a*bb")], ids=str
)
def test_joints_called_like_copies_components_or_patterns_are_taken_for_joints(deepbots, tmp_path, names):
    deepbots("new", "arm", "--template", "arm", "--json")
    text = (tmp_path / "arm.urdf").read_text(encoding="utf-8")
    text = text.replace('"shoulder"', f'"{names[0]}"').replace('"elbow"', f'"{names[1]}"')
    (tmp_path / "odd.urdf").write_text(text, encoding="utf-8")
    deepbots("new", "odd", "--urdf", "odd.urdf", "--json")
    assert api.lint(tmp_path / "odd.yaml", preview=True) == []
    assert api.compile(tmp_path / "odd.yaml").program.robots[0].actuators[0].joints == ("turn", *names)


def test_a_robot_file_outside_the_project_is_refused_with_what_to_do(deepbots, tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "there.urdf").write_bytes(shipped.robot_path("rover").read_bytes())
    ran = deepbots("new", "mine", "here", "--urdf", "there.urdf", code=2)
    assert "outside the project; allow its folder with `--allow-path .`" in ran.err
    assert "package://PACKAGE/PATH" in ran.err
    assert not any((tmp_path / "here").iterdir())


def test_a_robot_without_anything_to_drive_and_a_file_that_is_none_are_refused(deepbots, tmp_path):
    (tmp_path / "stone.urdf").write_text('<robot name="s"><link name="stone"/></robot>')
    (tmp_path / "broken.urdf").write_text("<robot>")
    deepbots("new", "a", "--urdf", "stone.urdf", code=2)
    deepbots("new", "a", "--urdf", "broken.urdf", code=1)
    deepbots("new", "a", "--urdf", "nowhere.urdf", code=2)
    assert not (tmp_path / "a.yaml").exists()


def test_new_counts_the_warnings_about_a_robot_file(deepbots, tmp_path):
    text = shipped.robot_path("rover").read_text(encoding="utf-8")
    cut = text.index("<inertial>", text.index('name="caster"'))
    (tmp_path / "odd.urdf").write_text(
        text[:cut] + text[text.index("</inertial>", cut) + len("</inertial>") :], encoding="utf-8"
    )
    created = deepbots("new", "odd", "--urdf", "odd.urdf")
    assert "1 warning; see: deepbots lint odd.yaml" in created.err


@pytest.mark.parametrize("template", [*Template])
def test_with_its_schema_a_new_scenario_leads_an_editor_to_its_names(deepbots, tmp_path, template):
    created = deepbots("new", "mine", "sub", "--template", template, "--schema", "--json")
    text = (tmp_path / "sub" / "mine.yaml").read_text(encoding="utf-8")
    assert text.startswith("# yaml-language-server: $schema=mine.schema.json\n\ndeepbots: 1")
    assert api.lint(tmp_path / "sub" / "mine.yaml", preview=True) == []
    schema = json.loads((tmp_path / "sub" / "mine.schema.json").read_text(encoding="utf-8"))
    robots = api.load(tmp_path / "sub" / "mine.yaml").robots.values()
    assert {f"Robot.{robot.name}" for robot in robots} <= {*schema["$defs"]}
    assert json.loads(created.out)["files"] == [
        f"sub/{file}"
        for file in ("mine.yaml", *(["mine.urdf"] if template == "arm" else []), "mine.schema.json")
    ]


def test_a_link_where_the_schema_would_go_leaves_nothing_half_written(deepbots, tmp_path):
    (tmp_path / "mine.schema.json").symlink_to("nowhere")
    deepbots("new", "mine", "--template", "pit", "--schema", code=2)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.schema.json"]


def test_a_schema_that_is_there_already_is_not_written_over(deepbots, tmp_path):
    (tmp_path / "mine.schema.json").write_text("{}")
    deepbots("new", "mine", "--template", "pit", "--schema", code=2)
    assert not (tmp_path / "mine.yaml").exists()


def test_without_a_schema_a_new_scenario_names_none_and_prints_the_command_for_one(deepbots, tmp_path):
    ran = deepbots("new", "mine", "--template", "pit")
    assert "yaml-language-server" not in (tmp_path / "mine.yaml").read_text(encoding="utf-8")
    hint = next(line for line in ran.err.splitlines() if "--schema" in line)
    command = hint.partition("deepbots ")[2]
    deepbots(*command.split())
    assert (tmp_path / "mine.schema.json").exists()


def test_a_template_and_a_robot_file_exclude_each_other_and_a_file_is_not_a_folder_to_write_into(
    deepbots, tmp_path
):
    both = deepbots("new", "mine", "--template", "pit", "--urdf", "rover", code=2)
    assert "cannot be combined" in both.err
    (tmp_path / "taken").write_text("")
    into = deepbots("new", "mine", "taken", "--template", "pit", code=2)
    assert "name a folder" in into.err


def test_a_robot_that_is_bolted_down_begins_above_the_ground(deepbots, tmp_path):
    """The cart of this one is 20 cm high, around the origin of its rail."""
    pytest.importorskip("pybullet_data")
    deepbots("new", "first", "--urdf", "package://pybullet_data/cartpole.urdf", "--json")
    assert "robot: {z: 0.1 m}" in (tmp_path / "first.yaml").read_text(encoding="utf-8")


def test_no_file_is_left_where_one_cannot_be_written(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        with pytest.raises(UsageError, match="large cannot be written: file too large"):
            write_new(
                {PurePosixPath("a"): b"1", PurePosixPath("large"): bytes(100), PurePosixPath("b"): b"2"},
                tmp_path / "new",
            )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list((tmp_path / "new").iterdir())


def test_a_project_has_a_schema_for_its_editor_and_a_workflow_that_lints(deepbots, tmp_path):
    report = json.loads(deepbots("new", "mine", "--template", "arm", "--project", "work", "--json").out)
    assert report["files"][:2] == ["work/mine.yaml", "work/mine.urdf"]
    work = tmp_path / "work"
    settings = json.loads((work / ".vscode" / "settings.json").read_text())
    (schema,) = settings["yaml.schemas"]
    assert json.loads((work / schema).read_text()) == json.loads(schema_text())
    steps = yaml.safe_load((work / ".github" / "workflows" / "lint.yml").read_text())["jobs"]["lint"]["steps"]
    lint = steps[-1]["run"].split()
    assert lint[:2] == ["deepbots", "lint"]
    deepbots("lint", "work", *lint[3:])
    deepbots("new", "mine", "other", "--template", "pit", "--project", "work", code=2)


_ROLLER = """#VRML_SIM R2023b utf8
WorldInfo { }
Solid { boundingObject Plane { } }
DEF ROLLER Robot { translation 0 0 0.05 controller "<none>" boundingObject Box { size 0.1 0.1 0.1 }
  physics Physics { density -1 mass 1 }
  children [ HingeJoint { jointParameters HingeJointParameters { anchor 0 0 0.1 }
    device RotationalMotor { name "motor" }
    endPoint Solid { translation 0 0 0.2 boundingObject Sphere { radius 0.02 } physics Physics { } } } ] }
"""


def test_a_world_of_webots_becomes_a_scenario_and_says_what_is_left(deepbots, tmp_path):
    (tmp_path / "roller.wbt").write_text(_ROLLER)
    created = deepbots("new", "mine", "--webots", "roller.wbt")
    assert created.out.split() == ["mine.yaml", "mine_roller.urdf"]
    assert "left to you" in created.err
    assert "deepbots lint mine.yaml" in created.err
    deepbots("try", "mine.yaml", "--episodes", "1")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--webots", "gone.wbt"], "gone.wbt is not a world"),
        (["--webots", "roller.wbt", "--protos", "gone"], "there is no such folder"),
        (["--webots", "roller.wbt", "--urdf", "epuck"], "cannot be combined"),
        (["--urdf", "epuck", "--protos", "."], "--protos goes with --webots"),
        (["--webots", "empty.wbt"], "has a motor"),
        (["--webots", "broken.wbt"], "broken.wbt:3"),
    ],
)
def test_a_world_of_webots_that_cannot_be_read_is_one_sentence(deepbots, tmp_path, arguments, sentence):
    (tmp_path / "roller.wbt").write_text(_ROLLER)
    (tmp_path / "empty.wbt").write_text("#VRML_SIM R2023b utf8\nWorldInfo { }\n")
    (tmp_path / "broken.wbt").write_text("#VRML_SIM R2023b utf8\nWorldInfo { \n")
    created = deepbots("new", "mine", *arguments, code=None)
    assert created.code != 0
    assert sentence in created.err
    assert "Traceback" not in created.err
    assert not (tmp_path / "mine.yaml").exists()


def test_a_robot_in_place_of_a_shipped_scenario_leads_to_its_option(deepbots):
    refused = deepbots("new", "mine", "--from", "package://pybullet_data/laikago/laikago_toes.urdf", code=2)
    assert "deepbots new mine --urdf package://pybullet_data/laikago/laikago_toes.urdf" in refused.err
