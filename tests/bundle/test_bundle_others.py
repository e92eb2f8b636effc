"""The files for LeRobot and LEAPP command what the robot of the simulation applies."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import closing
from itertools import islice
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
import onnxruntime
from safetensors.numpy import load

from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export.leapp import leapp_files
from deepbots_cli.insight.export.lerobot import ACTION, STATE, lerobot_files
from deepbots_cli.insight.export.recording import recorded_steps
from deepbots_cli.rollout.policies import PolicyDriver
from deepbots_robot import model
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


def test_a_pipeline_of_leapp_passes_memories_on_and_commands_what_the_simulated_robot_applies() -> None:
    step, learner, bundle = untrained_bundle("quadruped")
    graph = step.model({})
    files = leapp_files(
        {PurePosixPath("bundle.json"): model.encode(bundle.info), PurePosixPath("policy.onnx"): graph}
    )
    (file,) = [name for name in files if name.suffix == ".yaml"]
    pipeline = yaml.safe_load(files[file])
    (node,) = pipeline["models"]
    description = pipeline["models"][node]
    flow = pipeline["pipeline"]
    first = load(files[PurePosixPath(flow["initial_values"])])
    session = onnxruntime.InferenceSession(
        files[PurePosixPath(description["parameters"]["model_path"])], providers=["CPUExecutionProvider"]
    )
    for side, tensors in (("inputs", session.get_inputs()), ("outputs", session.get_outputs())):
        assert [(each["name"], each["shape"]) for each in description[side]] == [
            (each.name, each.shape) for each in tensors
        ]
    fed = [target for targets in flow["feedback_flow"].values() for target in targets]
    assert sorted(fed) == sorted(first)
    assert {each["name"] for each in description["inputs"]} == {
        *flow["inputs"][node],
        *(name.partition("/")[2] for name in fed),
    }
    memory: dict[str, Any] = {}
    with closing(recorded_steps(step, lambda world: PolicyDriver(learner, world))) as recorded:
        for each in islice(recorded, 40):
            memory = (
                {name.partition("/")[2]: value for name, value in first.items()} if each.first else memory
            )
            outputs = dict(
                zip(
                    [out["name"] for out in description["outputs"]],
                    session.run(None, {**each.inputs, **memory}),
                    strict=True,
                )
            )
            memory = {
                targets[0].partition("/")[2]: outputs[source.partition("/")[2]]
                for source, targets in flow["feedback_flow"].items()
            }
            for name, command in each.commands.items():
                assert outputs[name] == pytest.approx(command, abs=1e-5)
    (legs,) = [each for each in description["outputs"] if each["name"] == "dog.legs"]
    assert legs["kind"] == "target/joint/position"
    assert len(legs["element_names"][0]) == 12
    assert flow["configs"] == {"frequency": 1.0 / step.timestep}
