"""`deepbots try`: episodes without learning, with random or zero actions, a list of actions, or a script of
the scenario; `test`: the tests of scenarios."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from itertools import islice
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any, NamedTuple

import typer

from deepbots_cli import api, rollout
from deepbots_cli.analysis import possible_returns
from deepbots_cli.cli import arguments, records, terminal
from deepbots_cli.cli.arguments import OpenedSource, open_source, scenario_names
from deepbots_cli.cli.command import (
    Case,
    ClusterAddress,
    Engine,
    Force,
    Json,
    Overrides,
    Seed,
    Stage,
    Start,
    Workers,
    check_options,
    integer,
    option,
    start_values,
)
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.render import Case as ReportedCase
from deepbots_cli.diagnostics.render import xml_report
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import MissingExtraError, ScenarioError, UsageError
from deepbots_cli.files import atomic_write, check_output
from deepbots_cli.learning.executor import Attempt, results
from deepbots_cli.learning.runs.episodes import Summary, agent_scores
from deepbots_cli.learning.scenario_tests import TestResult, UnmetExpectation, run_tests
from deepbots_cli.lint.settings import settings
from deepbots_cli.program import RANDOM, Program
from deepbots_cli.program.task import ScenarioTest
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Driver, Episode
from deepbots_cli.rollout.drivers import POLICY, named_driver
from deepbots_cli.rollout.episode import own_episode
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.words import counted, shell_word

ROBOT = "Robot"
COUNT = 3


def command(
    ctx: typer.Context,
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            help="A scenario file, the name of a scenario that comes with deepbots, or the file of a failed"
            " episode (.json).",
        ),
    ],
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    driver: Annotated[
        str | None,
        option(
            "--driver NAME",
            "Who acts: `random`, `zero` (the middle of each range and the first option of each choice), a"
            " script of the scenario, or actions to repeat. By default `random`; with --robot there is no"
            " default for a scenario, and a run acts with its policy.",
        ),
    ] = None,
    episodes: Annotated[
        int | None, integer("--episodes N", f"Number of episodes, {COUNT} by default; with --robot 1.")
    ] = None,
    steps: Annotated[
        int | None,
        integer(
            "--steps N", "Stop after this total number of steps; by default at the end of the last episode."
        ),
    ] = None,
    seed: Seed = 0,
    start: Start = None,
    robot: Annotated[
        str | None,
        option(
            "--robot ADDRESS",
            "Act for the robot at an address in place of the simulated one: ros, ros:DOMAIN,"
            " tcp://HOST:PORT, ipc://FILE or ws://HOST:PORT. A scenario needs --driver with it; of a run, the"
            " policy acts.",
            ROBOT,
        ),
    ] = None,
    lockstep: Annotated[
        bool,
        option(
            "--lockstep",
            "With --robot, answer each set of values once; a simulated robot then waits for the answer.",
            ROBOT,
        ),
    ] = False,
    speed: Annotated[
        float, option("--speed X", "With --robot, how many seconds of the robot pass in one second.", ROBOT)
    ] = 1.0,
    engine: Engine = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Run a few episodes without training."""
    if scenario.endswith(".json") and _reproduced(ctx, Path(scenario), permissions, as_json=as_json):
        return
    options = start_values(start)
    data = {"seed": seed, "start": options, "case": case, "stage": stage}
    if robot is not None:
        recorded_with: dict[str, Any] = {
            "episodes": episodes or 1,
            "seed": seed,
            "options": options,
            "max_steps": steps,
            "engine": engine,
        }
        from deepbots_robot.server import report_lines

        source = open_source(scenario, overrides or (), permissions, engine)
        program = source.program.variant(case, stage)
        result, report = _on_robot(
            source,
            program,
            driver,
            robot,
            lockstep=lockstep,
            speed=speed,
            permissions=permissions,
            **recorded_with,
        )
        show_episodes(
            program,
            result,
            data | {"driver": driver or POLICY, "link": report},
            report_lines(report),
            as_json=as_json,
        )
        return
    compiled = api.compile(scenario, overrides=with_engine(overrides, engine), permissions=permissions)
    terminal.note_warnings(compiled.findings, scenario, compiled.permissions, compiled.overrides)
    program = compiled.program.variant(case, stage)
    driver = RANDOM if driver is None else driver
    outcomes, name = _simulate(program, driver, episodes or COUNT, seed, steps, options, permissions)
    show_episodes(
        program,
        outcomes,
        {"digest": compiled.digest, "engine": name, **data, "driver": driver},
        (),
        as_json=as_json,
    )


