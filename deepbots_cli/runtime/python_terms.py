"""Reward terms and endings that are functions of a user's Python module."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli.errors import EvaluationError, UsageError

if TYPE_CHECKING:
    from deepbots_cli.runtime.supervisor import Supervisor


def python_function(
    noun: str, name: str, module: str, function: str, truth: bool
) -> Callable[[Supervisor], Any]:
    """Return the function of a user's module that computes a reward term or an ending from the supervisor.

    The returned function checks each value: a truth value if `truth`, otherwise a number. `noun` and `name`
    are those of the term or the ending, for messages.

    Raises:
        UsageError: There is no such function, or its module cannot be imported.
    """
    called = f"the {noun} '{name}' in Python ({module}:{function})"
    try:
        imported = getattr(import_module(module), function)
    except Exception as error:  # whatever the module does while it is imported
        raise UsageError(f"{called} cannot be imported: {type(error).__name__}: {error}") from error
    if not callable(imported):
        raise UsageError(f"{called} is not a function")

    def call(supervisor: Supervisor) -> Any:
        try:
            value = imported(supervisor)
        except Exception as error:  # whatever the function does
            raise EvaluationError(
                f"step {supervisor.step_count}: {called} failed: {type(error).__name__}: {error}"
            ) from error
        is_truth = isinstance(value, (bool, np.bool_))
        if is_truth != truth or not (is_truth or isinstance(value, Real)):
            expected = "True or False" if truth else "a number"
            raise EvaluationError(
                f"step {supervisor.step_count}: {called} gave {str(value)[:40]!r} instead of {expected}"
            )
        return bool(value) if truth else float(value)

    return call
