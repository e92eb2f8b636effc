"""Functions of installed packages as terms of a scenario."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli.errors import EvaluationError, UsageError

if TYPE_CHECKING:
    from deepbots_cli.runtime.supervisor import Supervisor


def foreign(what: str, name: str, module: str, function: str, truth: bool) -> Callable[[Supervisor], Any]:
    """The function that gives the term `name`, a truth value if `truth`, else a number, from the supervisor.

    Raises:
        UsageError: There is no such function, or its module cannot be imported.
    """
    called = f"the {what} '{name}' in Python ({module}:{function})"
    try:
        found = getattr(import_module(module), function)
    except Exception as error:  # whatever the module does while it is imported
        raise UsageError(f"{called} cannot be imported: {type(error).__name__}: {error}") from error
    if not callable(found):
        raise UsageError(f"{called} is no function")

    def call(supervisor: Supervisor) -> Any:
        try:
            value = found(supervisor)
        except Exception as error:  # whatever the function does
            raise EvaluationError(f"step {supervisor.step_count}: {called} failed: {type(error).__name__}: {error}") from error
        is_truth = isinstance(value, (bool, np.bool_))
        if is_truth != truth or not (is_truth or isinstance(value, Real)):
            wanted = "True or False" if truth else "a number"
            raise EvaluationError(f"step {supervisor.step_count}: {called} gave {str(value)[:40]!r} and not {wanted}")
        return bool(value) if truth else float(value)

    return call
