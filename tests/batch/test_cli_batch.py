"""Batches on the command line."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("deepbots_cli.engines.mujoco")

from deepbots_cli.cli import main


def test_compile_prints_the_module_of_a_batch(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compile", "cartpole", "--target", "batch"]) == 0
    code = capsys.readouterr().out
    assert "class CartPoleBatch(BatchSupervisor):" in code
    assert "drive = pick(self.CHOICES_drive, action)" in code


def test_compile_says_what_a_batch_cannot_hold(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compile", "see_ball", "--target", "batch"]) == 2
    assert "SeeBall does not fit a batch: it has cameras" in capsys.readouterr().err


def test_bench_compares_engines_and_batches(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [
        "bench",
        "cartpole",
        "--engine",
        "mujoco,batch",
        "--worlds",
        "2",
        "--steps",
        "100",
        "--pairs",
        "1",
        "--json",
    ]
    assert main(arguments) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["engine"], row["worlds"]) for row in rows] == [("mujoco", 1), ("batch", 2)]
    assert all(0.0 < row["physics_us"] < row["step_us"] for row in rows)


def test_one_round_of_a_bench_is_not_called_medians(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["bench", "cartpole", "--engine", "mujoco,batch", "--worlds", "1", "--steps", "100", "--quick"])
        == 0
    )
    ran = capsys.readouterr()
    assert "random actions, one round; CPU times" in ran.out
    assert "measuring 1 round of 100 steps" in ran.err


def test_bench_refuses_worlds_without_a_batch(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "cartpole", "--worlds", "4"]) == 2
    assert "--worlds needs --engine batch" in capsys.readouterr().err
