"""`deepbots test`: the tests of scenarios."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer

from deepbots_cli import api
from deepbots_cli.cli import results, terminal
from deepbots_cli.cli.command import AllowCode, AllowPaths, Engine, Json, Sets
from deepbots_cli.cli.commands.lint import named
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.diagnostics import Finding
from deepbots_cli.engine_kinds import on_engine
from deepbots_cli.errors import ScenarioError, UsageError
from deepbots_cli.learning.scenario_tests import Miss, TestResult, run_tests
from deepbots_cli.lint.settings import settings
from deepbots_cli.program import Program
from deepbots_cli.program.task import Choices, FixedAction, ScenarioTest
from deepbots_cli.runtime.streams import derive


@dataclass(frozen=True)
class _Tested:
    """The results of one scenario; with errors in its file there are `findings` instead."""

    scenario: str
    program: Program | None = None
    engine: str | None = None
    results: tuple[TestResult, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def passed(self) -> bool:
        return not self.findings and all(result.passed for result in self.results)


def command(
    scenarios: Annotated[
        list[str], typer.Argument(metavar="SCENARIO", help="Scenario files, folders, or names of scenarios that come with deepbots.")
    ],
    only: Annotated[str | None, typer.Option("-k", metavar="NAME", help="Run only the tests whose names contain this text.")] = None,
    sets: Sets = None,
    engine: Engine = None,
    junit: Annotated[Path | None, typer.Option("--junit", metavar="FILE", help="Write the results as JUnit XML.")] = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
    allow_code: AllowCode = False,
) -> None:
    """Run the tests of scenarios.

    A scenario lists its tests under `tests`: who acts (a script, random or zero actions, or a sequence of actions), for how many episodes,
    and the expected result. A failed test shows what was expected and measured, and a command that shows the episode.

    The exit code is 0 if all tests pass, 1 if a test fails or a scenario has errors, and 2 if there is no test to run.

    \b
      deepbots test cartpole
      deepbots test scenarios/ --junit tests.xml
      deepbots test cartpole.yaml -k falls --engine mujoco

    Next: `deepbots view SCENARIO` shows an episode, with the options that a failed test prints.
    """
    if junit is not None and not junit.absolute().parent.is_dir():
        raise UsageError(f"{junit} cannot be written: there is no directory {junit.parent}")
    began, names = time.perf_counter(), named(scenarios, settings())
    options: dict[str, Any] = {"sets": on_engine(sets, engine), "allow_paths": allow_paths or (), "allow_code": allow_code, "tests": True}
    done = []
    for name in names:
        done.append(_tested(name, only, engine, options))
        if not as_json and (done[-1].results or done[-1].findings):
            _show(done[-1], sets or ())
    count = sum(len(found.results) for found in done)
    if not count and not any(found.findings for found in done):
        missing = f"whose name contains '{only}'" if only is not None else "under `tests`"
        raise UsageError(f"there is no test {missing} in {', '.join(names[:5])}{' ...' if len(names) > 5 else ''}")
    if junit is not None:
        results.write_junit(junit, "test", {found.scenario: _junit(found) for found in done if found.results or found.findings})
    if as_json:
        terminal.show_json({"passed": all(found.passed for found in done), "scenarios": [_data(found) for found in done]})
    else:
        _sum_up(done, time.perf_counter() - began)
    if not all(found.passed for found in done):
        raise typer.Exit(FAILED)


def _tested(name: str, only: str | None, engine: str | None, options: dict[str, Any]) -> _Tested:
    checked = api.load(name, **options)
    try:
        compiled = api.compile(checked)
    except ScenarioError as error:
        return _Tested(name, findings=tuple(error.findings))
    terminal.mention(compiled.findings, name)
    program, allow_code = compiled.program, compiled.allow_code
    tests = [test for test in checked.tests if only is None or only in test.name]
    with terminal.progress(f"episodes of {name}", always=False) as show:
        found = list(run_tests(program, tests, engine=engine, allow_code=allow_code, on_episode=show)) if tests else []
    places = {test.name: place for place, test in enumerate(tests)}
    return _Tested(name, program, engine, tuple(sorted(found, key=lambda result: places[result.test.name])))


def _show(found: _Tested, sets: Sequence[str]) -> None:
    if found.findings:
        terminal.show_findings(found.findings)
        terminal.say(f"{found.scenario}: not tested, because the file has errors\n")
        return
    rows: list[Row] = [
        {
            "test": result.test.name,
            "result": "passed" if result.passed else "FAILED",
            "episodes": result.episodes,
            "steps": result.steps,
            "seconds": f"{result.seconds:.2f}",
        }
        for result in found.results
    ]
    terminal.say(f"{found.scenario}\n{table(rows)}")
    for result in found.results:
        if not result.passed:
            terminal.say(f"\n  FAILED {result.test.name} ({result.test.span.where})")
            for miss in result.misses:
                terminal.say(f"    expected  {miss.expected} ({miss.where})\n    measured  {_measured(found, result.test, miss)}")
                terminal.say(f"    show it   {_command(found, result.test, miss, sets)}")
    terminal.say()


def _measured(found: _Tested, test: ScenarioTest, miss: Miss) -> str:
    period = found.program.period if found.program else 0.0
    step = f", step {miss.step:,} ({miss.step * period:.4g} s)" if miss.step is not None else ""
    return f"{miss.measured}; seed {test.seed}, episode {miss.episode}{step}" if miss.episode is not None else miss.measured


def _command(found: _Tested, test: ScenarioTest, miss: Miss, sets: Sequence[str]) -> str:
    """The command that shows the episode."""
    episode = miss.episode or 0
    options = [f"--{word} {value}" for word, value in (("case", test.case), ("stage", test.stage), ("engine", found.engine)) if value]
    options += [f"--set {quote(text)}" for text in sets]
    where = " ".join(["", quote(found.scenario), *options])
    if isinstance(test.policy, str):
        return f"deepbots view{where} --script {test.policy} --seed {test.seed} --episode {episode}"
    assert found.program is not None  # it was run
    actions = ",".join(_words(found.program, action) for action in test.policy)
    seed = derive(test.seed, "evaluation", episode)
    return f"deepbots run{where} --actions={actions} --steps {len(test.policy)} --episodes 1 --seed {seed}"


def _words(program: Program, action: FixedAction) -> str:
    """An action as `run --actions` takes it."""
    choices, ranges = iter(action.choices), iter(action.ranges)
    words: list[str] = []
    for part in program.policy.action:
        if isinstance(part, Choices):
            words.append(part.options[next(choices)].name)
        else:
            words += [f"{next(ranges):g}" for _ in part.components or ("",)]
    return ":".join(words)


def _sum_up(done: Sequence[_Tested], seconds: float) -> None:
    every = [result for found in done for result in found.results]
    failed, broken = sum(not result.passed for result in every), sum(bool(found.findings) for found in done)
    untested = [found.scenario for found in done if not found.results and not found.findings]
    if untested:
        terminal.note(f"no tests in {', '.join(untested[:5])}" + (f" and {len(untested) - 5} more" if len(untested) > 5 else ""))
    words = [f"{len(every) - failed} passed", *([f"{failed} failed"] if failed else [])]
    words += [f"{broken} scenario{'s' * (broken > 1)} with errors"] if broken else []
    terminal.say(f"{', '.join(words)} in {seconds:.1f} s")


def _junit(found: _Tested) -> list[results.JUnitCase]:
    if found.findings:
        return [results.JUnitCase("the scenario has no errors", False, found.findings[0].headline)]
    return [
        results.JUnitCase(
            result.test.name,
            result.passed,
            "; ".join(f"{miss.expected} ({miss.where}): {_measured(found, result.test, miss)}" for miss in result.misses) or "passed",
            result.seconds,
        )
        for result in found.results
    ]


def _data(found: _Tested) -> dict[str, Any]:
    tests = [
        {
            "test": result.test.name,
            "where": result.test.span.where,
            "passed": result.passed,
            "case": result.test.case,
            "stage": result.test.stage,
            "episodes": result.episodes,
            "steps": result.steps,
            "seconds": result.seconds,
            "seed": result.test.seed,
            "misses": [asdict(miss) | {"command": _command(found, result.test, miss, ())} for miss in result.misses],
        }
        for result in found.results
    ]
    errors = [{"code": finding.code, "where": finding.span.where, "headline": finding.headline} for finding in found.findings]
    return {"scenario": found.scenario, "engine": found.engine, "passed": found.passed, "tests": tests, "findings": errors}
