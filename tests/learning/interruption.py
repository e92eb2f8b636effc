"""Trainings with an event after some steps, and the result of a training, to the bit."""

from __future__ import annotations

import csv
import json
import os
import signal
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from deepbots_cli.learning import checkpoints, resume, train
from deepbots_cli.learning.multi_agent import has_agents, own_model
from deepbots_cli.learning.report import Reporter, TrainingProgress
from deepbots_cli.learning.runs.run import Run

TIMES = {"cpu_seconds", "wall_seconds", "simulated_hours", "solved_at"}


def press_ctrl_c() -> None:
    os.kill(os.getpid(), signal.SIGINT)


class At(Reporter):
    """Does something once, after some steps."""

    def __init__(self, steps: int, act: Callable[[], None] = press_ctrl_c) -> None:
        self.steps = steps
        self.act = act
        self.is_done = False
        self.notes: list[str] = []

    def update(self, progress: TrainingProgress) -> None:
        if progress.steps >= self.steps and not self.is_done:
            self.is_done = True
            self.act()

    def note(self, text: str) -> None:
        self.notes.append(text)


def monitor_rows(run: Path) -> list[dict[str, str]]:
    """The log of the episodes of a training."""
    return list(csv.DictReader(run.joinpath("monitor.csv").read_text().splitlines()[1:]))


def outcome(folder: Path) -> dict[str, Any]:
    """Everything that a training has made, without times."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    run = Run.open(folder)
    assert run.record.result is not None
    events = EventAccumulator(str(run.tensorboard), size_guidance={"scalars": 0})
    events.Reload()
    last = checkpoints.latest_checkpoint(run)
    return {
        "result": {name: value for name, value in run.record.result if name not in TIMES},
        "solved": run.record.result.solved_at and run.record.result.solved_at.steps,
        "monitor": [row | {"t": ""} for row in monitor_rows(folder)],
        "scalars": {
            tag: [(event.step, event.value) for event in events.Scalars(tag)]
            for tag in events.Tags()["scalars"]
            if not tag.startswith("time/")
        },
        "evaluations": (run.evaluations / "training.jsonl").read_text()
        if (run.evaluations / "training.jsonl").exists()
        else "",
        "models": {path.name: models_in(path) for path in run.model("last").parent.glob("*.zip")},
        "checkpoint": None if last is None else last.name,
        "arrays": {} if last is None else plain(dict(np.load(last / "arrays.npz"))),
    }


def becomes_the_same(
    scenario: Any, folder: Path, stop: int, between: Callable[[], object] = lambda: None, **options: Any
) -> dict[str, Any]:
    """Train in `whole`, and in `parts` with an interruption after `stop` steps. Everything that the trainings
    have made is the same, and is returned."""
    train(scenario, run=folder / "whole", **options)
    assert train(scenario, run=folder / "parts", progress=At(stop), **options).interrupted
    between()
    assert resume(folder / "parts").inexact == ()
    whole, parts = outcome(folder / "whole"), outcome(folder / "parts")
    for part, content in whole.items():
        assert parts[part] == content, part
    return whole


def models_in(path: Path) -> dict[str, Any]:
    """The tensors of a model, to the bit; of a model of several agents, those of each agent by its name."""
    from stable_baselines3.common.save_util import load_from_zip_file

    if has_agents(path):
        agents = json.loads(zipfile.ZipFile(path).read("data"))["agents"]
        models = {}
        for agent in agents:
            with own_model(path, agent) as file:
                models[agent] = models_in(file)
        return models
    _, tensors, variables = load_from_zip_file(path, load_data=False, device="cpu")
    return {"tensors": plain(tensors), "variables": plain(variables)}


def plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [plain(inner) for inner in value]
    return value.tolist() if hasattr(value, "tolist") else value
