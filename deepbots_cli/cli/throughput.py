"""The speed of engines, as commands print it."""

from __future__ import annotations

from deepbots_cli.cli import terminal
from deepbots_cli.cli.tables import table
from deepbots_cli.document import Permissions
from deepbots_cli.insight.speed import Speed, engine_worth_naming
from deepbots_cli.program import Program


def note_faster_engine(
    program: Program, timesteps: int | None = None, *, permissions: Permissions = Permissions()
) -> None:
    """Say in a line if another engine than the default one is faster, and makes a training at least 30 s of
    CPU time shorter.
    """
    faster = engine_worth_naming(program, timesteps, permissions=permissions)
    if faster is not None:
        terminal.note(f"note: {faster.text}")


def speed_table(name: str, speeds: list[Speed], rounds: int) -> str:
    """The table, and what its columns are."""
    shown = [
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
    measured = "one round" if rounds == 1 else f"medians of {rounds} rounds"
    return f"{name}, random actions, {measured}; CPU times are per step of one world\n{table(shown)}"
