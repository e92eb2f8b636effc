"""A lint rule."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.diagnostics import Finding, Rule


def short_episodes(checked: CheckedScenario) -> Iterator[Finding]:
    """Episodes of fewer than ten steps."""
    program = checked.program
    if program is not None and program.truncation.max_steps is not None and program.truncation.max_steps < 10:
        span = checked.namespace.values.span(("truncation", "max_steps"))
        yield Finding(
            "ACME1", span, f"episodes of {program.truncation.max_steps} steps", help="write at least 10"
        )


ABOUT = """\
Episodes of fewer than ten steps teach little.

Most of them is the reset.
"""
SHORT_EPISODES = Rule(
    "ACME1",
    "short-episodes",
    "warning",
    "episodes of fewer than ten steps",
    check=short_episodes,
    about=ABOUT,
    example="truncation: {max_steps: 5}",
    instead="truncation: {max_steps: 500}",
)