def _simulate(
    program: Program,
    driver: str,
    count: int,
    seed: int,
    max_steps: int | None,
    options: dict[str, Any],
    permissions: Permissions,
) -> tuple[list[Episode], str]:
    """Run episodes in the simulation. Returns them, and the name of the engine. Many episodes are counted
    while they run."""
    with closing(api.make(program, permissions=permissions)) as environment:
        acting = named_driver(environment, driver)
        running = run_episodes(
            environment, acting, count=count, seed=seed, max_steps=max_steps, options=options
        )
        outcomes: list[Episode] = []
        with terminal.progress() as show:
            for episode in running:
                outcomes.append(episode)
                if count > MAX_SHOWN:
                    show(len(outcomes), count)
        return outcomes, environment.engine.name


def _on_robot(
    source: OpenedSource, program: Program, driver: str | None, address: str, **settings: Any
) -> tuple[list[Episode], dict[str, Any]]:
    """Run episodes on the robot at an address, with the policy of a run, or a named driver."""
    if driver is None and source.run is None:
        raise UsageError(
            "--robot needs --driver NAME: random, zero, a script of the scenario, or actions; or name a run,"
            " whose policy acts"
        )
    if not 0.0 < settings["speed"] <= 1000.0:
        raise UsageError(f"--speed {settings['speed']:g}: write a number above 0, at most 1000")
    try:
        from deepbots_cli.insight.real_robot import try_robot
        from deepbots_robot.serving import ServeError, Transport
    except ModuleNotFoundError as error:
        raise MissingExtraError("robot", "acting for a robot") from error
    run = source.run

    def acting(world: Supervisor) -> Driver:
        if driver is not None and (driver != POLICY or run is None):
            return named_driver(world, driver)
        from deepbots_cli.learning import policy
        from deepbots_cli.rollout.policies import PolicyDriver

        assert run is not None  # a scenario has a driver
        return PolicyDriver(policy.loaded(run, source.model), world)

    try:
        transport = Transport.at(address)
    except ServeError as error:
        raise UsageError(str(error)) from None
    return try_robot(program, transport, acting, note=terminal.note, **settings)


def _reproduced(ctx: typer.Context, path: Path, permissions: Permissions, *, as_json: bool) -> bool:
    """Repeat a failed episode; return whether the file is one."""
    from deepbots_cli.learning import environments  # this imports gymnasium

    if not environments.is_failure(path):
        return False
    check_options(ctx, "the file of a failed episode")
    failure, error = environments.reproduce(path, permissions=permissions)
    repeated = (
        f"repeated {counted(len(failure.actions), 'action')}:"
        f" {'the episode does not fail' if error is None else error}"
    )
    terminal.show(
        {**failure.model_dump(), "reproduced": error}, f"{path}: {failure.error}", repeated, as_json=as_json
    )
    return True


MAX_SHOWN = 20
"""The largest number of episodes that are listed one by one. Of more episodes, only the first
`FIRST_EPISODES` are listed."""
FIRST_EPISODES = 5


