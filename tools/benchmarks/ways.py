"""Lengths of ways against scipy's Dijkstra on the same graph, over random arenas like those of FindBall.

    python -m tools.benchmarks.ways [--layouts 10000]

prints the largest difference (m) and the CPU time of a field by either.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING
from unittest import mock

import numpy as np

from deepbots_cli.footprint import Footprint, Patch
from deepbots_cli.runtime import paths

if TYPE_CHECKING:
    from numpy.typing import NDArray

ARENA = (-0.5, -0.5, 0.5, 0.5)
RADIUS, GOAL = 0.04, 0.025  # m


def dijkstra(blocked: NDArray[np.bool_], starts: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """The same as `path_lengths`, by scipy."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    index = np.arange(blocked.size).reshape(blocked.shape)
    edges: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]] = []
    for rows, columns in paths.MOVES:
        barred = blocked | np.roll(blocked, (rows, columns), (0, 1))
        for passed_cell in paths.passed_cells(rows, columns):
            barred |= np.roll(blocked, passed_cell, (0, 1))
        ends = index[~barred]
        move_length = cell * paths.LENGTH_SCALE * math.hypot(rows, columns)
        edges.append((ends - (rows * blocked.shape[1] + columns), ends, np.full(len(ends), move_length)))
    first = np.nonzero((starts.ravel() < paths.UNREACHABLE_LENGTH) & ~blocked.ravel())[0]
    edges.append(
        (np.full(len(first), blocked.size), first, np.maximum(starts.ravel()[first], 1e-12))
    )  # 0 is not an edge
    here, there, edge_lengths = (np.concatenate(parts) for parts in zip(*edges, strict=True))
    graph = csr_matrix((edge_lengths, (here, there)), shape=(blocked.size + 1, blocked.size + 1))
    lengths = dijkstra(graph, directed=False, indices=blocked.size)[:-1]
    return np.minimum(lengths, paths.UNREACHABLE_LENGTH).reshape(blocked.shape)


def layouts(count: int, generator: np.random.Generator) -> Iterator[tuple[list[Patch], tuple[float, float]]]:
    """Boxes and discs in the arena, and a goal."""
    for _ in range(count):
        solids = []
        for _ in range(generator.integers(1, 8)):
            a = generator.uniform(0.01, 0.15)
            b = generator.uniform(0.01, 0.15)
            yaw = generator.uniform(-math.pi, math.pi)
            form = (
                Footprint((0.0, 0.0), math.hypot(a, b), (a, b))
                if generator.random() < 0.7
                else Footprint((0.0, 0.0), a)
            )
            x, y = generator.uniform(-0.45, 0.45, 2).tolist()
            solids.append(form.at(x, y, yaw))
        yield solids, tuple(generator.uniform(-0.45, 0.45, 2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layouts", type=int, default=10_000)
    count = parser.parse_args().layouts
    generator = np.random.default_rng(0)
    spent, largest = [0.0, 0.0], 0.0
    methods: tuple[Callable[..., NDArray[np.float64]], ...] = (paths.path_lengths, dijkstra)
    for solids, goal in layouts(count, generator):
        places = generator.uniform(-0.5, 0.5, (20, 2)).tolist()
        lengths = []
        for number, method in enumerate(methods):
            with mock.patch.object(paths, "path_lengths", method):
                started = time.process_time()
                field = paths.DistanceField(ARENA, RADIUS, solids, goal, GOAL)
                spent[number] += time.process_time() - started
                lengths.append([field.length(x, y) for x, y in places])
        largest = max(largest, *(abs(a - b) for a, b in zip(*lengths, strict=True)))
    ours, theirs = (total / count * 1e3 for total in spent)
    print(
        f"{count} layouts: lengths differ by up to {largest:.1e} m; a field takes {ours:.1f} ms,"
        f" {theirs:.1f} ms by scipy"
    )


if __name__ == "__main__":
    main()
