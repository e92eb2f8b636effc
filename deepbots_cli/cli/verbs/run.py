"""`deepbots run`."""

from __future__ import annotations

from contextlib import closing
from enum import StrEnum
from statistics import fmean
from typing import TYPE_CHECKING, Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.options import AllowCode, AllowPaths, Case, Engine, Json, Scenario, Seed, Sets, Stage, chosen, whole
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import report
from deepbots_cli.learning.summary import Summary

if TYPE_CHECKING:
    from deepbots_cli.learning.episodes import Episode


MANY = 20
"""More episodes than these are no longer shown one by one, but for the `FIRST` of them."""
FIRST = 5


class Policy(StrEnum):
    random = "random"
    zero = "zero"


def command(
    scenario: Scenario,
    sets: Sets = None,
    case: Case = None,
    stage: Stage = None,
    policy: Annotated[Policy | None, typer.Option("--policy", help="Draw actions, or do nothing; random by default.")] = None,
    actions: Annotated[
        str | None, typer.Option("--actions", metavar="A,B,...", help="Take these actions, over and over: options by name, or numbers.")
    ] = None,
    script: Annotated[str | None, typer.Option("--script", metavar="NAME", help="Follow this script of the scenario.")] = None,
    episodes: Annotated[int, typer.Option("--episodes", metavar="N", parser=whole(), help="How many episodes to run.")] = 3,
    steps: Annotated[int | None, typer.Option("--steps", metavar="N", parser=whole(), help="Stop after so many steps in all.")] = None,
    seed: Seed = 0,
    engine: Engine = "pybullet",
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Run episodes without a trained policy, and show the reward terms.

    What a scenario pays, and how its episodes end, is best looked at before any training.

    \b
      deepbots run cartpole
      deepbots run cartpole --policy zero --episodes 1
      deepbots run cartpole --actions forward,backward --steps 50
      deepbots run pit_escape --script rocking --episodes 100
      deepbots run find_ball_random --stage crowded

    The numbers of an action of several are parted by colons, the actions by commas: --actions 0.5:0.5,0.5:-0.5
    """
    given = [name for name, value in (("--policy", policy), ("--actions", actions), ("--script", script)) if value is not None]
    if len(given) > 1:
        raise UsageError(f"{' and '.join(given)} exclude each other")
    compiled = api.compile(scenario, sets=sets or (), allow_paths=allow_paths or (), allow_code=allow_code)
    terminal.mention(compiled.findings, scenario)
    ir = chosen(compiled.ir, case, stage)
    if script is not None:
        ir.script(script)
    with closing(api.make(ir, engine=engine, allow_code=allow_code)) as environment:
        from deepbots_cli.cli import replay  # needs the simulator, whose absence `make` has reported by now

        if script is not None:
            acting = replay.written(environment, script)
        elif actions is not None:
            acting = replay.repeated(ir, actions)
        else:
            acting = getattr(replay, policy or Policy.random)(environment)
        running = replay.episodes(environment, acting, count=episodes, seed=seed, most_steps=steps)
        done: list[Episode] = []
        with terminal.progress() as show:
            for episode in running:
                done.append(episode)
                if show and episodes > MANY:
                    show(len(done), episodes)
    summary = Summary.of(done)
    if as_json:
        figures = {"success_defined": ir.defines_success, **vars(summary)}
        known = {"scenario": ir.name, "digest": compiled.digest, "seed": seed, "case": case, "stage": stage, "script": script}
        terminal.show_json({**known, "episodes": list(map(_row, done)), "summary": figures})
        return
    _show(done)
    if len(done) > 1:
        terminal.say("\n" + report.summary_text(summary, success_defined=ir.defines_success))


def _row(episode: Episode) -> Row:
    return {
        "return": episode.total_return,
        "length": episode.length,
        "ended_by": episode.ended_by,
        "success": episode.is_success,
        "reward_terms": dict(episode.terms),
    }


def _show(done: list[Episode]) -> None:
    shown = done if len(done) <= MANY else done[:FIRST]
    rows = [{"episode": number, **_row(episode)} for number, episode in enumerate(shown)]
    terminal.say("episodes\n" + table([{name: value for name, value in row.items() if name != "reward_terms"} for row in rows]))
    if len(shown) < len(done):
        terminal.say(f"  and {len(done) - len(shown):,} more")
    terminal.say("\nreward terms\n" + table([_term(done, name) for name in done[0].terms]))


def _term(done: list[Episode], name: str) -> Row:
    sums = [episode.terms[name] for episode in done]
    steps = sum(episode.length for episode in done)
    return {"term": name, "per_episode": fmean(sums), "per_step": sum(sums) / steps, "least": min(sums), "greatest": max(sums)}
