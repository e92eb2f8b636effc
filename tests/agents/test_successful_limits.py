"""A limit that is a success."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.runtime.agents import seats_of
from tests.agents.carts import CARTS

LIMITED = CARTS.replace("{max_steps: 60}", "{max_steps: {limit: 3, success: right}}")


@pytest.fixture
def carts(tmp_path: Path) -> Path:
    file = tmp_path / "carts.yaml"
    file.write_text(LIMITED)
    return file


def _last_info(file: Path) -> tuple[dict[str, object], dict[str, bool]]:
    with closing(api.make(file)) as world:
        world.reset(seed=0)
        for _ in range(3):
            _, _, ended, cut, info = world.step(np.zeros(2, np.float32))
        assert cut
        assert not ended
        return info, {name: seat.info(info)["is_success"] for name, seat in seats_of(world).items()}


def test_a_limit_is_a_success_of_the_agents_that_it_names(carts: Path) -> None:
    info, successes = _last_info(carts)
    assert info["ended_by"] == "max_steps"
    assert not info["is_success"]
    assert successes == {"left": False, "right": True}
    carts.write_text(LIMITED.replace("success: right}}", "success: all}}"))
    info, successes = _last_info(carts)
    assert info["is_success"]
    assert successes == {"left": True, "right": True}


def test_an_episode_of_a_role_succeeds_at_its_limit(carts: Path, capsys: pytest.CaptureFixture[str]) -> None:
    role = ["--agent", "right", "--against", "left=zero", "--driver", "zero"]
    assert main(["try", str(carts), *role, "--episodes", "1", "--json"]) == 0
    (episode,) = json.loads(capsys.readouterr().out)["episodes"]
    assert episode["ended_by"] == "max_steps"
    assert episode["success"]


@pytest.mark.parametrize("engine", ["bullet", "batch"])
def test_one_agent_succeeds_at_a_limit(tmp_path: Path, engine: str) -> None:
    file = tmp_path / "still.yaml"
    file.write_text(
        "deepbots: 1\nextends: cartpole\nname: Still\ntruncation: {max_steps: {limit: 2, success: all}}\n"
    )
    if engine == "batch":
        pytest.importorskip("mujoco")
        with closing(api.make_vec(file, 2)) as batch:
            batch.reset(seed=[0, 1])
            for _ in range(2):
                *_, truncated, infos = batch.step(np.array([0, 1]))
            assert truncated.all()
            assert infos["final_info"]["is_success"].all()
        return
    with closing(api.make(file)) as world:
        world.reset(seed=0)
        for _ in range(2):
            *_, info = world.step(0)
        assert info["is_success"]


def test_a_limit_names_agents_that_exist(carts: Path, tmp_path: Path) -> None:
    carts.write_text(LIMITED.replace("success: right}}", "success: middle}}"))
    alone = tmp_path / "one.yaml"
    alone.write_text(
        "deepbots: 1\nextends: cartpole\nname: One\ntruncation: {max_time: {limit: 2 s, success: cart}}\n"
    )
    for file, name in ((carts, "middle"), (alone, "cart")):
        errors = [finding for finding in api.lint(file) if finding.severity == "error"]
        assert [finding.headline for finding in errors] == [f"there is no agent `{name}`"]
