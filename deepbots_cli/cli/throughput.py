"""The speed of engines, as commands print it."""

from __future__ import annotations

from deepbots_cli.cli import terminal
from deepbots_cli.cli.tables import table
from deepbots_cli.document import Permissions
from deepbots_cli.insight.speed import (
    LARGE_SPREAD,
    Speed,
    busy_note,
    engine_worth_naming,
    medians,
    spread,
)
from deepbots_cli.program import Program


def note_faster_engine(
    program: Program, timesteps: int | None = None, *, permissions: Permissions = Permissions()
) -> None:
    """Print a line if another engine than the default one is faster, and makes a training at least 30 s of
    CPU time shorter.
    """
    faster = engine_worth_naming(program, timesteps, permissions=permissions)
    if faster is not None:
        terminal.note(f"note: {faster.text}")


def speed_table(name: str, measured: list[list[Speed]]) -> str:
    """Return the table of the rounds of each engine, the meaning of its columns, and a remark on a busy
    machine."""
    speeds = [*map(medians, measured)]
    rounds = len(measured[0])
    rows = [
        {
            "engine": speed.engine,
            "worlds": speed.worlds,
            "steps/s": round(speed.steps_per_second),
            "times": round(speed.steps_per_second / speeds[0].steps_per_second, 1),
            "CPU us/step": round(speed.step_us, 1),
            "physics": round(speed.physics_us, 1),
            "resets": round(speed.reset_us, 1),
            "the rest": round(speed.without_resets_us - speed.physics_us, 1),
            "physics share": round(speed.physics_share, 2),
        }
        for speed in speeds
    ]
    of_rounds = "one round" if rounds == 1 else f"medians of {rounds} rounds"
    largest = max(map(spread, measured))
    busy = f"\n{busy_note(largest)}" if largest > LARGE_SPREAD else ""
    return f"{name}, random actions, {of_rounds}; CPU times are per step of one world\n{table(rows)}{busy}"
