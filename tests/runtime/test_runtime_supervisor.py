"""Environments of generated code: their steps, `reset`, and Gymnasium.

* The supervisor between engine and robots: timing, endings, failures, and the code that one sees.
* `reset(options={...})`: values of an episode in place of draws.
* Scenarios by way of Gymnasium: `make`, `make_vec` and the `spec` of an environment.
* Random streams: one root seed, and each purpose for itself.

An episode in which the physics is unstable ends in an error that names the joint.
"""

from __future__ import annotations

import ast
import inspect
import linecache
import math
import pickle
import traceback
import warnings
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import DeepbotsError, EngineError, EvaluationError, MessageError, UsageError
from deepbots_cli.rollout.source import Source
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.streams import Streams, derive_seed
from tests.files import written
from tests.worlds import RAIL, Make, begun


# Endings and limits
def test_time_limits_count_whole_steps(small: Make) -> None:
    environment = begun(small("reward: {a: 1}", "truncation={max_time: 0.3 s}"))
    steps = 1
    while not environment.step(np.zeros(1))[3]:
        steps += 1
    assert steps == 15


def test_failure_beats_success_and_all_endings_are_listed(small: Make) -> None:
    environment = begun(
        small(
            "reward: {a: 1}\ntermination: {success: {far: drive > 0.5}, failure: {fast: drive > 0.4, slow: drive"
            " < 0}}"
        )
    )
    _, _, terminated, truncated, info = environment.step(np.array([0.75]))
    assert terminated is True
    assert truncated is False
    assert info["is_success"] is False
    assert (info["ended_by"], info["endings"]) == ("fast", ("fast", "far"))


def test_termination_beats_a_limit_in_the_same_step(small: Make) -> None:
    environment = begun(
        small("reward: {a: 1}\ntermination: {success: {far: drive > 0.5}}", "truncation.max_steps=1")
    )
    assert environment.step(np.array([1.0]))[2:4] == (True, False)
    environment.reset(seed=0)
    assert environment.step(np.array([0.0]))[2:4] == (False, True)


def test_an_ending_that_is_true_at_the_start_is_an_error_and_leaves_nothing_to_step(small: Make) -> None:
    environment = small("reward: {a: 1}\ntermination: {failure: {still: abs(position(cart.pole).x) < 1 mm}}")
    with pytest.raises(EvaluationError, match="'still' is already true at reset"):
        environment.reset(seed=0)
    with pytest.raises(UsageError, match="reset"):
        environment.step(np.zeros(1))


# What has no value
@pytest.mark.parametrize(
    ("term", "line"),
    [
        ("1 / (step - 3)", "1.0 / (step - 3.0)"),
        ("sqrt(2.5 - step)", "sqrt(2.5 - step)"),
        ("exp(1000 * step) if step == 3 else 0", "exp(1000.0 * step)"),
        ("log(3 - step)", "log(3.0 - step)"),
    ],
)
def test_an_expression_without_a_value_names_its_line_and_the_step(small: Make, term: str, line: str) -> None:
    environment = begun(small(f'reward: {{bad: "{term}"}}'))
    for _ in range(2):
        environment.step(np.zeros(1))
    with pytest.raises(EvaluationError) as caught:
        environment.step(np.zeros(1))
    assert "step 3" in str(caught.value)
    assert line in str(caught.value)
    assert "`bad = " in str(caught.value)
    environment.reset(seed=0)
    environment.step(np.zeros(1))


def test_a_reward_that_overflows_names_its_term(small: Make) -> None:
    environment = begun(small('reward: {fine: 1, large: "1e200 * (step * 1e150)"}'))
    with pytest.raises(EvaluationError, match="'large' is not finite"):
        environment.step(np.zeros(1))


def test_the_traceback_of_such_an_error_shows_generated_lines(small: Make) -> None:
    environment = begun(small('reward: {bad: "1 / (step - 1)"}'))
    with pytest.raises(EvaluationError) as caught:
        environment.step(np.zeros(1))
    text = "".join(traceback.format_exception(caught.value))
    assert "self.term_bad = 1.0 / (self.step_count - 1.0)" in text
    assert "<deepbots Small " in text


