"""The files for LeRobot command what the robot of the simulation applies."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import closing
from itertools import islice
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
import onnxruntime
from safetensors.numpy import load

from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export.devices import recorded_steps
from deepbots_cli.insight.export.lerobot import ACTION, STATE, lerobot_files
from deepbots_cli.rollout.policies import PolicyDriver
from tests.bundle.untrained import untrained_bundle

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
