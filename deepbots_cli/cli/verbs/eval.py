"""`deepbots eval`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli import api, learning
from deepbots_cli.canonical import task_digest
from deepbots_cli.cli import results, terminal
from deepbots_cli.cli.command import MAX_SEED, AllowCode, AllowPaths, Json, Sets, fraction, known_engine, whole
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.tables import table
from deepbots_cli.compiler.inputs import RESOLVED
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import report
from deepbots_cli.learning.group import Group, is_group
from deepbots_cli.learning.run import Run

if TYPE_CHECKING:
    from deepbots_cli.api import Compiled
    from deepbots_cli.learning import EvaluationResult, GroupResult
    from deepbots_cli.learning.episodes import Episode
    from deepbots_cli.learning.statistics import Verdict
    from deepbots_cli.program import Program


def command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory of `deepbots train`, or the folder of a group.")],
    episodes: Annotated[
        int | None,
        typer.Option(
            "--episodes", metavar="N", parser=whole(), help="Number of episodes; by default `evaluation.episodes` of the scenario."
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed",
            metavar="N",
            parser=whole(0, MAX_SEED),
            help="Root seed of the starts; by default the seed of the training, and 0 for a group.",
        ),
    ] = None,
    last: Annotated[bool, typer.Option("--last", help="Evaluate the last model instead of the best one.")] = False,
    video: Annotated[Path | None, typer.Option("--video", metavar="MP4", help="Record a video of the first episode.")] = None,
    scenario: Annotated[
        str | None, typer.Option("--scenario", metavar="SCENARIO", help="Evaluate in this scenario; by default in that of the run.")
    ] = None,
    sets: Sets = None,
    case: Annotated[
        str | None,
        typer.Option("--case", metavar="NAME", help="Evaluate in this case only; by default in the scenario and in all its cases."),
    ] = None,
    stage: Annotated[str | None, typer.Option("--stage", metavar="NAME", help="Evaluate in this stage of the curriculum only.")] = None,
    stochastic: Annotated[
        bool, typer.Option("--stochastic", help="Sample the actions of the policy; by default it takes its likeliest action.")
    ] = False,
    baselines: Annotated[
        bool, typer.Option("--baselines", help="Evaluate random actions, zero actions and the scripts of the scenario on the same starts.")
    ] = False,
    robustness: Annotated[
        bool,
        typer.Option("--robustness", help="Evaluate with latency, message loss, noise, other masses and friction, and weaker motors."),
    ] = False,
    details: Annotated[
        bool, typer.Option("--details", help="Show the results by drawn value too, and those in the stages of the curriculum.")
    ] = False,
    engine: Annotated[
        str | None, typer.Option("--engine", metavar="NAME", callback=known_engine, help="Physics engine; by default that of the training.")
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
    csv: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write a CSV file with a line for each episode.")] = None,
    junit: Annotated[
        Path | None, typer.Option("--junit", metavar="FILE", help="Write the requirements as JUnit XML, a test case for each.")
    ] = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Evaluate the policy of a run on held-out episodes.

    The episodes begin with starts that the training does not use. The cases in `evaluation.cases` are evaluated too, with the same starts.
    --require-solved, --min-success and --min-return apply to the result in the scenario, or in the case or stage that is given.
    For a group, every seed is evaluated on the same starts, and requirements apply to the means over the seeds.

    --min-success and --min-return stop the evaluation of a run as soon as the answer is certain: when the remaining episodes cannot change
    it, or when a 95 % confidence sequence (beta-binomial mixture; for returns, an anytime-valid t-test) excludes the required value.

    --robustness changes one condition at a time by several amounts, and shows where the result falls below --min-success or --min-return,
    by default below `solved` of the scenario or 80 % of the result without a change.

    --set overrides values of the scenario of the run, or of the scenario that --scenario names. The observation, action and messages of
    this scenario must be equal to those of the training; its world may differ. --engine runs the episodes in another engine.

    \b
      deepbots eval runs/cartpole-0-1
      deepbots eval runs/cartpole-0-1 --baselines
      deepbots eval runs/cartpole-seeds-1 --csv episodes.csv
      deepbots eval runs/cartpole-0-1 --robustness --episodes 20
      deepbots eval runs/cartpole-0-1 --video cartpole.mp4
      deepbots eval runs/cartpole-0-1 --scenario longer_pole.yaml --episodes 20
      deepbots eval runs/cartpole-0-1 --set fall_angle=10deg
      deepbots eval runs/cartpole-0-1 --engine mujoco
      deepbots eval runs/find_ball_random-0-1 --case many --details
      deepbots eval runs/find_ball-0-1 --min-success 90% --junit gate.xml

    Next: `deepbots compare RUN RUN` compares policies on the same starts, `deepbots runs RUN` lists its evaluations, and
    `deepbots train --resume RUN --timesteps N --full` continues the training.
    """
    for path in (csv, junit):
        if path is not None and not path.absolute().parent.is_dir():
            raise UsageError(f"{path} cannot be written: there is no directory {path.parent}")
    chosen: dict[str, Any] = {
        "episodes": episodes,
        "model": "last" if last else "best",
        "allow_code": allow_code,
        "build": None if engine is None else partial(api.build, engine=engine, allow_code=allow_code),
        "deterministic": not stochastic,
    }
    gates = Gates(min_success, min_return, require_solved)
    if is_group(run):
        refused = {"--video": video, "--robustness": robustness, "--baselines": baselines, "--details": details}
        for option, wish in refused.items():
            if wish:
                raise UsageError(
                    f"{option} evaluates a single run, and {run} is a group; name one of its runs, such as {Group.open(run).runs[0]}"
                )
        compiled = _judged(Group.open(run).path, scenario, sets, allow_paths, allow_code)
        _evaluate_group(run, compiled, gates, csv=csv, junit=junit, as_json=as_json, seed=seed or 0, case=case, stage=stage, **chosen)
        return
    known = Run.open(run)
    if robustness:
        _robustness(known, gates, sets or (), allow_paths or (), scenario, case, stage, as_json=as_json, seed=seed, **chosen)
        return
    compiled = _judged(run, scenario, sets, allow_paths, allow_code)
    chosen |= {"seed": seed, "scenario": compiled}
    with terminal.passing("loading the policy ..."):
        evaluate, evaluate_cases, evaluate_baselines = (
            learning.evaluate,
            learning.evaluate_cases,
            learning.evaluate_baselines,
        )  # imports torch
    program = known.program if compiled is None else compiled.program
    gates.check(program)
    usual = program.evaluation.episodes if case is None else program.case(case).episodes
    with terminal.progress(always=False) as show_episode:
        until = None if require_solved else partial(gates.decided, planned=episodes or usual)
        result = evaluate(known, case=case, stage=stage, video_to=video, on_episode=show_episode, until=until, **chosen)
        alone = case is not None or stage is not None
        cases = () if alone else evaluate_cases(known, stages=details, on_episode=show_episode, **chosen)
        others: Sequence[EvaluationResult] = ()
        if baselines:
            options = {name: value for name, value in chosen.items() if name not in ("model", "deterministic")} | {
                "episodes": result.episodes
            }
            others = evaluate_baselines(known, case=case, stage=stage, on_episode=show_episode, **options)
    elsewhere = _elsewhere(known, scenario, sets or (), compiled)
    data = {**with_cases(result, cases), "baselines": [report.to_json(other) for other in others], "set": sets or []}
    data |= {"elsewhere": elsewhere, "engine": engine or known.record.engine}
    known.keep_evaluation(data)
    if csv is not None:
        results.write_csv(csv, [result, *cases, *others])
    if as_json:
        terminal.show_json(data)
    else:
        show(result, cases, elsewhere=elsewhere)
        if others:
            names = ["the trained policy", *(other.model for other in others)]
            terminal.say("\nbaselines, on the same starts\n" + table(results.rows_of("policy", [result, *others], names)))
        if details:
            terminal.say("\n" + results.drawn_text(result))
    _require(gates.requirements(result, episodes or usual), program.name, junit)


