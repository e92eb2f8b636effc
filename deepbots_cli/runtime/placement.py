"""The poses of bodies at the beginning of an episode.

`Arrangement` takes bodies with coordinates first, then looks for a free spot for each of the others, in
order, again and again until the start is as required. `Floor` has the spots that are taken, `Forms` the
footprint and the height of each body. The search takes microseconds, since it works in the plane
(`deepbots_cli.footprint`); the engine gets only the final arrangement.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from deepbots_cli import footprint
from deepbots_cli.errors import EvaluationError
from deepbots_cli.footprint import Footprint, Patch, Spot
from deepbots_cli.frames import Triple, quaternion
from deepbots_cli.geometry import ground_height
from deepbots_cli.port import ZERO_VECTOR, Engine
from deepbots_cli.program import Program
from deepbots_cli.program.resets import kind_key
from deepbots_cli.program.task import RobotCopies
from deepbots_cli.program.world import ObjectBody, Variant, WorldModel
from deepbots_cli.robots import kinematics
from deepbots_cli.robots.model import Shape
from deepbots_cli.runtime.streams import Streams

Pose = tuple[Triple, Triple]
"""Position (m) and roll, pitch, yaw (rad)."""
Area = tuple[float, float, float, float]
"""Lowest x and y, highest x and y, in m."""

UNBOUNDED_AREA: Area = (-inf, -inf, inf, inf)
TOUCHING_TOLERANCE_M = 1e-9  # rounding
_SAME_SPOT_M = 1e-6  # m by which the coordinates of a cell may be off
MAX_ROUNDS = 30  # attitudes and kinds that are tried for one body in one attempt
TRIES_PER_ROUND = 40  # spots for each of them


class NoPlaceError(Exception):
    """The error for a body without a place in this attempt; `args` has its name."""


class Arrangement:
    """The places of one episode. `present` counts the copies of each group that take part."""

    def __init__(self, scenario: Program, engine: Engine) -> None:
        world = scenario.world
        placed_bodies = _placed(scenario)
        self._engine = engine
        self._height = ground_height(world.terrain)
        self.forms = Forms(world, scenario.reset.joint_positions)
        self._floor = Floor(world.arena.size if world.arena else None)
        built_in = [body.name for body in world.objects if not body.pooled and body.name not in placed_bodies]
        self._built_in = [self.forms.at_home(name) for name in built_in]
        self._capacity = {group.name: group.capacity for group in scenario.reset.groups}
        self._poses: dict[str, tuple[Triple, ...]] = {}
        self._rank: dict[str, float] = {}
        self.present: dict[str, int] = dict.fromkeys(self._capacity, 0)
        self._streams = Streams(0)

    @property
    def placed(self) -> Iterable[str]:
        """The bodies that take part in the episode."""
        return self._poses.keys()

    def arrange(self, attempt: Callable[[], bool], attempts: int, streams: Streams) -> None:
        """Call `attempt` until it returns that the start is as required.

        Raises:
            EvaluationError: It never was; names the body without a place, or the requirement.
        """
        self._streams = streams
        lacking: Counter[str] = Counter()
        before = streams.drawn
        for _ in range(attempts):
            self._forget()
            # The draws of a failed attempt are not those of the episode.
            streams.drawn = dict(before)
            streams.member = ""
            try:
                if attempt():
                    return
            except NoPlaceError as error:
                lacking[str(error)] += 1
            finally:
                streams.member = ""
        spots = [key for key in streams.chosen if key.endswith((".x", ".y"))]
        is_set = [
            body for body in lacking if any(key.startswith(f"{body}|") or f".{body}." in key for key in spots)
        ]
        raise EvaluationError(
            f"no start was found in {attempts} attempts (seed {streams.root}):"
            f" {_complaint(lacking, attempts, is_set)}"
        )

    def _forget(self) -> None:
        self._poses.clear()
        self._floor.clear()
        for patch, top in self._built_in:
            self._floor.occupy(patch, 0.0, top)
        self.forms.chosen.clear()
        self.present.update(dict.fromkeys(self.present, 0))

    # Parts of an attempt

    def layout(self, stream: str, *shares: tuple[str, float]) -> str:
        """Return one of the layouts, drawn by their shares."""
        point = self._streams[stream].random() * sum(share for _, share in shares)
        layout = shares[-1][0]  # rounding may leave a rest after the last share
        for name, share in shares:
            point -= share
            if point < 0.0:
                layout = name
                break
        return self._streams.take(stream, layout)

    def copies(self, group: str, count: float, at_most: float = inf) -> Iterator[str]:
        """Return the names of the copies that take part, and a kind drawn for each. Large copies come first,
        because they need more room."""
        return self._in_turn(self._present_copies(group, count, at_most))

    def _in_turn(self, bodies: Sequence[str]) -> Iterator[str]:
        """Yield the bodies, each while the draws are its own."""
        for body in bodies:
            self._streams.member = body if "#" in body else ""
            yield body
        self._streams.member = ""

    def _present_copies(self, group: str, count: float, at_most: float) -> list[str]:
        number = int(max(0.0, min(count, at_most, self._capacity[group])))
        self.present[group] = number
        names = [f"{group}#{index + 1}" for index in range(number)]
        self._rank = {name: index - (number - 1) / 2 for index, name in enumerate(names)}
        for name in names:
            self.forms.draw(name, self._streams)
        return sorted(names, key=lambda name: -self.forms.footprint(name).radius)

    def cells(
        self, body: str, count: float, spots: Sequence[Spot], stream: str
    ) -> Iterator[tuple[str, Spot]]:
        """Return copies of a group, or a single body, each with a spot of its own; drawn if there are more
        spots than bodies."""
        names = self._present_copies(body, count, len(spots)) if body in self._capacity else [body]
        if len(names) < len(spots):
            order = self._streams[stream].permutation(len(spots))
            spots = self._drawn_cells(names, [spots[index] for index in order], stream)
        return zip(self._in_turn(names), spots, strict=False)

    def _drawn_cells(self, names: Sequence[str], spots: list[Spot], stream: str) -> list[Spot]:
        """Return a spot for each body: first the chosen ones, then the others in their order."""
        spot_by_body: dict[str, Spot] = {}
        for is_chosen in (True, False):
            for body in names:
                self._streams.member = body if "#" in body else ""
                coordinates = self._chosen_spot(stream)
                if body not in spot_by_body and (coordinates is not None) is is_chosen:
                    drawn_spot = next(
                        (spot for spot in spots if coordinates is None or _fits(spot, coordinates)), None
                    )
                    if drawn_spot is None:
                        raise NoPlaceError(body)
                    spots.remove(drawn_spot)
                    spot_by_body[body] = drawn_spot
                    self._streams.drawn |= {
                        self._streams.key(f"{stream}.{axis}"): value
                        for axis, value in zip("xy", drawn_spot, strict=True)
                    }
        return [spot_by_body[body] for body in names]

    def _chosen_spot(self, stream: str) -> tuple[float | None, float | None] | None:
        """Return the coordinates that `options` of `reset` set for a body that looks for a spot; None if it
        sets neither."""
        values = self._streams.chosen
        key = self._streams.key(stream)
        x, y = values.get(f"{key}.x"), values.get(f"{key}.y")
        return None if x is None and y is None else (x, y)

    def stand(
        self,
        body: str,
        xyz: Triple,
        rpy: Triple,
        velocity: Triple = ZERO_VECTOR,
        angular_velocity: Triple = ZERO_VECTOR,
        *,
        rests: bool = False,
        clearance: float = 0.0,
        spacing: Spot = (0.0, 0.0),
    ) -> None:
        """Place a body at coordinates, without a check for other bodies."""
        if body not in self.forms.chosen:
            self.forms.draw(body, self._streams)
        x, y, z = xyz
        if spacing != (0.0, 0.0):
            x, y = x + self._rank[body] * spacing[0], y + self._rank[body] * spacing[1]
        patch = self.forms.footprint(body, rpy).at(x, y, rpy[2])
        self._settle(
            body, patch, (x, y, z), rpy, (velocity, angular_velocity), rests, clearance, self._height(x, y)
        )

    def find(
        self,
        body: str,
        area: Area | None,
        stream: str,
        pose: Callable[[], Pose],
        velocity: Triple = ZERO_VECTOR,
        angular_velocity: Triple = ZERO_VECTOR,
        *,
        rests: bool = False,
        clearance: float = 0.0,
        mesh: float = 0.0,
        on: str = "",
    ) -> None:
        """Place a body on a free spot, drawn uniformly; `pose` draws its height and attitude.

        `on` names the object on whose top it is placed, which has its place already; `area` None is then the
        whole top.

        Raises:
            NoPlaceError: None was found.
        """
        generator = self._streams[stream]
        coordinates = self._chosen_spot(stream)
        area = area or UNBOUNDED_AREA
        surface = None
        base = -inf
        if on:
            surface = self._surface(on, body)
            area = intersection(area, surface.area)
            base = surface.height
        for number in range(MAX_ROUNDS):
            # The first round keeps the kind that `copies` drew, by whose size the bodies were sorted.
            if number or body not in self.forms.chosen:
                self.forms.draw(body, self._streams)
            (_, _, z), rpy = pose()
            covered = self.forms.footprint(body, rpy)
            margin = 0.0 if self.forms.is_fixed(body) else clearance
            within = self._floor.allowed_area(area, covered, rpy[2], margin)
            within = surface.allowed_area(within, covered, rpy[2], margin) if surface else within
            spots = (
                shuffled_grid_spots(area, within, mesh, generator)
                if mesh
                else random_spots(within, TRIES_PER_ROUND, generator)
            )
            if coordinates is not None and (self._streams.is_follower or not mesh):
                spots = _moved(spots, coordinates, UNBOUNDED_AREA if self._streams.is_follower else within)
            elif coordinates is not None:
                spots = [spot for spot in spots if _fits(spot, coordinates)]
            elif number:
                spots = self._floor.candidate_spots(spots, covered, rpy[2], clearance, base)
            for x, y in spots:
                patch = covered.at(x, y, rpy[2])
                is_free = (surface is None or surface.contains(patch, margin)) and self._floor.is_free(
                    patch, clearance, base
                )
                if is_free or self._streams.is_follower:
                    ground = surface.height if surface else self._height(x, y)
                    self._settle(
                        body, patch, (x, y, z), rpy, (velocity, angular_velocity), rests, clearance, ground
                    )
                    key = self._streams.key(stream)
                    self._streams.drawn |= {f"{key}.x": float(x), f"{key}.y": float(y)}
                    return
        raise NoPlaceError(body)

    def _surface(self, support: str, body: str) -> Surface:
        """Return the top of an object in its place in this episode.

        Raises:
            NoPlaceError: It has no place yet, so that `body` finds none.
        """
        if support not in self._poses or support not in self.forms.things:
            raise NoPlaceError(body)
        (x, y, z), rpy, *_ = self._poses[support]
        return Surface(self.forms.footprint(support, rpy).at(x, y, rpy[2]), self.forms.top(support, z, rpy))

    def choose(self) -> None:
        """Give bodies of several kinds the kind that was drawn."""
        for body, variant in self.forms.chosen.items():
            self._engine.choose(body, variant.name)

    def put(self) -> None:
        """Put every body into the engine's world."""
        for body, (xyz, rpy, *motion) in self._poses.items():
            self._engine.place(body, xyz, quaternion(*rpy), *motion)

    def _settle(
        self,
        body: str,
        patch: Patch,
        xyz: Triple,
        rpy: Triple,
        motion: tuple[Triple, Triple],
        rests: bool,
        clearance: float,
        ground: float,
    ) -> None:
        """Note the place of a body whose height counts from `ground` (m)."""
        x, y, z = xyz
        z += ground + (self.forms.resting_height(body, rpy) if rests else 0.0)
        top = self.forms.top(body, z, rpy)
        # A table top at ground level needs no clearance.
        if top > ground + TOUCHING_TOLERANCE_M:
            self._floor.occupy(patch, clearance, top)
        self._poses[body] = ((x, y, z), rpy, *(() if motion == (ZERO_VECTOR, ZERO_VECTOR) else motion))


