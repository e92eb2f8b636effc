"""A run from someone else may hold anything. Resuming it ends in one sentence, and changes no file."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import stand_in
from test_learning_models import members, rewrite

from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import TrainingResult, resume, train
from deepbots_cli.learning.runs.run import Run

State = dict[str, Any]


def files(run: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(run)): path.read_bytes()
        for path in run.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


def refusal(run: Path) -> str:
    """What resuming the run is refused with; nothing in the run changes."""
    before = files(run)
    with pytest.raises(RunError) as caught:
        resume(run, total_timesteps=100_000, build=stand_in.build)
    assert files(run) == before
    assert "\n" not in str(caught.value)
    return caught.value.full_message


def with_state(run: Path, change: Callable[[State], object]) -> None:
    (path,) = (run / "checkpoints").glob("0*/state.json")
    state = json.loads(path.read_text())
    change(state)
    path.write_text(json.dumps(state))


def with_arrays(run: Path, arrays: Mapping[str, np.ndarray[Any, Any]]) -> None:
    (path,) = (run / "checkpoints").glob("0*/arrays.npz")
    content = members(path)
    for name, array in arrays.items():
        stream = io.BytesIO()
        np.lib.format.write_array(stream, array, version=(1, 0), allow_pickle=False)
        content[f"{name}.npy"] = stream.getvalue()
    rewrite(path, content)


HUGE_TEXT = {"dtype": "S2000000000", "value": ["x", "y", "z"]}
STATES: dict[str, Callable[[State], object]] = {
    "a position beyond the numbers of the generator": lambda state: state.update(
        numpy=[1_000_000_000, 0, 0.0]
    ),
    "a text of 2 GB as a number": lambda state: state["infos"].insert(0, {"r": HUGE_TEXT, "l": 1}),
    "an object as a number": lambda state: state["pending"][0].update(x={"dtype": "O", "value": 1}),
    "a number that its type does not have": lambda state: state["pending"][0].update(
        x={"dtype": "int8", "value": 300}
    ),
    "steps below zero": lambda state: state["counts"].update(num_timesteps=-(10**12)),
    "steps that the statistics do not have": lambda state: state["counts"].update(num_timesteps=10**9),
    "steps without end": lambda state: (
        state["counts"].update(num_timesteps=10**25),
        state["statistics"].update(steps=10**25),
    ),
    "steps of another checkpoint": lambda state: (
        state["counts"].update(num_timesteps=4),
        state["statistics"].update(steps=4),
    ),
    "a seed below zero": lambda state: state["starts"].__setitem__(0, -5),
    "a generator of another kind": lambda state: state["action_space"].update(bit_generator="MT19937"),
    "too many worlds": lambda state: (state["starts"].append(1), state["stages"].append(0)),
    "no worlds": lambda state: state.update(starts=[], stages=[]),
    "a stage that is not there": lambda state: state["stages"].__setitem__(0, 7),
    "an episode without end": lambda state: state["statistics"]["recent"][0].update(
        total_return=float("inf")
    ),
    "a generator of Python that is cut short": lambda state: state.update(python=[3, [1, 2, 3], None]),
    "an evaluation in the future": lambda state: state["callback"].update(evaluated_at=10**9),
    "a candidate whose return is not a number": lambda state: state["callback"].update(
        candidates=[{"steps": 4, "episodes": 20, "success_rate": 0.5, "mean_return": float("nan")}]
    ),
    "segments of a replay buffer in disorder": lambda state: state.update(segments=[[0, 10**12], [5, 6]]),
}


@pytest.mark.parametrize("name", STATES)
def test_a_forged_state_of_a_checkpoint_is_damaged(run_copy: Path, name: str) -> None:
    with_state(run_copy, STATES[name])
    message = refusal(run_copy)
    assert "damaged" in message
    assert f"deepbots train {run_copy}/resolved.yaml --initialize-from {run_copy}" in message


def torch_generator(run: Path) -> np.ndarray[Any, Any]:
    """A state that torch accepts, from which it would read 600 numbers beyond its own."""
    (path,) = (run / "checkpoints").glob("0*/arrays.npz")
    state = bytearray(np.load(path)["torch"].tobytes())
    struct.pack_into("<i4xQ", state, 8, 624, 600)
    return np.frombuffer(bytes(state), np.uint8)


ARRAYS: dict[str, Callable[[Path], Mapping[str, Any]]] = {
    "three million actions": lambda run: {"actions/0": np.zeros(3_000_000, np.int64)},
    "actions of text": lambda run: {"actions/0": np.full(5, "forward")},
    "actions that the scenario does not have": lambda run: {"actions/0": np.full(5, 99)},
    "actions that are not numbers": lambda run: {"actions/0": np.full(5, np.nan)},
    "an array of another shape": lambda run: {"torch": np.zeros((2, 2528), np.uint8)},
    "an array of another type": lambda run: {"torch": np.zeros(5056, np.int64)},
    "an array with a name of its own": lambda run: {"more": np.zeros(3)},
    "a generator that reads beyond its numbers": lambda run: {"torch": torch_generator(run)},
    "a generator of another size": lambda run: {"numpy": np.zeros(3, np.uint32)},
}


@pytest.mark.parametrize("name", ARRAYS)
def test_a_forged_array_of_a_checkpoint_is_damaged(run_copy: Path, name: str) -> None:
    with_arrays(run_copy, ARRAYS[name](run_copy))
    assert "damaged" in refusal(run_copy)


def test_a_solved_run_stays_solved_when_resuming_it_fails(run_copy: Path) -> None:
    with_arrays(run_copy, {"torch": np.zeros(5, np.uint8)})
    before = Run.open(run_copy).record
    refusal(run_copy)
    assert Run.open(run_copy).record == before
    assert before.status == "finished"


def test_a_solved_run_stays_solved_when_the_world_fails_before_anything_is_learned(run_copy: Path) -> None:
    class Broken(stand_in.CartPole):
        def step(self, action: Any) -> Any:
            raise UsageError("the world is broken")

    before = Run.open(run_copy).record
    with_arrays(run_copy, {f"actions/{index}": np.zeros(0, np.int64) for index in range(4)})
    with pytest.raises(UsageError, match="broken"):
        resume(run_copy, total_timesteps=100_000, build=Broken)
    assert Run.open(run_copy).record == before


def test_a_refused_resume_leaves_files_in_logs_and_tensorboard(run_copy: Path) -> None:
    (run_copy / "logs").mkdir(exist_ok=True)
    (run_copy / "logs" / "notes.txt").write_text("mine")
    (run_copy / "tensorboard" / "events.out.tfevents.9.mine").write_text("mine")
    before = files(run_copy)
    with pytest.raises(UsageError, match="is complete"):
        resume(run_copy, total_timesteps=100, build=stand_in.build)
    assert files(run_copy) == before


def test_the_advice_for_a_damaged_checkpoint_works(
    run_copy: Path, trained: TrainingResult, tmp_path: Path
) -> None:
    result = train(
        run_copy / "resolved.yaml",
        run=tmp_path / "new",
        initialize_from=run_copy,
        total_timesteps=256,
        build=stand_in.build,
    )
    assert result.initialized_from is not None
