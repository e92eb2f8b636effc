"""Arranges bodies: those with coordinates first, then each that looks for a free spot, in order.

What a spot keeps clear of is known in the plane (`deepbots_cli.footprint`), so that looking takes
microseconds; the engine sees only an arrangement that was found.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from math import inf

from deepbots_cli import footprint
from deepbots_cli.errors import EvaluationError
from deepbots_cli.footprint import Footprint, Patch, Spot
from deepbots_cli.frames import Triple
from deepbots_cli.ir import CompiledScenario, ObjectBody, Variant
from deepbots_cli.port import STILL, Engine
from deepbots_cli.runtime.streams import Streams
from deepbots_cli.urdf.model import RobotModel, Shape
from deepbots_cli.urdf.rotation import quaternion

Pose = tuple[Triple, Triple]
"""Position (m) and roll, pitch, yaw (rad)."""
Area = tuple[float, float, float, float]
"""Least x and y, greatest x and y, in m."""

TRIES = 400  # spots that are tried for one body in one attempt
SAME = 40  # of these, so many with the same attitude and kind; then both are drawn anew
_TOUCHING = 1e-9  # m that rounding may cost


class NoPlaceError(Exception):
    """A body found no place in this attempt; `args` holds its name."""


class Arrangement:
    """The places of one episode. `present` counts the copies of each group that take part."""

    def __init__(self, scenario: CompiledScenario, engine: Engine) -> None:
        world = scenario.world
        self._engine = engine
        self._half = (world.arena.size[0] / 2, world.arena.size[1] / 2) if world.arena else (inf, inf)
        self._robots = {robot.name: footprint.of_robot(robot.model) for robot in world.robots}
        self._models: dict[str, RobotModel] = {robot.name: robot.model for robot in world.robots}
        self._shapes = {thing.name: thing.shape for thing in world.objects}
        self._variants: dict[str, tuple[Variant, ...]] = {thing.name: thing.variants for thing in world.objects if thing.variants}
        self._upright = {shape: footprint.of_shape(shape) for shape in self._all_shapes()}
        self._built_in = {
            thing.name: (self._standing(thing), 0.0) for thing in world.objects if not thing.pooled and thing.name not in _placed(scenario)
        }
        self._capacity = {group.name: group.capacity for group in scenario.reset.groups}
        self._poses: dict[str, tuple[Triple, ...]] = {}
        self._patches: dict[str, tuple[Patch, float]] = {}
        self._chosen: dict[str, Variant] = {}
        self._rank: dict[str, float] = {}
        self.present: dict[str, int] = dict.fromkeys(self._capacity, 0)
        self._streams = Streams(0)

    def _standing(self, thing: ObjectBody) -> Patch:
        """Of a body that no reset moves, such as a piece of a wall."""
        (x, y, _), (roll, pitch, yaw) = thing.pose.xyz, thing.pose.rpy
        return footprint.of_shape(thing.shape, roll, pitch).at(x, y, yaw)

    def _all_shapes(self) -> Iterator[Shape]:
        yield from self._shapes.values()
        yield from (variant.shape for variants in self._variants.values() for variant in variants)

    def arrange(self, attempt: Callable[[], bool], attempts: int, streams: Streams) -> None:
        """Call `attempt` until it says that the start is as required.

        Raises:
            EvaluationError: It never was; names the body without a place, or the requirement.
        """
        self._streams = streams
        lacking: Counter[str] = Counter()
        for _ in range(attempts):
            self._poses.clear()
            self._patches = dict(self._built_in)
            self._chosen.clear()
            self.present.update(dict.fromkeys(self.present, 0))
            try:
                if attempt():
                    return
            except NoPlaceError as error:
                lacking[str(error)] += 1
        raise EvaluationError(f"no start was found in {attempts} attempts (seed {streams.root}): {_complaint(lacking, attempts)}")

    # What an attempt is made of

    def layout(self, stream: str, *shares: tuple[str, float]) -> str:
        """One of the layouts, drawn by their shares."""
        point = self._streams[stream].random() * sum(share for _, share in shares)
        for name, share in shares:
            point -= share
            if point < 0.0:
                return name
        return shares[-1][0]

    def copies(self, group: str, count: float, at_most: float = inf) -> list[str]:
        """The names of the copies that take part, and a kind drawn for each; large ones come first, as they need more room."""
        number = int(max(0.0, min(count, at_most, self._capacity[group])))
        self.present[group] = number
        names = [f"{group}#{index + 1}" for index in range(number)]
        self._rank = {name: index - (number - 1) / 2 for index, name in enumerate(names)}
        for name in names:
            if name in self._variants:
                self._choose(name)
        return sorted(names, key=lambda name: -self._upright[self._shape(name)].radius) if group not in self._robots else names

    def cells(self, body: str, count: float, spots: Sequence[Spot], stream: str) -> list[tuple[str, Spot]]:
        """Copies of a group, or a single body, each with a spot of its own; drawn where there are more spots than bodies."""
        names = self.copies(body, count, len(spots)) if body in self._capacity else [body]
        if len(names) < len(spots):
            order = self._streams[stream].permutation(len(spots))
            spots = [spots[index] for index in order[: len(names)]]
        return list(zip(names, spots, strict=False))

    def stand(
        self,
        body: str,
        xyz: Triple,
        rpy: Triple,
        velocity: Triple = STILL,
        angular_velocity: Triple = STILL,
        *,
        rests: bool = False,
        clearance: float = 0.0,
        spacing: Spot = (0.0, 0.0),
    ) -> None:
        """Place a body at coordinates, whatever is there."""
        x, y, z = xyz
        if spacing != (0.0, 0.0):
            x, y = x + self._rank[body] * spacing[0], y + self._rank[body] * spacing[1]
        self._settle(body, self._footprint(body, rpy).at(x, y, rpy[2]), (x, y, z), rpy, velocity, angular_velocity, rests, clearance)

    def find(
        self,
        body: str,
        area: Area,
        stream: str,
        pose: Callable[[], Pose],
        velocity: Triple = STILL,
        angular_velocity: Triple = STILL,
        *,
        rests: bool = False,
        clearance: float = 0.0,
        mesh: float = 0.0,
    ) -> None:
        """Place a body on a free spot, all of which are alike likely; `pose` draws its height and attitude.

        Raises:
            NoPlaceError: None was found.
        """
        for round_ in range(TRIES // SAME):
            if round_ and body in self._variants:
                self._choose(body)
            (_, _, z), rpy = pose()
            covered = self._footprint(body, rpy)
            for x, y in self._spots(covered, area, rpy[2], clearance, mesh, stream):
                patch = covered.at(x, y, rpy[2])
                if self._is_free(patch, clearance):
                    self._settle(body, patch, (x, y, z), rpy, velocity, angular_velocity, rests, clearance)
                    return
        raise NoPlaceError(body)

    def put(self) -> None:
        """Put every body into the engine's world."""
        for body, variant in self._chosen.items():
            self._engine.choose(body, variant.name)
        for body, (xyz, rpy, *motion) in self._poses.items():
            self._engine.place(body, xyz, quaternion(*rpy), *motion)

    def _choose(self, body: str) -> None:
        variants = self._variants[body]
        stream = self._streams[f"objects.{body.partition('#')[0]}.one_of"]
        self._chosen[body] = variants[int(stream.integers(len(variants)))]

    def _shape(self, body: str) -> Shape:
        chosen = self._chosen.get(body)
        return chosen.shape if chosen else self._shapes[body]

    def _footprint(self, body: str, rpy: Triple) -> Footprint:
        known = self._robots.get(body)
        if known is not None:
            return known
        shape = self._shape(body)
        return self._upright[shape] if rpy[0] == rpy[1] == 0.0 else footprint.of_shape(shape, rpy[0], rpy[1])

    def _spots(self, covered: Footprint, area: Area, yaw: float, clearance: float, mesh: float, stream: str) -> Iterator[Spot]:
        """Spots of the area that leave the walls their clearance: some of all, or every cell of a grid, in random order."""
        at_origin = covered.at(0.0, 0.0, yaw)
        (reach_x, reach_y), (half_x, half_y) = at_origin.extent, self._half
        low_x = max(area[0], clearance + reach_x - at_origin.x - half_x)
        low_y = max(area[1], clearance + reach_y - at_origin.y - half_y)
        high_x = min(area[2], half_x - clearance - reach_x - at_origin.x)
        high_y = min(area[3], half_y - clearance - reach_y - at_origin.y)
        generator = self._streams[stream]
        if mesh:
            middles = grid(area, mesh)
            for index in generator.permutation(len(middles)):
                x, y = middles[index]
                if low_x - _TOUCHING <= x <= high_x + _TOUCHING and low_y - _TOUCHING <= y <= high_y + _TOUCHING:
                    yield x, y
        elif low_x <= high_x and low_y <= high_y:
            for a, b in generator.random((SAME, 2)).tolist():
                yield low_x + a * (high_x - low_x), low_y + b * (high_y - low_y)

    def _is_free(self, patch: Patch, clearance: float) -> bool:
        return all(footprint.clear(patch, other, max(clearance, own) - _TOUCHING) for other, own in self._patches.values())

    def _settle(
        self,
        body: str,
        patch: Patch,
        xyz: Triple,
        rpy: Triple,
        velocity: Triple,
        angular_velocity: Triple,
        rests: bool,
        clearance: float,
    ) -> None:
        x, y, z = xyz
        if rests:
            z += footprint.resting(self._models.get(body) or self._shape(body), rpy[0], rpy[1])
        half = inf if body in self._models else footprint.resting(self._shape(body), rpy[0], rpy[1])
        if z + half > _TOUCHING:  # a table top at the height of the ground is nothing to keep clear of
            self._patches[body] = (patch, clearance)
        moving = velocity is not STILL or angular_velocity is not STILL
        self._poses[body] = ((x, y, z), rpy, *((velocity, angular_velocity) if moving else ()))


def grid(area: Area, mesh: float) -> list[Spot]:
    """The middles of the cells of size `mesh` that fit into an area, about its middle, row by row."""
    columns, rows = (max(1, int((area[axis + 2] - area[axis]) / mesh + 1e-9)) for axis in (0, 1))
    x, y = (area[0] + area[2]) / 2, (area[1] + area[3]) / 2
    return [(x + (i - (columns - 1) / 2) * mesh, y + (j - (rows - 1) / 2) * mesh) for j in range(rows) for i in range(columns)]


def _placed(scenario: CompiledScenario) -> set[str]:
    """What some layout places."""
    reset = scenario.reset
    return {place.body for places in (reset.places, *(layout.places for layout in reset.layouts)) for place in places}


def _complaint(lacking: Counter[str], attempts: int) -> str:
    """What failed most often, and what to do about it."""
    if lacking:
        body, times = lacking.most_common(1)[0]
        if 2 * times >= attempts:
            return f"'{body}' finds no place; ask for fewer or smaller bodies, less clearance, or a larger region"
    return "what `reset.require` asks for does not hold; let it ask for less, or allow more `attempts`"
