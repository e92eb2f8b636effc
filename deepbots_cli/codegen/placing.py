"""Prints how bodies look for a place: a call of the arrangement for each, a loop for the copies of a group."""

from __future__ import annotations

from collections.abc import Sequence

from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.text import quoted, tuple_code
from deepbots_cli.codegen.workspace import Workspace
from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.program.resets import Cells, Group, Placement, Region, Top


def is_sought(place: Placement) -> bool:
    """Whether more than its coordinates decides where the body stands."""
    return place.seeks_height or place.spot is not None


def place_lines(places: Sequence[Placement], space: Workspace, printer: Printer) -> list[str]:
    """The statements of one layout: first what has coordinates, then what stands in cells, then what looks for a spot."""
    groups = {group.name: group for group in space.scenario.reset.groups}
    return [line for place in _ordered(places) for line in _lines(place, groups.get(place.body), printer)]


def _ordered(places: Sequence[Placement]) -> list[Placement]:
    """Places by how they are found, then in file order; a body that stands on another comes after it."""
    ranks = {Region: 2, Top: 2, Cells: 1}
    waiting = sorted(places, key=lambda place: ranks.get(type(place.spot), 0))
    found: list[Placement] = []
    while waiting:
        bodies = {place.body for place in waiting}
        ready = (index for index, place in enumerate(waiting) if not (isinstance(place.spot, Top) and place.spot.of in bodies))
        found.append(waiting.pop(next(ready, 0)))
    return found


def _lines(place: Placement, group: Group | None, printer: Printer) -> list[str]:
    count = printer.value(group.count.scalar) if group else "1"
    body, pad = ("body", "    ") if group else (quoted(place.body), "")
    at_most = "" if place.at_most is None else f", {place.at_most}"
    # A call in the head of a loop could not be cut into lines.
    head = [f"copies = bodies.copies({quoted(place.body)}, {count}{at_most})", "for body in copies:"] if group else []
    match place.spot:
        case Region() | Top() as spot:
            pose = f"lambda: ({_triple(place.xyz, printer)}, {_triple(place.rpy, printer)})"
            region = spot if isinstance(spot, Region) else spot.region
            area = tuple_code([repr(end) for end in (*region.low, *region.high)]) if region else "None"
            options = _options(place, printer) + (f", mesh={spot.mesh!r}" if spot.mesh else "")
            options += f", on={quoted(spot.of)}" if isinstance(spot, Top) else ""
            return [*head, f"{pad}bodies.find({body}, {area}, {quoted(place.stream)}, {pose}{options})"]
        case Cells(spots):
            table = tuple_code([tuple_code([repr(x), repr(y)]) for x, y in spots])
            xyz = tuple_code(["spot[0]", "spot[1]", printer.value(place.xyz[2])])
            return [
                f"spots = {table}",
                f"cells = bodies.cells({quoted(place.body)}, {count}, spots, {quoted(place.stream)})",
                "for body, spot in cells:",
                f"    bodies.stand(body, {xyz}, {_triple(place.rpy, printer)}{_options(place, printer)})",
            ]
        case _:
            spacing = f", spacing={place.spacing!r}" if group and any(place.spacing) else ""
            xyz, rpy = _triple(place.xyz, printer), _triple(place.rpy, printer)
            return [*head, f"{pad}bodies.stand({body}, {xyz}, {rpy}{_options(place, printer)}{spacing})"]


def _options(place: Placement, printer: Printer) -> str:
    parts = [f", {name}={_triple(values, printer)}" for name, values in place.velocities]
    parts += [", rests=True"] if place.seeks_height else []
    parts += [f", clearance={place.clearance!r}"] if place.clearance else []
    return "".join(parts)


def _triple(values: Sequence[Scalar], printer: Printer) -> str:
    return tuple_code([printer.value(value) for value in values])
