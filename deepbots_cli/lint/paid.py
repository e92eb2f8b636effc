"""What is paid in episodes, the codes DB702, DB704, DB707 and DB708."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.intervals import INF, absolute
from deepbots_cli.expressions.scalar import State, walk
from deepbots_cli.expressions.types import Reference, Typed, children
from deepbots_cli.lint.blame import blamed
from deepbots_cli.lint.meaning import Book
from deepbots_cli.lint.payments import Payments
from deepbots_cli.lint.plan import IDLE
from deepbots_cli.lint.probed import Probed
from deepbots_cli.lint.report import Played
from deepbots_cli.lint.reward import horizon, is_turned_down
from deepbots_cli.program.task import Ending
from deepbots_cli.program.values import Expression

_DWARFED = 100.0
_FEW = 200
"""Steps; of fewer nothing is concluded."""
_MEMORIES = frozenset({"delta", "previous", "running_min", "running_max", "accumulate", "rising", "hold"})
"""What pays for getting somewhere, and so pays nothing to who stays."""


def non_finite_reward(probed: Probed) -> Iterator[Finding]:
    """DB707: the reward has no value, or none that is finite."""
    found = blamed(probed)
    if found is not None and found.section == "reward":
        help = "keep it away from zero, as `1 / max(x, 1 cm)` does, and from overflow, as `exp(min(x, 3))`"
        yield Finding("DB707", found.span, f"`{found.name}` is not finite", help=help, notes=found.notes)


def term_dominates(probed: Probed) -> Iterator[Finding]:
    """DB702: under every policy a term adds up to more than a hundred times all others, what endings pay among them."""
    if not probed.report.whole or not probed.measured:
        return
    prize = _prize(Payments(probed.program))
    for term, rows in probed.paid():
        ratios, notes = [], []
        for by, row in rows.items():
            episodes = max(1, sum(played.by == by for played in probed.report.played))
            others = sum(other[by].size for name, other in probed.paid() if name is not term) / episodes
            size, rival = row.size / episodes, max(others, prize)
            ratios.append(size / rival if rival > 0.0 and row.least < row.most else 0.0)
            notes.append(f"{by}: {size:.3g} in an episode, all others {others:.3g}" + (f", an ending {prize:.3g}" if prize else ""))
        if min(ratios) > _DWARFED:
            headline = f"`{term.name}` adds up to {min(ratios):.3g} times all other terms together, or more"
            yield Finding("DB702", term.span, headline, help=f"scale `{term.name}` down, or the others up", notes=tuple(notes))


def _prize(payments: Payments) -> float:
    """The most that an ending pays; 0 where that is not known."""
    _, final = payments.split()
    prizes = [absolute(payments.total(final, payments.at(ending))).high for ending in (*payments.program.endings, None)]
    most = max(prizes, default=0.0)
    return most if most < INF else 0.0


def inactive_term(probed: Probed) -> Iterator[Finding]:
    """DB704: a term was 0 in every step, though nothing is asked before it is paid.

    One with a condition may wait for what chance and scripts do not come to, such as a collision.
    """
    steps = sum(found.steps for found in probed.measured.values())
    if not probed.report.whole or steps < _FEW:
        return
    payments = Payments(probed.program)
    final = {term.name for term, _ in payments.split()[1]}
    for place, term in enumerate(probed.program.reward):
        if place not in probed.report.silent or term.name in final or term.foreign is not None:
            continue
        if not is_turned_down(term.typed, payments.book) and not _asks(term.typed, payments.book, set()):
            headline = f"`{term.name}` was zero in all {steps} steps that were simulated"
            help = "mend its condition, or add a script that is paid it under `scripts`"
            yield Finding("DB704", term.span, headline, help=help, notes=(probed.looked,))


def _asks(node: Typed, book: Book, met: set[str]) -> bool:
    """Whether a value depends on a condition, by whatever names."""
    if node.type.boolean:
        return True
    if isinstance(node, Reference) and node.symbol.name not in met:
        met.add(node.symbol.name)
        meant = book.named(node.symbol.name)
        return meant is not None and (meant.foreign is not None or _asks(meant.typed, book, met))
    return any(_asks(part, book, met) for part in children(node))


# What pays


def hovering_pays(probed: Probed) -> Iterator[Finding]:
    """DB708: to do something else for a whole episode is worth more than the success that was seen, or that could be."""
    successes = [ending for ending in probed.program.endings if ending.outcome == "success"]
    if not successes or not probed.report.whole:
        return
    found = _beaten(probed)
    if found:
        best, worst = found
        also = (Label(successes[0].value.span, "ends what pays"),)
        headline = f"{best.by} to the time limit is worth {best.worth:.3g}, and the success by {worst.by} {worst.worth:.3g}"
        notes = (f"discounted returns, both in the episode with seed {best.seed}",)
        help = "pay for coming nearer, as `-10 * delta(distance) / m` does, or let the success pay more than the steps that it ends"
        yield Finding("DB708", _dearest(probed, best.by).span, headline, help=help, notes=notes, also=also)
    elif len(successes) == 1 and not any(played.end == "success" for played in probed.report.played):
        yield from _idle(probed, successes[0])


def _beaten(probed: Probed) -> tuple[Played, Played] | None:
    """Of all seeds with an episode of either kind: the best that went on to its limit, and the best success, if that is worth less."""
    pairs = []
    for seed in sorted({played.seed for played in probed.report.played}):
        lasting = [played for played in probed.report.played if played.seed == seed and played.end == "limit"]
        reached = [played for played in probed.report.played if played.seed == seed and played.end == "success"]
        if lasting and reached:
            pairs.append((max(lasting, key=lambda played: played.worth), max(reached, key=lambda played: played.worth)))
    return pairs[0] if pairs and all(best.worth > success.worth for best, success in pairs) else None


def _idle(probed: Probed, success: Ending) -> Iterator[Finding]:
    """As the static rule compares: what doing nothing is paid in the steps that count, and what the end pays once."""
    payments = Payments(probed.program)
    row = probed.measured.get(IDLE)
    played = [played for played in probed.report.played if played.by == IDLE]
    ordinary, _ = payments.split()
    if row is None or not payments.is_whole or any(each.end not in ("limit", "left") for each in played):
        return
    if any(isinstance(node, State) and node.function in _MEMORIES for _, tree in ordinary for node in walk(payments.book.meaning(tree))):
        return
    pay = sum(term.total for term in row.terms) / row.steps
    prize = payments.total(list(payments.terms), payments.at(success)).high
    if pay > 0.0 and pay * horizon(payments) > prize:
        headline = f"doing nothing is paid {pay:.3g} in every step, and `{success.value.name}` {prize:.3g} once"
        help = "pay for coming nearer, as `-10 * delta(distance) / m` does, or let the success pay more than the steps that it ends"
        notes = (f"in {row.steps} steps; some {horizon(payments):.0f} steps count, by the discount of the training and the time limit",)
        also = (Label(success.value.span, "ends what pays"),)
        yield Finding("DB708", _dearest(probed, IDLE).span, headline, help=help, notes=notes, also=also)


def _dearest(probed: Probed, by: str) -> Expression:
    """The term that pays most under a policy."""
    return max(probed.paid(), key=lambda entry: entry[1][by].total)[0]


RULES = {"DB702": term_dominates, "DB704": inactive_term, "DB707": non_finite_reward, "DB708": hovering_pays}