def _judged(
    folder: Path, scenario: str | None, sets: Sequence[str] | None, allow_paths: Sequence[Path] | None, allow_code: bool
) -> Compiled | None:
    """The scenario to evaluate in, where it is not that of the run or group in `folder`."""
    if scenario is None and not sets:
        return None
    options: dict[str, Any] = {"sets": sets or (), "allow_paths": allow_paths or (), "allow_code": allow_code}
    if scenario is None:
        return api.compile(api.load(folder / RESOLVED, project=folder, **options))
    compiled = api.compile(api.load(scenario, **options))
    terminal.mention(compiled.findings, scenario)
    return compiled


Requirement = tuple[str, bool, str]
"""What is required, whether it is met, and the reason."""


@dataclass(frozen=True)
class Gates:
    """What `--min-success`, `--min-return` and `--require-solved` ask for."""

    min_success: float | None
    min_return: float | None
    solved: bool

    def check(self, program: Program) -> None:
        """Raises: UsageError: A success rate is required, and the scenario defines no success."""
        if self.min_success is not None and not program.defines_success:
            raise UsageError(
                f"--min-success: {program.name} defines no success; use --min-return or --require-solved,"
                " or add `termination.success` or a `goal` to the scenario"
            )

    def verdicts(self, episodes: Sequence[Episode], planned: int) -> Iterator[tuple[str, Verdict]]:
        """Each requirement of a number in words, and its answer after these of `planned` episodes."""
        from deepbots_cli.learning.statistics import gate_mean, gate_rate

        if self.min_success is not None:
            successes = sum(episode.is_success for episode in episodes)
            yield f"success rate of at least {self.min_success:g}", gate_rate(self.min_success, successes, len(episodes), planned)
        if self.min_return is not None:
            returns = [episode.total_return for episode in episodes]
            yield f"mean return of at least {self.min_return:g}", gate_mean(self.min_return, returns, planned)

    def decided(self, episodes: Sequence[Episode], planned: int) -> bool:
        """Whether every requirement is certainly met, or one certainly not."""
        answers = [verdict.met for _, verdict in self.verdicts(episodes, planned)]
        return bool(answers) and (False in answers or None not in answers)

    def requirements(self, result: EvaluationResult, planned: int) -> list[Requirement]:
        """The answers for a run; a requirement that another one has left undecided is left out."""
        found = [("the task is solved", bool(result.solved), result.verdict)] if self.solved else []
        answers = self.verdicts(result.outcomes, planned)
        return found + [(words, verdict.met, verdict.reason) for words, verdict in answers if verdict.met is not None]

    def requirements_of_group(self, group: GroupResult) -> list[Requirement]:
        """The answers for the means over the seeds of a group."""
        over = f"over {len(group.evaluations)} seeds"
        unsolved = [result.run.name for result in group.evaluations if not result.solved]
        found = []
        if self.solved:
            found.append(
                ("the task is solved", not unsolved, f"not solved by {', '.join(unsolved)}" if unsolved else "solved by every seed")
            )
        if self.min_success is not None:
            met = group.success_rate >= self.min_success
            found.append((f"success rate of at least {self.min_success:g}", met, f"mean success rate {group.success_rate:.4g} {over}"))
        if self.min_return is not None:
            met = group.mean_return >= self.min_return
            found.append((f"mean return of at least {self.min_return:g}", met, f"mean return {group.mean_return:.4g} {over}"))
        return found