def _placed(scenario: Program) -> set[str]:
    """Return the bodies that some layout places."""
    reset = scenario.reset
    return {
        place.body
        for places in (reset.placements, *(layout.placements for layout in reset.layouts))
        for place in places
    }


def _complaint(lacking: Counter[str], attempts: int, is_set: Sequence[str]) -> str:
    """Return the most frequent failure, and a remedy; the place of bodies of `is_set` is given by the options
    of `reset`."""
    if lacking:
        body = lacking.most_common(1)[0][0]
        if body in is_set:
            return (
                f"'{body}' cannot be placed at the position in the reset options: another body is there, or"
                " the position is outside its region"
            )
        if 2 * lacking.total() >= attempts:
            return (
                f"there is no free position for '{body}'; use fewer or smaller bodies, less clearance, or"
                " a larger region"
            )
    return "no start met `reset.require`; weaken the condition, or raise `attempts`"


class Floor:
    """The ground plane within the walls of an arena, and the patches that are taken."""

    def __init__(self, size: Spot | None) -> None:
        """Create a floor. `size` is the inner size of the arena along x and y, in m."""
        self._half = (size[0] / 2, size[1] / 2) if size else (inf, inf)
        self._taken: list[tuple[Patch, float, float]] = []

    def clear(self) -> None:
        self._taken.clear()

    def occupy(self, patch: Patch, clearance: float, top: float) -> None:
        """Take a patch for a body that reaches up to the height `top` (m)."""
        self._taken.append((patch, clearance, top))

    def allowed_area(self, area: Area, covered: Footprint, yaw: float, clearance: float) -> Area:
        """Return the part of the area in which the origin of a body keeps its clearance from the walls; may
        be empty."""
        at_origin = covered.at(0.0, 0.0, yaw)
        (reach_x, reach_y), (half_x, half_y) = at_origin.half_extents, self._half
        room_x, room_y = half_x - clearance - reach_x, half_y - clearance - reach_y
        x, y = at_origin.x, at_origin.y
        return (
            max(area[0], -room_x - x),
            max(area[1], -room_y - y),
            min(area[2], room_x - x),
            min(area[3], room_y - y),
        )

    def is_free(self, patch: Patch, clearance: float, base: float = -inf) -> bool:
        """Return whether each body above the height `base` (m) keeps its clearance and that of the patch."""
        x = patch.x
        y = patch.y
        radius = patch.radius
        for obstacle, other_clearance, top in self._taken:
            # The support, and all that is lower, does not stand in the way of a body on top.
            if top <= base + TOUCHING_TOLERANCE_M:
                continue
            patch_distance = (
                clearance if clearance > other_clearance else other_clearance
            ) - TOUCHING_TOLERANCE_M
            dx = x - obstacle.x
            dy = y - obstacle.y
            reach = radius + obstacle.radius + patch_distance
            # The circles around both patches come first: they need no corners.
            if (
                dx * dx + dy * dy < reach * reach
                and footprint.patch_distance(patch, obstacle) < patch_distance
            ):
                return False
        return True

    def candidate_spots(
        self, spots: list[Spot], covered: Footprint, yaw: float, clearance: float, base: float
    ) -> list[Spot]:
        """Return the spots where a disc that fits into the body would be free: a cheap test that drops most
        spots of a crowd."""
        obstacles = [
            (obstacle, other_clearance)
            for obstacle, other_clearance, top in self._taken
            if top > base + TOUCHING_TOLERANCE_M
        ]
        if not spots or not obstacles:
            return spots
        at_origin = covered.at(0.0, 0.0, yaw)
        rows = [
            (o.x, o.y, *(o.half or (0.0, 0.0)), o.cos, o.sin, 0.0 if o.half else o.radius, other_clearance)
            for o, other_clearance in obstacles
        ]
        x, y, half_x, half_y, c, s, around, clearances = np.array(rows).T
        dx, dy = np.add(spots, (at_origin.x, at_origin.y)).T[..., None] - np.array((x, y))[:, None]
        along = np.maximum(np.abs(c * dx + s * dy) - half_x, 0.0)
        across = np.maximum(np.abs(c * dy - s * dx) - half_y, 0.0)
        patch_distance = np.maximum(clearances, clearance) + around + covered.inradius - TOUCHING_TOLERANCE_M
        free = np.all(along * along + across * across >= patch_distance * patch_distance, axis=1)
        return [spot for spot, hopeful in zip(spots, free.tolist(), strict=True) if hopeful]