def run_episodes(
    environment: Supervisor,
    driver: Driver,
    *,
    count: int,
    seed: int,
    max_steps: int | None,
    options: dict[str, Any] | None = None,
) -> Iterator[Episode]:
    """Run up to `count` episodes with the `options` of `reset`, the first with `seed`.

    `ended_by` is `--steps` for an episode that `max_steps` ends.
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


def show_episodes(
    program: Program, outcomes: list[Episode], data: dict[str, Any], more: Sequence[str], *, as_json: bool
) -> None:
    summary = Summary.of_episodes(outcomes, possible_returns(program))
    data = {"scenario": program.name, **data, "episodes": list(map(_row, outcomes))}
    agents = agent_scores(program.members, outcomes)
    verdict = "" if agents else records.result_sentence(summary, success_defined=program.defines_success)
    totals = "\n" + records.summary_text(summary, success_defined=program.defines_success, agents=agents)
    data["summary"] = {"success_defined": program.defines_success, **vars(summary)}
    if agents:
        data["summary"]["agents"] = agents
    if program.others is not None:
        terminal.note(f"{program.others.agent} acts against {program.others.text}")
    terminal.show(
        data,
        *_lines(program, outcomes),
        *([totals] if len(outcomes) > 1 else []),
        *more,
        verdict=verdict,
        as_json=as_json,
    )


def _row(episode: Episode) -> Row:
    return {
        "return": episode.total_return,
        "length": episode.length,
        "ended_by": episode.ended_by,
        "success": episode.is_success,
        "reward_terms": dict(episode.terms),
        "drawn": dict(episode.drawn),
    }


def _agent_columns(program: Program, episode: Episode) -> Row:
    """Return the columns of an episode of several agents: the return of each, and who succeeded."""
    agent_episodes = {name: own_episode(member, episode) for name, member in program.members.items()}
    succeeded = [name for name, agent_episode in agent_episodes.items() if agent_episode.is_success]
    return {
        **{f"return of {name}": agent_episode.total_return for name, agent_episode in agent_episodes.items()},
        "length": episode.length,
        "ended_by": episode.ended_by,
        "success": ", ".join(succeeded) or "no",
    }


def _lines(program: Program, outcomes: list[Episode]) -> Iterator[str]:
    first_episodes = outcomes if len(outcomes) <= MAX_SHOWN else outcomes[:FIRST_EPISODES]
    rows = [
        {"episode": number, **(_agent_columns(program, episode) if program.members else _row(episode))}
        for number, episode in enumerate(first_episodes)
    ]
    listed = [
        {name: value for name, value in row.items() if name not in ("reward_terms", "drawn")} for row in rows
    ]
    yield "episodes\n" + table(listed)
    if len(first_episodes) < len(outcomes):
        yield f"  and {len(outcomes) - len(first_episodes):,} more"
    if outcomes[0].terms:
        yield "\nreward terms\n" + table([_term(outcomes, name) for name in outcomes[0].terms])


def _term(outcomes: list[Episode], name: str) -> Row:
    sums = [episode.terms[name] for episode in outcomes]
    steps = sum(episode.length for episode in outcomes)
    per_step = sum(sums) / max(1, steps)  # a robot may restart before the first step
    return {
        "term": name,
        "per_episode": fmean(sums),
        "min_episode": min(sums),
        "max_episode": max(sums),
        "per_step": per_step,
    }


@dataclass(frozen=True)
class _ScenarioResults:
    """The results of one scenario with its `warnings`; with errors in its file there are `findings`
    instead."""

    scenario: str
    results: tuple[TestResult, ...] = ()
    findings: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()

    @property
    def passed(self) -> bool:
        return not self.findings and all(result.passed for result in self.results)


def command_test(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SCENARIO",
            help="Scenario files, names of shipped scenarios, or folders; by default this folder.",
        ),
    ] = None,
    only: Annotated[
        str | None, option("-k NAME", "Run only the tests whose names contain this text.")
    ] = None,
    overrides: Overrides = None,
    engine: Engine = None,
    junit: Annotated[Path | None, option("--junit FILE", "Write the results as JUnit XML.")] = None,
    force: Force = False,
    workers: Workers = None,
    address: ClusterAddress = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Run the tests of scenarios."""
    if junit is not None:
        check_output(junit, force=force)
    began = time.perf_counter()
    names = scenario_names(scenarios or ["."], settings())
    options: dict[str, Any] = {
        "overrides": with_engine(overrides, engine),
        "permissions": permissions,
        "tests": True,
    }
    added = [f"--engine {engine}"] if engine else []
    added += terminal.scenario_options(permissions, overrides or ())
    arguments.check_dividable(
        workers, address, len(names), "there is one scenario; name several, or a folder"
    )
    scenario_results = []
    calls = [_Scenario(name, only, engine, options) for name in names]
    files = [Path(name) for name in names if Path(name).is_file()]
    with arguments.executor(workers, address, len(names)) as executor:
        for tested in results(executor.map(_tested, calls, files=files)):
            scenario_results.append(tested)
            terminal.note_warnings(tested.warnings, tested.scenario, permissions, options["overrides"])
            if not as_json:
                _show_tests(tested, added, permissions)
    if not any(tested.results or tested.findings for tested in scenario_results):
        missing = "under `tests`" if only is None else f"whose name contains '{only}'"
        raise UsageError(
            f"there is no test {missing} in {', '.join(names[:5])}{' ...' if len(names) > 5 else ''}"
        )
    if as_json:
        terminal.show_json(
            {
                "passed": all(tested.passed for tested in scenario_results),
                "scenarios": [_test_data(tested, added) for tested in scenario_results],
            }
        )
    else:
        _sum_up(scenario_results, only, time.perf_counter() - began)
    if junit is not None:
        suites = {
            tested.scenario: _junit(tested)
            for tested in scenario_results
            if tested.results or tested.findings
        }
        with atomic_write(junit) as draft:
            draft.write_bytes(xml_report(suites, prefix="deepbots test ").encode())
    if not all(tested.passed for tested in scenario_results):
        raise typer.Exit(FAILED)


class _Scenario(NamedTuple):
    """A scenario to be tested: its tests whose names contain `only`, and the options for loading it."""

    name: str
    only: str | None
    engine: str | None
    options: dict[str, Any]


def _tested(scenario: _Scenario, attempt: Attempt) -> _ScenarioResults:
    name, only, engine, options = scenario
    checked = api.load(name, **options)
    try:
        compiled = api.compile(checked)
    except ScenarioError as error:
        return _ScenarioResults(name, findings=tuple(error.findings))
    tests = [test for test in checked.tests if only is None or only in test.name]
    with terminal.progress(f"episodes of {name}", always=False) as show:
        test_results = run_tests(
            compiled.program, tests, engine=engine, permissions=compiled.permissions, on_episode=show
        )
        in_order = tuple(sorted(test_results, key=lambda result: tests.index(result.test)))
    return _ScenarioResults(name, in_order, warnings=tuple(compiled.findings) if tests else ())


