"""DB711 and DB810: what an episode is worth: the same for all policies, or not what is asked for."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding, Span
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.intervals import INF, Interval
from deepbots_cli.lint.payments import payments_of, versions
from deepbots_cli.lint.reach import reach_of
from deepbots_cli.program import Program

_ROUNDING = 1e-9


def nothing_to_learn(checked: Checked) -> Iterator[Finding]:
    """DB711: every episode is worth the same, whatever the policy does.

    The reward is the same in every step and no ending makes an episode shorter, so that no action is better than another. A constant
    such as `alive: 1` pays for lasting, where a failure ends the episode; a constant cost such as `time: -1` pays for being quick,
    where a success does. Scenarios without `train` are not meant.

    Example::

        reward: {alive: 1}
        remove: [termination, parameters.fall_angle, parameters.track]

    Instead::

        reward: {alive: 1}
        termination: {failure: {fallen: abs(cart.pole_angle) > fall_angle}}
    """
    if checked.program is None or checked.program.training is None or not all(_worth(program).single for program in versions(checked)):
        return
    worth = _worth(checked.program).low
    headline = f"every episode is worth {worth:.4g}, whatever the policy does"
    help = "pay for the goal, as `1 when goal_reached` does" if checked.program.goal else "pay for what the policy shall do"
    if worth > 0.0:
        help += ", or let a failure end a bad episode early"
    elif worth < 0.0:  # a failure would end the costs (DB705)
        help += ", or let a success end a good episode early"
    yield Finding("DB711", checked.program.reward[0].span, headline, help=help)


def return_out_of_reach(checked: Checked) -> Iterator[Finding]:
    """DB810: a mean return is asked for that no episode can be worth, or that every episode is.

    Training then never stops before its last step and nothing counts as solved, or all of it does at once; a stage of a curriculum
    goes on for ever, or is over as it begins. An episode is worth what its steps pay, by intervals, and what its end does: 200 steps
    of `alive: 1` come to 200.

    Example::

        solved: {mean_return: 500, episodes: 100}

    Instead::

        solved: {mean_return: 195, episodes: 100}
    """
    if checked.program is None:
        return
    for program, wanted, path in _wanted(checked.program):
        known = _worth(program)
        if wanted > known.high + _ROUNDING * abs(known.high):
            headline, help = f"no episode is worth {wanted:g}: it comes to {known.high:.4g} at most", "ask for less"
            yield Finding("DB810", _span(checked, path), headline, help=help)
        elif wanted <= known.low:
            headline, help = f"every episode is worth {wanted:g}: it comes to {known.low:.4g} at least", "ask for more"
            yield Finding("DB810", _span(checked, path), headline, help=help)


def _span(checked: Checked, path: Path) -> Span:
    assert checked.namespace is not None  # there is a task
    return checked.namespace.values.span(path)


def _wanted(program: Program) -> Iterator[tuple[Program, float, Path]]:
    """The mean returns that are asked for, each with the task that it is asked of and its place."""
    if program.solved is not None and program.solved.mean_return is not None:
        yield program, program.solved.mean_return, ("solved", "mean_return")
    for place, stage in enumerate(program.curriculum):
        if stage.until is not None and stage.until.metric == "mean_return":
            yield stage.program, stage.until.threshold, ("curriculum", place, "until")


def _worth(program: Program) -> Interval:
    """Of an episode, by the least and the most that a step and an end can pay; infinite where that is not known."""
    payments = payments_of(program)
    terms = list(payments.terms)
    if not payments.is_whole:
        return Interval(-INF, INF)
    step = payments.total(terms, payments.running())
    end = payments.total(terms, reach_of(payments.book, (1.0, float(payments.book.last))))  # whichever endings hold, several at once too
    ticks = payments.book.last * program.agent.repeat - 1
    fewest = 0 if program.endings else ticks
    best = step.high * (ticks if step.high > 0.0 else fewest) + end.high if step.high < INF else INF
    least = step.low * (ticks if step.low < 0.0 else fewest) + end.low if step.low > -INF else -INF
    return Interval(least, best)


RULES = (nothing_to_learn, return_out_of_reach)