@pytest.mark.parametrize("format", ["struct", "json", "csv", "msgpack", "none"])
@pytest.mark.parametrize("engine", ["exact", "pybullet"])
def test_a_world_that_blew_up_is_the_engines_failure(make: Make, format: str, engine: str) -> None:
    environment = begun(make(RAIL, f"messages.format={format}", engine=engine))
    environment.step(0)
    environment.engine.set_joint("cart", "hinge", math.nan, 0.0)
    with pytest.raises(EngineError, match="cart"):
        environment.step(0)


# Messages that do not fit
@pytest.mark.parametrize("message", [b"", b"garbage", "text", None, b"\0" * 12, b"\0" * 500])
def test_a_foreign_message_on_the_way_is_refused_by_the_robot(make: Make, message: Any) -> None:
    environment = begun(make(RAIL, engine="exact"))
    environment.step(0)
    environment.to_cart.transmit(message)
    with pytest.raises(MessageError, match=r"robot 'cart', to the robot, step 2"):
        environment.step(0)


def test_a_foreign_message_from_a_robot_is_refused_by_the_supervisor(make: Make) -> None:
    environment = begun(make(RAIL, engine="exact"))
    environment.from_cart.transmit(environment.to_cart.wire.encode((1.0,)))
    with pytest.raises(
        MessageError, match=r"robot 'cart', from the robot, step 1: the message has another layout"
    ):
        environment.step(0)


def test_every_failure_of_a_step_is_one_line_and_within_our_tree(make: Make) -> None:
    environment = make(RAIL, engine="exact")
    for use in (
        lambda: environment.step(0),
        lambda: environment.step("x"),
        lambda: environment.step(np.zeros((40, 40))),
    ):
        with pytest.raises(DeepbotsError) as caught:
            use()
        assert "\n" not in str(caught.value)
        environment.reset(seed=0)


# The code
def test_the_code_that_the_compiler_prints_is_the_code_that_runs(make: Make) -> None:
    environment = make(RAIL, engine="exact")
    code = api.compile(RAIL).code
    assert "".join(linecache.getlines(inspect.getfile(type(environment)._advance))) == code
    assert inspect.getsource(type(environment)._advance) in code
    assert inspect.getsource(type(environment.robot_cart).create_message) in code


def test_the_printed_module_has_the_papers_classes_and_imports_nothing_odd() -> None:
    tree = ast.parse(api.compile("cartpole").code)
    classes = {
        node.name: {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    }
    assert {"create_message", "use_message_data"} <= classes["CartController"]
    assert {"get_observations", "get_reward", "is_done", "get_info", "reset"} <= set(dir(Supervisor))
    assert "CartPoleSupervisor" in classes
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert modules <= {"__future__", "math", "struct", "typing", "deepbots_cli.runtime"}
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.Import)]


# Physics, end to end


