"""The template `duel` of `deepbots new`: two equal robots with equal chances."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.cli import main

pytest.importorskip("deepbots_cli.engines.mujoco")
MATCHES = 200


def _drive(seen: np.ndarray) -> np.ndarray:
    """Return the action of the script `drive`, given what an agent sees in all matches."""
    angle = 180.0 * seen[:, 1]
    gas = np.where(np.abs(angle) < 60.0, 1.0, -2.0 / 3.0)
    return np.stack([gas, np.clip(angle / 45.0, -1.0, 1.0)], axis=1)


@pytest.mark.slow
def test_neither_of_two_equal_drivers_has_an_advantage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine", "--template", "duel"]) == 0
    program = api.compile("mine.yaml").program
    columns = [list(member.columns) for member in program.members.values()]
    winners: dict[int, tuple[str, ...]] = {}
    with closing(api.build_batch(program, MATCHES)) as batch:
        seen = batch.reset(range(MATCHES))
        assert seen[:, columns[0]][:, 0] == pytest.approx(seen[:, columns[1]][:, 0], abs=1e-6)
        for _ in range(round(20 / program.period)):
            actions = np.concatenate([_drive(seen[:, own]) for own in columns], axis=1)
            outcome = batch.step(actions.astype(np.float32))
            for world, info in zip(outcome.done.tolist(), outcome.infos, strict=True):
                winners.setdefault(world, info["endings"])
            seen = outcome.observations
            if len(winners) == MATCHES:
                break
    wins = [list(winners.values()).count((name,)) for name in ("red_first", "blue_first")]
    assert sum(wins) > 0.7 * MATCHES
    assert abs(wins[0] - wins[1]) < 3 * MATCHES**0.5  # three standard deviations
