"""Messages about an episode that cannot go on: an expression without a value, a reward that is not finite, a
choice without an option."""

from __future__ import annotations

import math
import traceback
from collections.abc import Mapping

from deepbots_cli.errors import EvaluationError
from deepbots_cli.port import Engine
from deepbots_cli.program import generated
from deepbots_cli.program.task import Agent


def without_value(error: Exception, engine: Engine, step: int) -> Exception:
    """Return an `EvaluationError` that shows the generated line, or the error itself where it is a fault of
    ours."""
    frames = [
        frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.startswith("<deepbots")
    ]
    if not frames or not isinstance(error, (ArithmeticError, ValueError, NameError)):
        return error
    engine.require_finite()  # a world that blew up is the engine's failure, not the expression's
    statement = generated.as_written(frames[-1].line or "")
    return EvaluationError(f"step {step}: no value for `{statement}`: {error}")


def infinite_reward(terms: Mapping[str, float]) -> str:
    """Return the message about the terms that make a reward infinite or NaN."""
    culprit = next(
        (f"the reward term '{name}'" for name, value in terms.items() if not math.isfinite(value)), None
    )
    return f"{culprit or 'the sum of the reward terms'} is not finite"


def without_option(agent: Agent, choice: str) -> str:
    """Return the message for a choice whose options are all forbidden by conditions of the scenario."""
    options = next(part.options for part in agent.choices if part.name == choice)
    return f"every option of '{choice}' is forbidden: {', '.join(option.name for option in options)}"
