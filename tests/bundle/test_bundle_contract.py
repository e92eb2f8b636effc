"""An exported policy commands what the robots of the simulation apply, to 1e-5 of each command's range, in
every scenario that exports.

Loading a bundle: one that is damaged, changed or put together from two exports is refused in a sentence,
or acts the same.

The files for LeRobot command what the robot of the simulation applies.

A runner of Isaac Lab that follows `deploy.yaml` commands what the robot of the simulation applies.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import closing
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

import msgspec
import numpy as np
import onnx
import onnxruntime
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load

import deepbots_robot
from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export.deploy import DEPLOY_NAME, GRAPH_NAME, deploy_settings, isaac_files
from deepbots_cli.insight.export.devices import recorded_steps
from deepbots_cli.insight.export.lerobot import ACTION, STATE, lerobot_files
from deepbots_cli.insight.export.network import numbers_read
from deepbots_cli.program.identity import Deployment
from deepbots_cli.rollout.policies import PolicyDriver
from deepbots_robot import Bundle, BundleError, InputError, bundle, model, onnx_file
from tests.bundle.untrained import compare_with_simulation, untrained_bundle, with_training
from tests.few import few

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")


DATA = Path(__file__).parents[1] / "data" / "scenarios"
FURTHER: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("rail", ()),
    ("rail", ("messages.format=none",)),
    ("rail", ("messages.timing=delayed",)),
    ("drawn", ()),
    ("pair", ()),
    ("pair", ("agent={action_repeat: 3}",)),
    ("../../world/hills", ()),
    ("drone", ()),
    ("sensed", ()),
    ("pushed", ()),
    ("../../bundle/readings", ()),
)
FAST = ("quadruped", "multi_cartpole", "see_ball", "find_and_avoid")
"""The law `a_bundle_commands_what_the_simulation_applies` has small worlds, without pictures and copies."""


@pytest.mark.parametrize("scenario", few(shipped.scenario_names(), FAST))
def test_a_bundle_commands_what_the_robots_of_the_simulation_apply(scenario):
    comparison = compare_with_simulation(scenario, steps=60)
    assert comparison.steps == 60
    assert comparison.worst <= 1e-5


@pytest.mark.parametrize("scenario", few(shipped.scenario_names(), FAST))
def test_lint_names_the_readings_that_nothing_on_a_robot_measures(scenario):
    """`DB617` asks for a supplier of each."""
    step, _, loaded = untrained_bundle(scenario)
    of_source = {
        source: {entry.name for entry in loaded.info.inputs if entry.source == source}
        for source in ("sensor", "supervisor", "goal")
    }
    deployment = Deployment(step.program)
    assert of_source["supervisor"] == {*deployment.unmeasured}
    assert of_source["goal"] == {*deployment.goals}


@pytest.mark.slow
@pytest.mark.parametrize("scenario", shipped.scenario_names())
def test_over_a_thousand_steps_too(scenario):
    comparison = compare_with_simulation(scenario, steps=1000)
    assert comparison.steps >= 900  # an episode is left where two options are equally good
    assert comparison.worst <= 1e-5


@pytest.mark.parametrize(
    ("scenario", "overrides"),
    [
        ("find_and_avoid", ["agent={action_repeat: 3, frame_stack: 2}"]),
        (
            "line_follower",
            [
                "agent={action_repeat: 4}",
                "observation.time=0 .. 60 s",
                "observation.step=0 .. 100",
                "train.algorithm=RecurrentPPO",
            ],
        ),
    ],
)
def test_what_advances_between_two_actions_does_so_in_a_bundle(scenario, overrides):
    """The bundle is called in every timestep. Between two actions it repeats its last commands."""
    step, _, loaded = untrained_bundle(scenario, *overrides)
    assert loaded.info.timestep_s == step.program.world.timestep
    comparison = compare_with_simulation(scenario, *overrides, steps=100)
    assert comparison.steps == 100
    assert comparison.worst <= 1e-5


def test_what_robots_and_messages_remember_advances_when_they_act():
    comparison = compare_with_simulation(str(Path(__file__).parent / "messages.yaml"), steps=60)
    assert comparison.steps == 60
    assert comparison.worst <= 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(("name", "overrides"), FURTHER)
def test_scenarios_of_other_tests_too(name, overrides):
    assert compare_with_simulation(str(DATA / f"{name}.yaml"), *overrides, steps=100).worst <= 1e-5


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        (
            ["messages.timing=delayed"],
            "`apply` of rover reads sensors or keeps values, and messages to it arrive late",
        ),
        (
            ["observation={previous_reward: -1 .. 1}"],
            "the policy sees 'previous_reward', but the reward is known only during training",
        ),
    ],
)
def test_a_scenario_that_cannot_be_exported_is_refused_by_name(overrides, named):
    with pytest.raises(UsageError) as caught:
        untrained_bundle("find_and_avoid", *overrides)
    assert named in str(caught.value)


def test_a_sensor_and_an_actuator_of_one_name_cannot_be_exported(tmp_path: Path) -> None:
    text = shipped.scenario_path("cartpole").read_text("utf-8").replace("wheels", "pole_angle")
    file = tmp_path / "same.yaml"
    file.write_text(text.replace("../robots/urdf/cartpole.urdf", "cartpole"), encoding="utf-8")
    with pytest.raises(UsageError, match=r"two values called `cart\.pole_angle`"):
        untrained_bundle(str(file))


def test_what_a_scenario_says_in_many_words_is_read_again() -> None:
    _, _, loaded = untrained_bundle("cartpole")
    summary = "balances " * 1000
    info = msgspec.structs.replace(
        loaded.info, scenario=msgspec.structs.replace(loaded.info.scenario, summary=summary)
    )
    assert model.decode(model.encode(info)).scenario.summary == summary


@pytest.mark.parametrize(
    ("scenario", "unused"),
    [
        ("cartpole", {"position(cart)": {1, 2}, "velocity(cart)": {1, 2}, "velocity(cart.tip)": {1, 2}}),
        ("balancer", {"bot.accel": {1}, "bot.gyro": {0, 2}}),
    ],
)
def test_numbers_that_the_graph_does_not_read_change_nothing_and_all_others_do(
    scenario: str, unused: dict[str, set[int]]
) -> None:
    step, _, loaded = untrained_bundle(scenario)
    read = numbers_read(step.model({}))
    unread = {entry.name: {*range(entry.shape[0])} - read[entry.name] for entry in loaded.info.inputs}
    assert {name: places for name, places in unread.items() if places} == unused
    rng = np.random.default_rng(0)
    changed = {(entry.name, place): 0 for entry in loaded.info.inputs for place in range(entry.shape[0])}
    for _ in range(20):
        values = {entry.name: rng.normal(0.0, 0.1, entry.shape) for entry in loaded.info.inputs}
        wanted = results(loaded, values)
        for name, place in changed:
            moved = {key: value.copy() for key, value in values.items()}
            moved[name][place] += 0.05
            changed[name, place] += results(loaded, moved) != wanted
    assert {key for key, count in changed.items() if not count} == {
        (name, place) for name, places in unused.items() for place in places
    }


def results(loaded: Bundle, values: dict[str, Any]) -> list[bytes]:
    """All outputs of two steps with these values."""
    policy = loaded.start()
    return [value.tobytes() for _ in range(2) for value in policy.step(values).values()]


# Loading a bundle: one that is damaged, changed or put together from two exports is refused in a sentence,


ROOT = Path(__file__).parents[2]


def values_of(loaded: deepbots_robot.Bundle, rng: np.random.Generator) -> dict[str, Any]:
    return {entry.name: rng.normal(0.0, 3.0, entry.shape) for entry in loaded.info.inputs}


def test_a_policy_remembers_until_it_is_reset(folder: Path) -> None:
    loaded = deepbots_robot.load(folder)
    policy, independent = loaded.start(), loaded.start()
    rng = np.random.default_rng(0)
    rows = [values_of(loaded, rng) for _ in range(5)]
    first = [policy.step(row)["bot.wheels"].tolist() for row in rows]
    again = [policy.step(row)["bot.wheels"].tolist() for row in rows]
    assert first != again
    policy.reset()
    assert [policy.step(row)["bot.wheels"].tolist() for row in rows] == first
    assert [
        independent.step(row)["bot.wheels"].tolist() for row in rows
    ] == first  # each policy has a memory of its own


def test_in_a_loop_that_is_a_multiple_faster_the_policy_acts_on_every_nth_call(folder: Path) -> None:
    loaded = deepbots_robot.load(folder)
    policy, fast = loaded.start(), loaded.start(3 * loaded.info.rate_hz)
    rng = np.random.default_rng(0)
    rows = [values_of(loaded, rng) for _ in range(12)]
    wanted = [policy.step(row)["bot.wheels"].tolist() for row in rows[::3]]
    assert [fast.step(row)["bot.wheels"].tolist() for row in rows] == [
        command for command in wanted for _ in range(3)
    ]
    fast.reset()
    assert fast.step(rows[0])["bot.wheels"].tolist() == wanted[0]


@pytest.mark.parametrize("ratio", [0.5, 1.5, 0.0, -1.0, float("nan"), float("inf")])
def test_another_rate_is_refused(folder: Path, ratio: float) -> None:
    loaded = deepbots_robot.load(folder)
    with pytest.raises(BundleError, match="not a whole multiple"):
        loaded.start(ratio * loaded.info.rate_hz)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bot.gyro": [0.0, 0.0]}, "'bot.gyro' has the shape [2]; it must have [3]"),
        ({"bot.gyro": [0.0, np.nan, 0.0]}, "'bot.gyro' is not finite"),
        ({"bot.gyro": ["a", "b", "c"]}, "'bot.gyro' is of the type"),
        ({"bot.gyro": [True, False, True]}, "'bot.gyro' is of the type bool; it must be float64"),
        ({"bot.compass": 0.0}, "1 unknown (bot.compass)"),
    ],
)
def test_values_that_do_not_fit_change_nothing(folder: Path, change: dict[str, Any], message: str) -> None:
    loaded = deepbots_robot.load(folder)
    policy, unharmed = loaded.start(), loaded.start()
    values = values_of(loaded, np.random.default_rng(0))
    for each in (policy, unharmed):
        each.step(values)
    with pytest.raises(InputError) as caught:
        policy.step(values | change)
    assert message in str(caught.value)
    assert policy.step(values)["bot.wheels"].tolist() == unharmed.step(values)["bot.wheels"].tolist()


def test_a_missing_value_is_named(folder: Path) -> None:
    with pytest.raises(InputError, match=r"1 missing \(bot.gyro\)"):
        deepbots_robot.load(folder).start().step({"bot.accel": [0.0, 0.0, 9.81]})


# Recorded steps


def test_an_option_that_is_not_the_best_is_refused_unless_two_are_equally_good(
    choosing: Path, tmp_path: Path
) -> None:
    loaded = deepbots_robot.load(choosing)
    parity = bundle.read_parity((choosing / bundle.PARITY_NAME).read_bytes(), loaded.info)
    bundle.replay(loaded, parity)
    outputs = {name: rows.copy() for name, rows in parity.outputs.items()}
    outputs["action"][7] = 1 - outputs["action"][7]
    outputs["cart.wheels"][7] *= -1
    with pytest.raises(BundleError, match=r"step 7: 'cart\.wheels'"):
        bundle.replay(loaded, bundle.Parity(parity.inputs, outputs, parity.starts))
    outputs["scores"][7] = 0.5
    bundle.replay(loaded, bundle.Parity(parity.inputs, outputs, parity.starts))


# Hostile files


@given(st.binary(max_size=200))
def test_bytes_that_are_not_a_model_are_refused_or_have_no_nodes(content: bytes) -> None:
    try:
        onnx_file.require_plain(content)
    except BundleError:
        return
    assert not onnx.load_from_string(content).graph.node


@given(st.binary(max_size=300) | st.text(max_size=200).map(str.encode))
def test_bytes_that_are_not_a_description_are_refused(content: bytes) -> None:
    with pytest.raises(BundleError, match=r"bundle.json"):
        model.decode(content)


# What is published


def test_the_schema_is_that_of_the_records() -> None:
    """`python -m deepbots_robot.model` writes it."""
    assert (ROOT / model.PATH).read_text(encoding="utf-8") == model.json_schema()


def test_a_bundle_fits_the_published_schema(folder: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    published = json.loads((ROOT / model.PATH).read_text())
    jsonschema.Draft202012Validator.check_schema(published)
    jsonschema.validate(json.loads((folder / bundle.BUNDLE_NAME).read_text()), published)


def test_a_robot_imports_no_simulator_and_no_learner(folder: Path) -> None:
    code = f"""
