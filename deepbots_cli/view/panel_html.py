"""The texts of the panel of the page, as HTML. Names come from scenarios, and are escaped."""

from __future__ import annotations

import html
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from statistics import fmean
from typing import Any

from deepbots_cli.view.frames import AgentFrame, FrameLayout, PlottedField, WorldFrame

_MAX_ROWS = 40
_NUMBER = "text-align:right;white-space:nowrap;padding-left:0.6em"


def table(rows: Iterable[str]) -> str:
    content = f"<table style='width:100%;border-spacing:0 1px'>{''.join(rows)}</table>"
    return f"<div style='padding:0 1.2em 0 0.8em;font-size:0.8em'>{content}</div>"


def agent_rows(layout: FrameLayout, agent: AgentFrame) -> Iterator[str]:
    """Yield rows of the reward terms, action and observation; for the log of a robot, of the commands and the
    inputs of the policy."""
    if not layout.of_robot:
        yield _head("reward terms of this step")
        yield from (
            _row(name, f"{value:+.4f}") for name, value in [*agent.terms.items(), ("sum", agent.reward)]
        )
    if agent.action is not None:
        yield _head("commands" if layout.of_robot else "action")
        yield from _limited(_bar(*pair) for pair in zip(layout.action, agent.action, strict=True))
    if agent.allowed:
        options = [f"{entry.name}: {option}" for entry in layout.action for option in entry.options]
        forbidden = [option for option, may in zip(options, agent.allowed, strict=False) if not may]
        yield _row(f"forbidden in the next step: {', '.join(forbidden)}", "")
    yield _head("reported by the robot" if layout.of_robot else "observation")
    yield from _limited(_bar(*pair) for pair in zip(layout.observation, agent.observation, strict=True))


def training_rows(
    stages: Sequence[tuple[str, float]], evaluations: Sequence[Mapping[str, Any]], *, success: bool
) -> Iterator[str]:
    """Yield rows of the stages of a curriculum with the timesteps at their beginning, and of the evaluations
    of a training, the newest first."""
    if stages:
        yield _head("stages of the curriculum, and their first timestep")
        yield from (
            _wide_row(f"{number}. {name}", f"{steps:,.0f}") for number, (name, steps) in enumerate(stages, 1)
        )
    yield _head("evaluations during the training" if evaluations else "no evaluation yet")
    for evaluation in list(reversed(evaluations))[:_MAX_ROWS]:
        stage = f", stage {evaluation['stage']}" if evaluation["stage"] else ""
        rate = f", success {fmean(evaluation['successes']):.0%}" if success else ""
        yield _wide_row(
            f"{evaluation['steps']:,.0f} steps{stage}", f"return {fmean(evaluation['returns']):.4g}{rate}"
        )


def message_rows(layout: FrameLayout, frame: WorldFrame, other_agents: Collection[str]) -> Iterator[str]:
    """Yield rows of the message that each receiver uses, with its age, except for those of the `other_agents`
    among copies of a robot."""
    for key, message in frame.messages.items():
        robot, _, direction = key.partition("/")
        if robot in other_agents:
            continue
        age = f"{1000 * message.age:.0f} ms old{'' if message.received else ', no new message in this step'}"
        yield _head(f"message {'to' if direction == 'to_robot' else 'from'} {robot}: {age}")
        values = zip(layout.messages[key], message.values, strict=True)
        yield from _limited(
            _row(entry.name, "" if value is None else entry.text(value)) for entry, value in values
        )


def _limited(rows: Iterable[str]) -> Iterator[str]:
    """Yield the first rows, and how many more there are."""
    rows = iter(rows)
    yield from islice(rows, _MAX_ROWS)
    left = sum(1 for _ in rows)
    if left:
        yield _row(f"and {left} more, see Plots", "")


def notice(title: str, content_html: str, color: str) -> str:
    """Return a banner. `title` is escaped; `content_html` is inserted as it is."""
    return (
        "<div style='margin:0.4em 0.8em;padding:0.4em 0.7em;border-left:0.35em solid"
        f" {color};background:rgba(128,128,128,0.12)'>"
        f"<b>{html.escape(title)}</b><div style='font-size:0.85em'>{content_html}</div></div>"
    )


def heading(text: str) -> str:
    return f"<div style='padding:0.2em 1em 0;font-size:0.8em;font-weight:600'>{html.escape(text)}</div>"


def hint(text: str) -> str:
    return f"<div style='padding:0.3em 1em;font-size:0.85em'>{html.escape(text)}</div>"


def _head(text: str) -> str:
    return f"<tr><td colspan='3' style='padding-top:0.5em;font-weight:600'>{html.escape(text)}</td></tr>"


def _row(name: str, value: str, bar: str = "") -> str:
    # A long name is broken into lines, so that there is room for the bar.
    parts = html.escape(name).replace(".", ".<wbr>").replace("_", "_<wbr>")
    cells = f"<td style='overflow-wrap:anywhere'>{parts}</td><td style='{_NUMBER}'>{html.escape(value)}</td>"
    return f"<tr>{cells}<td style='width:35%'>{bar}</td></tr>"


def _wide_row(name: str, value: str) -> str:
    """Return a row without a bar, which leaves room for long words."""
    return (
        f"<tr><td>{html.escape(name)}</td><td colspan='2'"
        f" style='text-align:right'>{html.escape(value)}</td></tr>"
    )


def _bar(field: PlottedField, value: float) -> str:
    """Return a number with a mark at its place in its range."""
    share = (value - field.low) / (field.high - field.low) if field.high > field.low else 0.5
    at = 100 * min(1.0, max(0.0, share if math.isfinite(share) else 0.5))
    color = "#0072B2" if -1e-6 <= share <= 1 + 1e-6 else "#D55E00"
    mark = (
        f"<div style='position:absolute;left:calc({at:.0f}% -"
        f" 2px);width:4px;height:0.7em;background:{color}'></div>"
    )
    tip = html.escape(f"{field.text(field.low)} .. {field.text(field.high)}", quote=True)
    rail = (
        f"<div title='{tip}'"
        " style='position:relative;margin-left:0.6em;height:0.7em;background:rgba(128,128,128,0.25)'>"
        f"{mark}</div>"
    )
    return _row(field.name, field.text(value), rail)
