"""Arranges bodies: those with coordinates first, then each that looks for a free spot, in order.

What a spot keeps clear of is known in the plane (`deepbots_cli.footprint`), so that looking takes
microseconds; the engine sees only an arrangement that was found.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from math import inf

from deepbots_cli.errors import EvaluationError
from deepbots_cli.footprint import Patch, Spot
from deepbots_cli.frames import Triple
from deepbots_cli.port import STILL, Engine
from deepbots_cli.program import Program
from deepbots_cli.robots.rotation import quaternion
from deepbots_cli.runtime.placement.floor import EVERYWHERE, TOUCHING, Area, Floor, Surface, anywhere, cut, on_grid
from deepbots_cli.runtime.placement.forms import Forms
from deepbots_cli.runtime.streams import Streams
from deepbots_cli.terrain.relief import height

Pose = tuple[Triple, Triple]
"""Position (m) and roll, pitch, yaw (rad)."""

ROUNDS = 30  # attitudes and kinds that are tried for one body in one attempt
TRIES = 40  # spots for each of them


class NoPlaceError(Exception):
    """A body found no place in this attempt; `args` holds its name."""


class Arrangement:
    """The places of one episode. `present` counts the copies of each group that take part."""

    def __init__(self, scenario: Program, engine: Engine) -> None:
        world, placed = scenario.world, _placed(scenario)
        self._engine = engine
        self._height = height(world.terrain)
        self.forms = Forms(world)
        self._floor = Floor(world.arena.size if world.arena else None)
        built_in = [thing.name for thing in world.objects if not thing.pooled and thing.name not in placed]
        self._built_in = [(self.forms.at_home(name), self.forms.top_at_home(name)) for name in built_in]
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
        """Call `attempt` until it says that the start is as required.

        Raises:
            EvaluationError: It never was; names the body without a place, or the requirement.
        """
        self._streams = streams
        lacking: Counter[str] = Counter()
        for _ in range(attempts):
            self._forget()
            try:
                if attempt():
                    return
            except NoPlaceError as error:
                lacking[str(error)] += 1
        raise EvaluationError(f"no start was found in {attempts} attempts (seed {streams.root}): {_complaint(lacking, attempts)}")

    def _forget(self) -> None:
        self._poses.clear()
        self._floor.clear()
        for patch, top in self._built_in:
            self._floor.take(patch, 0.0, top)
        self.forms.chosen.clear()
        self.present.update(dict.fromkeys(self.present, 0))

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
            self.forms.draw(name, self._streams)
        return sorted(names, key=lambda name: -self.forms.footprint(name).radius)

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
        if body not in self.forms.chosen:
            self.forms.draw(body, self._streams)
        x, y, z = xyz
        if spacing != (0.0, 0.0):
            x, y = x + self._rank[body] * spacing[0], y + self._rank[body] * spacing[1]
        patch = self.forms.footprint(body, rpy).at(x, y, rpy[2])
        self._settle(body, patch, (x, y, z), rpy, velocity, angular_velocity, rests, clearance, self._height(x, y))

    def find(
        self,
        body: str,
        area: Area | None,
        stream: str,
        pose: Callable[[], Pose],
        velocity: Triple = STILL,
        angular_velocity: Triple = STILL,
        *,
        rests: bool = False,
        clearance: float = 0.0,
        mesh: float = 0.0,
        on: str = "",
    ) -> None:
        """Place a body on a free spot, all of which are alike likely; `pose` draws its height and attitude.

        `on` names the object on whose top it stands, which has its place already; `area` None is then the whole top.

        Raises:
            NoPlaceError: None was found.
        """
        generator = self._streams[stream]
        area, surface, base = area or EVERYWHERE, None, -inf
        if on:
            surface = self._surface(on, body)
            area, base = cut(area, surface.area), surface.height
        for number in range(ROUNDS):
            if number or body not in self.forms.chosen:
                self.forms.draw(body, self._streams)
            (_, _, z), rpy = pose()
            covered = self.forms.footprint(body, rpy)
            margin = 0.0 if self.forms.is_fixed(body) else clearance
            within = self._floor.within(area, covered, rpy[2], margin)
            within = surface.within(within, covered, rpy[2], margin) if surface else within
            spots = on_grid(area, within, mesh, generator) if mesh else anywhere(within, TRIES, generator)
            if number:
                spots = self._floor.hopeful(spots, covered, rpy[2], clearance, base)
            for x, y in spots:
                patch = covered.at(x, y, rpy[2])
                if (surface is None or surface.holds(patch, margin)) and self._floor.is_free(patch, clearance, base):
                    ground = surface.height if surface else self._height(x, y)
                    self._settle(body, patch, (x, y, z), rpy, velocity, angular_velocity, rests, clearance, ground)
                    return
        raise NoPlaceError(body)

    def _surface(self, support: str, body: str) -> Surface:
        """The top of an object as it stands in this episode.

        Raises:
            NoPlaceError: It has no place yet, so that `body` finds none.
        """
        if support not in self._poses or support not in self.forms.things:
            raise NoPlaceError(body)
        (x, y, z), rpy, *_ = self._poses[support]
        return Surface(self.forms.footprint(support, rpy).at(x, y, rpy[2]), self.forms.top(support, z, rpy))

    def choose(self) -> None:
        """Let bodies of several kinds take the kind that was drawn."""
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
        velocity: Triple,
        angular_velocity: Triple,
        rests: bool,
        clearance: float,
        ground: float,
    ) -> None:
        """Note the place of a body whose height counts from `ground` (m)."""
        x, y, z = xyz
        z += ground + (self.forms.resting(body, rpy) if rests else 0.0)
        top = self.forms.top(body, z, rpy)
        if top > ground + TOUCHING:  # a table top level with the ground is nothing to keep clear of
            self._floor.take(patch, clearance, top)
        moving = velocity is not STILL or angular_velocity is not STILL
        self._poses[body] = ((x, y, z), rpy, *((velocity, angular_velocity) if moving else ()))


def _placed(scenario: Program) -> set[str]:
    """What some layout places."""
    reset = scenario.reset
    return {place.body for places in (reset.placements, *(layout.placements for layout in reset.layouts)) for place in places}


def _complaint(lacking: Counter[str], attempts: int) -> str:
    """What failed most often, and what to do about it."""
    if lacking:
        body = lacking.most_common(1)[0][0]
        if 2 * lacking.total() >= attempts:
            return f"'{body}' finds no place; ask for fewer or smaller bodies, less clearance, or a larger region"
    return "what `reset.require` asks for does not hold; let it ask for less, or allow more `attempts`"
