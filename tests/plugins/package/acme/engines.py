"""An engine: PyBullet that counts its steps."""

from __future__ import annotations

from deepbots_cli.engines.pybullet.engine import PyBulletEngine


class Counting(PyBulletEngine):
    steps = 0

    def step(self, substeps: int) -> None:
        self.steps += 1
        super().step(substeps)
