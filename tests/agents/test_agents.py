"""Several agents in one world: the same world as with one agent that drives all robots, divided."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.compiler.inputs import RESOLVED_NAME, write_copies
from deepbots_cli.errors import UsageError
from deepbots_cli.rollout import Start
from deepbots_cli.rollout.drivers import named_driver
from deepbots_cli.runtime.agents import combined_action, seats_of
from tests.agents.carts import CARTS, OF_ONE, OF_TWO


def _noisy(carts: str) -> str:
    """Return the carts with noise of their sensors, and a parameter that each episode draws."""
    noisy = carts.replace("joint: pole_hinge}", "joint: pole_hinge, noise: 0.01 rad}")
    return noisy + "parameters: {push: uniform(0.5 .. 1)}\n"


SEVERAL = (
    _noisy(OF_TWO)
    + """\
agents:
  left:
    robots: [left]
    action: {drive: -1 .. 1}
    augment: {gap: apart, speed: velocity(left).x}
    observation: {left.angle: -1 .. 1 rad, gap: 0 .. 2 m, speed: -1 .. 1 m/s, previous_action: auto}
    reward: {upright: push * cos(left.angle), calm: -abs(delta(speed)) / (m/s)}
    scripts: {lean: {drive: 5 * left.angle / rad}}
    train:
      {algorithm: PPO, total_timesteps: 256, n_steps: 64, n_epochs: 1, batch_size: 32, network: {hidden: [8]}}
  right: {like: left, robots: [right]}
endings:
  left_fell:  {when: tilt(left.pole) > 30 deg, success: right, failure: left}
  right_fell: {when: tilt(right.pole) > 30 deg, success: left, failure: right}
"""
)
ONE = (
    _noisy(OF_ONE)
    + """\
action: {drive_left: -1 .. 1, drive_right: -1 .. 1}
augment:
  gap: apart
  speed_left: velocity(left).x
  speed_right: velocity(right).x
observation:
  left.angle: -1 .. 1 rad
  gap: 0 .. 2 m
  speed_left: -1 .. 1 m/s
  right.angle: -1 .. 1 rad
  speed_right: -1 .. 1 m/s
reward:
  upright_left: push * cos(left.angle)
  calm_left: -abs(delta(speed_left)) / (m/s)
  upright_right: push * cos(right.angle)
  calm_right: -abs(delta(speed_right)) / (m/s)
termination:
  failure:
    left_fell: tilt(left.pole) > 30 deg
    right_fell: tilt(right.pole) > 30 deg
