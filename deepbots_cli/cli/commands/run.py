"""`deepbots run`: episodes of a policy without learning: random or zero actions, a list of actions, or a script of the scenario."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from enum import StrEnum
from itertools import cycle, islice
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

from deepbots_cli import api, rollout
from deepbots_cli.analysis import possible_returns
from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.command import (
    Case,
    Engine,
    Json,
    Overrides,
    Scenario,
    Seed,
    Stage,
    Start,
    integer,
    option,
    start_values,
)
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.episodes import Summary
from deepbots_cli.program.task import ActionRange, Choices
from deepbots_cli.rollout import Driver, Episode
from deepbots_cli.rollout.drivers import named_driver, sequence_driver

if TYPE_CHECKING:
    from deepbots_cli.runtime import Supervisor

MAX_SHOWN = 20
"""Maximum number of episodes that are listed one by one; of more episodes, only the `FIRST_EPISODES` are."""
FIRST_EPISODES = 5
EPISODES = 3


class PlainPolicy(StrEnum):
    random = "random"
    zero = "zero"


def command(
    scenario: Scenario,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    policy: Annotated[
        PlainPolicy | None,
        option(
            "--policy", "`random` (default) samples actions; `zero` takes the middle of each range and the first option of each choice."
        ),
    ] = None,
    actions: Annotated[str | None, option("--actions A,B,...", "Repeat these actions: names of options, or numbers.")] = None,
    script: Annotated[str | None, option("--script NAME", "Use this script of the scenario as the policy.")] = None,
    episodes: Annotated[int, integer("--episodes N", "Number of episodes.")] = EPISODES,
    steps: Annotated[
        int | None, integer("--steps N", "Stop after this total number of steps; by default at the end of the last episode.")
    ] = None,
    seed: Seed = 0,
    start: Start = None,
    engine: Engine = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Run episodes without a policy, and show the reward terms.

    The result shows the returns, the reward terms and the endings of a scenario before any training.

    For the same seed, episode K starts differently in `run` than in `test`, `eval`, `view`, `picture` and `record`, which use held-out
    starts. `deepbots view SCENARIO --script NAME --seed N --episode K` shows held-out episode K.

    \b
      deepbots run cartpole
      deepbots run cartpole --policy zero --episodes 1
      deepbots run cartpole --actions forward,backward --steps 50
      deepbots run pit_escape --script rocking --episodes 100
      deepbots run find_ball_random --stage crowded
      deepbots run panda_push --start mark=0.5,0.1 --start objects.block.mass=0.3

    Commas separate actions, and colons separate the numbers of one action: --actions 0.5:0.5,0.5:-0.5

    If an episode raises an error, training and evaluation save this episode in the run directory. To repeat it, give its file:

    \b
      deepbots run runs/cartpole-0-1/failures/0001.json

    Next: `deepbots train SCENARIO` trains a policy.
    """
    given = [name for name, value in (("--policy", policy), ("--actions", actions), ("--script", script)) if value is not None]
    if len(given) > 1:
        raise UsageError(f"{' and '.join(given)} exclude each other")
    if scenario.endswith(".json") and Path(scenario).parent.name == "failures":
        if given or any((overrides, case, stage, engine, permissions.folders, steps, seed, start)) or episodes != EPISODES:
            raise UsageError("the file of a failed episode keeps its scenario, start and actions; it takes only --json and --allow-code")
        _reproduce(Path(scenario), permissions=permissions, as_json=as_json)
        return
    options = start_values(start)
    compiled = api.compile(scenario, overrides=with_engine(overrides, engine), permissions=permissions)
    terminal.note_warnings(compiled.findings, scenario)
    program = compiled.program.variant(case, stage)
    if script is not None:
        program.script(script)
    with closing(api.make(program, permissions=permissions)) as environment:
        name = environment.engine.name
        if actions is not None:
            driver = repeated_actions(environment, actions)
        else:
            driver = named_driver(environment, script or (policy or PlainPolicy.random).value)
        running = run_episodes(environment, driver, count=episodes, seed=seed, max_steps=steps, options=options)
        done: list[Episode] = []
        with terminal.progress() as show:
            for episode in running:
                done.append(episode)
                if show and episodes > MAX_SHOWN:
                    show(len(done), episodes)
    summary = Summary.of_episodes(done, possible_returns(program))
    data = {"scenario": program.name, "digest": compiled.digest, "engine": name, "seed": seed, "start": options}
    data |= {"case": case, "stage": stage, "script": script, "episodes": list(map(_row, done))}
    totals = "\n" + records.summary_text(summary, success_defined=program.defines_success)
    data["summary"] = {"success_defined": program.defines_success, **vars(summary)}
    terminal.show(data, *_lines(done), *([totals] if len(done) > 1 else []), as_json=as_json)