import sys, deepbots_robot
deepbots_robot.load({str(folder)!r}).start()
for name in ("deepbots_cli", "torch", "pybullet", "mujoco", "pydantic", "gymnasium", "onnx", "scipy"):
    assert name not in sys.modules, name
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


# The files for LeRobot command what the robot of the simulation applies


pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")


Files = Mapping[PurePosixPath, bytes]


def scaled(files: Files, name: str, key: str, values: Any, *, back: bool = False) -> Any:
    """The output of a normalizer of LeRobot in float32, from the files of a pipeline; `back` selects the
    unnormalizer."""
    (step,) = [
        each for each in json.loads(files[PurePosixPath(f"{name}.json")])["steps"] if "state_file" in each
    ]
    assert step["registry_name"] == ("unnormalizer_processor" if back else "normalizer_processor")
    assert step["config"]["features"][key]["shape"] == [len(values)]
    assert step["config"]["norm_map"][step["config"]["features"][key]["type"]] == "MIN_MAX"
    ends = load(files[PurePosixPath(step["state_file"])])
    low, high = (ends[f"{key}.{end}"].astype(np.float32) for end in ("min", "max"))
    numbers = np.asarray(values, np.float32)
    return (numbers + 1) / 2 * (high - low) + low if back else 2 * (numbers - low) / (high - low) - 1


