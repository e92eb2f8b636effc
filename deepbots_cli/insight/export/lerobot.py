"""A policy with the processors of LeRobot: `policy.onnx` over scaled observations, and around it two
pipelines that scale.

A pipeline is a JSON file of steps as `PolicyProcessorPipeline.save_pretrained` writes it, with the ranges of
each step in a file of safetensors: `policy_preprocessor.json` maps the observation in SI units to [-1, 1],
`policy_postprocessor.json` the commands of actuators from [-1, 1] to SI units. `features.json` names the
numbers of both, as `meta/info.json` of a data set does. The normalizers of LeRobot do not clip and remember
nothing: the graph clips, and computes `apply`; a scenario with a memory does not fit.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from safetensors.numpy import save

from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.insight.export.devices import Array, linear, output, tabulated
from deepbots_cli.insight.export.network import Decision, Graph, check_network, decide, takes_masks
from deepbots_cli.learning.learner import Learner
from deepbots_cli.program import Program
from deepbots_cli.words import unit_text

STATE, ACTION = "observation.state", "action"
GRAPH_NAME, FEATURES_NAME = "policy.onnx", "features.json"
_MODES = {"STATE": "MIN_MAX", "ACTION": "MIN_MAX"}
Step = tuple[str, dict[str, Any]]
"""A step of a pipeline: its name in LeRobot's registry, and its settings."""
_INSTEAD = "; export a bundle instead"


def lerobot_files(program: Program, learner: Learner) -> dict[PurePosixPath, bytes]:
    """Return the graph, the two pipelines with their ranges, and the names of the numbers.

    Raises:
        UsageError: Processors of LeRobot cannot represent the observation or the commands of the scenario;
            the message names the part.
    """
    agent, numbers = program.agent, program.agent.numbers
    _check(program, learner)
    check_network(learner, program)
    commands = [
        (robot, command)
        for robot in program.robots
        if robot.name in agent.robots
        for command in robot.commands
    ]
    outputs = [output(program, robot, command) for robot, command in commands]
    low, high = (np.array([end for entry in outputs for end in entry.range[side]], float) for side in (0, 1))
    if not np.isfinite([low, high]).all():
        raise UsageError(
            f"a processor of LeRobot scales ranges, and a command of {program.name} has no limit{_INSTEAD}"
        )
    graph = Graph()
    observation = graph.input(STATE, np.float32, 1, len(agent.inputs))
    clips = [number.clip and not number.is_truth for number in numbers]
    decision = decide(graph, learner.network(), program, {"observation": _clipped(graph, observation, clips)})
    targets = _targets(
        graph, program, decision, [tree for _, command in commands for tree in command.scalars], low, high
    )
    graph.output(ACTION, _clipped(graph, targets, [True] * len(low)), np.float32, 1, len(low))
    names = [
        f"{entry.name}.{component}"
        for entry in outputs
        for component in entry.components or (entry.actuator,)
    ]
    features = {
        STATE: _feature(
            [number.full_name for number in numbers], [unit_text(number.unit) for number in numbers]
        ),
        ACTION: _feature(names, [entry.unit for entry in outputs for _ in range(entry.shape[0])]),
    }
    # A truth value stays 0 or 1.
    seen_ends = [(-1.0, 1.0) if number.is_truth else (number.low, number.high) for number in numbers]
    to_device: Step = ("device_processor", {"device": "cpu", "float_dtype": None})
    before: list[Step] = [
        ("to_batch_processor", {}),
        to_device,
        ("normalizer_processor", _settings(STATE, "STATE", len(numbers))),
    ]
    after: list[Step] = [("unnormalizer_processor", _settings(ACTION, "ACTION", len(low))), to_device]
    about = {"fps": 1.0 / program.period, "features": features}
    files = {
        GRAPH_NAME: graph.model(program.name),
        **_pipeline("policy_preprocessor", before, STATE, *zip(*seen_ends, strict=True)),
        **_pipeline("policy_postprocessor", after, ACTION, low, high),
        FEATURES_NAME: json.dumps(about, indent=2).encode() + b"\n",
    }
    return {PurePosixPath(name): content for name, content in files.items()}


