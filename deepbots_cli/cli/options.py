"""Arguments and options that several verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepbots_cli.errors import UsageError

if TYPE_CHECKING:
    from deepbots_cli.ir import CompiledScenario


def known_engine(name: str | None) -> str | None:
    """A callback: refuses an engine that does not exist."""
    from deepbots_cli import engines

    if name is not None and name not in engines.names():
        raise typer.BadParameter(f"there is no engine '{name}'; there are {', '.join(engines.names())}")
    return name


def small_enough(seed: int | None) -> int | None:
    """A callback: refuses a seed that a run could not record. As a bound of the option it would fill the help with its digits."""
    if seed is not None and seed >= 2**63:
        raise typer.BadParameter(f"{seed} is too large; the largest seed is {2**63 - 1}")
    return seed


def chosen(ir: CompiledScenario, case: str | None, stage: str | None) -> CompiledScenario:
    """The scenario under the settings of a case or of a stage; itself without either.

    Raises:
        UsageError: Both are given, or the scenario has no such case or stage.
    """
    if case is not None and stage is not None:
        raise UsageError("--case and --stage exclude each other")
    return ir.case(case).scenario if case is not None else ir.stage(stage).scenario if stage is not None else ir


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
Seed = Annotated[int, typer.Option("--seed", metavar="N", min=0, callback=small_enough, help="The root of every random number.")]
Engine = Annotated[
    str, typer.Option("--engine", metavar="NAME", callback=known_engine, help="The physics: pybullet, or exact where equations are known.")
]
