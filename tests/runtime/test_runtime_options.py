"""`reset(options={...})`: values of an episode in place of draws."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.errors import EvaluationError, UsageError
from deepbots_cli.program import Program
from deepbots_cli.rollout.source import Source
from deepbots_cli.runtime import Supervisor
from deepbots_cli.view.frames import FrameReader
from tests.contract.rollout import as_bytes
from tests.few import LIGHT, few
from tests.worlds import SCENARIOS, Make

SECTIONS = """\
parameters:
  stride: 0.02 m
  mark: uniform(-0.5 -0.2 .. 0.6 0.2 m)
  twice: 2 * mark.x
  side: choice(-1 | 1)
  push: choice(-1 | 1) * uniform(1 .. 2)
  crates: integer(1 .. 4)
  noisy: uniform(0 .. 1) each step
reset:
  joints: {cart.slider: uniform(-1 .. 1 m), cart.hinge: {position: 0 rad, velocity: uniform(-1 .. 1 rad/s)}}
reward:
  x: mark.x / 1 m
  y: mark.y / 1 m
  twice: twice / 1 m
  side: side
  push: push
  crates: crates
  noisy: noisy
  stride: stride / 1 m
  lean: joint_position(cart.hinge) / 1 rad
"""


@pytest.fixture
def env(small: Make) -> Supervisor:
    return small(SECTIONS)


def drawn_rewards(env: Any, **reset: Any) -> dict[str, float]:
    """The values of the episode that a reset begins, by their terms of the reward."""
    observation, _ = env.reset(**reset)
    place = float(observation[0]) * 2.4
    *_, info = env.step(env.action_space.sample() * 0)
    return {**info["reward_terms"], "place": place}


def test_reset_options_set_a_drawn_parameter_and_a_vector(env: Supervisor) -> None:
    values = drawn_rewards(env, seed=1, options={"mark": [0.6, 0], "side": -1, "crates": 3})
    assert (values["x"], values["y"], values["side"], values["crates"]) == (0.6, 0.0, -1.0, 3.0)


def test_what_is_computed_from_a_value_that_was_set_follows_it(env: Supervisor) -> None:
    assert drawn_rewards(env, options={"mark": (0.25, 0.1)})["twice"] == 0.5


def test_reset_options_set_joints_by_their_path(env: Supervisor) -> None:
    assert drawn_rewards(env, options={"reset.joints.cart.slider": 0.5})["place"] == pytest.approx(0.5)
    assert drawn_rewards(env, options={"reset.joints.cart.hinge.velocity": -0.75})["lean"] == pytest.approx(
        -0.75 * 0.02, rel=0.1
    )


def test_other_draws_of_this_episode_and_of_later_ones_stay_as_they_are(env: Supervisor) -> None:
    plain = [drawn_rewards(env, seed=5), drawn_rewards(env), drawn_rewards(env)]
    some = [
        drawn_rewards(env, seed=5, options={"mark": [0.6, 0], "crates": 2}),
        drawn_rewards(env, options={"side": 1}),
        drawn_rewards(env),
    ]
    for name in ("push", "place", "noisy"):
        assert [values[name] for values in some] == [values[name] for values in plain]
    assert some[2] == plain[2]


def test_a_value_that_is_drawn_in_each_step_keeps_what_was_set_through_the_episode(env: Supervisor) -> None:
    env.reset(options={"noisy": 0.5})
    assert {env.step(env.action_space.sample() * 0)[4]["reward_terms"]["noisy"] for _ in range(5)} == {0.5}


def test_what_was_set_counts_for_one_episode(env: Supervisor) -> None:
    env.reset(seed=2, options={"mark": [0.6, 0]})
    assert drawn_rewards(env)["x"] != 0.6


def test_a_limit_as_a_float32_is_that_limit(env: Supervisor) -> None:
    assert drawn_rewards(env, options={"mark": np.array([0.6, 0.2], np.float32)})["x"] == 0.6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"marc": [0.6, 0]},
            r"'marc': did you mean 'mark'\? Small draws 'mark', 'mark\.x', 'mark\.y', 'side',"
            r" .*'reset\.joints\.cart\.slider'",
        ),
        ({"stride": 0.1}, r"'stride': it is a fixed parameter.*by overrides=\['stride=\.\.\.'\]"),
        ({"twice": 0.1}, "'twice': it is computed from other parameters; set those"),
        ({"mark": [0.7, 0]}, r"'mark\.x' to 0\.7: it is drawn from -0\.5 to 0\.6"),
        ({"mark": 0.6}, r"'mark' to 0\.6: it is 2 numbers \(x, y\)"),
        ({"mark.x": 0.7}, r"'mark\.x' to 0\.7: it is drawn from -0\.5 to 0\.6"),
        ({"mark.x": [0.5, 0.1]}, r"'mark\.x' to \[0\.5, 0\.1\]: it is a single number"),
        ({"mark": [0.6, 0], "mark.y": 0.1}, r"'mark\.y' twice"),
        (
            {"mark.z": 0.1},
            r"'mark\.z': did you mean 'mark\.[xy]'.* draws 'mark', 'mark\.x', 'mark\.y', 'side'",
        ),
        ({"mark": [0.6, 0, 0]}, r"it is 2 numbers"),
        ({"mark": [[0.6, 0]]}, r"it is 2 numbers"),
        ({"mark": ["0.6", "0"]}, r"it is 2 numbers"),
        ({"mark": [0.6, None]}, r"it is 2 numbers"),
        ({"mark": [0.6, float("nan")]}, r"'mark\.y' to nan: it is not finite"),
        ({"side": 0.5}, r"'side' to 0\.5; use one of -1, 1"),
        ({"side": True}, r"'side' to True: it is a single number"),
        ({"crates": 2.5}, r"'crates' to 2\.5: it is a whole number from 1 to 4"),
        ({"push": 3}, r"'push' to 3: it is drawn from -2 to 2"),
        ({"reset.joints.cart.slider": 5}, r"'reset\.joints\.cart\.slider' to 5: it is drawn from -1 to 1"),
    ],
)
def test_an_option_that_the_episode_could_not_have_drawn_is_refused(
    env: Supervisor, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        env.reset(options=options)


def test_options_that_are_not_a_mapping_are_refused(env: Supervisor) -> None:
    with pytest.raises(UsageError, match="options of reset must be a mapping from names to values, not list"):
        env.reset(options=["mark"])  # type: ignore[arg-type]


def test_the_episode_goes_on_after_options_that_were_refused(env: Supervisor) -> None:
    env.reset(options={"side": 1})
    with pytest.raises(UsageError):
        env.reset(options={"side": 2})
    assert env.step(env.action_space.sample())[4]["reward_terms"]["side"] == 1.0


def test_all_copies_of_a_vector_environment_take_the_options(small: Make) -> None:
    spec = small(SECTIONS).spec
    assert spec is not None
    vector = gymnasium.make_vec(spec, 3, vectorization_mode="sync")
    vector.reset(options={"mark": [0.6, 0]})
    *_, info = vector.step(vector.action_space.sample())
    assert info["reward_terms"]["x"].tolist() == [0.6] * 3
    vector.close()


TEAM = """\
deepbots: 1
name: Pair
extends: cartpole.yaml
robots: {cart: {count: 2, spacing: 0 0.5 0 m}}
agent: {each: cart}
world: {arena: {size: 4 4 m}}
parameters: {mark: uniform(0 .. 1 m)}
reward: {mark: mark / 1 m}
remove: [train, solved]
"""


OF_TEAM = """\
objects: {bar: {shape: box, size: 5 5 5 cm, mass: uniform(0.1 .. 0.2 kg)}, crate: {shape: box, size: 5 5 5 cm}}
reset: {place: {bar: {x: 1.2 m, y: uniform(-0.2 .. 0.2 m)}, crate: {region: {x: -1.8 .. -1 m, y: -1 .. 1 m}}}}
"""


@pytest.fixture
def team(make: Make, tmp_path: Path) -> Supervisor:
    """Two carts of one policy, a bar and a crate."""
    text = Source.open("cartpole").path.read_text(encoding="utf-8")
    (tmp_path / "cartpole.yaml").write_text(text.replace("../robots/urdf/cartpole.urdf", "cartpole"))
    (tmp_path / "team.yaml").write_text(TEAM + OF_TEAM)
    return make(tmp_path / "team.yaml", engine="pybullet")


def test_copies_record_the_draw_of_the_one_bar_that_acts_once(team: Supervisor) -> None:
    drawn = team.reset(seed=1)[1]["drawn"]
    assert set(drawn) == {
        "mark",
        "objects.bar.mass",
        "reset.place.bar.y",
        "reset.place.crate.x",
        "reset.place.crate.y",
        "cart#1.reset.joints.cart.pole_hinge",
        "cart#2.reset.joints.cart.pole_hinge",
    }
    assert team.engine.pose("bar")()[0][1] == drawn["reset.place.bar.y"]
    assert team.engine.pose("crate")()[0][:2] == (
        drawn["reset.place.crate.x"],
        drawn["reset.place.crate.y"],
    )


def test_drawn_values_of_copies_can_be_set(team: Supervisor) -> None:
    for seed in range(5):
        world, drawn = start(team, seed=seed)
        assert start(team, seed=9, options=drawn) == (world, drawn)
        assert episode(team, seed=9, options=drawn) == episode(team, seed=seed)


def test_the_draw_of_one_copy_is_set(team: Supervisor) -> None:
    plain = team.reset(seed=1)[1]["drawn"]
    options = {"cart#2.reset.joints.cart.pole_hinge": 0.01}
    assert team.reset(seed=1, options=options)[1]["drawn"] == plain | options
    both = team.reset(seed=1, options={"reset.joints.cart.pole_hinge": 0.0, **options})[1]["drawn"]
    assert both == plain | {"cart#1.reset.joints.cart.pole_hinge": 0.0} | options


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"cart#2.reset.place.bar.y": 0.1},
            r"'cart#2\.reset\.place\.bar\.y': all copies share this draw; write 'reset\.place\.bar\.y'",
        ),
        (
            {"cart#3.reset.joints.cart.pole_hinge": 0.0},
            r"'cart#3\.reset\.joints\.cart\.pole_hinge': did you mean 'reset",
        ),
        ({"cart#2.reset.joints.cart.pole_hinge": 3.0}, r"pole_hinge' to 3: it is drawn from"),
    ],
)
def test_a_wrong_option_for_one_copy_is_refused(
    team: Supervisor, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        team.reset(options=options)


def test_a_value_of_one_copy_that_is_given_twice_is_refused(
    team: Supervisor, make: Make, tmp_path: Path
) -> None:
    pushed = make(
        tmp_path / "team.yaml",
        "reset.place.cart={velocity: uniform(0 0 0 .. 0.1 0.1 0 m/s)}",
        engine="pybullet",
    )
    velocity = "cart#1.reset.place.cart.velocity"
    with pytest.raises(UsageError, match=rf"'reset\.place\.cart\.velocity\.x' twice: by '{velocity}\.x'"):
        pushed.reset(options={velocity: [0.05, 0.05, 0.0], f"{velocity}.x": 0.1})


def test_a_team_takes_a_parameter_for_all_copies(team: Supervisor) -> None:
    team.reset(options={"mark": 0.25, "reset.joints.cart.pole_hinge": 0.01})
    *_, info = team.step(team.action_space.sample())
    assert info["reward_terms"]["mark"] == 0.25


# What a reset drew, given back


def test_every_component_of_a_vector_is_recorded(env: Supervisor) -> None:
    values = drawn_rewards(env, seed=1)
    info = env.reset(seed=1)[1]["drawn"]
    assert (info["mark.x"], info["mark.y"]) == (values["x"], values["y"])
    assert "mark" not in info


def test_a_computed_draw_is_recorded_with_the_value_that_acts(env: Supervisor) -> None:
    assert drawn_rewards(env, seed=1)["push"] == env.reset(seed=1)[1]["drawn"]["push"]


def test_a_component_is_set_alone(env: Supervisor) -> None:
    plain = env.reset(seed=3)[1]["drawn"]
    changed = env.reset(seed=3, options={"mark.x": 0.5})[1]["drawn"]
    assert changed == plain | {"mark.x": 0.5}


def start(env: Supervisor, **reset: Any) -> tuple[Any, dict[str, Any]]:
    """The world after a reset, and the values that the reset drew."""
    observation, info = env.reset(**reset)
    frame = FrameReader(env).read(observation)
    return (frame.links, frame.joints, frame.variants), info["drawn"]


def episode(env: Supervisor, **reset: Any) -> list[bytes]:
    """A reset and some steps with the same actions."""
    observation, info = env.reset(**reset)
    env.action_space.seed(3)
    transitions = [(observation, 0.0, False, False, info)]
    while len(transitions) < 15 and not (transitions[-1][2] or transitions[-1][3]):
        transitions.append(env.step(env.action_space.sample()))
    return [as_bytes(transition) for transition in transitions]


def programs(name: str) -> list[Program]:
    """A shipped scenario, its cases and its stages."""
    program = api.compile(name).program
    return [
        program,
        *(case.program for case in program.cases),
        *(stage.program for stage in program.curriculum),
    ]


@pytest.mark.parametrize("name", few(shipped.scenario_names(), ("cartpole", "multi_cartpole", "see_ball")))
def test_setting_drawn_values_repeats_the_episode(name: str) -> None:
    for program in programs(name):
        with closing(api.make(program)) as env:
            world, drawn = start(env, seed=7)
            first = episode(env, seed=7)
            assert drawn
            assert episode(env, seed=7, options=drawn) == first
            assert start(env, seed=8, options=drawn) == (world, drawn)
            assert start(env, options=json.loads(json.dumps(drawn))) == (world, drawn)


NO_NOISE = ("cartpole", "multi_cartpole", "panda_push", "panda_reach", "pit_escape", "see_ball")
"""Scenarios that draw nothing within an episode."""


@pytest.mark.parametrize("name", few(NO_NOISE, LIGHT))
def test_without_noise_what_was_drawn_gives_the_same_episode_for_every_seed(name: str) -> None:
    with closing(api.make(name)) as env:
        drawn = env.reset(seed=7)[1]["drawn"]
        assert episode(env, seed=8, options=drawn) == episode(env, seed=7) != episode(env, seed=8)


@pytest.mark.parametrize(
    "name", few([path.name for path in sorted(SCENARIOS.glob("*.yaml"))], ("placed.yaml", "pushed.yaml"))
)
def test_every_kind_of_draw_is_taken_back(name: str) -> None:
    with closing(api.make(SCENARIOS / name)) as env:
        for seed in range(5):
            world, drawn = start(env, seed=seed)
            assert start(env, seed=99, options=drawn) == (world, drawn)


def test_a_free_position_and_a_layout_are_set() -> None:
    with closing(api.make("find_ball_random", overrides=["obstacles=1"])) as env:
        drawn = env.reset(
            seed=0, options={"reset.layout": "scattered", "reset.layouts.scattered.ball.x": 0.3}
        )[1]["drawn"]
        assert drawn["reset.layout"] == "scattered"
        assert drawn["reset.layouts.scattered.ball.x"] == 0.3
        assert env.engine.pose("ball")()[0][0] == 0.3
        with pytest.raises(UsageError, match=r"'reset\.layout' to 'spread'; use one of 'scattered', 'paper'"):
            env.reset(options={"reset.layout": "spread"})
        with pytest.raises(UsageError, match=r"'reset\.layouts\.scattered\.ball\.x' to 7: it is drawn from"):
            env.reset(options={"reset.layouts.scattered.ball.x": 7})


def test_a_position_that_is_not_free_is_refused_by_name() -> None:
    with closing(api.make("see_ball")) as env:
        drawn = env.reset(seed=0)[1]["drawn"]
        taken = {f"reset.place.ball.{axis}": drawn[f"reset.place.epuck.{axis}"] for axis in "xy"}
        with pytest.raises(
            EvaluationError, match=r"'(ball|epuck)' cannot be placed at the position in the reset options"
        ):
            env.reset(options=drawn | taken)
