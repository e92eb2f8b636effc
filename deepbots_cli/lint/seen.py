"""What the policy sees in episodes, the codes DB607, DB608 and DB611."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from deepbots_cli.diagnostics import Finding
from deepbots_cli.lint.blame import blamed
from deepbots_cli.lint.meaning import Book
from deepbots_cli.lint.probed import Number, Probed
from deepbots_cli.lint.reach import Reach
from deepbots_cli.lint.wording import figure

_OFTEN = 0.5
"""Share of the steps of every policy."""
_FEW = 100
"""Steps; of fewer nothing is concluded."""
_ROUNDING = 1e-6
"""As a share of a range."""


def observation_outside_space(probed: Probed) -> Iterator[Finding]:
    """DB607: a number of the observation is none, or is outside of what its space allows."""
    stop = probed.report.stop or {}
    if stop.get("kind") == "space":
        for entry in probed.program.observation:
            names = [name for name in map(str, stop["entries"]) if name.partition(".")[0] == entry.value.name or name == entry.value.name]
            if names:
                headline = f"`{names[0]}` is outside of the observation space"
                yield Finding("DB607", entry.value.span, headline, help="`clamp` it, or let it be clipped", notes=(probed.when(),))
    found = blamed(probed)
    if found is not None and found.section == "observation":
        help = "keep it defined everywhere, as `x / max(y, 1 cm)` does"
        yield Finding("DB607", found.span, f"`{found.name}`, which the policy sees, has no value", help=help, notes=found.notes)


def constant_observation(probed: Probed) -> Iterator[Finding]:
    """DB608: a number was the same in every step. One at an end of its range is left alone: a sonar may just have met nothing."""
    if not probed.report.whole or _steps(probed) < _FEW:
        return
    still = [number for number in probed.numbers if number.place in probed.report.still and not number.entry.value.typed.type.boolean]
    still = [number for number in still if -1.0 < _value(probed, number) < 1.0]
    for _, group in groupby(still, key=lambda number: number.entry.value.name):
        numbers = list(group)
        entry, parts = numbers[0].entry, max(1, len(numbers[0].entry.value.components))
        name = entry.value.name if len(numbers) == parts > 1 else ", ".join(number.name for number in numbers)
        whole = len(numbers) == parts
        value = figure(_real(probed, numbers[0]), entry.value.typed.type.dimension)
        headline = f"`{name}` never changes" + (f": it is {value} in every step" if len(numbers) == 1 else "")
        help = ("take it out" if whole else "show the other components alone") + ", or add a script that changes it under `scripts`"
        yield Finding("DB608", entry.value.span, headline, help=help, notes=(probed.looked,))
    pictures = [entry for entry in probed.program.observation if entry.value.typed.type.picture]
    for place, entry in enumerate(pictures, start=len(probed.numbers)):
        if place in probed.report.still:
            help = "look at where its camera stands and what it sees, or add a script that changes it under `scripts`"
            yield Finding("DB608", entry.value.span, f"the picture `{entry.value.name}` never changes", help=help, notes=(probed.looked,))


def observation_saturates(probed: Probed) -> Iterator[Finding]:
    """DB611: under every policy a number is at the same end of its range most of the time, and could lie beyond."""
    if not probed.report.whole or _steps(probed) < _FEW:
        return
    book = Book(probed.program)
    reach, met = Reach(book), set()
    for number in probed.numbers:
        entry = number.entry
        if not entry.clip or entry.value.typed.type.boolean or id(entry) in met:
            continue
        known = reach.of(book.scalars(entry.value)[number.component])
        low, high = entry.low[number.component], entry.high[number.component]
        slack = _ROUNDING * (high - low)
        for above, is_beyond in ((True, known.high > high + slack), (False, known.low < low - slack)):
            shares = {
                by: (row.seen[number.place].at_high if above else row.seen[number.place].at_low) / row.rows
                for by, row in probed.measured.items()
            }
            if is_beyond and min(shares.values()) >= _OFTEN:
                met.add(id(entry))
                end = figure(high if above else low, entry.value.typed.type.dimension)
                headline = f"`{number.name}` is at the end of its range, {end}, in at least {100 * min(shares.values()):.0f} % of all steps"
                notes = tuple(f"{100 * share:.0f} % of the steps of {by}" for by, share in shares.items())
                yield Finding(
                    "DB611", probed.range_span(entry), headline, help="widen its range, until it holds what is ordinary", notes=notes
                )
                break


def _steps(probed: Probed) -> int:
    return sum(found.steps for found in probed.measured.values())


def _value(probed: Probed, number: Number) -> float:
    """What it always was, from -1 to 1."""
    return next(iter(probed.measured.values())).seen[number.place].low


def _real(probed: Probed, number: Number) -> float:
    low, high = number.entry.low[number.component], number.entry.high[number.component]
    value = low + (_value(probed, number) + 1.0) / 2.0 * (high - low)
    return value if abs(value) > _ROUNDING * (high - low) else 0.0


RULES = {"DB607": observation_outside_space, "DB608": constant_observation, "DB611": observation_saturates}