class Surface(NamedTuple):
    """The level top of an object: its area, and its height in m."""

    patch: Patch
    height: float

    @property
    def area(self) -> Area:
        (x, y), (reach_x, reach_y) = (self.patch.x, self.patch.y), self.patch.half_extents
        return x - reach_x, y - reach_y, x + reach_x, y + reach_y

    def allowed_area(self, area: Area, covered: Footprint, yaw: float, margin: float) -> Area:
        """Return the part of the area in which the origin of a body may keep `margin` from the edge; may be
        empty."""
        at_origin = covered.at(0.0, 0.0, yaw)
        low_x, low_y, high_x, high_y = self.area
        reach_x, reach_y = (reach + margin for reach in at_origin.half_extents)
        x, y = at_origin.x, at_origin.y
        return intersection(
            area, (low_x + reach_x - x, low_y + reach_y - y, high_x - reach_x - x, high_y - reach_y - y)
        )

    def contains(self, patch: Patch, margin: float) -> bool:
        return self.patch.contains(patch, margin - TOUCHING_TOLERANCE_M)


def intersection(first: Area, second: Area) -> Area:
    """Return the intersection of two areas; of an empty one, the lowest coordinate is above the highest."""
    return (
        max(first[0], second[0]),
        max(first[1], second[1]),
        min(first[2], second[2]),
        min(first[3], second[3]),
    )


