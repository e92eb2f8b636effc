"""Random numbers: one root seed, one stream per purpose.

Each stream is named by its place in the scenario (`reset.set.cart.pole_hinge#0`), and its seed depends on the root and
that name alone. A new draw in a scenario therefore changes no other draw.
"""

from __future__ import annotations

import hashlib

import numpy as np


def derive(root: int, *names: str | int) -> int:
    """A 32-bit seed for the purpose `names` under the root seed; any whole number is a root, 0 too."""
    text = "/".join(str(name) for name in (root, *names))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


class Streams:
    """The random generators of one environment, made when first asked for."""

    def __init__(self, root: int | None, copy: str = "") -> None:
        """`root` None takes a seed from the operating system.

        The streams of a `copy` of a robot, such as `cart#2`, are its own, apart from those of parameters.
        """
        self.copy = copy
        self.root = int(np.random.SeedSequence().generate_state(1)[0]) if root is None else int(root)
        self._generators: dict[str, np.random.Generator] = {}

    def __getitem__(self, name: str) -> np.random.Generator:
        generator = self._generators.get(name)
        if generator is None:
            own = f"{self.copy}/" if self.copy and not name.startswith("parameters.") else ""
            seed = np.random.SeedSequence(_words(f"{self.root}/{own}{name}"))
            generator = self._generators[name] = np.random.Generator(np.random.PCG64(seed))
        return generator

    def uniform(self, name: str, low: float, high: float) -> float:
        return float(self[name].uniform(low, high))

    def integer(self, name: str, low: float, high: float) -> float:
        """A whole number from `low` to `high`, both included."""
        return float(self[name].integers(int(low), int(high), endpoint=True))

    def normal(self, name: str, mean: float, deviation: float) -> float:
        return float(self[name].normal(mean, deviation))

    def normals(self, name: str, count: int) -> list[float]:
        """Standard normal numbers."""
        numbers: list[float] = self[name].standard_normal(count).tolist()
        return numbers

    def choice(self, name: str, *options: float) -> float:
        return options[int(self[name].integers(len(options)))]


def _words(text: str) -> list[int]:
    digest = hashlib.sha256(text.encode()).digest()
    return [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
