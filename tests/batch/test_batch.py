"""A batch of worlds has the same episodes as its single worlds."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, MultiDiscrete

from deepbots_cli.cli import main

pytest.importorskip("deepbots_cli.engines.mujoco")

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.engines import ENGINES
from deepbots_cli.errors import BatchError, EvaluationError, UsageError
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.batch import BatchEnvironment
from deepbots_cli.runtime.spaces import fitting_rows
from tests.few import few
from tests.worlds import CART, SCENARIOS

FAST = ("cartpole", "find_ball", "find_and_avoid", "pit_escape", "balancer")
PUSHED = str(SCENARIOS / "pushed.yaml")
FEET = str(SCENARIOS / "feet.yaml")
SHORTER = {PUSHED: ("truncation.max_time=4 s",), "quadruped": ("truncation.max_time=4 s",)}
"""Settings with which episodes end within 500 steps."""
ENDLESS = ("find_and_avoid", "pit_escape", PUSHED, FEET)
"""Scenarios in which no episode ends within 40 steps."""
LIVED = ("multi_cartpole", "feet")
"""Those with what the law `one_world_is_one_of_many` does not draw: copies of a robot, and forces of contacts."""
OTHERS = (
    "cartpole_continuous",
    "cartpole_long",
    "cartpole_wireless",
    "find_and_avoid_unmasked",
    "find_ball_as_printed",
    "find_ball_random",
    "line_follower",
    "multi_cartpole",
    "panda_push",
    "panda_reach",
    "pit_escape_as_printed",
    "quadrotor",
    "quadruped",
    "tag_scripted",
    PUSHED,
)
"""With these, every shipped scenario that fits a batch."""


def stem(name: str) -> str:
    return Path(name).stem


def rows(observation: Any) -> np.ndarray[Any, Any]:
    """An observation, or those of all worlds, as one array."""
    if isinstance(observation, dict):
        return np.concatenate([observation[key] for key in sorted(observation)], axis=-1)
    return np.asarray(observation)


def part_of_world(part: Any, world: int) -> Any:
    return {key: value[world] for key, value in part.items()} if isinstance(part, dict) else part[world]


def masks(info: dict[str, Any]) -> list[Any]:
    """The mask of each choice; none where nothing is ever forbidden."""
    mask = info.get("action_mask", ())
    mask = mask["choices"] if isinstance(mask, dict) else mask
    return [mask] if isinstance(mask, np.ndarray) else list(mask)


def assert_same(actual: Any, expected: Any) -> None:
    """To the bit."""
    np.testing.assert_array_equal(rows(actual), rows(expected))


def compare(
    name: str,
    worlds: int,
    steps: int,
    overrides: tuple[str, ...] = (),
    permissions: Permissions = Permissions(),
) -> int:
    """Step a batch beside single worlds; the number of episodes that ended."""
    compiled = api.compile(name, overrides=overrides, permissions=permissions)
    seeds = [100 + world for world in range(worlds)]
    singles = [api.make(compiled, engine="mujoco") for _ in seeds]
    ended = 0
    with closing(deepbots_cli.make_vec(compiled, worlds)) as batch:
        observations, _ = batch.reset(seed=seeds)
        for world, single in enumerate(singles):
            assert_same(part_of_world(observations, world), single.reset(seed=seeds[world])[0])
        batch.action_space.seed(1)
        for _ in range(steps):
            actions = batch.action_space.sample()
            observations, rewards, terminated, truncated, infos = batch.step(actions)
            for world, single in enumerate(singles):
                observation, reward, *ends, info = single.step(part_of_world(actions, world))
                last = info
                assert ends == [terminated[world], truncated[world]]
                assert rewards[world] == reward
                if any(ends):
                    ended += 1
                    assert_same(infos["final_obs"][world], observation)
                    assert infos["final_info"]["ended_by"][world] == last["ended_by"]
                    assert infos["final_info"]["is_success"][world] == last["is_success"]
                    for what, values in last.get("each", {}).items():
                        assert infos["final_info"]["each"][what][world] == values
                    observation, info = single.reset()
                assert_same(part_of_world(observations, world), observation)
                for mine, other in zip(masks(infos), masks(info), strict=True):
                    np.testing.assert_array_equal(mine[world], other)
    for single in singles:
        single.close()
    return ended


@pytest.mark.parametrize("name", few([*FAST, "multi_cartpole", PUSHED, FEET], LIVED, stem))
def test_a_world_of_a_batch_has_the_episodes_of_a_single_world(name: str) -> None:
    overrides = ("truncation.max_time=0.6 s",) if name in ENDLESS else ()
    assert compare(name, worlds=3, steps=40, overrides=overrides) > 0


BODIES = (
    "truncation.max_time=0.4 s",
    "robots.dog.links={trunk: {com: uniform(-3 -3 -1 .. 3 3 1 cm), inertia: uniform(0.7 .. 1.3), mass: urdf *"
    " uniform(0.8 .. 1.2)}, '*_upper': {com: uniform(-1 -1 -1 .. 1 1 1 cm)}}",
    "robots.dog.joints={legs: {armature: uniform(0 .. 0.02 kg*m^2), friction: uniform(0 .. 0.2 N*m), damping:"
    " uniform(0 .. 0.1 N*m*s/rad)}}",
)
SPUN = (
    "robots.dog.actuators={legs: {type: velocity_motor, joints: legs, max_torque: 20 N*m}}",
    "robots.dog.apply={legs: 10 rad/s * stride}",
)


CURVE = "stall_torque: 40 N*m, no_load_speed: 10 rad/s"
SPRING = f"type: position_motor, joints: legs, stiffness: 40 N*m/rad, damping: 1 N*m*s/rad, {CURVE}"
CURVED = (
    f"robots.dog.actuators={{legs: {{{SPRING}, strength: 0.8}}}}",
    f"robots.dog.actuators={{legs: {{{SPRING}, strength: uniform(0.5 .. 1)}}}}",
)
TORQUES = (
    f"robots.dog.actuators={{legs: {{type: torque_motor, joints: legs, {CURVE}, strength: 1}}}}",
    "robots.dog.apply={legs: 33 N*m * stride}",
    "reset.settle=0 s",
)


@pytest.mark.parametrize(
    "motors",
    [
        pytest.param((), id="springs", marks=pytest.mark.slow),
        pytest.param(SPUN, id="velocity motors", marks=pytest.mark.slow),
        pytest.param(CURVED[:1], id="weak curves", marks=pytest.mark.slow),
        pytest.param(CURVED[1:], id="drawn curves"),
        pytest.param(TORQUES, id="torques", marks=pytest.mark.slow),
    ],
)
def test_drawn_bodies_and_joints_move_in_a_batch_as_in_single_worlds(motors: tuple[str, ...]) -> None:
    assert compare(PUSHED, worlds=3, steps=30, overrides=(*BODIES, *motors)) > 0


@pytest.mark.parametrize("start", ["level", "0.1"])
def test_memories_of_apply_wait_for_late_messages_in_a_batch_too(start: str) -> None:
    """Those with a received start begin with the first message, and all advance in the worlds that receive
    one."""
    overrides = (
        'robots.cart.receive={level: "0.4 + time / s"}',
        f"robots.cart.apply.wheels=accumulate(0.1 * drive, -1 .. 1, {start}) * wheel_speed + hold(level,"
        " level > 0.5) * wheel_speed",
        "messages.to_robot={latency: uniform(0 .. 100 ms) each step, order: arrival}",
    )
    assert compare("cartpole", worlds=3, steps=60, overrides=overrides) > 0


def test_a_world_whose_episode_ends_within_a_step_draws_nothing_in_its_other_timesteps() -> None:
    """Losses and latencies of the next episode are those of a single world."""
    assert compare("cartpole_wireless", worlds=3, steps=45, overrides=("agent={action_repeat: 3}",)) > 0


COPIES = (
    "agent.action_repeat=3",
    "robots.cart.count=3",
    "parameters.radio=uniform(10 .. 40 ms)",
    "parameters.fall_angle=uniform(10 .. 15 deg)",
    "messages.to_robot={latency: radio, loss: 5 %}",
    "messages.from_robot={latency: radio + uniform(0 .. 20 ms) each step, loss: 5 %}",
    "robots.cart.sensors.pole_angle={type: joint_position, joint: pole_hinge, noise: 0.2 deg, latency:"
    " uniform(0 .. 40 ms)}",
    "robots.cart.actuators.wheels={type: velocity_motor, joints: [wheel_*], max_torque: 10 N*m, delay:"
    " uniform(0 .. 16 ms)}",
    "robots.cart.links={'*': {mass: urdf * uniform(0.9 .. 1.1)}}",
    "objects.thing={one_of: {cube: {shape: box, size: 0.1 0.1 0.1 m}, ball: {shape: sphere, radius: 5 cm}}}",
    "reset.place.thing={x: 0.3 m, y: 0 m, z: 10 cm}",
    "augment.gap=ground_distance(cart, thing)",
    "augment.met=contact(cart, thing)",
    "observation.speed={range: -0.8 .. 0.8 m/s, noise: 0.1 m/s}",
    "observation.gap=0 .. 5 m",
    "observation.met=auto",
    "observation.tip_speed={range: -2 .. 2 m/s, history: 3}",
)


def test_copies_of_a_robot_in_a_batch_draw_sense_and_move_as_in_a_single_world() -> None:
    """With several timesteps in a step, lossy channels, values of each copy and of all, and a body of two
    forms."""
    assert compare("multi_cartpole", worlds=3, steps=40, overrides=COPIES) > 0


def test_a_world_of_copies_that_becomes_infinite_ends_for_all_of_them() -> None:
    compiled = api.compile("multi_cartpole")
    with (
        closing(deepbots_cli.make_vec(compiled, 3)) as batch,
        closing(api.make(compiled, engine="mujoco")) as single,
    ):
        batch.reset(seed=0)
        batch.batch.singles[1].engine.set_joint("cart#4", "pole_hinge", np.inf, 0.0)
        with pytest.warns(
            RuntimeWarning, match=r"world 1 \(seed 1\) was reset in step 1: .* became infinite or NaN"
        ):
            observations, rewards, _, truncated, infos = batch.step(np.zeros((3, 9), int))
        assert truncated.tolist() == [False, True, False]
        assert rewards[1] == 0.0
        assert infos["final_info"]["ended_by"][1] == "not_finite"
        assert len(batch.batch.losses) == 1
        single.reset(seed=2)
        assert_same(observations[2], single.step(np.zeros(9, int))[0])


MASKABLE = "train={algorithm: MaskablePPO, total_timesteps: 1000}"
CHOICES = "{choices: {forward: 1, keep: 0, backward: -1}, forbid: {forward: x > 5 mm, keep: step > 9}}"


@pytest.mark.parametrize(
    "action", [f"drive: {CHOICES}", f"other: {{choices: {{on: 1, off: 0}}}}, drive: {CHOICES}"]
)
def test_masks_of_a_batch_are_those_of_single_worlds(action: str) -> None:
    assert (
        compare(
            "cartpole",
            worlds=3,
            steps=40,
            overrides=(f"action={{{action}}}", "agent={action_repeat: 2}", MASKABLE),
        )
        > 0
    )


def test_a_world_of_a_batch_in_which_nothing_is_allowed_is_named() -> None:
    overrides = (
        "action={drive: {choices: {forward: 1, backward: -1}, forbid: {forward: step > 1, backward: x > 0"
        " m}}}",
        MASKABLE,
    )
    with closing(deepbots_cli.make_vec(api.compile("cartpole", overrides=overrides), 2)) as batch:
        batch.reset(seed=0)
        batch.step(np.array([1, 0]))
        with pytest.raises(
            EvaluationError,
            match=r"step 2 of world 1 \(seed 1\): every option of 'drive' is forbidden: forward, backward",
        ):
            batch.step(np.array([1, 0]))


HAND = Path(__file__).parents[1] / "golden" / "lint" / "robots" / "hand.urdf"
GRIP = f"""\
deepbots: 1
name: Grip
world: {{timestep: 20 ms, substeps: 4}}
robots:
  hand:
    urdf: {HAND}
    base: fixed
    groups: {{fingers: ["*"]}}
    sensors: {{travel: {{type: joint_position, joints: fingers}}}}
    actuators: {{grip: {{type: gripper, joints: fingers, closed: 0 mm, open: 40 mm}}}}
    emit: [travel]
    apply: {{grip: 0.5 + 0.5 * open}}
