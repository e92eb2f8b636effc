"""What touches what, how hard, and how far apart surfaces are."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from math import inf
from typing import TYPE_CHECKING

from deepbots_cli.engines.pybullet.library import pybullet as p

if TYPE_CHECKING:
    from deepbots_cli.port import ContactReader, ForceReader, GapReader

ANY = -2  # PyBullet's number for all links of a body
FAR = 1e6  # m; the distance between surfaces is asked for up to here
Place = tuple[int, int]
"""The number of a body and that of a link, or `ANY`."""


class Watch:
    """The links of one body that touched something since the last `forget`, each with what it touched.

    One query per body and engine step, however many readers there are: on four wheels 4 us.
    """

    def __init__(self, client: int, body: int) -> None:
        self._read = partial(p.getContactPoints, body, -1, ANY, ANY, client)
        self._touched: set[tuple[int, int, int]] = set()
        self.forget: Callable[[], None] = self._touched.clear

    def look(self) -> None:
        """A pair is listed while it is near; it touches if its surfaces overlap, or if it took a force to keep them from it."""
        for point in self._read():
            if point[9] > 0.0 or point[8] <= 0.0:
                self._touched.add((point[3], point[2], point[4]))

    def of_some(self, link: int, others: Collection[Place]) -> ContactReader:
        """Whether the link touched one of `others`."""
        touched, known = self._touched, frozenset(others)

        def read() -> bool:
            return any(
                (link in (ANY, own)) and ((other, other_link) in known or (other, ANY) in known) for own, other, other_link in touched
            )

        return read

    def of_all_but(self, link: int, without: Collection[int]) -> ContactReader:
        """Whether the link touched anything but the bodies `without`."""
        touched, left_out = self._touched, frozenset(without)

        def read() -> bool:
            return any((link in (ANY, own)) and other not in left_out for own, other, _ in touched)

        return read


def force(client: int, body: int, link: int) -> ForceReader:
    read = partial(p.getContactPoints, body, -1, link, ANY, client)
    return lambda: sum(point[9] for point in read())


def gap(client: int, one: Place, other: Place) -> GapReader:
    read = partial(p.getClosestPoints, one[0], other[0], FAR, one[1], other[1], physicsClientId=client)

    def distance() -> float:
        return max(0.0, min((point[8] for point in read()), default=inf))

    return distance
