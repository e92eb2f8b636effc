"""`reset(options={...})`: values of an episode in place of draws."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.runtime import Supervisor

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
  set: {cart.slider: uniform(-1 .. 1 m), cart.hinge: {position: 0 rad, velocity: uniform(-1 .. 1 rad/s)}}
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
def env(small: Callable[..., Supervisor]) -> Supervisor:
    return small(SECTIONS)


def drawn(env: Any, **reset: Any) -> dict[str, float]:
    """The values of the episode that a reset begins, by their terms of the reward."""
    observation, _ = env.reset(**reset)
    place = float(observation[0]) * 2.4
    *_, info = env.step(env.action_space.sample() * 0)
    return {**info["reward_terms"], "place": place}


def test_reset_options_set_a_drawn_parameter_and_a_vector(env: Supervisor) -> None:
    values = drawn(env, seed=1, options={"mark": [0.6, 0], "side": -1, "crates": 3})
    assert (values["x"], values["y"], values["side"], values["crates"]) == (0.6, 0.0, -1.0, 3.0)


def test_what_is_computed_from_a_value_that_was_set_follows_it(env: Supervisor) -> None:
    assert drawn(env, options={"mark": (0.25, 0.1)})["twice"] == 0.5


def test_reset_options_set_joints_by_their_path(env: Supervisor) -> None:
    assert drawn(env, options={"reset.set.cart.slider": 0.5})["place"] == pytest.approx(0.5)
    assert drawn(env, options={"reset.set.cart.hinge.velocity": -0.75})["lean"] == pytest.approx(-0.75 * 0.02, rel=0.1)


def test_other_draws_of_this_episode_and_of_later_ones_stay_as_they_are(env: Supervisor) -> None:
    plain = [drawn(env, seed=5), drawn(env), drawn(env)]
    some = [drawn(env, seed=5, options={"mark": [0.6, 0], "crates": 2}), drawn(env, options={"side": 1}), drawn(env)]
    for name in ("push", "place", "noisy"):
        assert [values[name] for values in some] == [values[name] for values in plain]
    assert some[2] == plain[2]


def test_a_value_that_is_drawn_in_each_step_keeps_what_was_set_through_the_episode(env: Supervisor) -> None:
    env.reset(options={"noisy": 0.5})
    assert {env.step(env.action_space.sample() * 0)[4]["reward_terms"]["noisy"] for _ in range(5)} == {0.5}


def test_what_was_set_counts_for_one_episode(env: Supervisor) -> None:
    env.reset(seed=2, options={"mark": [0.6, 0]})
    assert drawn(env)["x"] != 0.6


def test_a_limit_as_a_float32_is_that_limit(env: Supervisor) -> None:
    assert drawn(env, options={"mark": np.array([0.6, 0.2], np.float32)})["x"] == 0.6


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"marc": [0.6, 0]}, r"'marc': did you mean 'mark'\? Small draws 'mark', 'side', .*'reset\.set\.cart\.slider'"),
        ({"stride": 0.1}, r"'stride': it is a fixed parameter.*by overrides=\['stride=\.\.\.'\]"),
        ({"twice": 0.1}, "'twice': it is computed from other parameters; set those"),
        ({"mark": [0.7, 0]}, r"'mark\.x' to 0\.7: it is drawn from -0\.5 to 0\.6"),
        ({"mark": 0.6}, r"'mark' to 0\.6: it is 2 numbers \(x, y\)"),
        ({"mark": [0.6, 0, 0]}, r"it is 2 numbers"),
        ({"mark": [[0.6, 0]]}, r"it is 2 numbers"),
        ({"mark": ["0.6", "0"]}, r"it is 2 numbers"),
        ({"mark": [0.6, None]}, r"it is 2 numbers"),
        ({"mark": [0.6, float("nan")]}, r"'mark\.y' to nan: it is not finite"),
        ({"side": 0.5}, r"'side' to 0\.5: it is one of -1, 1"),
        ({"side": True}, r"'side' to True: it is a single number"),
        ({"crates": 2.5}, r"'crates' to 2\.5: it is a whole number from 1 to 4"),
        ({"push": 3}, r"'push' to 3: it is drawn from -2 to 2"),
        ({"reset.set.cart.slider": 5}, r"'reset\.set\.cart\.slider' to 5: it is drawn from -1 to 1"),
    ],
)
def test_an_option_that_the_episode_could_not_have_drawn_is_refused(env: Supervisor, options: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        env.reset(options=options)


def test_options_that_are_no_mapping_are_refused(env: Supervisor) -> None:
    with pytest.raises(UsageError, match="options of reset must be a mapping from names to values, not list"):
        env.reset(options=["mark"])  # type: ignore[arg-type]


def test_the_episode_goes_on_after_options_that_were_refused(env: Supervisor) -> None:
    env.reset(options={"side": 1})
    with pytest.raises(UsageError):
        env.reset(options={"side": 2})
    assert env.step(env.action_space.sample())[4]["reward_terms"]["side"] == 1.0


def test_all_copies_of_a_vector_environment_take_the_options(small: Callable[..., Supervisor]) -> None:
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


def test_a_team_takes_a_parameter_for_all_copies(make: Callable[..., Supervisor], tmp_path: Path) -> None:
    text = api.locate("cartpole")[0].read_text(encoding="utf-8")
    (tmp_path / "cartpole.yaml").write_text(text.replace("../robots/urdf/cartpole.urdf", "cartpole"))
    (tmp_path / "team.yaml").write_text(TEAM)
    team = make(tmp_path / "team.yaml", engine="pybullet")
    team.reset(options={"mark": 0.25, "reset.set.cart.pole_hinge": 0.01})
    *_, info = team.step(team.action_space.sample())
    assert info["reward_terms"]["mark"] == 0.25