action: {{open: -1 .. 1}}
observation: {{hand.travel: -0.05 .. 0.05 m}}
reward: {{
  sum: (joint_position(hand.left) + joint_position(hand.right)) / m,
  left: joint_position(hand.left) / m,
}}
reset: {{joints: {{hand.fingers: uniform(0 .. 40 mm)}}}}
truncation: {{max_steps: 20}}
"""


@pytest.fixture
def grip(tmp_path: Path) -> str:
    """A gripper of two fingers, of which one follows the other with the multiplier -1 and the offset -5
    mm."""
    path = tmp_path / "grip.yaml"
    path.write_text(GRIP, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("engine", sorted(ENGINES))
def test_a_finger_that_mimics_without_a_motor_moves_with_the_other(grip: str, engine: str) -> None:
    with closing(api.make(grip, engine=engine, permissions=Permissions([HAND.parent]))) as environment:
        observation, _ = environment.reset(seed=0)
        assert observation[0] > 0.0
        assert observation[0] + observation[1] == pytest.approx(-0.1, abs=1e-6)
        for _ in range(20):
            *_, info = environment.step(np.array([1.0], np.float32))
            assert info["reward_terms"]["sum"] == pytest.approx(-0.005, abs=0.0004)  # 1 % of the range
        assert info["reward_terms"]["left"] == pytest.approx(0.04, abs=1e-3)


def test_followers_live_the_same_episodes_in_a_batch(grip: str) -> None:
    assert compare(grip, worlds=3, steps=45, permissions=Permissions([HAND.parent])) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FAST, *OTHERS], ids=stem)
def test_many_worlds_for_long(name: str) -> None:
    assert compare(name, worlds=32, steps=500, overrides=SHORTER.get(name, ())) > 0


@pytest.fixture(scope="module")
def cartpole() -> Compiled:
    return api.compile("cartpole")


@pytest.fixture
def batch(cartpole: Compiled) -> Iterator[BatchEnvironment]:
    with closing(deepbots_cli.make_vec(cartpole, 4)) as vector_env:
        vector_env.reset(seed=0)
        yield vector_env


@pytest.fixture
def single(cartpole: Compiled) -> Iterator[Supervisor]:
    with closing(api.make(cartpole, engine="mujoco")) as world:
        yield world


def test_a_world_that_becomes_infinite_begins_anew_and_leaves_the_others_alone(
    batch: BatchEnvironment, single: Supervisor
) -> None:
    batch.batch.singles[2].engine.set_joint("cart", "pole_hinge", np.inf, 0.0)
    with pytest.warns(
        RuntimeWarning, match=r"world 2 \(seed 2\) was reset in step 1: .* became infinite or NaN"
    ):
        observations, rewards, _, truncated, infos = batch.step(np.zeros(4, int))
    assert truncated.tolist() == [False, False, True, False]
    assert infos["final_info"]["ended_by"][2] == "not_finite"
    assert rewards[2] == 0.0
    assert [(loss.world, loss.seed, loss.step) for loss in batch.batch.losses] == [(2, 2, 1)]
    assert batch.batch.losses[0].error == "the pose of 'cart' became infinite or NaN"
    single.reset(seed=3)
    assert_same(observations[3], single.step(0)[0])
    single.reset(seed=2)
    assert_same(observations[2], single.reset()[0])


def test_what_does_not_fit_a_batch_is_named() -> None:
    with pytest.raises(BatchError, match="SeeBall does not fit a batch: it has cameras"):
        deepbots_cli.make_vec("see_ball", 2)
    with pytest.raises(BatchError, match="the engine 'pybullet' has no batches of worlds"):
        deepbots_cli.make_vec("cartpole", 2, engine="pybullet")


def test_an_action_that_does_not_fit_is_refused_and_its_world_is_named(batch: BatchEnvironment) -> None:
    for wrong, message in (
        ([0, 0, 7, 0], r"^world 2: action 7 does not fit Discrete\(2\)$"),
        ([0, -1, 0, 0], r"^world 1: action -1 does not fit Discrete\(2\)$"),
        ([0, 0], r"^actions \[0, 0\] do not fit 4 worlds of Discrete\(2\)$"),
        ([0.0, 0.0, 0.0, 0.0], "do not fit 4 worlds"),
        (None, "actions None do not fit 4 worlds"),
    ):
        with pytest.raises(UsageError, match=message):
            batch.step(wrong)
    with closing(deepbots_cli.make_vec("cartpole_continuous", 2)) as continuous:
        continuous.reset(seed=0)
        with pytest.raises(
            UsageError, match=r"^world 0: action \[nan\] does not fit Box\(-1.0, 1.0, \(1,\), float32\)$"
        ):
            continuous.step([[np.nan], [0.0]])


def test_each_part_of_an_action_is_checked() -> None:
    space = Dict({"choices": MultiDiscrete([2, 3]), "ranges": Box(-1.0, 1.0, (2,), np.float32)})
    fits = fitting_rows(
        space, {"choices": [[0, 0], [1, 3], [1, 2]], "ranges": [[0, 0], [0, 0], [0, np.nan]]}, 3
    )
    assert fits is not None
    assert fits.tolist() == [True, False, False]
    assert fitting_rows(space, {"choices": [[0, 0]]}, 1) is None


def test_a_step_needs_a_reset(cartpole: Compiled) -> None:
    with (
        closing(deepbots_cli.make_vec(cartpole, 1)) as vector_env,
        pytest.raises(UsageError, match="call reset"),
    ):
        vector_env.step(np.zeros(1, int))


def test_a_batch_takes_the_options_of_a_single_world_back(cartpole: Compiled) -> None:
    with (
        closing(api.make(cartpole, engine="mujoco")) as env,
        closing(deepbots_cli.make_vec(cartpole, 3)) as batch,
    ):
        observation, info = env.reset(seed=4)
        observations, infos = batch.reset(seed=0, options=info["drawn"])
        for world in range(3):
            assert_same(observation, observations[world])
        assert (
            infos["drawn"]["reset.joints.cart.pole_hinge"].tolist()
            == [info["drawn"]["reset.joints.cart.pole_hinge"]] * 3
        )
        assert len(set(batch.reset(seed=0)[1]["drawn"]["reset.joints.cart.pole_hinge"].tolist())) == 3


def test_the_episodes_of_a_batch_go_on_after_options_that_were_refused(cartpole: Compiled) -> None:
    with closing(deepbots_cli.make_vec(cartpole, 2)) as batch:
        batch.reset(seed=0)
        first = batch.step(np.zeros(2, int))[0]
        with pytest.raises(UsageError, match="drawn from"):
            batch.reset(options={"reset.joints.cart.pole_hinge": 9.0})
        assert not np.array_equal(batch.step(np.zeros(2, int))[0], first)


def test_zeros_have_the_same_sign_in_a_batch_and_in_single_worlds(tmp_path: Path) -> None:
    """`atan2` of 0.0 and -0.0 is pi, of 0.0 and 0.0 it is 0."""
    zero, negative = "0 * time / s", "-0.0 * time / s"
    zeros = {
        "larger": f"max({negative}, {zero})",
        "smaller": f"min({zero}, {negative})",
        "limited": f"clamp({negative}, 0 .. 1)",
        "largest": f"running_max({zero} if step < 1 else {negative})",
        "smallest": f"running_min({negative} if step < 1 else {zero})",
        "added": f"accumulate({negative}, -1 .. 0, -0.0)",
        "rounded": "cart.coarse / rad",
    }
    sensor = {"type": "joint_position", "joint": "pole_hinge", "resolution": "90 deg", "range": "-1 .. 0 rad"}
    scenario = {
        "deepbots": 1,
        "extends": "cartpole",
        "name": "Zeros",
        "robots": {"cart": {"sensors": {"coarse": sensor}}},
        "reward": {name: f"atan2({zero}, {value}) / rad" for name, value in zeros.items()},
    }
    (tmp_path / "zeros.yaml").write_text(json.dumps(scenario))
    compiled = api.compile(tmp_path / "zeros.yaml")
    with (
        closing(api.make(compiled, engine="mujoco")) as single,
        closing(deepbots_cli.make_vec(compiled, 1)) as batch,
    ):
        single.reset(seed=0)
        batch.reset(seed=[0])
        for action in (0, 1, 1, 0, 0, 0):
            _, reward, _, _, info = single.step(action)
            _, (in_batch,), *_ = batch.step(np.array([action]))
            assert reward == in_batch, info["reward_terms"]


def test_a_world_that_becomes_unstable_in_a_step_is_named_and_leaves_the_others_alone() -> None:
    """FindBall asks for contacts in each substep."""
    compiled = api.compile("find_ball")
    with (
        closing(deepbots_cli.make_vec(compiled, 3)) as batch,
        closing(api.make(compiled, engine="mujoco")) as single,
    ):
        batch.reset(seed=7)
        at, turned = batch.batch.singles[1].engine.pose("epuck")()
        batch.batch.singles[1].engine.place("epuck", at, turned, velocity=(1e200, 0.0, 0.0))
        actions = np.zeros((3, 2), np.float32)
        with pytest.warns(
            RuntimeWarning, match=r"world 1 \(seed 8\) was reset in step 1: .* became infinite or NaN"
        ):
            observations, rewards, _, truncated, infos = batch.step(actions)
        assert truncated.tolist() == [False, True, False]
        assert rewards[1] == 0.0
        assert infos["final_info"]["ended_by"][1] == "not_finite"
        for world in (0, 2):
            single.reset(seed=7 + world)
            assert_same(observations[world], single.step(actions[world])[0])


# Batches on the command line


def test_compile_prints_the_module_of_a_batch(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compile", "cartpole", "--target", "batch"]) == 0
    code = capsys.readouterr().out
    assert "class CartPoleBatch(BatchSupervisor):" in code
    assert "drive = pick(self.CHOICES_drive, action)" in code


def test_compile_says_what_a_batch_cannot_hold(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compile", "see_ball", "--target", "batch"]) == 2
    assert "SeeBall does not fit a batch: it has cameras" in capsys.readouterr().err


def test_bench_compares_engines_and_batches(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [
        "bench",
        "cartpole",
        "--engine",
        "mujoco,batch",
        "--worlds",
        "2",
        "--steps",
        "100",
        "--pairs",
        "1",
        "--json",
    ]
    assert main(arguments) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["engine"], row["worlds"]) for row in rows] == [("mujoco", 1), ("batch", 2)]
    assert all(0.0 < row["physics_us"] < row["step_us"] for row in rows)


def test_one_round_of_a_bench_is_not_called_medians(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["bench", "cartpole", "--engine", "mujoco,batch", "--worlds", "1", "--steps", "100", "--quick"])
        == 0
    )
    ran = capsys.readouterr()
    assert "random actions, one round; CPU times" in ran.out
    assert "measuring 1 round of 100 steps" in ran.err


def test_bench_refuses_worlds_without_a_batch(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "cartpole", "--worlds", "4"]) == 2
    assert "--worlds needs --engine" in capsys.readouterr().err


def test_a_vector_with_constant_components_is_observed(tmp_path: Path) -> None:
    file = tmp_path / "scenario.yaml"
    text = CART.replace(
        "observation: {", "augment: {where: 'vector(cart.place, 1 m, 2 m)'}\nobservation: {where: -4 .. 4 m, "
    )
    file.write_text(f"{text}reward: {{alive: 1}}\n", encoding="utf-8")
    compare(str(file), worlds=3, steps=10)


def test_a_robot_has_no_clearance_to_its_own_link(tmp_path: Path) -> None:
    file = tmp_path / "scenario.yaml"
    gap = "augment: {gap: 'clearance(rover, rover.base_link)'}\nobservation: {gap: -1 .. 1 m, "
    text = (SCENARIOS / "reference.yaml").read_text("utf-8").replace("observation: {", gap)
    text = text.replace("emit: [near, eye]", "emit: [near]")
    file.write_text(re.sub(r"      eye: .*\n", "", text), encoding="utf-8")
    compare(str(file), worlds=2, steps=5)
