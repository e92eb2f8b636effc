"""How benchmarks repeat what they measure, and how they say what came out."""

from __future__ import annotations

import argparse
import gc
import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from statistics import median


@dataclass(frozen=True)
class Row:
    """One figure against its bar. `met` says whether it is on the right side of it; None where no bar is
    set."""

    what: str
    measured: float
    unit: str
    bar: float | None = None
    at_least: bool = False

    @property
    def met(self) -> bool | None:
        if self.bar is None:
            return None
        return bool(
            self.measured >= self.bar if self.at_least else self.measured <= self.bar
        )  # numpy has truth values of its own

    @property
    def bar_words(self) -> str:
        return (
            ""
            if self.bar is None
            else f"{'at least' if self.at_least else 'at most'} {self.bar:g} {self.unit}"
        )

    @property
    def verdict(self) -> str:
        return {None: "", True: "yes", False: "NO"}[self.met]


def options(description: str | None, *, parts: Iterable[str] = (), **counts: int) -> argparse.Namespace:
    """`--json`, the counts, each with its default, and the names of the `parts` to measure, by default
    all."""
    parser = argparse.ArgumentParser(description=(description or "").partition("\n")[0])
    names = list(parts)
    if names:
        words = f"of {', '.join(names)}; by default all"
        parser.add_argument("parts", nargs="*", metavar="PART", help=words)
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    for name, default in counts.items():
        parser.add_argument(f"--{name}", type=int, default=default, help=f"by default {default}")
    arguments = parser.parse_args()
    if names:
        unknown = [name for name in arguments.parts if name not in names]
        if unknown:
            parser.error(f"there is no part {unknown[0]}; the parts are {', '.join(names)}")
        arguments.parts = arguments.parts or names
    return arguments


def show(rows: Iterable[Row], *, as_json: bool) -> None:
    rows = list(rows)
    if as_json:
        shown = [
            {**asdict(row), "met": row.met, "bar_words": row.bar_words, "verdict": row.verdict}
            for row in rows
        ]
        print(json.dumps(shown, indent=2))
        return
    width = max(len(row.what) for row in rows)
    print(f"{'what':<{width}}  {'bar':>16}  {'measured':>16}  met")
    for row in rows:
        print(f"{row.what:<{width}}  {row.bar_words:>16}  {row.measured:>11.3f} {row.unit:<4}  {row.verdict}")


def pairs(first: Callable[[], float], second: Callable[[], float], count: int) -> list[tuple[float, float]]:
    """What both measure, `count` times in turn, with the garbage collector off; each begins every other pair.

    A machine that is busy now and then slows both sides of a pair alike, so that their ratio says more than
    their times.
    """
    first(), second()  # caches and clocks warm up
    gc.collect()
    gc.disable()
    try:
        measured = []
        for index in range(count):
            if index % 2:
                b = second()
                measured.append((first(), b))
            else:
                a = first()
                measured.append((a, second()))
        return measured
    finally:
        gc.enable()


def ratio(measured: list[tuple[float, float]]) -> float:
    """The median of the ratios of the pairs."""
    return median(a / b for a, b in measured)


def difference(measured: list[tuple[float, float]]) -> float:
    """The median of the differences of the pairs."""
    return median(a - b for a, b in measured)
