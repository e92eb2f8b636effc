"""Rays through a world, which the robot that sends them does not stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli.engines.mujoco import mujoco as mj

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Triple
    from deepbots_cli.webots.scene import Body

    Floats = NDArray[np.float64]

_SKIPPED_GROUP = 5
_GROUPS = np.array([1, 1, 1, 1, 1, 0], np.uint8)
"""Whether a geometry of each group stops rays."""


class Rays:
    """Casts rays.

    Args:
        bodies: The body of each geometry.
        update_positions: Brings the positions of the geometries up to date.
    """

    def __init__(
        self, model: Any, data: Any, bodies: Sequence[Body], update_positions: Callable[[], None]
    ) -> None:
        self._model, self._data = model, data
        self._update_positions = update_positions
        self._robot_geoms: dict[int, list[int]] = {}
        for index, body in enumerate(bodies):
            if body.robot is not None:
                self._robot_geoms.setdefault(body.robot.index, []).append(index)

    @contextmanager
    def _without(self, skipped: int | None) -> Iterator[None]:
        """Context in which the robot of an index stops no ray."""
        self._update_positions()
        # `mj_ray` can leave out a single body, and a robot has several.
        groups = self._model.geom_group
        geoms = [] if skipped is None else self._robot_geoms.get(skipped, [])
        saved = groups[geoms].copy()
        groups[geoms] = _SKIPPED_GROUP
        try:
            yield
        finally:
            groups[geoms] = saved

    def cast(
        self, start: Triple, directions: Sequence[Triple], reach: float, skipped: int | None
    ) -> list[tuple[float, int, float]]:
        """Return for each ray the distance (m; `reach` if nothing is hit), the geometry (or -1), and the
        cosine of its incidence. The robot `skipped` stops no ray."""
        geom, normal = np.full(1, -1, np.int32), np.zeros(3)
        results = []
        origin = np.array(start)
        with self._without(skipped):
            for direction in directions:
                ray = np.array(direction)
                length = float(
                    mj.mj_ray(self._model, self._data, origin, ray, _GROUPS, True, -1, geom, normal)
                )
                if length < 0 or length > reach:
                    results.append((reach, -1, 1.0))
                else:
                    results.append((length, int(geom[0]), abs(float(normal @ ray))))
        return results

    def distances(self, start: Triple, directions: Floats, reach: float, skipped: int | None) -> list[float]:
        """Return the distance along each of many rays from one point, m; infinite beyond `reach`. The
        directions have the shape (rays, 3). The robot `skipped` stops no ray."""
        count = len(directions)
        geoms, lengths = np.full(count, -1, np.int32), np.zeros(count)
        rays = np.ascontiguousarray(directions).ravel()
        model, data = self._model, self._data
        with self._without(skipped):
            mj.mj_multiRay(
                model, data, np.array(start), rays, _GROUPS, True, -1, geoms, lengths, None, count, reach
            )
        is_missed = (lengths < 0) | (lengths > reach)
        return np.where(is_missed, inf, lengths).tolist()  # type: ignore[no-any-return]
