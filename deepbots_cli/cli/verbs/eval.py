"""`deepbots eval`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api, learning
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import MAX_SEED, AllowCode, AllowPaths, Json, Sets, fraction, known_engine, whole
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.tables import table
from deepbots_cli.compiler.inputs import RESOLVED
from deepbots_cli.engine_kinds import on_engine
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import report
from deepbots_cli.learning.run import Run
from deepbots_cli.program.identity import task_digest

if TYPE_CHECKING:
    from deepbots_cli.api import Compiled
    from deepbots_cli.learning import EvaluationResult
    from deepbots_cli.learning.episodes import Episode
    from deepbots_cli.learning.statistics import Verdict


def _engines(names: list[str] | None) -> list[str] | None:
    """A callback: the names between commas, each of which is known and installed."""
    found = [name.strip() for text in names or () for name in text.split(",")]
    for name in found:
        known_engine(name)
    if len(set(found)) < len(found):
        raise typer.BadParameter("an engine is named twice")
    return found or None


def command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory of `deepbots train`.")],
    episodes: Annotated[
        int | None,
        typer.Option(
            "--episodes", metavar="N", parser=whole(), help="Number of episodes; by default `evaluation.episodes` of the scenario."
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed", metavar="N", parser=whole(0, MAX_SEED), help="Root seed of the starts; by default the seed of the training."
        ),
    ] = None,
    last: Annotated[bool, typer.Option("--last", help="Evaluate the last model instead of the best one.")] = False,
    video: Annotated[Path | None, typer.Option("--video", metavar="MP4", help="Record a video of the first episode.")] = None,
    scenario: Annotated[
        str | None, typer.Option("--scenario", metavar="SCENARIO", help="Evaluate in this scenario; by default in the scenario of the run.")
    ] = None,
    sets: Sets = None,
    case: Annotated[
        str | None,
        typer.Option("--case", metavar="NAME", help="Evaluate in this case only; by default in the scenario and in all its cases."),
    ] = None,
    engine: Annotated[
        list[str] | None,
        typer.Option(
            "--engine",
            metavar="NAME[,NAME]",
            callback=_engines,
            help="Physics engine, by default that of the training; several, with commas between, are compared on the same starts.",
        ),
    ] = None,
    require_solved: Annotated[bool, typer.Option("--require-solved", help="Exit with 1 unless the task is solved.")] = False,
    min_success: Annotated[
        float | None,
        typer.Option(
            "--min-success", metavar="RATE", parser=fraction, help="Exit with 1 if the success rate is lower than RATE, such as 0.8 or 80%."
        ),
    ] = None,
    min_return: Annotated[
        float | None, typer.Option("--min-return", metavar="VALUE", help="Exit with 1 if the mean return is lower than VALUE.")
    ] = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Evaluate the policy of a run on held-out episodes.

    The episodes begin with starts that the training does not use. The cases in `evaluation.cases` are evaluated too, with the same starts.
    The options --min-success, --min-return and --require-solved apply to the result in the scenario, or in the case given by --case.

    --min-success and --min-return stop the evaluation as soon as the answer is certain: when the remaining episodes cannot change it, or
    when a 95 % confidence sequence (beta-binomial mixture; for returns, an anytime-valid t-test) excludes the required value.

    --set overrides values of the scenario of the run, or of the scenario that --scenario names. This scenario must have the
    observation, action and messages of the training; its world may differ. --engine runs the episodes in another engine. With several
    engines, such as --engine mujoco,pybullet, every engine runs episodes from the same starts, and the table shows the difference of each
    further engine from the first, with its 95 % interval over pairs of episodes. The requirements then apply to every engine.

    \b
      deepbots eval runs/cartpole-0-1
      deepbots eval runs/cartpole-0-1 --video cartpole.mp4
      deepbots eval runs/cartpole-0-1 --scenario longer_pole.yaml --episodes 20
      deepbots eval runs/cartpole-0-1 --set fall_angle=10deg
      deepbots eval runs/cartpole-0-1 --engine mujoco
      deepbots eval runs/cartpole-0-1 --engine pybullet,mujoco
      deepbots eval runs/find_ball_random-0-1 --case many
      deepbots eval runs/cartpole-0-1 --require-solved --json
      deepbots eval runs/find_ball-0-1 --min-success 90%

    Next: `deepbots compare RUN RUN` compares policies on the same starts, and
    `deepbots train --resume RUN --timesteps N --full` continues the training.
    """
    known = Run.open(run)
    several: Sequence[str | None] = engine or [None]
    if video is not None and len(several) > 1:
        raise UsageError("a video shows one engine; name one with --engine")
    made: list[Compiled | None] = []
    for name in several:
        compiled = None
        if scenario is not None or sets or name not in (None, known.record.engine):
            options: dict[str, Any] = {"sets": on_engine(sets, name), "allow_paths": allow_paths or (), "allow_code": allow_code}
            checked = api.load(scenario, **options) if scenario is not None else api.load(run / RESOLVED, project=run, **options)
            compiled = api.compile(checked)
        made.append(compiled)
    compiled = made[0]
    if scenario is not None and compiled is not None:
        terminal.mention(compiled.findings, scenario)
    chosen: dict[str, Any] = {"episodes": episodes, "seed": seed, "model": "last" if last else "best", "allow_code": allow_code}
    with terminal.passing("loading the policy ..."):
        evaluate, evaluate_cases = learning.evaluate, learning.evaluate_cases  # which imports torch
    program = known.program if compiled is None else compiled.program
    if min_success is not None and not program.defines_success:
        raise UsageError(
            f"--min-success: {program.name} defines no success; use --min-return or --require-solved,"
            " or add `termination.success` or a `goal` to the scenario"
        )
    usual = program.evaluation.episodes if case is None else program.case(case).episodes
    gates = Gates(min_success, min_return, episodes or usual)
    until = None if require_solved or len(several) > 1 else gates.decided
    found: list[tuple[EvaluationResult, Sequence[EvaluationResult]]] = []
    for name, there in zip(several, made, strict=True):
        with terminal.progress("episodes" if name is None else f"episodes in {name}", always=False) as show_episode:
            chosen |= {"engine": name, "scenario": there, "on_episode": show_episode}
            result = evaluate(known, case=case, video_to=video, until=until, **chosen)
            found.append((result, evaluate_cases(known, **chosen) if case is None else ()))
        known.keep_evaluation({**with_cases(*found[-1]), "set": sets or []})
    elsewhere = _elsewhere(known, scenario, sets or (), compiled) if scenario is not None or sets else None
    if len(found) > 1:
        _show_engines(known, found, elsewhere, sets or [], as_json=as_json)
    elif as_json:
        terminal.show_json({**with_cases(*found[0]), "set": sets or []})
    else:
        show(*found[0], elsewhere=elsewhere)
    for result, _ in found:
        _require(result, gates, require_solved=require_solved)


