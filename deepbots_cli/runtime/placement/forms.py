"""What each body covers of the ground and how high it rests, in the form that it has in this episode."""

from __future__ import annotations

from math import inf

from deepbots_cli import footprint
from deepbots_cli.footprint import Footprint, Patch
from deepbots_cli.frames import Triple
from deepbots_cli.program.world import ObjectBody, Variant, WorldModel
from deepbots_cli.robots.model import Shape
from deepbots_cli.runtime.streams import Streams

LEVEL = (0.0, 0.0, 0.0)


class Forms:
    """`chosen` holds the variant of each body that may be of several kinds."""

    def __init__(self, world: WorldModel) -> None:
        self.models = {robot.name: robot.model for robot in world.robots}
        self.things: dict[str, ObjectBody] = {thing.name: thing for thing in world.objects}
        self.chosen: dict[str, Variant] = {}
        self._robots = {name: footprint.of_robot(model) for name, model in self.models.items()}
        self._widths = {name: footprint.half_width(model) for name, model in self.models.items()}
        shapes = [thing.shape for thing in world.objects]
        shapes += [variant.shape for thing in world.objects for variant in thing.variants]
        self._upright = {shape: footprint.of_shape(shape) for shape in shapes}

    def draw(self, body: str, streams: Streams) -> None:
        """Draw the kind of a body anew; one that is of one kind stays."""
        variants = self.things[body].variants if body in self.things else ()
        if variants:
            stream = streams[f"objects.{body.partition('#')[0]}.one_of"]
            self.chosen[body] = variants[int(stream.integers(len(variants)))]

    def is_fixed(self, body: str) -> bool:
        """Whether it will never move."""
        return body in self.things and (self.chosen.get(body) or self.things[body]).fixed

    def shape(self, body: str) -> Shape:
        """Of an object."""
        return (self.chosen.get(body) or self.things[body]).shape

    def footprint(self, body: str, rpy: Triple = LEVEL) -> Footprint:
        """What it covers with this attitude; a robot with any."""
        known = self._robots.get(body)
        if known is not None:
            return known
        shape = self.shape(body)
        return self._upright[shape] if rpy[0] == rpy[1] == 0.0 else footprint.of_shape(shape, rpy[0], rpy[1])

    def half_width(self, body: str) -> float:
        """Of the narrowest passage that it fits through, m."""
        return self._widths[body] if body in self._widths else self.footprint(body).narrowest

    def resting(self, body: str, rpy: Triple) -> float:
        """The height (m) of its origin where it rests on flat ground."""
        return footprint.resting(self.models.get(body) or self.shape(body), rpy[0], rpy[1])

    def top(self, body: str, z: float, rpy: Triple) -> float:
        """How high an object reaches whose origin is at `z`; infinite for a robot."""
        return z + footprint.resting(self.shape(body), rpy[0], rpy[1]) if body in self.things else inf

    def top_at_home(self, body: str) -> float:
        """How high an object reaches that stands where the world model has it."""
        pose = self.things[body].pose
        return self.top(body, pose.xyz[2], pose.rpy)

    def at_home(self, body: str) -> Patch:
        """What an object covers that stands where the world model has it."""
        (x, y, _), rpy = self.things[body].pose.xyz, self.things[body].pose.rpy
        return self.footprint(body, rpy).at(x, y, rpy[2])
