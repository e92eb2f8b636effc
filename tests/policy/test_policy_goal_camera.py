"""A camera that nothing but the goal looks through."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np

from deepbots_cli import api

TURNING = Path(__file__).parent / "turning.yaml"


def test_a_goal_sees_the_ball_until_the_robot_has_turned_away() -> None:
    with closing(api.make(TURNING)) as environment:
        environment.reset(seed=0)
        seen = [environment.step(np.ones(1, np.float32))[1] for _ in range(10)]
    assert seen[0] == 1.0
    assert seen[-1] == 0.0
    assert seen == sorted(seen, reverse=True)
