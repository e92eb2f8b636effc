"""Model files: plain arrays that fit, or nothing."""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import stand_in
import torch

from deepbots_cli.errors import RunError
from deepbots_cli.learning import TrainingResult, evaluate, resume


class Bomb:
    """Leaves a trace when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.trace,))


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def rewrite(path: Path, content: Mapping[str, bytes], compression: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in content.items():
            archive.writestr(name, data)


def npy(array: np.ndarray, *, allow_pickle: bool = False) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=allow_pickle)
    return stream.getvalue()


def weight(path: Path) -> str:
    return next(name for name in members(path) if name.endswith("action_net.weight.npy"))


def refused(run: Path, reason: str) -> None:
    with pytest.raises(RunError, match=reason) as caught:
        evaluate(run, episodes=1, build=stand_in.build)
    assert "\n" not in str(caught.value)


def refusal(run: Path) -> str:
    """Why a run's best model is refused; nothing if it can be evaluated."""
    try:
        evaluate(run, episodes=1, build=stand_in.build)
    except RunError as error:
        return str(error)
    return ""


def test_a_model_is_an_archive_of_arrays_that_numpy_reads_without_pickle(trained: TrainingResult) -> None:
    with np.load(trained.run / "models" / "last.npz", allow_pickle=False) as archive:
        assert all(archive[name].dtype == np.float32 for name in archive.files if name.startswith("policy/"))


def test_a_pickle_in_place_of_a_model_is_refused_and_never_run(run_copy: Path, tmp_path: Path) -> None:
    trace, path = tmp_path / "trace", run_copy / "models" / "best.npz"
    path.write_bytes(pickle.dumps(Bomb(trace)))
    refused(run_copy, "damaged")
    torch.save({"weights": Bomb(trace)}, path)
    refused(run_copy, "lacks|damaged")
    assert not trace.exists()


def test_a_pickle_inside_an_array_is_refused_and_never_run(run_copy: Path, tmp_path: Path) -> None:
    trace, path = tmp_path / "trace", run_copy / "models" / "best.npz"
    array = np.empty((2, 64), dtype=object)
    array[:] = Bomb(trace)
    rewrite(path, members(path) | {weight(path): npy(array, allow_pickle=True)})
    refused(run_copy, "needs <f4")
    assert not trace.exists()


@pytest.mark.parametrize(
    ("array", "reason"),
    [
        (np.zeros((3, 64), np.float32), "shape"),
        (np.zeros((2, 64), np.float64), "<f8"),
        (np.full((2, 64), np.nan, np.float32), "not finite"),
        (np.full((2, 64), np.inf, np.float32), "not finite"),
        (np.asfortranarray(np.zeros((2, 64), np.float32)), "no array"),
    ],
)
def test_an_array_that_does_not_fit_is_refused(run_copy: Path, array: np.ndarray, reason: str) -> None:
    path = run_copy / "models" / "best.npz"
    rewrite(path, members(path) | {weight(path): npy(array)})
    refused(run_copy, reason)


def test_a_header_that_promises_a_huge_array_costs_no_memory(run_copy: Path) -> None:
    path = run_copy / "models" / "best.npz"
    honest = npy(np.zeros((2, 64), np.float32))
    rewrite(path, members(path) | {weight(path): honest.replace(b"(2, 64), }" + b" " * 9, b"(2, 99999999999), }")})
    refused(run_copy, "99999999999")


def test_missing_and_strange_arrays_are_named(run_copy: Path) -> None:
    path = run_copy / "models" / "best.npz"
    whole = members(path)
    rewrite(path, {name: data for name, data in whole.items() if name != weight(path)})
    refused(run_copy, "lacks 'policy/action_net.weight'")
    rewrite(path, whole | {"policy/backdoor.npy": npy(np.zeros(1, np.float32))})
    refused(run_copy, "policy/backdoor")


def test_a_zip_bomb_is_refused(run_copy: Path) -> None:
    path = run_copy / "models" / "best.npz"
    rewrite(path, members(path) | {weight(path): bytes(50_000_000)}, zipfile.ZIP_DEFLATED)
    refused(run_copy, "compressed")


def test_a_truncated_or_shuffled_file_is_refused_or_read(run_copy: Path) -> None:
    path = run_copy / "models" / "best.npz"
    content = path.read_bytes()
    generator = np.random.default_rng(0)
    for _ in range(60):
        spoiled = bytearray(content[: generator.integers(len(content))] if generator.random() < 0.5 else content)
        for position in generator.integers(len(spoiled), size=3) if spoiled else ():
            spoiled[position] = generator.integers(256)
        path.write_bytes(bytes(spoiled))
        assert "\n" not in refusal(run_copy)


def test_a_damaged_checkpoint_is_refused_and_the_models_stay(run_copy: Path) -> None:
    (run_copy / "checkpoint.npz").write_bytes(b"PK\x03\x04 no archive")
    with pytest.raises(RunError, match="damaged"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)
    assert evaluate(run_copy, episodes=1, build=stand_in.build).episodes == 1


@pytest.mark.parametrize("moment", ["step", "exp_avg", "exp_avg_sq"])
def test_a_checkpoint_whose_optimiser_lacks_an_array_is_refused(run_copy: Path, moment: str) -> None:
    path = run_copy / "checkpoint.npz"
    rewrite(path, {name: data for name, data in members(path).items() if name != f"policy.optimizer/2/{moment}.npy"})
    with pytest.raises(RunError, match=f"lacks 'policy.optimizer/2/{moment}'"):
        resume(run_copy, total_timesteps=3_000, build=stand_in.build)


def test_an_optimiser_that_counts_below_zero_is_refused(run_copy: Path) -> None:
    path = run_copy / "checkpoint.npz"
    rewrite(path, members(path) | {"policy.optimizer/0/step.npy": npy(np.array(-1.0, np.float32))})
    with pytest.raises(RunError, match=r"'policy\.optimizer/0/step' counts below zero"):
        resume(run_copy, total_timesteps=3_000, build=stand_in.build)
