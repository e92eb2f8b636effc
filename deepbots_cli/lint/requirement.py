"""DB812: requirements that drawing again does not help."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.scalar import World
from deepbots_cli.expressions.types import Invocation, Reference, Stage, Typed, children
from deepbots_cli.lint.meaning import book_of
from deepbots_cli.lint.reach import ALWAYS
from deepbots_cli.lint.start import AtStart
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement


def requirement_not_redrawn(checked: Checked) -> Iterator[Finding]:
    """DB812: `reset.require` depends on parameters that are drawn, and on nothing that is drawn again where it does not hold.

    Where a requirement does not hold, the layout, all places and the joints are drawn again. Parameters keep their values for the
    episode, so that all attempts are the same, and the reset breaks off. Draw the parameter so that it fits, or draw under `place`.

    Example::

        parameters: {mark: uniform(-0.3 .. 0.3 m)}
        augment: {left: mark - x}
        observation: {left: -0.8 .. 0.8 m}
        reset: {require: abs(mark) > 10 cm}

    Instead::

        parameters: {side: choice(-1 | 1), mark: side * uniform(0.1 .. 0.3 m)}
        augment: {left: mark - x}
        observation: {left: -0.8 .. 0.8 m}
    """
    if checked.program is None or (require := checked.program.reset.require) is None:
        return
    book = book_of(checked.program)
    (node,) = book.scalars(require)
    drawn = {value.name for value in checked.program.parameters if value.typed.type.stage is not Stage.FIXED}
    facts = [fact for fact in book.unfold(node) if isinstance(fact, World)]
    bodies = {subject.partition(".")[0].partition("#")[0] for fact in facts for subject in fact.subjects}
    placements = [place for place in _placements(checked.program) if place.body in bodies]
    told = sorted((book.told(node) | {name for place in placements for name in _names(place)}) & drawn)
    bent = {subject.partition(".")[0] for fact in facts if not _is_of_root(checked.program, fact) for subject in fact.subjects}
    if told and not _is_drawn_again(checked.program, placements, bent) and AtStart(book).of(node) != ALWAYS:
        headline = f"drawing again does not change what is required: `{told[0]}` is drawn once per episode"
        yield Finding("DB812", require.span, headline, help=f"draw `{told[0]}` so that it fits, or draw places under `reset.place`")


def _is_of_root(program: Program, fact: World) -> bool:
    """Whether it is about the place of an object or of a root link, which no joint moves."""
    roots = {f"{robot.name}.{robot.model.root}" for robot in program.world.robots} | {thing.name for thing in program.world.objects}
    return fact.function in ("position", "orientation") and roots.issuperset(fact.subjects)


def _placements(program: Program) -> list[Placement]:
    reset = program.reset
    return [*reset.placements, *(place for layout in reset.layouts for place in layout.placements)]


def _names(place: Placement) -> Iterator[str]:
    """What its coordinates are made of."""
    waiting = [coordinate.typed for coordinate in place.coordinates.values()]
    while waiting:
        node = waiting.pop()
        if isinstance(node, Reference):
            yield node.symbol.name
        waiting += children(node)


def _is_drawn_again(program: Program, placements: list[Placement], bent: set[str]) -> bool:
    """Whether something is another at the next attempt: the place of a body, the layout, or a joint of a robot that is `bent`."""
    joints = any(start.robot in bent and _draws(start.position.typed) for start in program.reset.joint_starts)
    return joints or any(_moves(place) for place in placements) or (bool(placements) and len(program.reset.layouts) > 1)


def _moves(place: Placement) -> bool:
    coordinates = place.coordinates.values()
    is_drawn = any(_draws(coordinate.typed) for coordinate in coordinates)
    return is_drawn or place.spot is not None or place.at_most is not None


def _draws(node: Typed) -> bool:
    is_draw = isinstance(node, Invocation) and FUNCTIONS[node.function].family is Family.DRAW
    return is_draw or any(_draws(part) for part in children(node))


RULES = (requirement_not_redrawn,)