"""
)


@pytest.fixture
def several(tmp_path: Path) -> Path:
    file = tmp_path / "several.yaml"
    file.write_text(SEVERAL)
    return file


def test_agents_see_and_earn_what_one_agent_that_drives_all_robots_does(
    several: Path, tmp_path: Path
) -> None:
    file = tmp_path / "one.yaml"
    file.write_text(ONE)
    with closing(api.make(several)) as world, closing(api.make(file)) as same:
        seats = seats_of(world)
        observed, _ = world.reset(seed=3)
        joint_observation, _ = same.reset(seed=3)
        generator = np.random.default_rng(0)
        for _ in range(60):
            left, right = generator.uniform(-1, 1, (2, 1)).astype(np.float32)
            observed, _, ended, cut, info = world.step(
                combined_action(world, seats, {"left": left, "right": right})
            )
            joint_observation, reward, other_ended, other_cut, other_info = same.step(
                np.concatenate([left, right])
            )
            assert seats["left"].observation(observed)[:3].tolist() == joint_observation[[0, 1, 2]].tolist()
            assert seats["right"].observation(observed)[:3].tolist() == joint_observation[[3, 1, 4]].tolist()
            assert seats["left"].observation(observed)[3] == left[0]
            terms = other_info["reward_terms"]
            assert seats["left"].reward(info) == terms["upright_left"] + terms["calm_left"]
            assert sum(seat.reward(info) for seat in seats.values()) == pytest.approx(reward)
            assert (ended, cut) == (other_ended, other_cut)
            if ended or cut:
                break


def test_an_ending_is_a_success_for_one_agent_and_a_failure_for_the_other(several: Path) -> None:
    with closing(api.make(several)) as world:
        seats = seats_of(world)
        world.reset(seed=3)
        info: dict[str, Any] = {}
        ended = False
        while not ended:
            actions = {"left": np.ones(1, np.float32), "right": np.zeros(1, np.float32)}
            _, _, ended, cut, info = world.step(combined_action(world, seats, actions))
            assert not cut
    assert info["ended_by"] == "left_fell"
    assert not seats["left"].info(info)["is_success"]
    assert seats["right"].info(info)["is_success"]


def test_the_environment_of_a_role_is_the_world_with_the_others_driven(several: Path) -> None:
    compiled = api.compile(several, overrides=["role.agent=left", "role.others.right=zero"])
    with closing(api.make(compiled)) as environment, closing(api.make(several)) as world:
        seats = seats_of(world)
        seen, _ = environment.reset(seed=5)
        observed, _ = world.reset(seed=5)
        assert seen.tolist() == seats["left"].observation(observed).tolist()
        for _ in range(10):
            action = environment.script("lean")
            actions = {"left": action, "right": np.zeros(1, np.float32)}
            observed, _, _, _, info = world.step(combined_action(world, seats, actions))
            seen, reward, _, _, own = environment.step(action)
            assert seen.tolist() == seats["left"].observation(observed).tolist()
            assert reward == seats["left"].reward(info)
            assert set(own["reward_terms"]) == {"upright", "calm"}


def test_a_random_agent_acts_the_same_in_a_repeated_episode(several: Path) -> None:
    compiled = api.compile(several, overrides=["role.agent=left", "role.others.right=random"])
    with closing(api.make(compiled)) as environment:
        tracks = []
        for _ in range(2):
            environment.reset(seed=8)
            tracks.append([environment.step(np.zeros(1, np.float32))[0].tolist() for _ in range(5)])
    assert tracks[0] == tracks[1]


def test_the_policy_of_a_role_is_trained_and_evaluated(several: Path, tmp_path: Path) -> None:
    compiled = api.compile(several, overrides=["role.agent=right"])
    result = deepbots_cli.train(compiled, run=tmp_path / "run")
    evaluation = deepbots_cli.evaluate(result.run, episodes=2)
    assert result.steps == 256
    assert evaluation.episodes == 2


def test_pettingzoo_accepts_the_environment(several: Path) -> None:
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
    from pettingzoo.utils import parallel_to_aec

    with closing(deepbots_cli.parallel_env(several)) as environment:
        parallel_api_test(environment, num_cycles=200)
        api_test(parallel_to_aec(environment), num_cycles=50)
    parallel_seed_test(lambda: deepbots_cli.parallel_env(several), num_cycles=10)


@pytest.mark.parametrize(
    ("setting", "headline"),
    [
        ("agents.right.robots=[left]", "`right` drives the robot `left`, which `left` drives too"),
        ("agents.left.robots=[middle]", "there is no robot `middle`"),
        ("agents.left.like=right", "mirrors itself"),
        ("agents.right.like=middle", "there is no agent `middle`"),
        ("endings.left_fell.success=middle", "there is no agent `middle`"),
        ("endings.left_fell.failure=all", "`left_fell` is a success and a failure of `right`"),
        (
            "endings.left_fell={when: apart < 1 m, success: right}",
            "does not say what it is for the agent `left`",
        ),
        ("role.agent=middle", "there is no agent `middle`"),
        ("agents.left.signals={apart: 1 m}", "`apart` of `left` is already a signal of all agents"),
        ("agents.left__b={like: left, robots: []}", "`left__b` cannot be the name of an agent"),
        ("agents.left_={like: left, robots: []}", "`left_` cannot be the name of an agent"),
        ("signals.left__drive=1 m", "`left__drive` is the name of `drive` of the agent `left`"),
        ("parameters.left__drive=1 m", "`left__drive` is the name of `drive` of the agent `left`"),
        ("robots.right.count=3", "a robot with copies together with several agents is not supported yet"),
        ("agents.right.each=right", "a robot with copies together with several agents"),
        ("agents.right.goal={achieved: apart}", "a `goal` together with several agents is not supported yet"),
        ("observation.gap=0 .. 1 m", "`observation` at the top level cannot be combined with `agents`"),
    ],
)
def test_a_mistake_about_agents_is_one_finding(several: Path, setting: str, headline: str) -> None:
    errors = [finding for finding in api.lint(several, overrides=[setting]) if finding.severity == "error"]
    assert len(errors) == 1
    assert headline in errors[0].headline


def test_a_batch_of_worlds_shows_what_single_worlds_show(several: Path) -> None:
    pytest.importorskip("mujoco")
    with closing(api.make_vec(several, 3)) as batch, closing(api.make(several, engine="mujoco")) as single:
        batch.reset(seed=[4, 5, 6])
        single.reset(seed=5)
        generator = np.random.default_rng(0)
        for _ in range(8):
            actions = generator.uniform(-1, 1, (3, 2)).astype(np.float32)
            seen = batch.step(actions)[0]
            assert seen[1].tolist() == single.step(actions[1])[0].tolist()


def test_the_options_of_a_command_replace_the_role_of_the_file(
    several: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    several.write_text(SEVERAL + "role: {agent: left, others: {right: zero}}\n")
    command = ["try", str(several), "--agent", "right", "--against", "left=lean", "--driver", "zero"]
    main([*command, "--episodes", "1", "--json"])
    (episode,) = json.loads(capsys.readouterr().out)["episodes"]
    assert episode["ended_by"] in ("left_fell", "right_fell", "max_steps")


@pytest.mark.parametrize("words", [["--against", "left=lean"], ["--agent", "right", "--against", "left"]])
def test_a_rival_without_an_agent_or_a_driver_is_a_wrong_use(several: Path, words: list[str]) -> None:
    assert main(["try", str(several), *words]) == 2


def test_a_run_of_a_mirrored_agent_has_the_learner_that_was_chosen_for_it(several: Path) -> None:
    several.write_text(SEVERAL.replace("    train: {", "    # {"))
    compiled = api.with_learner(api.compile(several, overrides=["role.agent=right"]))
    folder = several.parent / "run"
    folder.mkdir()
    write_copies(folder, compiled.resolved, compiled.inputs)
    assert compiled.program.agent.training is not None
    assert api.compile(folder / RESOLVED_NAME).digest == compiled.digest


def test_a_driver_lets_each_agent_act_by_its_script_of_this_name(several: Path) -> None:
    with closing(api.make(several)) as world:
        driver = named_driver(world, "lean")
        driver.begin(Start())
        observed, _ = world.reset(seed=3)
        for _ in range(5):
            expected = {name: seat.script("lean") for name, seat in seats_of(world).items()}
            action = driver.act(observed)
            assert action.tolist() == combined_action(world, seats_of(world), expected).tolist()
            observed, *_ = world.step(action)
        with pytest.raises(UsageError, match="the drivers are lean, random, zero"):
            named_driver(world, "nothing")


def test_a_value_that_the_robot_of_another_agent_sends_is_named_so(several: Path) -> None:
    several.write_text(
        SEVERAL.replace("gap: 0 .. 2 m, speed", "gap: 0 .. 2 m, right.angle: -1 .. 1 rad, speed")
    )
    (error,) = [finding for finding in api.lint(several) if finding.severity == "error"]
    assert error.headline == "`right` sends `angle` to its agent `right`, and not to `left`"


def test_a_setting_below_an_agent_may_add_the_section_of_its_training(tmp_path: Path) -> None:
    (tmp_path / "carts.yaml").write_text(CARTS, encoding="utf-8")
    compiled = api.compile(tmp_path / "carts.yaml", overrides=["agents.right.train.gamma=0.9"])
    training = compiled.program.members["right"].program.agent.training
    assert training is not None
    assert {entry.name: entry.value for entry in training.hyperparameters}["gamma"] == 0.9


def test_warnings_about_the_robot_file_of_a_package_are_left_out_for_several_agents(tmp_path: Path) -> None:
    robot = "urdf: package://pybullet_data/racecar/racecar.urdf"
    text = CARTS.replace("urdf: cartpole", robot).replace("pole_hinge", "left_steering_hinge_joint")
    text = text.replace("wheel_*", '"*_wheel_joint"').replace(".pole)", ".chassis)")
    (tmp_path / "cars.yaml").write_text(text, encoding="utf-8")
    assert "DB307" not in [finding.code for finding in api.lint(tmp_path / "cars.yaml")]
    assert [
        finding.severity for finding in api.lint(tmp_path / "cars.yaml") if finding.severity == "error"
    ] == []


def test_a_cost_of_a_shared_success_is_explained_by_the_endings_of_agents(tmp_path: Path) -> None:
    text = CARTS.replace("near: -0.1 * apart / m", "met: -10 when met").partition("endings:")[0]
    text += "termination: {success: {met: apart < 0.5 m}}\n"
    (tmp_path / "carts.yaml").write_text(text, encoding="utf-8")
    (finding,) = (each for each in api.lint(tmp_path / "carts.yaml") if each.code == "DB703")
    assert "write it under `endings`" in (finding.help or "")
    assert finding.fix is None
