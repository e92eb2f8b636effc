"""`deepbots robustness`: a policy under conditions that it was not trained for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepbots_cli.cli import processes, records, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    MAX_SEED,
    SCENARIO,
    ClusterAddress,
    Json,
    Overrides,
    Workers,
    fraction,
    integer,
    known_engine,
    option,
)
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.learning.runs.run import ModelRef


def command(
    run: Annotated[
        Path,
        typer.Argument(metavar="RUN|MODEL", help="A run directory of `deepbots train`, or a model in it."),
    ],
    episodes: Annotated[
        int | None,
        integer(
            "--episodes N",
            "Episodes of each evaluation; by default `evaluation.episodes` of the scenario, but at most 50.",
        ),
    ] = None,
    min_success: Annotated[
        float | None,
        option(
            "--min-success RATE",
            "Success rate that the policy must reach, such as 0.8 or 80%.",
            parser=fraction,
        ),
    ] = None,
    min_return: Annotated[
        float | None, option("--min-return VALUE", "Mean return that the policy must reach.")
    ] = None,
    mass_of: Annotated[
        str | None,
        option(
            "--mass-of NAME",
            "Object or ROBOT.LINK whose mass changes; by default the heaviest link that can move.",
        ),
    ] = None,
    as_json: Json = False,
    scenario: Annotated[
        str | None,
        option(
            "--scenario SCENARIO",
            "Evaluate in this scenario; by default in the scenario of the run.",
            SCENARIO,
        ),
    ] = None,
    overrides: Overrides = None,
    case: Annotated[
        str | None, option("--case NAME", "Evaluate in this case of `evaluation.cases`.", SCENARIO)
    ] = None,
    stage: Annotated[
        str | None, option("--stage NAME", "Evaluate in this stage of the curriculum.", SCENARIO)
    ] = None,
    engine: Annotated[
        str | None,
        option(
            "--engine NAME",
            "Physics engine; by default that of the training.",
            SCENARIO,
            callback=known_engine,
        ),
    ] = None,
    seed: Annotated[
        int | None,
        integer(
            "--seed N", "Root seed of the starts; by default the seed of the training.", 0, MAX_SEED, ADVANCED
        ),
    ] = None,
    last: Annotated[
        bool, option("--last", "Evaluate the last model instead of the best one.", ADVANCED)
    ] = False,
    stochastic: Annotated[
        bool,
        option(
            "--stochastic",
            "Sample the actions of the policy; by default it takes its likeliest action.",
            ADVANCED,
        ),
    ] = False,
    workers: Workers = None,
    address: ClusterAddress = None,
    permissions: Permissions = Permissions(),
) -> None:
    """Evaluate a policy under changed conditions."""
    ref = ModelRef.open(run, permissions, model="last" if last else "best")
    terminal.note_physics(ref.run)
    with terminal.transient_line("loading the policy ..."):
        from deepbots_cli.learning.robustness import evaluate_robustness
    with processes.executor(workers, address) as executor, terminal.progress("evaluations") as show_level:
        result = evaluate_robustness(
            ref,
            episodes=episodes,
            seed=seed,
            deterministic=not stochastic,
            scenario=scenario,
            overrides=with_engine(overrides, engine),
            case=case,
            stage=stage,
            mass_of=mass_of,
            min_success=min_success,
            min_return=min_return,
            permissions=permissions,
            on_level=show_level,
            executor=executor,
        )
    terminal.show(records.robustness_json(result), records.robustness_text(result), as_json=as_json)
    if not result.nominal_holds:
        raise typer.Exit(FAILED)