def _evaluate_group(
    folder: Path, compiled: Compiled | None, gates: Gates, *, csv: Path | None, junit: Path | None, as_json: bool, **chosen: Any
) -> None:
    with terminal.passing("loading the policies ..."):
        evaluate_group = learning.evaluate_group  # which imports torch
    group = Group.open(folder)
    if group.runs:
        gates.check(Run.open(group.runs[0]).program if compiled is None else compiled.program)
    with terminal.progress("runs", always=False) as show_run:
        found = evaluate_group(folder, scenario=compiled, on_run=show_run, **chosen)
    if csv is not None:
        results.write_csv(csv, found.evaluations)
    if as_json:
        terminal.show_json(results.group_json(found))
    else:
        terminal.say(results.group_text(found))
    _require(gates.requirements_of_group(found), found.name, junit)


def _robustness(
    known: Run,
    gates: Gates,
    sets: Sequence[str],
    allow_paths: Sequence[Path],
    scenario: str | None,
    case: str | None,
    stage: str | None,
    *,
    as_json: bool,
    **chosen: Any,
) -> None:
    gates.check(known.program)
    with terminal.passing("loading the policy ..."):
        from deepbots_cli.learning.robustness import evaluate_robustness  # which imports torch
    with terminal.progress("evaluations") as show_level:
        found = evaluate_robustness(
            known,
            scenario=scenario,
            sets=sets,
            allow_paths=allow_paths,
            min_success=gates.min_success,
            min_return=gates.min_return,
            on_level=show_level,
            case=case,
            stage=stage,
            **chosen,
        )
    if as_json:
        terminal.show_json(results.robustness_json(found))
    else:
        terminal.say(results.robustness_text(found))


def _elsewhere(run: Run, scenario: str | None, sets: Sequence[str], compiled: Compiled | None) -> str | None:
    """The name in the report of a scenario that replaces the scenario of the run."""
    if compiled is None:
        return None
    same = task_digest(compiled.program) == task_digest(run.program)
    changed = "".join(f" --set {quote(text)}" for text in sets)
    return f"{scenario or 'of the run'}{changed}, {'the same as in the training' if same else 'different from the training'}"


def show(result: EvaluationResult, cases: Sequence[EvaluationResult], *, elsewhere: str | None = None) -> None:
    """An evaluation, and the cases beside it."""
    terminal.say(results.evaluation_text(result, elsewhere))
    if cases:
        terminal.say("\ncases\n" + table(results.case_rows([result, *cases])))


def with_cases(result: EvaluationResult, cases: Sequence[EvaluationResult]) -> dict[str, Any]:
    """An evaluation and its cases as a dictionary."""
    return {**report.to_json(result), "cases": [report.to_json(other) for other in cases]}


def _require(requirements: Sequence[Requirement], suite: str, junit: Path | None) -> None:
    """Report each requirement, and exit with 1 if one is not met."""
    if junit is not None:
        results.write_junit(junit, suite, requirements)
    for words, met, reason in requirements:
        if met:
            terminal.note(f"met: {words} ({reason})")
        else:
            terminal.complain(f"not met: {words} ({reason})")
    if not all(met for _, met, _ in requirements):
        raise typer.Exit(FAILED)
