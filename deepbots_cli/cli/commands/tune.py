"""`deepbots tune`: a new study; `apply`: its best values, written into the scenario file."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, get_args

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    MAX_SEED,
    MAX_SEEDS,
    ClusterAddress,
    Engine,
    Json,
    Overrides,
    Quiet,
    Workers,
    integer,
    option,
    seed_list,
    whole_number,
)
from deepbots_cli.cli.studies import continue_study
from deepbots_cli.cli.tables import table
from deepbots_cli.cli.written_files import write_values
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.document import Permissions
from deepbots_cli.document.load import TUNE
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.campaigns.study import Objective, Study, create_study


def command(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO",
            help="A scenario file, or the name of a scenario that comes with deepbots.",
        ),
    ] = None,
    params: Annotated[
        list[str] | None,
        option(
            "--param PATH=VALUES",
            "Values to try, such as train.learning_rate=1e-4..1e-2:log, parameters.pole_length=0.5..1.5m or"
            " train.batch_size='64 | 128'; may be repeated. By default those of `tune.search`.",
        ),
    ] = None,
    overrides: Overrides = None,
    trials: Annotated[
        int | None,
        integer("--trials N", "Number of trials in all; by default `tune.trials`, else 40.", 1, 100_000),
    ] = None,
    seeds: Annotated[
        str | None,
        option(
            "--seeds N|LIST",
            "Number of seeds of each trial, or a list such as 0..4; by default `tune.seeds`, else 3.",
        ),
    ] = None,
    timesteps: Annotated[
        int | None,
        integer(
            "--timesteps N",
            "Timesteps of each training, such as 50k; by default `tune.timesteps`, else"
            " `train.total_timesteps`.",
        ),
    ] = None,
    objective: Annotated[
        str | None,
        option(
            "--objective NAME",
            "What makes a trial good: `solved` (few timesteps until the task is solved), `success_rate` or"
            " `mean_return` (of an evaluation"
            " of the best models). By default the first of them that the scenario defines.",
        ),
    ] = None,
    seed: Annotated[int, integer("--seed N", "Seed of the search; 0 by default.", 0, MAX_SEED)] = 0,
    run: Annotated[
        Path | None, option("--run DIR", "Directory to create for the study; by default a new one in ./runs.")
    ] = None,
    prune: Annotated[
        bool | None,
        option("--prune/--no-prune", "End trials early that are worse than the median.", ADVANCED),
    ] = None,
    workers: Workers = None,
    address: ClusterAddress = None,
    engine: Engine = None,
    quiet: Quiet = False,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Search for better values of a scenario."""
    if scenario is None:
        raise UsageError(
            "there is no scenario; name one, such as: deepbots tune cartpole --param"
            " train.learning_rate=1e-4..1e-2:log"
        )
    if objective not in (None, *get_args(Objective)):
        raise UsageError(
            f"--objective: there is no objective '{objective}'; choose one of:"
            f" {', '.join(get_args(Objective))}"
        )
    if run is not None and run.exists():
        raise UsageError(
            f"--run: {run} already exists; choose another directory, because studies are not overwritten"
        )
    checked = _checked(scenario, params or (), with_engine(overrides, engine), permissions)
    settings: dict[str, Any] = {
        "trials": trials,
        "timesteps": timesteps,
        "objective": objective,
        "prune": prune,
        "seed": seed,
    }
    settings |= {"seeds": None if seeds is None else _seeds(seeds), "command": ["deepbots", *sys.argv[1:]]}
    study = create_study(checked, folder=run, **settings)
    try:
        continue_study(study, workers, address, quiet=quiet, as_json=as_json, permissions=permissions)
    except (DeepbotsError, KeyboardInterrupt):
        if not study.trials():  # for example, the workers do not exist
            shutil.rmtree(study.path, ignore_errors=True)
        raise


def _checked(
    scenario: str, params: Sequence[str], overrides: Sequence[str] | None, permissions: Permissions
) -> CheckedScenario:
    """Return the scenario with the search of the options.

    Raises:
        UsageError: An option is wrong. ScenarioError: The scenario has errors, which may be in its section
            `tune`.
    """
    overrides = list(overrides or ())
    if not params:
        return api.load(scenario, overrides=overrides, permissions=permissions, tests=True)
    search: dict[str, str] = {}
    for text in params:
        path, _, values = (part.strip() for part in text.partition("="))
        if not path or not values:
            raise UsageError(
                f"--param {text}: write PATH=VALUES, such as --param train.learning_rate=1e-4..1e-2:log"
            )
        if path in search:
            raise UsageError(f"--param names {path} twice")
        search[path] = values
    before = api.load(scenario, overrides=overrides, permissions=permissions)
    if before.program is None:  # reports all errors of the scenario
        api.compile(before)
    # A list is YAML already; anything else is one text.
    entries = (
        f"{json.dumps(path)}: {values if values.startswith('[') else json.dumps(values)}"
        for path, values in search.items()
    )
    checked = api.load(
        scenario,
        overrides=[*overrides, f"tune.search={{{', '.join(entries)}}}"],
        permissions=permissions,
        tests=True,
    )
    for finding in checked.findings.errors:
        if (finding.span.source.assigned or "").partition(".")[0] == TUNE:
            name = next(
                (
                    f" {path}={values}"
                    for path, values in search.items()
                    if finding.span.text.strip("\"'") in (path, values)
                ),
                "",
            )
            raise UsageError(
                f"--param{name}: {finding.headline}{f'; {finding.help}' if finding.help else ''}"
            )
    return checked


def _seeds(text: str) -> Sequence[int]:
    """Parse seeds: `3` for so many seeds from 0, or `0..4` or `0,3,7` for these seeds."""
    if ".." in text or "," in text:
        return seed_list(text)
    return range(whole_number(1, MAX_SEEDS)(text))


def apply(
    folder: Annotated[Path, typer.Argument(metavar="STUDY", help="A study of `tune`.")],
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="FILE",
            help="The scenario file to change; by default that of the study.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Write the best values of a search into the scenario file."""
    study = Study.open(folder)
    trials = study.trials()
    best = next(iter(study.ranked(trials)), None)
    if best is None:
        raise UsageError(
            f"{study.path} has no complete trial yet; continue it with: deepbots resume"
            f" {quote(str(study.path))}"
        )
    name = scenario or study.record.source
    file = write_values(name, best.values, f"set by {study.path.name}, {best.path.name}", permissions)
    over_first = study.over_first(trials)
    if over_first is not None and not over_first.is_clear:
        terminal.note(f"note: {best.path.name} is not clearly better than the values of the scenario itself")
    data = {"file": file, "member": best.path.name, "values": best.values, "over_first": over_first}
    rows = [{"key": key, "value": text} for key, text in best.values.items()]
    first = max(study.record.seeds) + 1
    further = [f"deepbots lint {quote(name)}", f"deepbots train {quote(name)} --seeds {first}..{first + 4}"]
    terminal.show(
        data, f"{file}: values of {best.path.name}\n{table(rows)}", as_json=as_json, next_commands=further
    )
