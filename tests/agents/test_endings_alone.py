"""Endings that end the episode of one agent while others go on."""

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
from deepbots_cli.codegen import batch_obstacles
from deepbots_cli.errors import BatchError
from deepbots_cli.rollout import Start
from deepbots_cli.rollout.drivers import AgentsDriver
from deepbots_cli.rollout.episode import own_episode, result_of, steps
from deepbots_cli.runtime.agents import combined_action, seats_of
from tests.agents.carts import CARTS

ALONE = (
    CARTS.replace("success: right, failure: left}", "ends: left, failure: left}")
    .replace("success: left, failure: right}", "ends: right, failure: right}")
    .replace("near:", "fallen: -5 when terminated, near:")
)
PUSH = {"left": np.ones(1, np.float32), "right": np.zeros(1, np.float32)}


@pytest.fixture
def carts(tmp_path: Path) -> Path:
    file = tmp_path / "carts.yaml"
    file.write_text(ALONE)
    return file


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
    rows = _course(carts)
    assert rows[-1]["info"]["agent_endings"]["left"].endings == ("left_fell",)


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
    own = rows[-1]["infos"]["right"]
    assert own["ended_by"] in ("right_fell", "max_steps")
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
        driver = AgentsDriver(world, {"left": "ahead", "right": "zero"})
        episode = result_of(steps(world, driver, Start(3)), 0)
        left, right = (own_episode(member, episode) for member in world.scenario.members.values())
    assert left.ended_by == "left_fell"
    assert left.is_success is False
    assert right.ended_by == "right_fell"
    assert right.is_success is True
    assert left.length < right.length == episode.length
    assert left.total_return + right.total_return == pytest.approx(episode.total_return)


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
        assert outcome.done.tolist()[0] == 0
        assert info["ended_by"] == rows[-1]["info"]["ended_by"]


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


@pytest.mark.parametrize(
    ("setting", "headline"),
    [
        ("endings.left_fell.ends=middle", "there is no agent `middle`"),
        (
            "endings.left_fell.success=right",
            "`left_fell` is a success of `right`, whose episode it does not end",
        ),
        (
            "endings.left_fell={when: speed > 1 m/s, failure: all}",
            "`speed` is a name of each agent, but `left_fell` is an ending of all",
        ),
        ("endings.left_fell.ends=all", "`left_fell` does not say what it is for the agent `right`"),
        ("agents.right.reward={won: 1 when left_fell}", "`left_fell`"),
    ],
)
def test_a_mistake_about_endings_of_one_agent_is_one_finding(
    carts: Path, setting: str, headline: str
) -> None:
    errors = [finding for finding in api.lint(carts, overrides=[setting]) if finding.severity == "error"]
    assert len(errors) == 1
    assert headline in errors[0].headline


def test_try_shows_the_result_of_each_agent(carts: Path, capsys: pytest.CaptureFixture[str]) -> None:
    carts.write_text(
        ALONE.replace("ends: right, failure: right", "ends: right, success: right").replace(
            "tilt(right.pole) > 30 deg", "time > 1.5 s"
        )
    )
    assert main(["try", str(carts), "--driver", "ahead", "--episodes", "1", "--json"]) == 0
    (episode,) = json.loads(capsys.readouterr().out)["episodes"]
    assert episode["ended_by"] == "right_fell"


def test_an_agent_that_ends_before_others_trains_in_single_worlds(carts: Path) -> None:
    program = api.compile(carts, overrides=["role={agent: left}", "world.engine=mujoco"]).program
    assert batch_obstacles(program) == ["the episode of left may end before those of others"]
    with pytest.raises(BatchError, match="may end before those of others"):
        api.build_batch(program, 8, engine="mujoco")
