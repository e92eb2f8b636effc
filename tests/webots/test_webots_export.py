"""`deepbots export --to webots`: worlds, controllers, and the same episodes as in the scenario."""

from __future__ import annotations

import ast
import re
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import UsageError
from deepbots_webots.nodes import walk
from deepbots_webots.project import read_world
from deepbots_webots.scene import build_scene
from tests.webots.exported_projects import (
    exported,
    node,
    run_exported,
    run_scenario,
    run_supervisor,
    simulation_of,
    world_of,
)

FITTING = ("cartpole", "pit_escape", "find_ball", "multi_cartpole", "line_follower", "balancer")


def messages(rows: list[Any], way: str) -> list[dict[str, list[str]]]:
    """Return the texts of each robot in each episode, without those that begin one."""
    episodes: list[dict[str, list[str]]] = []
    for _, reward, _, _, texts in rows:
        if reward is None:
            episodes.append({})
        for robot, direction, text in texts:
            if direction == way and not text.startswith("start,"):
                episodes[-1].setdefault(robot, []).append(text)
    return episodes


@pytest.mark.parametrize(
    ("name", "episodes", "steps", "script"),
    [
        ("cartpole", 20, 300, None),
        pytest.param("multi_cartpole", 8, 120, None, marks=pytest.mark.slow),
        pytest.param("find_ball", 4, 120, "around", marks=pytest.mark.slow),
        pytest.param("pit_escape", 2, 60, "rocking", marks=pytest.mark.slow),
    ],
)
def test_an_exported_project_runs_as_its_scenario(
    name: str, episodes: int, steps: int, script: str | None, tmp_path: Path
):
    prepared = exported(name, tmp_path)
    program = prepared.compiled.program
    work = [[seed, _actions(program, seed, steps, script)] for seed in range(episodes)]
    wanted, exports = run_scenario(prepared, tmp_path, work), run_exported(prepared, tmp_path, work)
    assert len(exports) == len(wanted) >= steps
    for (observation, reward, *ends, _), (own, own_reward, *own_ends, _) in zip(exports, wanted, strict=True):
        assert np.abs(np.subtract(observation, own)).max() <= 1e-6
        assert (reward, ends) == (pytest.approx(own_reward, abs=1e-9), own_ends)
    assert messages(exports, "to") == messages(wanted, "to")
    for of_export, of_scenario in zip(messages(exports, "from"), messages(wanted, "from"), strict=True):
        for robot, texts in of_export.items():
            # The first one was sent before the episode; the scenario has its first message instead.
            for text, own in zip(texts[1:], of_scenario[robot][1:], strict=False):
                cells, own_cells = ([float(cell) for cell in each.split(",")] for each in (text, own))
                assert cells == pytest.approx(own_cells, rel=1e-9, abs=1e-9)


def _actions(program: Any, seed: int, count: int, script: str | None) -> list[Any]:
    environment = api.build(program, engine="mujoco")
    environment.action_space.seed(seed)
    environment.reset(seed=seed)
    actions, has_ended = [], False
    while len(actions) < count and not has_ended:
        action = environment.action_space.sample() if script is None else environment.script(script)
        actions.append(np.asarray(action).tolist())
        _, _, terminated, truncated, _ = environment.step(action)
        has_ended = terminated or truncated
    return actions


@pytest.mark.slow
def test_an_exported_project_trains_on_its_supervisor(tmp_path: Path):
    exported("cartpole", tmp_path)
    (code,) = re.findall(
        r"(    from stable_baselines3 .*?)\n\n\|", (tmp_path / "README.md").read_text(), re.DOTALL
    )
    lines = ["from webots_environment import CartPoleEnvironment", textwrap.dedent(code)]
    run_supervisor(tmp_path, "\n".join(lines).replace("task)", "task, n_steps=64)").replace("100_000", "64"))


@pytest.mark.parametrize("name", FITTING)
def test_all_nodes_and_fields_exist_and_masses_are_those_of_the_scenario(name: str, tmp_path: Path):
    prepared = exported(name, tmp_path)
    world = read_world(world_of(tmp_path))
    simulation = simulation_of(world)
    assert list(world.findings) == []
    assert {robot.controller for robot in simulation.scene.robots} == {
        folder.name for folder in (tmp_path / "controllers").iterdir()
    }
    mass = sum(link.mass for robot in prepared.project.world.robots for link in robot.model.links)
    assert float(simulation.physics.model.body_mass.sum()) == pytest.approx(mass, rel=1e-5)


def test_bodies_stand_at_the_start_of_an_episode_before_the_first_reset(tmp_path: Path):
    exported("find_ball", tmp_path)
    simulation = simulation_of(read_world(world_of(tmp_path)))
    heights = {name: node(simulation, name).getPosition()[2] for name in ("BALL", "BOX")}
    assert heights == pytest.approx({"BALL": 0.07, "BOX": 0.15})


INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
ARM = """<robot name="arm">
  <link name="base"><inertial><mass value="2"/>{inertia}</inertial></link>
  <link name="mount"/>
  <link name="camera"><inertial><mass value="0.5"/>{inertia}</inertial></link>
  <link name="hand"><inertial><mass value="0.5"/>{inertia}</inertial></link>
  <joint name="foot" type="fixed"><parent link="base"/><child link="mount"/></joint>
  <joint name="neck" type="fixed"><parent link="mount"/><child link="camera"/></joint>
  <joint name="wrist" type="{type}"><parent link="mount"/><child link="hand"/><axis xyz="0 1 0"/>
    <limit {limits} effort="5" velocity="3"/></joint>
</robot>"""


