"""PitEscape as shipped, in other pits and with finer physics: driving ahead does not lead out, and rocking
does."""

from contextlib import closing
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.geometry import picture_pixels
from tests.few import every
from tests.pits import relief

HERE = Path(__file__).parent
PITS = (
    "pit_escape",
    *(HERE / f"pit_escape_{variant}.yaml" for variant in ("heightfield", "mesh", "half_step")),
)


def test_the_files_are_what_the_generator_writes() -> None:
    assert (
        picture_pixels((HERE / "pit.png").read_bytes()).tolist() == picture_pixels(relief.picture()).tolist()
    )
    assert (HERE / "pit.obj").read_text(encoding="utf-8") == relief.mesh()


@pytest.mark.slow
@pytest.mark.parametrize("pit", every(2, PITS, lambda pit: Path(pit).stem))
def test_rocking_leaves_every_pit_and_driving_forward_none(pit: str | Path) -> None:
    """What makes the pit a task: no motor holds the ball on its wall, and swinging with the gyro's sign gets
    it out."""
    with closing(api.make(pit)) as environment:

        def escapes(script: str, seed: int) -> bool:
            environment.reset(seed=seed)
            ended = False
            info = {}
            while not ended:
                _, _, terminated, truncated, info = environment.step(environment.script(script))
                ended = terminated or truncated
            return bool(info["is_success"])

        assert [escapes("rocking", seed) for seed in range(3)] == [True] * 3
        assert not escapes("forward_only", 0)