@pytest.mark.parametrize("action", [["0.5"], [True], [b"0.5"]])
def test_an_action_of_text_or_truth_values_fits_no_interval(small: Make, action: list[object]) -> None:
    environment = begun(small("reward: {pay: drive}"))
    with pytest.raises(UsageError, match="does not fit"):
        environment.step(action)


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
        (["mark"], "options of reset must be a mapping from names to values, not list"),
        ({"reset.joints.cart.slider": 5}, r"'reset\.joints\.cart\.slider' to 5: it is drawn from -1 to 1"),
    ],
)
def test_an_option_that_the_episode_could_not_have_drawn_is_refused(
    env: Supervisor, options: Any, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        env.reset(options=options)


def test_the_episode_goes_on_after_options_that_were_refused(env: Supervisor) -> None:
    env.reset(options={"side": 1})
    with pytest.raises(UsageError):
        env.reset(options={"side": 2})
    assert env.step(env.action_space.sample())[4]["reward_terms"]["side"] == 1.0


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


def test_a_component_is_set_alone(env: Supervisor) -> None:
    plain = env.reset(seed=3)[1]["drawn"]
    assert env.reset(seed=3, options={"mark.x": 0.5})[1]["drawn"] == plain | {"mark.x": 0.5}


def test_a_position_that_is_not_free_is_refused_by_name() -> None:
    with closing(api.make("see_ball")) as env:
        drawn = env.reset(seed=0)[1]["drawn"]
        taken = {f"reset.place.ball.{axis}": drawn[f"reset.place.epuck.{axis}"] for axis in "xy"}
        with pytest.raises(
            EvaluationError, match=r"'(ball|epuck)' cannot be placed at the position in the reset options"
        ):
            env.reset(options=drawn | taken)


ANY = "deepbots/Scenario-v1"


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A scenario that does not come with deepbots."""
    text = (
        Source.open("cartpole")
        .path.read_text(encoding="utf-8")
        .replace("../robots/urdf/cartpole.urdf", "cartpole")
    )
    return written(tmp_path / "mine.yaml", text.replace("name: CartPole", "name: Mine"))


@pytest.fixture
def strict() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def first(env: Any) -> list[float]:
    """The observation that an episode of seed 1 begins with, after which the environment is closed."""
    observation, _ = env.reset(seed=1)
    env.close()
    return np.ravel(observation).tolist()


def test_a_scenario_of_ones_own_is_made_by_its_path(mine: Path, strict: None) -> None:
    env = begun(gymnasium.make(ANY, scenario=str(mine), overrides=["track=0.2m"], render_mode="rgb_array"))
    assert (env.render().shape[2], env.unwrapped.scenario.name) == (3, "Mine")
    env.close()


def test_a_scenario_of_ones_own_begins_as_by_make(mine: Path, strict: None) -> None:
    assert first(gymnasium.make(ANY, scenario=mine)) == first(api.make(mine))


def test_a_missing_scenario_is_an_error_that_shows_how(strict: None) -> None:
    with pytest.raises(UsageError, match=r"needs a scenario: gymnasium\.make"):
        gymnasium.make(ANY)


@pytest.mark.parametrize("way", ["registered", "path", "compiled", "intermediate"])
def test_the_spec_of_an_environment_is_short_and_makes_it_again(mine: Path, way: str, strict: None) -> None:
    compiled = api.compile(mine)
    env: Any = {
        "registered": lambda: gymnasium.make(ANY, scenario=str(mine)),
        "path": lambda: api.make(mine),
        "compiled": lambda: api.make(compiled),
        "intermediate": lambda: api.make(compiled.program),
    }[way]()
    assert len(repr(env.spec)) < 600
    again = gymnasium.make(env.spec)
    several = gymnasium.make_vec(env.spec, 1, vectorization_mode="sync")
    assert first(again) == first(several) == first(env)


def test_a_copy_in_another_process_has_the_fixed_parameters(mine: Path, strict: None) -> None:
    env = api.make(mine)
    copy = pickle.loads(pickle.dumps(env))
    env.close()
    with pytest.raises(UsageError, match="'track': it is a fixed parameter"):
        copy.reset(options={"track": 0.2})
    copy.close()


PINNED_SEEDS = [1726737503, 2927587060, 1207722611, 1478552595]
PINNED_DRAWS = [0.09192528450451198, -0.2648980716967728, 2.0, 2.0]


def test_derived_seeds_are_the_same_in_every_version() -> None:
    """A run is repeated by its seed, so these figures may never change."""
    assert [
        derive_seed(0),
        derive_seed(0, "reset"),
        derive_seed(0, "environment", 3),
        derive_seed(2**40, "évaluation"),
    ] == PINNED_SEEDS


def test_drawn_values_are_the_same_in_every_version() -> None:
    streams = Streams(7)
    drawn = [
        streams.uniform("a", -1.0, 1.0),
        streams.normal("b", 0.0, 1.0),
        streams.integer("c", 1, 6),
        streams.choice("d", 2.0, 3.0, 5.0),
    ]
    assert drawn == PINNED_DRAWS


def test_draws_from_other_streams_do_not_change_a_stream() -> None:
    alone, mixed = Streams(3), Streams(3)
    expected = [alone.uniform("wanted", 0.0, 1.0) for _ in range(5)]
    drawn = []
    for index in range(5):
        mixed.normal(f"other {index}", 0.0, 1.0)
        drawn.append(mixed.uniform("wanted", 0.0, 1.0))
        mixed.integer("another", 0, 9)
    assert drawn == expected


def test_without_a_seed_two_environments_differ() -> None:
    assert Streams(None).root != Streams(None).root


@pytest.mark.parametrize("root", [-1, 2**70])
def test_any_whole_number_is_a_seed(root: int) -> None:
    assert 0.0 <= Streams(root).uniform("a", 0.0, 1.0) < 1.0
    assert 0 <= derive_seed(root, "a") < 2**32


def test_whole_numbers_are_drawn_with_both_ends() -> None:
    streams = Streams(1)
    assert {streams.integer("n", 2, 4) for _ in range(100)} == {2.0, 3.0, 4.0}
    assert {streams.integer("n", 1.5, 4.5) for _ in range(100)} == {2.0, 3.0, 4.0}


def test_draws_are_plain_floats_that_every_message_format_can_carry() -> None:
    streams = Streams(1)
    drawn = [
        streams.uniform("a", 0, 1),
        streams.normal("b", 0, 1),
        streams.integer("c", 1, 6),
        streams.choice("d", 2.0, 3.0),
    ]
    assert {type(value) for value in drawn} == {float}


# An episode in which the physics is unstable ends in an error that names the joint


ROBOT = """<robot name="arm">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip">
    <inertial><origin xyz="0.05 0 0"/><mass value="0.001"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="ankle" type="revolute">
    <parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="50" velocity="20"/>
  </joint>
</robot>
"""
SCENARIO = """\
deepbots: 1
name: Gram
world: {timestep: 20 ms, substeps: 5}
robots:
  arm:
    urdf: arm.urdf
    base: fixed
    sensors: {angle: {type: joint_position, joint: ankle}}
    actuators: {spring: {type: position_motor, joint: ankle, stiffness: 1_000_000 N*m/rad}}
    apply: {spring: bend * 0.5 rad}
action: {bend: -1 .. 1}
observation: {arm.angle: auto}
reward: {up: cos(arm.angle)}
truncation: {max_steps: 50}
"""
STIFF = 1_000_000


def steps(folder: Path, engine: str, stiffness: float = STIFF) -> None:
    """Run an episode with a spring of this stiffness (N m/rad) on 1 g."""
    (folder / "arm.urdf").write_text(ROBOT)
    file = written(folder / "gram.yaml", SCENARIO.replace("1_000_000", str(stiffness)))
    environment = api.make(str(file), engine=engine)
    try:
        environment.reset(seed=0)
        ended = False
        while not ended:
            _, _, _, ended, _ = environment.step(np.ones(1, np.float32))
    finally:
        environment.close()


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_spring_that_is_too_strong_ends_the_episode_with_the_name_of_its_joint(tmp_path, engine):
    pytest.importorskip(engine)
    with pytest.raises(EngineError, match=r"joint 'ankle' of 'arm' turns at \S+ rad/s, which no motor"):
        steps(tmp_path, engine)


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_the_stiffness_that_the_finding_names_is_stable(tmp_path, engine):
    pytest.importorskip(engine)
    (tmp_path / "arm.urdf").write_text(ROBOT)
    file = written(tmp_path / "gram.yaml", SCENARIO)
    (finding,) = [finding for finding in api.lint(file) if finding.code == "DB325"]
    stable = float(finding.help.partition("below ")[2].partition(" ")[0])
    steps(tmp_path, engine, stable)
    file.write_text(SCENARIO.replace("1_000_000", str(stable)))
    assert "DB325" not in {finding.code for finding in api.lint(file)}


def test_a_world_of_a_batch_whose_joint_is_too_fast_is_lost(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "arm.urdf").write_text(ROBOT)
    file = written(tmp_path / "gram.yaml", SCENARIO.replace("substeps: 5", "substeps: 5, engine: mujoco"))
    environment = api.make_vec(str(file), num_envs=2)
    try:
        environment.reset(seed=0)
        with pytest.warns(RuntimeWarning, match=r"'ankle' of 'arm' turns at .* spring of 1e\+06"):
            _, reward, _, truncated, _ = environment.step(np.array([[1.0], [0.0]], np.float32))
        assert truncated.tolist() == [True, False]
        assert reward[0] == 0.0
    finally:
        environment.close()
