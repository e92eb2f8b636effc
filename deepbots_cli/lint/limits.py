"""What the process that simulates may use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

OUT_OF_MEMORY = 77
"""The exit code of a process that asked for more."""


@dataclass(frozen=True)
class Limits:
    """Ordinary scenarios take 1 to 8 s of CPU; one that takes longer in all is no mistake, and nothing is said of it.

    A single step (or reset, or the building of the world) that takes longer than `step` does not come back. A world of 500
    bodies takes 0.6 GB of address space, most of which is libraries.
    """

    cpu: int = 120
    """s of CPU time in all."""
    step: float = 30.0
    """s of CPU time for a step."""
    memory: int = 4096
    """MiB of address space."""
    wall: float = 900.0
    """s by the clock in all, on a machine that may be busy with other things."""

    def told(self) -> list[str]:
        """As arguments of the process that keeps them."""
        return [str(self.cpu), str(self.step), str(self.memory)]

    @classmethod
    def read(cls, told: Sequence[str]) -> Self:
        """The inverse of `told`."""
        cpu, step, memory = told
        return cls(int(cpu), float(step), int(memory))
