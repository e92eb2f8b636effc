"""A drawing in SVG whose colors follow the color scheme of the page."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

Point = tuple[float, float]
_STYLE = """
  svg { color-scheme: light dark; --ink: #1c1e21; --soft: #6b7280; --fill: #e5e7eb; --blue: #1d4ed8; --orange: #c2410c; --green: #15803d; }
  @media (prefers-color-scheme: dark) {
    svg { --ink: #e5e7eb; --soft: #9ca3af; --fill: #374151; --blue: #60a5fa; --orange: #fb923c; --green: #4ade80; }
  }
  text { font: 13px system-ui, sans-serif; fill: var(--ink); }
  .code { font-family: ui-monospace, monospace; font-size: 12px; }
  .line { fill: none; stroke-width: 1.5; }
  .dashed { stroke-dasharray: 5 4; }
  .ink { stroke: var(--ink); } .soft { stroke: var(--soft); } .blue { stroke: var(--blue); }
  .orange { stroke: var(--orange); } .green { stroke: var(--green); }
  text.ink, text.soft, text.blue, text.orange, text.green { stroke: none; }
  text.soft { fill: var(--soft); } text.blue { fill: var(--blue); } text.orange { fill: var(--orange); } text.green { fill: var(--green); }
  .solid { fill: var(--fill); } .solid-blue { fill: var(--blue); } .solid-green { fill: var(--green); }
  .solid-orange { fill: var(--orange); }
  .head-ink { fill: var(--ink); } .head-soft { fill: var(--soft); } .head-blue { fill: var(--blue); }
  .head-orange { fill: var(--orange); } .head-green { fill: var(--green); }
"""


class Drawing:
    """Collects shapes; x goes to the right and y down, in pixels."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self._size = width, height
        self._title = title
        self._parts: list[str] = []
        self._colors: set[str] = set()

    def line(
        self, points: Iterable[Point], color: str = "ink", *, dashed: bool = False, arrow: bool = False
    ) -> None:
        if arrow:
            self._colors.add(color)
        end = f' marker-end="url(#{color})"' if arrow else ""
        self._parts.append(
            f'<polyline class="line {color}{" dashed" * dashed}" points="{_points(points)}"{end}/>'
        )

    def polygon(
        self, points: Iterable[Point], color: str = "ink", *, fill: str = "", dashed: bool = False
    ) -> None:
        style = "" if fill else ' fill="none"'
        self._parts.append(
            f'<polygon class="{color} {fill}{" dashed" * dashed}"{style} stroke-width="1.5"'
            f' points="{_points(points)}"/>'
        )

    def circle(
        self, center: Point, radius: float, color: str = "ink", *, fill: str = "", dashed: bool = False
    ) -> None:
        style = "" if fill else ' fill="none"'
        place = f'cx="{_number(center[0])}" cy="{_number(center[1])}" r="{_number(radius)}"'
        self._parts.append(
            f'<circle class="{color} {fill}{" dashed" * dashed}"{style} stroke-width="1.5" {place}/>'
        )

    def box(
        self, left: float, top: float, width: float, height: float, color: str = "ink", *, fill: str = "solid"
    ) -> None:
        style = "" if fill else ' fill="none"'
        place = (
            f'x="{_number(left)}" y="{_number(top)}" width="{_number(width)}" height="{_number(height)}"'
            ' rx="5"'
        )
        self._parts.append(f'<rect class="{color} {fill}"{style} stroke-width="1.5" {place}/>')

    def text(
        self, place: Point, text: str, color: str = "", *, anchor: str = "start", code: bool = False
    ) -> None:
        style = " ".join(filter(None, [color, "code" if code else ""]))
        name = f' class="{style}"' if style else ""
        at = f'x="{_number(place[0])}" y="{_number(place[1])}" text-anchor="{anchor}"'
        self._parts.append(f"<text{name} {at}>{escape(text)}</text>")

    def svg(self) -> str:
        width, height = self._size
        heads = "".join(
            f'<marker id="{color}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6"'
            ' orient="auto">'
            f'<path class="head-{color}" d="M0 0L8 4L0 8z"/></marker>'
            for color in sorted(self._colors)
        )
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0'
            f' {width} {height}" role="img">'
        )
        parts = [
            head,
            f"<title>{escape(self._title)}</title>",
            f"<style>{_STYLE}</style>",
            f"<defs>{heads}</defs>",
            *self._parts,
            "</svg>",
        ]
        return "\n".join(parts) + "\n"


def _points(points: Iterable[Point]) -> str:
    return " ".join(f"{_number(x)},{_number(y)}" for x, y in points)


def _number(value: float) -> str:
    """To a tenth of a pixel, so that rounding of other machines does not show."""
    return f"{round(value, 1) + 0.0:g}"
