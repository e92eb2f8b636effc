"""`deepbots eval`: a run or a group in its scenario, its cases and several engines, and the requirements on
its result."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from deepbots_cli import api, learning
from deepbots_cli.analysis import possible_returns
from deepbots_cli.cli import arguments, records, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    FAILED_EPISODES,
    MAX_SEED,
    SCENARIO,
    ClusterAddress,
    Force,
    Latex,
    Overrides,
    Workers,
    check_options,
    episodes_or_failed,
    finite,
    fraction,
    integer,
    known_engine,
    option,
)
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.tables import Row, table, write_tables
from deepbots_cli.diagnostics.render import Case, xml_report
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write, check_output
from deepbots_cli.learning.campaigns.group import Group
from deepbots_cli.learning.runs.episodes import check_common_measure, check_defines_success
from deepbots_cli.learning.runs.evaluations import in_parentheses
from deepbots_cli.learning.runs.run import ModelRef, Run
from deepbots_cli.learning.runs.statistics import Interval, Verdict, gate_mean, gate_rate
from deepbots_cli.program.identity import task_digest
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.words import beside, counted, shell_word

if TYPE_CHECKING:
    from deepbots_cli.api import Compiled
    from deepbots_cli.learning import EvaluationResult, GroupResult
    from deepbots_cli.learning.executor import Executor
    from deepbots_cli.program import Program
    from deepbots_cli.rollout import Episode
    from deepbots_cli.rollout.policies import StopCondition

_REQUIREMENTS = "Requirements"
_ENDS = ("margin", "truth_ending", "truncation_limit", "nearest")
"""The statements of an explanation about the end of an episode: the passed limit, or the distance to a
success."""
_MAX_FAILED = 10
"""The number of failed episodes of which `--episodes failed` prints the margin."""


def _engines(names: list[str] | None) -> list[str] | None:
    """Return the names between commas, each of which is a known and installed engine."""
    engines = [name.strip() for text in names or () for name in text.split(",")]
    for name in engines:
        known_engine(name)
    if len(set(engines)) < len(engines):
        raise typer.BadParameter("an engine is named twice")
    return engines or None


def command(
    ctx: typer.Context,
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN|MODEL",
            help="A run directory of `deepbots train`, a model in it, or the folder of a group.",
        ),
    ],
    episodes: Annotated[
        Any,
        option(
            "--episodes N|failed",
            "Number of episodes, by default `evaluation.episodes` of the scenario, or as many as `solved`"
            " requires, if that is more; `failed` repeats those that failed.",
            parser=episodes_or_failed,
        ),
    ] = None,
    baselines: Annotated[
        bool,
        option(
            "--baselines",
            "Evaluate random actions, zero actions and the policies under `scripts` of the scenario on the"
            " same starts.",
        ),
    ] = False,
    details: Annotated[
        bool,
        option(
            "--details",
            "Also show the result in each stage of the curriculum, and by each randomly drawn value: for the"
            " episodes in each quarter, sorted by this value, or for each value if there are at most 6.",
        ),
    ] = False,
    as_json: Annotated[bool, option("--json", "Print the result as JSON.")] = False,
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
        str | None,
        option(
            "--case NAME",
            "Evaluate in this case only; by default in the scenario and in all its cases.",
            SCENARIO,
        ),
    ] = None,
    engine: Annotated[
        list[str] | None,
        option(
            "--engine NAME[,NAME]",
            "Physics engine, by default that of the training, or of `--scenario`; several, with commas between,"
            " are compared on the same starts.",
            SCENARIO,
            callback=_engines,
        ),
    ] = None,
    require_solved: Annotated[
        bool, option("--require-solved", "Exit with 1 unless the task is solved.", _REQUIREMENTS)
    ] = False,
    min_success: Annotated[
        float | None,
        option(
            "--min-success RATE",
            "Exit with 1 if the success rate is below RATE, such as 0.8 or 80%.",
            _REQUIREMENTS,
            parser=fraction,
        ),
    ] = None,
    min_return: Annotated[
        float | None,
        option(
            "--min-return VALUE",
            "Exit with 1 if the mean return is lower than VALUE.",
            _REQUIREMENTS,
            callback=finite,
        ),
    ] = None,
    seed: Annotated[
        int | None,
        integer(
            "--seed N",
            "Root seed of the starts; by default the seed of the training, and 0 for a group.",
            0,
            MAX_SEED,
            ADVANCED,
        ),
    ] = None,
    last: Annotated[
        bool, option("--last", "Evaluate the last model instead of the best one.", ADVANCED)
    ] = False,
    stage: Annotated[
        str | None, option("--stage NAME", "Evaluate in this stage of the curriculum only.", ADVANCED)
    ] = None,
    stochastic: Annotated[
        bool,
        option(
            "--stochastic",
            "Sample the actions of the policy; by default it takes its likeliest action.",
            ADVANCED,
        ),
    ] = False,
    csv: Annotated[
        Path | None, option("--csv FILE", "Write a CSV file with a line for each episode.", ADVANCED)
    ] = None,
    latex: Latex = None,
    junit: Annotated[
        Path | None,
        option("--junit FILE", "Write the requirements as JUnit XML, a test case for each.", ADVANCED),
    ] = None,
    force: Force = False,
    workers: Workers = None,
    address: ClusterAddress = None,
    permissions: Permissions = Permissions(),
) -> None:
    """Evaluate the policy of a run, or of a group."""
    if episodes == FAILED_EPISODES:
        check_options(ctx, "--episodes failed")
        _repeat_failed(ModelRef.open(run, permissions), as_json=as_json, permissions=permissions)
        return
    gates = Gates(min_success, min_return, require_solved)
    check_output(*filter(None, (csv, latex, junit)), force=force)
    source = Source.open(run, permissions, SourceKind.RUN, SourceKind.CHECKPOINT, SourceKind.GROUP)
    if engine is not None and len(engine) > 1:
        check_options(ctx, "several engines")
    if source.kind is SourceKind.GROUP:
        check_options(ctx, "a group")
    request = _Request(
        run=run,
        source=source,
        scenario=scenario,
        overrides=overrides or (),
        engines=engine or (None,),
        case=case,
        stage=stage,
        gates=gates,
        csv=csv,
        latex=latex,
        junit=junit,
        as_json=as_json,
        workers=workers,
        address=address,
        options={"episodes": episodes, "deterministic": not stochastic, "permissions": permissions},
    )
    if source.kind is SourceKind.GROUP:
        _evaluate_group(request, seed=seed or 0, model="last" if last else "best")
        return
    _evaluate_run(
        request,
        ModelRef.open(source, model="last" if last else "best"),
        seed,
        baselines=baselines,
        details=details,
    )


@dataclass(frozen=True)
class _Request:
    """The request of an evaluation: the object, scenario and engines, the requirements, and the output.

    `options` are the options of the functions that evaluate.
    """

    run: Path
    source: Source
    scenario: str | None
    overrides: Sequence[str]
    engines: Sequence[str | None]
    case: str | None
    stage: str | None
    gates: Gates
    csv: Path | None
    latex: Path | None
    junit: Path | None
    as_json: bool
    workers: int | None
    address: str | None
    options: Mapping[str, Any]

    def scenarios(self, trained_in: str) -> list[Compiled | None]:
        """Return the scenario of each engine; None is that of the run or group."""
        return [
            evaluation_scenario(self.source, trained_in, self.scenario, self.overrides, name)
            for name in self.engines
        ]

    def planned(self, run: Run, seed: int | None, scenarios: Sequence[Compiled | None]) -> list[int]:
        """Return the number of episodes in each engine."""
        from deepbots_cli.learning.evaluation import planned_episodes

        return [
            planned_episodes(run, self.options["episodes"], seed, judged, self.case, self.stage, engine=name)
            for name, judged in zip(self.engines, scenarios, strict=True)
        ]

    def write(self, results: Sequence[EvaluationResult], groups: Sequence[GroupResult] = ()) -> None:
        """Write each episode as CSV, and for LaTeX each evaluation and the statistics of groups over seeds."""
        if self.csv is not None:
            records.write_csv(self.csv, results)
        named = (
            (" ".join(filter(None, (result.run.name, result.engine, records.case_label(result)))), result)
            for result in results
        )
        over_seeds: list[Row] = [
            {
                "run": f"{counted(len(group.evaluations), 'seed')} {group.evaluations[0].engine}",
                **records.scores(group),
            }
            for group in groups
        ]
        write_tables([*records.evaluation_rows("run", named), *over_seeds], None, self.latex)


def _evaluate_run(
    request: _Request,
    ref: ModelRef,
    seed: int | None,
    *,
    baselines: bool,
    details: bool,
) -> None:
    """Evaluate a model of a run in each engine."""
    run = ref.run
    gates = request.gates
    case, stage = request.case, request.stage
    scenarios = request.scenarios(run.record.engine)
    programs = [run.program if compiled is None else compiled.program for compiled in scenarios]
    for program in programs:
        gates.check(program)
        program.variant(case, stage)
    with terminal.transient_line("loading the policy ..."):
        planned = request.planned(run, seed, scenarios)
        from deepbots_cli.runtime.spaces import FORWARD_BATCH_SIZE
    parts = math.ceil(max(planned) / FORWARD_BATCH_SIZE)
    reason = f"up to {FORWARD_BATCH_SIZE} episodes run on one worker; choose more with --episodes N"
    arguments.check_dividable(request.workers, request.address, parts, reason)
    evaluations: list[_EngineEvaluations] = []
    requirements: list[Requirement] = []
    with arguments.executor(request.workers, request.address, parts) as executor:
        for name, judged, program, count in zip(request.engines, scenarios, programs, planned, strict=True):
            # Engines are compared on the same starts, so that each of several plays all episodes.
            until = gates.stop_condition(program.variant(case, stage), count) if len(scenarios) == 1 else None
            first = evaluations[0].result if evaluations else None
            options = {"seed": seed, "model": ref.name, "scenario": judged, "engine": name}
            try:
                evaluation = _evaluate_in_engine(
                    request, run, options, until, executor, first, baselines=baselines, details=details
                )
            except KeyboardInterrupt:
                if not evaluations:
                    raise
                break
            evaluations.append(evaluation)
            result = evaluations[-1].result
            records.write_evaluation(run, evaluations[-1].as_json())
            prefix = f"{result.engine}: " if len(scenarios) > 1 else ""
            requirements += [requirement.with_words(prefix) for requirement in gates.requirements(result)]
            if evaluation.unfinished:
                break
    if missing := tuple(f"engine {name}" for name in request.engines[len(evaluations) :]):
        evaluations[-1] = replace(evaluations[-1], unfinished=(*evaluations[-1].unfinished, *missing))
    request.write([result for evaluation in evaluations for result in evaluation.results])
    if evaluations[-1].unfinished:
        _show_unfinished(evaluations, details=details, as_json=request.as_json)
        raise KeyboardInterrupt
    if len(evaluations) > 1:
        _show_engines(run, evaluations, as_json=request.as_json)
    else:
        data = evaluations[0].as_json()
        verdict = records.evaluation_verdict(evaluations[0].result)
        terminal.show(data, *evaluations[0].lines(details=details), verdict=verdict, as_json=request.as_json)
    _require(requirements, [evaluation.result for evaluation in evaluations], request.junit)


def _evaluate_in_engine(
    request: _Request,
    run: Run,
    further_options: Mapping[str, Any],
    until: StopCondition | None,
    executor: Executor,
    first: EvaluationResult | None,
    *,
    baselines: bool,
    details: bool,
) -> _EngineEvaluations:
    """Evaluate a model of a run, and the models that it is compared with; `further_options` are options of
    `evaluate`, and `first` is the evaluation in the first engine. An interruption ends it, and is raised if
    nothing is finished."""
    case, stage = request.case, request.stage
    engine, judged = further_options["engine"], further_options["scenario"]
    unit = "episodes" if engine is None else f"episodes in {engine}"
    options = {**request.options, **further_options}
    episodes = options["episodes"]
    if first is not None:
        options["seed"], episodes = first.seed, first.episodes
    with terminal.progress(unit, always=False) as show_episode:
        result = learning.evaluate(
            run,
            case=case,
            stage=stage,
            until=until,
            executor=executor,
            on_episode=show_episode,
            **options | {"episodes": episodes},
        )
    cases: list[EvaluationResult] = []
    scripted: Sequence[EvaluationResult] = ()
    variants = _variants(run.program if judged is None else judged.program, stages=details)
    if case is not None or stage is not None:
        variants = {}
    unfinished = [*variants, *(["baselines"] if baselines else [])]
    try:
        for name, variant in variants.items():
            with terminal.progress(f"{unit} of {name}", always=False) as show_episode:
                cases.append(
                    learning.evaluate(run, executor=executor, on_episode=show_episode, **variant, **options)
                )
            unfinished.remove(name)
        if baselines:
            baseline_options = {
                name: value for name, value in options.items() if name not in ("model", "deterministic")
            }
            # The evaluation may have ended early, and baselines have its starts.
            baseline_options |= {"episodes": result.episodes, "seed": result.seed}
            with terminal.progress(f"{unit} of baselines", always=False) as show_episode:
                scripted = learning.evaluate_baselines(
                    run, case=case, stage=stage, on_episode=show_episode, **baseline_options
                )
            unfinished.remove("baselines")
    except KeyboardInterrupt:
        if not unfinished:
            raise
    label = scenario_label(run, request.scenario, request.overrides, judged)
    return _EngineEvaluations(result, cases, scripted, label, tuple(unfinished))


def _variants(program: Program, *, stages: bool) -> dict[str, dict[str, Any]]:
    """Return the options of `evaluate` for each case of the scenario, and with `stages` for each stage of its
    curriculum."""
    cases = {f"case {case.name}": {"case": case.name} for case in program.cases}
    of_stages = {f"stage {stage.name}": {"stage": stage.name} for stage in program.curriculum if stages}
    return {**cases, **of_stages}


@dataclass(frozen=True)
class _EngineEvaluations:
    """The evaluations of a run in one engine. `scenario` is a text for a scenario that replaces the scenario
    of the run; `unfinished` are the cases, stages and engines that an interruption left out."""

    result: EvaluationResult
    cases: Sequence[EvaluationResult]
    baselines: Sequence[EvaluationResult]
    scenario: str | None
    unfinished: tuple[str, ...] = ()

    @property
    def results(self) -> tuple[EvaluationResult, ...]:
        return (self.result, *self.cases, *self.baselines)

    def as_json(self) -> dict[str, Any]:
        return {
            **records.evaluation_json(self.result, self.cases),
            "baselines": [baseline.model_dump(mode="json") for baseline in self.baselines],
        }

    def lines(self, *, details: bool) -> Iterator[str]:
        yield records.evaluation_text(self.result, self.cases, scenario=self.scenario)
        if self.baselines:
            policies = [
                ("the trained policy", self.result),
                *((baseline.model, baseline) for baseline in self.baselines),
            ]
            yield "\nbaselines, on the same starts\n" + table(records.evaluation_rows("policy", policies))
        if details:
            yield "\n" + records.drawn_text(self.result)


def _repeat_failed(ref: ModelRef, *, as_json: bool, permissions: Permissions) -> None:
    """Repeat the failed episodes of the last evaluation of a run or a model, count their endings, and show
    the first."""
    from deepbots_cli.insight import trace
    from deepbots_cli.insight.episode import explain, explanation_json

    path, evaluation = records.last_evaluation(ref)
    run = ref.run
    failed = evaluation.failed(run.program)
    first = failed[:_MAX_FAILED]
    rows = []
    with terminal.progress("episodes", always=False) as show:
        again = (
            trace.trace_episodes(run, failed, **evaluation.replay_options, permissions=permissions)
            if failed
            else ()
        )
        for number, traced in zip(failed, again, strict=True):
            statements = explain(traced)
            rows.append({"number": number, **explanation_json(traced, statements)})
            if show is not None:
                show(len(rows), len(failed))
            if not as_json and number in first:
                terminal.print_result(f"episode {number}: '{traced.ended_by}' at {traced.time:.2f} s")
                if ends := [statement.text for statement in statements if statement.cause in _ENDS]:
                    terminal.print_result(f"  {' '.join(ends)}")
    lines = [f"and {len(failed) - len(first)} more; --json shows all"] if len(failed) > len(first) else []
    lines.append(f"{len(failed)} of {len(evaluation.outcomes)} episodes of {path} failed")
    lines += [
        f"  '{ending}' ended {count}"
        for ending, count in Counter(row["ended_by"] for row in rows).most_common()
    ]
    name = shell_word(ref.path if ref.is_named else run.path)
    commands = [f"deepbots diagnose {name} --episode {number}" for number in failed[:1]]
    commands += [f"deepbots render {name} -o failed.mp4 --episodes failed"] if failed else []
    data = {"run": run.path, "evaluation": path, "episodes": len(evaluation.outcomes), "failed": rows}
    terminal.show(data, *lines, as_json=as_json, next_commands=commands)


def _show_unfinished(evaluations: Sequence[_EngineEvaluations], *, details: bool, as_json: bool) -> None:
    """Show what was evaluated before an interruption, and name the rest."""
    unfinished = evaluations[-1].unfinished
    parts = [evaluation.as_json() for evaluation in evaluations]
    data = parts[0] if len(parts) == 1 else {"evaluations": parts}
    lines = [line for evaluation in evaluations for line in evaluation.lines(details=details)]
    terminal.show(data | {"unfinished": list(unfinished)}, *lines, as_json=as_json)
    terminal.note(f"not evaluated: {', '.join(unfinished)}")


def _show_engines(run: Run, evaluations: Sequence[_EngineEvaluations], *, as_json: bool) -> None:
    """Show the evaluations in several engines side by side, and the difference of each from the first, from
    the same starts."""
    from deepbots_cli.learning.comparison import compare_engines

    columns = zip(*((evaluation.result, *evaluation.cases) for evaluation in evaluations), strict=True)
    pairs = [compare_engines(column[0], result) for column in columns for result in column[1:]]
    first = evaluations[0].result
    scenario = f"; scenario {evaluations[0].scenario}" if evaluations[0].scenario else ""
    results = [result for evaluation in evaluations for result in (evaluation.result, *evaluation.cases)]
    rows = [
        {"engine": result.engine, **row}
        for result, row in zip(results, records.case_rows(results), strict=True)
    ]
    terminal.show(
        {"evaluations": [evaluation.as_json() for evaluation in evaluations], "differences": pairs},
        f"evaluation of {first.scenario} in {len(evaluations)} engines, trained in"
        f" {run.record.engine}{scenario}",
        f"  {records.held_out(first.episodes)} from evaluation seed {first.seed}, the same in every engine",
        table(rows),
        "\ndifferences on the same starts, with 95 % intervals\n" + records.engines_table(pairs),
        *dict.fromkeys(f"note: {note}" for evaluation in evaluations for note in evaluation.result.notes),
        verdict="\n".join(
            f"{each.result.engine}: {records.evaluation_verdict(each.result)}" for each in evaluations
        ),
        as_json=as_json,
    )


def evaluation_scenario(
    source: Source, trained_in: str, scenario: str | None, overrides: Sequence[str] | None, engine: str | None
) -> Compiled | None:
    """Return the scenario to evaluate in, if it is not that of the run or group `source`."""
    if scenario is None and not overrides and engine in (None, trained_in):
        return None
    scenario_source = (
        source if scenario is None else Source.open(scenario, source.permissions, SourceKind.SCENARIO)
    )
    compiled = api.compile(scenario_source, overrides=with_engine(overrides, engine))
    if scenario is not None:
        terminal.note_warnings(compiled.findings, scenario, compiled.permissions, compiled.overrides)
    return compiled


def _evaluate_group(request: _Request, **further_options: Any) -> None:
    """Evaluate a group in each engine; `further_options` are options of `evaluate_group`."""
    group = Group.open(request.source)
    gates = request.gates
    scenarios = request.scenarios(group.record.engine)
    ready = group.runs_with_model
    reason = f"{request.run} contains {counted(len(ready), 'trained run')}"
    arguments.check_dividable(request.workers, request.address, len(ready), reason)
    options = {**request.options, **further_options, "case": request.case, "stage": request.stage}
    groups: list[GroupResult] = []
    requirements: list[Requirement] = []
    with arguments.executor(request.workers, request.address, len(ready)) as executor:
        with terminal.transient_line("loading the policies ..."):
            from deepbots_cli.learning.comparison import compare_engines, evaluate_group
        for compiled in scenarios:
            planned = 0
            if ready:
                program = Run.open(ready[0]).program if compiled is None else compiled.program
                gates.check(program)
                planned = (options["episodes"] or program.evaluation_episodes(request.case)) * len(ready)
            until = None
            if planned and len(scenarios) == 1:
                until = partial(gates.decided_of_group, planned=planned)
            with terminal.progress("runs", always=False) as show_run:
                result = evaluate_group(
                    request.run, scenario=compiled, on_run=show_run, until=until, executor=executor, **options
                )
            for evaluation in result.evaluations:
                records.write_evaluation(Run.open(evaluation.run), records.evaluation_json(evaluation))
            engine = result.evaluations[0].engine if len(scenarios) > 1 else None
            prefix = "" if engine is None else f"{engine}: "
            requirements += [
                requirement.with_words(prefix) for requirement in gates.requirements_of_group(result, planned)
            ]
            groups.append(result)
            if not request.as_json:
                text = records.group_text(result)
                terminal.print_result(text if engine is None else f"in {engine}: {text}\n")
    request.write([result for group_result in groups for result in group_result.evaluations], groups)
    pairs = [compare_engines(groups[0], group_result) for group_result in groups[1:]]
    if request.as_json:
        rows = [records.group_json(group_result) for group_result in groups]
        terminal.show_json({"groups": rows, "differences": pairs} if pairs else rows[0])
    elif pairs:
        terminal.print_result(
            "differences of each run on the same starts, with 95 % intervals over the seeds"
        )
        terminal.print_result(records.engines_table(pairs))
    _require(
        requirements,
        [result for group_result in groups for result in group_result.evaluations],
        request.junit,
    )


def scenario_label(
    run: Run, scenario: str | None, overrides: Sequence[str], compiled: Compiled | None
) -> str | None:
    """Return a text for a scenario that replaces the scenario of the run; None if neither --scenario nor
    --set is given."""
    if compiled is None or not (scenario or overrides):
        return None
    is_same_task = task_digest(compiled.program) == task_digest(run.program)
    changed = "".join(f" --set {shell_word(text)}" for text in overrides)
    return (
        f"{scenario or 'of the run'}{changed},"
        f" {'with the same episodes as the training' if is_same_task else 'different from the training'}"
    )


def _require(
    requirements: Sequence[Requirement], judged: Sequence[EvaluationResult], junit: Path | None
) -> None:
    """Report each requirement on the `judged` evaluations, and exit with 1 if one is not met."""
    if junit is not None:
        first = judged[0]
        properties = {
            "run": ", ".join(dict.fromkeys(str(result.run) for result in judged)),
            "model": first.model,
            "seed": str(first.seed),
        }
        properties |= {"episodes": str(sum(result.episodes for result in judged))} | records.evaluated_in(
            first
        )
        properties["engine"] = ", ".join(dict.fromkeys(result.engine or "" for result in judged))
        cases = [
            Case(words, reason, "" if met else f"not met: {words} ({reason})")
            for words, met, reason in requirements
        ]
        with atomic_write(junit) as draft:
            draft.write_bytes(
                xml_report({first.scenario: cases}, prefix="deepbots eval ", properties=properties).encode()
            )
    for words, met, reason in requirements:
        if met:
            terminal.note(f"met: {words} ({reason})")
        else:
            terminal.print_error(f"not met: {words} ({reason})")
    if not all(met for _, met, _ in requirements):
        raise typer.Exit(FAILED)


class Requirement(NamedTuple):
    """A requirement in words, whether it is met, and the reason."""

    words: str
    met: bool
    reason: str

    def with_words(self, before: str = "", after: str = "") -> Requirement:
        """Return the requirement with further words around its own."""
        return self._replace(words=f"{before}{self.words}{after}")


@dataclass(frozen=True)
class Gates:
    """The requirements of `--min-success`, `--min-return` and `--require-solved`."""

    min_success: float | None
    min_return: float | None
    solved: bool

    def check(self, program: Program) -> None:
        """Check that the scenario has what the requirements need.

        Raises:
            UsageError: The scenario lacks success, or `solved`.
        """
        solved = program.agent.solved
        if self.solved or self.min_success is not None or self.min_return is not None:
            check_common_measure(program, "require something of one: --agent NAME")
        if self.min_success is not None:
            check_defines_success(
                program, "--min-return" if solved is None else "--min-return or --require-solved"
            )
        if self.solved and solved is None:
            alternatives = "--min-success or --min-return" if program.defines_success else "--min-return"
            raise UsageError(
                f"--require-solved: {program.name} has no `solved` criterion; use {alternatives},"
                " or add a criterion such as `solved: mean_return >= 195 over 100 episodes` to the scenario"
            )

    def verdicts(
        self, episodes: Sequence[Episode], planned: int, bounds: Interval
    ) -> Iterator[tuple[str, Verdict]]:
        """Yield each requirement of a number in words, and its answer after these of `planned` episodes;
        `bounds` are those of a return."""
        if self.min_success is not None:
            successes = sum(episode.is_success for episode in episodes)
            yield (
                f"success rate of at least {self.min_success:g}",
                gate_rate(self.min_success, successes, len(episodes), planned),
            )
        if self.min_return is not None:
            returns = [episode.total_return for episode in episodes]
            yield (
                f"mean return of at least {self.min_return:g}",
                gate_mean(self.min_return, returns, planned, bounds),
            )

    def decided(self, episodes: Sequence[Episode], planned: int, bounds: Interval) -> bool:
        """Return whether every requirement is certainly met, or one certainly not."""
        answers = [verdict.met for _, verdict in self.verdicts(episodes, planned, bounds)]
        return bool(answers) and (False in answers or None not in answers)

    def stop_condition(self, program: Program, planned: int) -> StopCondition | None:
        """Return the condition that ends the episodes once every requirement of a number is certain; None if
        all planned episodes are needed."""
        return (
            None if self.solved else partial(self.decided, planned=planned, bounds=possible_returns(program))
        )

    def requirements(self, result: EvaluationResult) -> list[Requirement]:
        """Return the answers for a run. A requirement that another one has left undecided is left out."""
        requirements = []
        if self.solved:
            requirements.append(Requirement("the task is solved", bool(result.solved), result.answer))
        planned = result.planned or result.episodes
        answers = self.verdicts(result.outcomes, planned, result.possible_returns)
        requirements += [
            Requirement(words, verdict.met, verdict.reason)
            for words, verdict in answers
            if verdict.met is not None
        ]
        remarks = in_parentheses(result.circumstances)
        return [requirement.with_words(after=remarks) for requirement in requirements]

    def decided_of_group(self, episodes: Sequence[Episode], planned: int) -> bool:
        """Return whether the remaining planned episodes of all runs cannot change the answer to
        `--min-success`.

        Other requirements need all episodes, because a confidence sequence does not cover other seeds, and
        returns have no limit.
        """
        if self.min_success is None or self.min_return is not None or self.solved:
            return False
        successes = sum(episode.is_success for episode in episodes)
        least, most = successes / planned, (successes + planned - len(episodes)) / planned
        return least >= self.min_success or most < self.min_success

    def requirements_of_group(self, group: GroupResult, planned: int) -> list[Requirement]:
        """Return the answers for the means over the seeds of a group."""
        left = planned - sum(result.episodes for result in group.evaluations)
        over = f"over {counted(len(group.evaluations), 'seed')}"
        over += f"; the remaining {left} episodes cannot change the result" if left > 0 else ""
        requirements = []
        if self.solved:
            unsolved = [result.run.name for result in group.evaluations if result.solved is False]
            unknown = [result.run.name for result in group.evaluations if result.solved is None]
            reason = f"not solved by {', '.join(unsolved)}" if unsolved else "solved by every seed"
            if unknown and not unsolved:
                reason = f"unknown for {', '.join(unknown)}, because the criterion needs more episodes"
            requirements.append(Requirement("the task is solved", not unsolved and not unknown, reason))
        for name, required, mean in (
            ("success rate", self.min_success, group.success_rate),
            ("mean return", self.min_return, group.mean_return),
        ):
            if required is not None:
                measured, bar = beside(mean, required)
                words = f"{'' if name.startswith('mean') else 'mean '}{name} {measured} {over}"
                requirements.append(Requirement(f"{name} of at least {bar}", mean >= required, words))
        remarks = in_parentheses(
            words for evaluation in group.evaluations for words in evaluation.circumstances
        )
        return [requirement.with_words(after=remarks) for requirement in requirements]
