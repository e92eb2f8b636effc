"""Several agents in one world, without learning.

* Several agents in one world: the same world as with one agent that drives all robots, divided.
* An agent whose name is also a word of the language.
* Endings that end the episode of one agent while others go on.
* A limit that is a success.
* Messages from robot to robot.
* `previous_reward` and `episode_return` of one among several agents.
* The section `tests` of a scenario with several agents.
* The shipped scenarios with several agents, beside their own `tests`.
* The template `duel` of `deepbots new`: two equal robots with equal chances.
"""

from __future__ import annotations

import json
import re
from contextlib import closing
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.codegen import batch_obstacles
from deepbots_cli.compiler.agents import sections_of_agents
from deepbots_cli.compiler.inputs import RESOLVED_NAME, write_copies
from deepbots_cli.compiler.inventory import names_at
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import MappingNode, Node, to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import BatchError, UsageError
from deepbots_cli.rollout import Start
from deepbots_cli.rollout.drivers import AgentsDriver, named_driver
from deepbots_cli.rollout.episode import own_episode, result_of, steps
from deepbots_cli.runtime.agents import combined_action, seats_of
from tests.agents.carts import CARTS, OF_ONE, OF_TWO, scenario_fixture, write_scenario
from tests.commands import Deepbots
from tests.few import few
from tests.files import written
from tests.golden.cases import mistakes


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


MIRRORED = """\
robots: [{me}]
action: {{{me}_gas: -1 .. 1}}
augment: {{seen: position({me}).x, {me}_heard: "hold(2 * ({other}_end), message_received ({other}))"}}
observation: {{{me}_heard: {{range: 0 .. 5 m}}, previous_action: auto, {me}.{other}_near: auto}}
reward: {{near: previous_action.{me}_gas * {me}_goal}}
solved: success_rate >= 0.9 over 50 episodes
train: {{algorithm: PPO, network: {{hidden: [8], activation: tanh}}, symmetry: {{swap: {{{me}: {other}}}}}}}
"""
"""The section of an agent, which an agent `other` mirrors."""


@pytest.mark.parametrize(
    "name", ["red", "action", "range", "success", "previous", "message", "position", "x", "tanh"]
)
def test_an_agent_may_have_a_name_that_is_also_a_word_of_the_language(name: str) -> None:
    agents = {name: to_data(_section(name, "other")), "other": {"like": name, "robots": ["other"]}}
    root = parse(Source("agents.yaml", json.dumps({"agents": agents})), Findings())
    assert isinstance(root, MappingNode)
    mirrored = to_data(sections_of_agents(root)["other"])
    assert mirrored == to_data(_section("other", name))


def _section(me: str, other: str) -> Node:
    root = parse(Source("section.yaml", MIRRORED.format(me=me, other=other)), Findings())
    assert root is not None
    return root


several = scenario_fixture(SEVERAL)


def test_agents_see_and_earn_what_one_agent_that_drives_all_robots_does(
    several: Path, tmp_path: Path
) -> None:
    file = written(tmp_path / "one.yaml", ONE)
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
            assert (reward, set(own["reward_terms"])) == (seats["left"].reward(info), {"upright", "calm"})


