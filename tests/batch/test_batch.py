"""A batch of worlds has the same episodes as its single worlds.

Trainings over a batch of worlds: what learners see, snapshots, and when worlds are stepped one by one.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, MultiDiscrete

import deepbots_cli
from deepbots_cli import api, learning
from deepbots_cli.api import Compiled
from deepbots_cli.cli import main
from deepbots_cli.document import Permissions
from deepbots_cli.engines import ENGINES
from deepbots_cli.errors import BatchError, EvaluationError, UsageError
from deepbots_cli.learning import learner
from deepbots_cli.learning.environments import EvaluationWorlds, stepping_text, supervisor_factory
from deepbots_cli.learning.sb3.rollouts import CollectorEnvironment
from deepbots_cli.program import Program
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.collector import LocalCollector
from deepbots_cli.rollout.policies import ordered_episodes, play_batch, play_episodes
from deepbots_cli.rollout.worlds import BatchWorlds, SingleWorlds, Worlds, observation_digest
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.batch import BatchEnvironment
from deepbots_cli.runtime.spaces import fitting_rows
from tests.few import few
from tests.worlds import CART, SCENARIOS

pytest.importorskip("deepbots_cli.engines.mujoco")


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
    overrides = ("truncation.max_time={limit: 0.6 s, success: all}",) if name in ENDLESS else ()
    assert compare(name, worlds=3, steps=40, overrides=overrides) > 0


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


@pytest.mark.parametrize(
    ("name", "world", "breaks", "error"),
    [
        (
            "cartpole",
            2,
            lambda engine: engine.set_joint("cart", "pole_hinge", np.inf, 0.0),
            "the pose of 'cart' became infinite or NaN",
        ),
        (
            "multi_cartpole",
            1,
            lambda engine: engine.set_joint("cart#4", "pole_hinge", np.inf, 0.0),
            "became infinite",
        ),
        # FindBall asks for contacts in each substep.
        (
            "find_ball",
            1,
            lambda engine: engine.place("epuck", *engine.pose("epuck")(), velocity=(1e200, 0.0, 0.0)),
            "",
        ),
    ],
)
def test_a_world_that_becomes_infinite_begins_anew_and_leaves_the_others_alone(
    name: str, world: int, breaks: Callable[[Any], None], error: str
) -> None:
    compiled = api.compile(name)
    with (
        closing(deepbots_cli.make_vec(compiled, 4)) as batch,
        closing(api.make(compiled, engine="mujoco")) as single,
    ):
        batch.reset(seed=7)
        breaks(batch.batch.singles[world].engine)
        actions = np.zeros_like(batch.action_space.sample())
        reset = rf"world {world} \(seed {7 + world}\) was reset in step 1: .* became infinite or NaN"
        with pytest.warns(RuntimeWarning, match=reset):
            observations, rewards, _, truncated, infos = batch.step(actions)
        assert truncated.tolist() == [number == world for number in range(4)]
        assert (rewards[world], infos["final_info"]["ended_by"][world]) == (0.0, "not_finite")
        (loss,) = batch.batch.losses
        assert (loss.world, loss.seed, loss.step) == (world, 7 + world, 1)
        assert error in loss.error
        for number in range(4):
            single.reset(seed=7 + number)
            expected = single.reset() if number == world else single.step(actions[number])
            assert_same(observations[number], expected[0])


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


# Batches on the command line


def test_compile_prints_the_module_of_a_batch(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compile", "cartpole", "--target", "batch"]) == 0
    code = capsys.readouterr().out
    assert "class CartPoleBatch(BatchSupervisor):" in code
    assert "drive = pick(self.CHOICES_drive, action)" in code


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
    rows = json.loads(capsys.readouterr().out)["speeds"]
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


# Trainings over a batch of worlds: what learners see, snapshots, and when worlds are stepped one by one


pytest.importorskip("deepbots_cli.engines.mujoco")
pytest.importorskip("stable_baselines3")


SEEDS = (3, 4, 5)
MASKED = (
    "action={drive: {choices: {forward: 1, backward: -1}, forbid: {backward: x > 3 mm}}}",
    "train={algorithm: MaskablePPO, total_timesteps: 1000, environments: 8, n_steps: 32, n_epochs: 1}",
)


@pytest.fixture(scope="module")
def program() -> Program:
    return api.compile("cartpole").program


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        pytest.param("cartpole", (), id="alone"),
        pytest.param("cartpole", MASKED, id="masked", marks=pytest.mark.slow),
        pytest.param("multi_cartpole", MASKED, id="copies"),
    ],
)
def test_a_learner_sees_the_same_of_a_batch_as_of_single_worlds(
    name: str, overrides: tuple[str, ...]
) -> None:
    program = api.compile(name, overrides=overrides).program
    episodes: dict[str, list[tuple[int, Episode]]] = {"batch": [], "single": []}
    batched = BatchWorlds(
        lambda stage: api.build_batch(program, 3),
        SEEDS,
        on_episode=lambda world, episode: episodes["batch"].append((world, episode)),
    )
    singles = [api.build(program, engine="mujoco") for _ in SEEDS]
    usual = SingleWorlds(
        singles, SEEDS, on_episode=lambda world, episode: episodes["single"].append((world, episode))
    )
    with closing(batched), closing(usual):
        np.testing.assert_array_equal(batched.reset(), usual.reset())
        generator = np.random.default_rng(0)
        for _ in range(60):
            actions = generator.integers(0, 2, usual.rows)
            for of_batch, of_singles in zip(
                batched.step_all(actions)[:3], usual.step_all(actions)[:3], strict=True
            ):
                np.testing.assert_array_equal(of_batch, of_singles)
            np.testing.assert_array_equal(batched.action_masks(), usual.action_masks())
    masks = CollectorEnvironment(LocalCollector(batched)).env_method("action_masks")
    np.testing.assert_array_equal(masks, batched.action_masks())
    assert batched.action_masks().all() == (not overrides)
    assert episodes["batch"] == episodes["single"] != []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "overrides"), [("cartpole", []), ("multi_cartpole", ["robots.cart.count=2"])]
)
def test_worlds_of_a_batch_enter_another_stage_one_by_one(name: str, overrides: list[str]) -> None:
    """When three episodes have ended, each at the end of its own, as single worlds do."""
    program, harder = (
        api.compile(name, overrides=[*overrides, *more]).program for more in ([], ["fall_angle=8 deg"])
    )
    programs = [program, harder]
    steps: list[list[object]] = []
    kinds: list[list[int]] = []

    def stage_of(done: int) -> int:
        return int(done >= 3)

    for is_batch in (True, False):
        done: list[int] = []
        stages = [0, 0, 0]

        def enter(world: int, done: list[int] = done, stages: list[int] = stages) -> int | None:
            if stages[world] == stage_of(len(done)):
                return None
            stages[world] = 1
            return 50 + world

        def next_world(
            world: int, enter: Callable[[int], int | None] = enter
        ) -> tuple[Supervisor, int] | None:
            seed = enter(world)
            return None if seed is None else (api.build(harder, engine="mujoco"), seed)

        def count(world: int, episode: Episode, done: list[int] = done) -> None:
            done.append(world)

        env: Worlds
        if is_batch:
            env = BatchWorlds(
                lambda stage: api.build_batch(programs[stage], 3),
                SEEDS,
                stages,
                on_episode=count,
                next_seed=enter,
            )
        else:
            singles = [api.build(program, engine="mujoco") for _ in SEEDS]
            env = SingleWorlds(singles, SEEDS, on_episode=count, next_world=next_world)
        transitions: list[object] = [env.reset().tolist()]
        of_stages = []
        with closing(env):
            generator = np.random.default_rng(1)
            for _ in range(120):
                step = env.step_all(generator.integers(0, 2, env.rows))
                transitions.append(
                    (
                        step.observations.tolist(),
                        step.rewards.tolist(),
                        step.ended.tolist(),
                        [ending.episode for ending in step.endings],
                    )
                )
                of_stages.append(sum(stages))
            if is_batch:
                histories = env.histories()
                with closing(
                    BatchWorlds(lambda stage: api.build_batch(programs[stage], 3), SEEDS, stages)
                ) as other:
                    assert observation_digest(other.repeat(histories)) == observation_digest(env.observations)
        steps.append(transitions)
        kinds.append(of_stages)
    assert steps[0] == steps[1]
    assert kinds[0] == kinds[1]
    assert {0, 1, 2, 3} == set(kinds[0])


def test_a_running_batch_is_restored_exactly(program: Program) -> None:
    with (
        closing(BatchWorlds(lambda stage: api.build_batch(program, 3), SEEDS)) as first,
        closing(BatchWorlds(lambda stage: api.build_batch(program, 3), SEEDS)) as restored,
    ):
        first.reset()
        plan = np.random.default_rng(1).integers(0, 2, (90, 3))
        for actions in plan[:50]:
            first.step_all(actions)
        assert len({len(history.actions) for history in first.histories()}) > 1
        assert observation_digest(restored.repeat(first.histories())) == observation_digest(
            first.observations
        )
        for actions in plan[50:]:
            mine, again = first.step_all(actions), restored.step_all(actions)
            np.testing.assert_array_equal(mine[0], again[0])
            assert [ending.episode for ending in mine.endings] == [ending.episode for ending in again.endings]


def untrained(program: Program, spaces: Any) -> Any:
    """A policy for the spaces of these worlds."""
    assert program.agent.training is not None
    return learner.create(
        learner.Setup(program.agent.training, spaces.observation_space, spaces.action_space)
    )


def evaluated(
    name: str, worlds: int, seeds: list[int], overrides: tuple[str, ...] = ()
) -> tuple[list[Episode], list[Episode]]:
    """Episodes of an untrained policy in a batch, and in a single world."""
    program = api.compile(name, overrides=overrides).program
    single = api.build(program, engine="mujoco")
    numbers = range(len(seeds))
    with closing(SingleWorlds([single], [0])), closing(api.build_batch(program, worlds)) as many:
        policy = untrained(program, many)
        apart = play_episodes(policy, single, seeds, deterministic=True, numbers=numbers)
        return ordered_episodes(play_batch(policy, many, seeds), numbers), ordered_episodes(apart, numbers)


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("cartpole", ("action={drive: -1 .. 1}", "truncation.max_steps=20")),  # episodes of many lengths
        pytest.param("cartpole", (*MASKED, "truncation.max_steps=20"), marks=pytest.mark.slow),
        pytest.param("multi_cartpole", ("truncation.max_steps=12",), marks=pytest.mark.slow),
        ("multi_cartpole", (*MASKED, "robots.cart.count=3", "truncation.max_steps=12")),
        (
            "quadrotor",
            ("truncation={max_steps: 2}",),
        ),  # several timesteps in a step, and functions that numpy rounds otherwise
    ],
)
def test_an_evaluation_in_a_batch_gives_the_episodes_of_single_worlds(
    name: str, overrides: tuple[str, ...]
) -> None:
    together, apart = evaluated(name, worlds=10, seeds=list(range(21)), overrides=overrides)
    assert together == apart


def test_an_evaluation_in_which_a_world_fails_is_left_to_single_worlds() -> None:
    """They say which episode it is, and keep it."""
    program = api.compile("cartpole", overrides=("reward.odd=1/(5 - step)",)).program
    with closing(EvaluationWorlds(supervisor_factory("mujoco"), engine="mujoco", batch=8)) as worlds:
        worlds.enter(program)
        assert worlds.has_batch_for(8)
        policy = untrained(program, worlds.first)
        with pytest.raises(EvaluationError, match=r"episode 0 \(seed 0\), .*step 5"):
            worlds.play(policy, range(8))


def test_a_policy_that_draws_its_actions_plays_in_single_worlds() -> None:
    program = api.compile("cartpole", overrides=("action={drive: -1 .. 1}", "reward.push=drive")).program
    with closing(EvaluationWorlds(supervisor_factory("mujoco"), engine="mujoco", batch=8)) as worlds:
        worlds.enter(program)
        policy = untrained(program, worlds.first)
        likeliest, drawn = (worlds.play(policy, range(8), deterministic=value) for value in (True, False))
    assert likeliest != drawn


def test_a_note_says_why_worlds_are_stepped_one_by_one() -> None:
    camera, cart = api.compile("see_ball").program, api.compile("cartpole").program
    assert (
        stepping_text(camera, 8, "mujoco", supervisor_factory("mujoco"))
        == "SeeBall steps its 8 worlds one by one: it has cameras, whose pictures are drawn world by world"
    )
    assert (
        stepping_text(cart, 8, "mujoco", supervisor_factory("mujoco"))
        == "CartPole steps its 8 worlds together, as a batch"
    )
    assert stepping_text(camera, 8, "pybullet", supervisor_factory("pybullet")) == ""


def test_a_batch_enters_the_next_stage_after_an_evaluation(tmp_path: Path) -> None:
    stages = (
        "curriculum=[{name: easy, set: {truncation.max_steps: 3}, until: mean_return >= 2 in"
        " evaluation}, {name: hard}]"
    )
    changes = [
        stages,
        "truncation.max_steps=5",
        "train.n_steps=32",
        "train.n_epochs=1",
        "solved=mean_return >= 195 over 8 episodes",
    ]
    result = learning.train(
        api.compile("cartpole", overrides=changes),
        run=tmp_path / "run",
        total_timesteps=1024,
        engine="mujoco",
    )
    (done,) = result.stages
    rows = list(csv.DictReader((tmp_path / "run" / "monitor.csv").read_text().splitlines()[1:]))
    assert (done.value, done.steps % 8) == (3.0, 0)
    assert {(row["stage"], row["l"]) for row in rows if int(row["steps"]) > done.steps + 24} == {
        ("hard", "5")
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("cartpole", ()),
        (
            "cartpole",
            ("curriculum=[{name: easy, set: {fall_angle: 20 deg}, until: 480 steps}, {name: hard}]",),
        ),
        ("cartpole", MASKED),
        ("multi_cartpole", ()),
    ],
    ids=["alone", "curriculum", "masked", "copies"],
)
def test_a_training_over_a_batch_resumes_to_the_bit(
    tmp_path: Path, name: str, changes: tuple[str, ...]
) -> None:
    compiled = api.compile(name, overrides=[*changes, "train.n_steps=32", "train.n_epochs=1"])
    whole = learning.train(
        compiled, run=tmp_path / "whole", total_timesteps=1024, engine="mujoco", stop_when_solved=False
    )
    learning.train(
        compiled, run=tmp_path / "parts", total_timesteps=512, engine="mujoco", stop_when_solved=False
    )
    parts = learning.resume(tmp_path / "parts", total_timesteps=1024, stop_when_solved=False)
    assert parts.inexact == ()
    assert parts.weights_digest == whole.weights_digest
