"""Lint rules: what is allowed but probably not meant.

A rule is a small pure generator that reads a checked scenario and yields findings; it knows no other
rule. What the compiler needs to know anyway, it reports itself.

names.py   definitions that nothing uses
spaces.py  what the policy sees
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.diagnostics import Finding
from deepbots_cli.rules.names import unused_definition, unused_part
from deepbots_cli.rules.spaces import privileged_observation

Rule = Callable[[Checked], Iterator[Finding]]
RULES: tuple[Rule, ...] = (unused_definition, unused_part, privileged_observation)


def run(checked: Checked) -> Iterator[Finding]:
    """The findings of all rules; none for a scenario that cannot be understood as a whole."""
    if not checked.findings.errors:
        for rule in RULES:
            yield from rule(checked)
