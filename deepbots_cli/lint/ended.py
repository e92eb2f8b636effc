"""How episodes end that should have begun, the codes DB806 and DB808."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.diagnostics import Finding
from deepbots_cli.lint.blame import blamed
from deepbots_cli.lint.probed import Probed

_SHOWN = 8


def ends_at_reset(probed: Probed) -> Iterator[Finding]:
    """DB806: an ending holds when an episode begins, with some seeds at least."""
    for ending in probed.program.endings:
        seeds = probed.report.early.get(ending.value.name, [])
        if seeds:
            headline = f"`{ending.value.name}` already holds at the start of {len(seeds)} of {probed.plan.resets} episodes"
            more = ", ..." if len(seeds) > _SHOWN else ""
            notes = (f"with seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds[:_SHOWN]))}{more}",)
            help = "let the episode begin clear of it, under `reset`, or widen it"
            yield Finding("DB806", ending.value.span, headline, help=help, notes=notes)


def breaks_off(probed: Probed) -> Iterator[Finding]:
    """DB808: an episode cannot begin or go on, for a reason that no other code tells."""
    stop = probed.report.stop or {}
    if stop.get("kind") != "value":
        return
    found = blamed(probed)
    if found is not None and found.section == "other":
        help = "keep it defined everywhere, as `x / max(y, 1 cm)` does"
        yield Finding("DB808", found.span, f"`{found.name}` has no value", help=help, notes=found.notes)
    elif found is None:
        span = probed.key(("reset",) if probed.report.where.doing == "reset" else ("robots",))
        yield Finding("DB808", span, "an episode breaks off", notes=(probed.when(), str(stop.get("text", ""))))


RULES = {"DB806": ends_at_reset, "DB808": breaks_off}
