"""A runner of Isaac Lab that follows `deploy.yaml` commands what the robot of the simulation applies."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
import onnxruntime

from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export.deploy import DEPLOY_NAME, GRAPH_NAME, deploy_settings, isaac_files
from deepbots_cli.insight.export.devices import recorded_steps
from deepbots_cli.rollout.policies import PolicyDriver
from tests.bundle.untrained import untrained_bundle, with_training

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


def test_the_ranges_of_commands_are_those_of_the_training() -> None:
    program = untrained_bundle(
        WALK,
        "parameters.way=uniform(-0.2 -2 .. 0.4 2 m/s)",
        "augment=[vx, wz, way]",
        "observation.way=-1 .. 1 m/s",
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
