"""Hand-written policies: they decide what the agent decides, and remember nothing."""

from __future__ import annotations

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.compiler.emit.guard.expressions import nodes
from deepbots_cli.expressions.scalar import Draw, State
from deepbots_cli.ir import MOST_CONDITIONS, Aim, Choices, CompiledScenario, Interval, Pick

_LEAST, _MOST = 1e-300, 1e300


def require_scripts(scenario: CompiledScenario) -> None:
    """Each decides every part of the action, by options that there are and as many values as there are components."""
    names = [script.name for script in scenario.scripts]
    if len(set(names)) < len(names):
        raise CanonicalError("two scripts share a name")
    for script in scenario.scripts:
        if len(script.parts) != len(scenario.action) or not all(map(_decides, script.parts, scenario.action)):
            raise CanonicalError(f"'{script.name[:40]}' is no script for this action")
        if any(isinstance(node, State | Draw) for node in nodes(script)):
            raise CanonicalError(f"the script '{script.name[:40]}' has a memory")


def _decides(decided: Pick | Aim, part: Choices | Interval) -> bool:
    match decided, part:
        case Pick(), Choices():
            known = {option.name for option in part.options}
            count = len(decided.conditions)
            return count <= MOST_CONDITIONS and count + 1 == len(decided.options) and known.issuperset(decided.options)
        case Aim(), Interval():
            return len(decided.values) == max(1, len(part.components)) and _LEAST < part.high - part.low < _MOST
        case _:
            return False
