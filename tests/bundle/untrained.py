"""Bundles of policies without a training, whose weights are spread so that their actions differ."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import torch

import deepbots_robot
from deepbots_cli import api
from deepbots_cli.insight.export.control import ControlStep, control_step
from deepbots_cli.insight.export.devices import recorded_steps
from deepbots_cli.insight.export.parity import Comparison, recorded_parity
from deepbots_cli.learning import learner as learners
from deepbots_cli.program import Program
from deepbots_cli.rollout.policies import PolicyDriver
from deepbots_cli.runtime.spaces import action_space, observation_space
from deepbots_robot import bundle, model

DIGEST = "0" * 64


def learner_of(program: Program, *, seed: int = 0) -> Any:
    """The untrained policy of a program with a training."""
    agent = program.agent
    assert agent.training is not None
    with torch.random.fork_rng():
        learner = learners.create(
            learners.Setup(agent.training, observation_space(agent), action_space(agent))
        )
        torch.manual_seed(seed)
        with torch.no_grad():
            for weight in learner.model.policy.parameters():
                weight.mul_(1.5).add_(0.05 * torch.randn_like(weight))
    return learner


@cache
def untrained_bundle(source: str, *overrides: str) -> tuple[ControlStep, Any, deepbots_robot.Bundle]:
    """The graph of a scenario, its policy, and the bundle in memory; that of the first of several agents."""
    compiled = api.compile(source, overrides=overrides)
    if compiled.program.members:
        first = next(iter(compiled.program.members))
        compiled = api.compile(source, overrides=(*overrides, f"role={{agent: {first}}}"))
    program = api.with_learner(compiled).program
    learner = learner_of(program)
    step = control_step(program, learner)
    info = info_of(step)
    return (
        step,
        learner,
        bundle.Bundle(info, step.model({bundle.METADATA_KEY: bundle.description_digest(info)})),
    )


def info_of(step: ControlStep) -> model.BundleInfo:
    program = step.program
    parts = [
        model.ActionPart(name=name, low=part.low, high=part.high)
        for part in program.agent.ranges
        for name in part.names
    ]
    parts += [
        model.ActionPart(name=part.name, options={option.name: {} for option in part.options})
        for part in program.agent.choices
    ]
    return model.BundleInfo(
        format=1,
        deepbots="0",
        scenario=model.Scenario(
            name=program.name,
            summary="",
            digest=DIGEST,
            task_digest=DIGEST,
            robots={},
            interface={},
            licenses={},
        ),
        training=model.Training(algorithm="", model="best", seed=0, steps=0, engine="", versions={}),
        rate_hz=1.0 / step.timestep,
        timestep_s=step.timestep,
        inputs=tuple(reading.info for reading in step.readings.values()),
        memory=tuple(step.memories),
        outputs=tuple(step.outputs),
        action=tuple(parts),
        files={},
        evaluation=None,
    )


def compare_with_simulation(
    source: str, *overrides: str, steps: int, engine: str | None = None
) -> Comparison:
    """A bundle beside the simulation of its scenario, in which its policy acts."""
    step, learner, loaded = untrained_bundle(source, *overrides)
    comparison = Comparison(loaded)
    recorded = recorded_steps(step, lambda world: PolicyDriver(learner, world), engine=engine)
    for each in islice(recorded, steps):
        comparison.add(each)
    recorded.close()
    return comparison


def write_bundle(folder: Path, source: str, *overrides: str) -> Path:
    """The files of a bundle in a new folder; README and scenario are empty."""
    step, learner, loaded = untrained_bundle(source, *overrides)
    folder.mkdir()
    graph = step.model({bundle.METADATA_KEY: bundle.description_digest(loaded.info)})
    write(folder, loaded.info, graph, recorded_parity(loaded, step, learner, engine=None))
    return folder


def write(folder: Path, info: model.BundleInfo, graph: bytes, parity: bytes) -> None:
    files = {
        bundle.GRAPH_NAME: graph,
        bundle.PARITY_NAME: parity,
        bundle.README_NAME: b"",
        bundle.SCENARIO_NAME: b"",
    }
    for name, content in files.items():
        (folder / name).write_bytes(content)
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    (folder / bundle.BUNDLE_NAME).write_bytes(model.encode(msgspec.structs.replace(info, files=digests)))


def with_training(program: Program, **changes: Any) -> Program:
    assert program.agent.training is not None
    return program.with_agent(training=replace(program.agent.training, **changes))
