"""Arguments and options that several verbs share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepbots_cli.errors import UsageError

if TYPE_CHECKING:
    from deepbots_cli.program import Program


MOST_SEED = 2**63 - 1
"""The largest seed that a run can record."""


def known_engine(name: str | None) -> str | None:
    """A callback that rejects unknown engines."""
    from deepbots_cli import engines

    if name is not None and name not in engines.names():
        raise typer.BadParameter(f"there is no engine '{name}'; there are {', '.join(engines.names())}")
    return name


def whole(least: int = 1, most: int | None = None) -> Callable[[str | int], int]:
    """A parser of whole numbers: in digits, grouped as in a scenario (`100_000`), or short (`100k`, `1e5`)."""

    def parse(text: str | int) -> int:
        value = _whole(str(text))
        if value is None:
            raise typer.BadParameter(f"'{text}' is not a whole number; write it like 100000, 100_000, 100k or 1e5")
        if value < least:
            raise typer.BadParameter(f"{text} is too small; the least is {least}")
        if most is not None and value > most:
            raise typer.BadParameter(f"{text} is too large; the largest is {most}")
        return value

    return parse


def _whole(text: str) -> int | None:
    try:
        return int(text)
    except ValueError:
        from deepbots_cli.scenario.fields import count_meant

        meant = count_meant(text)
    try:
        number = float(meant or text)
    except ValueError:
        return None
    return int(number) if number.is_integer() and number < 1e15 else None


def chosen(program: Program, case: str | None, stage: str | None) -> Program:
    """The scenario under the settings of a case or of a stage; itself without either.

    Raises:
        UsageError: Both are given, or the scenario has no such case or stage.
    """
    if case is not None and stage is not None:
        raise UsageError("--case and --stage exclude each other")
    return program.case(case).program if case is not None else program.stage(stage).program if stage is not None else program


def fraction(text: str) -> float:
    """A parser: a number from 0 to 1, written `0.8` or `80%`."""
    from deepbots_cli.scenario.fields import read_fraction

    try:
        value = read_fraction(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1:
        hint = f"; write {text}% for a share in hundredths" if 1 < value <= 100 else ""
        raise typer.BadParameter(f"'{text}' is not a number from 0 to 1 or a percentage{hint}")
    return value


Scenario = Annotated[str, typer.Argument(metavar="SCENARIO", help="A file, or the name of a scenario that comes with deepbots.")]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change a value, such as fall_angle=10deg; may be repeated.")
]
AllowPaths = Annotated[
    list[Path] | None,
    typer.Option("--allow-path", metavar="DIR", help="A folder outside the project that may be read from; may be repeated."),
]
AllowCode = Annotated[bool, typer.Option("--allow-code", help="Let terms that are functions of Python run; trust their packages.")]
Case = Annotated[str | None, typer.Option("--case", metavar="NAME", help="Take this case of the evaluation.")]
Stage = Annotated[str | None, typer.Option("--stage", metavar="NAME", help="Take this stage of the curriculum.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Seed = Annotated[int, typer.Option("--seed", metavar="N", parser=whole(0, MOST_SEED), help="The root of every random number.")]
Engine = Annotated[
    str, typer.Option("--engine", metavar="NAME", callback=known_engine, help="The physics: pybullet, or an engine of another package.")
]
