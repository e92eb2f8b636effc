"""Contacts and their forces, distances between surfaces, free distances of rays from a link, and lines of
sight."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deepbots_cli import frames
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco.model import HIDDEN_GROUP
from deepbots_cli.port import ZERO_VECTOR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.engines.mujoco.model import Body
    from deepbots_cli.engines.mujoco.state import MujocoWorld
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import (
        ClearanceReader,
        ContactReader,
        ForceReader,
        RayReader,
        VectorReader,
    )

    FloatArray = NDArray[np.float64]

MAX_CLEARANCE_M = 1e6  # m; larger distances between surfaces are not computed
ELLIPSOID = int(mj.mjtGeom.mjGEOM_ELLIPSOID)  # the shape of tires, and of nothing else
VERTICAL = 1e-9  # the horizontal length of a forward axis that points up or down
MEETING_TOLERANCE_M = 1e-9  # m; by how much lines that meet in a point may miss it
SEEN_GROUPS = np.ones(6, np.uint8)  # the groups of geoms that rays meet
SEEN_GROUPS[HIDDEN_GROUP] = 0


class ContactMonitor:
    """Checks contacts after every engine step, and adds up their forces, for all readers of a world."""

    def __init__(self, world: MujocoWorld) -> None:
        self._world = world
        # Both objects stay the same; MuJoCo updates their contents in each engine step.
        self._data = world.data
        self._contacts = world.data.contact
        self._readers_by_pair: dict[tuple[int, int], list[int]] = {}
        self._touched: list[bool] = []
        self._all_false: list[bool] = []
        self._ignored_pairs: list[list[int]] = []
        self._forces: list[tuple[frozenset[int], list[float]]] = []
        """Geoms, and the sums of normal forces on them (N) in the engine steps since the last `reset`."""
        self._vectors: list[tuple[frozenset[int], list[Triple]]] = []
        """Geoms, and the sums of all forces of others on them (N, world frame)."""
        self._readings: list[list[Any]] = []
        """The sums of all readers, in the order in which they were bound."""
        world.state_accessors.append((self._memory, self._restore))

    def reset(self) -> None:
        self._touched[:] = self._all_false
        for readings in self._readings:
            readings.clear()

    def _memory(self) -> tuple[list[bool], list[list[Any]]]:
        return list(self._touched), [list(readings) for readings in self._readings]

    def _restore(self, memory: tuple[list[bool], list[list[Any]]]) -> None:
        touched, forces = memory
        self._touched[: len(touched)] = touched
        # Not strict: readers that were bound after the snapshot have no memory in it.
        for readings, before in zip(self._readings, forces, strict=False):
            readings[:] = before

    def update(self) -> None:
        """Mark the readers of the pairs of geoms in contact; `_ignored_pairs` are pairs that concern none of
        them."""
        if self._forces:
            exerted = self._data.efc_force.tolist()
            # The address of a contact without constraint rows is -1.
            normals = [exerted[at] if at >= 0 else 0.0 for at in self._contacts.efc_address.tolist()]
            pairs = list(zip(self._contacts.geom.tolist(), normals, strict=True))
            for geoms, readings in self._forces:
                readings.append(float(sum(force for pair, force in pairs if not geoms.isdisjoint(pair))))
        if self._vectors:
            vectors = list(self._force_vectors())
            for geoms, sums in self._vectors:
                total = ZERO_VECTOR
                for first, second, force in vectors:
                    if (first in geoms) != (second in geoms):
                        total = (frames.add if second in geoms else frames.subtract)(total, force)
                sums.append(total)
        if self._data.ncon:
            pairs = self._contacts.geom.tolist()
            # A robot at rest has the same contacts in many steps, and often none that a reader asks for.
            if pairs != self._ignored_pairs:
                met = [
                    index
                    for first, second in pairs
                    for index in self._readers_by_pair.get((first, second), ())
                ]
                for index in met:
                    self._touched[index] = True
                self._ignored_pairs = pairs if not met else []

    def reader(self, own_geoms: Iterable[int], other_geoms: Iterable[int]) -> ContactReader:
        index = len(self._touched)
        touched = self._touched
        other_geoms = tuple(other_geoms)
        self._ignored_pairs = []
        for geom in own_geoms:
            for other_geom in other_geoms:
                # MuJoCo orders the geoms of a contact itself, whatever the order of the pair.
                self._readers_by_pair.setdefault((geom, other_geom), []).append(index)
                self._readers_by_pair.setdefault((other_geom, geom), []).append(index)
        touched.append(False)
        self._all_false.append(False)
        return lambda: touched[index]

    def normal_force(self, geoms: Iterable[int]) -> ForceReader:
        """Return a reader of the mean sum of normal forces on geoms (N)."""
        readings: list[float] = []
        self._forces.append((frozenset(geoms), readings))
        self._readings.append(readings)
        return lambda: sum(readings) / len(readings) if readings else 0.0

    def force_vector(self, geoms: Iterable[int]) -> VectorReader:
        """Return a reader of the mean sum of the forces of other geoms on geoms (N, world frame)."""
        readings: list[Triple] = []
        self._vectors.append((frozenset(geoms), readings))
        self._readings.append(readings)
        return lambda: frames.mean(readings)

    def _force_vectors(self) -> Iterator[tuple[int, int, Triple]]:
        """Yield two geoms that touch, and the force of the first on the second one, with friction."""
        force = np.zeros(6)
        for index, (first, second) in enumerate(self._contacts.geom.tolist()):
            mj.mj_contactForce(self._world.model, self._data, index, force)
            # The rows of the frame are normal and tangents; the normal points from the first to the second.
            x, y, z = (force[:3] @ self._contacts.frame[index].reshape(3, 3)).tolist()
            yield first, second, (x, y, z)


def clearance(world: MujocoWorld, first_geoms: Sequence[int], second_geoms: Sequence[int]) -> ClearanceReader:
    """Return a reader of the distance between geoms, without tires, which are within their wheels."""
    model, data = world.model, world.data
    pairs = [
        (first, second)
        for first in first_geoms
        for second in second_geoms
        if ELLIPSOID not in (model.geom_type[first], model.geom_type[second])
    ]

    between = mj.mj_geomDistance

    def distance() -> float:
        world.update_positions()
        smallest = MAX_CLEARANCE_M
        for first, second in pairs:
            # With the smallest distance so far as the cutoff: MuJoCo returns the cutoff for pairs beyond it.
            apart = between(model, data, first, second, smallest, None)
            if apart < smallest:
                smallest = apart
        # Negative for surfaces within each other.
        return max(0.0, smallest) if smallest < MAX_CLEARANCE_M else inf

    return distance


def penetrations(world: MujocoWorld) -> Iterable[tuple[int, int, float]]:
    """Yield geoms within each other and their depth (m) in the present state; a state of its own is used, so
    that nothing changes."""
    model = world.model
    data = world.data
    spare = world.scratch_data
    for name in ("qpos", "mocap_pos", "mocap_quat"):
        getattr(spare, name)[:] = getattr(data, name)
    mj.mj_kinematics(model, spare)
    mj.mj_comPos(model, spare)
    mj.mj_collision(model, spare)
    for (first, second), distance in zip(
        spare.contact.geom.tolist(), spare.contact.dist.tolist(), strict=True
    ):
        if distance < 0.0:
            yield first, second, -distance


# Rays


class _Rays(NamedTuple):
    """Rays of a link that pass through its own body, whose geoms have these `groups`.

    `starts` and `directions` are in the frame of the link, of shape (rays, 3); `reach` is in m. `upright`
    rays follow the yaw of the link alone.
    """

    link: int
    groups: NDArray[np.int32]
    starts: FloatArray
    directions: FloatArray
    reach: float
    upright: bool

    def axes(self, world: MujocoWorld) -> FloatArray:
        """Return the matrix that turns the frame of the rays into that of the world."""
        matrix = world.data.xmat[self.link].reshape(3, 3)
        return level_axes(matrix[0, 0], matrix[1, 0]) if self.upright else matrix


def level_axes(xx: Any, yx: Any) -> FloatArray:
    """Return the matrices (..., 3, 3) of the yaw of links whose forward axes have these x and y in the world.

    A link whose forward axis is vertical has the yaw 0. Without angles, single worlds and batches round
    alike.
    """
    length = np.sqrt(xx * xx + yx * yx)
    is_vertical = length < VERTICAL
    length = np.where(is_vertical, 1.0, length)
    cosine, sine = np.where(is_vertical, 1.0, xx / length), np.where(is_vertical, 0.0, yx / length)
    axes = np.zeros((*np.shape(cosine), 3, 3))
    axes[..., 0, 0] = axes[..., 1, 1] = cosine
    axes[..., 1, 0] = sine
    axes[..., 0, 1] = -sine
    axes[..., 2, 2] = 1.0
    return axes


def rays(
    world: MujocoWorld,
    body: Body,
    link: int,
    ray_frames: Sequence[Frame],
    reach: float,
    *,
    upright: bool = False,
) -> RayReader:
    """Return a reader of rays. Rays whose lines meet in a point are cast from there in one call, which costs
    a quarter of a call for each."""
    geoms = body.geoms_of(None)
    groups = world.model.geom_group
    starts = np.array([origin for origin, _ in ray_frames])
    directions = np.array([frames.rotate(rotation, (1.0, 0.0, 0.0)) for _, rotation in ray_frames])
    # MuJoCo numbers geoms along the tree of links, so those of one body follow each other; a slice is a view.
    own_groups = groups[min(geoms) : max(geoms) + 1] if geoms else groups[:0]
    cast = _Rays(link, own_groups, starts, directions, reach, upright)
    center = _meeting_point(starts, directions)
    return _separate_rays(world, cast) if center is None else _rays_from_point(world, cast, center)


def _separate_rays(world: MujocoWorld, rays: _Rays) -> RayReader:
    model = world.model
    data = world.data
    ray = mj.mj_ray
    seen_groups = SEEN_GROUPS
    link, groups, starts, directions, reach, _ = rays
    position = data.xpos[link]
    origins, ways = np.empty_like(starts), np.empty_like(directions)
    ray_views = list(zip(origins, ways, strict=True))  # views of arrays that keep their memory

    def read() -> list[float]:
        world.update_positions()
        saved = groups.copy()
        groups.fill(HIDDEN_GROUP)
        try:
            axes = rays.axes(world).T
            np.matmul(starts, axes, origins)
            np.add(origins, position, origins)
            np.matmul(directions, axes, ways)
            lengths = [
                ray(model, data, origin, direction, seen_groups, True, -1, None, None)
                for origin, direction in ray_views
            ]
        finally:
            groups[:] = saved
        return [reach if length < 0.0 or length > reach else length for length in lengths]

    return read


def _rays_from_point(world: MujocoWorld, rays: _Rays, center: FloatArray) -> RayReader:
    """Return a reader of rays from one point; `center` is in the frame of the link."""
    model = world.model
    data = world.data
    ray = mj.mj_ray
    seen_groups = SEEN_GROUPS
    link, groups, starts, directions, reach, _ = rays
    position = data.xpos[link]
    aside = np.ascontiguousarray(directions.T)
    count = len(starts)
    ahead = np.einsum("ij,ij->i", starts - center, directions).tolist()
    far = reach + max(ahead)  # MuJoCo measures from the center, the port from each start
    geoms = np.zeros(count, np.int32)
    met = np.zeros(count)

    def read() -> list[float]:
        world.update_positions()
        saved = groups.copy()
        groups.fill(HIDDEN_GROUP)
        try:
            axes = rays.axes(world)
            origin = position + axes @ center
            ways = (axes @ aside).T.ravel()
            mj.mj_multiRay(model, data, origin, ways, seen_groups, True, -1, geoms, met, None, count, far)
            lengths = met.tolist()
            free = [
                reach if length < 0.0 else min(length - start, reach)
                for length, start in zip(lengths, ahead, strict=True)
            ]
            for index, length in enumerate(free):
                if length < 0.0:  # something is between the center and the start
                    origin = position + axes @ starts[index]
                    direction = axes @ directions[index]
                    hit = ray(model, data, origin, direction, seen_groups, True, -1, None, None)
                    free[index] = reach if hit < 0.0 or hit > reach else hit
        finally:
            groups[:] = saved
        return free

    return read


def _meeting_point(starts: FloatArray, directions: FloatArray) -> FloatArray | None:
    """Return the point behind or at all starts where the lines of the rays meet, if there is one."""
    if len(starts) < 2:
        return None
    # The point nearest to all lines in least squares: the sum of (1 - d d^T)(p - s) is 0.
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.cond(total) > 1e6:
        return None  # parallel
    point = np.linalg.solve(total, np.einsum("nij,nj->i", across, starts))
    apart = starts - point
    ahead = np.einsum("ij,ij->i", apart, directions)
    off = np.linalg.norm(apart - ahead[:, None] * directions, axis=1).max()
    return point if off < MEETING_TOLERANCE_M and ahead.min() > -MEETING_TOLERANCE_M else None