def _reproduce(path: Path, permissions: Permissions, as_json: bool) -> None:
    from deepbots_cli.learning import failures  # which imports gymnasium

    failure, error = failures.reproduce(path, permissions=permissions)
    repeated = f"repeated {len(failure.actions):,} actions: {'the episode does not fail' if error is None else error}"
    terminal.show({**failure.model_dump(), "reproduced": error}, f"{path}: {failure.error}", repeated, as_json=as_json)


def _row(episode: Episode) -> Row:
    return {
        "return": episode.total_return,
        "length": episode.length,
        "ended_by": episode.ended_by,
        "success": episode.is_success,
        "reward_terms": dict(episode.terms),
        "drawn": dict(episode.drawn),
    }


def _lines(done: list[Episode]) -> Iterator[str]:
    shown = done if len(done) <= MAX_SHOWN else done[:FIRST_EPISODES]
    rows = [{"episode": number, **_row(episode)} for number, episode in enumerate(shown)]
    listed = [{name: value for name, value in row.items() if name not in ("reward_terms", "drawn")} for row in rows]
    yield "episodes\n" + table(listed)
    if len(shown) < len(done):
        yield f"  and {len(done) - len(shown):,} more"
    yield "\nreward terms\n" + table([_term(done, name) for name in done[0].terms])


def _term(done: list[Episode], name: str) -> Row:
    sums = [episode.terms[name] for episode in done]
    steps = sum(episode.length for episode in done)
    return {"term": name, "per_episode": fmean(sums), "min_episode": min(sums), "max_episode": max(sums), "per_step": sum(sums) / steps}


# Drivers


def repeated_actions(environment: Supervisor, text: str) -> Driver:
    """The actions in `text`, repeated without end. Commas separate actions, colons the parts of one action.

    A part is the name or the index of an option, or a number from -1 to 1 for a range. All copies of a robot get the same action.

    Raises:
        UsageError: The scenario has no such action.
    """
    return sequence_driver(cycle([_action(environment, word.strip()) for word in text.split(",")]))


def run_episodes(
    environment: Supervisor, driver: Driver, *, count: int, seed: int, max_steps: int | None, options: dict[str, Any] | None = None
) -> Iterator[Episode]:
    """Up to `count` episodes with the `options` of `reset`, the first with `seed`.

    `ended_by` is `--steps` for an episode that `max_steps` cuts.
    """
    left = max_steps
    for number in range(count):
        start = rollout.Start(seed if number == 0 else None, options)
        running = rollout.steps(environment, driver, start)
        episode = rollout.result_of(islice(running, None if left is None else left + 1), start.seed)
        yield episode if episode.ended_by else replace(episode, ended_by="--steps")
        left = None if left is None else left - episode.length
        if left == 0:
            return


def _action(environment: Supervisor, text: str) -> Any:
    parts = [width for part in environment.scenario.agent.action for width in _slots(part)]
    words = text.split(":")
    if len(words) != len(parts):
        raise UsageError(
            f"the action '{text}' has {len(words)} parts, and an action of the scenario has {len(parts)}; separate the parts by colons"
        )
    values = [_value(part, word.strip()) for part, word in zip(parts, words, strict=True)]
    ranges = [value for part, value in zip(parts, values, strict=True) if isinstance(part, ActionRange)]
    choices = [int(value) for part, value in zip(parts, values, strict=True) if isinstance(part, Choices)]
    return environment.make_action(choices, ranges)


def _slots(part: Choices | ActionRange) -> Sequence[Choices | ActionRange]:
    """The part, repeated once per number that it takes in an action."""
    return [part] * (max(1, len(part.components)) if isinstance(part, ActionRange) else 1)


def _value(part: Choices | ActionRange, word: str) -> float:
    if isinstance(part, Choices):
        names = [option.name for option in part.options]
        if word in names:
            return names.index(word)
        if word.isdecimal() and int(word) < len(names):
            return int(word)
        raise UsageError(f"'{part.name}' has no option '{word}'; its options are: {', '.join(names)}")
    try:
        value = float(word)
    except ValueError:
        value = float("nan")
    if not -1 <= value <= 1:
        order = f"; the order of its numbers is {':'.join(part.components)}" if len(part.components) > 1 else ""
        meaning = f"they stand for {part.low:g} and {part.high:g} {part.unit}{order}"
        raise UsageError(f"'{word}' is not a value of '{part.name}', which takes a number from -1 to 1; {meaning}")
    return value