CARTPOLE: Mapping[str, Callable[[Mapping[str, Any]], float]] = {
    "x": lambda values: values["position(cart)"][0],
    "speed": lambda values: values["velocity(cart)"][0],
    "cart.pole_angle": lambda values: values["cart.pole_angle"][0],
    "tip_speed": lambda values: values["velocity(cart.tip)"][0],
}


@pytest.mark.parametrize("scenario", ["cartpole", "cartpole_continuous"])
def test_processors_of_lerobot_around_the_graph_command_what_the_simulated_robot_applies(
    scenario: str,
) -> None:
    step, learner, _ = untrained_bundle(scenario)
    files = lerobot_files(step.program, learner)
    session = onnxruntime.InferenceSession(
        files[PurePosixPath("policy.onnx")], providers=["CPUExecutionProvider"]
    )
    features = json.loads(files[PurePosixPath("features.json")])["features"]
    with closing(recorded_steps(step, lambda world: PolicyDriver(learner, world))) as recorded:
        for each in islice(recorded, 60):
            state = [CARTPOLE[name](each.inputs) for name in features[STATE]["names"]]
            (action,) = session.run(
                [ACTION], {STATE: scaled(files, "policy_preprocessor", STATE, state)[None]}
            )
            commands = scaled(files, "policy_postprocessor", ACTION, action[0], back=True)
            assert commands == pytest.approx(each.commands["cart.wheels"], abs=1e-4 * 25)
    assert [name.removeprefix("cart.wheels.") for name in features[ACTION]["names"]] == [
        *step.outputs[0].components
    ]
    assert features[ACTION]["units"] == ["rad/s"] * 4


