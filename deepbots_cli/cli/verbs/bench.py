"""`deepbots bench`."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.options import AllowCode, AllowPaths, Engine, Json, Scenario, Seed, Sets, whole
from deepbots_cli.cli.tables import pairs as aligned
from deepbots_cli.errors import MissingExtraError


def command(
    scenario: Scenario,
    sets: Sets = None,
    steps: Annotated[
        int | None, typer.Option("--steps", metavar="N", parser=whole(100), help="Steps of the agent in each; 2000 by default.")
    ] = None,
    pairs: Annotated[
        int | None, typer.Option("--pairs", metavar="N", parser=whole(), help="How often each is measured; 9 by default.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Measure a tenth as long: 600 steps, 3 times.")] = False,
    seed: Seed = 0,
    engine: Engine = "pybullet",
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Time a step of the environment against bare physics.

    Both go through the same episodes in the same engine with the same substeps; resets are not timed. The ratio is what messages,
    observation, reward and endings cost.

    \b
      deepbots bench cartpole
      deepbots bench quadruped --quick
      deepbots bench cartpole --set messages.format=csv --pairs 15
    """
    compiled = api.compile(scenario, sets=sets or (), allow_paths=allow_paths or (), allow_code=allow_code)
    terminal.mention(compiled.findings, scenario)
    try:
        from deepbots_cli.cli import measure
    except ModuleNotFoundError as error:
        raise MissingExtraError("sim", "timing a scenario") from error
    usual_steps, usual_pairs = (600, 3) if quick else (2000, 9)
    steps, pairs = steps or usual_steps, pairs or usual_pairs
    terminal.note(f"timing {pairs} pairs of {steps:,} steps; --quick takes a tenth of the time")
    with terminal.progress("measurements") as show:
        result = measure.compare(compiled, engine=engine, steps=steps, pairs=pairs, seed=seed, on_measured=show)
    if as_json:
        terminal.show_json(asdict(result))
        return
    terminal.say(
        f"{result.scenario} on {result.engine}, {result.format} messages; medians of {result.pairs} pairs of {result.steps:,} steps\n"
        + aligned(
            {
                "step of the environment": f"{result.step_us:.2f} us, {result.steps_per_second:,.0f} per second",
                "bare physics": f"{result.bare_us:.2f} us",
                "ratio": f"{result.ratio:.3f} ({result.least_ratio:.3f} .. {result.greatest_ratio:.3f})",
            }
        )
    )