def _fits(spot: Spot, coordinates: tuple[float | None, float | None]) -> bool:
    """Return whether a spot has the given coordinates."""
    return all(
        coordinate is None or abs(value - coordinate) <= _SAME_SPOT_M
        for value, coordinate in zip(spot, coordinates, strict=True)
    )


def _moved(spots: Iterable[Spot], coordinates: tuple[float | None, float | None], area: Area) -> list[Spot]:
    """Return the spots with the given coordinates, if they lie in the area."""
    x, y = coordinates
    moved = (
        [(across if x is None else x, along if y is None else y) for across, along in spots]
        if None in coordinates
        else [coordinates]
    )
    return [(x, y) for x, y in moved if x is not None and y is not None and _contains(area, x, y)]


def _contains(area: Area, x: float, y: float) -> bool:
    slack = TOUCHING_TOLERANCE_M
    return area[0] - slack <= x <= area[2] + slack and area[1] - slack <= y <= area[3] + slack


def random_spots(area: Area, count: int, generator: np.random.Generator) -> list[Spot]:
    """Return `count` spots of an area, drawn uniformly; none of an empty one."""
    if area[0] > area[2] or area[1] > area[3]:
        return []
    shares = generator.random((count, 2)).tolist()
    return [(area[0] + a * (area[2] - area[0]), area[1] + b * (area[3] - area[1])) for a, b in shares]