def test_the_ranges_for_lerobot_have_all_digits() -> None:
    step, learner, _ = untrained_bundle("cartpole")
    files = lerobot_files(step.program, learner)
    ends = load(files[PurePosixPath("policy_preprocessor_step_2_normalizer_processor.safetensors")])
    assert ends[f"{STATE}.max"].tolist() == [number.high for number in step.program.agent.numbers]


@pytest.mark.parametrize(
    ("scenario", "named"),
    [
        ("quadruped", "the observation of previous_action"),
        ("pit_escape", "`agent.frame_stack`"),
        ("panda_reach", "goals, images and copies"),
        ("find_and_avoid", "forbids options"),
        ("find_ball", "`apply` of FindBall reads sensors, has a memory or is not linear"),
    ],
)
def test_a_scenario_that_lerobot_cannot_represent_is_refused(scenario: str, named: str) -> None:
    step, learner, _ = untrained_bundle(scenario)
    with pytest.raises(UsageError) as caught:
        lerobot_files(step.program, learner)
    assert named in str(caught.value)


# A runner of Isaac Lab that follows `deploy.yaml` commands what the robot of the simulation applies


pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")


WALK = str(Path(__file__).parent / "walk.yaml")
Terms = Mapping[str, Callable[[Mapping[str, Any], Any], Any]]


