"""PitEscape in other pits and with finer physics: nobody drives out of them, and rocking leads out."""

from contextlib import closing
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.terrain import png
from tests.pits import relief

HERE = Path(__file__).parent
VARIANTS = ("heightfield", "mesh", "half_step")


def test_the_files_are_what_the_generator_writes() -> None:
    assert png.heights((HERE / "pit.png").read_bytes()) == png.heights(relief.picture())
    assert (HERE / "pit.obj").read_text(encoding="utf-8") == relief.mesh()


@pytest.mark.parametrize("variant", VARIANTS)
def test_rocking_leaves_every_pit_and_driving_forward_none(variant: str) -> None:
    with closing(api.make(HERE / f"pit_escape_{variant}.yaml")) as environment:

        def escapes(script: str, seed: int) -> bool:
            environment.reset(seed=seed)
            ended, info = False, {}
            while not ended:
                _, _, terminated, truncated, info = environment.step(environment.script(script))
                ended = terminated or truncated
            return bool(info["is_success"])

        assert [escapes("rocking", seed) for seed in range(3)] == [True] * 3
        assert not escapes("forward_only", 0)