def shuffled_grid_spots(area: Area, within: Area, mesh: float, generator: np.random.Generator) -> list[Spot]:
    """Return the middles of the cells of size `mesh` that fit into an area, about its middle, and lie within
    another; in random order."""
    # In floats, 0.3 m are 2.9999999999999996 cells of 0.1 m.
    columns, rows = (max(1, int((area[axis + 2] - area[axis]) / mesh + 1e-9)) for axis in (0, 1))
    x, y = (area[0] + area[2]) / 2, (area[1] + area[3]) / 2
    middles = [
        (x + (i - (columns - 1) / 2) * mesh, y + (j - (rows - 1) / 2) * mesh)
        for j in range(rows)
        for i in range(columns)
    ]
    shuffled_middles = [middles[index] for index in generator.permutation(len(middles))]
    return [(x, y) for x, y in shuffled_middles if _contains(within, x, y)]


class Forms:
    """Footprint and height of each body in the form of this episode; `chosen` has the variants drawn, and
    `joint_positions` those of `Reset`."""

    def __init__(self, world: WorldModel, joint_positions: Mapping[str, Mapping[str, float]]) -> None:
        self._joint_positions = joint_positions
        self.models = {robot.name: robot.model for robot in world.robots}
        self.things: dict[str, ObjectBody] = {body.name: body for body in world.objects}
        self.chosen: dict[str, Variant] = {}
        self._robots = {name: footprint.robot_footprint(model) for name, model in self.models.items()}
        self._widths = {name: footprint.half_width(model) for name, model in self.models.items()}
        shapes = [body.shape for body in world.objects]
        shapes += [variant.shape for body in world.objects for variant in body.variants]
        self._upright = {shape: footprint.shape_footprint(shape) for shape in shapes}

    def draw(self, body: str, streams: Streams) -> None:
        """Draw the variant of a body anew; a body without variants stays."""
        variants = self.things[body].variants if body in self.things else ()
        if variants:
            stream = streams[f"objects.{body.partition('#')[0]}.one_of"]
            kind = streams.note(kind_key(body), variants[int(stream.integers(len(variants)))].name)
            self.chosen[body] = next(variant for variant in variants if variant.name == kind)

    def is_fixed(self, body: str) -> bool:
        """Return whether the body never moves."""
        return body in self.things and (self.chosen.get(body) or self.things[body]).fixed

    def shape(self, body: str) -> Shape:
        """Return the shape of an object."""
        return (self.chosen.get(body) or self.things[body]).shape

    def footprint(self, body: str, rpy: Triple = (0.0, 0.0, 0.0)) -> Footprint:
        """Return the footprint with this attitude; that of a robot does not depend on it."""
        cached = self._robots.get(body)
        if cached is not None:
            return cached
        shape = self.shape(body)
        return (
            self._upright[shape]
            if rpy[0] == rpy[1] == 0.0
            else footprint.shape_footprint(shape, rpy[0], rpy[1])
        )

    def half_width(self, body: str) -> float:
        """Return half the width of the narrowest passage that it fits through, in m."""
        return self._widths[body] if body in self._widths else self.footprint(body).inradius

    def resting_height(self, body: str, rpy: Triple) -> float:
        """Return the height (m) of the body's origin if its lowest point touches flat ground."""
        return kinematics.resting_height(
            self.models.get(body) or self.shape(body), rpy[0], rpy[1], self._joint_positions.get(body)
        )

    def top(self, body: str, z: float, rpy: Triple) -> float:
        """Return the height of the top of an object whose origin is at `z`; infinite for a robot."""
        if body not in self.things:
            return inf
        return kinematics.highest_point(self.shape(body), ((0.0, 0.0, z), quaternion(rpy[0], rpy[1], 0.0)))

    def at_home(self, body: str) -> tuple[Patch, float]:
        """Return the patch and the top of an object at the pose of the world model."""
        x, y, z = self.things[body].pose.xyz
        rpy = self.things[body].pose.rpy
        return self.footprint(body, rpy).at(x, y, rpy[2]), self.top(body, z, rpy)


def copy_offset(copies: RobotCopies, number: int) -> Triple:
    """Return the offset (m) of a copy from the middle of the row."""
    steps = number - (copies.count + 1) / 2
    x, y, z = (steps * step for step in copies.spacing)
    return x, y, z