def _show_engines(
    run: Run,
    found: Sequence[tuple[EvaluationResult, Sequence[EvaluationResult]]],
    elsewhere: str | None,
    sets: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """The evaluations in several engines side by side, and the difference of each from the first, from the same starts."""
    from deepbots_cli.learning.comparison import across_engines

    pairs = [
        across_engines(one, other)
        for column in zip(*((result, *cases) for result, cases in found), strict=True)
        for one, other in ((column[0], other) for other in column[1:])
    ]
    if as_json:
        evaluations = [with_cases(result, cases) for result, cases in found]
        terminal.show_json({"evaluations": evaluations, "differences": [asdict(pair) for pair in pairs], "set": list(sets)})
        return
    first = found[0][0]
    trained = f"trained in {run.record.engine}"
    terminal.say(f"evaluation of {first.scenario} in {len(found)} engines, {trained}" + (f"; scenario {elsewhere}" if elsewhere else ""))
    terminal.say(f"  {first.episodes:,} held-out starts from seed {first.seed}, the same in every engine")
    rows = report.case_rows([each for result, cases in found for each in (result, *cases)])
    engines = [each.engine for result, cases in found for each in (result, *cases)]
    one_case = len({row["case"] for row in rows}) == 1
    terminal.say(
        table(
            [
                {"engine": name, **{key: value for key, value in row.items() if key != "case" or not one_case}}
                for name, row in zip(engines, rows, strict=True)
            ]
        )
    )
    terminal.say("\ndifferences on the same starts, with 95 % intervals")
    terminal.say(table([pair.row(with_case=not one_case) for pair in pairs]))
    for result, _ in found:
        terminal.say(f"{result.engine}: {result.verdict}")
    for note in dict.fromkeys(note for result, _ in found for note in result.notes):
        terminal.say(f"note: {note}")


@dataclass(frozen=True)
class Gates:
    """What `--min-success` and `--min-return` require of an evaluation of `planned` episodes."""

    min_success: float | None
    min_return: float | None
    planned: int

    def verdicts(self, episodes: Sequence[Episode]) -> Iterator[tuple[str, Verdict]]:
        """Each requirement in words, and its answer after these episodes."""
        from deepbots_cli.learning.statistics import gate_mean, gate_rate

        if self.min_success is not None:
            successes = sum(episode.is_success for episode in episodes)
            yield f"success rate of at least {self.min_success:g}", gate_rate(self.min_success, successes, len(episodes), self.planned)
        if self.min_return is not None:
            returns = [episode.total_return for episode in episodes]
            yield f"mean return of at least {self.min_return:g}", gate_mean(self.min_return, returns, self.planned)

    def decided(self, episodes: Sequence[Episode]) -> bool:
        """Whether every requirement is certainly met, or one certainly not."""
        answers = [verdict.met for _, verdict in self.verdicts(episodes)]
        return bool(answers) and (False in answers or None not in answers)


def _elsewhere(run: Run, scenario: str | None, sets: Sequence[str], compiled: Compiled | None) -> str | None:
    """The name in the report of a scenario that replaces the scenario of the run."""
    if compiled is None:
        return None
    same = task_digest(compiled.program) == task_digest(run.program)
    changed = "".join(f" --set {quote(text)}" for text in sets)
    return f"{scenario or 'of the run'}{changed}, {'the same as in the training' if same else 'different from the training'}"


def show(result: EvaluationResult, cases: Sequence[EvaluationResult], *, elsewhere: str | None = None) -> None:
    """An evaluation, and the cases beside it."""
    terminal.say(report.evaluation_text(result, elsewhere))
    if cases:
        terminal.say("\ncases\n" + table(report.case_rows([result, *cases])))


def with_cases(result: EvaluationResult, cases: Sequence[EvaluationResult]) -> dict[str, Any]:
    """An evaluation and its cases as a dictionary."""
    return {**report.to_json(result), "cases": [report.to_json(other) for other in cases]}


def _require(result: EvaluationResult, gates: Gates, *, require_solved: bool) -> None:
    """Report each requirement, and exit with 1 if the result does not meet all of them."""
    unmet = []
    if require_solved and not result.solved:
        unmet.append(
            "the task is not solved"
            if result.solved is False
            else f"the evaluation cannot say whether the task is solved ({result.verdict})"
        )
    for requirement, verdict in gates.verdicts(result.outcomes):
        if verdict.met is False:
            unmet.append(f"not met: {requirement} ({verdict.reason})")
        elif verdict.met:
            terminal.note(f"met: {requirement} ({verdict.reason})")
    if unmet:
        terminal.complain(" and ".join(unmet))
        raise typer.Exit(FAILED)