def arm(
    folder: Path, *, type: str = "revolute", limits: str = 'lower="-1" upper="1"', name: str = "arm"
) -> str:
    """Write a scenario with a robot that has a link without mass between links with mass."""
    (folder / "arm.urdf").write_text(ARM.format(inertia=INERTIA, type=type, limits=limits))
    path = folder / "arm.yaml"
    unit = "m" if type == "prismatic" else "rad"
    path.write_text(
        f"""deepbots: 1
name: Arm
world: {{timestep: 32 ms}}
robots:
  {name}:
    urdf: arm.urdf
    sensors: {{wrist_position: {{type: joint_position, joint: wrist}}}}
    actuators: {{motor: {{type: velocity_motor, joints: [wrist]}}}}
    apply: {{motor: drive * 1 {unit}/s}}
action: {{drive: -1 .. 1}}
observation: {{{name}.wrist_position: -1 .. 1 {unit}}}
reward: {{upright: 1}}
truncation: {{max_steps: 20}}
"""
    )
    return str(path)


@pytest.mark.parametrize(
    ("base", "heavy"), [("free", {"ARM", "ARM__MOUNT", "ARM__CAMERA", "ARM__HAND"}), ("fixed", {"ARM__HAND"})]
)
def test_no_link_falls_off_a_link_without_physics(base: str, heavy: set[str], tmp_path: Path):
    exported(arm(tmp_path), tmp_path / "out", f"robots.arm.base={base}")
    scene = build_scene(read_world(tmp_path / "out" / "worlds" / "arm.wbt"))
    assert {node.name for node in walk(scene.nodes) if node.fields.get("physics")} == heavy


@pytest.mark.parametrize(
    ("type", "limits", "stops"),
    [
        ("prismatic", 'lower="-0.5" upper="inf"', "minStop -0.5\n maxStop 1000000"),
        ("prismatic", 'lower="0" upper="0"', "minStop 0\n maxStop 1e-06"),
        ("revolute", 'lower="0" upper="0"', "minStop 0\n maxStop 1e-06"),
        ("revolute", 'lower="-1" upper="2"', "minStop -1\n maxStop 2"),
    ],
)
def test_a_joint_stops_at_its_limits(type: str, limits: str, stops: str, tmp_path: Path):
    exported(arm(tmp_path, type=type, limits=limits), tmp_path / "out")
    assert stops in "\n".join(
        " " + line.strip() for line in (tmp_path / "out" / "worlds" / "arm.wbt").read_text().splitlines()
    )


def test_a_robot_does_not_overwrite_a_controller_of_the_project(tmp_path: Path):
    with pytest.raises(UsageError, match="has the name of supervisor: rename it"):
        exported(arm(tmp_path, name="supervisor"), tmp_path / "out")


def test_a_robot_called_robot_runs_the_class_of_its_scenario(tmp_path: Path):
    project = exported(arm(tmp_path, name="robot"), tmp_path / "out").project
    assert "use_message_data" in vars(project.controller_class(project.program.robots[0]))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("see_ball", "Cameras"),
        ("biped", "motors of Webots have no stiffness, and no torque that falls with their speed."),
        ("tag", "Several agents"),
        (
            "cartpole_wireless",
            "Delays, and other actuators that act in each physics step, cannot be exported.",
        ),
        ("panda_reach", "panda_joint4"),
    ],
)
def test_a_scenario_that_webots_cannot_express_is_refused_before_anything_is_written(
    name: str, reason: str, tmp_path: Path
):
    with pytest.raises(UsageError, match=reason):
        exported(name, tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_command_lists_differences_and_overwrites_nothing(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    folder = tmp_path / "out"
    words = ["export", "cartpole", "--to", "webots", "-o", str(folder)]
    summary = r'Push "it" to C:\new'
    assert main([*words, "--set", "fall_angle=10 deg", "--set", f"summary='{summary}'"]) == 0
    assert "differs in Webots: Messages take one timestep" in capfd.readouterr().err
    readme = (folder / "README.md").read_text()
    assert "Messages take one timestep" in readme
    assert f"\n{summary}\n" in readme
    module = ast.parse((folder / "controllers/supervisor/webots_environment.py").read_text())
    assert summary in [ast.get_docstring(entry) for entry in module.body if isinstance(entry, ast.ClassDef)]
    assert "0.17453292519943295" in (folder / "scenario/environment.py").read_text()
    (folder / "README.md").write_text("mine")
    assert main(words) != 0
    assert (folder / "README.md").read_text() == "mine"
    assert main([*words, "--force"]) == 0
    assert "Messages take one timestep" in (folder / "README.md").read_text()


@pytest.mark.slow
def test_a_robot_reports_a_message_of_another_layout(tmp_path: Path):
    prepared = exported("cartpole", tmp_path)
    path = tmp_path / "scenario/environment.py"
    text = path.read_text()
    path.write_text(text.replace("return (cart_joints[0][0],)", "return (cart_joints[0][0], 1.0)"))
    with pytest.raises(AssertionError, match="too many values"):
        run_exported(prepared, tmp_path, [[0, [0, 0, 0]]])