def test_the_options_of_a_command_replace_the_role_of_the_file(
    several: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    several.write_text(SEVERAL + "role: {agent: left, others: {right: zero}}\n")
    command = ["try", str(several), "--agent", "right", "--against", "left=lean", "--driver", "zero"]
    main([*command, "--episodes", "1", "--json"])
    (episode,) = json.loads(capsys.readouterr().out)["episodes"]
    assert episode["ended_by"] in ("left_fell", "right_fell", "max_steps")


@pytest.mark.parametrize(
    "words",
    [
        ["--against", "left=lean"],
        ["--agent", "right", "--against", "left"],
        ["--agent", "right", "--against", "left="],
        ["--agent", "right", "--against", "=lean"],
        ["--agent", "right", "--against", "left=lean", "--against", "left=zero"],
    ],
)
def test_a_rival_without_an_agent_or_a_driver_is_a_wrong_use(several: Path, words: list[str]) -> None:
    assert main(["try", str(several), *words]) == 2


def test_a_rival_whose_name_is_an_emoji_is_named_in_the_finding(several: Path, deepbots: Deepbots) -> None:
    assert (
        "there is no driver of `left` `🤖`"
        in deepbots("try", several, "--agent", "right", "--against", "left=🤖", code=1).err
    )


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


def test_scripts_of_agents_act_in_turn_as_alone(several: Path) -> None:
    with closing(api.make(several)) as world:
        (alone, in_turn) = (
            [
                step.observation.tolist()
                for step in islice(steps(world, named_driver(world, text), Start(3)), 9)
            ]
            for text in ("lean", "lean*3,lean")
        )
        assert alone == in_turn


def test_a_setting_below_an_agent_may_add_the_section_of_its_training(tmp_path: Path) -> None:
    (tmp_path / "carts.yaml").write_text(CARTS, encoding="utf-8")
    compiled = api.compile(tmp_path / "carts.yaml", overrides=["agents.right.train.gamma=0.9"])
    training = compiled.program.members["right"].program.agent.training
    assert training is not None
    assert {entry.name: entry.value for entry in training.hyperparameters}["gamma"] == 0.9


def test_a_case_changes_the_actuator_of_each_agent(carts: Path) -> None:
    case = "evaluation: {cases: {weak: {set: {robots.right.actuators.wheels.max_velocity: 2 rad/s}}}}\n"
    carts.write_text(carts.read_text() + case)
    program = api.compile(carts).program
    limits = [
        {robot.name: robot.actuators[0].max_velocity[0] for robot in variant.robots}
        for variant in (program, program.variant("weak", None))
    ]
    assert limits[1] == {**limits[0], "right": 2.0}


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


ALONE = (
    CARTS.replace("success: right, failure: left}", "ends: left, failure: left}")
    .replace("success: left, failure: right}", "ends: right, failure: right}")
    .replace("near:", "fallen: -5 when terminated, near:")
)
PUSH = {"left": np.ones(1, np.float32), "right": np.zeros(1, np.float32)}


carts = scenario_fixture(ALONE)


def _course(file: Path, **options: Any) -> list[dict[str, Any]]:
    """Return the rows of an episode in which the left cart drives ahead and the right one does not move."""
    rows = []
    with closing(api.make(file, **options)) as world:
        seats = seats_of(world)
        world.reset(seed=3)
        ended = cut = False
        while not (ended or cut):
            _, _, ended, cut, info = world.step(combined_action(world, seats, PUSH))
            rows.append(
                {
                    "info": info,
                    "rewards": {name: seat.reward(info) for name, seat in seats.items()},
                    "infos": {name: seat.info(info) for name, seat in seats.items()},
                    "ended": ended,
                    "cut": cut,
                }
            )
    return rows


def test_an_ending_of_one_agent_may_use_its_names(carts: Path) -> None:
    carts.write_text(ALONE.replace("tilt(left.pole) > 30 deg", "speed > 3 cm/s"))
    assert _course(carts)[-1]["info"]["agent_endings"]["left"].endings == ("left_fell",)


def test_an_agent_ends_while_the_other_goes_on(carts: Path) -> None:
    rows = _course(carts)
    last = next(number for number, row in enumerate(rows) if row["info"]["agent_endings"])
    assert set(rows[last]["info"]["agent_endings"]) == {"left"}
    assert not rows[last]["ended"]
    assert rows[last]["infos"]["left"]["ended_by"] == "left_fell"
    assert rows[last]["infos"]["left"]["reward_terms"]["fallen"] == -5
    assert rows[last]["infos"]["right"]["ended_by"] is None
    assert all(row["rewards"]["left"] == 0 for row in rows[last + 1 :])
    assert all(row["rewards"]["right"] > 0 for row in rows[last + 1 :][:-1])
    assert len(rows) > last + 2
    assert rows[-1]["infos"]["right"]["ended_by"] in ("right_fell", "max_steps")
    assert rows[-1]["infos"]["left"]["ended_by"] == "left_fell"


def test_the_world_ends_with_its_last_agent(carts: Path) -> None:
    carts.write_text(ALONE.replace("tilt(right.pole) > 30 deg", "time > 1.5 s"))
    rows = _course(carts)
    assert rows[-1]["ended"]
    assert rows[-1]["info"]["ended_by"] == "right_fell"
    assert {name: end.endings for name, end in rows[-1]["info"]["agent_endings"].items()} == {
        "left": ("left_fell",),
        "right": ("right_fell",),
    }


def test_the_robots_of_an_agent_that_has_ended_stop(carts: Path) -> None:
    carts.write_text(ALONE.replace("tilt(left.pole) > 30 deg", "velocity(left).x > 3 cm/s"))
    with closing(api.make(carts)) as world:
        seats = seats_of(world)
        world.reset(seed=3)
        speeds = []
        ended = False
        while not ended:
            observed, _, ended, cut, _ = world.step(combined_action(world, seats, PUSH))
            ended = ended or cut
            speeds.append(float(seats["left"].observation(observed)[1]))
    assert max(speeds) > 0.03
    assert abs(speeds[-1]) < 0.01


def test_an_episode_of_each_agent_has_its_own_length_and_result(carts: Path) -> None:
    carts.write_text(
        ALONE.replace("ends: right, failure: right", "ends: right, success: right").replace(
            "tilt(right.pole) > 30 deg", "time > 1.5 s"
        )
    )
    with closing(api.make(carts)) as world:
        episode = result_of(
            steps(world, AgentsDriver(world, {"left": "ahead", "right": "zero"}), Start(3)), 0
        )
        left, right = (own_episode(member, episode) for member in world.scenario.members.values())
    assert left.ended_by == "left_fell"
    assert left.is_success is False
    assert right.ended_by == "right_fell"
    assert right.is_success is True
    assert left.length < right.length == episode.length
    assert left.total_return + right.total_return == pytest.approx(episode.total_return)


def test_two_agents_that_fail_in_one_step_have_both_failed(carts: Path) -> None:
    out = "{when: time > 0.1 s, success: %s, failure: %s}"
    endings = f"{{red_out: {out % ('blue', 'red')}, blue_out: {out % ('red', 'blue')}}}"
    carts.write_text(f"deepbots: 1\nextends: sumo\nname: Tie\nendings: {endings}\nremove: [endings]\n")
    with closing(api.make(carts)) as world:
        episode = result_of(steps(world, AgentsDriver(world, {"red": "zero", "blue": "zero"}), Start(3)), 0)
        assert sorted(episode.endings) == ["blue_out", "red_out"]
        members = world.scenario.members.values()
        assert not any(own_episode(member, episode).is_success for member in members)


def test_the_episode_of_a_role_ends_with_its_agent(carts: Path) -> None:
    role = ["role={agent: left, others: {right: zero}}"]
    with closing(api.make(api.compile(carts, overrides=role))) as environment:
        environment.reset(seed=3)
        ended = False
        number = 0
        while not ended:
            _, _, ended, cut, info = environment.step(PUSH["left"])
            number += 1
            assert not cut
        assert info["ended_by"] == environment.ended_by == "left_fell"
    alone = next(row for row in _course(carts) if row["info"]["agent_endings"])
    assert alone["info"]["agent_endings"]["left"].step == number


@pytest.mark.parametrize("repeat", ["", "agent: {action_repeat: 3}\n"])
def test_a_batch_ends_agents_as_single_worlds_do(carts: Path, repeat: str) -> None:
    pytest.importorskip("mujoco")
    text = ALONE.replace("tilt(right.pole) > 30 deg", "time > 1.5 s") + repeat
    carts.write_text(text.replace("upright: cos", "upright: 0.1 * previous_reward + cos"))
    rows = _course(carts, engine="mujoco")
    with closing(api.make_vec(carts, 2)) as vector:
        batch = vector.batch
        batch.reset([3, 5])
        for row in rows:
            outcome = batch.advance(np.array([[1.0, 0.0], [0.0, 0.0]], np.float32))
            assert outcome.rewards[0] == pytest.approx(sum(row["rewards"].values()), rel=1e-12)
            assert bool(outcome.terminated[0]) == row["ended"]
            info = batch.info(0)
            assert info["agent_endings"] == row["info"]["agent_endings"]
        assert (outcome.done.tolist()[0], info["ended_by"]) == (0, rows[-1]["info"]["ended_by"])


def test_an_agent_leaves_the_environment_of_pettingzoo(carts: Path) -> None:
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    with closing(deepbots_cli.parallel_env(carts)) as environment:
        parallel_api_test(environment, num_cycles=200)
        environment.reset(seed=3)
        seen = []
        while environment.agents:
            acting = list(environment.agents)
            results = environment.step({name: PUSH[name] for name in acting})
            assert all(set(result) == set(acting) for result in results)
            seen.append((acting, results[2], results[3]))
    both, alone = [each for each in seen if len(each[0]) == 2], [each for each in seen if len(each[0]) == 1]
    assert both[-1][1] == {"left": True, "right": False}
    assert alone
    assert {name for acting, *_ in alone for name in acting} == {"right"}
    parallel_seed_test(lambda: deepbots_cli.parallel_env(carts), num_cycles=10)


def test_an_agent_that_ends_before_others_trains_in_single_worlds(carts: Path) -> None:
    program = api.compile(carts, overrides=["role={agent: left}", "world.engine=mujoco"]).program
    assert batch_obstacles(program) == ["the episode of left may end before those of others"]
    with pytest.raises(BatchError, match="may end before those of others"):
        api.build_batch(program, 8, engine="mujoco")


ONE_CARTPOLE = "deepbots: 1\nextends: cartpole\nname: One\n"
LIMITED = CARTS.replace("{max_steps: 60}", "{max_steps: {limit: 3, success: right}}")


limited_carts = scenario_fixture(LIMITED)


def _last_info(file: Path) -> tuple[dict[str, object], dict[str, bool]]:
    with closing(api.make(file)) as world:
        world.reset(seed=0)
        for _ in range(3):
            _, _, ended, cut, info = world.step(np.zeros(2, np.float32))
        assert cut
        assert not ended
        return info, {name: seat.info(info)["is_success"] for name, seat in seats_of(world).items()}


def test_a_limit_is_a_success_of_the_agents_that_it_names(limited_carts: Path) -> None:
    info, successes = _last_info(limited_carts)
    assert info["ended_by"] == "max_steps"
    assert not info["is_success"]
    assert successes == {"left": False, "right": True}
    limited_carts.write_text(LIMITED.replace("success: right}}", "success: all}}"))
    info, successes = _last_info(limited_carts)
    assert info["is_success"]
    assert successes == {"left": True, "right": True}


@pytest.mark.parametrize(
    "limits",
    ["{max_steps: {limit: 2, success: all}}", "{max_steps: 2, max_time: {limit: 64 ms, success: all}}"],
)
def test_one_agent_succeeds_at_a_limit_also_beside_an_equal_one(tmp_path: Path, limits: str) -> None:
    overrides = [f"truncation={limits}"]
    with closing(api.make(write_scenario(tmp_path, ONE_CARTPOLE), overrides=overrides)) as world:
        world.reset(seed=0)
        for _ in range(2):
            *_, info = world.step(0)
        assert info["is_success"]


HEARING = (
    CARTS.replace(
        "  left:\n    urdf: cartpole\n", "  left:\n    urdf: cartpole\n    hear: {mate: right.angle}\n"
    )
    .replace("  right:\n    urdf: cartpole\n", "  right:\n    urdf: cartpole\n    hear: {mate: left.angle}\n")
    .replace("speed: -1 .. 1 m/s}", "speed: -1 .. 1 m/s, left.mate: -1 .. 1 rad}")
)


hearing_carts = scenario_fixture(HEARING)


def _observed(file: Path, steps: int = 12, engine: str | None = None) -> list[dict[str, list[float]]]:
    """Return what each agent sees after the reset and after each step."""
    with closing(api.make(file, engine=engine)) as world:
        seats = seats_of(world)
        seen = [world.reset(seed=3)[0]]
        seen += [world.step(combined_action(world, seats, PUSH))[0] for _ in range(steps)]
        return [{name: seat.observation(each).tolist() for name, seat in seats.items()} for each in seen]


@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
def test_an_agent_sees_what_its_robot_heard_a_timestep_ago(hearing_carts: Path, engine: str) -> None:
    pytest.importorskip("mujoco")
    seen = _observed(hearing_carts, engine="mujoco" if engine == "mujoco" else None)
    for name, other in (("left", "right"), ("right", "left")):
        heard = [each[name][2] for each in seen]
        measured = [each[other][0] for each in seen]
        assert heard[0] == measured[0]  # the first message arrives with the reset
        assert heard[1:] == measured[:-1]
        assert len(set(heard)) > 5


def test_a_latency_delays_and_a_range_cuts_the_messages(hearing_carts: Path) -> None:
    hearing_carts.write_text(HEARING + "messages: {between_robots: {latency: 64 ms}}\n")
    seen = _observed(hearing_carts)
    assert [each["left"][2] for each in seen[3:]] == [each["right"][0] for each in seen[:-3]]
    hearing_carts.write_text(
        HEARING + "messages: {between_robots: {range: 50 cm}}\n"
    )  # the carts are 1 m apart
    seen = _observed(hearing_carts)
    assert {each["left"][2] for each in seen} == {seen[0]["right"][0]}
    hearing_carts.write_text(HEARING + "messages: {between_robots: {range: 50 cm, on_loss: zero}}\n")
    assert {each["left"][2] for each in _observed(hearing_carts)[2:]} == {0.0}


def test_losses_are_drawn_for_each_pair_and_repeat_with_the_seed(hearing_carts: Path) -> None:
    hearing_carts.write_text(
        HEARING.replace("> 30 deg", "> 170 deg")
        + "messages: {between_robots: {loss: 50 %, latency: uniform(0 .. 50 ms) each step}}\n"
    )
    first, second = _observed(hearing_carts, 40), _observed(hearing_carts, 40)
    assert first == second
    repeated = [a["left"][2] == b["left"][2] for a, b in pairwise(first)]
    of_the_other_robot = [a["right"][2] == b["right"][2] for a, b in pairwise(first)]
    assert 5 < sum(repeated) < 36
    assert repeated != of_the_other_robot


def test_a_robot_of_the_same_agent_is_heard_too(tmp_path: Path) -> None:
    file = written(
        tmp_path / "one.yaml",
        "deepbots: 1\nextends: cartpole\nname: Pair\nmessages: {format: struct}\n"
        "robots:\n  cart: {hear: {other_angle: other.lean}}\n"
        "  other:\n    urdf: cartpole\n    pose: {y: 30 cm}\n"
        "    sensors: {lean: {type: joint_position, joint: pole_hinge}}\n"
        "observation: {cart.other_angle: -20 .. 20 deg}\n"
        "reset: {joints: {other.pole_hinge: 3 deg}}\n",
    )
    with closing(api.make(file)) as world:
        observed, _ = world.reset(seed=0)
        assert observed[-1] == pytest.approx(3 / 20, rel=1e-5)


def test_an_agent_learns_and_lint_has_no_doubts(hearing_carts: Path, tmp_path: Path) -> None:
    # DB708 says that falling ends the payments, which is the point here.
    assert {finding.code for finding in api.lint(hearing_carts)} <= {"DB708"}
    hearing_carts.write_text(
        HEARING + "train: {algorithm: PPO, total_timesteps: 128, n_steps: 64, n_epochs: 1, batch_size: 32}\n"
    )
    assert deepbots_cli.train(hearing_carts, run=tmp_path / "run", seed=0).steps == 128
    pytest.importorskip("onnx")
    folder = tmp_path / "bundle"
    assert main(["export", str(tmp_path / "run"), "--agent", "left", "-o", str(folder)]) == 0
    inputs = {entry["name"]: entry for entry in json.loads((folder / "bundle.json").read_text())["inputs"]}
    assert inputs["left.mate"]["supplied_by"] == "messages of right"
    assert inputs["left.mate"]["latency_s"] == 0.032
    assert "left.mate: another robot sends this" in (folder / "README.md").read_text()


OBSERVED = (
    CARTS.replace(
        "speed: -1 .. 1 m/s}", "speed: -1 .. 1 m/s, previous_reward: -10 .. 10, earned: -100 .. 100}"
    )
    .replace("augment: {", "augment: {earned: episode_return, ")
    .replace("near:", "more: 0.1 * previous_reward, near:")
    .replace("ahead: {drive: 1}", "ahead: {drive: 0.1 * previous_reward}")
)


@pytest.mark.parametrize("repeat", ["", "agent: {action_repeat: 3}\n"])
def test_an_agent_sees_its_own_rewards(tmp_path: Path, repeat: str) -> None:
    file = write_scenario(tmp_path, OBSERVED + repeat)
    with closing(api.make(file)) as world:
        world.reset(seed=1)
        seats = seats_of(world)
        generator = np.random.default_rng(0)
        earned, last = dict.fromkeys(seats, 0.0), dict.fromkeys(seats, 0.0)
        for _ in range(5):
            observed, _, _, _, info = world.step(generator.uniform(-1, 1, 2).astype(np.float32))
            for name, seat in seats.items():
                reward = seat.reward(info)
                *_, seen, total = seat.observation(observed)
                assert seen == pytest.approx(reward / 10, rel=1e-5)
                if not repeat:  # within a step of several timesteps, the return grows in each of them
                    assert total == pytest.approx(earned[name] / 100, abs=1e-6)
                assert seat.script("ahead")[0] == pytest.approx(min(1.0, 0.1 * reward), rel=1e-5)
                more = seat.info(info)["reward_terms"]["more"]
                assert more == pytest.approx(0.1 * last[name] * (3 if repeat else 1))
                earned[name] += reward
                last[name] = reward


TESTS = """\
tests:
  left_falls:
    driver: {left: ahead, right: zero}
    episodes: 3
    expect: {failure_rate: 100 %, ends_by: left_fell, eventually: speed > 10 cm/s}
  right_wins:
    agent: right
    driver: {left: ahead, right: zero}
    expect: {success_rate: 100 %, always: abs(speed) < 20 cm/s}
  both_lean:
    driver: lean
    max_steps: 5
    expect: {always: not left_fell and apart < 2 m}
  pushed:
    agent: right
    actions: [{right: 1}, {left: {drive: -1}, right: {drive: 1}}, {left: 1}]
    expect: {eventually: speed > 1 cm/s}
"""


tested_carts = scenario_fixture(CARTS + TESTS)


def test_a_test_expects_the_results_of_one_agent(tested_carts: Path, deepbots: Deepbots) -> None:
    assert not [finding for finding in api.lint(tested_carts) if finding.severity == "error"]
    (scenario,) = json.loads(deepbots("test", tested_carts, "--json").out)["scenarios"]
    assert [test["test"] for test in scenario["tests"]] == ["left_falls", "right_wins", "both_lean", "pushed"]
    assert [test["steps"] for test in scenario["tests"]][2:] == [5, 3]


def test_a_step_of_a_test_is_offered_the_agents_and_below_each_its_actions(tested_carts: Path) -> None:
    checked, step = api.load(tested_carts), ("tests", "pushed", "actions", 1)
    places = [("action", step), ("option", step), ("choice", (*step, "left")), ("option", (*step, "left"))]
    offered = [[entry.name for entry in names_at(checked, *place)] for place in places]
    assert offered == [["left", "right"], [], ["drive"], []]


def test_a_failed_test_shows_the_command_with_both_drivers(tested_carts: Path, deepbots: Deepbots) -> None:
    tested_carts.write_text((CARTS + TESTS).replace("success_rate: 100 %", "success_rate: 0 .. 10 %"))
    (scenario,) = json.loads(deepbots("test", tested_carts, "-k", "right_wins", "--json", code=1).out)[
        "scenarios"
    ]
    ((miss,),) = [test["misses"] for test in scenario["tests"]]
    assert miss["measured"].startswith("1 of 1 episodes")
    words = miss["command"].split()
    assert words[:2] == ["deepbots", "view"]
    (episode,) = json.loads(deepbots("try", *words[2:-2], "--episodes", "1", "--json").out)["episodes"]
    assert episode["ended_by"] == "left_fell"
    assert episode["success"]


def test_a_failed_sequence_of_actions_is_repeated_by_its_command(
    tested_carts: Path, deepbots: Deepbots
) -> None:
    tested_carts.write_text((CARTS + TESTS).replace("speed > 1 cm/s", "speed > 1 m/s"))
    (scenario,) = json.loads(deepbots("test", tested_carts, "-k", "pushed", "--json", code=1).out)[
        "scenarios"
    ]
    ((miss,),) = [test["misses"] for test in scenario["tests"]]
    assert "--driver=0:1,-1:1,1:0 --steps 3" in miss["command"]
    deepbots(*miss["command"].split()[1:])


def test_an_agent_may_have_the_name_of_a_column(tested_carts: Path, deepbots: Deepbots) -> None:
    tested_carts.write_text(re.sub(r"\bleft\b", "length", re.sub(r"\bright\b", "success", CARTS)))
    _, columns, _, row = deepbots(
        "try", tested_carts, "--driver", "zero", "--episodes", "1", "--steps", "3"
    ).out.splitlines()[:4]
    assert columns.split("  ")[1:] == [
        "episode",
        "return of length",
        "return of success",
        "length",
        "ended_by",
        "success",
    ]
    assert (row.split()[0], row.split()[3]) == ("0", "3")


def test_tests_of_a_file_with_a_role_are_about_all_agents(tested_carts: Path) -> None:
    tested_carts.write_text(CARTS + TESTS + "role: {agent: right}\n")
    assert main(["test", str(tested_carts)]) == 0


MISTAKEN = {
    "several": SEVERAL,
    "ends": ALONE,
    "limit": LIMITED,
    "hears": HEARING,
    "tests": CARTS + TESTS,
    "one": ONE_CARTPOLE,
}
"""The scenarios that mistakes about agents are made in."""


@pytest.mark.parametrize(("name", "change", "headline"), mistakes("agents"))
def test_a_mistake_about_agents_is_one_finding(
    tmp_path: Path, name: str, change: str | list[str], headline: str
) -> None:
    settings = [change] if isinstance(change, str) else []
    text = MISTAKEN[name] if isinstance(change, str) else MISTAKEN[name].replace(*change, 1)
    assert settings or text != MISTAKEN[name]
    file = write_scenario(tmp_path, text)
    errors = [each.headline for each in api.lint(file, overrides=settings) if each.severity == "error"]
    assert len(errors) == 1
    assert headline in errors[0]


def test_in_sumo_both_agents_observe_the_same_from_their_own_side() -> None:
    with closing(deepbots_cli.parallel_env("sumo")) as environment:
        draws = {"away": 0.2, "aside": 0.1, "reset.place.red.yaw": 0.3, "reset.place.blue.yaw": 0.3 + np.pi}
        observed, _ = environment.reset(seed=0, options=draws)
        assert observed["red"] == pytest.approx(observed["blue"], abs=1e-3)


def test_the_state_before_the_first_reset_is_a_usage_error() -> None:
    environment = deepbots_cli.parallel_env("sumo")
    with closing(environment), pytest.raises(UsageError, match=r"call reset\(\) before state\(\)"):
        environment.state()


@pytest.mark.parametrize("scenario", few(["tag", "carry", "sumo"], ["tag"]))
@pytest.mark.filterwarnings("ignore:We recommend agents to be named")
def test_the_tests_of_pettingzoo_pass(scenario: str) -> None:
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, render_test
    from pettingzoo.utils import parallel_to_aec

    with closing(deepbots_cli.parallel_env(scenario)) as environment:
        parallel_api_test(environment, num_cycles=20)
        api_test(parallel_to_aec(environment), num_cycles=10)
    parallel_seed_test(lambda: deepbots_cli.parallel_env(scenario), num_cycles=5)
    with pytest.warns(RuntimeWarning, match="there is no display"):
        render_test(
            lambda render_mode: parallel_to_aec(deepbots_cli.parallel_env(scenario, render_mode=render_mode))
        )


@pytest.mark.filterwarnings("ignore:there is no display")
def test_a_window_is_not_as_large_as_a_matplotlibrc_says() -> None:
    parallel = pytest.importorskip("deepbots_cli.runtime.parallel")  # it imports PettingZoo
    from matplotlib import pyplot

    with pyplot.rc_context({"figure.dpi": 100_000}), closing(parallel.Window("Duel", 0.1)):
        assert (pyplot.gcf().dpi, pyplot.rcParams["figure.dpi"]) == (100, 100_000)


MATCHES = 200


def _drive(seen: np.ndarray) -> np.ndarray:
    """Return the action of the script `drive`, given what an agent sees in all matches."""
    angle = 180.0 * seen[:, 1]
    gas = np.where(np.abs(angle) < 60.0, 1.0, -2.0 / 3.0)
    return np.stack([gas, np.clip(angle / 45.0, -1.0, 1.0)], axis=1)


@pytest.mark.slow
def test_neither_of_two_equal_drivers_has_an_advantage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine", "--template", "duel", "--json"]) == 0
    program = api.compile("mine.yaml").program
    columns = [list(member.columns) for member in program.members.values()]
    winners: dict[int, tuple[str, ...]] = {}
    with closing(api.build_batch(program, MATCHES)) as batch:
        seen = batch.reset(range(MATCHES))
        assert seen[:, columns[0]][:, 0] == pytest.approx(seen[:, columns[1]][:, 0], abs=1e-6)
        for _ in range(round(20 / program.period)):
            actions = np.concatenate([_drive(seen[:, own]) for own in columns], axis=1)
            outcome = batch.step(actions.astype(np.float32))
            for world, info in zip(outcome.done.tolist(), outcome.infos, strict=True):
                winners.setdefault(world, info["endings"])
            seen = outcome.observations
            if len(winners) == MATCHES:
                break
    wins = [list(winners.values()).count((name,)) for name in ("red_first", "blue_first")]
    assert sum(wins) > 0.7 * MATCHES
    assert abs(wins[0] - wins[1]) < 3 * MATCHES**0.5  # three standard deviations
