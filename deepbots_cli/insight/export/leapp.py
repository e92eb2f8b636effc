"""The graph of a bundle with a pipeline file of LEAPP (config version 1.3), which describes its tensors and
how they are wired.

The pipeline has one model, `policy`. Its memories are `feedback_flow`, their first values a file of
safetensors. LEAPP has no key for units, frames, ranges and ages; they are further keys of a tensor, which its
runners ignore.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import yaml
from safetensors.numpy import save

from deepbots_robot import model
from deepbots_robot.bundle import BUNDLE_NAME, GRAPH_NAME, initial_value

CONFIG_VERSION = "1.3"
NODE = "policy"
_INPUT_KINDS = {
    "joint_position": "state/joint/position",
    "joint_velocity": "state/joint/velocity",
    "joint_torque": "state/joint/effort",
    "position": "state/body/position",
    "orientation": "state/body/rotation",
    "velocity": "state/body/linear_velocity",
    "angular_velocity": "state/body/angular_velocity",
    "gyro": "state/body/angular_velocity",
    "accelerometer": "state/body/linear_acceleration",
}
_OUTPUT_KINDS = {
    "position": "target/joint/position",
    "velocity": "target/joint/velocity",
    "effort": "target/joint/effort",
    "cartesian": "target/body/position",
}


def leapp_files(bundle: Mapping[PurePosixPath, bytes]) -> dict[PurePosixPath, bytes]:
    """Return, for the files of a bundle, the graph, the pipeline file NAME.yaml, and the first values of
    memories."""
    info, graph = model.decode(bundle[PurePosixPath(BUNDLE_NAME)]), bundle[PurePosixPath(GRAPH_NAME)]
    name = re.sub(r"\W+", "_", info.scenario.name).lower()
    first = {f"{NODE}/{entry.name}": np.ascontiguousarray(initial_value(entry)) for entry in info.memory}
    values = f"{name}_initial_values.safetensors"
    content = {
        "models": {NODE: {**_tensors(info), "parameters": _parameters(graph)}},
        "pipeline": {
            "data_flow": {},
            "feedback_flow": {f"{NODE}/{entry.name}_next": [f"{NODE}/{entry.name}"] for entry in info.memory},
            "inputs": {NODE: [entry.name for entry in info.inputs]},
            "outputs": {
                NODE: [entry.name for entry in info.outputs] + ["action"] + ["scores"] * bool(info.choices)
            },
            "configs": {"frequency": info.rate_hz},
            **({"initial_values": values} if first else {}),
        },
        "system information": {
            "exporter": f"deepbots {info.deepbots}",
            "leapp config version": CONFIG_VERSION,
        },
    }
    text = yaml.safe_dump(content, default_flow_style=None, sort_keys=False, allow_unicode=True)
    contents = {GRAPH_NAME: graph, f"{name}.yaml": text.encode(), **({values: save(first)} if first else {})}
    return {PurePosixPath(name): content for name, content in contents.items()}


def _tensors(info: model.BundleInfo) -> dict[str, list[dict[str, Any]]]:
    """Return the inputs and outputs of the graph, in its order."""
    after = [
        {"name": f"{entry.name}_next", "shape": [*entry.shape], "dtype": entry.dtype} for entry in info.memory
    ]
    choices = info.choices
    action = {
        "name": "action",
        "shape": [] if len(choices) == 1 else [len(choices) or len(info.action)],
        "dtype": "int64" if choices else "float32",
    }
    scores = [{"name": "scores", "shape": [sum(choices)], "dtype": "float32"}] if choices else []
    return {
        "inputs": [
            *(_tensor(entry, _INPUT_KINDS.get(entry.sensor or "")) for entry in info.inputs),
            *({"name": entry.name, "shape": [*entry.shape], "dtype": entry.dtype} for entry in info.memory),
        ],
        "outputs": [
            *(_tensor(entry, _OUTPUT_KINDS.get(entry.kind)) for entry in info.outputs),
            *after,
            action,
            *scores,
        ],
    }


def _tensor(entry: model.Input | model.Output, kind: str | None) -> dict[str, Any]:
    names = entry.joints if len(entry.joints) == entry.shape[0] else entry.components
    described: dict[str, Any] = {
        "name": entry.name,
        "shape": [*entry.shape],
        "dtype": entry.dtype,
        "kind": kind,
        "element_names": [[*names]] if names else None,
        "unit": entry.unit or None,
        "frame": entry.frame,
        "range": None if entry.range is None else [[*ends] for ends in entry.range],
    }
    if isinstance(entry, model.Output):
        described |= {
            "max_rate": [*entry.max_rate],
            "safe": [*entry.safe],
            "stiffness": entry.stiffness,
            "damping": entry.damping,
        }
    else:
        described |= {"source": entry.source, "latency_s": entry.latency_s, "max_age_s": entry.max_age_s}
    return {key: value for key, value in described.items() if value is not None}


def _parameters(graph: bytes) -> dict[str, str]:
    return {
        "backend": "onnx",
        "model_path": GRAPH_NAME,
        "md5sum": hashlib.md5(graph, usedforsecurity=False).hexdigest(),
        "sha256sum": hashlib.sha256(graph).hexdigest(),
    }
