"""What a training that is not solved changed since an earlier one that was: a fact, and no proven cause."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deepbots_cli.document.files import display_path
from deepbots_cli.document.nodes import follow_dotted
from deepbots_cli.insight.statements import Numbers, list_text, statement
from deepbots_cli.insight.training import TrainingEvidence
from deepbots_cli.learning.runs.verdict import SEED, ChangedValue

_MAX_SHOWN = 4
_LIKELIHOOD = 0.89
"""The likelihood that orders this fact: after certain causes (0.9), and before all others."""


@statement(
    "changed_since_solved",
    "Changed since {earlier}, which was solved: {changed}.",
    advice="Set {them} back and train again: the task is solved once more if this value is the reason. To"
    " keep a value, adapt what depends on it, such as endings, ranges of the observation, or the length of"
    " the training.",
)
def changed_since_solved(evidence: TrainingEvidence) -> Numbers | None:
    if evidence.verdict.solved:
        return None
    if evidence.earlier_solved is None:
        return None
    earlier, values = evidence.earlier_solved
    if all(value.path == SEED for value in values):
        return None
    changes = [_change(value, evidence) for value in values]
    return {
        "likelihood": _LIKELIHOOD,
        "earlier": display_path(earlier.path),
        "changed": list_text(
            [_text(change, value) for change, value in zip(changes, values, strict=True)], _MAX_SHOWN
        ),
        "changes": changes,
        "them": "one of them" if len(changes) > 1 else "it",
    }


def _change(value: ChangedValue, evidence: TrainingEvidence) -> dict[str, Any]:
    """Return a changed value as JSON; `place` is its file and line."""
    root = evidence.linted.root
    _, node, unresolved = follow_dotted(root, value.path) if root is not None else ((), None, value.path)
    location = ""
    if node is not None and not unresolved:
        location = f"{display_path(Path(node.span.source.name))}:{node.span.start_position.line}"
    return {
        "path": value.path,
        "before": value.before,
        "after": value.after,
        **({"place": location} if location else {}),
        "is_written": value.is_written,
    }


def _text(change: dict[str, Any], value: ChangedValue) -> str:
    return f"{value} ({change['place']})" if "place" in change else str(value)
