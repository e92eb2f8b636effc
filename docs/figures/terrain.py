"""Two terrains of docs/world.md as nets: the formula of the example there, and the pit of pit_escape."""

from __future__ import annotations

import re
from itertools import pairwise, product
from pathlib import Path

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.document import loads
from deepbots_cli.geometry import ground_height
from deepbots_cli.program import Program
from figures.drawing import Drawing, Point

ROOT = Path(__file__).resolve().parents[2]
WIDTH = 105.0  # pixels of half a side, along each axis


def draw() -> str:
    text = next(
        block
        for block in re.findall(
            r"```yaml fragment\n(.*?)```", (ROOT / "docs" / "world.md").read_text(encoding="utf-8"), re.DOTALL
        )
        if "type: formula" in block
    )
    wavy = api.compile(
        check(loads(f"deepbots: 1\nextends: cartpole\n{text}", base=ROOT / "scenarios"))
    ).program
    drawing = Drawing(640, 260, "Two terrains, one from a formula and one with a pit")
    _net(drawing, (165.0, 130.0), wavy, 2.0, 200.0, (40, 8))
    _net(drawing, (475.0, 150.0), api.compile("pit_escape").program, 6.0, 55.0, (18, 18))
    drawing.text((165.0, 24.0), "type: formula", anchor="middle", code=True)
    drawing.text((475.0, 24.0), "type: pit", anchor="middle", code=True)
    drawing.text((165.0, 250.0), "4 x 4 m, heights exaggerated", "soft", anchor="middle")
    drawing.text((475.0, 250.0), "12 x 12 m, heights exaggerated", "soft", anchor="middle")
    return drawing.svg()


def _net(
    drawing: Drawing, center: Point, program: Program, half: float, scale: float, cells: tuple[int, int]
) -> None:
    """A square with so many cells along x and y, from the far corner to the near one; `scale` in pixels per
    meter of height."""
    height = ground_height(program.world.terrain)
    rows, columns = ([half * (2.0 * number / count - 1.0) for number in range(count + 1)] for count in cells)

    def seen(x: float, y: float) -> Point:
        across, along = 1.25 * WIDTH * (y - x) / (2 * half), 0.62 * WIDTH * (x + y) / (2 * half)
        return center[0] + across, center[1] + along - scale * float(height(x, y))

    for (x, next_x), (y, next_y) in sorted(
        product(pairwise(rows), pairwise(columns)), key=lambda cell: cell[0][0] + cell[1][0]
    ):
        drawing.polygon(
            [seen(x, y), seen(next_x, y), seen(next_x, next_y), seen(x, next_y)], "blue", fill="solid"
        )
    for end, label, color in (((half * 1.25, -half), "x", "orange"), ((-half, half * 1.25), "y", "green")):
        start = (half, -half) if label == "x" else (-half, half)
        drawing.line([seen(*start), seen(*end)], color, arrow=True)
        drawing.text((seen(*end)[0] + (-14 if label == "x" else 6), seen(*end)[1] + 4), label, color)