class Runner:
    """What `deploy.yaml` asks of a runner, over functions for the terms."""

    def __init__(self, settings: Mapping[str, Any], graph: bytes, terms: Terms) -> None:
        self._settings, self._terms = settings, terms
        self._session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
        self._action = settings["actions"]["JointPositionAction"]
        self.reset()

    def reset(self) -> None:
        self._history: dict[str, deque[Any]] = {}
        self._last: Any = np.zeros(len(self._action["scale"]))

    def step(self, values: Mapping[str, Any]) -> Any:
        numbers = []
        for name, term in self._settings["observations"].items():
            value = np.asarray(self._terms[name](values, self._last), float)
            value = np.clip(value, *term["clip"]) if term["clip"] else value
            count = term["history_length"]
            rows = self._history.setdefault(name, deque([value * term["scale"]] * count, count))
            rows.append(value * term["scale"])
            numbers += rows
        (actions,) = self._session.run(["actions"], {"obs": np.concatenate(numbers)[None].astype(np.float32)})
        self._last = actions[0]
        return np.clip(
            self._last * self._action["scale"] + self._action["offset"], *np.transpose(self._action["clip"])
        )


def test_a_runner_commands_what_the_simulated_robot_applies() -> None:
    step, learner, _ = untrained_bundle(WALK)
    files = isaac_files(step.program, learner)
    settings = yaml.safe_load(files[DEPLOY_NAME])
    assert [*settings["observations"]] == [
        "vx", "wz", "projected_gravity", "base_ang_vel", "joint_pos_rel", "joint_vel_rel", "last_action",
    ]  # fmt: skip
    default = np.array(settings["default_joint_pos"])
    runner = Runner(
        settings,
        files[GRAPH_NAME],
        {
            "vx": lambda values, last: values["vx"],
            "wz": lambda values, last: values["wz"],
            "projected_gravity": lambda values, last: values["dog.down"],
            "base_ang_vel": lambda values, last: values["dog.gyro"],
            "joint_pos_rel": lambda values, last: values["dog.q"] - default,
            "joint_vel_rel": lambda values, last: values["dog.dq"],
            "last_action": lambda values, last: last,
        },
    )
    recorded = recorded_steps(step, lambda world: PolicyDriver(learner, world))
    for each in islice(recorded, 60):
        if each.first:
            runner.reset()
        assert runner.step(each.inputs) == pytest.approx(each.commands["dog.legs"], abs=1e-5)
    recorded.close()


def test_the_file_has_all_digits_and_the_order_of_joints() -> None:
    step, learner, _ = untrained_bundle(WALK)
    settings = yaml.safe_load(isaac_files(step.program, learner)[DEPLOY_NAME])
    assert settings == deploy_settings(step.program)
    assert settings["default_joint_pos"][4] == np.pi / 4
    in_file = [
        joint.name
        for joint in step.program.world.robots[0].model.joints
        if joint.name in settings["joint_names"]
    ]
    assert [in_file[index] for index in settings["joint_ids_map"]] == settings["joint_names"]
    assert settings["step_dt"] == 0.02
    assert settings["stiffness"] == [40.0] * 12
    assert settings["observations"]["joint_vel_rel"] == {
        "params": {},
        "clip": [-20.0, 20.0],
        "scale": [0.05] * 12,
        "history_length": 2,
    }


