"""The exceptions that deepbots raises, as a tree.

    DeepbotsError               a problem that the user can fix; the command line prints its message
    ├── ScenarioError           a scenario has findings at error level; carries them
    ├── UsageError              wrong arguments, a missing file, an unknown engine (exit code 2)
    │   ├── BatchError          the scenario cannot run in a batch of worlds
    │   ├── MissingExtraError   an optional dependency is not installed
    │   └── RunError            a run directory cannot be used: missing, damaged, or of another version
    │       └── StorageError    a file cannot be written: the disk is full, or read-only
    ├── MessageError            a message between robot and supervisor does not have the expected layout
    ├── EvaluationError         an expression has no value in the present state of the world
    │   └── EndsAtResetError    an ending is already true when an episode begins
    ├── PluginError             the code of a callback or logger of another package failed
    └── EngineError             the physics failed: a pose is not finite, a body cannot be loaded

Any other exception that reaches the user is a bug of deepbots.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from deepbots_cli.installation import install_hint

if TYPE_CHECKING:
    from collections.abc import Sequence

    from deepbots_cli.diagnostics import Finding


class DeepbotsError(Exception):
    """A problem that the user can solve; its message says how."""

    @property
    def full_message(self) -> str:
        """The message with its notes (`add_note`), each in a line of its own."""
        return "\n".join([str(self), *getattr(self, "__notes__", ())])

    def __reduce__(self) -> tuple[Any, ...]:
        """Support `pickle`, which would otherwise call the constructor of the subclass with the message."""
        return _restored, (type(self), *self.args), self.__dict__


def _restored(kind: type[DeepbotsError], *arguments: object) -> DeepbotsError:
    return kind.__new__(kind, *arguments)


class ScenarioError(DeepbotsError):
    """A scenario cannot be compiled; `findings` lists every problem."""

    def __init__(self, findings: Sequence[Finding]) -> None:
        self.findings = tuple(findings)
        errors = [f for f in self.findings if f.severity == "error"]
        first = errors[0] if errors else self.findings[0]
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        super().__init__(f"{first.span.location}: {first.code} {first.headline}{more}")


class UsageError(DeepbotsError):
    """The request itself cannot be met: wrong arguments, a missing file, not a run."""


class BatchError(UsageError):
    """The scenario cannot run in a batch of worlds; the message says why."""


class MissingExtraError(UsageError):
    """An optional dependency is needed for this and is not installed."""

    def __init__(self, extra: str, purpose: str) -> None:
        self.extra = extra
        super().__init__(f"{purpose} needs the '{extra}' extra; {install_hint(extra)}")


class RunError(UsageError):
    """A run directory cannot be used for what was asked."""


class StorageError(RunError):
    """A file cannot be written, because the disk is full, for example: other trainings in this place would
    fail too."""


class MessageError(DeepbotsError):
    """A message between robot and supervisor does not fit its layout; names robot, step and field."""


class EvaluationError(DeepbotsError):
    """An expression of the scenario has no value in the present state of the world; shows the line."""


class EndsAtResetError(EvaluationError):
    """An ending is already true when an episode begins; names it."""


class PluginError(DeepbotsError):
    """The code of a callback or a logger of another package failed; names it and the line."""


class EngineError(DeepbotsError):
    """The physics engine failed; names the body and the simulated time where known."""