def _show_tests(tested: _ScenarioResults, options: Sequence[str], permissions: Permissions) -> None:
    if tested.findings:
        terminal.show_findings(tested.findings, permissions)
        terminal.print_result(f"{tested.scenario}: not tested, because the file has errors\n")
    elif tested.results:
        terminal.print_result(f"{tested.scenario}\n{table([_test_row(result) for result in tested.results])}")
        for result in tested.results:
            if not result.passed:
                terminal.print_result(f"\n  FAILED {result.test.name} ({result.test.span.location})")
            for unmet in result.unmet:
                terminal.print_result(
                    f"    expected  {unmet.expected} ({unmet.where})\n    measured  {unmet.measured}"
                )
                terminal.print_result(f"    show it   {_command(tested.scenario, result, unmet, options)}")
        terminal.print_result()


def _test_row(result: TestResult) -> Row:
    numbers = {"episodes": result.episodes, "steps": result.steps, "seconds": f"{result.seconds:.2f}"}
    return {"test": result.test.name, "result": "passed" if result.passed else "FAILED", **numbers}


def _command(scenario: str, result: TestResult, unmet: UnmetExpectation, options: Sequence[str]) -> str:
    """Return the command that shows the episode of an unmet expectation, with the options of this one."""
    test = result.test
    episode = unmet.episode
    settings = [f"--{word} {value}" for word, value in (("case", test.case), ("stage", test.stage)) if value]
    where = " ".join([shell_word(scenario), *settings, *options, *_acting_options(test)])
    if isinstance(test.driver, str):
        return f"deepbots view {where} --driver {test.driver} --seed {test.seed} --episode {episode}"
    actions = ",".join(action.text for action in test.driver)
    seed = derive_seed(test.seed, "evaluation", episode)
    # An action may begin with a minus, which without the equals sign would make it an option.
    return f"deepbots try {where} --driver={actions} --steps {len(test.driver)} --episodes 1 --seed {seed}"


def _acting_options(test: ScenarioTest) -> list[str]:
    """Return the options that let the other agents act as in a test of several agents."""
    if not test.drivers:
        return []
    options = [f"--against {name}={driver}" for name, driver in test.drivers.items() if name != test.agent]
    return [f"--agent {test.agent}", *options]


def _sum_up(scenario_results: Sequence[_ScenarioResults], only: str | None, seconds: float) -> None:
    test_results = [result for tested in scenario_results for result in tested.results]
    failed, broken = (
        sum(not result.passed for result in test_results),
        sum(bool(tested.findings) for tested in scenario_results),
    )
    untested = [tested.scenario for tested in scenario_results if not tested.results and not tested.findings]
    if untested:
        terminal.note(
            f"no {f'test with {only!r} in its name' if only else 'tests'} in {', '.join(untested[:5])}"
            + (f" and {len(untested) - 5} more" if len(untested) > 5 else "")
        )
    words = [f"{len(test_results) - failed} passed"]
    if failed:
        words.append(f"{failed} failed")
    if broken:
        words.append(f"{counted(broken, 'scenario')} with errors")
    terminal.print_verdict(f"{', '.join(words)} in {seconds:.1f} s")


def _junit(tested: _ScenarioResults) -> Iterator[ReportedCase]:
    yield from (
        ReportedCase("the scenario has no errors", finding.headline, finding.headline)
        for finding in tested.findings[:1]
    )
    for result in tested.results:
        reason = "; ".join(f"{unmet.expected} ({unmet.where}): {unmet.measured}" for unmet in result.unmet)
        fault = "" if result.passed else f"not met: {result.test.name} ({reason})"
        yield ReportedCase(result.test.name, reason, fault, attributes={"time": f"{result.seconds:.3f}"})


def _test_data(tested: _ScenarioResults, options: Sequence[str]) -> dict[str, Any]:
    tests = [
        {
            "test": result.test.name,
            "where": result.test.span.location,
            **{key: getattr(result.test, key) for key in ("case", "stage", "seed")},
            **{key: getattr(result, key) for key in ("passed", "episodes", "steps", "seconds")},
            "misses": [
                asdict(unmet) | {"command": _command(tested.scenario, result, unmet, options)}
                for unmet in result.unmet
            ],
        }
        for result in tested.results
    ]
    errors = [
        {"code": finding.code, "where": finding.span.location, "headline": finding.headline}
        for finding in tested.findings
    ]
    return {"scenario": tested.scenario, "passed": tested.passed, "tests": tests, "findings": errors}