def _targets(
    graph: Graph, program: Program, decision: Decision, trees: Sequence[Scalar], low: Array, high: Array
) -> str:
    """Return the commands of an action, scaled from their ranges to [-1, 1]: float32 [1, n].

    Raises:
        UsageError: The commands are not a sum of multiples of the action, or depend on more than the chosen
            option.
    """
    # A range without a width has nothing to divide by.
    width = np.where(high > low, (high - low) / 2, 1.0)
    if program.agent.choices:
        rows = tabulated(program, trees)
        if rows is not None:
            row, size = decision.options[0], 1
            for choice, option in zip(program.agent.choices[1:], decision.options[1:], strict=True):
                size = len(choice.options)
                # The rows of the table are in mixed radix, and the option of the last choice changes first.
                row = graph.add("Add", graph.add("Mul", row, graph.constant([size], np.int64)), option)
            return str(graph.add("Gather", graph.constant((rows - low) / width - 1.0), row, axis=0))
    elif (coefficients := linear(program, trees)) is not None:
        matrix, offset = coefficients[0] / width[:, None], (coefficients[1] - low) / width - 1.0
        return str(
            graph.add("Gemm", decision.action, graph.constant(matrix), graph.constant(offset), transB=1)
        )
    raise UsageError(
        f"`apply` of {program.name} reads sensors, has a memory or is not linear in the action{_INSTEAD}"
    )


def _check(program: Program, learner: Learner) -> None:
    """Refuse a policy that no processor represents."""
    agent = program.agent
    remembering = [
        entry.name for entry in agent.observation if entry.history > 1 or entry.name == "previous_action"
    ]
    if agent.goal is not None or agent.images or agent.copies is not None:
        raise UsageError(f"goals, images and copies of a robot do not fit one vector of numbers{_INSTEAD}")
    if takes_masks(learner, program):
        raise UsageError(
            f"{program.name} forbids options, which processors of LeRobot do not compute{_INSTEAD}"
        )
    if learner.network().memory is not None:
        raise UsageError(f"processors of LeRobot pass on no memory of a recurrent policy{_INSTEAD}")
    if remembering or agent.frame_stack > 1:
        subject = f"the observation of {remembering[0]}" if remembering else "`agent.frame_stack`"
        raise UsageError(f"processors of LeRobot remember no step before, which {subject} needs{_INSTEAD}")


def _clipped(graph: Graph, value: str, mask: Sequence[bool]) -> str:
    """Return a vector [1, n] of which these numbers are clipped to [-1, 1]."""
    if not any(mask):
        return value
    ends = np.where(mask, 1.0, np.finfo(np.float32).max)[None]
    return str(graph.add("Min", graph.add("Max", value, graph.constant(-ends)), graph.constant(ends)))


def _feature(names: Sequence[str], units: Sequence[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": [len(names)], "names": [*names], "units": [*units]}


def _settings(key: str, kind: str, count: int) -> dict[str, Any]:
    return {"eps": 1e-08, "features": {key: {"type": kind, "shape": [count]}}, "norm_map": _MODES}


def _pipeline(name: str, steps: Sequence[Step], key: str, lows: Any, highs: Any) -> dict[str, bytes]:
    """Return the files of a pipeline, of which one step scales `key`."""
    index = next(index for index, (kind, _) in enumerate(steps) if "normalizer" in kind)
    ranges = f"{name}_step_{index}_{steps[index][0]}.safetensors"
    entries = [
        {"registry_name": kind, "config": config, **({"state_file": ranges} if number == index else {})}
        for number, (kind, config) in enumerate(steps)
    ]
    return {
        f"{name}.json": json.dumps({"name": name, "steps": entries}, indent=2).encode() + b"\n",
        ranges: save({f"{key}.min": np.array(lows, np.float64), f"{key}.max": np.array(highs, np.float64)}),
    }
