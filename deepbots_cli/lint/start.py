"""What values can be right after a reset: where bodies stand, how joints are set, what memories begin with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import cos, sin

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.intervals import EVERYTHING, Interval, exact, hull
from deepbots_cli.expressions.scalar import State, World
from deepbots_cli.lint.meaning import Book
from deepbots_cli.lint.reach import NEVER, Reach
from deepbots_cli.program.resets import Placement, Region, Top

_PLANE = ("x", "y")
_TURNS = ("roll", "pitch", "yaw")
_BEFORE = {"episode_return": NEVER, "previous_reward": NEVER}


class AtStart(Reach):
    """The first values of an episode. Where the world settles, and of copies of a robot, nothing is known of places."""

    def __init__(self, book: Book) -> None:
        super().__init__(book, _BEFORE, (0.0, 0.0))
        program = book.program
        self._is_placed = not program.reset.settle and program.agent.each is None
        self._bodies = {f"{robot.name}.{robot.model.root}": robot.name for robot in program.world.robots}
        self._bodies |= {thing.name: thing.name for thing in program.world.objects}

    def _world(self, node: World) -> Interval:
        found = self.standing(node)
        return super()._world(node) if found is None else found

    def standing(self, node: World) -> Interval | None:
        """What a fact about a place is drawn from, no wider; None where the scenario does not say it."""
        if not self._is_placed:
            return None
        subject = node.subjects[0]
        match node.function:
            case "joint_position":
                return self.joint(subject)
            case "position":
                places = list(self._places(self._bodies.get(subject, "")))
                return hull([self._coordinate(place, node.component or "") for place in places]) if places else None
            case "joint_velocity":
                return self._joint_speed(subject)
            case "velocity" | "angular_velocity" as way:
                return self._speed(subject, way, "xyz".index(node.component or "x"))
            case "orientation":
                places = list(self._places(self._bodies.get(subject, "")))
                return hull([self._attitude(place)["xyzw".index(node.component or "")] for place in places]) if places else None
            case _:
                return None

    def joint(self, joint: str) -> Interval | None:
        """Where a joint is set; None for one that nothing sets."""
        robot, _, name = joint.partition(".")
        for start in self.book.program.reset.joint_starts:
            if start.robot == robot and name in start.joints:
                return self.of(start.position.scalars[start.joints.index(name)])
        return None

    def _joint_speed(self, joint: str) -> Interval:
        robot, _, name = joint.partition(".")
        for start in self.book.program.reset.joint_starts:
            if start.robot == robot and name in start.joints and start.velocity is not None:
                return self.of(start.velocity.scalars[start.joints.index(name)])
        return NEVER

    def _speed(self, subject: str, way: str, axis: int) -> Interval | None:
        """At rest unless the scenario says otherwise; None for what turns or is moved by joints, since its origin may then move too."""
        body = self._bodies.get(subject)
        places = list(self._places(body or subject.partition(".")[0].partition("#")[0]))
        moved = [valued for place in places for valued in (place.velocity, place.angular_velocity) if valued is not None]
        swinging = any(
            start.robot == subject.partition(".")[0] and start.velocity is not None for start in self.book.program.reset.joint_starts
        )
        if not moved and (body is not None or not swinging):
            return NEVER
        if body is None or (way == "velocity" and any(place.angular_velocity is not None for place in places)):
            return None
        given = [place.velocity if way == "velocity" else place.angular_velocity for place in places]
        trees = [() if value is None else value.scalars for value in given]
        return hull([self.of(parts[axis if len(parts) > 1 else 0]) if parts else NEVER for parts in trees])

    def _places(self, body: str) -> Iterator[Placement]:
        reset = self.book.program.reset
        placements = (*reset.placements, *(place for layout in reset.layouts for place in layout.placements))
        return (place for place in placements if place.body == body)

    def poses(self, body: str) -> Iterator[tuple[Placement, dict[str, Interval]]]:
        """Each way in which a body or the copies of a group are put, before the world settles: x, y, z in m, roll, pitch, yaw in rad.

        The z of what rests on the ground is anything.
        """
        for place in self._places(body.partition("#")[0]):
            yield place, {key: self._coordinate(place, key) for key in (*_PLANE, "z", *_TURNS)}

    def _coordinate(self, place: Placement, key: str) -> Interval:
        if key == "z" and isinstance(place.spot, Top):
            return EVERYTHING
        if key in _PLANE and place.spot is not None:
            axis = _PLANE.index(key)
            region = place.spot.region if isinstance(place.spot, Top) else place.spot
            if region is None:
                return EVERYTHING
            if isinstance(region, Region):
                return Interval(region.low[axis], region.high[axis])
            return hull([exact(spot[axis]) for spot in region.spots])
        coordinate = place.coordinates.get(key)
        if coordinate is None:
            return EVERYTHING if key == "z" and place.rests else exact(0.0)
        return self.of(coordinate.scalar)

    def _attitude(self, place: Placement) -> tuple[Interval, ...]:
        """The quaternion of a body turned by roll, pitch and yaw, about fixed axes in this order."""
        halves = [iv.multiply(self._coordinate(place, key), exact(0.5)) for key in _TURNS]
        halves[2] = iv.add(halves[2], exact(place.heading / 2))
        (cr, cp, cy), (sr, sp, sy) = [_through(cos, half) for half in halves], [_through(sin, half) for half in halves]
        return (
            iv.subtract(_product(sr, cp, cy), _product(cr, sp, sy)),
            iv.add(_product(cr, sp, cy), _product(sr, cp, sy)),
            iv.subtract(_product(cr, cp, sy), _product(sr, sp, cy)),
            iv.add(_product(cr, cp, cy), _product(sr, sp, sy)),
        )

    def _state(self, node: State) -> Interval:
        args = [self.of(arg) for arg in node.args]
        match node.function:
            case "delta" | "integral" | "duration" | "rising":
                return NEVER
            case "previous":
                return args[-1]
            case "accumulate":
                return args[3]
            case _:
                return args[0]


def is_level(pose: Mapping[str, Interval]) -> bool:
    """Whether a pose, as from `AtStart.poses`, is neither rolled nor pitched."""
    return pose["roll"] == pose["pitch"] == exact(0.0)


def _through(function: object, angle: Interval) -> Interval:
    return iv.cosine(angle) if function is cos else iv.sine(angle)


def _product(a: Interval, b: Interval, c: Interval) -> Interval:
    return iv.multiply(iv.multiply(a, b), c)