def test_sensors_of_one_kind_keep_their_numbers_and_the_name_of_the_base_is_for_its_own() -> None:
    """A vector that is shorter than the policy expects; a foot whose readings pass for those of the body."""
    program = untrained_bundle(
        WALK,
        "robots.dog.sensors.foot={type: gyro, link: FR_toe}",
        "robots.dog.sensors.turned={type: projected_gravity, link: trunk, pose: {yaw: 90 deg}}",
        "robots.dog.sensors.again={type: gyro, link: trunk}",
        "robots.dog.emit={q: q - stand, dq: dq, gyro: gyro, down: turned, foot: foot, again: again}",
        "observation={dog.foot: -9 .. 9 rad/s, dog.gyro: -6 .. 6 rad/s, dog.down: -1 .. 1, dog.again: -6 .. 6 rad/s}",
    )[0].program
    observations = deploy_settings(program)["observations"]
    assert [*observations] == ["dog_foot", "base_ang_vel", "dog_down", "dog_again"]
    assert sum(len(term["scale"]) for term in observations.values()) == len(program.agent.inputs)


def test_the_reading_of_a_single_joint_has_the_name_of_a_runner(tmp_path: Path) -> None:
    (tmp_path / "rail.yaml").write_text(
        """deepbots: 1
name: Rail
world: {timestep: 20 ms}
robots:
  rail:
    urdf: cartpole_rail
    base: fixed
    sensors: {at: {type: joint_position, joint: slider}}
    actuators:
      servo: {type: position_motor, joint: slider, stiffness: 9 N/m, damping: 1 N*s/m, max_torque: 9 N}
    apply: {servo: 0.1 m * go}
action: {go: -1 .. 1}
observation: {rail.at: -1 .. 1 m}
reward: {still: 1}
truncation: {max_steps: 100}
"""
    )
    assert [*deploy_settings(api.compile(tmp_path / "rail.yaml").program)["observations"]] == ["joint_pos"]


def test_the_ranges_of_commands_are_those_of_the_training() -> None:
    program = untrained_bundle(
        WALK,
        "parameters.way=uniform(-0.2 -2 .. 0.4 2 m/s)",
        "augment=[vx, wz, way]",
        "observation.way=-1 .. 1 m/s",
        "observation.wz={range: -0.3 .. 0.3 rad/s, clip: false}",
    )[0].program
    assert deploy_settings(program)["commands"] == {
        "vx": {"ranges": {"vx": [-0.5, 1.0]}},
        "wz": {"ranges": {"wz": [-1.0, 1.0]}},
        "way": {"ranges": {"way_x": [-0.2, 0.4], "way_y": [-1.0, 1.0]}},
    }


@pytest.mark.parametrize(
    ("scenario", "overrides", "named"),
    [
        ("cartpole", [], "choices, goals, images, copies"),
        ("find_ball", [], "the scenario commands epuck.left_wheel, epuck.right_wheel"),
        ("quadrotor", [], "'rotors' is none"),
        (
            WALK,
            ["observation.vx=-0.5 .. 1 m/s"],
            "the range of the observation 'vx' must be the same for all components and symmetric",
        ),
        (
            WALK,
            ["robots.dog.apply.legs=stand + reach * stride^3"],
            "`apply.legs` is not a scale and an offset",
        ),
        (
            WALK,
            ["robots.dog.actuators.legs.max_velocity=0.1 rad/s"],
            "without `max_velocity`, and 'legs' is none",
        ),
    ],
)
def test_a_scenario_that_does_not_fit_is_refused(scenario: str, overrides: list[str], named: str) -> None:
    with pytest.raises(UsageError) as caught:
        deploy_settings(untrained_bundle(scenario, *overrides)[0].program)
    assert named in str(caught.value)


def test_a_recurrent_policy_is_refused() -> None:
    program = untrained_bundle(WALK)[0].program
    assert program.agent.training is not None
    recurrent = with_training(program, algorithm="RecurrentPPO")
    with pytest.raises(UsageError, match="a recurrent policy does not fit the runners"):
        deploy_settings(recurrent)
